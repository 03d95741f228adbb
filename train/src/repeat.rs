//! A training repeated with several seeds: what each came to, and how far they scatter.
use crate::{fit::RunSummary, run::history::Row};

/// The runs of one config under several seeds.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Repeats {
    /// Seed and outcome, in the order in which they ran.
    pub runs: Vec<(u64, RunSummary)>,
}

/// A column's name and how to read it from the row of the best weights.
type Column = (&'static str, fn(&Row) -> Option<f64>);

const COLUMNS: [Column; 9] = [
    ("epoch", |r| Some(r.epoch)),
    ("minutes", |r| Some(r.seconds / 60.0)),
    ("AP", |r| r.scores[0]),
    ("AP50", |r| r.scores[1]),
    ("mean IoU", |r| r.scores[2]),
    ("precision", |r| r.scores[3]),
    ("recall", |r| r.scores[4]),
    ("F1", |r| r.scores[5]),
    ("best F1", |r| r.scores[6]),
];

/// Mean and sample deviation (over n - 1); the deviation of a single value is not defined.
#[must_use]
pub fn mean_and_deviation(values: &[f64]) -> (f64, Option<f64>) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
    (mean, (values.len() > 1).then(|| (squares / (n - 1.0)).sqrt()))
}

impl RunSummary {
    /// The row of the weights that were kept as the best, else the last.
    #[must_use]
    pub fn best_row(&self) -> Option<&Row> {
        let rows = &self.history.rows;
        self.best.and_then(|(_, step)| rows.iter().find(|row| row.step == step)).or(rows.last())
    }
}

impl Repeats {
    /// A line a seed, then mean and deviation, each a cell a column; absent where it was not measured by every run.
    fn cells(&self) -> Vec<(String, Vec<Option<f64>>)> {
        let of_run = |(seed, run): &(u64, RunSummary)| (seed.to_string(), COLUMNS.map(|(_, of)| run.best_row().and_then(of)).to_vec());
        let mut lines: Vec<(String, Vec<Option<f64>>)> = self.runs.iter().map(of_run).collect();
        let spread = |k: usize| {
            let values: Option<Vec<f64>> = lines.iter().map(|(_, cells)| cells[k]).collect();
            values.filter(|v| !v.is_empty()).map(|v| mean_and_deviation(&v))
        };
        let spreads: Vec<_> = (0..COLUMNS.len()).map(spread).collect();
        lines.push(("mean".into(), spreads.iter().map(|s| s.map(|s| s.0)).collect()));
        lines.push(("deviation".into(), spreads.iter().map(|s| s.and_then(|s| s.1)).collect()));
        lines
    }

    /// The validation scores of each run's best weights with their mean and sample deviation, as a Markdown table.
    #[must_use]
    pub fn table(&self) -> String {
        let mut text = format!("| seed | {} |\n|", COLUMNS.map(|c| c.0).join(" | "));
        text += &"--:|".repeat(COLUMNS.len() + 1);
        for (name, cells) in self.cells() {
            let cell = |(k, v): (usize, &Option<f64>)| match (v, k) {
                (None, _) => "-".into(),
                (Some(v), 0 | 1) => format!("{v:.2}"),
                (Some(v), _) => format!("{v:.4}"),
            };
            let cells: Vec<String> = cells.iter().enumerate().map(cell).collect();
            text += &format!("\n| {name} | {} |", cells.join(" | "));
        }
        text + "\n"
    }

    /// The same with every digit, as CSV.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let mut text = format!("seed,{}\n", COLUMNS.map(|c| c.0.to_lowercase().replace(' ', "_")).join(","));
        for (name, cells) in self.cells() {
            let cells: Vec<String> = cells.iter().map(|v| v.map_or(String::new(), |v| v.to_string())).collect();
            text += &format!("{name},{}\n", cells.join(","));
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{fit::End, run::history::History};

    fn run(best: Option<(f64, u64)>, recalls: &[f64]) -> RunSummary {
        let row = |(k, recall): (usize, &f64)| Row {
            step: k as u64 + 1,
            seconds: 60.0 * (k + 1) as f64,
            scores: [None, None, None, None, Some(*recall), None, None],
            ..Row::default()
        };
        let history = History { rows: recalls.iter().enumerate().map(row).collect() };
        RunSummary { end: End::Finished, steps: recalls.len() as u64, epochs: 1.0, seconds: 1.0, best, history }
    }

    #[test]
    fn by_hand() {
        assert_eq!(mean_and_deviation(&[2.0, 4.0, 6.0]), (4.0, Some(2.0)));
        assert_eq!(mean_and_deviation(&[3.0]), (3.0, None));
        // The best row counts, not the last.
        let repeats = Repeats { runs: vec![(7, run(Some((0.5, 1)), &[0.5, 0.1])), (8, run(None, &[0.2, 0.7]))] };
        let table = repeats.table();
        let lines: Vec<&str> = table.lines().collect();
        assert_eq!(lines[2], "| 7 | 0.00 | 1.00 | - | - | - | - | 0.5000 | - | - |");
        assert_eq!(lines[3], "| 8 | 0.00 | 2.00 | - | - | - | - | 0.7000 | - | - |");
        assert_eq!(lines[4], "| mean | 0.00 | 1.50 | - | - | - | - | 0.6000 | - | - |");
        assert!(lines[5].starts_with("| deviation | 0.00 | 0.71 | - | - | - | - | 0.1414 |"), "{}", lines[5]);
        assert!(repeats.to_csv().contains("\nmean,0,1.5,,,,,0.6,,\n"), "{}", repeats.to_csv());
    }
}
