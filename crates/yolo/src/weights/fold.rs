//! Batch norm folded into its convolution: the same function with fewer numbers, and free of any program's epsilon.
use super::{ConvWeights, NormWeights, Weights};

/// The same parameters with every batch norm folded into kernel and bias.
#[must_use]
pub fn folded(weights: &Weights, epsilon: f64) -> Weights {
    let convolutions = weights.convolutions.iter().map(|convolution| fold(convolution, epsilon)).collect();
    Weights { seen: weights.seen, convolutions }
}

/// `kernel' = kernel s`, `bias' = beta - mean s` with `s = gamma / sqrt(variance + epsilon)` for each output channel.
#[must_use]
pub fn fold(convolution: &ConvWeights, epsilon: f64) -> ConvWeights {
    let Some(NormWeights { gamma, mean, variance }) = &convolution.norm else { return convolution.clone() };
    let scales: Vec<f64> = gamma.iter().zip(variance).map(|(g, v)| f64::from(*g) / (f64::from(*v) + epsilon).sqrt()).collect();
    let channel = convolution.kernel.len() / scales.len().max(1);
    let scaled = convolution.kernel.chunks(channel.max(1)).zip(&scales);
    let kernel = scaled.flat_map(|(values, s)| values.iter().map(move |v| (f64::from(*v) * s) as f32)).collect();
    let shifts = convolution.bias.iter().zip(mean).zip(&scales);
    let bias = shifts.map(|((beta, mean), s)| (f64::from(*beta) - f64::from(*mean) * s) as f32).collect();
    ConvWeights { bias, norm: None, kernel }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_hand() {
        let norm = NormWeights { gamma: vec![2.0, 1.0], mean: vec![0.5, -1.0], variance: vec![0.24, 3.99] };
        let convolution = ConvWeights { bias: vec![1.0, 0.0], norm: Some(norm), kernel: vec![1.0, -1.0, 2.0, 4.0] };
        let folded = fold(&convolution, 0.01);
        assert_eq!(folded, ConvWeights { bias: vec![-1.0, 0.5], norm: None, kernel: vec![4.0, -4.0, 1.0, 2.0] });
    }
}
