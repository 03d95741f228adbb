//! The hand-drawn style: markers drawn by a hand on some surface, seen by a camera, with exact truth.
//!
//! Everything is drawn in linear light. Each purpose has its own stream of chance, keyed by the image (and the marker), so that no effect
//! shifts the draws of another.
use crate::{
    background::embedded::{Material, fill},
    canvas::Canvas,
    color,
    config::{self, Config},
    effects::{self, Blur},
    stickers,
};
use image::RgbImage;
use serde_json::json;
use tcross_dataset::{Marker, Quad, Record, Rng, geom::quad};

pub mod drawing;
pub mod film;
pub mod ink;
mod marker;
pub mod view;

use film::{Film, Light};
use marker::Spec;
use view::{Camera, View};

/// Draws the markers, confusers and effects of image `index` over its background and fills in the record.
pub fn draw(mut canvas: Canvas, config: &Config, seed: u64, index: u64, record: &mut Record) -> RgbImage {
    let stream = |purpose: &str| Rng::for_item(seed, &format!("datagen/{purpose}"), index);
    let (width, height) = (f64::from(config.width), f64::from(config.height));
    let mut count = stream("count");
    let wanted = config.markers.per_image.sample(&mut count).floor() as usize;
    let near_misses = config.confusers.near_misses.sample(&mut count).floor() as usize;
    let specs: Vec<Spec> = (0..wanted + near_misses).map(|k| Spec::sample(config, k >= wanted, marker_seed(seed, index, k))).collect();

    let camera = sample_camera(config, &specs, stream("camera"));
    record.intrinsics = Some([camera.focal, camera.focal, camera.center[0], camera.center[1]]);
    if camera.k1 != 0.0 {
        record.distortion = Some([camera.k1, 0.0]);
    }

    let mut clutter = stream("stickers");
    for _ in 0..config.confusers.stickers.sample(&mut clutter).floor() as usize {
        stickers::paint(&mut canvas, &mut clutter);
    }

    let motion = Motion::sample(config, &specs, stream("motion"));
    let light = PhotoLight::of(&canvas, &mut stream("light"));
    let softness = config.camera.softness_px.sample(&mut stream("softness"));
    let mut taken: Vec<Quad> = Vec::new();
    let mut shown = Vec::new();
    for spec in &specs {
        let Some((view, outline)) = spec.place(&camera, width, height, &taken) else { continue };
        taken.push(outline);
        shown.push((spec, view));
    }
    // Near misses first, so that none hides a marker.
    let mut truths: Vec<(usize, Truth)> = Vec::new();
    for pass in [true, false] {
        for (k, (spec, view)) in shown.iter().enumerate().filter(|(_, (spec, _))| spec.near_miss == pass) {
            let blur = motion.as_ref().filter(|m| !m.camera_moves).map(|m| &m.blur);
            if let Some(truth) = paint(&mut canvas, spec, view, &light, softness, blur) {
                truths.push((k, truth));
            }
        }
    }
    for (k, truth) in truths {
        let (spec, view) = &shown[k];
        if !spec.near_miss {
            record.markers.extend(truth.into_marker(spec, view, width, height, motion.as_ref()));
        }
    }
    expose(&mut canvas, config, motion.as_ref(), &stream, record);
    canvas.to_image()
}

/// The seed of marker `k`'s own streams.
fn marker_seed(seed: u64, index: u64, k: usize) -> u64 {
    // 53 bits, so that readers whose numbers are floating point keep it.
    Rng::for_item(seed, "datagen/marker", index * 64 + k as u64).bits() >> 11
}

fn sample_camera(config: &Config, specs: &[Spec], mut rng: Rng) -> Camera {
    let (width, height) = (f64::from(config.width), f64::from(config.height));
    let half_angle = config.camera.field_of_view_deg.sample(&mut rng).to_radians() / 2.0;
    let focal = width / 2.0 / libm::tan(half_angle);
    // A large, steep marker needs a longer lens to stand before the camera at all.
    let focal = specs.iter().map(|s| s.stance.least_focal()).fold(focal, f64::max);
    Camera { focal, center: [width / 2.0, height / 2.0], k1: config.camera.distortion.sample(&mut rng) }
}

/// One motion blur for the image.
struct Motion {
    blur: Blur,
    length: f64,
    camera_moves: bool,
    angle: f64,
    curve: f64,
}

impl Motion {
    fn sample(config: &Config, specs: &[Spec], mut rng: Rng) -> Option<Self> {
        let c = &config.camera;
        let fraction = c.motion_blur.sample(&mut rng);
        let angle = c.motion_deg.sample(&mut rng).to_radians();
        let curve = c.motion_curve.sample(&mut rng);
        let camera_moves = rng.chance(c.camera_moves);
        // An image without a marker is blurred as if it had one.
        let other = config.markers.side_px.sample(&mut rng);
        let side = specs.first().map_or(other, |s| s.stance.side_px);
        let length = (fraction * side).min(c.motion_blur_max_px);
        (length > 0.3).then(|| Self { blur: Blur::motion(length, angle, curve), length, camera_moves, angle, curve })
    }
}

/// The light that falls on a sheet, taken from the photo: its level, its colour, its slopes.
struct PhotoLight {
    columns: usize,
    levels: Vec<f32>,
    tone: color::Linear,
    grain: f32,
    seed: u64,
}

/// Pixels a cell of the light.
const LIGHT_CELL: usize = 32;

impl PhotoLight {
    fn of(canvas: &Canvas, rng: &mut Rng) -> Self {
        // Every fourth pixel of every fourth row tells enough of the light: sums over cells, then over each cell and its neighbours.
        let (columns, rows) = (canvas.width.div_ceil(LIGHT_CELL) + 1, canvas.height.div_ceil(LIGHT_CELL) + 1);
        let mut sums = vec![([0f32; 3], 0f32); columns * rows];
        for y in (0..canvas.height).step_by(4) {
            for x in (0..canvas.width).step_by(4) {
                let (sum, count) = &mut sums[y / LIGHT_CELL * columns + x / LIGHT_CELL];
                let pixel = canvas.at(x, y);
                (0..3).for_each(|c| sum[c] += pixel[c]);
                *count += 1.0;
            }
        }
        let mean_of = |cells: &mut dyn Iterator<Item = usize>| {
            let (sum, count) = cells.fold(([0f32; 3], 0f32), |(sum, n), k| (std::array::from_fn(|c| sum[c] + sums[k].0[c]), n + sums[k].1));
            (count > 0.0).then(|| color::scaled(sum, 1.0 / count))
        };
        let mean = mean_of(&mut (0..sums.len())).unwrap_or([0.2; 3]);
        let level = color::luminance(mean).max(0.01);
        let follow = rng.uniform(0.1, 0.6);
        let strength = ((f64::from(level) * 1.7 + 0.12) * rng.uniform(0.75, 1.25)).clamp(0.08, 1.05);
        let at = |i: usize, j: usize| {
            let around = |k: usize, n: usize| k.saturating_sub(1)..(k + 1).min(n);
            let near = mean_of(&mut around(j, rows).flat_map(|j| around(i, columns).map(move |i| j * columns + i)));
            let local = near.map_or(level, color::luminance).max(0.005);
            (strength * libm::pow(f64::from(local / level), follow).clamp(0.35, 1.6)) as f32
        };
        let levels = (0..columns * rows).map(|k| at(k % columns, k / columns)).collect();
        let tint = rng.uniform(0.0, 0.5);
        let tone = mean.map(|v| libm::pow(f64::from(v / level).clamp(0.5, 1.6), tint) as f32);
        Self { columns, levels, tone, grain: grain_of(canvas), seed: rng.bits() }
    }
}

impl Light for PhotoLight {
    fn level(&self, x: f32, y: f32) -> f32 {
        let (x, y) = (x / LIGHT_CELL as f32, y / LIGHT_CELL as f32);
        let (i, j) = (x as usize, y as usize);
        let (u, v) = (x - i as f32, y - j as f32);
        let last = self.levels.len() - 1;
        let at = |i: usize, j: usize| self.levels[(j * self.columns + i).min(last)];
        let top = at(i, j) + (at(i + 1, j) - at(i, j)) * u;
        let bottom = at(i, j + 1) + (at(i + 1, j + 1) - at(i, j + 1)) * u;
        top + (bottom - top) * v
    }

    fn tone(&self) -> color::Linear {
        self.tone
    }
}

/// The photo's own noise: the median difference between neighbours, as a deviation in linear light; fine texture counts too, so it is
/// kept small.
fn grain_of(canvas: &Canvas) -> f32 {
    let plane = &canvas.planes[1];
    let mut steps: Vec<f32> =
        plane.chunks_exact(canvas.width).step_by(7).flat_map(|row| row.windows(2).step_by(5).map(|w| (w[1] - w[0]).abs())).collect();
    steps.sort_by(f32::total_cmp);
    steps.get(steps.len() / 2).map_or(0.0, |m| (m * 0.75).min(0.015))
}

/// What was drawn where.
struct Truth {
    corners: Quad,
    center: [f64; 2],
    mask: Vec<(usize, usize, usize)>,
    bounds: tcross_dataset::PixelBox,
    covered: f64,
}

/// Draws one marker (or near miss) over the picture. `None` where nothing of it can be seen.
fn paint(canvas: &mut Canvas, spec: &Spec, view: &View, light: &PhotoLight, softness: f64, motion: Option<&Blur>) -> Option<Truth> {
    let size = (canvas.width, canvas.height);
    let look = spec.look(canvas, view);
    let pad = (softness * 3.0).ceil() as usize + motion.map_or(0, |m| m.reach) + 1;
    let mut film = Film::render(&look.layers(&spec.stance.half), view, size, pad, light)?;
    let corners = look.drawing.corners.map(|p| view.image_from_plane(p));
    let corners = Quad([corners[0]?, corners[1]?, corners[2]?, corners[3]?]);
    let center = view.image_from_plane(look.drawing.center)?;
    let occluder = spec.occluder(&corners);
    let (mask, bounds) = visible(&film, occluder.as_ref().map(|o| o.1.as_slice()))?;
    let (width, height) = (film.x.len(), film.y.len());
    for plane in &mut film.planes {
        effects::soften(plane, width, height, softness as f32);
        if let Some(blur) = motion {
            blur.apply(plane, width, height);
        }
    }
    lay(canvas, &film, light);
    if let Some((_, outline)) = &occluder {
        let mut rng = Rng::for_item(spec.seed, "datagen/occluder", 1);
        let material = match rng.index(3) {
            0 => Material::of(color::from_hsv(rng.uniform(10.0, 35.0), rng.uniform(0.25, 0.6), rng.uniform(0.4, 0.95)), &mut rng).plain(),
            1 => Material::saturated(&mut rng),
            _ => Material::muted(&mut rng),
        };
        fill(canvas, outline, |x, y| {
            let (color, tone, level) = (material.at(x, y), light.tone(), light.level(x, y));
            (std::array::from_fn(|k| color[k] * tone[k] * level), 1.0)
        });
    }
    let covered = occluder.map_or(0.0, |o| o.0);
    Some(Truth { corners, center, mask, bounds, covered })
}

/// Lays a film over the picture; what it adds gets the photo's grain.
fn lay(canvas: &mut Canvas, film: &Film, light: &PhotoLight) {
    let normals = crate::noise::normals();
    let width = film.x.len();
    let mut rng = Rng::for_item(light.seed, "datagen/film-grain", film.y.start as u64 * 65_536 + film.x.start as u64);
    for (j, y) in film.y.clone().enumerate() {
        let start = (rng.bits() & 0x7fff) as usize;
        for c in 0..3 {
            let row = &mut canvas.planes[c][y * canvas.width + film.x.start..][..width];
            let (through, own) = (&film.planes[c][j * width..][..width], &film.planes[3 + c][j * width..][..width]);
            let grain = &normals[start + c * 64..][..width.min(1 << 15)];
            for (((v, t), o), n) in row.iter_mut().zip(through).zip(own).zip(grain) {
                *v = *v * t + o * (1.0 + 0.5 * light.grain) + light.grain * n * (1.0 - t);
            }
        }
    }
}

/// The pixels that show the marker, as runs (row, first, end), and the box of all ink that is in the image and not covered.
fn visible(film: &Film, occluder: Option<&[[f32; 2]]>) -> Option<(Vec<(usize, usize, usize)>, tcross_dataset::PixelBox)> {
    let width = film.x.len();
    let hidden = |x: usize, y: usize| occluder.is_some_and(|o| contains(o, [x as f32 + 0.5, y as f32 + 0.5]));
    let mut runs: Vec<(usize, usize, usize)> = Vec::new();
    let (mut columns, mut rows) = (vec![0f32; width], vec![0f32; film.y.len()]);
    for (j, y) in film.y.clone().enumerate() {
        for (i, x) in film.x.clone().enumerate() {
            let ink = film.ink[j * width + i];
            if ink <= 0.02 || hidden(x, y) {
                continue;
            }
            columns[i] = columns[i].max(ink);
            rows[j] = rows[j].max(ink);
            if ink >= 0.5 {
                match runs.last_mut() {
                    Some(run) if run.0 == y && run.2 == x => run.2 += 1,
                    _ => runs.push((y, x, x + 1)),
                }
            }
        }
    }
    // A border pixel that is covered in part counts by that part.
    let ends = |strengths: &[f32], start: usize| {
        let first = strengths.iter().position(|s| *s > 0.05)?;
        let last = strengths.iter().rposition(|s| *s > 0.05)?;
        Some(((start + first + 1) as f64 - f64::from(strengths[first]), (start + last) as f64 + f64::from(strengths[last])))
    };
    let ((x_min, x_max), (y_min, y_max)) = (ends(&columns, film.x.start)?, ends(&rows, film.y.start)?);
    Some((runs, [x_min, y_min, x_max, y_max].into()))
}

/// Even-odd test.
fn contains(outline: &[[f32; 2]], p: [f32; 2]) -> bool {
    let mut inside = false;
    for k in 0..outline.len() {
        let (a, b) = (outline[k], outline[(k + 1) % outline.len()]);
        if (a[1] <= p[1]) != (b[1] <= p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) {
            inside = !inside;
        }
    }
    inside
}

/// To a ten-thousandth: finer than any picture shows, and shorter on disk.
fn rounded(v: f64) -> f64 {
    (v * 1e4).round() / 1e4
}

impl Truth {
    fn into_marker(self, spec: &Spec, view: &View, width: f64, height: f64, motion: Option<&Motion>) -> Option<Marker> {
        let [x0, y0, x1, y1] = <[f64; 4]>::from(self.bounds).map(rounded);
        let mut marker = Marker::from_box(spec.shape.name(), [x0, y0, x1, y1].into());
        let corners = self.corners.0.map(|p| p.map(rounded));
        let center = self.center.map(rounded);
        let frame = [[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]];
        let inside = quad::polygon_area(&quad::clip_convex(&corners, &frame)).abs() / quad::polygon_area(&corners).abs().max(1e-9);
        let geometry = spec.shape.geometry();
        if geometry.oriented {
            marker.angle = Some(rounded(quad::angle_deg(corners[0][0] - center[0], corners[0][1] - center[1])));
            marker.stem = Some(0);
        }
        marker.homography = tcross_dataset::Homography::from_unit_square(&corners);
        marker.visible = Some(rounded((inside * (1.0 - self.covered)).clamp(0.0, 1.0)));
        marker.corners = Some(Quad(corners));
        marker.center = Some(center);
        marker.blur_px = Some(rounded(motion.map_or(0.0, |m| m.length)));
        marker.tilt_deg = Some(rounded(spec.stance.tilt.to_degrees()));
        marker.medium = Some(spec.medium.name().into());
        marker.surface = Some(spec.surface.name().into());
        marker.fill = Some(color::hex(spec.fill));
        marker.line = Some(color::hex(spec.line));
        marker.occlusion = Some(rounded(self.covered));
        marker.rotation = Some(view.pose.rotation);
        marker.translation = Some(view.pose.translation);
        let mut mask = Vec::with_capacity(self.mask.len() * 2);
        let mut at = 0;
        for (y, from, to) in self.mask {
            let start = y * width as usize + from;
            mask.extend([(start - at) as u32, (to - from) as u32]);
            at = start + to - from;
        }
        marker.mask = Some(mask);
        marker.seed = Some(spec.seed);
        Some(marker)
    }
}

/// What the camera does to the whole picture, in the order in which light meets it.
fn expose(canvas: &mut Canvas, config: &Config, motion: Option<&Motion>, stream: &dyn Fn(&str) -> Rng, record: &mut Record) {
    let c = &config.camera;
    let (width, height) = (canvas.width, canvas.height);
    let mut shadow = stream("shadow");
    if shadow.chance(c.shadows) {
        effects::shadow(canvas, &mut shadow);
        record.effects.insert("shadow".into(), true.into());
    }
    let defocus = c.defocus_px.sample(&mut stream("defocus"));
    for plane in &mut canvas.planes {
        // A disc of radius r has the deviation r/2.
        effects::soften(plane, width, height, (defocus / 2.0) as f32);
        if let Some(m) = motion.filter(|m| m.camera_moves) {
            m.blur.apply(plane, width, height);
        }
    }
    let (exposure, balance) = (c.exposure_stops.sample(&mut stream("exposure")), c.white_balance_stops.sample(&mut stream("balance")));
    canvas.gain(effects::gains(exposure, balance));
    let mut noise = stream("noise");
    let percent = c.noise_percent.sample(&mut noise);
    if percent > 0.0 {
        effects::sensor_noise(canvas, percent, &mut noise);
    }
    for marker in &mut record.markers {
        marker.defocus_px = Some(rounded(defocus));
    }
    if let Some(m) = motion {
        record.effects.insert(
            "motion".into(),
            json!({ "length_px": rounded(m.length), "angle_deg": rounded(m.angle.to_degrees()), "curve": rounded(m.curve), "camera": m.camera_moves }),
        );
    }
    for (key, value) in
        [("defocus_px", defocus), ("exposure_stops", exposure), ("white_balance_stops", balance), ("noise_percent", percent)]
    {
        record.effects.insert(key.into(), rounded(value).into());
    }
}

/// One of the configured names, or the first of all where none has a weight.
fn pick<T: Copy>(weights: &config::Weights<T>, default: T, rng: &mut Rng) -> T {
    config::choose(weights, rng).unwrap_or(default)
}
