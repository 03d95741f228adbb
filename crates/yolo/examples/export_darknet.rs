//! Writes a network with random weights as Darknet's `model.cfg` and `model.weights`: `export_darknet ARCHITECTURE WIDTH DIR`
//! (for `scripts/bench-infer.py`; a trained model is exported by `tcross model export`).
use tcross_yolo::{Architecture, Model, ModelConfig, Weights, model::ExportFormat};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [architecture, width, dir] = words.as_slice() else { return Err("expected: ARCHITECTURE WIDTH DIR".into()) };
    let architecture = if architecture == "yolov3-tiny" { Architecture::YoloV3Tiny } else { Architecture::YoloV3 };
    let config = ModelConfig { width: width.parse()?, classes: 80, ..ModelConfig::of(architecture) };
    let weights = Weights::init(&config.graph()?, &config.fields(), &Default::default(), 0);
    Model { config, weights }.export(ExportFormat::Darknet, std::path::Path::new(dir).join("model.cfg"))?;
    Ok(())
}
