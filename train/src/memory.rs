//! How much memory a training will need, told before its first step.
use crate::{config::Config, device::Accelerator, error::TrainError};
use tcross_yolo::{ModelConfig, NetSize, model, refiner::Patch};

/// An estimate in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Estimate {
    /// Weights, gradients, the optimiser's moments, the moving average and what is read back of them.
    pub parameters: u64,
    /// What the forward pass keeps for the backward pass, and the largest gradients.
    pub activations: u64,
    /// Batches that wait.
    pub batches: u64,
    /// Decoded images.
    pub cache: u64,
    /// What the second stage sees of each claim.
    pub claims: u64,
}

/// Copies of each parameter: itself, its gradient, two moments, the average, and one on its way.
const PARAMETER_COPIES: u64 = 6;
/// Copies of each convolution's output while all of them wait for the backward pass (before and after batch norm, activation).
const ACTIVATION_COPIES: u64 = 3;
/// Claims of an image that are learned from, made ones included: more than the quickstart's 13.
const CLAIMS: u64 = 16;

impl Estimate {
    /// For this network at the largest of its input sizes, with `images` images to cache.
    ///
    /// # Errors
    /// If the layers do not fit together.
    pub fn of(config: &Config, network: &ModelConfig, images: usize) -> Result<Self, TrainError> {
        let area = |net: &NetSize| net.width * net.height;
        let windows = (config.windows.until > 0.0).then_some(config.windows.side);
        let sizes = config.multi_scale.iter().copied().chain(windows).map(NetSize::square).chain([network.input]);
        let net = sizes.max_by_key(area).unwrap_or(network.input);
        let layers = model::info(&ModelConfig { input: net, ..network.clone() })?;
        let convolutions = layers.iter().filter(|layer| layer.parameters > 0);
        let outputs: usize = convolutions.map(|layer| layer.shape.iter().product::<usize>()).sum();
        let parameters: usize = layers.iter().map(|layer| layer.parameters).sum();
        let batch = config.batch as u64;
        let picture = 3 * area(&network.input) as u64;
        Ok(Self {
            // Each further part of a batch has parameters and gradients of its own.
            parameters: 4 * (PARAMETER_COPIES + 2 * (config.batch_parts as u64 - 1)) * parameters as u64,
            activations: 4 * ACTIVATION_COPIES * batch * outputs as u64,
            batches: 4 * 3 * area(&net) as u64 * batch * (config.workers as u64 + 2),
            cache: (picture * images as u64).min((config.cache_gb * 1e9) as u64),
            claims: if config.refine.epochs > 0.0 { CLAIMS * Patch::BYTES as u64 * images as u64 } else { 0 },
        })
    }

    /// All together.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.parameters + self.activations + self.batches + self.cache + self.claims
    }

    /// Compares with what the system has free, where that is what the training takes: a graphics card has memory of its own.
    ///
    /// # Errors
    /// If the training cannot fit.
    pub fn check(&self, accelerator: Accelerator) -> Result<(), TrainError> {
        match available_bytes().filter(|_| accelerator == Accelerator::Cpu) {
            Some(available) if self.total() > available => {
                Err(TrainError::Memory { needed: gigabytes(self.total()), available: gigabytes(available) })
            }
            _ => Ok(()),
        }
    }
}

impl std::fmt::Display for Estimate {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let [total, parameters, activations, batches, cache] =
            [self.total(), self.parameters, self.activations, self.batches, self.cache].map(gigabytes);
        write!(f, "about {total}: parameters {parameters}, activations {activations}, waiting batches {batches}, images {cache}")?;
        if self.claims > 0 { write!(f, ", claims {}", gigabytes(self.claims)) } else { Ok(()) }
    }
}

fn gigabytes(bytes: u64) -> String {
    format!("{:.2} GB", bytes as f64 / 1e9)
}

/// Memory that a program can still get, where the system tells (Linux).
fn available_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("MemAvailable:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Windows;
    use tcross_yolo::Architecture;

    #[test]
    fn grows_with_batch_and_input() {
        let config = Config::default();
        let network = ModelConfig::of(Architecture::YoloV3Tiny);
        let estimate = Estimate::of(&config, &network, 1000).unwrap();
        assert_eq!(estimate.cache, 1000 * 3 * 416 * 416);
        let double = Estimate::of(&Config { batch: 16, ..config.clone() }, &network, 1000).unwrap();
        assert_eq!(double.activations, 2 * estimate.activations);
        let windows = Windows { until: 0.5, side: 832, ..Windows::default() };
        for larger in [Config { multi_scale: vec![832], ..config.clone() }, Config { windows, ..config }] {
            assert_eq!(Estimate::of(&larger, &network, 1000).unwrap().activations, 4 * estimate.activations);
        }
        let huge = Estimate { parameters: u64::MAX / 2, ..estimate };
        assert!(available_bytes().is_none() || matches!(huge.check(Accelerator::Cpu), Err(TrainError::Memory { .. })));
        assert!(huge.check(Accelerator::Cuda).is_ok());
    }
}
