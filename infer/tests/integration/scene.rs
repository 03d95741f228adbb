//! A small renderer of drawn T crosses on any background, independent of the generator: the judge of the pose in tests and
//! in the pose study. Light is added linearly; truth is the ideal square before the hand's wobble.
use image::{Rgb, RgbImage};
use tcross_dataset::{Homography, PixelBox, Quad, Rng};

/// One marker as drawn.
#[derive(Debug, Clone)]
pub struct Drawn {
    /// Corners, clockwise as seen, the stem's first.
    pub corners: Quad,
    /// Unit square to pixels.
    pub map: Homography,
    /// Extent of the corners.
    pub bounds: PixelBox,
    /// Angle between the marker's normal and the direction to the camera.
    pub tilt_deg: f64,
    /// Length of the motion blur in pixels.
    pub blur_px: f64,
}

/// Ranges of what is drawn.
#[derive(Debug, Clone)]
pub struct Style {
    /// Width of the box in pixels, log-uniform.
    pub width_px: (f64, f64),
    /// Tilt in degrees.
    pub tilt_deg: (f64, f64),
    /// Motion blur as a share of the box's width.
    pub blur: (f64, f64),
    /// Saturation of the fill.
    pub saturation: (f64, f64),
    /// Hue of the fill in degrees.
    pub hue: (f64, f64),
    /// Amplitude of the hand's wobble in sides.
    pub wobble: f64,
    /// Deviation of the sensor's noise in grey levels.
    pub noise: f64,
}

impl Default for Style {
    fn default() -> Self {
        Self {
            width_px: (40.0, 400.0),
            tilt_deg: (0.0, 60.0),
            blur: (0.0, 0.1),
            saturation: (0.35, 1.0),
            hue: (0.0, 360.0),
            wobble: 0.008,
            noise: 3.0,
        }
    }
}

fn linear(v: u8) -> f64 {
    let v = f64::from(v) / 255.0;
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

fn byte(v: f64) -> f64 {
    255.0 * if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

fn hsv(h: f64, s: f64, v: f64) -> [f64; 3] {
    let f = |n: f64| {
        let k = (n + h / 60.0) % 6.0;
        v - v * s * k.min(4.0 - k).clamp(0.0, 1.0)
    };
    [f(5.0), f(3.0), f(1.0)].map(|c| linear((c * 255.0).round() as u8))
}

/// Corners of a unit square seen by a pinhole camera: turned by `roll`, tilted by `tilt` about an axis at `axis` (radians).
fn seen(roll: f64, tilt: f64, axis: f64, aspect: f64) -> [[f64; 2]; 4] {
    [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]].map(|[x, y]| {
        let (x, y) = (x * aspect, y / aspect);
        let (x, y) = (x * roll.cos() - y * roll.sin(), x * roll.sin() + y * roll.cos());
        // Along and across the axis of the tilt.
        let (u, v) = (x * axis.cos() + y * axis.sin(), -x * axis.sin() + y * axis.cos());
        let (v, z) = (v * tilt.cos(), 4.0 + v * tilt.sin());
        let (u, v) = (4.0 * u / z, 4.0 * v / z);
        [u * axis.cos() - v * axis.sin(), u * axis.sin() + v * axis.cos()]
    })
}

/// A low-frequency wave, amplitude about 1.
struct Wave([(f64, f64); 3]);

impl Wave {
    fn new(rng: &mut Rng) -> Self {
        Self(std::array::from_fn(|k| (rng.uniform(0.2, 0.6) / (k as f64 + 1.0), rng.uniform(0.0, std::f64::consts::TAU))))
    }
    fn at(&self, t: f64) -> f64 {
        self.0.iter().enumerate().map(|(k, (a, p))| a * (3.0 * (k as f64 + 1.0) * t + p).sin()).sum()
    }
}

/// Draws one marker somewhere on `image` and says where.
pub fn draw(image: &mut RgbImage, style: &Style, rng: &mut Rng) -> Drawn {
    let (w, h) = (f64::from(image.width()), f64::from(image.height()));
    let tilt_deg = rng.uniform(style.tilt_deg.0, style.tilt_deg.1);
    let unit = seen(
        rng.uniform(0.0, std::f64::consts::TAU),
        tilt_deg.to_radians(),
        rng.uniform(0.0, std::f64::consts::TAU),
        rng.uniform(0.9, 1.1),
    );
    let b = Quad(unit).bounds();
    let room = ((w - 8.0) / b.width()).min((h - 8.0) / b.height());
    let scale = (rng.log_uniform(style.width_px.0, style.width_px.1) / b.width()).min(room);
    let x = rng.uniform(4.0, (w - 4.0 - b.width() * scale).max(4.1)) - b.x_min * scale;
    let y = rng.uniform(4.0, (h - 4.0 - b.height() * scale).max(4.1)) - b.y_min * scale;
    let corners = unit.map(|p| [p[0] * scale + x, p[1] * scale + y]);
    let map = Homography::from_unit_square(&corners).expect("a tilted square is no line");
    let blur_px = rng.uniform(style.blur.0, style.blur.1) * b.width() * scale;
    let (fill, line) = colours(style, rng);
    let thickness = rng.uniform(0.03, 0.08).max(1.6 / Quad(corners).side_px());
    let drawn = Drawn { corners: Quad(corners), map, bounds: Quad(corners).bounds(), tilt_deg, blur_px };
    let waves: Vec<Wave> = (0..8).map(|_| Wave::new(rng)).collect();
    let hatch = (rng.uniform(0.0, 0.12), rng.uniform(20.0, 50.0), rng.uniform(0.0, std::f64::consts::TAU));
    let light = [rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3)];
    let back = map.inverse().expect("a homography of a sound quadrilateral");
    let unit_colour = |p: [f64; 2]| -> Option<[f64; 3]> {
        let [u, v] = back.apply(p);
        let a = style.wobble;
        let inside = v > a * waves[0].at(u) && u < 1.0 + a * waves[1].at(v) && v < 1.0 + a * waves[2].at(u) && u > a * waves[3].at(v);
        if !inside {
            return None;
        }
        // The three arms: to the stem's corner and to both its neighbours.
        let arm = [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]].iter().enumerate().any(|(k, d)| {
            let (x, y) = (u - 0.5, v - 0.5);
            let t = (x * d[0] + y * d[1]) / std::f64::consts::SQRT_2;
            let s = (x * d[1] - y * d[0]) / std::f64::consts::SQRT_2 + a * waves[4 + k].at(2.0 * t);
            (-0.5 * thickness..0.70).contains(&t) && s.abs() < thickness / 2.0
        });
        let shade = 1.0 + light[0] * (u - 0.5) + light[1] * (v - 0.5);
        let stroke = 1.0 - hatch.0 * (hatch.1 * (u * hatch.2.cos() + v * hatch.2.sin())).sin().max(0.0);
        Some(if arm { line.map(|c| c * shade) } else { fill.map(|c| c * shade * stroke) })
    };
    paint(image, &drawn, &unit_colour, rng.uniform(0.0, std::f64::consts::TAU));
    if style.noise > 0.0 {
        for p in image.pixels_mut() {
            for c in &mut p.0 {
                // A triangular draw is near enough to a normal one, and quick.
                let v = f64::from(*c) + style.noise * 2.4 * (rng.unit() + rng.unit() - 1.0);
                *c = v.round().clamp(0.0, 255.0) as u8;
            }
        }
    }
    drawn
}

fn colours(style: &Style, rng: &mut Rng) -> ([f64; 3], [f64; 3]) {
    let fill = hsv(rng.uniform(style.hue.0, style.hue.1), rng.uniform(style.saturation.0, style.saturation.1), rng.uniform(0.5, 1.0));
    loop {
        let line = hsv(rng.uniform(0.0, 360.0), rng.uniform(0.0, 1.0), rng.uniform(0.0, 1.0));
        let apart: f64 = (0..3).map(|k| (line[k].sqrt() - fill[k].sqrt()).powi(2)).sum();
        if apart.sqrt() > 0.45 {
            return (fill, line);
        }
    }
}

fn paint(image: &mut RgbImage, drawn: &Drawn, colour: &dyn Fn([f64; 2]) -> Option<[f64; 3]>, heading: f64) {
    let reach = drawn.blur_px / 2.0 + 3.0;
    let b = &drawn.bounds;
    let x0 = (b.x_min - reach).floor().max(0.0) as u32;
    let y0 = (b.y_min - reach).floor().max(0.0) as u32;
    let x1 = ((b.x_max + reach).ceil() as u32).min(image.width());
    let y1 = ((b.y_max + reach).ceil() as u32).min(image.height());
    let (w, h) = ((x1 - x0) as usize, (y1 - y0) as usize);
    const N: usize = 4;
    let mut sharp = vec![[0.0f64; 3]; w * h];
    for y in 0..h {
        for x in 0..w {
            let below = image.get_pixel(x0 + x as u32, y0 + y as u32).0.map(linear);
            let mut sum = [0.0; 3];
            for s in 0..N * N {
                let at = |v: usize, k: usize| v as f64 + (k as f64 + 0.5) / N as f64;
                let c = colour([f64::from(x0) + at(x, s % N), f64::from(y0) + at(y, s / N)]).unwrap_or(below);
                for k in 0..3 {
                    sum[k] += c[k] / (N * N) as f64;
                }
            }
            sharp[y * w + x] = sum;
        }
    }
    let taps = (drawn.blur_px * 1.5).ceil().max(1.0) as usize;
    for y in 0..h {
        for x in 0..w {
            let mut sum = [0.0; 3];
            for t in 0..taps {
                let along = drawn.blur_px * ((t as f64 + 0.5) / taps as f64 - 0.5);
                let (px, py) = (x as f64 + along * heading.cos(), y as f64 + along * heading.sin());
                let (px, py) = (px.clamp(0.0, (w - 1) as f64), py.clamp(0.0, (h - 1) as f64));
                let (ix, iy) = (px as usize, py as usize);
                let (jx, jy) = ((ix + 1).min(w - 1), (iy + 1).min(h - 1));
                let (fx, fy) = (px - ix as f64, py - iy as f64);
                for k in 0..3 {
                    let top = sharp[iy * w + ix][k] * (1.0 - fx) + sharp[iy * w + jx][k] * fx;
                    let bottom = sharp[jy * w + ix][k] * (1.0 - fx) + sharp[jy * w + jx][k] * fx;
                    sum[k] += (top * (1.0 - fy) + bottom * fy) / taps as f64;
                }
            }
            image.put_pixel(x0 + x as u32, y0 + y as u32, Rgb(sum.map(|v| byte(v).round().clamp(0.0, 255.0) as u8)));
        }
    }
}

/// A background of overlapping discs in random colours over a gradient: cluttered like a photograph's edges are.
pub fn clutter(width: u32, height: u32, rng: &mut Rng) -> RgbImage {
    let base = [rng.uniform(60.0, 220.0), rng.uniform(60.0, 220.0), rng.uniform(60.0, 220.0)];
    let mut image = RgbImage::from_fn(width, height, |x, y| {
        Rgb(std::array::from_fn(|k| (base[k] + 30.0 * (f64::from(x) / f64::from(width) - f64::from(y) / f64::from(height))) as u8))
    });
    for _ in 0..60 {
        let (cx, cy) = (rng.uniform(0.0, f64::from(width)), rng.uniform(0.0, f64::from(height)));
        let r = rng.log_uniform(8.0, f64::from(height) / 3.0);
        let grey = rng.uniform(20.0, 235.0);
        let tint: [f64; 3] = std::array::from_fn(|_| rng.normal() * 22.0);
        let colour = Rgb(std::array::from_fn(|k| (grey + tint[k]).clamp(0.0, 255.0) as u8));
        for y in (cy - r).max(0.0) as u32..((cy + r).min(f64::from(height)) as u32) {
            for x in (cx - r).max(0.0) as u32..((cx + r).min(f64::from(width)) as u32) {
                if (f64::from(x) - cx).powi(2) + (f64::from(y) - cy).powi(2) < r * r {
                    image.put_pixel(x, y, colour);
                }
            }
        }
    }
    image
}
