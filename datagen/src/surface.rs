//! What a marker is drawn on: sheets with their colours, lines and grain, or the photo's own surface.
use crate::{
    color::{self, Linear},
    dist::Dist,
    noise::{Spectrum, Tile},
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tcross_dataset::Rng;

/// What a marker is drawn on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Surface {
    /// Straight onto whatever the photo shows.
    Photo,
    /// White paper.
    White,
    /// Ruled paper.
    Ruled,
    /// Squared paper.
    Squared,
    /// Brown wrapping paper.
    Brown,
    /// Coloured card.
    Card,
    /// A blackboard or a dark card.
    Board,
    /// A painted wall or a whiteboard.
    Wall,
    /// The grains of a road or a pavement.
    Asphalt,
}

impl Surface {
    /// All of them.
    pub const ALL: [Self; 9] =
        [Self::Photo, Self::White, Self::Ruled, Self::Squared, Self::Brown, Self::Card, Self::Board, Self::Wall, Self::Asphalt];

    /// The word used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Photo => "photo",
            Self::White => "white",
            Self::Ruled => "ruled",
            Self::Squared => "squared",
            Self::Brown => "brown",
            Self::Card => "card",
            Self::Board => "board",
            Self::Wall => "wall",
            Self::Asphalt => "asphalt",
        }
    }

    /// True for what bends and has an edge of its own; the others are parts of something larger.
    #[must_use]
    pub fn is_paper(self) -> bool {
        matches!(self, Self::White | Self::Ruled | Self::Squared | Self::Brown | Self::Card)
    }
}

/// One sheet, ready to be asked for its colour anywhere.
#[derive(Debug, Clone)]
pub struct Sheet {
    /// Reflectance of the plain sheet.
    pub base: Linear,
    /// Margins around the marker's rectangle, in sides: left, top, right, bottom; `None` where there is no sheet.
    pub margins: Option<[f32; 4]>,
    /// What was drawn for them from the config, in sides.
    pub margin: Option<f64>,
    /// Width over which the sheet fades into its surroundings, in sides; 0 for paper, whose edge is cut.
    pub fade: f32,
    /// The shadow that a sheet casts on what it lies on.
    pub cast: Option<Cast>,
    rule: Option<Rule>,
    grain: f32,
    spectrum: Spectrum,
    offset: [f32; 2],
}

/// The shadow around a sheet. Lengths are in sides of the marker.
#[derive(Debug, Clone, Copy)]
pub struct Cast {
    /// Where it falls, from the sheet.
    pub shift: [f32; 2],
    /// Half the width of its soft edge.
    pub soft: f32,
    /// What part of the light it takes, 0..1.
    pub depth: f32,
}

impl Cast {
    /// How far it reaches beyond the sheet.
    #[must_use]
    pub fn reach(&self) -> f32 {
        self.soft + self.shift[0].abs().max(self.shift[1].abs())
    }
}

/// Texels of grain a side of the marker.
const TEXELS: f32 = 120.0;

#[derive(Debug, Clone)]
struct Rule {
    color: Linear,
    period: f32,
    width: f32,
    phase: [f32; 2],
    squared: bool,
}

impl Sheet {
    /// Draws the sheet's own properties; each of its four margins is `margin` times 0.6 to 1.6.
    pub fn sample(surface: Surface, margin: &Dist, rng: &mut Rng) -> Self {
        let white = || color::from_hsv(45.0, 0.03, 0.94);
        let base = match surface {
            Surface::Photo => [0.5; 3],
            Surface::White | Surface::Ruled | Surface::Squared => {
                color::scaled(color::mix(white(), color::from_hsv(rng.uniform(0.0, 360.0), 0.08, 0.95), 0.5), rng.uniform(0.8, 1.0) as f32)
            }
            Surface::Brown => color::from_hsv(rng.uniform(25.0, 38.0), rng.uniform(0.3, 0.5), rng.uniform(0.55, 0.78)),
            Surface::Card => color::from_hsv(rng.uniform(0.0, 360.0), rng.uniform(0.1, 0.5), rng.uniform(0.75, 0.98)),
            Surface::Board => color::from_hsv(rng.uniform(0.0, 360.0), rng.uniform(0.0, 0.4), rng.uniform(0.12, 0.3)),
            Surface::Wall => color::from_hsv(rng.uniform(20.0, 220.0), rng.uniform(0.0, 0.15), rng.uniform(0.7, 0.97)),
            Surface::Asphalt => color::from_hsv(rng.uniform(20.0, 240.0), rng.uniform(0.0, 0.12), rng.uniform(0.25, 0.6)),
        };
        // A patch of a wall or a road is larger than a sheet and ends in a stain, not in a cut.
        let fade = if matches!(surface, Surface::Wall | Surface::Asphalt) { rng.uniform(0.05, 0.4) as f32 } else { 0.0 };
        let margin = (surface != Surface::Photo).then(|| margin.sample(rng));
        let margins = margin.map(|even| std::array::from_fn(|_| (even * rng.uniform(0.6, 1.6)) as f32 + fade));
        let ruled = matches!(surface, Surface::Ruled | Surface::Squared);
        let period = rng.log_uniform(0.05, 0.3) as f32;
        let blue = color::from_hsv(rng.uniform(190.0, 250.0), rng.uniform(0.2, 0.7), 0.75);
        let color = if rng.chance(0.7) { blue } else { color::from_hsv(0.0, 0.0, 0.6) };
        let rule = Rule {
            color,
            period,
            width: period * rng.uniform(0.04, 0.1) as f32,
            phase: [rng.unit() as f32, rng.unit() as f32],
            squared: surface == Surface::Squared,
        };
        Self {
            base,
            margins,
            margin,
            fade,
            rule: ruled.then_some(rule),
            // Paper is even but for its fibres; walls and boards have clouds and scratches.
            grain: (match surface {
                Surface::Photo => 0.0,
                Surface::White | Surface::Ruled | Surface::Squared | Surface::Card => rng.uniform(0.0, 0.025),
                Surface::Brown | Surface::Wall => rng.uniform(0.03, 0.08),
                Surface::Board => rng.uniform(0.03, 0.15),
                Surface::Asphalt => rng.uniform(0.2, 0.5),
            }) as f32,
            spectrum: match surface {
                Surface::Wall | Surface::Board => *rng.choose(&[Spectrum::Soft, Spectrum::Pink, Spectrum::Rough]),
                Surface::Brown => *rng.choose(&[Spectrum::Rough, Spectrum::Grain]),
                _ => Spectrum::Rough,
            },
            cast: (surface.is_paper() && rng.chance(0.75)).then(|| {
                let (angle, far) = (rng.uniform(0.0, std::f64::consts::TAU), rng.uniform(0.0, 0.025));
                let soft = (far * rng.uniform(0.5, 1.5) + rng.uniform(0.004, 0.02)) as f32;
                Cast {
                    shift: [(far * libm::cos(angle)) as f32, (far * libm::sin(angle)) as f32],
                    soft,
                    depth: rng.uniform(0.15, 0.65) as f32,
                }
            }),
            offset: [rng.uniform(0.0, 256.0) as f32, rng.uniform(0.0, 256.0) as f32],
        }
    }

    /// The reflectance at a place in sides of the marker; `footprint` is the size of a pixel there.
    #[must_use]
    pub fn at(&self, x: f32, y: f32, footprint: f32) -> Linear {
        let mut color = self.base;
        if let Some(rule) = &self.rule {
            // How much of the pixel a line covers: the line's width over the pixel's, never below what a thin line adds.
            let cover = |v: f32, phase: f32| {
                let from_line = ((v / rule.period + phase).fract().abs() - 0.5).abs() * rule.period;
                ((rule.width * 0.5 - from_line) / footprint + 0.5).clamp(0.0, 1.0).min(rule.width / footprint)
            };
            let mut ink = cover(y, rule.phase[1]);
            if rule.squared {
                ink = ink.max(cover(x, rule.phase[0]));
            }
            color = color::mix(color, rule.color, ink);
        }
        let noise = Tile::of(self.spectrum).smooth(x * TEXELS + self.offset[0], y * TEXELS + self.offset[1]);
        // A pixel that sees many grains sees their mean.
        let grain = self.grain / (footprint * TEXELS / 2.0).max(1.0);
        color::scaled(color, (1.0 + grain * noise.clamp(-3.0, 3.0)).max(0.0))
    }
}
