//! Where the cells and anchors of each head lie in an input of a given size, and what their logits mean as boxes.
use crate::{config::NetSize, fields::BoxFields};

/// Grids, anchors and fields: what assignment, losses and decoding need to know about a network.
#[derive(Debug, Clone, PartialEq)]
pub struct Geometry {
    /// Input size in pixels.
    pub net: NetSize,
    /// What a box carries.
    pub fields: BoxFields,
    /// `[width, height]` in net-input pixels.
    pub anchors: Vec<[f32; 2]>,
    /// The heads, coarse first.
    pub heads: Vec<HeadGeometry>,
    /// Length, in cells, of the interval around a cell's middle in which its centres lie; 1 in YOLOv3.
    pub scale_xy: f32,
}

/// One head's grid.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HeadGeometry {
    /// Indices into the anchors.
    pub mask: Vec<usize>,
    /// Side of a cell in net-input pixels.
    pub stride_px: usize,
    /// Cells across.
    pub columns: usize,
    /// Cells down.
    pub rows: usize,
}

impl HeadGeometry {
    /// Number of cells.
    #[must_use]
    pub fn cells(&self) -> usize {
        self.columns * self.rows
    }
}

/// One anchor of one cell of one head.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Predictor {
    /// Index of the head, coarse first.
    pub head: usize,
    /// Index of the anchor within the head.
    pub anchor: usize,
    /// `row * columns + column`.
    pub cell: usize,
}

/// A box as centre and size, in fractions of the network's input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormBox {
    /// Centre.
    pub x: f32,
    /// Centre.
    pub y: f32,
    /// Width.
    pub w: f32,
    /// Height.
    pub h: f32,
}

impl NormBox {
    /// Intersection over union; 0 where both are empty, NaN where one is not finite.
    #[must_use]
    pub fn iou(&self, other: &Self) -> f32 {
        let overlap = |a: f32, la: f32, b: f32, lb: f32| ((a + la / 2.0).min(b + lb / 2.0) - (a - la / 2.0).max(b - lb / 2.0)).max(0.0);
        let both = overlap(self.x, self.w, other.x, other.w) * overlap(self.y, self.h, other.y, other.h);
        let union = self.w * self.h + other.w * other.h - both;
        if union > 0.0 { both / union } else { 0.0 }
    }
}

/// The logistic function.
#[must_use]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

impl Geometry {
    /// YOLOv3's, from each head's mask and stride, coarse first.
    pub fn new(net: NetSize, fields: BoxFields, anchors: Vec<[f32; 2]>, heads: impl IntoIterator<Item = (Vec<usize>, usize)>) -> Self {
        let head = |(mask, stride_px): (Vec<usize>, usize)| HeadGeometry {
            mask,
            stride_px,
            columns: net.width / stride_px,
            rows: net.height / stride_px,
        };
        Self { net, fields, anchors, heads: heads.into_iter().map(head).collect(), scale_xy: 1.0 }
    }

    /// Number of logits that a head gives for one image, in the order `[anchor, field, row, column]`.
    #[must_use]
    pub fn head_len(&self, head: usize) -> usize {
        self.heads[head].mask.len() * self.fields.len() * self.heads[head].cells()
    }

    /// Where a field of a predictor stands among its head's logits of one image.
    #[must_use]
    pub fn index(&self, at: Predictor, field: usize) -> usize {
        (at.anchor * self.fields.len() + field) * self.heads[at.head].cells() + at.cell
    }

    /// Width and height of a predictor's anchor, in fractions of the input.
    #[must_use]
    pub fn anchor(&self, at: Predictor) -> [f32; 2] {
        let [w, h] = self.anchors[self.heads[at.head].mask[at.anchor]];
        [w / self.net.width as f32, h / self.net.height as f32]
    }

    /// The box that a predictor's first four logits mean:
    /// `((column + s(tx)) / columns, (row + s(ty)) / rows, exp(tw) anchor_w, exp(th) anchor_h)`, with the sigmoid stretched about 1/2:
    /// `s(t) = 1/2 + scale_xy (sigmoid(t) - 1/2)`.
    #[must_use]
    pub fn decode_box(&self, at: Predictor, [tx, ty, tw, th]: [f32; 4]) -> NormBox {
        let head = &self.heads[at.head];
        let (column, row) = (at.cell % head.columns, at.cell / head.columns);
        let [aw, ah] = self.anchor(at);
        NormBox {
            x: (column as f32 + self.stretched(sigmoid(tx))) / head.columns as f32,
            y: (row as f32 + self.stretched(sigmoid(ty))) / head.rows as f32,
            w: tw.exp() * aw,
            h: th.exp() * ah,
        }
    }

    fn stretched(&self, sigmoid: f32) -> f32 {
        0.5 + self.scale_xy * (sigmoid - 0.5)
    }

    /// The value of the sigmoid, 0..1, that means this place relative to a cell's upper left corner, in cells; outside 0..1 where the cell
    /// cannot reach it.
    #[must_use]
    pub fn sigmoid_of(&self, within: f32) -> f32 {
        0.5 + (within - 0.5) / self.scale_xy
    }

    /// A predictor's first four logits.
    #[must_use]
    pub fn box_logits(&self, at: Predictor, logits: &[f32]) -> [f32; 4] {
        std::array::from_fn(|field| logits[self.index(at, field)])
    }

    /// The middle of a predictor's cell, in fractions of the input: keypoints count from it, in units of the anchor.
    #[must_use]
    pub fn cell_center(&self, at: Predictor) -> [f32; 2] {
        let head = &self.heads[at.head];
        [((at.cell % head.columns) as f32 + 0.5) / head.columns as f32, ((at.cell / head.columns) as f32 + 0.5) / head.rows as f32]
    }

    /// Every predictor of a head, in the order of its objectness logits.
    pub fn predictors(&self, head: usize) -> impl Iterator<Item = Predictor> + '_ {
        let grid = &self.heads[head];
        (0..grid.mask.len()).flat_map(move |anchor| (0..grid.cells()).map(move |cell| Predictor { head, anchor, cell }))
    }
}
