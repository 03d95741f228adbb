//! Whole runs over files: JSONL, overlays, skipped images, given boxes.
use crate::scene;
use image::RgbImage;
use tcross_dataset::{Detection, ImageDetections, PixelBox, PoseOutcome, Rng, detections};
use tcross_infer::{Boxes, Config, Detector, InferError, Progress, RunOptions, Source, run};
use tcross_yolo::{Architecture, Model, ModelConfig, NetSize, Weights};

fn tiny() -> Detector {
    let config = ModelConfig { width: 0.0625, input: NetSize::square(64), ..ModelConfig::of(Architecture::YoloV3Tiny) };
    let weights = Weights::init(&config.graph().unwrap(), &config.fields(), &Default::default(), 3);
    Detector::from_model(&Model { config, weights }).unwrap()
}

#[test]
fn unreadable_images_are_skipped_and_named() {
    let dir = tempfile::tempdir().unwrap();
    RgbImage::from_pixel(90, 60, image::Rgb([90, 120, 30])).save(dir.path().join("a.png")).unwrap();
    RgbImage::from_pixel(40, 40, image::Rgb([30, 120, 30])).save(dir.path().join("a.jpg")).unwrap();
    std::fs::write(dir.path().join("b.jpg"), b"no picture").unwrap();
    RgbImage::from_pixel(33, 70, image::Rgb([9, 20, 30])).save(dir.path().join("c.jpg")).unwrap();
    let out = dir.path().join("out/detections.jsonl");
    let options = RunOptions { out: Some(out.clone()), overlay: Some(dir.path().join("overlays")), ..RunOptions::default() };
    let config = Config { score: 0.0, pose: true, most: 5, ..Config::default() };
    let mut boxes = Boxes::Detector(Box::new(config.configure(tiny())));
    let source = Source::open(&[dir.path()], None).unwrap();
    let mut warnings = Vec::new();
    let report = run(&mut boxes, &source, &config, &options, &mut |p| {
        if let Progress::Skipped { warning } = p {
            warnings.push(warning.to_owned());
        }
        true
    })
    .unwrap();
    assert_eq!((report.images, report.skipped, report.detections), (3, 1, 15));
    assert_eq!(report.refused + report.poses, 15);
    assert!(warnings.len() == 1 && warnings[0].contains("b.jpg"), "{warnings:?}");
    let rows = detections::read(&out).unwrap();
    assert_eq!(
        rows.iter().map(|r| (r.image.as_str(), r.width, r.height)).collect::<Vec<_>>(),
        [("a.jpg", 40, 40), ("a.png", 90, 60), ("c.jpg", 33, 70)]
    );
    assert!(rows.iter().all(|r| r.detections.is_sorted_by(|a, b| a.score >= b.score)));
    for (name, width) in [("a.jpg", 40), ("a.png.jpg", 90), ("c.jpg", 33)] {
        assert_eq!(image::open(dir.path().join("overlays").join(name)).unwrap().width(), width, "{name}");
    }
    let only = Source::open(&[dir.path().join("b.jpg")], None).unwrap();
    assert!(matches!(run(&mut boxes, &only, &config, &RunOptions::default(), &mut |_| true), Err(InferError::NoneReadable { .. })));
}

#[test]
fn poses_come_from_given_boxes_too() {
    let dir = tempfile::tempdir().unwrap();
    let mut rng = Rng::for_item(5, "test/run", 2);
    let mut image = RgbImage::from_pixel(320, 240, image::Rgb([176, 168, 150]));
    let style = scene::Style { width_px: (120.0, 121.0), tilt_deg: (0.0, 30.0), blur: (0.0, 0.02), ..scene::Style::default() };
    let drawn = scene::draw(&mut image, &style, &mut rng);
    image.save(dir.path().join("x.png")).unwrap();
    let line = |bounds: PixelBox| ImageDetections {
        image: "x.png".into(),
        width: 320,
        height: 240,
        detections: vec![Detection { score: 1.0, class: 0, bounds, pose: None }],
        ms: None,
    };
    let given = dir.path().join("boxes.jsonl");
    detections::write(&given, [&line(drawn.bounds)]).unwrap();
    let config = Config { pose: true, ..Config::default() };
    let drawn_to = tempfile::tempdir().unwrap();
    let options = RunOptions {
        camera: Some("500,500,160,120".parse().unwrap()),
        cube: true,
        overlay: Some(drawn_to.path().join("o")),
        ..RunOptions::default()
    };
    let mut boxes = Boxes::given(&given).unwrap();
    let mut outcome = None;
    let source = Source::open(&[dir.path()], None).unwrap();
    run(&mut boxes, &source, &config, &options, &mut |p| {
        if let Progress::Done { line, .. } = p {
            outcome = line.detections[0].pose.clone();
        }
        true
    })
    .unwrap();
    let Some(PoseOutcome::Found(pose)) = outcome else { panic!("{outcome:?}") };
    // What is drawn is up to a tenth longer than wide, so a square cannot fit it to better than that.
    let off = pose.reprojection_px.unwrap() / pose.corners.side_px();
    assert!(pose.rotation.is_some() && pose.translation.unwrap()[2] > 0.0 && off < 0.05, "{off} sides");
    // The cube changes most of the marker it stands on; nothing is drawn far from it.
    let picture = image::open(drawn_to.path().join("o/x.png.jpg")).unwrap().into_rgb8();
    assert_eq!(picture.dimensions(), image.dimensions());
    let (mut on, mut of) = (0, 0);
    let ([cx, cy], reach) = (drawn.bounds.center(), drawn.bounds.width().max(drawn.bounds.height()));
    for ((x, y, before), after) in image.enumerate_pixels().zip(picture.pixels()) {
        let changed = (0..3).any(|c| before[c].abs_diff(after[c]) > 40);
        let (px, py) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
        let quad: Vec<[f64; 2]> = drawn.corners.0.iter().map(|p| [0.9 * p[0] + 0.1 * cx, 0.9 * p[1] + 0.1 * cy]).collect();
        let inside = (0..4).all(|k| {
            let (a, b) = (quad[k], quad[(k + 1) % 4]);
            (b[0] - a[0]) * (py - a[1]) - (b[1] - a[1]) * (px - a[0]) > 0.0
        });
        if inside {
            on += usize::from(changed);
            of += 1;
        }
        assert!(!changed || (px - cx).hypot(py - cy) < 2.5 * reach, "({x}, {y})");
    }
    assert!(2 * on > of, "{on} of {of} pixels of the marker are covered");
    std::fs::copy(dir.path().join("x.png"), dir.path().join("y.png")).unwrap();
    let more = Source::open(&[dir.path().join("y.png")], None).unwrap();
    let error = run(&mut boxes, &more, &config, &RunOptions::default(), &mut |_| true).unwrap_err().to_string();
    assert!(error.contains("y.png") && error.contains("boxes.jsonl"), "{error}");
}

/// `infer.refine = false` leaves a model's second stage out.
#[test]
fn a_second_stage_can_be_left_out() {
    let weights = Weights::zeros(&tcross_yolo::refiner::net::layers());
    let refiner = Some(tcross_yolo::Refiner::new(&weights, tcross_yolo::BoxConvention::Continuous).unwrap());
    for refine in [true, false] {
        let mut detector = tiny();
        detector.refiner = refiner.clone();
        assert_eq!(Config { refine, ..Config::default() }.configure(detector).refiner.is_some(), refine);
    }
}
