//! Distributions as people write them in a config: `"log 8..416"`, `"50% 0, 40% 0.02..0.15, 10% 0.15..0.4"`, `3`.
//!
//! One value carries its own sampler and its own cumulative distribution, so that the audit judges a dataset by the very
//! words that made it.
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::{borrow::Cow, fmt, str::FromStr};
use tcross_dataset::Rng;

/// One law of chance.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Law {
    Constant(f64),
    Uniform(f64, f64),
    Log(f64, f64),
    Int(i64, i64),
}

/// A distribution of one number: a weighted mixture of constants, uniform and log-uniform ranges and whole numbers.
///
/// Written as text: parts separated by commas, each with an optional weight in percent before it. A part is a number (`0`), a uniform
/// range (`0..75`), a log-uniform range (`log 8..416`) or uniform whole numbers with both ends in (`int 1..3`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Written", into = "String")]
pub struct Dist(Vec<(f64, Law)>);

/// What a config may hold: text, or a bare number for a constant.
#[derive(Deserialize)]
#[serde(untagged)]
enum Written {
    Number(f64),
    Text(String),
}

impl TryFrom<Written> for Dist {
    type Error = String;
    fn try_from(written: Written) -> Result<Self, String> {
        match written {
            Written::Number(value) => Ok(Self::constant(value)),
            Written::Text(text) => text.parse(),
        }
    }
}

impl Dist {
    /// Always `value`.
    #[must_use]
    pub fn constant(value: f64) -> Self {
        Self(vec![(1.0, Law::Constant(value))])
    }

    /// Uniform in [lo, hi).
    #[must_use]
    pub fn uniform(lo: f64, hi: f64) -> Self {
        Self(vec![(1.0, Law::Uniform(lo, hi))])
    }

    /// Log-uniform in [lo, hi), both positive.
    #[must_use]
    pub fn log(lo: f64, hi: f64) -> Self {
        Self(vec![(1.0, Law::Log(lo, hi))])
    }

    /// Uniform whole numbers, both ends in.
    #[must_use]
    pub fn int(lo: i64, hi: i64) -> Self {
        Self(vec![(1.0, Law::Int(lo, hi))])
    }

    /// Draws a value.
    pub fn sample(&self, rng: &mut Rng) -> f64 {
        let part = if self.0.len() == 1 { 0 } else { rng.weighted(&self.0.iter().map(|p| p.0).collect::<Vec<_>>()) };
        match self.0[part].1 {
            Law::Constant(value) => value,
            Law::Uniform(lo, hi) => rng.uniform(lo, hi),
            Law::Log(lo, hi) => rng.log_uniform(lo, hi),
            Law::Int(lo, hi) => rng.int(lo, hi) as f64,
        }
    }

    /// The probability of a value of at most `x`.
    #[must_use]
    pub fn cdf(&self, x: f64) -> f64 {
        let total: f64 = self.0.iter().map(|p| p.0).sum();
        let of = |law: Law| match law {
            Law::Constant(value) => f64::from(u8::from(x >= value)),
            Law::Uniform(lo, hi) if hi > lo => ((x - lo) / (hi - lo)).clamp(0.0, 1.0),
            Law::Log(lo, hi) if hi > lo && x > 0.0 => ((x / lo).ln() / (hi / lo).ln()).clamp(0.0, 1.0),
            Law::Log(lo, hi) if hi > lo => 0.0,
            Law::Uniform(lo, _) | Law::Log(lo, _) => f64::from(u8::from(x >= lo)),
            Law::Int(lo, hi) => ((x.floor() - lo as f64 + 1.0) / (hi - lo + 1) as f64).clamp(0.0, 1.0),
        };
        self.0.iter().map(|&(weight, law)| weight * of(law)).sum::<f64>() / total
    }

    /// True where values may repeat exactly, so that a continuous test of fit does not apply.
    #[must_use]
    pub fn has_atoms(&self) -> bool {
        self.0.iter().any(|(_, law)| match *law {
            Law::Constant(_) | Law::Int(..) => true,
            Law::Uniform(lo, hi) | Law::Log(lo, hi) => lo == hi,
        })
    }

    /// The values with a probability of their own, and that probability.
    #[must_use]
    pub fn atoms(&self) -> Vec<(f64, f64)> {
        let total: f64 = self.0.iter().map(|p| p.0).sum();
        let mut atoms: Vec<(f64, f64)> = Vec::new();
        for &(weight, law) in &self.0 {
            match law {
                Law::Constant(value) => atoms.push((value, weight / total)),
                Law::Int(lo, hi) => atoms.extend((lo..=hi).map(|v| (v as f64, weight / total / (hi - lo + 1) as f64))),
                Law::Uniform(lo, hi) | Law::Log(lo, hi) if lo == hi => atoms.push((lo, weight / total)),
                Law::Uniform(..) | Law::Log(..) => {}
            }
        }
        atoms.sort_by(|a, b| a.0.total_cmp(&b.0));
        atoms.dedup_by(|next, kept| {
            let same = next.0 == kept.0;
            if same {
                kept.1 += next.1;
            }
            same
        });
        atoms
    }

    /// The smallest and the largest possible value.
    #[must_use]
    pub fn bounds(&self) -> (f64, f64) {
        self.0.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), (_, law)| {
            let (lo, hi) = match *law {
                Law::Constant(v) => (v, v),
                Law::Uniform(lo, hi) | Law::Log(lo, hi) => (lo, hi),
                Law::Int(lo, hi) => (lo as f64, hi as f64),
            };
            (min.min(lo), max.max(hi))
        })
    }
}

impl FromStr for Dist {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = |part: &str| {
            format!(
                "cannot read '{part}' in distribution \"{text}\": expected a number, 'a..b', 'log a..b' or 'int a..b', each with an optional weight such as '20%'"
            )
        };
        let number = |word: &str| word.trim().parse::<f64>().ok().filter(|v| v.is_finite());
        let weighted = text.split(',').filter(|part| part.contains('%')).count();
        if weighted > 0 && weighted < text.split(',').count() {
            return Err(format!("some parts of distribution \"{text}\" have a weight and some have none; give each one its '%', or none"));
        }
        let mut parts = Vec::new();
        for part in text.split(',') {
            let (weight, rest) = match part.split_once('%') {
                Some((weight, rest)) => (number(weight).filter(|w| *w >= 0.0).ok_or_else(|| wrong(part))?, rest),
                None => (1.0, part),
            };
            let (word, range) = rest.trim().split_once(' ').unwrap_or(("", rest.trim()));
            let law = match (word, range.split_once("..")) {
                ("", None) => Law::Constant(number(range).ok_or_else(|| wrong(part))?),
                ("" | "uniform" | "log" | "int", Some((lo, hi))) => {
                    let (lo, hi) = number(lo).zip(number(hi)).filter(|(lo, hi)| lo <= hi).ok_or_else(|| wrong(part))?;
                    match word {
                        "log" if lo > 0.0 => Law::Log(lo, hi),
                        "log" => return Err(format!("a log range must be positive, found '{}' in \"{text}\"", part.trim())),
                        "int" if lo.fract() == 0.0 && hi.fract() == 0.0 => Law::Int(lo as i64, hi as i64),
                        "int" => return Err(format!("an int range has whole ends, found '{}' in \"{text}\"", part.trim())),
                        _ => Law::Uniform(lo, hi),
                    }
                }
                _ => return Err(wrong(part)),
            };
            parts.push((weight, law));
        }
        if parts.iter().all(|p| p.0 == 0.0) {
            return Err(format!("all weights are zero in distribution \"{text}\""));
        }
        Ok(Self(parts))
    }
}

impl fmt::Display for Dist {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (k, (weight, law)) in self.0.iter().enumerate() {
            if k > 0 {
                f.write_str(", ")?;
            }
            if self.0.len() > 1 {
                write!(f, "{weight}% ")?;
            }
            match law {
                Law::Constant(v) => write!(f, "{v}")?,
                Law::Uniform(lo, hi) => write!(f, "{lo}..{hi}")?,
                Law::Log(lo, hi) => write!(f, "log {lo}..{hi}")?,
                Law::Int(lo, hi) => write!(f, "int {lo}..{hi}")?,
            }
        }
        Ok(())
    }
}

impl From<Dist> for String {
    fn from(dist: Dist) -> Self {
        dist.to_string()
    }
}

impl JsonSchema for Dist {
    fn schema_name() -> Cow<'static, str> {
        "Dist".into()
    }
    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": ["string", "number"] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_round_trips() {
        for text in ["3", "0..75", "log 8..416", "int 1..3", "50% 0, 40% 0.02..0.15, 10% log 0.15..0.4", "-18..18"] {
            let dist: Dist = text.parse().unwrap();
            assert_eq!(dist.to_string(), text);
        }
        for bad in ["", "8..", "log 0..5", "5..1", "a", "0% 3", "nan", "often 1..2"] {
            assert!(bad.parse::<Dist>().is_err(), "{bad}");
        }
    }

    #[test]
    fn draws_follow_the_cdf() {
        // Kolmogorov's distance of 4000 draws stays under 1.63/sqrt(n) (one in a hundred), and far under it for the wrong law.
        let distance = |dist: &Dist, law: &Dist| {
            let mut rng = Rng::for_item(3, "test/dist", 0);
            let mut draws: Vec<f64> = (0..4000).map(|_| dist.sample(&mut rng)).collect();
            draws.sort_by(f64::total_cmp);
            draws.iter().enumerate().map(|(k, x)| (law.cdf(*x) - (k as f64 + 0.5) / 4000.0).abs()).fold(0.0, f64::max)
        };
        let (log, flat): (Dist, Dist) = ("30% log 8..416, 70% 20..40".parse().unwrap(), Dist::uniform(8.0, 416.0));
        assert!(distance(&log, &log) < 1.63 / 63.0);
        assert!(distance(&log, &flat) > 0.2);
    }

    #[test]
    fn atoms_are_found() {
        let dist: Dist = "50% 0, 50% int 0..1".parse().unwrap();
        assert_eq!(dist.atoms(), vec![(0.0, 0.75), (1.0, 0.25)]);
        assert_eq!((dist.cdf(-1.0), dist.cdf(0.0), dist.cdf(1.0)), (0.0, 0.75, 1.0));
    }
}
