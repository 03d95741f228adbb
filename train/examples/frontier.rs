//! Accuracy against minutes of training, of several runs: a figure, and a table as Markdown on standard output.
//!
//! `cargo run --release -p tcross-train --example frontier -- OUT.svg METRIC [NAME=]RUN... [NAME:MINUTES:VALUE]...`
//!
//! METRIC is a column of `metrics.csv` without `val_`, such as `ap` or `mean_iou`. A RUN is a run's folder; a folder of `seed-*` runs, as
//! `tcross train --seeds` leaves it, is drawn as their mean within their range. `NAME:MINUTES:VALUE` is a single point measured elsewhere.
#![expect(clippy::print_stdout, reason = "an example prints its result")]
use std::{
    error::Error,
    path::{Path, PathBuf},
};
use tcross_dataset::files;
use tcross_eval::figures::{Axis, LinePlot, Series};
use tcross_train::run::history::{History, SCORES};

/// Minutes at which the table is taken.
const AT: [f64; 6] = [2.5, 5.0, 10.0, 15.0, 20.0, 25.0];

/// What a run, or several of one kind, had reached at any minute: the best so far, as its best weights would be taken.
struct Track {
    name: String,
    /// `[minutes, value]` of each validation, one list a seed.
    seeds: Vec<Vec<[f64; 2]>>,
}

impl Track {
    fn read(name: &str, dir: &Path, column: usize) -> Result<Self, Box<dyn Error>> {
        let mut runs: Vec<PathBuf> = vec![dir.to_owned()];
        if !dir.join("metrics.csv").is_file() {
            runs = std::fs::read_dir(dir)?.filter_map(|e| Some(e.ok()?.path())).filter(|p| p.join("metrics.csv").is_file()).collect();
            runs.sort();
        }
        let points = |run: &PathBuf| -> Result<Vec<[f64; 2]>, Box<dyn Error>> {
            let history = History::read(&run.join("metrics.csv"), u64::MAX)?;
            let mut best = f64::NEG_INFINITY;
            let mut points = Vec::new();
            for (minutes, value) in history.rows.iter().filter_map(|row| Some((row.seconds / 60.0, row.scores[column]?))) {
                best = best.max(value);
                points.push([minutes, best]);
            }
            Ok(points)
        };
        let seeds: Vec<_> = runs.iter().map(points).collect::<Result<_, _>>()?;
        if seeds.iter().all(Vec::is_empty) {
            return Err(format!("{}: no metrics.csv with such scores, nor folders with one", dir.display()).into());
        }
        Ok(Self { name: name.to_owned(), seeds })
    }

    /// Lowest, mean and highest over the seeds at a minute; none before every seed has its first validation.
    fn at(&self, minutes: f64) -> Option<[f64; 3]> {
        let reached = |points: &Vec<[f64; 2]>| points.iter().take_while(|p| p[0] <= minutes + 1e-9).last().map(|p| p[1]);
        let values: Vec<f64> = self.seeds.iter().map(reached).collect::<Option<_>>()?;
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        Some([values.iter().copied().fold(f64::INFINITY, f64::min), mean, values.iter().copied().fold(f64::NEG_INFINITY, f64::max)])
    }

    /// Every minute at which something may change.
    fn minutes(&self) -> Vec<f64> {
        let mut all: Vec<f64> = self.seeds.iter().flatten().map(|p| p[0]).collect();
        all.sort_by(f64::total_cmp);
        all
    }

    fn series(&self) -> Series {
        let known: Vec<(f64, [f64; 3])> = self.minutes().into_iter().filter_map(|m| Some((m, self.at(m)?))).collect();
        let line = Series::line(&self.name, known.iter().map(|(m, v)| [*m, v[1]]).collect());
        if self.seeds.len() > 1 { line.within(known.iter().map(|(m, v)| [*m, v[0], v[2]]).collect()) } else { line.marked() }
    }

    fn end(&self) -> f64 {
        self.minutes().last().copied().unwrap_or(0.0)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [out, metric, inputs @ ..] = words.as_slice() else {
        return Err("expected: OUT.svg METRIC [NAME=]RUN... [NAME:MINUTES:VALUE]...".into());
    };
    let names: Vec<&str> = SCORES.iter().map(|name| name.trim_start_matches("val_")).collect();
    let column = names.iter().position(|name| name == metric).ok_or_else(|| format!("{metric}: expected one of {}", names.join(", ")))?;
    let (mut tracks, mut points) = (Vec::new(), Vec::new());
    for input in inputs {
        if let [name, minutes, value] = input.split(':').collect::<Vec<_>>()[..] {
            points.push((name.to_owned(), [minutes.parse()?, value.parse()?]));
            continue;
        }
        let (name, dir) = input.split_once('=').unwrap_or((Path::new(input).file_name().and_then(|n| n.to_str()).unwrap_or(input), input));
        tracks.push(Track::read(name, Path::new(dir), column)?);
    }
    let mut plot =
        LinePlot::new("Accuracy against training time", Axis::linear("minutes of training"), Axis::linear(metric.replace('_', " ")));
    for track in &tracks {
        plot = plot.with(track.series());
    }
    for (name, point) in &points {
        plot = plot.with(Series::dots(name, vec![*point]));
    }
    files::write_atomically(out, plot.caption("Best validation so far; bands span the seeds. Validation is part of the time.").svg())?;

    println!("| run | {} | end |", AT.map(|m| format!("{m} min")).join(" | "));
    println!("|---|{}", "--:|".repeat(AT.len() + 1));
    for track in &tracks {
        let end = track.end();
        let cell = |m: f64| track.at(m).filter(|_| m <= end).map_or("-".into(), |v| format!("{:.3}", v[1]));
        let last = track.at(f64::INFINITY).map_or("-".into(), |[lo, mean, hi]| match track.seeds.len() {
            1 => format!("{mean:.3} at {end:.1} min"),
            n => format!("{mean:.3} ({lo:.3}-{hi:.3}, {n} seeds) at {end:.1} min"),
        });
        println!("| {} | {} | {last} |", track.name, AT.map(cell).join(" | "));
    }
    for (name, [minutes, value]) in &points {
        println!("| {name} | {} {value:.3} at {minutes:.1} min |", "- | ".repeat(AT.len()));
    }
    Ok(())
}
