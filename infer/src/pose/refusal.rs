//! Why no pose is claimed: an answer, not a failure.

/// The reason for giving no pose. Its text is what stands in `{"refused": "reason"}`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// A number of the box is not finite, or its sides are reversed.
    #[error("no box: its numbers are not finite or reversed")]
    NoBox,
    /// The box has no area.
    #[error("box of no area")]
    NoArea,
    /// The box and the image do not overlap.
    #[error("box outside the image")]
    Outside,
    /// Too few pixels for a T cross.
    #[error("too small")]
    TooSmall,
    /// Everything in and around the box has one colour.
    #[error("one colour")]
    OneColour,
    /// A corner lies beyond the image's border.
    #[error("cut by the border")]
    CutByBorder,
    /// A part of the outline is hidden.
    #[error("occluded")]
    Occluded,
    /// Nothing four-sided stands out from its surroundings.
    #[error("no marker: nothing four-sided stands out")]
    NoOutline,
    /// A quadrilateral without three lines from its middle.
    #[error("no marker: no T cross inside")]
    NoCross,
    /// The half diagonal without a line cannot be told from the others.
    #[error("ambiguous: the stem cannot be told")]
    Ambiguous,
    /// A pose was read, of a lower quality than is asked for.
    #[error("unsure: quality below min_quality")]
    Unsure,
}
