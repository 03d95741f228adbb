//! A dry-erase pen: a thin film that leaves light middles and dark rims.
use super::Nature;

pub(super) const NATURE: Nature = Nature {
    opacity: 0.4,
    density: 0.9,
    nib: [0.05, 0.14],
    soft: 0.08,
    rim: 0.35,
    grain: 0.03,
    grain_size: 0.02,
    streaks: 0.3,
    uneven: 0.3,
    hand: 1.0,
    value: [0.3, 0.95],
    saturation: [0.7, 1.0],
};
