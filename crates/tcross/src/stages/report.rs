//! The report of an experiment: all rows scored together, and a verdict for each expected result.
use super::{
    Row,
    expect::{Expectation, expectations},
    ledger::Ledger,
};
use crate::{
    config::Config,
    console,
    exit::{Failure, Outcome},
    work,
};
use serde_json::Value;
use std::path::Path;
use tcross_dataset::{Split, files};
use tcross_eval::{
    Evaluation, Report, Run, Truth, evaluate,
    report::{Extra, NamedTable},
    sweep,
};

/// A row's test detections scored, and the same network's validation detections, which choose a threshold.
struct Scored {
    truth: Truth,
    test: Evaluation,
    validation: Option<Evaluation>,
}

impl Scored {
    fn new(row: &Row) -> Outcome<Self> {
        let truth = if row.tests_on_all() { Truth::open_all(row.data())? } else { Truth::open(row.data(), Some(Split::Test))? };
        let test = evaluate(&truth, &row.name, row.detections().as_path().into(), &row.config.eval, false)?;
        let score = |path: std::path::PathBuf| -> Outcome<Evaluation> {
            let truth = Truth::open(row.data(), Some(Split::Val))?;
            Ok(evaluate(&truth, &row.name, path.as_path().into(), &row.config.eval.for_a_threshold(), false)?)
        };
        Ok(Self { truth, test, validation: row.validation().map(score).transpose()? })
    }

    fn run(&self) -> Run<'_> {
        Run { validation: self.validation.as_ref(), ..Run::new(&self.truth, &self.test) }
    }
}

/// Scores every row and writes `eval/` and `report.html`.
pub fn write(title: &str, config: &Config, rows: &[Row], ledger: &Ledger, out: &Path) -> Outcome {
    let scored: Vec<Scored> = rows.iter().map(Scored::new).collect::<Outcome<_>>()?;
    let mut provenance = work::provenance();
    provenance.push(("seed".into(), config.seed.to_string()));
    provenance.push(("backgrounds".into(), config.backgrounds.as_ref().map_or("embedded scenes".into(), |b| b.display().to_string())));
    provenance.extend(ledger.digests().map(|(stage, digest)| (format!("digest of {stage}"), digest.to_owned())));
    provenance
        .extend(ledger.times().map(|(stage, s)| (format!("time of {stage}"), console::seconds(std::time::Duration::from_secs_f64(s)))));
    provenance.push(("config".into(), crate::config::commented(config)?));
    let extras = rows.iter().filter_map(|row| curves(row, rows.len() > 1)).collect();
    let (swept, plain): (Vec<&Scored>, Vec<&Scored>) = scored.iter().partition(|s| s.test.config.sweep.is_some());
    let of = |s: &Scored| s.test.config.sweep.map(|factor| sweep(&s.truth, &s.test, factor)).transpose();
    let sweeps = swept.into_iter().map(of).collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect();
    let runs = plain.into_iter().map(Scored::run).collect();
    let mut built = Report { title: title.into(), runs, sweeps, extras, provenance }.build();
    let expected = expectations(config, rows, &built.metrics);
    if !expected.is_empty() {
        built.verdicts.insert(0, Expectation::summary(&expected));
        built.tables.insert(0, NamedTable { key: "expected".into(), table: Expectation::table(&expected) });
    }
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

/// Prints the tables and the verdicts from the files.
pub fn print(config: &Config, rows: &[Row], out: &Path) -> Outcome {
    let tables = work::SHORT_TABLES.map(|key| out.join(format!("eval/tables/{key}.md")));
    for table in tables.iter().filter(|t| t.is_file()) {
        console::result(&format!("{}\n", files::read_text(table)?));
    }
    let path = out.join("eval/metrics.json");
    let metrics: Value = serde_json::from_str(&files::read_text(&path)?).map_err(|e| Failure::new(format!("{}: {e}", path.display())))?;
    expectations(config, rows, &metrics).iter().for_each(|e| console::result(&e.line()));
    console::note(&format!("{}", out.join("report.html").display()));
    Ok(())
}
