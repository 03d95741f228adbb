//! Axis-aligned boxes and their overlap.
use serde::{Deserialize, Serialize};

/// `[x_min, y_min, x_max, y_max]` in pixels of some image, written so in every file.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(from = "[f64; 4]", into = "[f64; 4]")]
pub struct PixelBox {
    /// Left side.
    pub x_min: f64,
    /// Upper side.
    pub y_min: f64,
    /// Right side.
    pub x_max: f64,
    /// Lower side.
    pub y_max: f64,
}

impl From<[f64; 4]> for PixelBox {
    fn from([x_min, y_min, x_max, y_max]: [f64; 4]) -> Self {
        Self { x_min, y_min, x_max, y_max }
    }
}

impl From<PixelBox> for [f64; 4] {
    fn from(b: PixelBox) -> Self {
        [b.x_min, b.y_min, b.x_max, b.y_max]
    }
}

impl PixelBox {
    /// The box around a centre.
    #[must_use]
    pub fn from_center(cx: f64, cy: f64, width: f64, height: f64) -> Self {
        Self { x_min: cx - width / 2.0, y_min: cy - height / 2.0, x_max: cx + width / 2.0, y_max: cy + height / 2.0 }
    }

    /// `x_max - x_min`.
    #[must_use]
    pub fn width(&self) -> f64 {
        self.x_max - self.x_min
    }

    /// `y_max - y_min`.
    #[must_use]
    pub fn height(&self) -> f64 {
        self.y_max - self.y_min
    }

    /// Zero for an empty or reversed box.
    #[must_use]
    pub fn area(&self) -> f64 {
        self.width().max(0.0) * self.height().max(0.0)
    }

    /// The middle.
    #[must_use]
    pub fn center(&self) -> [f64; 2] {
        [(self.x_min + self.x_max) / 2.0, (self.y_min + self.y_max) / 2.0]
    }

    /// The shorter of width and height.
    #[must_use]
    pub fn short_side(&self) -> f64 {
        self.width().min(self.height())
    }

    /// The same with its right and lower side moved outwards by `extra`: from one convention of counting boxes to another.
    #[must_use]
    pub fn grown(&self, extra: f64) -> Self {
        Self { x_max: self.x_max + extra, y_max: self.y_max + extra, ..*self }
    }

    /// The part inside an image of this size; may be empty.
    #[must_use]
    pub fn clipped(&self, width: f64, height: f64) -> Self {
        Self {
            x_min: self.x_min.clamp(0.0, width),
            y_min: self.y_min.clamp(0.0, height),
            x_max: self.x_max.clamp(0.0, width),
            y_max: self.y_max.clamp(0.0, height),
        }
    }

    /// True where all four numbers are finite and no side is reversed.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        [self.x_min, self.y_min, self.x_max, self.y_max].iter().all(|v| v.is_finite())
            && self.x_max >= self.x_min
            && self.y_max >= self.y_min
    }
}

/// Intersection over union of continuous boxes; 0 where both are empty.
#[must_use]
pub fn iou(a: &PixelBox, b: &PixelBox) -> f64 {
    overlap(a, b, 0.0)
}

/// Intersection over union as the paper counts it: corners are pixel indices and every side, also of the intersection,
/// is `max - min + 1` long.
#[must_use]
pub fn iou_inclusive(a: &PixelBox, b: &PixelBox) -> f64 {
    overlap(a, b, 1.0)
}

fn overlap(a: &PixelBox, b: &PixelBox, one: f64) -> f64 {
    let area = |q: &PixelBox| (q.width() + one).max(0.0) * (q.height() + one).max(0.0);
    let w = (a.x_max.min(b.x_max) - a.x_min.max(b.x_min) + one).max(0.0);
    let h = (a.y_max.min(b.y_max) - a.y_min.max(b.y_min) + one).max(0.0);
    let union = area(a) + area(b) - w * h;
    if union > 0.0 { w * h / union } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inclusive_counts_both_ends() {
        let a = PixelBox::from([0.0, 0.0, 9.0, 9.0]);
        let b = PixelBox::from([5.0, 0.0, 14.0, 9.0]);
        assert!((iou_inclusive(&a, &b) - 50.0 / 150.0).abs() < 1e-12);
        assert!((iou(&a, &b) - 36.0 / 126.0).abs() < 1e-12);
    }

    #[test]
    fn empty_boxes_do_not_divide_by_zero() {
        let point = PixelBox::from([3.0; 4]);
        assert_eq!(iou(&point, &point), 0.0);
        assert_eq!(iou_inclusive(&point, &point), 1.0);
    }

    #[test]
    fn overlap_equals_counting_pixels() {
        // The naive twin: count integer pixels covered by each box.
        let count =
            |f: &dyn Fn(i32, i32) -> bool| (0..12).flat_map(|y| (0..12).map(move |x| (x, y))).filter(|&(x, y)| f(x, y)).count() as f64;
        let mut rng = crate::Rng::for_item(0, "test/iou", 0);
        for _ in 0..500 {
            let mut draw = || {
                let (x, y) = (rng.int(0, 8), rng.int(0, 8));
                [x, y, x + rng.int(0, 3), y + rng.int(0, 3)].map(|v| v as i32)
            };
            let (a, b) = (draw(), draw());
            let inside = |q: [i32; 4], x: i32, y: i32| x >= q[0] && x <= q[2] && y >= q[1] && y <= q[3];
            let naive = count(&|x, y| inside(a, x, y) && inside(b, x, y)) / count(&|x, y| inside(a, x, y) || inside(b, x, y));
            let got = iou_inclusive(&a.map(f64::from).into(), &b.map(f64::from).into());
            assert!((naive - got).abs() < 1e-12);
        }
    }
}
