//! Every row of the paper's tables from detections built to have that row's counts.
use tcross_dataset::{Detection, ImageDetections, Marker, PixelBox, Record, dataset::BoxConvention};
use tcross_eval::{
    Config, Evaluation, Truth, evaluate,
    paper_tables::{PaperRow, ROWS, TABLE_6_TP, table},
    table::rounded,
};

fn record(k: usize) -> Record {
    Record {
        image: format!("test/{k:05}.jpg"),
        width: 416,
        height: 416,
        background: None,
        markers: vec![Marker::from_box("t_cross", [100.0, 100.0, 139.0, 139.0].into())],
        confusers: Vec::new(),
        intrinsics: None,
        distortion: None,
        effects: serde_json::Map::new(),
    }
}

fn claim(score: f64, bounds: [f64; 4]) -> Detection {
    Detection { score, class: 0, bounds: PixelBox::from(bounds), pose: None }
}

/// A box whose inclusive IoU with the marker's 40 x 40 pixels is `iou`: the same box, but so much narrower.
fn overlapping(iou: f64) -> [f64; 4] {
    [100.0, 100.0, 99.0 + 40.0 * iou, 139.0]
}

/// An empty corner, where every detection is a false positive.
const NOWHERE: [f64; 4] = [300.0, 300.0, 320.0, 320.0];

fn scored(detections: Vec<Vec<Detection>>) -> Evaluation {
    let records: Vec<Record> = (0..detections.len()).map(record).collect();
    let rows: Vec<ImageDetections> = records
        .iter()
        .zip(detections)
        .map(|(r, d)| ImageDetections { image: r.image.clone(), width: r.width, height: r.height, detections: d, ms: None })
        .collect();
    let truth = Truth::new(records, BoxConvention::Inclusive, None);
    evaluate(&truth, "made up", rows.into(), &Config { bootstrap_draws: 50, ..Config::default() }, false).unwrap()
}

/// Detections at one threshold: misses without any, the others with the IoU that makes the printed mean; every found
/// marker also has a duplicate, which must not count, and detections below the threshold, which must not either.
fn built(row: &PaperRow) -> Vec<Vec<Detection>> {
    let iou = row.mean_iou * row.markers as f64 / row.tp() as f64;
    let image = |k: u64| {
        let mut detections = vec![claim(row.threshold - 0.01, NOWHERE)];
        if k < row.tp() {
            detections.push(claim(row.threshold, overlapping(iou)));
            detections.push(claim(0.99, overlapping(iou * 0.9)));
        } else {
            detections.push(claim(row.threshold - 0.001, overlapping(0.99)));
        }
        let extra = row.fp / row.markers + u64::from(k < row.fp % row.markers);
        detections.extend((0..extra).map(|_| claim(0.9, NOWHERE)));
        detections
    };
    (0..row.markers).map(image).collect()
}

#[test]
fn every_consistent_row_is_reproduced() {
    for row in &ROWS {
        let got = scored(built(row)).row_at(row.threshold);
        let name = format!("table {} {}", row.table, row.name);
        assert_eq!((got.tp, got.fp, got.fn_), (row.tp(), row.fp, row.fn_), "{name}");
        assert_eq!(rounded(got.mean_iou.unwrap(), 3), rounded(row.mean_iou, 3), "{name}");
        if row.fault.is_none() {
            let check = |got: Option<f64>, printed: Option<f64>, digits: usize| {
                assert!(
                    printed.is_none_or(|p| rounded(got.unwrap(), digits) == rounded(p, digits)),
                    "{name}: {got:?}, printed {printed:?}"
                );
            };
            check(got.percent_fn, row.percent_fn, 1);
            check(got.precision, row.precision, 3);
            check(got.recall, row.recall, 3);
        }
    }
}

/// The rows that contradict themselves come out as the page of the paper's faults says.
#[test]
fn faulty_rows_come_out_as_recomputed() {
    let recomputed = |number: u8, name: &str| {
        let row = table(number).find(|r| r.name == name).unwrap();
        let got = scored(built(row)).headline();
        (rounded(got.percent_fn.unwrap(), 1), rounded(got.precision.unwrap(), 3))
    };
    assert_eq!(recomputed(4, "T cross of thickness 2"), ("3.8".into(), "0.977".into()));
    assert_eq!(recomputed(5, "T cross of thickness 1"), ("5.7".into(), "0.990".into()));
    assert_eq!(recomputed(5, "T cross of random thickness"), ("3.7".into(), "0.995".into()));
}

/// Table 6 as one file: the thresholds are read from the scores, not set one by one.
#[test]
fn table_6_from_one_file_of_detections() {
    let rows: Vec<&PaperRow> = table(6).collect();
    let mut images: Vec<Vec<Detection>> = vec![Vec::new(); 55];
    for (k, row) in rows.iter().enumerate() {
        let next = rows.get(k + 1).map_or((0, 0), |r| (r.tp(), r.fp));
        // Markers found here and no longer at the next threshold have a score just above this one.
        for image in &mut images[next.0 as usize..row.tp() as usize] {
            image.push(claim(row.threshold, overlapping(0.71)));
        }
        for f in next.1..row.fp {
            images[f as usize % 55].push(claim(row.threshold + 0.001, NOWHERE));
        }
    }
    let got = scored(images).rows();
    assert_eq!(got.len(), 14);
    for ((got, row), tp) in got.iter().zip(rows).zip(TABLE_6_TP) {
        assert_eq!((got.threshold, got.tp, got.fp, got.fn_), (row.threshold, tp, row.fp, row.fn_));
        // All found markers overlap alike, so the mean follows the count of misses.
        assert!((got.mean_iou.unwrap() - 0.71 * tp as f64 / 55.0).abs() < 1e-9);
    }
}
