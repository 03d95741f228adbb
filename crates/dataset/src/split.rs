//! Train, validation and test.
use serde::{Deserialize, Serialize};
use std::{fmt, str::FromStr};

/// One of the three parts of a dataset, 7 : 2 : 1. Validation chooses, test is reported once.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// What the network learns from.
    Train,
    /// What checkpoints and thresholds are chosen on.
    Val,
    /// What is reported.
    Test,
}

impl Split {
    /// All three, in the order in which a dataset is written.
    pub const ALL: [Self; 3] = [Self::Train, Self::Val, Self::Test];

    /// The paper's split of photo `index` (0-based): `index mod 10` in 0-6 train, 7-8 validation, 9 test.
    #[must_use]
    pub fn of(index: usize) -> Self {
        match index % 10 {
            0..=6 => Self::Train,
            7 | 8 => Self::Val,
            _ => Self::Test,
        }
    }

    /// The word used in paths: `train`, `val` or `test`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Val => "val",
            Self::Test => "test",
        }
    }
}

impl fmt::Display for Split {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Split {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|k| k.name() == s).ok_or_else(|| format!("unknown split '{s}': expected train, val or test"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_counts() {
        let count = |s| (0..10_797).filter(|&i| Split::of(i) == s).count();
        assert_eq!(Split::ALL.map(count), [7560, 2158, 1079]);
    }
}
