//! From raw logits to boxes.
use crate::{
    config::BoxConvention,
    fields::BoxFields,
    geometry::{Geometry, sigmoid},
    nms,
};
use tcross_dataset::{Detection, Letterbox, PixelBox};

/// A claim in the space of the network's input.
#[derive(Debug, Clone, PartialEq)]
pub struct NetDetection {
    /// Objectness times class probability, 0..1.
    pub score: f32,
    /// 0..1.
    pub objectness: f32,
    /// Index of the class.
    pub class: u32,
    /// In net-input pixels; not clipped.
    pub bounds: PixelBox,
    /// In net-input pixels, as many as the network has.
    pub keypoints: Vec<[f64; 2]>,
}

/// What is kept of a network's claims.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectOptions {
    /// Claims are kept whose score is at least this, 0..1.
    pub score: f32,
    /// Of two claims of one class that overlap by more than this IoU, the one of lower score goes.
    pub nms_iou: f64,
    /// At most this many boxes an image.
    pub most: usize,
    /// Whether boxes are cut at the image's border.
    pub clip: bool,
}

impl Default for DetectOptions {
    fn default() -> Self {
        Self { score: 0.05, nms_iou: 0.45, most: 200, clip: true }
    }
}

/// Every claim of one image with a score of at least `min_score`: one a box and class, in the order of the logits. `logits` holds each
/// head's `[anchor, field, row, column]`, coarse first. Claims that are not finite are left out.
#[must_use]
pub fn decode(geometry: &Geometry, logits: &[&[f32]], min_score: f32) -> Vec<NetDetection> {
    // A score is never above its objectness: most predictors are passed over by comparing logits.
    let least_logit = (min_score / (1.0 - min_score)).ln() - 1e-3;
    let mut found = Vec::new();
    for (head, logits) in logits.iter().enumerate() {
        for at in geometry.predictors(head) {
            let logit = logits[geometry.index(at, BoxFields::OBJECTNESS)];
            if logit < least_logit {
                continue;
            }
            let objectness = sigmoid(logit);
            let b = geometry.decode_box(at, geometry.box_logits(at, logits));
            let (width, height) = (geometry.net.width as f64, geometry.net.height as f64);
            let bounds =
                PixelBox::from_center(f64::from(b.x) * width, f64::from(b.y) * height, f64::from(b.w) * width, f64::from(b.h) * height);
            if !bounds.is_valid() {
                continue;
            }
            for (class, field) in geometry.fields.classes().enumerate() {
                let score = objectness * sigmoid(logits[geometry.index(at, field)]);
                if score >= min_score {
                    let ([cx, cy], [aw, ah]) = (geometry.cell_center(at), geometry.anchor(at));
                    let point = |k| {
                        let [x, y] = [0, 1].map(|axis| logits[geometry.index(at, geometry.fields.keypoint(k).start + axis)]);
                        [f64::from(cx + x * aw) * width, f64::from(cy + y * ah) * height]
                    };
                    let keypoints = (0..geometry.fields.keypoints).map(point).collect();
                    found.push(NetDetection { score, objectness, class: class as u32, bounds, keypoints });
                }
            }
        }
    }
    found
}

/// From one image's logits to detections in the source image, by falling score: decoding, suppression, the letterbox undone, and boxes
/// counted as the model's training set counts them.
#[must_use]
pub fn detect(
    geometry: &Geometry,
    logits: &[&[f32]],
    letterbox: &Letterbox,
    boxes: BoxConvention,
    options: &DetectOptions,
) -> Vec<Detection> {
    let kept = nms::nms(decode(geometry, logits, options.score), options.nms_iou, options.most);
    kept.iter().map(|d| to_source(d, letterbox, boxes, options.clip)).collect()
}

/// One claim in the source image.
#[must_use]
pub fn to_source(detection: &NetDetection, letterbox: &Letterbox, boxes: BoxConvention, clip: bool) -> Detection {
    let mut bounds = letterbox.box_to_source(&detection.bounds);
    if clip {
        bounds = bounds.clipped(letterbox.source.0 as f64, letterbox.source.1 as f64);
    }
    bounds.x_max -= boxes.extra();
    bounds.y_max -= boxes.extra();
    Detection { score: f64::from(detection.score), class: detection.class, bounds, pose: None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Architecture, ModelConfig, NetSize, Truth, targets};
    use tcross_dataset::Rng;

    fn geometry() -> Geometry {
        ModelConfig { classes: 3, keypoints: 1, ..ModelConfig::of(Architecture::YoloV3Tiny) }.geometry(NetSize { width: 96, height: 64 })
    }

    fn logits(geometry: &Geometry) -> Vec<Vec<f32>> {
        let mut rng = Rng::for_item(5, "test/decode", 0);
        (0..2).map(|head| (0..geometry.head_len(head)).map(|_| 2.0 * rng.normal() as f32).collect()).collect()
    }

    /// The naive twin: every predictor and class, by the formulas, in f64.
    #[test]
    fn equals_the_formulas() {
        [1.0, 2.0].into_iter().for_each(equals_the_formulas_at);
    }

    fn equals_the_formulas_at(scale_xy: f32) {
        let geometry = Geometry { scale_xy, ..geometry() };
        let logits = logits(&geometry);
        let views: Vec<&[f32]> = logits.iter().map(Vec::as_slice).collect();
        let got = decode(&geometry, &views, 0.3);
        let s = |x: f32| 1.0 / (1.0 + (-f64::from(x)).exp());
        let stretched = |x: f32| 0.5 + f64::from(scale_xy) * (s(x) - 0.5);
        let mut naive = Vec::new();
        for (head, grid) in geometry.heads.iter().enumerate() {
            for (anchor, &m) in grid.mask.iter().enumerate() {
                for row in 0..grid.rows {
                    for column in 0..grid.columns {
                        let t = |field: usize| logits[head][((anchor * 10 + field) * grid.rows + row) * grid.columns + column];
                        for class in 0..3 {
                            let score = s(t(4)) * s(t(5 + class));
                            if score >= 0.3 {
                                let stride = grid.stride_px as f64;
                                let [aw, ah] = geometry.anchors[m].map(f64::from);
                                let (x, y) = ((column as f64 + stretched(t(0))) * stride, (row as f64 + stretched(t(1))) * stride);
                                let (w, h) = (f64::from(t(2)).exp() * aw, f64::from(t(3)).exp() * ah);
                                let point = [
                                    (column as f64 + 0.5) * stride + f64::from(t(8)) * aw,
                                    (row as f64 + 0.5) * stride + f64::from(t(9)) * ah,
                                ];
                                naive.push((score, class as u32, PixelBox::from_center(x, y, w, h), point));
                            }
                        }
                    }
                }
            }
        }
        assert!(naive.len() > 20 && naive.len() == got.len());
        for (a, b) in got.iter().zip(&naive) {
            let close = |x: f64, y: f64| (x - y).abs() < 1e-4 * (1.0 + y.abs());
            assert!(close(f64::from(a.score), b.0) && a.class == b.1);
            assert!(<[f64; 4]>::from(a.bounds).iter().zip(<[f64; 4]>::from(b.2)).all(|(x, y)| close(*x, y)));
            assert!(a.keypoints[0].iter().zip(b.3).all(|(x, y)| close(*x, y)));
        }
    }

    #[test]
    fn a_perfect_network_gives_the_truth_back() {
        // Write the targets of an inclusive box as logits: detection must return exactly that box.
        let geometry = geometry();
        let letterbox = Letterbox::new((192, 128), (96, 64));
        let stored = PixelBox::from([60.0, 40.0, 99.0, 71.0]);
        let continuous = PixelBox { x_max: stored.x_max + 1.0, y_max: stored.y_max + 1.0, ..stored };
        let truth = [Truth::from_net_box(&letterbox.box_to_net(&continuous), 2, geometry.net)];
        let positives = targets::assign(&geometry, 0, &truth, 1.0).unwrap();
        let mut logits: Vec<Vec<f32>> = (0..2).map(|head| vec![-20.0; geometry.head_len(head)]).collect();
        let inverse = |p: f32| (p / (1.0 - p)).ln();
        for p in &positives {
            let t = p.target;
            for (field, value) in [inverse(t[0]), inverse(t[1]), t[2], t[3], 20.0].into_iter().enumerate() {
                logits[p.at.head][geometry.index(p.at, field)] = value;
            }
            logits[p.at.head][geometry.index(p.at, 5 + 2)] = 20.0;
        }
        let views: Vec<&[f32]> = logits.iter().map(Vec::as_slice).collect();
        let got = detect(&geometry, &views, &letterbox, BoxConvention::Inclusive, &DetectOptions::default());
        assert_eq!((got.len(), got[0].class), (1, 2));
        assert!(<[f64; 4]>::from(got[0].bounds).iter().zip(<[f64; 4]>::from(stored)).all(|(a, b)| (a - b).abs() < 1e-3), "{got:?}");
    }

    #[test]
    fn broken_logits_claim_nothing() {
        let geometry = geometry();
        for bad in [f32::NAN, f32::INFINITY] {
            let logits: Vec<Vec<f32>> = (0..2).map(|head| vec![bad; geometry.head_len(head)]).collect();
            let views: Vec<&[f32]> = logits.iter().map(Vec::as_slice).collect();
            assert!(decode(&geometry, &views, 0.1).is_empty());
        }
    }
}
