//! A printer: flat colour, ruled edges, no hand at all.
use super::Nature;

pub(super) const NATURE: Nature = Nature {
    opacity: 0.6,
    density: 1.6,
    nib: [0.05, 0.12],
    soft: 0.02,
    rim: 0.0,
    grain: 0.0,
    grain_size: 0.01,
    streaks: 0.0,
    uneven: 0.0,
    hand: 0.0,
    value: [0.4, 1.0],
    saturation: [0.7, 1.0],
};
