//! Chalk: an opaque powder on the raised grain, soft at its edges.
use super::Nature;

pub(super) const NATURE: Nature = Nature {
    opacity: 0.9,
    density: 0.95,
    nib: [0.06, 0.15],
    soft: 0.5,
    rim: -0.1,
    grain: 0.5,
    grain_size: 0.01,
    streaks: 0.3,
    uneven: 0.35,
    hand: 1.0,
    value: [0.8, 1.0],
    saturation: [0.35, 0.8],
};
