//! What one box of a head carries, and where.
use std::ops::Range;

/// The numbers a head gives for each anchor of each cell, in this order: x, y, w, h, objectness, one a class, two a keypoint.
///
/// The network's body, the assignment and the decoding of the box itself ask only this type where things stand, so a new kind of
/// number is added here, in [`crate::loss`] and in [`crate::decode`], and nowhere else.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BoxFields {
    /// Number of classes, at least 1.
    pub classes: usize,
    /// Number of points in the image, such as a centre and four corners; 0 in plain YOLOv3.
    pub keypoints: usize,
}

impl BoxFields {
    /// Index of the objectness, right behind the four numbers of the box.
    pub const OBJECTNESS: usize = 4;

    /// Plain YOLOv3: a box, an objectness, classes.
    #[must_use]
    pub fn plain(classes: usize) -> Self {
        Self { classes, keypoints: 0 }
    }

    /// How many numbers an anchor has in each cell.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "never empty: a box and its objectness are always there")]
    pub fn len(&self) -> usize {
        5 + self.classes + 2 * self.keypoints
    }

    /// Where the class logits stand.
    #[must_use]
    pub fn classes(&self) -> Range<usize> {
        5..5 + self.classes
    }

    /// Where a keypoint's x and y stand.
    #[must_use]
    pub fn keypoint(&self, index: usize) -> Range<usize> {
        let start = 5 + self.classes + 2 * index;
        start..start + 2
    }
}
