//! The only bridge between an image and a network's input: scale keeping the aspect, then pad.
use super::boxes::PixelBox;

/// How an image of one size lies in a network's input of another, as Darknet does it: the new size by truncating integer
/// division, the offset `(net - new) / 2` truncated for pixels but exact for boxes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Letterbox {
    /// Source width and height in pixels.
    pub source: (usize, usize),
    /// Network width and height in pixels.
    pub net: (usize, usize),
    /// Width and height of the scaled image inside the network's input, in pixels.
    pub scaled: (usize, usize),
}

impl Letterbox {
    /// The letterbox of a source of this size (both at least 1) in a network of that size.
    #[must_use]
    pub fn new(source: (usize, usize), net: (usize, usize)) -> Self {
        let (w, h) = source;
        let scaled = if net.0 * h < net.1 * w { (net.0, (h * net.0 / w).max(1)) } else { ((w * net.1 / h).max(1), net.1) };
        Self { source, net, scaled }
    }

    /// Where the scaled image's first pixel lies: the truncated half of the border.
    #[must_use]
    pub fn offset_px(&self) -> (usize, usize) {
        ((self.net.0 - self.scaled.0) / 2, (self.net.1 - self.scaled.1) / 2)
    }

    fn offset(&self) -> (f64, f64) {
        ((self.net.0 - self.scaled.0) as f64 / 2.0, (self.net.1 - self.scaled.1) as f64 / 2.0)
    }

    fn scale(&self) -> (f64, f64) {
        (self.scaled.0 as f64 / self.source.0 as f64, self.scaled.1 as f64 / self.source.1 as f64)
    }

    /// A point of the source in the network's input. The offset is the exact half of the
    /// border, which Darknet's published weights expect; training maps its labels the same way.
    #[must_use]
    pub fn net_from_source(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let ((ox, oy), (sx, sy)) = (self.offset(), self.scale());
        [x * sx + ox, y * sy + oy]
    }

    /// A point of the network's input in the source.
    #[must_use]
    pub fn source_from_net(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let ((ox, oy), (sx, sy)) = (self.offset(), self.scale());
        [(x - ox) / sx, (y - oy) / sy]
    }

    /// A box of the source in the network's input.
    #[must_use]
    pub fn box_to_net(&self, b: &PixelBox) -> PixelBox {
        let (p, q) = (self.net_from_source([b.x_min, b.y_min]), self.net_from_source([b.x_max, b.y_max]));
        PixelBox::from([p[0], p[1], q[0], q[1]])
    }

    /// A box of the network's input in the source; not clipped.
    #[must_use]
    pub fn box_to_source(&self, b: &PixelBox) -> PixelBox {
        let (p, q) = (self.source_from_net([b.x_min, b.y_min]), self.source_from_net([b.x_max, b.y_max]));
        PixelBox::from([p[0], p[1], q[0], q[1]])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn darknets_sizes() {
        assert_eq!(Letterbox::new((768, 576), (416, 416)).scaled, (416, 312));
        assert_eq!(Letterbox::new((640, 424), (416, 416)).scaled, (416, 275));
        assert_eq!(Letterbox::new((416, 416), (416, 416)), Letterbox { source: (416, 416), net: (416, 416), scaled: (416, 416) });
    }

    proptest! {
        #[test]
        fn round_trip(w in 1usize..3000, h in 1usize..3000, nw in 1usize..20, nh in 1usize..20, x in 0.0..1.0f64, y in 0.0..1.0f64) {
            let l = Letterbox::new((w, h), (nw * 32, nh * 32));
            let p = [x * w as f64, y * h as f64];
            let q = l.source_from_net(l.net_from_source(p));
            prop_assert!((p[0] - q[0]).abs() < 1e-6 && (p[1] - q[1]).abs() < 1e-6);
            prop_assert!(l.scaled.0 <= l.net.0 && l.scaled.1 <= l.net.1);
        }
    }
}
