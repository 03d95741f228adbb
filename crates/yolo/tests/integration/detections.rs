//! From a photo to boxes with the published tiny weights: own letterbox, network, decoding and suppression against Darknet's.
use crate::golden;
use burn::tensor::{Device, Tensor, TensorData};
use std::path::Path;
use tcross_dataset::Detection;
use tcross_yolo::{
    BoxConvention, DetectOptions, Model, Yolo,
    decode::{decode, to_source},
    detect, input,
    network::read_logits,
};

struct Photo<'a> {
    file: &'a str,
    reference: &'a str,
    score: f64,
    px: f64,
}

#[test]
fn both_masks_on_three_photos() {
    let Some(dir) = golden::folder("darknet-tiny") else { return };
    for mask in ["", "-mask123"] {
        let mut model = Model::load_darknet(dir.join(format!("yolov3-tiny{mask}.cfg")), dir.join("yolov3-tiny.weights")).unwrap();
        model.config.epsilon = 1e-6;
        let network = Yolo::new(&model.config, &model.weights, &Device::flex()).unwrap();
        // JPEG decoders differ from Darknet's own; the PNG has its pixels.
        for photo in [
            Photo { file: "dog-decoded.png", reference: "dog", score: 1e-4, px: 0.02 },
            Photo { file: "coffee.png", reference: "coffee", score: 1e-4, px: 0.02 },
            Photo { file: "dog.jpg", reference: "dog", score: 0.01, px: 1.0 },
            Photo { file: "person.jpg", reference: "person", score: 0.01, px: 1.0 },
        ] {
            check(&model, &network, &photo, &dir, mask);
        }
    }
}

fn check(model: &Model, network: &Yolo, photo: &Photo, dir: &Path, mask: &str) {
    let image = image::open(dir.join(photo.file)).unwrap().to_rgb8();
    let net = model.config.input;
    let mut values = vec![0.0; 3 * net.width * net.height];
    let letterbox = input::prepare(&image, net, &mut values);
    let heads = network.forward(Tensor::from_data(TensorData::new(values, [1, 3, net.height, net.width]), &Device::flex()));
    let logits: Vec<Vec<f32>> = heads.iter().map(read_logits).collect();
    let views: Vec<&[f32]> = logits.iter().map(Vec::as_slice).collect();
    let geometry = model.config.geometry(net);

    let reference = golden::json(dir.join(format!("detections-{}{mask}.json", photo.reference)));
    let options = DetectOptions { score: 0.1, nms_iou: 0.45, most: 200, clip: false };
    let before: Vec<Detection> =
        decode(&geometry, &views, options.score).iter().map(|d| to_source(d, &letterbox, BoxConvention::Continuous, false)).collect();
    compare(before, &reference["before_nms"], photo);
    compare(detect(&geometry, &views, &letterbox, BoxConvention::Continuous, &options), &reference["after_nms"], photo);
}

fn compare(mut got: Vec<Detection>, reference: &serde_json::Value, photo: &Photo) {
    let reference = reference.as_array().unwrap();
    assert_eq!(got.len(), reference.len(), "{}", photo.file);
    for row in reference {
        let number = |key: &str| row[key].as_f64().unwrap();
        let same = |d: &Detection| {
            let [cx, cy] = d.bounds.center();
            let sides = [(cx, "cx"), (cy, "cy"), (d.bounds.width(), "w"), (d.bounds.height(), "h")];
            u64::from(d.class) == row["class"].as_u64().unwrap()
                && (d.score - number("prob")).abs() <= photo.score
                && sides.iter().all(|(value, key)| (value - number(key)).abs() <= photo.px)
        };
        let at = got.iter().position(same).unwrap_or_else(|| panic!("{}: no detection like {row} among {got:#?}", photo.file));
        got.swap_remove(at);
    }
}
