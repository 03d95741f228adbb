//! Errors of recovered poses and the marks computed from them, as `tcross eval --protocol pose` defines them, with the time each took.
use std::fmt;
use tcross_dataset::{Marker, PoseOutcome, geom::quad::angle_deg};

/// One marker and what was said about it. Percents are of the side, the root of the quadrilateral's area.
#[derive(Debug, Clone)]
pub struct Trial {
    pub outcome: PoseOutcome,
    pub width_px: f64,
    pub center_percent: f64,
    pub angle_deg: f64,
    pub corner_percent: f64,
    /// Squared Mahalanobis distance of the true centre under the stated covariance.
    pub mahalanobis: f64,
    pub ms: f64,
}

impl Trial {
    /// `None` for a marker without a true pose.
    pub fn new(truth: &Marker, outcome: PoseOutcome, ms: f64) -> Option<Self> {
        let corners = truth.corners?;
        let center = truth.center.or_else(|| corners.diagonal_crossing())?;
        let angle = truth.angle.unwrap_or_else(|| angle_deg(corners.0[0][0] - center[0], corners.0[0][1] - center[1]));
        let width_px = truth.bounds.width();
        let mut trial = Self { outcome, width_px, center_percent: 0.0, angle_deg: 0.0, corner_percent: 0.0, mahalanobis: 0.0, ms };
        if let PoseOutcome::Found(pose) = &trial.outcome {
            let percent = 100.0 / corners.side_px();
            let squared = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
            let turn = (pose.angle - angle).rem_euclid(360.0);
            let [xx, xy, yy] = pose.covariance;
            let (dx, dy) = (pose.center[0] - center[0], pose.center[1] - center[1]);
            trial.center_percent = percent * squared(pose.center, center).sqrt();
            trial.angle_deg = turn.min(360.0 - turn);
            trial.corner_percent = percent * ((0..4).map(|k| squared(pose.corners.0[k], corners.0[k])).sum::<f64>() / 4.0).sqrt();
            trial.mahalanobis = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy);
        }
        Some(trial)
    }

    pub fn found(&self) -> bool {
        matches!(self.outcome, PoseOutcome::Found(_))
    }
}

/// The marks over many trials.
#[derive(Debug, Clone)]
pub struct Marks {
    pub markers: usize,
    pub recovered: f64,
    pub center: [f64; 2],
    pub angle: [f64; 2],
    pub corner: [f64; 2],
    pub wrong: f64,
    pub coverage: f64,
    pub mahalanobis: [f64; 2],
    pub quality: [f64; 2],
    pub ms: [f64; 2],
    pub ms_small: [f64; 2],
}

/// The value below which the share `p` of the values lies (nearest rank); NaN without values.
pub fn quantile(mut values: Vec<f64>, p: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    if values.is_empty() { f64::NAN } else { values[((p * values.len() as f64).ceil() as usize).clamp(1, values.len()) - 1] }
}

impl Marks {
    pub fn of(trials: &[Trial]) -> Self {
        let found: Vec<&Trial> = trials.iter().filter(|t| t.found()).collect();
        let at = |p: [f64; 2], f: &dyn Fn(&Trial) -> f64| p.map(|p| quantile(found.iter().map(|t| f(t)).collect(), p));
        let share = |f: &dyn Fn(&Trial) -> bool| found.iter().filter(|t| f(t)).count() as f64 / found.len().max(1) as f64;
        let ms = |p: [f64; 2], below: f64| p.map(|p| quantile(trials.iter().filter(|t| t.width_px <= below).map(|t| t.ms).collect(), p));
        Self {
            markers: trials.len(),
            recovered: found.len() as f64 / trials.len().max(1) as f64,
            center: at([0.5, 0.95], &|t| t.center_percent),
            angle: at([0.5, 0.95], &|t| t.angle_deg),
            corner: at([0.5, 0.95], &|t| t.corner_percent),
            wrong: share(&|t| t.angle_deg > 45.0),
            // 5.991: the 95 % quantile of chi squared with two degrees of freedom.
            coverage: share(&|t| t.mahalanobis <= 5.991),
            mahalanobis: at([0.5, 0.95], &|t| t.mahalanobis),
            quality: at([0.02, 0.1], &|t| if let PoseOutcome::Found(p) = &t.outcome { p.quality } else { 0.0 }),
            ms: ms([0.5, 0.99], f64::INFINITY),
            ms_small: ms([0.5, 0.99], 200.0),
        }
    }
}

impl fmt::Display for Marks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [m0, m1] = self.mahalanobis;
        writeln!(f, "  markers                {:8}", self.markers)?;
        writeln!(f, "  recovered              {:8.2} %", 100.0 * self.recovered)?;
        writeln!(f, "  centre  median, p95    {:8.2} {:8.2} % of the side", self.center[0], self.center[1])?;
        writeln!(f, "  angle   median, p95    {:8.2} {:8.2} degrees", self.angle[0], self.angle[1])?;
        writeln!(f, "  corners median, p95    {:8.2} {:8.2} % of the side", self.corner[0], self.corner[1])?;
        writeln!(f, "  wrong orientation      {:8.2} %", 100.0 * self.wrong)?;
        writeln!(f, "  95 % ellipse holds     {:8.2} %", 100.0 * self.coverage)?;
        writeln!(f, "  Mahalanobis median, p95{m0:8.2} {m1:8.2} (1.39 and 5.99 are calibrated)")?;
        writeln!(f, "  quality p2, p10        {:8.2} {:8.2}", self.quality[0], self.quality[1])?;
        writeln!(f, "  time    median, p99    {:8.3} {:8.3} ms", self.ms[0], self.ms[1])?;
        write!(f, "  up to 200 px wide      {:8.3} {:8.3} ms", self.ms_small[0], self.ms_small[1])
    }
}
