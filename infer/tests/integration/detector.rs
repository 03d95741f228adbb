//! The detector against the original program's own detections.
use std::path::PathBuf;
use tcross_dataset::{PixelBox, geom::boxes::iou};
use tcross_infer::{Config, Detector, read_image};

/// Reference material that lies beside the repository; `None`, with a word, where it is absent.
fn golden(path: &str) -> Option<PathBuf> {
    let beside = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared");
    let named = std::env::var_os("TCROSS_SHARED").map(PathBuf::from);
    let found = named.into_iter().chain([beside]).map(|dir| dir.join("golden").join(path)).find(|p| p.exists());
    if found.is_none() {
        eprintln!("skipped: no {path} in the reference material; set TCROSS_SHARED to its folder");
    }
    found
}

#[test]
fn darknets_own_detections_are_found() {
    let Some(dir) = golden("darknet-tiny") else { return };
    let config = Config { score: 0.1, ..Config::default() };
    let mut detector = config.configure(Detector::load(dir.join("yolov3-tiny.cfg")).unwrap());
    detector.options.clip = false;
    let text = std::fs::read_to_string(dir.join("detections-coffee.json")).unwrap();
    let golden: serde_json::Value = serde_json::from_str(&text).unwrap();
    let wanted: Vec<(u64, f64, PixelBox)> = golden["after_nms"]
        .as_array()
        .unwrap()
        .iter()
        .map(|d| {
            let n = |key: &str| d[key].as_f64().unwrap();
            (d["class"].as_u64().unwrap(), n("prob"), PixelBox::from_center(n("cx"), n("cy"), n("w"), n("h")))
        })
        .collect();
    let found = detector.detect(&read_image(&dir.join("coffee.png")).unwrap());
    assert!(!wanted.is_empty());
    assert_eq!(found.len(), wanted.len(), "{found:?}");
    for (class, prob, bounds) in wanted {
        let near = |d: &&tcross_dataset::Detection| u64::from(d.class) == class && iou(&d.bounds, &bounds) > 0.995;
        let d = found.iter().find(near).unwrap_or_else(|| panic!("no {class} at {bounds:?} among {found:?}"));
        assert!((d.score - prob).abs() < 1e-3, "{} {prob}", d.score);
    }
}
