//! Where the cells and anchors of each head lie in an input of a given size.
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

impl Geometry {
    /// From each head's mask and stride, coarse first.
    pub fn new(net: NetSize, fields: BoxFields, anchors: Vec<[f32; 2]>, heads: impl IntoIterator<Item = (Vec<usize>, usize)>) -> Self {
        let head = |(mask, stride_px): (Vec<usize>, usize)| HeadGeometry {
            mask,
            stride_px,
            columns: net.width / stride_px,
            rows: net.height / stride_px,
        };
        Self { net, fields, anchors, heads: heads.into_iter().map(head).collect() }
    }

    /// Number of logits that a head gives for one image, in the order `[anchor, field, row, column]`.
    #[must_use]
    pub fn head_len(&self, head: usize) -> usize {
        self.heads[head].mask.len() * self.fields.len() * self.heads[head].cells()
    }
}
