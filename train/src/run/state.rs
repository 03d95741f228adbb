//! `state/state.safetensors`: all that a training needs to go on as if it had never stopped. Data order, augmentation and input sizes
//! are functions of (seed, step), so the step stands for them.
use crate::{ema::Ema, error::TrainError, optimizer::Slot};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};
use std::{collections::HashMap, path::Path};
use tcross_dataset::files;
use tcross_yolo::{Graph, Weights};

/// The newest form this program reads.
const FORMAT: u32 = 1;
const KEY: &str = "tcross";

/// A stopped training.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Everything but the tensors.
    pub progress: Progress,
    /// The weights that learn.
    pub weights: Weights,
    /// Their moving average.
    pub average: Weights,
    /// What the optimiser remembers.
    pub slots: Vec<Slot>,
    /// What a second stage remembers of its claims.
    pub claims: Vec<f32>,
}

/// How far a training has come.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Version of this form.
    pub format: u32,
    /// Steps taken.
    pub step: u64,
    /// Seconds of training.
    pub seconds: f64,
    /// What the run was started with, but for its length: one `key = value` a line.
    pub identity: String,
    /// The best value of the metric, and its step.
    pub best: Option<(f64, u64)>,
    /// Validations since.
    pub since_best: u64,
    /// Validations so far.
    pub validations: u64,
    /// Sums since the last row.
    pub sums: Sums,
    /// Moving average of the loss, to know divergence by.
    pub usual_loss: f64,
    /// What the last validation took, with all that is written after it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub validation_seconds: Option<f64>,
    /// Claims that a second stage has come by.
    #[serde(default)]
    pub claims: u64,
}

/// Sums over the steps since the last row of `metrics.csv`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Sums {
    /// Number of steps.
    pub steps: u64,
    /// Centre, size, objectness, class, keypoints, gradient norm.
    pub values: [f64; 6],
    /// Seconds of steps.
    pub seconds: f64,
}

impl Progress {
    /// At the first step.
    #[must_use]
    pub fn start(identity: String) -> Self {
        Self {
            format: FORMAT,
            step: 0,
            seconds: 0.0,
            identity,
            best: None,
            since_best: 0,
            validations: 0,
            sums: Sums::default(),
            usual_loss: 0.0,
            validation_seconds: None,
            claims: 0,
        }
    }
}

impl State {
    /// Writes the file, first under a temporary name.
    ///
    /// # Errors
    /// If the folder cannot be written.
    pub fn write(
        path: &Path,
        progress: &Progress,
        weights: &Weights,
        average: &Ema,
        slots: &[Slot],
        claims: &[f32],
    ) -> Result<(), TrainError> {
        let mut tensors: Vec<(String, Vec<u8>)> = Vec::new();
        let mut put = |name: String, values: &[f32]| tensors.push((name, values.iter().flat_map(|v| v.to_le_bytes()).collect()));
        for (kind, weights) in [("weights", weights), ("average", &average.weights)] {
            for (index, convolution) in weights.convolutions.iter().enumerate() {
                convolution.parts().into_iter().for_each(|(part, values)| put(format!("{kind}.{index}.{part}"), values));
            }
        }
        for (index, slot) in slots.iter().enumerate() {
            put(format!("slots.{index}.first"), &slot.first);
            put(format!("slots.{index}.second"), &slot.second);
        }
        put("claims".into(), claims);
        let broken = |e: &dyn std::fmt::Display| TrainError::state(path, e);
        let views = tensors.iter().map(|(name, bytes)| Ok((name, TensorView::new(Dtype::F32, vec![bytes.len() / 4], bytes)?)));
        let views = views.collect::<Result<Vec<_>, safetensors::SafeTensorError>>().map_err(|e| broken(&e))?;
        let header = toml::to_string(progress).map_err(|e| broken(&e))?;
        let bytes = safetensors::serialize(views, Some(HashMap::from([(KEY.into(), header)]))).map_err(|e| broken(&e))?;
        Ok(files::write_atomically(path, bytes)?)
    }

    /// Reads a file that belongs to a training of this identity and these layers.
    ///
    /// # Errors
    /// If it is broken, of a newer form, or of another training (naming the first difference).
    pub fn read(path: &Path, identity: &str, graph: &Graph) -> Result<Self, TrainError> {
        let bytes = std::fs::read(path).map_err(|e| TrainError::state(path, format!("{e}; nothing to resume from")))?;
        let broken = |e: &dyn std::fmt::Display| TrainError::state(path, e);
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|e| broken(&e))?;
        let text = header.metadata().as_ref().and_then(|m| m.get(KEY)).ok_or_else(|| broken(&"not a state of this program"))?;
        #[derive(Deserialize)]
        struct Version {
            format: u32,
        }
        let version: Version = toml::from_str(text).map_err(|e| broken(&e.message()))?;
        if version.format > FORMAT {
            return Err(broken(&format!("format {} is newer than this program, which reads format {FORMAT}", version.format)));
        }
        let progress: Progress = toml::from_str(text).map_err(|e| broken(&e.message()))?;
        if let Some(difference) = first_difference(&progress.identity, identity) {
            return Err(broken(&difference));
        }
        let tensors = SafeTensors::deserialize(&bytes).map_err(|e| broken(&e))?;
        let values = |name: &str| -> Result<Vec<f32>, TrainError> {
            let tensor = tensors.tensor(name).map_err(|e| broken(&format!("{name}: {e}")))?;
            Ok(tensor.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
        };
        let weights = |kind: &str| -> Result<Weights, TrainError> {
            let mut weights = Weights::zeros(graph);
            for (index, convolution) in weights.convolutions.iter_mut().enumerate() {
                for (part, target) in convolution.parts_mut() {
                    *target = values(&format!("{kind}.{index}.{part}"))?;
                }
            }
            weights.check(graph)?;
            Ok(weights)
        };
        let count = (0..).take_while(|k| tensors.tensor(&format!("slots.{k}.first")).is_ok()).count();
        let slot = |k| Ok(Slot { first: values(&format!("slots.{k}.first"))?, second: values(&format!("slots.{k}.second"))? });
        let slots = (0..count).map(slot).collect::<Result<_, TrainError>>()?;
        let claims = if tensors.tensor("claims").is_ok() { values("claims")? } else { Vec::new() };
        Ok(Self { weights: weights("weights")?, average: weights("average")?, slots, claims, progress })
    }
}

/// The first line in which two lists of settings differ.
fn first_difference(saved: &str, now: &str) -> Option<String> {
    let missing = |line: Option<&str>| line.unwrap_or("nothing").to_owned();
    let (mut saved, mut now) = (saved.lines(), now.lines());
    loop {
        match (saved.next(), now.next()) {
            (None, None) => return None,
            (a, b) if a == b => {}
            (a, b) => {
                let (a, b) = (missing(a), missing(b));
                return Some(format!("was saved by another training: it has `{a}`, this one `{b}`; only lengths may change on a resume"));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tcross_yolo::{Architecture, ModelConfig};

    #[test]
    fn survives_the_file_to_the_bit() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("state.safetensors");
        let config = ModelConfig { width: 0.0625, ..ModelConfig::of(Architecture::YoloV3Tiny) };
        let graph = config.graph().unwrap();
        let weights = |seed| Weights::init(&graph, &config.fields(), &Default::default(), seed);
        let mut progress = Progress::start("batch = 8\nrate = 0.1\n".into());
        progress.seconds = 0.1 + 0.2;
        progress.best = Some((1.0 / 3.0, 7));
        let slots = vec![Slot { first: vec![0.1, -0.0], second: vec![1e-30, 3.0] }, Slot::default()];
        State::write(&path, &progress, &weights(1), &Ema::new(weights(2), 0.9), &slots, &[0.3, -1.0]).unwrap();
        let state = State::read(&path, &progress.identity, &graph).unwrap();
        assert_eq!(state, State { progress: progress.clone(), weights: weights(1), average: weights(2), slots, claims: vec![0.3, -1.0] });

        let message = State::read(&path, "batch = 8\nrate = 0.2\n", &graph).unwrap_err().to_string();
        assert!(message.contains("`rate = 0.1`") && message.contains("`rate = 0.2`"), "{message}");
        progress.format = 9;
        State::write(&path, &progress, &weights(1), &Ema::new(weights(2), 0.9), &[], &[]).unwrap();
        assert!(State::read(&path, &progress.identity, &graph).unwrap_err().to_string().contains("format 9 is newer"));
    }
}
