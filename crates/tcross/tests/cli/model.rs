//! Weights in and out, as a user types it.
use crate::{tcross, tcross_in, word};
use std::path::Path;
use tcross_yolo::{Architecture, ExportFormat, Model, ModelConfig, Weights};

/// A narrow yolov3-tiny with names, as `DIR/net.cfg`, `net.weights` and `net.names`.
fn darknet(dir: &Path) -> Model {
    let config = ModelConfig { width: 0.0625, classes: 2, ..ModelConfig::of(Architecture::YoloV3Tiny) };
    let weights = Weights::init(&config.graph().unwrap(), &config.fields(), &Default::default(), 5);
    let model = Model { config, weights };
    model.export(ExportFormat::Darknet, dir.join("net")).unwrap();
    std::fs::write(dir.join("net.names"), "cat\ndog\n").unwrap();
    model
}

#[test]
fn a_model_goes_around_and_comes_back_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| word(&dir.path().join(name));
    let model = darknet(dir.path());
    let imported = tcross(["model", "import", &at("net.cfg"), "--out", &at("own")]).good();
    assert!(imported.stderr.contains("yolov3-tiny x 0.0625 with 2 class(es); all 13 convolutions"), "{}", imported.stderr);
    let info = tcross(["model", "info", &at("own")]).good().stdout;
    assert!(
        info.contains("head of stride 32: 13x13 cells, anchors 81x82, 135x169, 344x319") && info.contains("classes: cat, dog"),
        "{info}"
    );
    for (format, file) in [("darknet", "again.cfg"), ("safetensors", "again.safetensors")] {
        tcross(["model", "export", &at("own"), "--to", format, "--out", &at(&format!("{format}/again"))]).good();
        assert_eq!(Model::load(dir.path().join(format).join(file)).unwrap().weights, model.weights, "{format}");
    }
    assert_eq!(std::fs::read(at("darknet/again.weights")).unwrap(), std::fs::read(at("net.weights")).unwrap());
    tcross(["model", "export", &at("own"), "--to", "onnx", "--out", &at("net.onnx")]).good();
    assert!(std::fs::metadata(at("net.onnx")).unwrap().len() > 4 * 30_000);
}

#[test]
fn bare_names_are_looked_for_in_the_current_folder() {
    let dir = tempfile::tempdir().unwrap();
    darknet(dir.path());
    std::fs::rename(dir.path().join("net.weights"), dir.path().join("other.weights")).unwrap();
    std::fs::rename(dir.path().join("net.names"), dir.path().join("coco.names")).unwrap();
    let info = tcross_in(dir.path(), ["model", "info", "net.cfg"]).good().stdout;
    assert!(info.contains("classes: cat, dog"), "{info}");
}

#[test]
fn a_network_without_a_backbone_is_shown() {
    let dir = tempfile::tempdir().unwrap();
    let cfg =
        "[net]\nwidth=32\nheight=32\n[convolutional]\nfilters=6\nsize=1\nactivation=linear\n[yolo]\nmask=0\nanchors=10,14\nclasses=1\n";
    let config = tcross_yolo::weights::cfg::parse("one.cfg", cfg).unwrap();
    let weights = Weights::init(&config.graph().unwrap(), &config.fields(), &Default::default(), 5);
    Model { config, weights }.save(dir.path().join("last.safetensors")).unwrap();
    let info = tcross(["model".into(), "info".into(), word(dir.path())]).good().stdout;
    assert!(info.contains("there is no backbone"), "{info}");
}

#[test]
fn cuts_say_which_layers_they_held() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| word(&dir.path().join(name));
    darknet(dir.path());
    tcross(["model", "export", &at("net.cfg"), "--to", "darknet", "--cut", "15", "--out", &at("net")]).good();
    assert!(tcross(["model", "import", &at("net.conv.15"), "--out", &at("x")]).error(1).contains("name its cfg"));
    let taken = tcross(["model", "import", &at("net.conv.15"), "--cfg", &at("net.cfg"), "--out", &at("cut")]).good();
    assert!(taken.stderr.contains("9 of 13 convolutions (layers 0-14); the others are random"), "{}", taken.stderr);
    assert!(
        tcross(["model", "export", &at("net.cfg"), "--to", "darknet", "--cut", "99", "--out", &at("y")])
            .error(2)
            .contains("1 to 24 layers")
    );
}

#[test]
fn broken_files_are_told_with_offset_expected_and_found() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| word(&dir.path().join(name));
    darknet(dir.path());
    let bytes = std::fs::read(at("net.weights")).unwrap();
    let info = |bytes: &[u8]| {
        std::fs::write(at("net.weights"), bytes).unwrap();
        tcross(["model", "info", &at("net.cfg")]).error(1).to_owned()
    };
    let cut = info(&bytes[..bytes.len() - 10]);
    assert!(cut.contains("net.weights: layer 22, kernel: expected") && cut.contains("bytes at offset"), "{cut}");
    let long = info(&[&bytes[..], &[0; 12]].concat());
    assert!(long.contains(&format!("end of file: expected 0 bytes at offset {}, found 12", bytes.len())), "{long}");
}

/// The published weights on a photo, as a user detects with them.
#[test]
fn coco_is_detected_by_name() {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let shared = if beside.is_dir() { beside } else { std::env::var_os("TCROSS_SHARED").unwrap_or_default().into() };
    let golden = shared.join("golden/darknet-tiny");
    if !golden.is_dir() {
        eprintln!("skipped: no reference data at {}", golden.display());
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| word(&dir.path().join(name));
    let imported = tcross(["model", "import", &word(&golden.join("yolov3-tiny.cfg")), "--out", &at("coco")]).good();
    assert!(imported.stderr.contains("yolov3-tiny x 1 with 80 class(es); all 13 convolutions"), "{}", imported.stderr);
    let info = tcross(["model", "info", &at("coco")]).good().stdout;
    assert!(info.contains("classes: person, bicycle, car") && info.contains("8858734 parameters, 5.565 GFLOP"), "{info}");
    let photo = word(&golden.join("dog.jpg"));
    tcross(["infer", &at("coco"), &photo, "--score", "0.5", "--out", &at("found.jsonl"), "--overlay", &at("overlay")]).good();
    let found = tcross_dataset::detections::read(dir.path().join("found.jsonl")).unwrap();
    let names = Model::load(dir.path().join("coco")).unwrap().config.names;
    let found: Vec<&str> = found[0].detections.iter().map(|d| names[d.class as usize].as_str()).collect();
    assert!(found.contains(&"dog") && found.contains(&"car"), "{found:?}");
    assert_eq!(std::fs::read_dir(dir.path().join("overlay")).unwrap().count(), 1);
}
