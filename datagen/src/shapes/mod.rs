//! The shapes of the paper in the unit frame, one a file. A new shape is one file and one line in each list below.
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

mod at_sign;
mod cross;
mod cross_in_rectangle;
mod empty_rectangle;
mod empty_triangle;
mod filled_rectangle;
mod filled_triangle;
mod framed_star;
mod star;
mod star_in_rectangle;
mod t_cross;
mod two_arms;

/// A point of the unit frame: (0, 0) is the first corner, x runs to the second, y to the fourth.
pub type UnitPoint = [f64; 2];

/// What a shape is made of. Coordinates are 0, 1/2 or 1 where the paper's protocol draws the shape, so that they fall on whole pixels.
#[derive(Debug, Clone, Copy)]
pub struct Geometry {
    /// The closed outline.
    pub outline: &'static [UnitPoint],
    /// True where the inside of the outline is filled.
    pub filled: bool,
    /// True where the outline itself is drawn as lines.
    pub framed: bool,
    /// Straight lines, each drawn from its first end to its second.
    pub lines: &'static [[UnitPoint; 2]],
    /// True where the shape looks different after each quarter turn, so that an angle can be read from it.
    pub oriented: bool,
}

/// The unit square, clockwise as seen, the stem's corner first.
pub const SQUARE: &[UnitPoint] = &[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];

/// A shape's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Shape {
    /// A filled rectangle with three lines from its centre to three corners: the marker.
    TCross,
    /// A filled rectangle.
    FilledRectangle,
    /// Four sides.
    EmptyRectangle,
    /// A filled triangle, apex up.
    FilledTriangle,
    /// Three sides, apex up.
    EmptyTriangle,
    /// Both diagonals, a vertical and a horizontal line.
    Star,
    /// A star and the four sides.
    FramedStar,
    /// The @ sign.
    AtSign,
    /// A star on a filled rectangle.
    StarInRectangle,
    /// Both diagonals on a filled rectangle.
    CrossInRectangle,
    /// Both diagonals alone (a near miss, not of the paper).
    Cross,
    /// A filled rectangle with two lines from its centre (a near miss, not of the paper).
    TwoArms,
}

impl Shape {
    /// All of them.
    pub const ALL: [Self; 12] = [
        Self::TCross,
        Self::FilledRectangle,
        Self::EmptyRectangle,
        Self::FilledTriangle,
        Self::EmptyTriangle,
        Self::Star,
        Self::FramedStar,
        Self::AtSign,
        Self::StarInRectangle,
        Self::CrossInRectangle,
        Self::Cross,
        Self::TwoArms,
    ];

    /// What it is made of.
    #[must_use]
    pub fn geometry(self) -> Geometry {
        match self {
            Self::TCross => t_cross::GEOMETRY,
            Self::FilledRectangle => filled_rectangle::GEOMETRY,
            Self::EmptyRectangle => empty_rectangle::GEOMETRY,
            Self::FilledTriangle => filled_triangle::GEOMETRY,
            Self::EmptyTriangle => empty_triangle::GEOMETRY,
            Self::Star => star::GEOMETRY,
            Self::FramedStar => framed_star::GEOMETRY,
            Self::AtSign => at_sign::GEOMETRY,
            Self::StarInRectangle => star_in_rectangle::GEOMETRY,
            Self::CrossInRectangle => cross_in_rectangle::GEOMETRY,
            Self::Cross => cross::GEOMETRY,
            Self::TwoArms => two_arms::GEOMETRY,
        }
    }

    /// The word used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::TCross => "t_cross",
            Self::FilledRectangle => "filled_rectangle",
            Self::EmptyRectangle => "empty_rectangle",
            Self::FilledTriangle => "filled_triangle",
            Self::EmptyTriangle => "empty_triangle",
            Self::Star => "star",
            Self::FramedStar => "framed_star",
            Self::AtSign => "at_sign",
            Self::StarInRectangle => "star_in_rectangle",
            Self::CrossInRectangle => "cross_in_rectangle",
            Self::Cross => "cross",
            Self::TwoArms => "two_arms",
        }
    }
}

impl std::str::FromStr for Shape {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|s| s.name() == text.replace('-', "_"));
        found.ok_or_else(|| format!("expected one of {}", Self::ALL.map(Self::name).join(", ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_files() {
        for shape in Shape::ALL {
            assert_eq!(serde_json::to_string(&shape).unwrap(), format!("\"{}\"", shape.name()));
        }
    }

    #[test]
    fn only_what_changes_with_a_quarter_turn_is_oriented() {
        let turned = |p: UnitPoint| [1.0 - p[1], p[0]];
        let same = |a: [UnitPoint; 2], b: [UnitPoint; 2]| a == b || (a[0] == b[1] && a[1] == b[0]);
        for shape in Shape::ALL {
            let g = shape.geometry();
            let lines_stay = g.lines.iter().all(|l| g.lines.iter().any(|m| same(l.map(turned), *m)));
            let outline_stays = g.outline.iter().all(|p| g.outline.contains(&turned(*p)));
            assert_eq!(g.oriented, !(lines_stay && outline_stays), "{}", shape.name());
        }
    }
}
