//! A marker's own frame: where its lines meet, and how a square around that is stretched and slanted to its outline. Seen in it, a marker
//! that is tilted looks like one seen from the front, but for how far it is turned.
use super::polar::UnitBox;

/// A linear map of the plane, `[[xx, xy], [yx, yy]]`, to be applied to columns.
pub type Linear = [[f32; 2]; 2];

/// Bounds of a frame's stretch, in half sides of the claim.
const STRETCH: [f32; 2] = [0.08, 2.0];
/// How far from the claim's middle a frame's may lie, in half sides.
const FARTHEST: f32 = 1.2;
/// What is taken for the area of a map that has none, and for the stretch of a frame that has none.
const LEAST_AREA: f32 = 1e-6;

/// `center + axes * p` takes a square of half side 1 to one of the marker's own stretch and slant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Where the lines meet.
    pub center: [f32; 2],
    /// Symmetric, so that nothing is said of how far the marker is turned: the root of the corners' second moments around the centre.
    pub axes: Linear,
}

impl Frame {
    /// Of a marker whose lines meet at `center` and end in `corners`.
    #[must_use]
    pub fn of(corners: [[f32; 2]; 4], center: [f32; 2]) -> Self {
        let mut moments = [[0.0; 2]; 2];
        for corner in corners {
            let d = [corner[0] - center[0], corner[1] - center[1]];
            (0..2).for_each(|i| (0..2).for_each(|j| moments[i][j] += d[i] * d[j] / 4.0));
        }
        Self { center, axes: root(moments) }
    }

    /// Of an upright marker that fills a box.
    #[must_use]
    pub fn of_box(b: UnitBox) -> Self {
        let half = |axis: usize| (b[axis + 2] - b[axis]) / 2.0;
        Self { center: [(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0], axes: [[half(0), 0.0], [0.0, half(1)]] }
    }

    /// As it is after `center + axes * p`.
    #[must_use]
    pub fn mapped(&self, center: [f32; 2], axes: &Linear) -> Self {
        let moved = apply(axes, self.center);
        let both = product(axes, &self.axes);
        Self { center: [center[0] + moved[0], center[1] + moved[1]], axes: root(product(&both, &transposed(&both))) }
    }

    /// The nearest that is worth a look: around something that the claim shows, and neither flat nor huge.
    #[must_use]
    pub fn sound(self) -> Self {
        let [[a, b], [_, d]] = self.axes;
        let (middle, spread) = ((a + d) / 2.0, ((a - d) / 2.0).hypot(b));
        let [low, high] = [middle - spread, middle + spread].map(|v| v.clamp(STRETCH[0], STRETCH[1]));
        // The same directions, at the allowed lengths.
        let (m, s) = ((low + high) / 2.0, if spread > 0.0 { (high - low) / 2.0 / spread } else { 0.0 });
        let off = s * (a - d) / 2.0;
        Self { center: self.center.map(|v| v.clamp(-FARTHEST, FARTHEST)), axes: [[m + off, s * b], [s * b, m - off]] }
    }
}

/// The symmetric root of a symmetric map without negative stretch.
fn root(m: Linear) -> Linear {
    let area = (m[0][0] * m[1][1] - m[0][1] * m[1][0]).max(0.0).sqrt();
    let t = (m[0][0] + m[1][1] + 2.0 * area).sqrt().max(LEAST_AREA);
    [[(m[0][0] + area) / t, m[0][1] / t], [m[1][0] / t, (m[1][1] + area) / t]]
}

/// A map of a column.
#[must_use]
pub fn apply(m: &Linear, p: [f32; 2]) -> [f32; 2] {
    m.map(|row| row[0] * p[0] + row[1] * p[1])
}

/// First `b`, then `a`.
#[must_use]
pub fn product(a: &Linear, b: &Linear) -> Linear {
    let columns = transposed(b).map(|column| apply(a, column));
    transposed(&columns)
}

fn transposed(m: &Linear) -> Linear {
    [[m[0][0], m[1][0]], [m[0][1], m[1][1]]]
}

/// The way back.
#[must_use]
pub fn inverse(m: &Linear) -> Linear {
    let area = m[0][0] * m[1][1] - m[0][1] * m[1][0];
    let area = if area.abs() < LEAST_AREA { LEAST_AREA } else { area };
    [[m[1][1] / area, -m[0][1] / area], [-m[1][0] / area, m[0][0] / area]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: &Frame, b: &Frame) -> bool {
        let numbers = |f: &Frame| [f.center[0], f.center[1], f.axes[0][0], f.axes[0][1], f.axes[1][0], f.axes[1][1]];
        numbers(a).iter().zip(numbers(b)).all(|(a, b)| (a - b).abs() < 1e-5)
    }

    fn moved(f: &Frame, p: [f32; 2]) -> [f32; 2] {
        let q = apply(&f.axes, p);
        [f.center[0] + q[0], f.center[1] + q[1]]
    }

    #[test]
    fn a_square_has_its_half_sides_however_it_is_turned() {
        let upright = Frame::of([[0.0, 1.0], [4.0, 1.0], [4.0, 5.0], [0.0, 5.0]], [2.0, 3.0]);
        assert!(close(&upright, &Frame { center: [2.0, 3.0], axes: [[2.0, 0.0], [0.0, 2.0]] }), "{upright:?}");
        let on_a_corner = Frame::of([[2.0, 0.0], [0.0, 2.0], [-2.0, 0.0], [0.0, -2.0]], [0.0; 2]);
        assert!(close(&on_a_corner, &Frame { center: [0.0; 2], axes: [[2f32.sqrt(), 0.0], [0.0, 2f32.sqrt()]] }), "{on_a_corner:?}");
        assert!(close(&Frame::of_box([0.0, 1.0, 4.0, 5.0]), &upright));
    }

    /// A slanted marker seen in its own frame is a square.
    #[test]
    fn in_its_frame_a_slanted_marker_is_a_square() {
        let slant: Linear = [[1.0, 0.6], [-0.2, 0.5]];
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|p| apply(&slant, p)).map(|p| [p[0] + 0.3, p[1]]);
        let frame = Frame::of(corners, [0.3, 0.0]);
        assert_eq!(frame.axes[0][1], frame.axes[1][0]);
        let back = inverse(&frame.axes);
        let seen = corners.map(|p| apply(&back, [p[0] - 0.3, p[1]]));
        let length = |p: [f32; 2]| p[0].hypot(p[1]);
        assert!(seen.iter().all(|p| (length(*p) - 2f32.sqrt()).abs() < 1e-5), "{seen:?}");
        assert!((seen[0][0] * seen[1][0] + seen[0][1] * seen[1][1]).abs() < 1e-5, "right angles: {seen:?}");
        // The frame of the seen corners is that of the frame as it is seen.
        let center = apply(&back, [-0.1, 0.2]);
        assert!(close(
            &frame.mapped(center, &back),
            &Frame::of(
                corners.map(|p| {
                    let q = apply(&back, p);
                    [q[0] + center[0], q[1] + center[1]]
                }),
                {
                    let q = apply(&back, [0.3, 0.0]);
                    [q[0] + center[0], q[1] + center[1]]
                }
            )
        ));
    }

    #[test]
    fn what_no_claim_can_show_is_brought_back() {
        let fine = Frame { center: [0.2, -0.4], axes: [[0.7, 0.2], [0.2, 0.5]] };
        assert!(close(&fine.sound(), &fine));
        // Mirrored along one diagonal, huge along the other: the directions stay.
        let wild = Frame { center: [7.0, -9.0], axes: [[1.0, 4.0], [4.0, 1.0]] }.sound();
        assert_eq!(wild.center, [FARTHEST, -FARTHEST]);
        let along = |p: [f32; 2]| moved(&Frame { center: [0.0; 2], ..wild }, p);
        assert!(along([1.0, 1.0]).iter().all(|v| (v - STRETCH[1]).abs() < 1e-5), "{wild:?}");
        assert!((along([1.0, -1.0])[0] - STRETCH[0]).abs() < 1e-5, "{wild:?}");
        let flat = Frame { center: [0.0; 2], axes: [[0.0; 2]; 2] }.sound();
        assert!(close(&flat, &Frame { center: [0.0; 2], axes: [[STRETCH[0], 0.0], [0.0, STRETCH[0]]] }));
        assert!(Frame::of([[1.0; 2]; 4], [1.0; 2]).sound().axes.as_flattened().iter().all(|v| v.is_finite()));
    }
}
