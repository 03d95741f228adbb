//! Paint: it hides what is below and keeps the streaks of the brush.
use super::Nature;

pub(super) const NATURE: Nature = Nature {
    opacity: 0.97,
    density: 1.3,
    nib: [0.08, 0.25],
    soft: 0.1,
    rim: 0.1,
    grain: 0.08,
    grain_size: 0.02,
    streaks: 0.45,
    uneven: 0.15,
    hand: 1.0,
    value: [0.35, 1.0],
    saturation: [0.7, 1.0],
};
