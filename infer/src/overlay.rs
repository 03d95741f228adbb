//! Detections drawn on their picture: boxes, scores, corners, the orientation's arrow; a picture laid onto the marker; a cube.
use crate::{
    camera::{Camera, Lens},
    config::Config,
    lettering,
    run::RunOptions,
};
use image::{Rgb, RgbImage};
use nalgebra::{Matrix3, Vector3};
use tcross_dataset::{Detection, PixelBox, Pose, PoseOutcome};
use tiny_skia::{Color, FillRule, LineCap, Paint, Path, PathBuilder, Pixmap, Rect, Stroke, Transform};

/// Draws everything of one picture that scores at least `config.overlay_score`.
#[must_use]
pub fn draw(image: &RgbImage, found: &[Detection], config: &Config, options: &RunOptions, replacement: Option<&RgbImage>) -> RgbImage {
    let mut picture = image.clone();
    let shown: Vec<&Detection> = found.iter().filter(|d| d.score >= config.overlay_score).collect();
    let poses = || shown.iter().filter_map(|d| if let Some(PoseOutcome::Found(pose)) = &d.pose { Some(&**pose) } else { None });
    if let Some(replacement) = replacement {
        for pose in poses() {
            replace(&mut picture, pose, replacement);
        }
    }
    let Some(mut canvas) = Canvas::new(&picture) else { return picture };
    if options.cube {
        let camera = options.camera.unwrap_or(Lens::FieldOfView(60.0)).camera(picture.width(), picture.height());
        poses().for_each(|pose| canvas.cube(pose, &camera));
    }
    for detection in shown {
        canvas.detection(detection, options.name_of(detection), replacement.is_some() || options.cube);
    }
    canvas.onto(&mut picture);
    picture
}

/// Lays a picture onto the marker with the marker's perspective; the picture's upper left corner goes to the stem's.
pub fn replace(image: &mut RgbImage, pose: &Pose, picture: &RgbImage) {
    let Some(back) = pose.homography.inverse() else { return };
    let b = pose.corners.bounds().clipped(f64::from(image.width()), f64::from(image.height()));
    if !b.is_valid() || picture.width() == 0 || picture.height() == 0 {
        return;
    }
    let (w, h) = (f64::from(picture.width()), f64::from(picture.height()));
    // Enough samples a pixel that a large picture on a small marker does not shimmer.
    let shrink = (w.max(h) / pose.corners.side_px().max(1.0)).ceil();
    let n = shrink.clamp(2.0, 6.0) as u32;
    for y in b.y_min.floor() as u32..(b.y_max.ceil() as u32).min(image.height()) {
        for x in b.x_min.floor() as u32..(b.x_max.ceil() as u32).min(image.width()) {
            let (mut sum, mut hits) = ([0.0f64; 3], 0.0);
            for s in 0..n * n {
                let at = |v: u32, k: u32| f64::from(v) + (f64::from(k) + 0.5) / f64::from(n);
                let [u, v] = back.apply([at(x, s % n), at(y, s / n)]);
                if (0.0..1.0).contains(&u) && (0.0..1.0).contains(&v) {
                    let c = picture.get_pixel((u * w) as u32, (v * h) as u32);
                    (0..3).for_each(|k| sum[k] += f64::from(c[k]));
                    hits += 1.0;
                }
            }
            if hits > 0.0 {
                let share = hits / f64::from(n * n);
                let below = *image.get_pixel(x, y);
                let mixed = |k: usize| sum[k] / hits * share + f64::from(below[k]) * (1.0 - share);
                image.put_pixel(x, y, Rgb(std::array::from_fn(|k| mixed(k).round() as u8)));
            }
        }
    }
}

/// A transparent layer over a picture.
struct Canvas {
    layer: Pixmap,
    /// Width of lines, growing with the picture.
    pen: f32,
}

const BOX: [u8; 3] = [255, 214, 10];
const OUTLINE: [u8; 3] = [0, 229, 255];
const ARROW: [u8; 3] = [255, 45, 85];
const REFUSED: [u8; 3] = [160, 160, 160];

impl Canvas {
    fn new(picture: &RgbImage) -> Option<Self> {
        let layer = Pixmap::new(picture.width(), picture.height())?;
        Some(Self { layer, pen: (picture.width().max(picture.height()) as f32 / 500.0).max(1.2) })
    }

    fn stroke(&mut self, path: Option<Path>, colour: [u8; 3], width: f32) {
        let Some(path) = path else { return };
        for (colour, width) in [([0, 0, 0], width + 1.5), (colour, width)] {
            let stroke = Stroke { width, line_cap: LineCap::Round, ..Stroke::default() };
            self.layer.stroke_path(
                &path,
                &paint(colour, if colour == [0, 0, 0] { 110 } else { 255 }),
                &stroke,
                Transform::identity(),
                None,
            );
        }
    }

    fn polygon(points: &[[f64; 2]], close: bool) -> Option<Path> {
        let mut path = PathBuilder::new();
        for (k, p) in points.iter().enumerate() {
            let (x, y) = (p[0] as f32, p[1] as f32);
            if k == 0 { path.move_to(x, y) } else { path.line_to(x, y) }
        }
        if close {
            path.close();
        }
        path.finish()
    }

    fn detection(&mut self, d: &Detection, name: &str, bare: bool) {
        let PixelBox { x_min, y_min, x_max, y_max } = d.bounds;
        let corners = [[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max]];
        let refused = matches!(d.pose, Some(PoseOutcome::Refused { .. }));
        let colour = if refused { REFUSED } else { BOX };
        if !bare {
            self.stroke(Self::polygon(&corners, true), colour, self.pen);
            self.label(format!("{name} {:.2}", d.score).trim_start(), x_min as f32, y_min as f32, colour);
        }
        if let (Some(PoseOutcome::Found(pose)), false) = (&d.pose, bare) {
            self.stroke(Self::polygon(&pose.corners.0, true), OUTLINE, self.pen);
            self.arrow(pose.center, pose.corners.0[0]);
        }
    }

    fn arrow(&mut self, from: [f64; 2], to: [f64; 2]) {
        let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
        let wing = |turn: f64| {
            let (s, c) = turn.sin_cos();
            [to[0] - 0.28 * (dx * c - dy * s), to[1] - 0.28 * (dx * s + dy * c)]
        };
        self.stroke(Self::polygon(&[from, to], false), ARROW, 1.4 * self.pen);
        self.stroke(Self::polygon(&[wing(0.45), to, wing(-0.45)], false), ARROW, 1.4 * self.pen);
        let dot = PathBuilder::from_circle(from[0] as f32, from[1] as f32, 1.8 * self.pen);
        if let Some(dot) = dot {
            self.layer.fill_path(&dot, &paint(ARROW, 255), FillRule::Winding, Transform::identity(), None);
        }
    }

    /// A cube of the marker's side standing on it, towards the viewer.
    fn cube(&mut self, pose: &Pose, camera: &Camera) {
        let Some(solutions) = camera.solve(&pose.corners, 1.0) else { return };
        let (r, t): (Matrix3<f64>, Vector3<f64>) = (solutions.best.rotation, solutions.best.translation);
        let corner = |k: usize, z: f64| {
            let (x, y) = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)][k % 4];
            camera.project(&(r * Vector3::new(x, y, z) + t))
        };
        let all: Option<Vec<[f64; 2]>> = (0..8).map(|k| corner(k, if k < 4 { 0.0 } else { -1.0 })).collect();
        let Some(p) = all else { return };
        // Faces seen from outside turn counter-clockwise here; those towards the viewer are painted last.
        let faces = [[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7], [4, 5, 6, 7]];
        for (k, face) in faces.iter().enumerate() {
            let quad: Vec<[f64; 2]> = face.iter().map(|i| p[*i]).collect();
            let area = tcross_dataset::geom::quad::polygon_area(&quad);
            let front = if k == 4 { area > 0.0 } else { area < 0.0 };
            let shade = [(90, 130, 255), (60, 95, 210), (40, 70, 170), (70, 110, 230), (150, 185, 255)][k];
            if front && let Some(path) = Self::polygon(&quad, true) {
                self.layer.fill_path(&path, &paint([shade.0, shade.1, shade.2], 215), FillRule::Winding, Transform::identity(), None);
                self.stroke(Some(path), [235, 240, 255], self.pen);
            }
        }
    }

    /// Letters in a dark field above a point, pushed inside the picture.
    fn label(&mut self, text: &str, x: f32, y: f32, colour: [u8; 3]) {
        let dot = (self.pen * 0.8).max(1.0).round();
        let (dots, columns) = lettering::dots(text);
        let (w, h) = ((columns + 2) as f32 * dot, (lettering::LETTER[1] + 2) as f32 * dot);
        let x = x.clamp(0.0, (self.layer.width() as f32 - w).max(0.0)).round();
        let y = if y < h { y } else { y - h }.clamp(0.0, (self.layer.height() as f32 - h).max(0.0)).round();
        let mut fill = |x: f32, y: f32, w: f32, h: f32, colour: [u8; 3], alpha: u8| {
            if let Some(rect) = Rect::from_xywh(x, y, w, h) {
                self.layer.fill_rect(rect, &paint(colour, alpha), Transform::identity(), None);
            }
        };
        fill(x, y, w, h, [0, 0, 0], 190);
        for (column, row) in dots {
            fill(x + dot * (1 + column) as f32, y + dot * (1 + row) as f32, dot, dot, colour, 255);
        }
    }

    fn onto(self, picture: &mut RgbImage) {
        for (p, q) in picture.pixels_mut().zip(self.layer.pixels()) {
            let keep = 255 - u32::from(q.alpha());
            let mix = |below: u8, above: u8| (u32::from(above) + (u32::from(below) * keep + 127) / 255).min(255) as u8;
            *p = Rgb([mix(p[0], q.red()), mix(p[1], q.green()), mix(p[2], q.blue())]);
        }
    }
}

fn paint(colour: [u8; 3], alpha: u8) -> Paint<'static> {
    let mut paint = Paint::default();
    paint.set_color(Color::from_rgba8(colour[0], colour[1], colour[2], alpha));
    paint.anti_alias = true;
    paint
}
