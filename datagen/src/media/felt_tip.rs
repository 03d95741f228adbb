//! A felt tip: saturated ink that runs to the rim of each stroke.
use super::Nature;

pub(super) const NATURE: Nature = Nature {
    opacity: 0.35,
    density: 1.1,
    nib: [0.05, 0.16],
    soft: 0.06,
    rim: 0.25,
    grain: 0.05,
    grain_size: 0.008,
    streaks: 0.1,
    uneven: 0.12,
    hand: 1.0,
    value: [0.4, 1.0],
    saturation: [0.7, 1.0],
};
