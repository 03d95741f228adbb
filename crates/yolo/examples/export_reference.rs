//! Writes a model in every exported form together with what this crate computes from one image, for `scripts/check-export.py`:
//!
//! `cargo run --release -p tcross-yolo --example export_reference -- MODEL IMAGE OUT`
//!
//! OUT gets `exact.{cfg,weights,onnx}`, `folded.{cfg,weights,onnx}`, `input.npy`, `head_STRIDE.npy` and `detections.jsonl`.
use burn::tensor::{Device, Tensor, TensorData};
use std::{error::Error, path::Path};
use tcross_dataset::{ImageDetections, detections, files};
use tcross_yolo::{BoxConvention, DetectOptions, ExportFormat, Model, Yolo, detect, input, network::read_logits};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [model, image_path, out] = arguments.as_slice() else { return Err("usage: export_reference MODEL IMAGE OUT".into()) };
    let (model, out) = (Model::load(model)?, Path::new(out));
    files::create_dir(out)?;
    for (name, model) in [("exact", &model), ("folded", &model.folded()?)] {
        model.export(ExportFormat::Darknet, out.join(name))?;
        model.export(ExportFormat::Onnx, out.join(name))?;
    }

    let image = image::open(image_path)?.to_rgb8();
    let net = model.config.input;
    let mut values = vec![0.0; 3 * net.width * net.height];
    let letterbox = input::prepare(&image, net, &mut values);
    write_npy(&out.join("input.npy"), [1, 3, net.height, net.width], &values)?;

    let device = Device::flex();
    let network = Yolo::new(&model.config, &model.weights, &device)?;
    let heads = network.forward(Tensor::from_data(TensorData::new(values, [1, 3, net.height, net.width]), &device));
    let logits: Vec<Vec<f32>> = heads.iter().map(read_logits).collect();
    for ((head, values), (_, _, stride)) in heads.iter().zip(&logits).zip(network.graph().heads()) {
        write_npy(&out.join(format!("head_{stride}.npy")), head.dims(), values)?;
    }
    let views: Vec<&[f32]> = logits.iter().map(Vec::as_slice).collect();
    let options = DetectOptions { score: 0.25, clip: false, most: usize::MAX, ..Default::default() };
    let row = ImageDetections {
        image: image_path.clone(),
        width: image.width(),
        height: image.height(),
        detections: detect(&model.config.geometry(net), &views, &letterbox, BoxConvention::Continuous, &options),
        ms: None,
    };
    Ok(detections::write(out.join("detections.jsonl"), [&row])?)
}

/// A `.npy` file of little-endian float32.
fn write_npy(path: &Path, shape: [usize; 4], values: &[f32]) -> Result<(), Box<dyn Error>> {
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {:?}, }}", shape).replace('[', "(").replace(']', ")");
    let padded = format!("{header:<width$}\n", width = (header.len() + 11).next_multiple_of(64) - 11);
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((padded.len() as u16).to_le_bytes());
    bytes.extend(padded.as_bytes());
    bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    Ok(files::write_atomically(path, bytes)?)
}
