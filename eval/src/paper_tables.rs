//! Tables 2 to 7 of the paper as printed, with the counts behind each row and what does not add up.
use crate::{config::PaperRef, error::EvalError};

/// A printed row. All numbers are as printed, three decimals or one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PaperRow {
    /// Number of the table.
    pub table: u8,
    /// The row's words; in table 6 the threshold.
    pub name: &'static str,
    /// Score threshold.
    pub threshold: f64,
    /// Mean IoU.
    pub mean_iou: f64,
    /// False positives.
    pub fp: u64,
    /// False negatives.
    pub fn_: u64,
    /// Printed percent of false negatives; table 6 prints none.
    pub percent_fn: Option<f64>,
    /// Printed precision; table 6 prints true positives instead.
    pub precision: Option<f64>,
    /// Printed recall.
    pub recall: Option<f64>,
    /// Test markers that reproduce the row, or come nearest.
    pub markers: u64,
    /// What in the row contradicts the rest of it.
    pub fault: Option<&'static str>,
}

impl PaperRow {
    /// Markers less misses.
    #[must_use]
    pub fn tp(&self) -> u64 {
        self.markers - self.fn_
    }

    /// TP / (TP + FP), recomputed.
    #[must_use]
    pub fn precision(&self) -> f64 {
        self.tp() as f64 / (self.tp() + self.fp) as f64
    }

    /// TP / (TP + FN), recomputed.
    #[must_use]
    pub fn recall(&self) -> f64 {
        self.tp() as f64 / self.markers as f64
    }

    /// 100 FN / markers, recomputed.
    #[must_use]
    pub fn percent_fn(&self) -> f64 {
        100.0 * self.fn_ as f64 / self.markers as f64
    }
}

/// A row of tables 2 to 5 and 7, all at threshold 0.3.
#[allow(clippy::too_many_arguments, reason = "a line of a table")]
const fn row(
    table: u8,
    name: &'static str,
    mean_iou: f64,
    fp: u64,
    fn_: u64,
    percent_fn: f64,
    precision: f64,
    recall: f64,
    markers: u64,
    fault: Option<&'static str>,
) -> PaperRow {
    let (percent_fn, precision, recall) = (Some(percent_fn), Some(precision), Some(recall));
    PaperRow { table, name, threshold: 0.3, mean_iou, fp, fn_, percent_fn, precision, recall, markers, fault }
}

/// A row of table 6: real images, 55 markers.
const fn at(threshold: f64, name: &'static str, mean_iou: f64, fp: u64, fn_: u64) -> PaperRow {
    PaperRow { table: 6, name, threshold, mean_iou, fp, fn_, percent_fn: None, precision: None, recall: None, markers: 55, fault: None }
}

/// Every row of tables 2 to 7, in their order.
#[rustfmt::skip]
pub const ROWS: [PaperRow; 33] = [
    row(2, "filled rectangle", 0.665, 15, 16, 5.4, 0.949, 0.946, 297, None),
    row(2, "empty rectangle", 0.666, 12, 16, 5.4, 0.959, 0.946, 297, None),
    row(2, "filled triangle", 0.701, 8, 8, 2.7, 0.973, 0.973, 297, None),
    row(2, "empty triangle", 0.679, 6, 13, 4.4, 0.979, 0.956, 297, None),
    row(2, "star of thickness 2", 0.695, 3, 9, 3.0, 0.990, 0.970, 297, None),
    row(2, "star of thickness 1", 0.654, 13, 19, 6.4, 0.955, 0.936, 297, None),
    row(2, "star of thickness 1 surrounded by a rectangle", 0.614, 19, 21, 7.1, 0.936, 0.929, 297, None),
    row(2, "@ symbol", 0.699, 10, 19, 6.4, 0.965, 0.936, 297, None),
    row(3, "star of thickness 2 in a filled rectangle", 0.755, 2, 9, 1.9, 0.996, 0.981, 480, None),
    row(3, "star of thickness 1 in a filled rectangle", 0.764, 7, 11, 2.3, 0.985, 0.977, 480, None),
    row(3, "cross of thickness 2 in a filled rectangle", 0.764, 1, 9, 1.9, 0.998, 0.981, 480, None),
    row(3, "cross of thickness 1 in a filled rectangle", 0.764, 3, 5, 1.0, 0.994, 0.990, 480, None),
    row(4, "T cross of thickness 2", 0.689, 6, 10, 3.9, 0.997, 0.962, 260, Some("260 markers give 3.8 % and a precision of .977")),
    row(4, "T cross of thickness 1", 0.664, 5, 13, 5.0, 0.980, 0.950, 260, None),
    row(5, "T cross of thickness 2", 0.780, 5, 33, 3.1, 0.995, 0.969, 1079, None),
    row(5, "T cross of thickness 1", 0.743, 10, 62, 5.8, 0.990, 0.943, 1079, Some("62 of 1079 are 5.7 %")),
    row(5, "T cross of random thickness", 0.762, 5, 40, 3.8, 0.995, 0.963, 1079, Some("40 of 1079 are 3.7 %")),
    at(0.05, "0.05", 0.710, 127, 1), at(0.10, "0.10", 0.710, 25, 1), at(0.15, "0.15", 0.707, 10, 1), at(0.20, "0.20", 0.692, 3, 2),
    at(0.25, "0.25", 0.685, 1, 3), at(0.30, "0.30", 0.673, 1, 4), at(0.35, "0.35", 0.659, 1, 5), at(0.40, "0.40", 0.628, 0, 7),
    at(0.45, "0.45", 0.600, 0, 9), at(0.50, "0.50", 0.524, 0, 15), at(0.55, "0.55", 0.501, 0, 17), at(0.60, "0.60", 0.416, 0, 23),
    at(0.65, "0.65", 0.332, 0, 29), at(0.70, "0.70", 0.280, 0, 33),
    row(7, "T cross of random thickness", 0.762, 5, 40, 3.8, 0.995, 0.963, 1079, Some("40 of 1079 are 3.7 %")),
    row(7, "real", 0.673, 1, 4, 7.3, 0.981, 0.927, 55, None),
];

/// True positives as table 6 prints them, in its order.
pub const TABLE_6_TP: [u64; 14] = [54, 54, 54, 53, 52, 51, 50, 48, 46, 40, 38, 32, 26, 22];

/// The rows of a table.
pub fn table(number: u8) -> impl Iterator<Item = &'static PaperRow> {
    ROWS.iter().filter(move |r| r.table == number)
}

/// The row a configuration names.
///
/// # Errors
/// If there is no such row; the error lists those of the table.
pub fn find(wanted: &PaperRef) -> Result<&'static PaperRow, EvalError> {
    table(wanted.table).find(|r| r.name.eq_ignore_ascii_case(&wanted.row)).ok_or_else(|| {
        let known: Vec<&str> = table(wanted.table).map(|r| r.name).collect();
        let known = if known.is_empty() { "none (tables are 2 to 7)".to_owned() } else { known.join(", ") };
        EvalError::PaperRow { table: wanted.table, row: wanted.row.clone(), known }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounds half up to `digits` decimals, as the paper does.
    fn printed(v: f64, digits: i32) -> f64 {
        let scale = 10f64.powi(digits);
        (v * scale + 0.5 + 1e-9).floor() / scale
    }

    #[test]
    fn rows_add_up_or_are_marked() {
        for r in &ROWS {
            let same = |want: Option<f64>, got: f64, digits| want.is_none_or(|w| (printed(got, digits) - w).abs() < 1e-9);
            let consistent = same(r.percent_fn, r.percent_fn(), 1) && same(r.precision, r.precision(), 3) && same(r.recall, r.recall(), 3);
            assert_eq!(consistent, r.fault.is_none(), "table {} {}", r.table, r.name);
        }
        assert!(table(6).zip(TABLE_6_TP).all(|(r, tp)| r.tp() == tp));
    }

    #[test]
    fn a_wrong_row_lists_the_right_ones() {
        let message = find(&PaperRef { table: 5, row: "T-cross".into() }).unwrap_err().to_string();
        assert!(message.contains("T cross of random thickness"), "{message}");
        assert_eq!(find(&PaperRef { table: 7, row: "Real".into() }).unwrap().fn_, 4);
    }
}
