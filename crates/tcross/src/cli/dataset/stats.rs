//! `tcross dataset stats DIR`: a table of the numbers, counts of the words, and a drawing of each distribution.
use crate::{console, exit::Outcome};
use std::{fmt::Write, path::Path};
use tcross_dataset::{
    Dataset, Split, files,
    stats::{Column, Stats, collect},
};
use tcross_eval::figures::{Axis, LinePlot, Series};

/// Bars a drawing.
const BINS: usize = 40;

pub fn run(dataset: &Dataset, split: Option<Split>, out: Option<&Path>) -> Outcome {
    let splits = split.map_or_else(|| dataset.splits(), |s| vec![s]);
    let stats = collect(dataset, &splits)?;
    console::result(&table(&stats));
    if let Some(out) = out {
        files::create_dir(out)?;
        for column in stats.columns.iter().filter(|c| c.values.len() > 1) {
            files::write_atomically(out.join(format!("{}.svg", column.name.replace(' ', "-"))), drawing(column))?;
        }
        console::note(&format!("{}: {} distributions", out.display(), stats.columns.len()));
    }
    Ok(())
}

fn table(stats: &Stats) -> String {
    let counts: Vec<String> = stats.images.iter().map(|(s, n)| format!("{n} {s}")).collect();
    let mut text = format!("images: {} ({} without a marker)\nmarkers: {}\n\n", counts.join(", "), stats.empty, stats.markers);
    let _ = writeln!(text, "{:<24} {:>8} {:>9} {:>9} {:>9} {:>9} {:>9}", "quantity", "count", "least", "5 %", "median", "95 %", "most");
    for column in &stats.columns {
        let _ = write!(text, "{:<24} {:>8}", column.name, column.values.len());
        for share in [0.0, 0.05, 0.5, 0.95, 1.0] {
            let _ = write!(text, " {:>9.2}", column.quantile(share).unwrap_or(f64::NAN));
        }
        let _ = writeln!(text, " {}", column.unit);
    }
    for (name, words) in &stats.words {
        let all: usize = words.values().sum();
        let shares: Vec<String> = words.iter().map(|(w, n)| format!("{w} {:.1} %", 100.0 * *n as f64 / all as f64)).collect();
        let _ = write!(text, "\n{name}: {}", shares.join(", "));
    }
    text
}

/// The distribution as a stepped outline.
fn drawing(column: &Column) -> String {
    let bars = column.histogram(BINS);
    let half = if bars.len() > 1 { (bars[1].0 - bars[0].0) / 2.0 } else { 0.5 };
    let mut outline = Vec::new();
    for (middle, count) in bars {
        outline.extend([[middle - half, count as f64], [middle + half, count as f64]]);
    }
    let unit = if column.unit.is_empty() { String::new() } else { format!(" ({})", column.unit) };
    let plot = LinePlot::new(column.name, Axis::linear(format!("{}{unit}", column.name)), Axis::linear("count"));
    plot.with(Series::line(column.name, outline)).svg()
}
