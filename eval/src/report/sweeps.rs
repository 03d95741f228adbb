//! One-factor datasets in a report: a table and figures a factor, and one table over all.
use super::{figures::Figure, tables::Named};
use crate::{
    figures::{Axis, LinePlot, Series},
    sweep::{Factor, Point, Sweep},
    table::{Cell, Table},
};

/// Recall from which a detector is said to hold.
const HOLDS: f64 = 0.9;

/// All tables: the summary, then one a sweep.
pub fn tables(sweeps: &[Sweep]) -> Vec<Named> {
    if sweeps.is_empty() {
        return Vec::new();
    }
    let each = sweeps.iter().map(|s| Named::new(key(sweeps, s), table(s)));
    [Named::new("sweeps", summary(sweeps))].into_iter().chain(each).collect()
}

/// `sweep-blur`, and the run's name behind it where several runs are swept over one factor.
fn key(all: &[Sweep], sweep: &Sweep) -> String {
    let alike: Vec<&Sweep> = all.iter().filter(|s| s.factor == sweep.factor).collect();
    let slugs = super::slugs(alike.iter().map(|s| s.run.as_str()));
    let run = alike.iter().zip(slugs).find(|(s, _)| alike.len() > 1 && std::ptr::eq(**s, sweep));
    format!("sweep-{}{}", sweep.factor.name(), run.map_or(String::new(), |(_, slug)| format!("-{slug}")))
}

fn summary(sweeps: &[Sweep]) -> Table {
    let columns = ["factor", "run", "images", "from", "to", "recall, lowest class", "recall, highest class", "recall >= 0.9 from", "to"];
    let mut table = Table::new("One-factor datasets: where the detector holds.", &columns);
    for s in sweeps {
        let (Some(first), Some(last)) = (s.points.first(), s.points.last()) else { continue };
        let [from, to] = s.holds(HOLDS).map_or([None, None], |h| h.map(Some));
        table.rows.push(vec![
            Cell::text(s.factor.label()),
            Cell::text(&s.run),
            Cell::Count(s.points.iter().map(|p| p.images).sum()),
            Cell::Number(first.from, 2),
            Cell::Number(last.to, 2),
            Cell::number(first.row.recall, 3),
            Cell::number(last.row.recall, 3),
            Cell::number(from, 2),
            Cell::number(to, 2),
        ]);
    }
    table.notes.push(format!(
        "Images are cut into classes of equal count by the factor's value. The last two columns are the ends of the longest stretch of \
         classes with a recall of at least {HOLDS}, at the score threshold of the sweep."
    ));
    table
}

fn table(sweep: &Sweep) -> Table {
    let pose = sweep.points.iter().any(|p| p.pose.is_some());
    let mut columns = vec!["from", "to", "mean", "markers", "mean IoU", "95 %", "precision", "95 %", "recall", "95 %", "F1", "FP an image"];
    if pose {
        columns.extend(["poses", "centre %", "p95", "corners %", "p95", "angle", "p95", "turned"]);
    }
    let caption = format!("{}: the paper's metrics against {}, at score threshold {}.", sweep.run, sweep.factor.label(), sweep.threshold);
    let mut table = Table::new(caption, &columns);
    for p in &sweep.points {
        let r = &p.row;
        let mut row = vec![
            Cell::Number(p.from, 2),
            Cell::Number(p.to, 2),
            Cell::Number(p.at, 2),
            Cell::Count(p.markers),
            Cell::number(r.mean_iou, 3),
            Cell::range(r.mean_iou_ci, 3),
            Cell::number(r.precision, 3),
            Cell::range(r.precision_ci, 3),
            Cell::number(r.recall, 3),
            Cell::range(r.recall_ci, 3),
            Cell::number(r.f1, 3),
            Cell::Number(p.fp_per_image, 3),
        ];
        if pose {
            row.push(Cell::number(p.pose.map(|q| q.recovered), 3));
            let spreads = [p.pose.and_then(|q| q.center_percent), p.pose.and_then(|q| q.corner_percent), p.pose.and_then(|q| q.angle_deg)];
            row.extend(spreads.into_iter().flat_map(|s| [Cell::number(s.map(|s| s.median), 2), Cell::number(s.map(|s| s.p95), 2)]));
            row.push(Cell::number(p.pose.and_then(|q| q.wrong_orientation), 3));
        }
        table.rows.push(row);
    }
    if pose {
        table.notes.push(
            "Poses: fraction of all markers with one. Errors: median and 95th percentile, percent of the marker's side or degrees. Turned: \
             fraction of poses wrong by more than 45 degrees."
                .into(),
        );
    }
    table
}

/// All figures: of each factor every metric in one, or with several runs every metric in its own; then the poses.
pub fn figures(sweeps: &[Sweep]) -> Vec<Figure> {
    let mut out = Vec::new();
    for factor in Factor::ALL {
        let of: Vec<&Sweep> = sweeps.iter().filter(|s| s.factor == factor).collect();
        match of.as_slice() {
            [] => {}
            [one] => out.push(all_metrics(one)),
            several => out.extend(METRICS.iter().map(|m| one_metric(several, m))),
        }
        out.extend(of.iter().filter_map(|s| poses(sweeps, s)));
    }
    out
}

type Read = fn(&Point) -> (Option<f64>, Option<[f64; 2]>);

const METRICS: [(&str, &str, Read); 4] = [
    ("recall", "recall", |p| (p.row.recall, p.row.recall_ci)),
    ("precision", "precision", |p| (p.row.precision, p.row.precision_ci)),
    ("f1", "F1", |p| (p.row.f1, p.row.f1_ci)),
    ("mean-iou", "mean IoU (misses as 0)", |p| (p.row.mean_iou, p.row.mean_iou_ci)),
];

fn curve(sweep: &Sweep, label: &str, read: Read) -> Series {
    let points = sweep.points.iter().map(|p| [p.at, read(p).0.unwrap_or(f64::NAN)]).collect();
    let band = sweep.points.iter().filter_map(|p| read(p).1.map(|[lo, hi]| [p.at, lo, hi])).collect();
    Series::line(label, points).marked().within(band)
}

fn axis(factor: Factor, sweeps: &[&Sweep]) -> Axis {
    let positive = sweeps.iter().all(|s| s.points.iter().all(|p| p.at > 0.0));
    if factor.is_log() && positive { Axis::log(format!("{}, log", factor.label())) } else { Axis::linear(factor.label()) }
}

fn all_metrics(sweep: &Sweep) -> Figure {
    let mut plot = LinePlot::new("", axis(sweep.factor, &[sweep]), Axis::linear("value").from_to(0.0, 1.0));
    for (_, label, read) in METRICS {
        plot = plot.with(curve(sweep, label, read));
    }
    let images: u64 = sweep.points.iter().map(|p| p.images).sum();
    let plot = plot.caption(format!(
        "{images} images that vary in this alone, in {} classes of equal count; each point stands at its class's mean. Score threshold {}. \
         Bands: 95 %.",
        sweep.points.len(),
        sweep.threshold
    ));
    Figure::new(&format!("sweep-{}", sweep.factor.name()), &format!("Sweep over {}", sweep.factor.name()), &plot)
}

fn one_metric(sweeps: &[&Sweep], (key, label, read): &(&str, &str, Read)) -> Figure {
    let factor = sweeps[0].factor;
    let mut plot = LinePlot::new("", axis(factor, sweeps), Axis::linear(*label).from_to(0.0, 1.0));
    for sweep in sweeps {
        plot = plot.with(curve(sweep, &sweep.run, *read));
    }
    let plot = plot.caption("Classes of equal count; each point stands at its class's mean. Bands: 95 %.");
    Figure::new(&format!("sweep-{}-{key}", factor.name()), &format!("Sweep over {}: {label}", factor.name()), &plot)
}

/// Errors of poses: solid the median, dashed the 95th percentile.
fn poses(all: &[Sweep], sweep: &Sweep) -> Option<Figure> {
    let with = sweep.points.iter().filter(|p| p.pose.is_some_and(|q| q.center_percent.is_some())).count();
    if with < 2 {
        return None;
    }
    let y = Axis::log("error (% of side, degrees; log)");
    let mut plot = LinePlot::new("", axis(sweep.factor, &[sweep]), y);
    type Error = fn(&Point) -> Option<crate::protocol::pose::Spread>;
    let errors: [(&str, Error); 3] = [
        ("centre (%)", |p| p.pose?.center_percent),
        ("corners (%)", |p| p.pose?.corner_percent),
        ("angle (degrees)", |p| p.pose?.angle_deg),
    ];
    for (k, (label, read)) in errors.into_iter().enumerate() {
        let line = |f: fn(crate::protocol::pose::Spread) -> f64| -> Vec<[f64; 2]> {
            sweep.points.iter().map(|p| [p.at, read(p).map_or(f64::NAN, f)]).collect()
        };
        let color = crate::figures::Color::series(k);
        plot = plot.with(Series::line(label, line(|s| s.median)).marked().colored(color));
        plot = plot.with(Series::line("", line(|s| s.p95)).dashed().colored(color));
    }
    let plot = plot.caption("Solid: median of the recovered poses; dashed: their 95th percentile.");
    Some(Figure::new(&format!("{}-pose", key(all, sweep)), &format!("Sweep over {}: errors of poses", sweep.factor.name()), &plot))
}
