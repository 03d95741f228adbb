//! `tcross dataset audit DIR`: what was asked for against what came out, and every pair of parameters that should know nothing of each other.
use crate::{
    console,
    exit::{Failure, Outcome},
};
use std::{fmt::Write, path::Path};
use tcross_datagen::audit::{Audit, audit};
use tcross_dataset::files;
use tcross_eval::figures::{Anchor, Canvas, Color};

pub fn run(dir: &Path, out: Option<&Path>) -> Outcome {
    super::must_exist(dir, "dataset")?;
    let audit = audit(dir)?;
    console::result(&table(&audit));
    if let Some(out) = out {
        files::create_dir(out)?;
        files::write_atomically(out.join("audit.json"), serde_json::to_string_pretty(&audit)? + "\n")?;
        files::write_atomically(out.join("correlations.svg"), matrix(&audit).svg())?;
        console::note(&format!("{}: audit.json, correlations.svg", out.display()));
    }
    if audit.fits.is_empty() {
        return Err(Failure::new(format!("{}: too few images to judge; make at least 30, better 1000", dir.display())));
    }
    if audit.passed() {
        let rest = match audit.unjudged.len() {
            0 => String::new(),
            n => format!("; {n} could not be judged, for the reasons above"),
        };
        console::note(&format!("{}: every distribution is as asked, and what should be independent is{rest}", dir.display()));
        return Ok(());
    }
    let (bad, tied) = (audit.fits.iter().filter(|f| !f.good).count(), audit.pairs.iter().filter(|p| p.flagged).count());
    Err(Failure::new(format!(
        "{}: {bad} distributions differ from what was asked, {tied} pairs are tied; each is marked above",
        dir.display()
    )))
}

fn table(audit: &Audit) -> String {
    let mut text = format!("{:<20} {:>6} {:>10} {:>10} {:>9}  asked\n", "parameter", "count", "mean", "statistic", "p");
    for fit in &audit.fits {
        let mark = if fit.good { "" } else { "  <-- differs" };
        let _ = writeln!(
            text,
            "{:<20} {:>6} {:>10.4} {:>10.4} {:>9.2e}  {}{mark}",
            fit.name, fit.count, fit.mean, fit.statistic, fit.p, fit.asked
        );
    }
    if !audit.unjudged.is_empty() {
        let _ = writeln!(text, "\nnot judged:");
        for unjudged in &audit.unjudged {
            let _ = writeln!(text, "  data.{} = {}: {}", unjudged.key, unjudged.asked, unjudged.why);
        }
    }
    let names = audit.names();
    if names.len() > 1 {
        let _ = writeln!(text, "\nrank correlations in hundredths; ! marks a tie that chance does not explain (level {:.1e})", audit.level);
        for (row, name) in names.iter().enumerate() {
            let _ = write!(text, "{row:>3} {name:<20}");
            for other in &names[..row] {
                let cell = audit
                    .pair(name, other)
                    .map_or("   .".into(), |p| format!("{:>3.0}{}", 100.0 * p.correlation, if p.flagged { "!" } else { " " }));
                let _ = write!(text, " {cell:>4}");
            }
            let _ = writeln!(text);
        }
        let _ = write!(text, "    {:<20}", "");
        (0..names.len() - 1).for_each(|k| _ = write!(text, " {k:>3} "));
        let _ = writeln!(text);
    }
    for pair in audit.pairs.iter().filter(|p| p.flagged) {
        let _ = writeln!(text, "tied: {} and {}, correlation {:.3}, p {:.1e}", pair.a, pair.b, pair.correlation, pair.p);
    }
    text
}

/// The correlations as a field of squares: blue against, red together, a frame where flagged.
fn matrix(audit: &Audit) -> Canvas {
    const CELL: f64 = 22.0;
    let names = audit.names();
    let (left, top) = (170.0, 40.0);
    let side = CELL * names.len() as f64;
    let mut canvas = Canvas::new(left + side + 20.0, top + side + 130.0);
    let ink = Color([40, 40, 40]);
    canvas.text([10.0, 24.0], "Rank correlations of what should be independent", 14.0, Anchor::Start, ink);
    for (i, name) in names.iter().enumerate() {
        let y = top + CELL * i as f64;
        canvas.text([left - 6.0, y + 15.0], name.clone(), 11.0, Anchor::End, ink);
        canvas.text_upwards([left + CELL * (i as f64 + 0.65), top + side + 6.0], name.clone(), 11.0, Anchor::End, ink);
        for (j, other) in names.iter().enumerate() {
            let x = left + CELL * j as f64;
            let pair = audit.pair(name, other);
            let strength = if i == j { 1.0 } else { pair.map_or(0.0, |p| p.correlation) };
            let color = if strength < 0.0 { Color([33, 102, 172]) } else { Color([178, 24, 43]) };
            canvas.rect([x + 0.5, y + 0.5], [x + CELL - 0.5, y + CELL - 0.5], Color([238, 238, 238]), 1.0);
            canvas.rect([x + 0.5, y + 0.5], [x + CELL - 0.5, y + CELL - 0.5], color, strength.abs().min(1.0));
            if pair.is_some_and(|p| p.flagged) {
                canvas.text([x + CELL / 2.0, y + 16.0], "!", 13.0, Anchor::Middle, ink);
            }
        }
    }
    canvas
}
