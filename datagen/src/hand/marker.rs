//! One marker's choices: shape, size, stance, colours, medium, surface; each from its own stream.
use super::{
    drawing::{Drawing, Habits, Plan, Tally},
    film::{Layers, Tint, opacity_on},
    pick, rounded,
    view::{Camera, Stance, View, place},
};
use crate::{
    blend::Blend,
    canvas::Canvas,
    color::{self, Linear},
    config::{Config, HandConfig},
    media::Medium,
    shapes::Shape,
    surface::{Sheet, Surface},
};
use serde_json::{Map, Value, json};
use tcross_dataset::{Quad, Rng, geom::quad};

/// Everything chosen for one marker before it is seen.
#[derive(Debug)]
pub(super) struct Spec {
    pub(super) seed: u64,
    pub(super) near_miss: bool,
    pub(super) shape: Shape,
    pub(super) stance: Stance,
    pub(super) medium: Medium,
    pub(super) surface: Surface,
    pub(super) fill: Linear,
    pub(super) line: Linear,
    pub(super) blend: Blend,
    line_medium: Medium,
    /// The lines' medium as first drawn, before those that would not show on the fill were passed over.
    first_line_medium: Medium,
    /// The fill's hue in degrees, and its place in the config's list where there is one.
    hue: (f64, Option<usize>),
    bent: bool,
    sheet: Sheet,
    occlusion: f64,
    glare: bool,
    hand: HandConfig,
}

/// A drawing with its inks' colours and its sheet.
pub(super) struct Look<'a> {
    pub(super) drawing: Drawing,
    fill: Tint,
    line: Tint,
    sheet: &'a Sheet,
    pub(super) glare: Option<([f32; 2], f32, f32)>,
}

impl Look<'_> {
    pub(super) fn layers(&self, half: &[f64; 2]) -> Layers<'_> {
        Layers { drawing: &self.drawing, fill: &self.fill, line: &self.line, sheet: self.sheet, half: *half, glare: self.glare }
    }
}

impl Spec {
    /// `turn` says which of the configured hues it takes where they go in turn.
    pub(super) fn sample(config: &Config, near_miss: bool, seed: u64, turn: Option<u64>) -> Self {
        let stream = |purpose: &str| Rng::for_item(seed, &format!("datagen/marker/{purpose}"), 0);
        let m = &config.markers;
        let shapes = if near_miss { &config.confusers.shapes } else { &m.shapes };
        let shape = pick(shapes, Shape::TCross, &mut stream("shape"));
        let medium = pick(&m.media, Medium::FeltTip, &mut stream("medium"));
        let surface = pick(&m.surfaces, Surface::White, &mut stream("surface"));
        let sheet = Sheet::sample(surface, &m.margin, &mut stream("sheet"));
        let mut hues = stream("hue");
        let listed = match m.hues.len() {
            0 => None,
            n => Some(turn.map_or_else(|| hues.index(n), |k| (k % n as u64) as usize)),
        };
        let hue = listed.map(|k| m.hues[k] + hues.uniform(-6.0, 6.0));
        let Colors { fill, line, hue, line_medium, first_line_medium } = colors(config, medium, &sheet, hue, &mut stream("colors"));
        let aspect = m.aspect.sample(&mut stream("aspect")).sqrt();
        let mut bend = stream("bend");
        let bent = bend.chance(m.bent) && surface.is_paper();
        let stance = Stance {
            side_px: m.side_px.sample(&mut stream("side")),
            tilt: m.tilt_deg.sample(&mut stream("tilt")).to_radians(),
            azimuth: stream("azimuth").uniform(0.0, std::f64::consts::TAU),
            roll: m.roll_deg.sample(&mut stream("roll")).to_radians(),
            half: [0.5 * aspect, 0.5 / aspect],
            bend: (if bent { m.bend.sample(&mut bend) } else { 0.0 }, bend.uniform(0.0, std::f64::consts::PI)),
            may_be_cut: stream("cut").chance(m.cut),
        };
        #[cfg(test)]
        let stance = Stance { roll: if super::EQUAL_ANGLES.get() { stance.azimuth } else { stance.roll }, ..stance };
        Self {
            seed,
            near_miss,
            shape,
            stance,
            medium,
            surface,
            fill,
            line,
            blend: pick(&m.blend, Blend::Matched, &mut stream("blend")),
            line_medium,
            first_line_medium,
            hue: (hue, listed),
            bent,
            sheet,
            occlusion: m.occlusion.sample(&mut stream("occlusion")),
            glare: stream("glare").chance(config.camera.glare),
            hand: config.hand.clone(),
        }
    }

    /// A place where it hides no other much; the first marker always finds one.
    pub(super) fn place(&self, camera: &Camera, width: f64, height: f64, taken: &[Quad]) -> Option<(View, Quad)> {
        for attempt in 0..12 {
            let mut rng = Rng::for_item(self.seed, "datagen/marker/place", attempt);
            let (view, outline) = place(&self.stance, camera, width, height, &mut rng)?;
            let grown = grow(&outline, 1.5);
            let cover = self.cover(&view, &outline);
            let free = taken.iter().all(|other| {
                let common = quad::polygon_area(&quad::clip_convex(&grow(other, 1.5).0, &grown.0)).abs();
                let ink = grow(other, 1.15);
                common < 0.02 * other.signed_area().abs().min(outline.signed_area().abs())
                    && cover.iter().all(|c| quad::polygon_area(&quad::clip_convex(c, &ink.0)).abs() < 1e-3 * other.signed_area().abs())
            });
            if free {
                return Some((view, outline));
            }
        }
        None
    }

    /// What it lays over the picture besides ink: the outlines of its sheet and of what covers it. None of them may lie on another's ink,
    /// which is in the truth already. (Near misses are painted before all markers.)
    fn cover(&self, view: &View, outline: &Quad) -> Vec<Vec<[f64; 2]>> {
        if self.near_miss {
            return Vec::new();
        }
        let [w, h] = self.stance.half;
        let sheet = self.sheet.margins.map(|margins| {
            let [left, top, right, bottom] = margins.map(f64::from);
            let corners = [[-w - left, -h - top], [w + right, -h - top], [w + right, h + bottom], [-w - left, h + bottom]];
            let seen: Option<Vec<_>> = corners.into_iter().map(|p| view.image_from_plane(p)).collect();
            seen.unwrap_or_else(|| grow(outline, 3.0).0.to_vec())
        });
        let before = self.occluder(outline).map(|(_, o)| o.iter().map(|p| p.map(f64::from)).collect());
        sheet.into_iter().chain(before).collect()
    }

    /// Draws it, in colours that show on what is behind it.
    pub(super) fn look(&self, canvas: &Canvas, view: &View) -> Look<'_> {
        let mut rng = Rng::for_item(self.seed, "datagen/marker/look", 0);
        let [w, h] = self.stance.half;
        // A cell a pixel where the sheet is nearest, between the direction in which it is seen straight and the one in which it is foreshortened.
        let cells = |p| view.scales(p).map(|(largest, smallest)| (largest + smallest) / 2.0);
        let scale = [[0.0, 0.0], [-w, -h], [w, -h], [w, h], [-w, h]].into_iter().filter_map(cells).fold(8.0, f64::max);
        let (fill, line) = (self.medium.nature(), self.line_medium.nature());
        let plan = Plan { shape: self.shape, half: self.stance.half, fill: &fill, line: &line, scale: scale.clamp(40.0, 640.0) as f32 };
        let drawing = plan.draw(&self.hand, Rng::for_item(self.seed, "datagen/marker/hand", 0));
        let below = if self.surface == Surface::Photo { brightness_at(canvas, view) } else { color::luminance(self.sheet.base) };
        let glare = self.glare.then(|| {
            let spot = [rng.uniform(-0.6, 0.6) as f32, rng.uniform(-0.6, 0.6) as f32];
            (spot, rng.uniform(0.2, 0.9) as f32, rng.uniform(0.15, 0.8) as f32)
        });
        let solid = self.shape.geometry().filled;
        Look {
            drawing,
            fill: Tint::new(self.fill, &fill, opacity_on(&fill, below)),
            line: Tint::new(self.line, &line, opacity_on(&line, if solid { color::luminance(self.fill) * below.max(0.3) } else { below })),
            sheet: &self.sheet,
            glare,
        }
    }

    /// How it was drawn, for the record.
    pub(super) fn hand(&self, habits: &Habits) -> Map<String, Value> {
        let [w, h] = self.stance.half;
        let tally = |t: Tally| (t.all > 0).then(|| json!([t.some, t.all]));
        named([
            ("aspect", number(w / h)),
            ("wobble", number(habits.wobble)),
            ("corner_error", number(habits.corner_error)),
            ("end_error", number(habits.end_error)),
            ("line_medium", Some(self.line_medium.name().into())),
            ("line_width", number(habits.line_width)),
            ("hatched", number(f64::from(u8::from(habits.hatched)))),
            ("hatch_spacing", habits.hatch.and_then(|h| number(h[0]))),
            ("hatch_deg", habits.hatch.and_then(|h| number(h[1]))),
            ("outlined", habits.outlined.and_then(|o| number(f64::from(u8::from(o))))),
            ("retraced", tally(habits.lines)),
            ("gaps", tally(habits.strokes)),
        ])
    }

    /// What was drawn for it from the config and cannot be read from the other keys of the record, or not in every case.
    pub(super) fn asked(&self) -> Map<String, Value> {
        let s = &self.stance;
        named([
            ("side_px", number(s.side_px)),
            ("tilt_deg", number(s.tilt.to_degrees())),
            ("azimuth_deg", number(s.azimuth.to_degrees())),
            ("roll_deg", number(s.roll.to_degrees())),
            ("cut", Some(s.may_be_cut.into())),
            ("bent", self.surface.is_paper().then_some(self.bent.into())),
            ("margin", self.sheet.margin.and_then(number)),
            ("hue_deg", number(self.hue.0)),
            ("hue", self.hue.1.map(Into::into)),
            ("line_medium", Some(self.first_line_medium.name().into())),
        ])
    }

    /// What covers it: the covered share of its quadrilateral, and an outline that covers everything on one side of a line.
    pub(super) fn occluder(&self, corners: &Quad) -> Option<(f64, Vec<[f32; 2]>)> {
        if self.occlusion <= 0.0 || self.near_miss {
            return None;
        }
        let mut rng = Rng::for_item(self.seed, "datagen/occluder", 0);
        let angle = rng.uniform(0.0, std::f64::consts::TAU);
        let (n, along) = ([libm::cos(angle), libm::sin(angle)], [-libm::sin(angle), libm::cos(angle)]);
        let area = corners.signed_area().abs();
        let depth = |p: &[f64; 2]| p[0] * n[0] + p[1] * n[1];
        let side = |p: &[f64; 2]| p[0] * along[0] + p[1] * along[1];
        let reach = |f: &dyn Fn(&[f64; 2]) -> f64| {
            corners.0.iter().map(f).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
        };
        let ((near, far), (left, right)) = (reach(&depth), reach(&side));
        let (wide, deep) = ((right - left) * rng.uniform(0.1, 0.5) + 2.0, (far - near) * rng.uniform(0.1, 0.6) + 2.0);
        let outline = |at: f64| {
            let point = |d: f64, s: f64| [n[0] * d + along[0] * s, n[1] * d + along[1] * s];
            [point(at, left - wide), point(far + deep, left - wide), point(far + deep, right + wide), point(at, right + wide)]
        };
        let covered = |at: f64| {
            let mut clip = outline(at).to_vec();
            if quad::polygon_area(&clip) < 0.0 {
                clip.reverse();
            }
            quad::polygon_area(&quad::clip_convex(&corners.0, &clip)).abs() / area
        };
        // Bisection: less is covered the farther the line stands.
        let (mut lo, mut hi) = (near, far);
        for _ in 0..40 {
            let middle = (lo + hi) / 2.0;
            if covered(middle) > self.occlusion { lo = middle } else { hi = middle }
        }
        Some((covered(lo), outline(lo).iter().map(|p| p.map(|v| v as f32)).collect()))
    }
}

/// A number of the record.
fn number(v: f64) -> Option<Value> {
    Some(rounded(v).into())
}

/// What there is, by name.
fn named<const N: usize>(all: [(&str, Option<Value>); N]) -> Map<String, Value> {
    all.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?))).collect()
}

/// A quadrilateral scaled about the mean of its corners.
fn grow(q: &Quad, by: f64) -> Quad {
    let middle: [f64; 2] = std::array::from_fn(|k| q.0.iter().map(|p| p[k]).sum::<f64>() / 4.0);
    Quad(q.0.map(|p| std::array::from_fn(|k| middle[k] + (p[k] - middle[k]) * by)))
}

/// How bright the picture is where a marker is to stand.
fn brightness_at(canvas: &Canvas, view: &View) -> f32 {
    let Some([x, y]) = view.image_from_plane([0.0, 0.0]) else { return 0.5 };
    let around = |v: f64, limit: usize| {
        let at = (v.max(0.0) as usize).min(limit - 1);
        at.saturating_sub(12)..(at + 12).min(limit)
    };
    color::luminance(canvas.mean(around(x, canvas.width), around(y, canvas.height)))
}

/// What a marker's colours are, and what was drawn on the way to them.
struct Colors {
    fill: Linear,
    line: Linear,
    hue: f64,
    line_medium: Medium,
    first_line_medium: Medium,
}

/// A saturated fill and lines that differ from it: dark, light, or of another hue.
fn colors(config: &Config, medium: Medium, sheet: &Sheet, hue: Option<f64>, rng: &mut Rng) -> Colors {
    let nature = medium.nature();
    let paper = color::luminance(sheet.base);
    let any = rng.uniform(0.0, 360.0);
    let hue = hue.unwrap_or(any);
    let mut fill =
        color::from_hsv(hue, rng.uniform(nature.saturation[0], nature.saturation[1]), rng.uniform(nature.value[0], nature.value[1]));
    if paper < 0.15 {
        // On a board only light colours show.
        fill = color::from_hsv(hue, rng.uniform(0.4, 0.9), rng.uniform(0.75, 1.0));
    }
    let mut first = None;
    for _ in 0..16 {
        let line_medium = pick(&config.markers.line_media, Medium::FeltTip, rng);
        let first_line_medium = *first.get_or_insert(line_medium);
        let pen = line_medium.nature();
        let turn = rng.uniform(70.0, 290.0);
        let line = match rng.index(4) {
            0 => color::from_hsv(rng.uniform(0.0, 360.0), rng.uniform(0.0, 0.5), rng.uniform(0.02, 0.2)),
            1 if pen.opacity > 0.5 => color::from_hsv(rng.uniform(0.0, 360.0), rng.uniform(0.0, 0.2), rng.uniform(0.85, 1.0)),
            _ => color::from_hsv(hue + turn, rng.uniform(0.6, 1.0), rng.uniform(pen.value[0], pen.value[1])),
        };
        // What is seen: a translucent ink mixes with the fill below it.
        let seen: Linear = std::array::from_fn(|k| line[k] * pen.opacity + line[k] * fill[k] * (1.0 - pen.opacity));
        let distance: f32 = (0..3).map(|k| (libm::sqrtf(seen[k]) - libm::sqrtf(fill[k])).powi(2)).sum();
        if distance > 0.12 {
            return Colors { fill, line, hue, line_medium, first_line_medium };
        }
    }
    let line = if color::luminance(fill) > 0.18 { [0.01; 3] } else { [0.9; 3] };
    Colors { fill, line, hue, line_medium: Medium::Paint, first_line_medium: first.unwrap_or(Medium::Paint) }
}
