//! Darknet's gradient, to the last decision.
use crate::golden;
use tcross_yolo::{Architecture, Geometry, Loss, LossKind, ModelConfig, NetSize, NormBox, Truth};

fn truths(dir: &std::path::Path) -> Vec<Vec<Truth>> {
    let (shape, values) = golden::npy(dir.join("truths.npy"));
    let row = |r: &[f32]| Truth {
        bounds: NormBox { x: r[0], y: r[1], w: r[2], h: r[3] },
        class: r[4] as u32,
        weight: 1.0,
        keypoints: Vec::new(),
    };
    let image = |image: &[f32]| image.chunks(5).filter(|r| r[0] != 0.0).map(row).collect();
    values.chunks(shape[1] * 5).map(image).collect()
}

#[test]
fn gradients_and_scalar_of_darknets_loss() {
    let Some(dir) = golden::folder("loss") else { return };
    let geometry: Geometry = ModelConfig { classes: 3, ..ModelConfig::of(Architecture::YoloV3Tiny) }.geometry(NetSize::square(416));
    let logits = ["h13", "h26"].map(|head| golden::npy(dir.join(format!("logits-{head}.npy"))).1);
    let expected = golden::json(dir.join("expected.json"));
    for (ignore_iou, case) in [(0.7, "pj-ignore0.7"), (0.5, "pj-ignore0.5")] {
        let got = Loss::new(LossKind::Darknet, ignore_iou).evaluate(&geometry, &logits, &truths(&dir)).unwrap();
        let mut total = 0.0;
        for (gradient, head) in got.gradients.iter().zip(["h13", "h26"]) {
            // Darknet's delta is the descent direction of the sum over the batch of two.
            let delta: Vec<f32> = gradient.iter().map(|g| -2.0 * g).collect();
            let difference = golden::max_difference(&delta, &golden::npy(dir.join(format!("delta-{case}-{head}.npy"))).1);
            assert!(difference < 1e-5, "{case} {head}: {difference}");
            let cost: f64 = delta.iter().map(|d| f64::from(*d).powi(2)).sum();
            let reference = &expected["cases"][case][head];
            assert!((cost / reference["cost"].as_f64().unwrap() - 1.0).abs() < 1e-5);
            total += reference["loss"].as_f64().unwrap();
        }
        assert!((2.0 * got.terms.total() / total - 1.0).abs() < 1e-5, "{case}: {} {total}", 2.0 * got.terms.total());
    }
}
