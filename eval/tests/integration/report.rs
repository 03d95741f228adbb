//! A small report, written to disk and read back.
use image::{Rgb, RgbImage};
use tcross_dataset::{Detection, ImageDetections, Marker, Record, dataset::BoxConvention, detections, files};
use tcross_eval::{Config, Report, Run, Truth, config::PaperRef, evaluate, report::Extra};

/// Four images: found, missed with a false positive, without a marker, without anything.
fn dataset(dir: &std::path::Path) {
    files::create_dir(dir.join("test")).unwrap();
    let record = |k: usize, boxes: &[[f64; 4]]| Record {
        image: format!("test/{k:05}.png"),
        width: 60,
        height: 50,
        background: Some("embedded/room".into()),
        markers: boxes.iter().map(|b| Marker::from_box("t_cross", (*b).into())).collect(),
        confusers: Vec::new(),
        intrinsics: None,
        distortion: None,
        // One that differs from image to image, and one that does not.
        effects: [("noise_percent", k + 1), ("jpeg_quality", 90)].map(|(key, v)| (key.to_owned(), v.into())).into_iter().collect(),
    };
    let b = [10.0, 10.0, 30.0, 30.0];
    let records = [record(0, &[b]), record(1, &[b]), record(2, &[]), record(3, &[])];
    for r in &records {
        RgbImage::from_pixel(60, 50, Rgb([120, 130, 140])).save(dir.join(&r.image)).unwrap();
    }
    files::write_jsonl(dir.join("test.jsonl"), &records).unwrap();
    let found = |k: usize, claims: &[(f64, [f64; 4])]| ImageDetections {
        image: records[k].image.clone(),
        width: 60,
        height: 50,
        detections: claims.iter().map(|(score, b)| Detection { score: *score, class: 0, bounds: (*b).into(), pose: None }).collect(),
        ms: None,
    };
    let rows = [found(0, &[(0.9, b), (0.6, b)]), found(1, &[(0.8, [40.0, 30.0, 55.0, 45.0])]), found(2, &[(0.5, b)]), found(3, &[])];
    detections::write(dir.join("detections.jsonl"), &rows).unwrap();
}

#[test]
fn writes_what_the_contract_names() {
    let folder = tempfile::tempdir().unwrap();
    dataset(folder.path());
    let truth = Truth::open(folder.path(), None).unwrap();
    assert_eq!(truth.boxes, BoxConvention::Continuous);
    let config = Config {
        paper: Some(PaperRef { table: 6, row: "0.30".into() }),
        bootstrap_draws: 20,
        size_edges_px: vec![16.0, 24.0],
        min_side_px: vec![16.0, 24.0],
        ..Config::default()
    };
    let source = folder.path().join("detections.jsonl");
    let evaluation = evaluate(&truth, "small", source.as_path().into(), &config, false).unwrap();
    let run = Run { validation: Some(&evaluation), ..Run::new(&truth, &evaluation) };
    let extras = vec![Extra { title: "Training".into(), fragments: vec!["<svg id=\"loss\"></svg>".into()] }];
    let provenance = vec![("Seed".to_owned(), "7 & more".to_owned())];
    let out = folder.path().join("eval");
    Report { title: "A <small> set".into(), runs: vec![run], sweeps: vec![], extras, provenance }.build().write(&out).unwrap();

    let metrics: serde_json::Value = serde_json::from_str(&files::read_text(out.join("metrics.json")).unwrap()).unwrap();
    let paper = &metrics["paper"];
    assert_eq!((&paper["images"], &paper["markers"]), (&4.into(), &2.into()));
    let row = &paper["rows"][5];
    assert_eq!(row["threshold"], 0.3);
    assert_eq!((&row["tp"], &row["fp"], &row["fn"], &row["duplicates"]), (&1.into(), &2.into(), &1.into(), &1.into()));
    assert!(row["precision_ci"].is_array() && row["mean_iou_ci"].is_array());
    assert!(paper["rows"][13].get("precision").is_some() && metrics.get("pose").is_none());
    assert_eq!(paper["fp_per_1000_without_marker"]["value"], 500.0);
    assert_eq!(paper["errors"], serde_json::json!({"missed": 1, "background": 2, "duplicate": 1, "misplaced": 0}));
    let sides: Vec<_> =
        paper["min_side"].as_array().unwrap().iter().map(|s| (&s["min_side_px"], &s["markers"], &s["headline"]["fp"])).collect();
    assert_eq!(sides, [(&16.0.into(), &2.into(), &1.into()), (&24.0.into(), &0.into(), &0.into())]);
    assert!(metrics["coco"]["ap50"].as_f64().unwrap() > 0.3);
    let slices: Vec<&str> = paper["slices"].as_array().unwrap().iter().filter_map(|s| s["key"].as_str()).collect();
    assert!(slices.contains(&"noise_percent") && !slices.contains(&"jpeg_quality"), "{slices:?}");
    assert_eq!(paper["verdict"]["recall"], "below");
    assert_eq!(paper["chosen_on_validation"]["threshold"], 0.81);

    for name in ["headline", "thresholds", "coco", "paper", "min-side", "table6"] {
        for kind in ["md", "csv", "tex"] {
            assert!(out.join(format!("tables/{name}.{kind}")).is_file(), "{name}.{kind}");
        }
    }
    for name in ["figure20", "froc", "precision-recall", "threshold", "reliability"] {
        for kind in ["svg", "pdf", "png"] {
            assert!(out.join(format!("figures/{name}.{kind}")).is_file(), "{name}.{kind}");
        }
    }
    assert_eq!(std::fs::read_dir(out.join("galleries/background")).unwrap().count(), 2);
    let page = files::read_text(out.join("report.html")).unwrap();
    assert!(page.contains("A &lt;small&gt; set") && page.contains("<svg id=\"loss\">") && page.contains("7 &amp; more"));
    assert!(!page.contains("src=\"http") && !page.contains("href="), "nothing beside the page is needed");
}

/// Two runs beside each other: the images on which they disagree are shown with the boxes of both, the greatest difference first.
#[test]
fn disagreements_are_shown() {
    let folder = tempfile::tempdir().unwrap();
    dataset(folder.path());
    let truth = Truth::open(folder.path(), None).unwrap();
    let mut rows = detections::read(folder.path().join("detections.jsonl")).unwrap();
    let config = Config { bootstrap_draws: 20, ..Config::default() };
    let first = evaluate(&truth, "first", rows.clone().into(), &config, false).unwrap();
    rows[1].detections.clear();
    let second = evaluate(&truth, "second", rows.into(), &config, false).unwrap();
    let runs = vec![Run::new(&truth, &first), Run::new(&truth, &second)];
    let built = Report { title: "t".into(), runs, sweeps: vec![], extras: vec![], provenance: vec![] }.build();
    let gallery = built.galleries.iter().find(|g| g.key == "disagreements-1").unwrap();
    assert_eq!((gallery.of, gallery.pictures.len()), (1, 1));
    let shown = &gallery.pictures[0];
    assert_eq!((shown.width, shown.height), (60 + 8 + 60, 50));
    assert!(shown.caption.contains("first: score 0.80; second: no detection"), "{}", shown.caption);
}

#[test]
fn the_same_bytes_twice() {
    let folder = tempfile::tempdir().unwrap();
    dataset(folder.path());
    let truth = Truth::open(folder.path().join("test.jsonl"), None).unwrap();
    let make = || {
        let source = folder.path().join("detections.jsonl");
        let evaluation = evaluate(&truth, "small", source.as_path().into(), &Config::default(), false).unwrap();
        Report { title: "t".into(), runs: vec![Run::new(&truth, &evaluation)], sweeps: vec![], extras: vec![], provenance: vec![] }
            .build()
            .html()
    };
    assert!(make() == make());
}

#[test]
fn a_missing_split_says_what_is_there() {
    let folder = tempfile::tempdir().unwrap();
    dataset(folder.path());
    let message = Truth::open(folder.path(), Some(tcross_dataset::Split::Val)).unwrap_err().to_string();
    assert!(message.contains("val") && message.contains("test"), "{message}");
}
