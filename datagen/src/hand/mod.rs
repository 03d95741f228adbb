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
use serde_json::{Map, Value, json};
use tcross_dataset::{Confuser, Marker, Quad, Record, Rng, geom::quad};

pub mod drawing;
pub mod film;
pub mod ink;
mod marker;
mod photo;
pub mod video;
pub mod view;

use film::{Film, Light};
use marker::Spec;
use photo::PhotoLight;
use video::{Moment, Path};
use view::{Camera, View};

#[cfg(test)]
thread_local! {
    /// A fault for the audit's test: every marker's turn equals the direction of its tilt.
    pub(crate) static EQUAL_ANGLES: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

/// Draws the markers, confusers and effects of image `index` over its background and fills in the record. At a moment of a video the canvas is
/// what lies around the frame.
pub fn draw(mut canvas: Canvas, config: &Config, seed: u64, index: u64, moment: Option<Moment>, record: &mut Record) -> RgbImage {
    // What stays the same through a video is drawn once for all of its frames.
    let item = moment.map_or(index, |m| m.sequence);
    let stream = |purpose: &str| Rng::for_item(seed, &format!("datagen/{purpose}"), item);
    let (width, height) = (f64::from(config.width), f64::from(config.height));
    let mut count = stream("count");
    let wanted = config.markers.per_image.sample(&mut count).floor() as usize;
    let near_misses = config.confusers.near_misses.sample(&mut count).floor() as usize;
    let turn = moment.map(|m| m.sequence);
    note(record, "markers", wanted.into());
    note(record, "near_misses", near_misses.into());
    let specs: Vec<Spec> = (0..wanted + near_misses).map(|k| Spec::sample(config, k >= wanted, marker_seed(seed, item, k), turn)).collect();

    if let Some(first) = specs.get(wanted) {
        note(record, "near_miss", first.shape.name().into());
    }

    let (camera, field_of_view_deg) = sample_camera(config, &specs, stream("camera"));
    note(record, "field_of_view_deg", rounded(field_of_view_deg).into());
    record.intrinsics = Some([camera.focal, camera.focal, camera.center[0], camera.center[1]]);
    if camera.k1 != 0.0 {
        record.distortion = Some([camera.k1, 0.0]);
    }

    let mut clutter = stream("stickers");
    let stickers = config.confusers.stickers.sample(&mut clutter).floor() as usize;
    note(record, "stickers", stickers.into());
    for _ in 0..stickers {
        stickers::paint(&mut canvas, &mut clutter);
    }

    let path = moment.zip(specs.first()).and_then(|(moment, spec)| {
        let path = Path::sample(&config.video, &spec.stance, camera, [width, height], &mut stream("path"));
        let mut video = json!({ "sequence": moment.sequence, "frame": moment.frame, "time_s": rounded(moment.time_s) });
        for (key, value) in path.iter().flat_map(|p| p.drawn) {
            video[key] = rounded(value).into();
        }
        record.effects.insert("video".into(), video);
        Some((moment, path?))
    });
    let (mut taken, mut shown) = (Vec::new(), Vec::new());
    let motion = if let Some((moment, path)) = &path {
        canvas = path.warp(&canvas, config.width as usize, config.height as usize, moment.time_s);
        shown.push((&specs[0], path.view(moment.time_s)));
        Motion::of_camera(path.blur(moment.time_s))
    } else {
        for spec in &specs {
            let Some((view, outline)) = spec.place(&camera, width, height, &taken) else { continue };
            taken.push(outline);
            shown.push((spec, view));
        }
        let (fraction, motion) = Motion::sample(config, &specs, stream("motion"));
        record.effects.insert("motion_fraction".into(), rounded(fraction).into());
        motion
    };
    let light = PhotoLight::of(&canvas, &mut stream("light"), Rng::for_item(seed, "datagen/grain", index).bits());
    // No marker is sharper than the photo it stands in.
    let least = config.camera.softness_px.sample(&mut stream("softness"));
    let softness = least.max(f64::from(light.sharpness_px));
    note(record, "softness_px", rounded(least).into());
    record.effects.insert("softness_px".into(), rounded(softness).into());
    record.effects.insert("light".into(), light.parameters());
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
        if spec.near_miss {
            let bounds = <[f64; 4]>::from(truth.bounds).map(rounded).into();
            record.confusers.push(Confuser { shape: spec.shape.name().into(), bounds });
        } else {
            record.markers.extend(truth.into_marker(spec, view, width, height, motion.as_ref()));
        }
    }
    expose(&mut canvas, config, motion.as_ref(), &stream, Rng::for_item(seed, "datagen/noise", index), record);
    canvas.to_image()
}

/// The seed of marker `k`'s own streams.
fn marker_seed(seed: u64, index: u64, k: usize) -> u64 {
    // 53 bits, so that readers whose numbers are floating point keep it.
    Rng::for_item(seed, "datagen/marker", index * 64 + k as u64).bits() >> 11
}

/// Notes what was drawn from the config where the picture may have made something else of it.
fn note(record: &mut Record, key: &str, value: Value) {
    record.effects.entry("asked").or_insert_with(|| json!({}))[key] = value;
}

/// The camera, and the field of view that was drawn for it in degrees.
fn sample_camera(config: &Config, specs: &[Spec], mut rng: Rng) -> (Camera, f64) {
    let (width, height) = (f64::from(config.width), f64::from(config.height));
    let drawn = config.camera.field_of_view_deg.sample(&mut rng);
    let focal = width / 2.0 / libm::tan(drawn.to_radians() / 2.0);
    // A large, steep marker needs a longer lens to stand before the camera at all.
    let focal = specs.iter().map(|s| s.stance.least_focal()).fold(focal, f64::max);
    (Camera { focal, center: [width / 2.0, height / 2.0], k1: config.camera.distortion.sample(&mut rng) }, drawn)
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
    /// The blur of a moving camera: length in pixels, direction in radians, bend.
    fn of_camera((length, angle, curve): (f64, f64, f64)) -> Option<Self> {
        video::shutter((length, angle, curve)).map(|blur| Self { blur, length, camera_moves: true, angle, curve })
    }

    /// The fraction of the marker's side that was drawn, and the blur where it is long enough to be seen.
    fn sample(config: &Config, specs: &[Spec], mut rng: Rng) -> (f64, Option<Self>) {
        let c = &config.camera;
        let fraction = c.motion_blur.sample(&mut rng);
        let angle = c.motion_deg.sample(&mut rng).to_radians();
        let curve = c.motion_curve.sample(&mut rng);
        let camera_moves = rng.chance(c.camera_moves);
        // An image without a marker is blurred as if it had one.
        let other = config.markers.side_px.sample(&mut rng);
        let side = specs.first().map_or(other, |s| s.stance.side_px);
        let length = (fraction * side).min(c.motion_blur_max_px);
        let seen = (length > 0.3).then(|| Self { blur: Blur::motion(length, angle, curve), length, camera_moves, angle, curve });
        (fraction, seen)
    }
}

/// What was drawn where.
struct Truth {
    corners: Quad,
    center: [f64; 2],
    mask: Vec<(usize, usize, usize)>,
    bounds: tcross_dataset::PixelBox,
    covered: f64,
    glare: Option<([f32; 2], f32, f32)>,
    /// How the hand drew it, by name.
    hand: Map<String, Value>,
}

/// Draws one marker (or near miss) over the picture. `None` where nothing of it can be seen.
fn paint(canvas: &mut Canvas, spec: &Spec, view: &View, light: &PhotoLight, softness: f64, motion: Option<&Blur>) -> Option<Truth> {
    let size = (canvas.width, canvas.height);
    let look = spec.look(canvas, view);
    let softness = spec.blend.softness(softness);
    let pad = (softness * 3.0).ceil() as usize + motion.map_or(0, |m| m.reach) + 1;
    let mut film = Film::render(&look.layers(&spec.stance.half), view, size, pad, light)?;
    let corners = look.drawing.corners.map(|p| view.image_from_plane(p));
    let corners = Quad([corners[0]?, corners[1]?, corners[2]?, corners[3]?]);
    let center = view.image_from_plane(look.drawing.center)?;
    let occluder = spec.occluder(&corners);
    let (mask, bounds) = visible(&film, occluder.as_ref().map(|o| o.1.as_slice()))?;
    let (width, height) = (film.x.len(), film.y.len());
    // Most films let the same part of each colour through: none below a sheet, all beside it.
    let grey = film.planes[0] == film.planes[1] && film.planes[0] == film.planes[2];
    for plane in &mut film.planes[if grey { 2 } else { 0 }..] {
        effects::soften(plane, width, height, softness as f32);
        if let Some(blur) = motion {
            blur.apply(plane, width, height);
        }
    }
    if grey {
        (film.planes[0], film.planes[1]) = (film.planes[2].clone(), film.planes[2].clone());
    }
    spec.blend.lay(canvas, &film, light.grain, light.seed);
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
    Some(Truth { corners, center, mask, bounds, covered, glare: look.glare, hand: spec.hand(&look.drawing.habits) })
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
        marker.tilt_deg = Some(rounded(view.tilt().to_degrees()));
        marker.medium = Some(spec.medium.name().into());
        marker.surface = Some(spec.surface.name().into());
        marker.fill = Some(color::hex(spec.fill));
        marker.line = Some(color::hex(spec.line));
        marker.occlusion = Some(rounded(self.covered));
        marker.blend = Some(spec.blend.name().into());
        marker.bend = Some([rounded(spec.stance.bend.0), rounded(spec.stance.bend.1.to_degrees())]).filter(|b| b[0] != 0.0);
        marker.hand = self.hand;
        marker.asked = spec.asked();
        marker.glare = self.glare.map(|(at, radius, strength)| [at[0], at[1], radius, strength].map(|v| rounded(f64::from(v))));
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
fn expose(
    canvas: &mut Canvas,
    config: &Config,
    motion: Option<&Motion>,
    stream: &dyn Fn(&str) -> Rng,
    mut noise: Rng,
    record: &mut Record,
) {
    let c = &config.camera;
    let (width, height) = (canvas.width, canvas.height);
    let mut shadow = stream("shadow");
    if shadow.chance(c.shadows) {
        let shadow = effects::Shadow::sample(width, height, &mut shadow);
        shadow.cast(canvas);
        record.effects.insert("shadow".into(), shadow.parameters());
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
