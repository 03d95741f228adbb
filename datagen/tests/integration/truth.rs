//! The truth against the picture: corners and centre are found again with sub-pixel accuracy from the pixels alone (the annotation only says
//! where to look, and is first moved by up to a pixel).
use image::RgbImage;
use tcross_datagen::{Backgrounds, Blend, Config, Dist, Medium, Surface, color, sample};
use tcross_dataset::{Record, Rng};

type P = [f64; 2];

/// Light at a continuous place, bilinear between pixel centres.
fn light(image: &RgbImage, [x, y]: P) -> [f64; 3] {
    let (x, y) = (x - 0.5, y - 0.5);
    let (i, j) = (x.floor(), y.floor());
    let (u, v) = (x - i, y - j);
    let at = |dx: f64, dy: f64| {
        let px = (i + dx).clamp(0.0, f64::from(image.width()) - 1.0) as u32;
        let py = (j + dy).clamp(0.0, f64::from(image.height()) - 1.0) as u32;
        color::linear(*image.get_pixel(px, py)).map(f64::from)
    };
    let (a, b, c, d) = (at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0), at(1.0, 1.0));
    std::array::from_fn(|k| (a[k] * (1.0 - u) + b[k] * u) * (1.0 - v) + (c[k] * (1.0 - u) + d[k] * u) * v)
}

fn sub(a: P, b: P) -> P {
    [a[0] - b[0], a[1] - b[1]]
}

fn along(p: P, d: P, t: f64) -> P {
    [p[0] + d[0] * t, p[1] + d[1] * t]
}

fn unit(d: P) -> P {
    let n = d[0].hypot(d[1]);
    [d[0] / n, d[1] / n]
}

/// A line as a point and a direction: total least squares.
fn fit(points: &[P]) -> (P, P) {
    let n = points.len() as f64;
    let mean = [points.iter().map(|p| p[0]).sum::<f64>() / n, points.iter().map(|p| p[1]).sum::<f64>() / n];
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for p in points {
        let d = sub(*p, mean);
        (xx, xy, yy) = (xx + d[0] * d[0], xy + d[0] * d[1], yy + d[1] * d[1]);
    }
    let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
    (mean, [angle.cos(), angle.sin()])
}

fn cross((p, d): (P, P), (q, e): (P, P)) -> P {
    let t = ((q[0] - p[0]) * e[1] - (q[1] - p[1]) * e[0]) / (d[0] * e[1] - d[1] * e[0]);
    along(p, d, t)
}

/// Profiles across one side, from outside (-reach) to inside, as the share of the way from the colour outside to the colour inside.
struct Profiles {
    places: Vec<P>,
    inward: P,
    reach: f64,
    shares: Vec<Vec<f64>>,
    /// How the light rises per pixel along a profile, outside and inside; common to the side, because it is the light's and not the edge's.
    slopes: [f64; 2],
}

const STEPS: usize = 200;
/// Samples at either end of a profile that no blur reaches.
const FLAT: usize = STEPS * 3 / 16;

impl Profiles {
    fn take(image: &RgbImage, places: Vec<P>, inward: P, reach: f64) -> Self {
        let at = |k: usize| -reach + 2.0 * reach * (k as f64 + 0.5) / STEPS as f64;
        let values: Vec<Vec<[f64; 3]>> =
            places.iter().map(|p| (0..STEPS).map(|k| light(image, along(*p, inward, at(k)))).collect()).collect();
        let mean = |range: std::ops::Range<usize>| -> [f64; 3] {
            let n = (range.len() * values.len()) as f64;
            std::array::from_fn(|c| values.iter().flat_map(|v| &v[range.clone()]).map(|v| v[c]).sum::<f64>() / n)
        };
        let (outside, inside) = (mean(0..FLAT), mean(STEPS - FLAT..STEPS));
        let d: [f64; 3] = std::array::from_fn(|c| inside[c] - outside[c]);
        let norm: f64 = d.iter().map(|v| v * v).sum();
        let share = |v: &[f64; 3]| (0..3).map(|c| (v[c] - outside[c]) * d[c]).sum::<f64>() / norm;
        let shares: Vec<Vec<f64>> = values.iter().map(|v| v.iter().map(share).collect()).collect();
        let slope = |range: std::ops::Range<usize>| {
            let mean = |f: &dyn Fn(usize) -> f64| range.clone().map(f).sum::<f64>() / range.len() as f64;
            let level = |k: usize| shares.iter().map(|s| s[k]).sum::<f64>() / shares.len() as f64;
            let (x, y) = (mean(&at), mean(&level));
            let (xy, xx) = range.clone().fold((0.0, 0.0), |(xy, xx), k| (xy + (at(k) - x) * (level(k) - y), xx + (at(k) - x).powi(2)));
            xy / xx
        };
        let slopes = [slope(0..FLAT), slope(STEPS - FLAT..STEPS)];
        Self { places, inward, reach, shares, slopes }
    }

    /// Where the fill ends on each profile: two sloping levels that meet at a step have the profile's area. Symmetric blur keeps it.
    fn edges(&self) -> Vec<P> {
        let step = 2.0 * self.reach / STEPS as f64;
        let at = |k: usize| -self.reach + step * (k as f64 + 0.5);
        let level = |s: &[f64], range: std::ops::Range<usize>, slope: f64| {
            range.clone().map(|k| s[k] - slope * at(k)).sum::<f64>() / range.len() as f64
        };
        let one = |(place, s): (&P, &Vec<f64>)| {
            let (a, b) = (level(s, 0..FLAT, self.slopes[0]), level(s, STEPS - FLAT..STEPS, self.slopes[1]));
            let area: f64 = s.iter().sum::<f64>() * step;
            // Area of the two levels with the step at x, less the profile's; it falls as x moves inwards.
            let excess = |x: f64| {
                let part = |level: f64, slope: f64, from: f64, to: f64| level * (to - from) + slope * (to * to - from * from) / 2.0;
                part(a, self.slopes[0], -self.reach, x) + part(b, self.slopes[1], x, self.reach) - area
            };
            let (mut lo, mut hi) = (-self.reach, self.reach);
            for _ in 0..50 {
                let middle = (lo + hi) / 2.0;
                if excess(middle) > 0.0 { lo = middle } else { hi = middle }
            }
            along(*place, self.inward, lo)
        };
        self.places.iter().zip(&self.shares).map(one).collect()
    }
}

/// The middle of a line of another colour on a profile across it.
fn middle(image: &RgbImage, at: P, across: P, reach: f64) -> P {
    let steps = 200;
    let place = |k: usize| -reach + 2.0 * reach * (k as f64 + 0.5) / steps as f64;
    let values: Vec<[f64; 3]> = (0..steps).map(|k| light(image, along(at, across, place(k)))).collect();
    let (first, last) = (values[0], values[steps - 1]);
    let weight = |k: usize| {
        let t = k as f64 / (steps - 1) as f64;
        (0..3).map(|c| (values[k][c] - first[c] * (1.0 - t) - last[c] * t).powi(2)).sum::<f64>().sqrt()
    };
    let (sum, moment) = (0..steps).fold((0.0, 0.0), |(s, m), k| (s + weight(k), m + weight(k) * place(k)));
    along(at, across, moment / sum)
}

/// A calibrated lens: straight lines are straight only without it.
struct Lens {
    focal: f64,
    center: P,
    k1: f64,
}

impl Lens {
    fn of(record: &Record) -> Self {
        let [focal, _, cx, cy] = record.intrinsics.unwrap();
        Self { focal, center: [cx, cy], k1: record.distortion.map_or(0.0, |k| k[0]) }
    }

    fn bent(&self, p: P) -> P {
        let d = sub(p, self.center);
        let r2 = (d[0] * d[0] + d[1] * d[1]) / (self.focal * self.focal);
        along(self.center, d, 1.0 + self.k1 * r2)
    }

    fn straight(&self, p: P) -> P {
        (0..20).fold(p, |q, _| {
            let off = sub(p, self.bent(q));
            along(q, off, 1.0)
        })
    }
}

/// Corners and centre from the picture, looking near `guess`.
fn detect(image: &RgbImage, lens: &Lens, guess: [P; 4], reach: f64) -> ([P; 4], P) {
    let sides: Vec<(P, P)> = (0..4)
        .map(|k| {
            let (a, b) = (guess[k], guess[(k + 1) % 4]);
            let d = unit(sub(b, a));
            let inward = [-d[1], d[0]]; // clockwise corners: the inside lies to the right
            let length = sub(b, a)[0].hypot(sub(b, a)[1]);
            let places = (0..25).map(|i| along(a, d, length * (0.3 + 0.4 * f64::from(i) / 24.0))).collect();
            let points = Profiles::take(image, places, inward, reach).edges();
            fit(&points.into_iter().map(|p| lens.straight(p)).collect::<Vec<_>>())
        })
        .collect();
    let corners: [P; 4] = std::array::from_fn(|k| lens.bent(cross(sides[(k + 3) % 4], sides[k])));
    let side =
        sub(guess[0], guess[2])[0].hypot(sub(guess[0], guess[2])[1]).min(sub(guess[1], guess[3])[0].hypot(sub(guess[1], guess[3])[1]))
            / 1.4;
    let axis = |a: P, b: P, shares: &[f64]| {
        let d = unit(sub(b, a));
        let length = sub(b, a)[0].hypot(sub(b, a)[1]);
        fit(&shares
            .iter()
            .map(|s| middle(image, along(a, d, length * s), [-d[1], d[0]], side * 0.11))
            .map(|p| lens.straight(p))
            .collect::<Vec<_>>())
    };
    let diagonal = axis(corners[1], corners[3], &[0.2, 0.24, 0.28, 0.32, 0.68, 0.72, 0.76, 0.8]);
    let stem = axis(corners[0], corners[2], &[0.2, 0.22, 0.24, 0.26, 0.28, 0.3, 0.32]);
    (corners, lens.bent(cross(diagonal, stem)))
}

fn config(clean: bool) -> Config {
    let mut c = Config::default();
    c.markers.per_image = Dist::constant(1.0);
    c.markers.side_px = Dist::uniform(90.0, 200.0);
    c.markers.tilt_deg = if clean { Dist::uniform(0.0, 30.0) } else { Dist::uniform(0.0, 50.0) };
    c.markers.occlusion = Dist::constant(0.0);
    (c.markers.cut, c.markers.bent) = (0.0, 0.0);
    c.markers.margin = Dist::constant(0.5);
    c.markers.surfaces = [(Surface::White, 1.0)].into();
    c.markers.media = [(Medium::Print, 1.0)].into();
    c.markers.line_media = [(Medium::Print, 1.0)].into();
    // The relief of whatever lies below is noise to an edge.
    c.markers.blend = [(Blend::Matched, 1.0), (Blend::Sharp, 1.0), (Blend::Feathered, 1.0)].into();
    c.hand.line_width = Dist::uniform(0.06, 0.1);
    c.camera.motion_blur = if clean { Dist::constant(0.0) } else { Dist::uniform(0.0, 0.05) };
    c.camera.motion_curve = Dist::constant(0.0);
    c.camera.defocus_px = if clean { Dist::constant(0.0) } else { Dist::uniform(0.0, 2.0) };
    c.camera.softness_px = Dist::constant(0.5);
    if clean {
        c.camera.distortion = Dist::constant(0.0);
    }
    // No light is clipped: clipping would move every edge.
    c.camera.exposure_stops = Dist::constant(-1.0);
    c.camera.noise_percent = Dist::constant(0.0);
    (c.camera.shadows, c.camera.glare) = (0.0, 0.0);
    c.confusers.near_misses = Dist::constant(0.0);
    c.confusers.stickers = Dist::constant(0.0);
    c
}

struct Errors {
    corners: Vec<P>,
    /// Along the ray from the centre: positive is outside the truth.
    outward: Vec<f64>,
    centers: Vec<P>,
}

fn errors(config: &Config, images: u64, reach: f64) -> Errors {
    let mut out = Errors { corners: vec![], outward: vec![], centers: vec![] };
    for index in 0..images {
        let made = sample(config, &Backgrounds::embedded(), 11, index).unwrap();
        let Some(marker) = made.record.markers.first() else { continue };
        let (truth, center) = (marker.corners.unwrap().0, marker.center.unwrap());
        if truth.iter().any(|p| p.iter().any(|v| !(6.0..410.0).contains(v))) {
            continue;
        }
        let mut rng = Rng::for_item(0, "test/guess", index);
        let shift = [rng.uniform(-0.7, 0.7), rng.uniform(-0.7, 0.7)];
        let (found, middle) = detect(&made.image, &Lens::of(&made.record), truth.map(|p| [p[0] + shift[0], p[1] + shift[1]]), reach);
        for k in 0..4 {
            let e = sub(found[k], truth[k]);
            let ray = unit(sub(truth[k], center));
            out.corners.push(e);
            out.outward.push(e[0] * ray[0] + e[1] * ray[1]);
        }
        out.centers.push(sub(middle, center));
    }
    out
}

fn quantile(errors: &[P], q: f64) -> f64 {
    let mut lengths: Vec<f64> = errors.iter().map(|e| e[0].hypot(e[1])).collect();
    lengths.sort_by(f64::total_cmp);
    lengths[((lengths.len() - 1) as f64 * q) as usize]
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let v: Vec<f64> = values.collect();
    v.iter().sum::<f64>() / v.len() as f64
}

#[test]
fn clean_pictures_have_no_bias() {
    let e = errors(&config(true), 60, 6.0);
    assert!(e.centers.len() > 40);
    let bias = [mean(e.corners.iter().map(|p| p[0])), mean(e.corners.iter().map(|p| p[1])), mean(e.outward.iter().copied())];
    let center = [mean(e.centers.iter().map(|p| p[0])), mean(e.centers.iter().map(|p| p[1]))];
    eprintln!(
        "clean: corner bias {bias:.3?}, median {:.3}; centre bias {center:.3?}, median {:.3}",
        quantile(&e.corners, 0.5),
        quantile(&e.centers, 0.5)
    );
    assert!(bias.iter().chain(&center).all(|b| b.abs() < 0.05), "{bias:?} {center:?}");
}

#[test]
fn perspective_lens_and_blur_move_truth_and_picture_alike() {
    let e = errors(&config(false), 60, 14.0);
    let (c, m) = ([0.5, 0.95].map(|q| quantile(&e.corners, q)), [0.5, 0.95].map(|q| quantile(&e.centers, q)));
    eprintln!("perspective, lens, blur: corners median {:.3} p95 {:.3}, centre median {:.3} p95 {:.3}", c[0], c[1], m[0], m[1]);
    assert!(c[0] < 0.3 && c[1] < 1.0, "{c:?}");
    assert!(m[0] < 0.3 && m[1] < 1.0, "{m:?}");
}

#[test]
fn a_hands_corners_are_where_the_truth_says() {
    let mut config = config(true);
    config.markers.media = [(Medium::FeltTip, 1.0)].into();
    config.hand.hatched = 0.0;
    config.hand.outlined = 0.0;
    config.hand.corner_error = Dist::constant(0.05);
    let e = errors(&config, 40, 6.0);
    let c = [0.5, 0.95].map(|q| quantile(&e.corners, q));
    eprintln!("felt tip: corners median {:.3} p95 {:.3}", c[0], c[1]);
    assert!(c[0] < 0.3 && c[1] < 1.0, "{c:?}");
}

/// Whatever is drawn after a marker, sheets and what covers them included, leaves the pixels of its mask as they were: the truth is still true.
#[test]
fn a_later_marker_covers_no_earlier_one() {
    let mut config = Config { width: 320, height: 320, ..Config::default() };
    config.markers.side_px = Dist::uniform(30.0, 60.0);
    config.markers.margin = Dist::constant(0.6);
    config.markers.surfaces = [(Surface::White, 1.0)].into();
    config.markers.occlusion = Dist::constant(0.3);
    config.confusers.near_misses = Dist::constant(0.0);
    config.camera.noise_percent = Dist::constant(0.0);
    let backgrounds = Backgrounds::embedded();
    let mut several = 0;
    for index in 0..40 {
        let [one, many] = [1.0, 4.0].map(|count| {
            config.markers.per_image = Dist::constant(count);
            sample(&config, &backgrounds, 3, index).unwrap()
        });
        let (Some(marker), true) = (one.record.markers.first(), many.record.markers.len() > 1) else { continue };
        assert_eq!(marker.bounds, many.record.markers[0].bounds);
        several += 1;
        let mut at = 0;
        for run in marker.mask.as_ref().unwrap().chunks(2) {
            at += run[0];
            for pixel in at..at + run[1] {
                let (x, y) = (pixel % 320, pixel / 320);
                let (a, b) = (one.image.get_pixel(x, y), many.image.get_pixel(x, y));
                assert!(a.0.iter().zip(b.0).all(|(a, b)| a.abs_diff(b) <= 24), "image {index} at ({x}, {y}): {a:?} {b:?}");
            }
            at += run[1];
        }
    }
    assert!(several > 10, "{several}");
}
