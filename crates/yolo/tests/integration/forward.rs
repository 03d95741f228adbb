//! Forward passes against Darknet's, OpenCV's and AlexeyAB's.
use crate::golden;
use burn::tensor::{Device, Tensor, TensorData};
use tcross_yolo::{Model, ModelConfig, NetSize, Weights, Yolo, network::read_logits, weights::cfg};

fn image(path: impl AsRef<std::path::Path>) -> Tensor<4> {
    let (shape, values) = golden::npy(path);
    Tensor::from_data(TensorData::new(values, shape), &Device::flex())
}

fn network(model: &Model, epsilon: f64) -> Yolo {
    Yolo::new(&ModelConfig { epsilon, ..model.config.clone() }, &model.weights, &Device::flex()).unwrap()
}

/// Each head against a reference file, at most `tolerance` apart.
fn check_heads<'a>(network: &Yolo, input: Tensor<4>, references: impl IntoIterator<Item = (&'a str, f32)>, dir: &std::path::Path) {
    let heads = network.forward(input);
    for (head, (file, tolerance)) in heads.iter().zip(references) {
        let (shape, expected) = golden::npy(dir.join(file));
        assert_eq!(head.dims().as_slice(), shape);
        let difference = golden::max_difference(&read_logits(head), &expected);
        assert!(difference < tolerance, "{file}: {difference}");
    }
}

#[test]
fn every_connection_of_the_full_network() {
    let Some(dir) = golden::folder("wiring-w16") else { return };
    for size in ["160x160", "192x128"] {
        let model = Model::load_darknet(dir.join(format!("yolov3-w16-{size}.cfg")), dir.join("yolov3-w16.weights")).unwrap();
        assert_eq!((model.config.width, model.config.channel_multiple), (0.0625, 1)); // recognised as a scaled yolov3
        let input = image(dir.join(format!("input-{size}.npy")));
        let files = |kind: &str| [81, 93, 105].map(|layer| format!("{kind}head-{size}-{layer}.npy"));
        let against = |kind: &str, epsilon, tolerance| {
            let files = files(kind);
            check_heads(&network(&model, epsilon), input.clone(), files.iter().map(|f| (f.as_str(), tolerance)), &dir);
        };
        against("", 1e-6, 1e-4);
        against("opencv-", 1e-6, 1e-4);
        against("alexey-", 1e-5, 5e-5);
    }
}

#[test]
fn every_layer_of_the_full_network() {
    let Some(dir) = golden::folder("wiring-w16") else { return };
    for size in ["160x160", "192x128"] {
        let model = Model::load_darknet(dir.join(format!("yolov3-w16-{size}.cfg")), dir.join("yolov3-w16.weights")).unwrap();
        let rows =
            check_table(&network(&model, 1e-6), image(dir.join(format!("input-{size}.npy"))), &dir.join(format!("layers-{size}.json")));
        assert_eq!(rows, 107 - 3); // heads are activated in the table
    }
}

#[test]
fn tiny_with_the_published_weights() {
    let Some(dir) = golden::folder("darknet-tiny") else { return };
    let model = Model::load(dir.join("yolov3-tiny.cfg")).unwrap();
    let input = image(dir.join("dog-input.npy"));
    check_heads(&network(&model, 1e-6), input.clone(), [("dog-raw-15.npy", 3e-4), ("dog-raw-22.npy", 3e-4)], &dir);
    check_heads(&network(&model, 1e-5), input.clone(), [("dog-raw-15.npy", 2e-3), ("dog-raw-22.npy", 2e-3)], &dir);
    check_heads(&network(&model, 1e-5), input.clone(), [("alexey-dog-raw-15.npy", 1e-4)], &dir);
    assert_eq!(check_table(&network(&model, 1e-6), input, &dir.join("layers-dog.json")), 24 - 2);
}

/// Each layer's mean, deviation and first values, within 1e-4 of its largest value; says how many layers were compared.
fn check_table(network: &Yolo, input: Tensor<4>, table: &std::path::Path) -> usize {
    let table = golden::json(table);
    let mut compared = 0;
    let _ = network.clone().layerwise().forward_watched(input, &mut |layer, output| {
        let output = &tcross_kernels::ops::channels_first(output.clone());
        let row = &table["layers"][layer];
        if row["type"] == "yolo" {
            return;
        }
        let number = |key: &str| row[key].as_f64().unwrap();
        let shape: Vec<usize> = row["shape"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap() as usize).collect();
        assert_eq!(output.dims()[1..], shape, "layer {layer}");
        let values: Vec<f64> = read_logits(output).into_iter().map(f64::from).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let deviation = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt();
        let close = 1e-4 * number("max").abs().max(number("min").abs());
        assert!((mean - number("mean")).abs() < close, "layer {layer}: mean {mean}");
        assert!((deviation - number("std")).abs() < close, "layer {layer}: deviation {deviation}");
        let first = row["first8"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap());
        assert!(values.iter().zip(first).all(|(a, b)| (a - b).abs() < close), "layer {layer}");
        compared += 1;
    });
    compared
}

/// 62 million parameters, generated here as the reference data's README says.
#[test]
fn full_width() {
    let Some(dir) = golden::folder("darknet53") else { return };
    let config = cfg::read(dir.join("yolov3-416.cfg")).unwrap();
    let weights = generated(&config);
    let NetSize { width, height } = config.input;
    let input: Vec<f32> = (0..3 * width * height)
        .map(|i| {
            let (x, y, channel) = (i % width, i / width % height, i / (width * height));
            (mix(i as u32, 0x1A9E_0000) >> 8) as f32 * 2f32.powi(-25) + ((3 * x + 5 * y + 80 * channel) % 256) as f32 * 2f32.powi(-9)
        })
        .collect();
    let input = Tensor::from_data(TensorData::new(input, [1, 3, height, width]), &Device::flex());
    let model = Model { config, weights };
    let heads = network(&model, 1e-6).forward(input);
    for ((head, file), step) in heads.iter().zip(["head-81-stride1.npy", "head-93-stride2.npy", "head-105-stride4.npy"]).zip([1, 2, 4]) {
        let [_, channels, rows, columns] = head.dims();
        let all = read_logits(head);
        let picked = (0..channels).flat_map(|c| (0..rows).step_by(step).map(move |y| (c * rows + y) * columns));
        let picked: Vec<f32> = picked.flat_map(|start| (0..columns).step_by(step).map(move |x| start + x)).map(|i| all[i]).collect();
        let difference = golden::max_difference(&picked, &golden::npy(dir.join(file)).1);
        assert!(difference < 3e-4, "{file}: {difference}");
    }
}

fn mix(i: u32, seed: u32) -> u32 {
    let mut x = i.wrapping_add(seed);
    x = (x ^ (x >> 16)).wrapping_mul(0x7FEB_352D);
    x = (x ^ (x >> 15)).wrapping_mul(0x846C_A68B);
    x ^ (x >> 16)
}

/// The generator that the reference data's README describes.
fn generated(config: &ModelConfig) -> Weights {
    let graph = config.graph().unwrap();
    let mut weights = Weights::zeros(&graph);
    let mut index = 0u32;
    for ((layer, conv), convolution) in graph.convolutions().zip(&mut weights.convolutions) {
        let before_shortcut = matches!(graph.layers().get(layer + 1), Some(tcross_yolo::Layer::Shortcut { .. }));
        let bound = (6.0 / (conv.in_channels * conv.kernel * conv.kernel) as f64).sqrt();
        for (part, values) in convolution.parts_mut() {
            let (centre, half) = match part {
                "gamma" => (if before_shortcut { 0.25 } else { 0.95 }, 0.1),
                "variance" => (1.0, 0.5),
                "kernel" => (0.0, if conv.batch_norm { bound } else { 0.25 * bound }),
                _ => (0.0, 0.1),
            };
            for value in values {
                let odd = 2 * i64::from(mix(index, 0x5933_0000) >> 8) + 1 - (1 << 24);
                *value = odd as f32 * 2f32.powi(-24) * half as f32 + centre as f32;
                index += 1;
            }
        }
    }
    weights
}
