//! Knows a training that has gone astray, and writes down the batch that it went astray on.
use crate::{
    data::{Batch, Samples},
    error::TrainError,
    run::{RunDir, draw},
    step::StepOutput,
};
use serde_json::json;
use std::path::PathBuf;

/// A loss this many times the usual one is taken for divergence.
const MOST_TIMES: f64 = 1000.0;

/// What is wrong with a step, if anything; `usual` is the moving average of the loss, and takes the step in.
pub(crate) fn judge(output: &StepOutput, step: u64, usual: &mut f64) -> Option<String> {
    let (total, before) = (output.terms.total(), *usual);
    // One wild batch moves the usual loss by a tenth at most.
    *usual = if step == 0 { total } else { 0.99 * before + 0.01 * total.min(10.0 * before) };
    if !total.is_finite() {
        Some(format!("the loss is {total}"))
    } else if !output.gradient_norm.is_finite() {
        Some(format!("the gradient's norm is {}", output.gradient_norm))
    } else if step > 0 && total > MOST_TIMES * before {
        Some(format!("the loss is {total:.3}, usually {before:.3}"))
    } else {
        None
    }
}

/// Writes `batches/diverged.jpg`, the batch with its boxes, and `diverged.json` beside it: the images it was made of, what was to be learned
/// from each, and the step's numbers. Returns the picture's path.
pub(crate) fn write(
    run: &RunDir,
    samples: &Samples,
    batch: &Batch,
    rate: f64,
    output: &StepOutput,
    what: &str,
) -> Result<PathBuf, TrainError> {
    let picture = run.write_picture("batches/diverged.jpg", &draw::batch(batch))?;
    let images = batch.sources.iter().zip(&batch.truths).map(|(sources, truths)| {
        let names: Vec<&str> = sources.iter().map(|&index| samples.records[index].image.as_str()).collect();
        let boxes = truths.iter().map(|t| {
            let b = t.bounds;
            json!({ "center": [b.x, b.y], "size": [b.w, b.h], "class": t.class, "weight": t.weight })
        });
        json!({ "made_of": names, "boxes": boxes.collect::<Vec<_>>() })
    });
    let t = &output.terms;
    let number = |value: f64| if value.is_finite() { json!(value) } else { json!(value.to_string()) };
    let report = json!({
        "step": batch.request.step,
        "what": what,
        "rate": rate,
        "gradient_norm": number(output.gradient_norm),
        "loss": {
            "center": number(t.center), "size": number(t.size), "objectness": number(t.objectness),
            "class": number(t.class), "keypoints": number(t.keypoints),
        },
        "input": [batch.request.input.net.width, batch.request.input.net.height],
        "images": images.collect::<Vec<_>>(),
    });
    run.write("batches/diverged.json", &format!("{report:#}\n"))?;
    Ok(picture)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tcross_yolo::LossTerms;

    fn output(total: f64, gradient_norm: f64) -> StepOutput {
        StepOutput { terms: LossTerms { center: total, ..LossTerms::default() }, gradient_norm }
    }

    #[test]
    fn numbers_that_are_none_and_leaps_are_told() {
        let mut usual = 0.0;
        assert_eq!(judge(&output(5.0, 1.0), 0, &mut usual), None);
        assert_eq!(judge(&output(50.0, 1.0), 1, &mut usual), None);
        assert!((usual - (0.99 * 5.0 + 0.01 * 50.0)).abs() < 1e-12);
        let leap = judge(&output(1e5, 1.0), 2, &mut usual).unwrap();
        assert!(leap.contains("100000.000, usually 5.450"), "{leap}");
        assert!(usual < 1.1 * 5.45);
        assert!(judge(&output(f64::NAN, 1.0), 3, &mut 5.0).unwrap().contains("NaN"));
        assert!(judge(&output(5.0, f64::INFINITY), 3, &mut 5.0).unwrap().contains("norm is inf"));
    }
}
