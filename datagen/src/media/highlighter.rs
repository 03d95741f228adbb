//! A highlighter: a broad translucent band that lets the surface through and darkens where bands overlap.
use super::Nature;

pub(super) const NATURE: Nature = Nature {
    opacity: 0.05,
    density: 0.9,
    nib: [0.12, 0.3],
    soft: 0.08,
    rim: 0.15,
    grain: 0.05,
    grain_size: 0.01,
    streaks: 0.15,
    uneven: 0.1,
    hand: 1.0,
    value: [0.85, 1.0],
    saturation: [0.6, 1.0],
};
