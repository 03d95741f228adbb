//! A wax crayon: it catches only the raised grain of the paper.
use super::Nature;

pub(super) const NATURE: Nature = Nature {
    opacity: 0.55,
    density: 1.1,
    nib: [0.05, 0.14],
    soft: 0.35,
    rim: 0.0,
    grain: 0.55,
    grain_size: 0.012,
    streaks: 0.2,
    uneven: 0.3,
    hand: 1.0,
    value: [0.5, 1.0],
    saturation: [0.6, 1.0],
};
