//! A ball pen: thin lines laid close, with blobs and skips.
use super::Nature;

pub(super) const NATURE: Nature = Nature {
    opacity: 0.5,
    density: 1.2,
    nib: [0.02, 0.05],
    soft: 0.25,
    rim: -0.2,
    grain: 0.15,
    grain_size: 0.006,
    streaks: 0.2,
    uneven: 0.35,
    hand: 1.0,
    value: [0.2, 0.8],
    saturation: [0.7, 1.0],
};
