//! The one carrier of parameters: plain vectors. Files, the burn module and fast inference all go through it.
pub mod cfg;
pub mod darknet;
pub mod fold;
pub mod init;
pub mod onnx;
pub mod safetensors;

use crate::{
    error::YoloError,
    fields::BoxFields,
    graph::{Conv, Graph},
};
pub use init::Init;
use std::path::PathBuf;

/// Parameters of every convolution, in the order of the layers.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Weights {
    /// Images seen in training, as Darknet's files count them.
    pub seen: u64,
    /// One a convolution.
    pub convolutions: Vec<ConvWeights>,
}

/// What a file gave to a network that it fits in part.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Loaded {
    /// Layers of the convolutions whose parameters were read, rising.
    pub layers: Vec<usize>,
    /// Convolutions of the network.
    pub of: usize,
}

impl Loaded {
    /// True where nothing was left out.
    #[must_use]
    pub fn is_all(&self) -> bool {
        self.layers.len() == self.of
    }
}

impl std::fmt::Display for Loaded {
    /// `11 of 13 convolutions (layers 0-13, 18, 21)`: from the first to the last of each run of convolutions that were all read.
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        if self.is_all() {
            return write!(f, "all {} convolutions", self.of);
        }
        let mut runs: Vec<(usize, usize)> = Vec::new();
        for &layer in &self.layers {
            match runs.last_mut() {
                // Shortcuts, routes and pools between two convolutions have no parameters: a gap of a few layers is none.
                Some((_, last)) if layer <= *last + 2 => *last = layer,
                _ => runs.push((layer, layer)),
            }
        }
        let runs: Vec<String> = runs.iter().map(|(a, b)| if a == b { a.to_string() } else { format!("{a}-{b}") }).collect();
        write!(f, "{} of {} convolutions (layers {})", self.layers.len(), self.of, runs.join(", "))
    }
}

/// Parameters of one convolution.
#[derive(Debug, Clone, PartialEq)]
pub struct ConvWeights {
    /// `[out]`: the bias; with batch norm its beta.
    pub bias: Vec<f32>,
    /// Batch norm, if there is one.
    pub norm: Option<NormWeights>,
    /// `[out, in, row, column]`.
    pub kernel: Vec<f32>,
}

/// Batch norm's own numbers, `[out]` each.
#[derive(Debug, Clone, PartialEq)]
pub struct NormWeights {
    /// The scale.
    pub gamma: Vec<f32>,
    /// Running mean.
    pub mean: Vec<f32>,
    /// Running variance.
    pub variance: Vec<f32>,
}

impl ConvWeights {
    /// All zeros, in the shape of `conv`.
    #[must_use]
    pub fn zeros(conv: &Conv) -> Self {
        let zeros = || vec![0.0; conv.filters];
        let norm = conv.batch_norm.then(|| NormWeights { gamma: zeros(), mean: zeros(), variance: zeros() });
        Self { bias: zeros(), norm, kernel: vec![0.0; conv.kernel_len()] }
    }

    /// Each vector with its name, in the order of Darknet's files.
    #[must_use]
    pub fn parts(&self) -> Vec<(&'static str, &Vec<f32>)> {
        let mut parts = vec![("bias", &self.bias)];
        if let Some(NormWeights { gamma, mean, variance }) = &self.norm {
            parts.extend([("gamma", gamma), ("mean", mean), ("variance", variance)]);
        }
        parts.push(("kernel", &self.kernel));
        parts
    }

    /// As [`Self::parts`], to be written to.
    pub fn parts_mut(&mut self) -> Vec<(&'static str, &mut Vec<f32>)> {
        let mut parts = vec![("bias", &mut self.bias)];
        if let Some(NormWeights { gamma, mean, variance }) = &mut self.norm {
            parts.extend([("gamma", gamma), ("mean", mean), ("variance", variance)]);
        }
        parts.push(("kernel", &mut self.kernel));
        parts
    }
}

impl Weights {
    /// Random parameters to start training from; the same for the same seed.
    #[must_use]
    pub fn init(graph: &Graph, fields: &BoxFields, init: &Init, seed: u64) -> Self {
        init::weights(graph, fields, init, seed)
    }

    /// All zeros, in the shapes of `graph`.
    #[must_use]
    pub fn zeros(graph: &Graph) -> Self {
        Self { seen: 0, convolutions: graph.convolutions().map(|(_, conv)| ConvWeights::zeros(conv)).collect() }
    }

    /// Checks that every vector has the length that `graph` asks for.
    ///
    /// # Errors
    /// The first that has not.
    pub fn check(&self, graph: &Graph) -> Result<(), YoloError> {
        let wrong = |name: String, expected: String, found: String| Err(YoloError::Tensor { path: PathBuf::new(), name, expected, found });
        let (expected, found) = (graph.convolutions().count(), self.convolutions.len());
        if expected != found {
            return wrong("all".into(), format!("{expected} convolutions"), format!("{found}"));
        }
        for ((layer, conv), weights) in graph.convolutions().zip(&self.convolutions) {
            if conv.batch_norm != weights.norm.is_some() {
                let kind = |norm: bool| if norm { "batch norm" } else { "a bias only" }.to_string();
                return wrong(format!("layers.{layer}"), kind(conv.batch_norm), kind(weights.norm.is_some()));
            }
            for (part, values) in weights.parts() {
                let expected = if part == "kernel" { conv.kernel_len() } else { conv.filters };
                if values.len() != expected {
                    return wrong(format!("layers.{layer}.{part}"), format!("{expected} values"), values.len().to_string());
                }
            }
        }
        Ok(())
    }
}
