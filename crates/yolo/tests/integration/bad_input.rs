//! Files damaged at random: every one is read or refused, none ends the program.
use proptest::prelude::*;
use tcross_yolo::{Architecture, ExportFormat, Model, ModelConfig, Weights, weights::cfg};

fn model() -> Model {
    let config = ModelConfig { width: 0.0625, ..ModelConfig::of(Architecture::YoloV3Tiny) };
    let weights = Weights::init(&config.graph().unwrap(), &config.fields(), &Default::default(), 5);
    Model { config, weights }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn damaged_cfgs(edits in prop::collection::vec((0usize..4000, "[0-9=,\\[\\]a-z\\n-]{0,6}", 0usize..12), 1..4)) {
        let mut text = cfg::write(&model().config).unwrap();
        for (at, new, cut) in edits {
            let at = at % text.len();
            let end = (at + cut).min(text.len());
            text.replace_range(at..end, &new);
        }
        if let Err(error) = cfg::parse("net.cfg", &text) {
            prop_assert!(!error.to_string().is_empty());
        }
    }
}

#[test]
fn cut_and_flipped_weights() {
    let (dir, model) = (tempfile::tempdir().unwrap(), model());
    let stem = dir.path().join("best");
    for format in [ExportFormat::Darknet, ExportFormat::Safetensors] {
        let file = model.export(format, &stem).unwrap().into_iter().find(|f| f.extension().is_some_and(|e| e != "cfg")).unwrap();
        let bytes = std::fs::read(&file).unwrap();
        for cut in [0, 1, 7, 8, 19, 20, 21, 100, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(&file, &bytes[..cut]).unwrap();
            let message = Model::load(&file).unwrap_err().to_string();
            assert!(message.contains("best."), "{cut}: {message}");
        }
        for at in 0..64 {
            let mut bytes = bytes.clone();
            bytes[at] ^= 0xA5;
            std::fs::write(&file, bytes).unwrap();
            let _ = Model::load(&file); // the header may still make sense; what must not happen is a panic
        }
    }
}
