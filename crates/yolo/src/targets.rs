//! Which predictor learns which truth.
use crate::{
    anchors,
    error::YoloError,
    fields::BoxFields,
    geometry::{Geometry, NormBox, Predictor},
};
use tcross_dataset::PixelBox;

/// A box to learn, in fractions of the network's input.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// Centre and size: centre in 0..=1, size above 0.
    pub bounds: NormBox,
    /// Index of the class.
    pub class: u32,
    /// Share of the picture it comes from (mix-up), 0..=1; 1 for a plain picture.
    pub weight: f32,
    /// Points in fractions of the input, as many as the network has, or none where they are not known.
    pub keypoints: Vec<[f32; 2]>,
}

impl Truth {
    /// From a continuous box in net-input pixels.
    #[must_use]
    pub fn from_net_box(bounds: &PixelBox, class: u32, net: crate::NetSize) -> Self {
        let (w, h) = (net.width as f64, net.height as f64);
        let [cx, cy] = bounds.center();
        let bounds = NormBox { x: (cx / w) as f32, y: (cy / h) as f32, w: (bounds.width() / w) as f32, h: (bounds.height() / h) as f32 };
        Self { bounds, class, weight: 1.0, keypoints: Vec::new() }
    }

    /// Checks that a network with these fields can learn this box.
    fn check(&self, fields: &BoxFields) -> Result<(), String> {
        let NormBox { x, y, w, h } = self.bounds;
        if ![x, y].iter().all(|v| (0.0..=1.0).contains(v)) {
            return Err(format!("centre ({x}, {y}) of the input's size: expected both in 0..=1"));
        }
        if ![w, h].iter().all(|v| *v > 0.0 && *v <= LARGEST_SIDE) {
            return Err(format!("size {w} x {h} of the input's: expected both above 0 and at most {LARGEST_SIDE}"));
        }
        if self.class as usize >= fields.classes {
            return Err(format!("class {}: expected less than {}", self.class, fields.classes));
        }
        if !(0.0..=1.0).contains(&self.weight) {
            return Err(format!("weight {}: expected 0..=1", self.weight));
        }
        if !self.keypoints.is_empty() && self.keypoints.len() != fields.keypoints {
            return Err(format!("{} keypoints: expected {} or none", self.keypoints.len(), fields.keypoints));
        }
        if self.keypoints.iter().flatten().any(|v| !v.is_finite()) {
            return Err("a keypoint is not finite".into());
        }
        Ok(())
    }
}

/// A box may stick out of the input, but the scale `2 - w h` of its error must stay positive.
const LARGEST_SIDE: f32 = 1.4;

/// A predictor that learns a box.
#[derive(Debug, Clone, PartialEq)]
pub struct Positive<'a> {
    /// Which.
    pub at: Predictor,
    /// The box it learns: the last one that claimed it.
    pub truth: &'a Truth,
    /// The classes of all that claimed it, in their order.
    pub classes: Vec<u32>,
    /// Targets of the four box logits: x and y (after the sigmoid), ln of width and height over the anchor's.
    pub target: [f32; 4],
    /// `2 - w h`: small boxes count more.
    pub scale: f32,
}

/// Gives each truth of an image to the one anchor, over all heads, of best shape, in the cell that holds its centre. Truths that claim
/// the same predictor overwrite each other's box, and add up their classes. Then every other anchor whose shape overlaps a truth's by more
/// than `assign_iou` learns it too, where nothing claimed it before (AlexeyAB's `iou_thresh`; 1 for none), and so does, for each of these
/// anchors, every cell beside that one, across or down, that reaches the centre (none where `scale_xy` is 1).
///
/// # Errors
/// If a truth is out of range; `image` is only named.
pub fn assign<'a>(geometry: &Geometry, image: usize, truths: &'a [Truth], assign_iou: f32) -> Result<Vec<Positive<'a>>, YoloError> {
    let mut positives: Vec<Positive> = Vec::new();
    for (index, truth) in truths.iter().enumerate() {
        truth.check(&geometry.fields).map_err(|message| YoloError::Label { image, index, message })?;
        let Some(at) = predictor(geometry, best_anchor(geometry, &truth.bounds), &truth.bounds) else { continue };
        let positive = positive(geometry, at, truth);
        match positives.iter_mut().find(|p| p.at == at) {
            None => positives.push(positive),
            Some(earlier) => {
                let mut classes = std::mem::take(&mut earlier.classes);
                if !classes.contains(&truth.class) {
                    classes.push(truth.class);
                }
                *earlier = Positive { classes, ..positive };
            }
        }
    }
    let mut claim = |at: Predictor, truth: &'a Truth| {
        if positives.iter().all(|p| p.at != at) {
            positives.push(positive(geometry, at, truth));
        }
    };
    for truth in truths.iter().filter(|_| assign_iou < 1.0) {
        for at in alike(geometry, truth, assign_iou) {
            claim(at, truth);
        }
    }
    for truth in truths.iter().filter(|_| geometry.scale_xy > 1.0) {
        let best = predictor(geometry, best_anchor(geometry, &truth.bounds), &truth.bounds);
        for at in best.into_iter().chain(alike(geometry, truth, assign_iou)) {
            beside(geometry, at, &truth.bounds).for_each(|at| claim(at, truth));
        }
    }
    Ok(positives)
}

/// The predictors, in the cell that holds a truth's centre, whose anchors' shapes overlap the truth's by more than `assign_iou`.
fn alike<'a>(geometry: &'a Geometry, truth: &'a Truth, assign_iou: f32) -> impl Iterator<Item = Predictor> + 'a {
    (0..geometry.anchors.len())
        .filter(move |&anchor| shape_iou(geometry, anchor, &truth.bounds) > assign_iou)
        .filter_map(|anchor| predictor(geometry, anchor, &truth.bounds))
}

/// The predictors of the same anchor in the cells left, right, above and below that reach a box's centre.
fn beside<'a>(geometry: &'a Geometry, at: Predictor, b: &'a NormBox) -> impl Iterator<Item = Predictor> + 'a {
    let grid = &geometry.heads[at.head];
    let (column, row) = (at.cell % grid.columns, at.cell / grid.columns);
    let cells = [
        (Some(column), row.checked_sub(1)),
        (Some(column), Some(row + 1)),
        (column.checked_sub(1), Some(row)),
        (Some(column + 1), Some(row)),
    ];
    let inside = cells.into_iter().filter_map(|(column, row)| Some((column?, row?))).filter(|(c, r)| *c < grid.columns && *r < grid.rows);
    inside
        .map(move |(column, row)| Predictor { cell: row * grid.columns + column, ..at })
        .filter(move |at| target(geometry, *at, b)[..2].iter().all(|p| (0.0..=1.0).contains(p)))
}

fn positive<'a>(geometry: &Geometry, at: Predictor, truth: &'a Truth) -> Positive<'a> {
    Positive { at, truth, classes: vec![truth.class], target: target(geometry, at, &truth.bounds), scale: scale(&truth.bounds) }
}

/// The predictor of an anchor in the cell that holds a box's centre; none if the anchor belongs to no head.
fn predictor(geometry: &Geometry, wanted: usize, b: &NormBox) -> Option<Predictor> {
    let (head, anchor) =
        geometry.heads.iter().enumerate().find_map(|(h, head)| head.mask.iter().position(|&m| m == wanted).map(|a| (h, a)))?;
    let grid = &geometry.heads[head];
    let cell = |at: f32, cells: usize| ((at * cells as f32) as usize).min(cells - 1);
    Some(Predictor { head, anchor, cell: cell(b.y, grid.rows) * grid.columns + cell(b.x, grid.columns) })
}

/// Index of the anchor whose shape overlaps the box's best; the first of equals.
fn best_anchor(geometry: &Geometry, b: &NormBox) -> usize {
    let mut best = (0, f32::NEG_INFINITY);
    for index in 0..geometry.anchors.len() {
        let overlap = shape_iou(geometry, index, b);
        if overlap > best.1 {
            best = (index, overlap);
        }
    }
    best.0
}

/// IoU of an anchor and a box, both centred at 0.
fn shape_iou(geometry: &Geometry, anchor: usize, b: &NormBox) -> f32 {
    let [w, h] = geometry.anchors[anchor];
    anchors::shape_iou([w / geometry.net.width as f32, h / geometry.net.height as f32], [b.w, b.h])
}

fn target(geometry: &Geometry, at: Predictor, b: &NormBox) -> [f32; 4] {
    let grid = &geometry.heads[at.head];
    let [aw, ah] = geometry.anchor(at);
    let (column, row) = (at.cell % grid.columns, at.cell / grid.columns);
    let within = |at: f32, cells: usize, cell: usize| geometry.sigmoid_of(at * cells as f32 - cell as f32);
    [within(b.x, grid.columns, column), within(b.y, grid.rows, row), (b.w / aw).ln(), (b.h / ah).ln()]
}

fn scale(b: &NormBox) -> f32 {
    2.0 - b.w * b.h
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Architecture, ModelConfig, NetSize};

    fn tiny() -> Geometry {
        ModelConfig { classes: 3, ..ModelConfig::of(Architecture::YoloV3Tiny) }.geometry(NetSize::square(416))
    }

    fn truth(x0: f64, y0: f64, x1: f64, y1: f64, class: u32) -> Truth {
        Truth::from_net_box(&PixelBox::from([x0, y0, x1, y1]), class, NetSize::square(416))
    }

    #[test]
    fn best_shape_over_all_heads_and_the_cell_of_the_centre() {
        let geometry = tiny();
        // 10 x 14 is anchor 0: the fine head (26 x 26). Centre (105, 57): column 6, row 3.
        let truths = [truth(100.0, 50.0, 110.0, 64.0, 1)];
        let positives = assign(&geometry, 0, &truths, 1.0).unwrap();
        assert_eq!(positives[0].at, Predictor { head: 1, anchor: 0, cell: 3 * 26 + 6 });
        let want = [105.0 / 16.0 - 6.0, 57.0 / 16.0 - 3.0, 0.0, 0.0];
        assert!(positives[0].target.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-5), "{:?}", positives[0].target);
    }

    #[test]
    fn later_truths_overwrite_the_box_and_add_their_class() {
        let truths = [truth(100.0, 100.0, 180.0, 180.0, 1), truth(101.0, 101.0, 183.0, 183.0, 2)];
        let geometry = tiny();
        let positives = assign(&geometry, 0, &truths, 1.0).unwrap();
        assert_eq!(positives.len(), 1);
        assert_eq!((positives[0].truth, positives[0].classes.as_slice()), (&truths[1], [1, 2].as_slice()));
    }

    #[test]
    fn a_centre_on_the_far_border_falls_into_the_last_cell() {
        let truths = [truth(400.0, 400.0, 432.0, 432.0, 0)];
        let geometry = tiny();
        let at = assign(&geometry, 0, &truths, 1.0).unwrap()[0].at;
        assert_eq!(at.cell, geometry.heads[at.head].cells() - 1);
    }

    #[test]
    fn labels_out_of_range_are_named() {
        let geometry = tiny();
        let good = truth(100.0, 100.0, 180.0, 180.0, 1);
        for (bad, words) in [
            (Truth { class: 3, ..good.clone() }, "class 3"),
            (Truth { bounds: NormBox { x: 1.5, ..good.bounds }, ..good.clone() }, "centre (1.5"),
            (Truth { bounds: NormBox { w: 0.0, ..good.bounds }, ..good.clone() }, "size 0"),
            (Truth { bounds: NormBox { h: f32::NAN, ..good.bounds }, ..good.clone() }, "NaN"),
        ] {
            let message = assign(&geometry, 4, &[good.clone(), bad], 1.0).unwrap_err().to_string();
            assert!(message.starts_with("image 4, box 1: ") && message.contains(words), "{message}");
        }
    }

    #[test]
    fn other_anchors_of_like_shape_learn_too() {
        let geometry = ModelConfig::of(Architecture::YoloV3).geometry(NetSize::square(416));
        let truths = [Truth { bounds: NormBox { x: 0.5, y: 0.5, w: 0.11, h: 0.14 }, class: 0, weight: 1.0, keypoints: Vec::new() }];
        let best = assign(&geometry, 0, &truths, 1.0).unwrap();
        assert_eq!(best.len(), 1);
        let more = assign(&geometry, 0, &truths, 0.4).unwrap();
        assert_eq!(more[0], best[0]);
        let wanted = (0..9).filter(|&a| shape_iou(&geometry, a, &truths[0].bounds) > 0.4).count();
        assert!(more.len() == wanted && wanted > 1, "{wanted}");
        // Each decodes back to the box from its own anchor.
        for p in &more {
            let [aw, ah] = geometry.anchor(p.at);
            assert!((p.target[2].exp() * aw - 0.11).abs() < 1e-5 && (p.target[3].exp() * ah - 0.14).abs() < 1e-5);
        }
    }

    #[test]
    fn cells_beside_learn_what_they_reach() {
        let geometry = Geometry { scale_xy: 2.0, ..tiny() };
        // Cell (6, 3) of the fine head, a quarter from its left and upper border: the cells left and above reach half a cell beyond it.
        let truths = [truth(95.0, 45.0, 105.0, 59.0, 1)];
        let positives = assign(&geometry, 0, &truths, 1.0).unwrap();
        let cells: Vec<usize> = positives.iter().map(|p| p.at.cell).collect();
        assert_eq!(cells, [3 * 26 + 6, 2 * 26 + 6, 3 * 26 + 5]);
        for p in &positives {
            let logit = |t: f32| (t / (1.0 - t)).ln();
            let b = geometry.decode_box(p.at, [logit(p.target[0]), logit(p.target[1]), p.target[2], p.target[3]]);
            assert!((b.x - truths[0].bounds.x).abs() < 1e-5 && (b.y - truths[0].bounds.y).abs() < 1e-5, "{b:?}");
        }
        // In a corner of the picture there is nothing beyond.
        assert_eq!(assign(&geometry, 0, &[truth(0.0, 0.0, 8.0, 8.0, 1)], 1.0).unwrap().len(), 1);
    }
}
