//! `[[expect]]`: what a result should be, beside what it is.
use super::Row;
use crate::config::{Config, Expect};
use serde_json::Value;
use tcross_eval::table::{Cell, Table};

/// Segments of a metric's path that say: less is better.
const LESS_IS_BETTER: [&str; 20] = [
    "fp",
    "fn",
    "percent_fn",
    "duplicates",
    "fp_per_image",
    "fp_per_1000_without_marker",
    "ece",
    "errors",
    "problems",
    "center_percent",
    "center_px",
    "angle_deg",
    "corner_percent",
    "corner_px",
    "wrong_orientation",
    "missed",
    "refused",
    "reasons",
    "false_poses",
    "ms",
];

/// One expected result of one row.
pub struct Expectation<'a> {
    row: &'a str,
    expect: &'a Expect,
    /// `None` if the metrics hold no such number.
    found: Option<f64>,
}

/// Every expected result of every row that it is about.
pub fn expectations<'a>(config: &'a Config, rows: &'a [Row], metrics: &Value) -> Vec<Expectation<'a>> {
    let mut out = Vec::new();
    for expect in &config.expect {
        for row in rows.iter().filter(|r| expect.run.as_ref().is_none_or(|n| *n == r.name)) {
            let found = block_of(metrics, &row.name).and_then(|block| look_up(block, expect));
            out.push(Expectation { row: &row.name, expect, found });
        }
    }
    out
}

/// What the metrics say of a run: the block of its name, or all of it where one run is all there is.
fn block_of<'a>(metrics: &'a Value, run: &str) -> Option<&'a Value> {
    let named = |blocks: &'a Value, key: &str| blocks.as_array()?.iter().find(|b| b[key] == run);
    let several = ["runs", "sweeps"].iter().any(|key| metrics[*key].is_array()) || metrics["compare"].is_object();
    let found = named(&metrics["runs"], "name")
        .or_else(|| named(&metrics["compare"]["files"], "name"))
        .or_else(|| named(&metrics["sweeps"], "run"));
    found.or((!several || metrics["paper"].is_object()).then_some(metrics))
}

/// A number of a run's metrics: a path, or a word of the headline row.
fn look_up(block: &Value, expect: &Expect) -> Option<f64> {
    let path = |from: &Value, metric: &str| {
        let step = |at: &Value, key: &str| match at {
            Value::Array(items) => items.get(key.parse::<usize>().ok()?).cloned(),
            other => other.get(key).cloned(),
        };
        metric.split('.').try_fold(from.clone(), |at, key| step(&at, key)).and_then(|v| v.as_f64())
    };
    let Some(side) = expect.min_side_px else {
        return path(block, &expect.metric).or_else(|| path(&block["paper"]["headline"], &expect.metric));
    };
    let sizes = block["paper"]["min_side"].as_array()?;
    let size = sizes.iter().find(|s| s["min_side_px"].as_f64() == Some(side))?;
    path(&size["headline"], &expect.metric).or_else(|| path(size, &expect.metric))
}

impl Expectation<'_> {
    /// True where less is better.
    fn less(&self) -> bool {
        self.expect.metric.split('.').any(|segment| LESS_IS_BETTER.contains(&segment))
    }

    /// The worst value that is still good enough.
    fn limit(&self) -> f64 {
        let Expect { value, tolerance, .. } = self.expect;
        if self.less() { value + tolerance } else { value - tolerance }
    }

    /// `None` where the metrics hold no such number.
    fn met(&self) -> Option<bool> {
        let (found, limit) = (self.found?, self.limit());
        Some(if self.less() { found <= limit } else { found >= limit })
    }

    fn metric(&self) -> String {
        match self.expect.min_side_px {
            Some(side) => format!("{} (short side >= {side} px)", self.expect.metric),
            None => self.expect.metric.clone(),
        }
    }

    /// What was expected, what came, whether it is good enough.
    pub fn line(&self) -> String {
        let (row, metric) = (self.row, self.metric());
        let source = if self.expect.source.is_empty() { String::new() } else { format!(" ({})", self.expect.source) };
        let (Some(found), Some(met)) = (self.found, self.met()) else {
            return format!("expected: {row}: {metric} is not among the metrics: not known");
        };
        let (sign, word) = (if self.less() { "<=" } else { ">=" }, if met { "met" } else { "NOT met" });
        format!("expected: {row}: {metric} {found:.4}, wanted {sign} {:.4}{source}: {word}", self.limit())
    }

    /// One sentence over all.
    pub fn summary(all: &[Self]) -> String {
        let met = all.iter().filter(|e| e.met() == Some(true)).count();
        format!("{met} of {} expected results are met.", all.len())
    }

    /// A line each.
    pub fn table(all: &[Self]) -> Table {
        let mut table = Table::new("Expected results.", &["run", "metric", "wanted", "found", "source", "verdict"]);
        for e in all {
            let sign = if e.less() { "<=" } else { ">=" };
            let verdict = match e.met() {
                Some(true) => Cell::Verdict("met", Some(true)),
                Some(false) => Cell::Verdict("not met", Some(false)),
                None => Cell::Verdict("not known", Some(false)),
            };
            table.rows.push(vec![
                Cell::text(e.row),
                Cell::text(e.metric()),
                Cell::text(format!("{sign} {:.4}", e.limit())),
                Cell::number(e.found, 4),
                Cell::text(&e.expect.source),
                verdict,
            ]);
        }
        table
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expect(metric: &str, value: f64, min_side_px: Option<f64>) -> Expect {
        Expect { run: None, metric: metric.into(), min_side_px, value, tolerance: 0.01, source: "Table 5".into() }
    }

    #[test]
    fn verdicts() {
        let metrics = serde_json::json!({"coco": {"ap50": 0.5}, "paper": {
            "headline": {"recall": 0.955, "fp": 3}, "rows": [{"tp": 7}],
            "min_side": [{"min_side_px": 16.0, "headline": {"recall": 0.1}}, {"min_side_px": 24.0, "headline": {"recall": 0.99}}]}});
        let found = |metric: &str, side: Option<f64>| look_up(&metrics, &expect(metric, 0.0, side));
        assert_eq!((found("recall", None), found("coco.ap50", None), found("paper.rows.0.tp", None)), (Some(0.955), Some(0.5), Some(7.0)));
        assert_eq!((found("recall", Some(24.0)), found("recall", Some(23.0)), found("recal", None)), (Some(0.99), None, None));
        let line = |metric: &str, value: f64| {
            let expect = expect(metric, value, None);
            Expectation { row: "ours", expect: &expect, found: look_up(&metrics, &expect) }.line()
        };
        assert!(line("recall", 0.96).ends_with("(Table 5): met"));
        assert!(line("recall", 0.97).contains("NOT met"));
        assert!(line("fp", 2.0).contains("NOT met"));
        assert!(line("nonsense", 2.0).contains("not among"));
    }

    #[test]
    fn errors_and_costs_are_wanted_small() {
        let less = |metric: &str| Expectation { row: "ours", expect: &expect(metric, 0.0, None), found: None }.less();
        for metric in [
            "fp",
            "percent_fn",
            "paper.headline.fn",
            "paper.rows.0.duplicates",
            "paper.calibration.ece",
            "paper.errors.missed",
            "paper.fp_per_1000_without_marker.value",
            "pose.angle_deg.p95",
            "pose.center_percent.median",
            "pose.center_px.mean",
            "pose.corner_percent.p95",
            "pose.corner_px.median",
            "pose.wrong_orientation",
            "pose.missed",
            "pose.refused",
            "pose.false_poses",
            "points.0.fp_per_image",
            "ms.network",
        ] {
            assert!(less(metric), "{metric}");
        }
        for metric in
            ["mean_iou", "recall", "f1", "coco.ap50", "pose.recovered", "pose.quad_iou.median", "pose.within_tight", "paper.froc_area"]
        {
            assert!(!less(metric), "{metric}");
        }
    }
}
