//! What a marker is drawn with, one medium a file. A new medium is one file and one line in each list below.
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

mod ball_pen;
mod chalk;
mod crayon;
mod dry_erase;
mod felt_tip;
mod highlighter;
mod paint;
mod print;

/// How a medium leaves its colour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nature {
    /// 0 filters the light of what lies below (a highlighter), 1 hides it (paint).
    pub opacity: f32,
    /// How deep one translucent layer is; 1 is the colour as named, 2 that of two layers.
    pub density: f32,
    /// Width of the nib as a fraction of the marker's side, for fills: smallest and largest.
    pub nib: [f64; 2],
    /// Softness of a stroke's edge as a fraction of its radius.
    pub soft: f32,
    /// How much darker the rim of a stroke is than its middle (ink that runs outwards), or lighter if negative.
    pub rim: f32,
    /// How much of the surface's grain stays bare, 0..1.
    pub grain: f32,
    /// Size of that grain in marker sides.
    pub grain_size: f32,
    /// Streaks along the stroke, 0..1.
    pub streaks: f32,
    /// How unevenly the colour comes, along and between strokes, 0..1.
    pub uneven: f32,
    /// 1 for a hand, 0 for a machine: scales wobble, gaps and missed ends.
    pub hand: f64,
    /// Range of brightness (value) of the colours it comes in.
    pub value: [f64; 2],
    /// Range of saturation of the colours it comes in.
    pub saturation: [f64; 2],
}

/// The name of a medium.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Medium {
    /// Translucent, broad, bright; overlaps darken.
    Highlighter,
    /// Saturated, with darker rims.
    FeltTip,
    /// Thin lines, dense hatching.
    BallPen,
    /// Waxy, the paper's grain shows.
    Crayon,
    /// Powdery and opaque, at home on dark boards.
    Chalk,
    /// Opaque, with streaks of the brush.
    Paint,
    /// Thin even film with light middles.
    DryErase,
    /// Clean, flat, ruled: a printer.
    Print,
}

impl Medium {
    /// All of them.
    pub const ALL: [Self; 8] =
        [Self::Highlighter, Self::FeltTip, Self::BallPen, Self::Crayon, Self::Chalk, Self::Paint, Self::DryErase, Self::Print];

    /// How it leaves its colour.
    #[must_use]
    pub fn nature(self) -> Nature {
        match self {
            Self::Highlighter => highlighter::NATURE,
            Self::FeltTip => felt_tip::NATURE,
            Self::BallPen => ball_pen::NATURE,
            Self::Crayon => crayon::NATURE,
            Self::Chalk => chalk::NATURE,
            Self::Paint => paint::NATURE,
            Self::DryErase => dry_erase::NATURE,
            Self::Print => print::NATURE,
        }
    }

    /// The word used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Highlighter => "highlighter",
            Self::FeltTip => "felt_tip",
            Self::BallPen => "ball_pen",
            Self::Crayon => "crayon",
            Self::Chalk => "chalk",
            Self::Paint => "paint",
            Self::DryErase => "dry_erase",
            Self::Print => "print",
        }
    }
}
