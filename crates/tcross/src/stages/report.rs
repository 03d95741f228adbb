//! The report of an experiment: all rows scored together, and a verdict for each expected result.
use super::{Row, ledger::Ledger};
use crate::{
    config::{Config, Expect},
    console,
    exit::{Failure, Outcome},
    nearest, work,
};
use serde_json::Value;
use std::path::Path;
use tcross_dataset::{Split, files};
use tcross_eval::{Report, Run, Truth, evaluate, report::Extra};

/// Scores every row and writes `eval/` and `report.html`.
pub fn write(title: &str, config: &Config, rows: &[Row], ledger: &Ledger, out: &Path) -> Outcome {
    let mut scored = Vec::new();
    for row in rows {
        let truth = Truth::open(row.data(), Some(Split::Test))?;
        let evaluation = evaluate(&truth, &row.name, row.detections().as_path().into(), &row.config.eval, false)?;
        scored.push((truth, evaluation));
    }
    let runs = scored.iter().map(|(truth, evaluation)| Run::new(truth, evaluation)).collect();
    let mut provenance = work::provenance();
    provenance.push(("seed".into(), config.seed.to_string()));
    provenance.push(("backgrounds".into(), config.backgrounds.as_ref().map_or("embedded scenes".into(), |b| b.display().to_string())));
    provenance
        .extend(ledger.times().map(|(stage, s)| (format!("time of {stage}"), console::seconds(std::time::Duration::from_secs_f64(s)))));
    provenance.push(("config".into(), crate::config::commented(config)?));
    let extras = rows.iter().filter_map(|row| curves(row, rows.len() > 1)).collect();
    let built = Report { title: title.into(), runs, extras, provenance }.build();
    built.write(out.join("eval"))?;
    Ok(files::write_atomically(out.join("report.html"), built.html())?)
}

/// The curves of a row's training.
fn curves(row: &Row, several: bool) -> Option<Extra> {
    let mut paths: Vec<_> = std::fs::read_dir(row.run().join("curves")).ok()?.flatten().map(|e| e.path()).collect();
    paths.retain(|p| p.extension().is_some_and(|e| e == "svg"));
    paths.sort();
    let fragments = paths.iter().filter_map(|p| std::fs::read_to_string(p).ok()).collect();
    Some(Extra { title: if several { format!("Training: {}", row.name) } else { "Training".into() }, fragments })
}

/// Prints the table and the verdicts from the files.
pub fn print(config: &Config, rows: &[Row], out: &Path) -> Outcome {
    console::result(&files::read_text(out.join("eval/tables/headline.md"))?);
    let path = out.join("eval/metrics.json");
    let metrics: Value = serde_json::from_str(&files::read_text(&path)?).map_err(|e| Failure::new(format!("{}: {e}", path.display())))?;
    for expect in &config.expect {
        let named: Vec<(usize, &Row)> = rows.iter().enumerate().filter(|(_, r)| expect.run.as_ref().is_none_or(|n| *n == r.name)).collect();
        if named.is_empty() {
            let wanted = expect.run.as_deref().unwrap_or_default();
            let hint = nearest::hint(wanted, rows.iter().map(|r| r.name.as_str()));
            console::warn(&format!("expect: no run '{wanted}'{hint}"));
        }
        for (k, row) in named {
            let block = if rows.len() == 1 { &metrics } else { &metrics["runs"][k] };
            console::result(&verdict(expect, &row.name, look_up(block, &expect.metric)));
        }
    }
    console::note(&format!("{}", out.join("report.html").display()));
    Ok(())
}

/// A number of a run's metrics: a path, or a word of the headline row.
fn look_up(block: &Value, metric: &str) -> Option<f64> {
    let path = |metric: &str| {
        metric.split('.').try_fold(block, |at, key| match at {
            Value::Array(items) => items.get(key.parse::<usize>().ok()?),
            other => other.get(key),
        })
    };
    path(metric).or_else(|| path(&format!("paper.headline.{metric}"))).and_then(Value::as_f64)
}

/// One line: what was expected, what came, whether it is good enough.
fn verdict(expect: &Expect, row: &str, found: Option<f64>) -> String {
    // Of these, less is better.
    let less = ["fp", "fn", "percent_fn"].iter().any(|m| expect.metric.ends_with(m)) || expect.metric.contains("error");
    let source = if expect.source.is_empty() { String::new() } else { format!(" ({})", expect.source) };
    let Some(found) = found else { return format!("expected: {row}: {} is not among the metrics", expect.metric) };
    let good = if less { found <= expect.value + expect.tolerance } else { found >= expect.value - expect.tolerance };
    let (sign, word) = (if less { "<=" } else { ">=" }, if good { "met" } else { "NOT met" });
    let limit = if less { expect.value + expect.tolerance } else { expect.value - expect.tolerance };
    format!("expected: {row}: {} {found:.4}, wanted {sign} {limit:.4}{source}: {word}", expect.metric)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expect(metric: &str, value: f64) -> Expect {
        Expect { run: None, metric: metric.into(), value, tolerance: 0.01, source: "Table 5".into() }
    }

    #[test]
    fn verdicts() {
        let metrics = serde_json::json!({"paper": {"headline": {"recall": 0.955, "fp": 3}, "rows": [{"tp": 7}]}, "coco": {"ap50": 0.5}});
        assert_eq!(
            (look_up(&metrics, "recall"), look_up(&metrics, "coco.ap50"), look_up(&metrics, "paper.rows.0.tp")),
            (Some(0.955), Some(0.5), Some(7.0))
        );
        assert_eq!(look_up(&metrics, "recal"), None);
        assert!(verdict(&expect("recall", 0.96), "ours", look_up(&metrics, "recall")).ends_with("(Table 5): met"));
        assert!(verdict(&expect("recall", 0.97), "ours", look_up(&metrics, "recall")).contains("NOT met"));
        assert!(verdict(&expect("fp", 2.0), "ours", look_up(&metrics, "fp")).contains("NOT met"));
        assert!(verdict(&expect("nonsense", 2.0), "ours", None).contains("not among"));
    }
}
