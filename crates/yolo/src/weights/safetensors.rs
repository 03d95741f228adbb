//! Safetensors files: one named float32 tensor a parameter, `layers.12.kernel` and so on, which any tool can read.
//!
//! The only metadata is `tcross`: a JSON object with the format's number and the images seen. (One entry, because the format's library
//! writes several in no fixed order, and the same weights should give the same bytes.)
use super::{ConvWeights, NormWeights, Weights};
use crate::{
    error::YoloError,
    graph::{Conv, Graph},
};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use std::{collections::HashMap, path::Path};
use tcross_dataset::files;

/// The newest format this program reads.
pub const FORMAT: u32 = 1;

const KEY: &str = "tcross";

#[derive(serde::Serialize, serde::Deserialize)]
struct Header {
    format: u32,
    seen: u64,
}

fn shape(part: &str, conv: &Conv) -> Vec<usize> {
    if part == "kernel" { vec![conv.filters, conv.in_channels, conv.kernel, conv.kernel] } else { vec![conv.filters] }
}

/// The file's bytes; the same for the same parameters.
///
/// # Errors
/// If the parameters do not fit the layers.
pub fn to_bytes(graph: &Graph, weights: &Weights) -> Result<Vec<u8>, YoloError> {
    weights.check(graph)?;
    let mut tensors: Vec<(String, Vec<usize>, Vec<u8>)> = Vec::new();
    for ((layer, conv), convolution) in graph.convolutions().zip(&weights.convolutions) {
        for (part, values) in convolution.parts() {
            let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
            tensors.push((format!("layers.{layer}.{part}"), shape(part, conv), bytes));
        }
    }
    let failed = |e: &dyn std::fmt::Display| YoloError::broken("safetensors", e);
    let views = tensors.iter().map(|(name, shape, bytes)| Ok((name, TensorView::new(Dtype::F32, shape.clone(), bytes)?)));
    let views: Vec<_> = views.collect::<Result<_, safetensors::SafeTensorError>>().map_err(|e| failed(&e))?;
    let header = serde_json::to_string(&Header { format: FORMAT, seen: weights.seen }).map_err(|e| failed(&e))?;
    safetensors::serialize(views, Some(HashMap::from([(KEY.into(), header)]))).map_err(|e| failed(&e))
}

/// Writes all parameters, first under a temporary name.
///
/// # Errors
/// If the parameters do not fit the layers, or the folder cannot be written.
pub fn write(path: impl AsRef<Path>, graph: &Graph, weights: &Weights) -> Result<(), YoloError> {
    files::write_atomically(&path, to_bytes(graph, weights)?).map_err(|e| YoloError::broken(&path, e))
}

/// Reads all parameters of a network.
///
/// # Errors
/// If the file cannot be read, is of a newer format, or a tensor is missing, unknown, or of another shape.
pub fn read(path: impl AsRef<Path>, graph: &Graph) -> Result<Weights, YoloError> {
    let path = path.as_ref();
    let bytes = std::fs::read(path).map_err(|e| YoloError::io(path, e))?;
    let broken = |e: &dyn std::fmt::Display| YoloError::broken(path, format!("no safetensors file: {e}"));
    let (_, metadata) = SafeTensors::read_metadata(&bytes).map_err(|e| broken(&e))?;
    let file = SafeTensors::deserialize(&bytes).map_err(|e| broken(&e))?;
    let seen = match metadata.metadata().as_ref().and_then(|entries| entries.get(KEY)) {
        None => 0, // written by another program
        Some(text) => {
            let header: Header = serde_json::from_str(text).map_err(|e| broken(&e))?;
            if header.format > FORMAT {
                return Err(YoloError::Format { path: path.to_owned(), found: header.format.to_string(), known: FORMAT });
            }
            header.seen
        }
    };

    let wrong =
        |name: &str, expected: String, found: String| YoloError::Tensor { path: path.to_owned(), name: name.into(), expected, found };
    let mut names = Vec::new();
    let mut take = |layer: usize, conv: &Conv, part: &str| {
        let (name, shape) = (format!("layers.{layer}.{part}"), shape(part, conv));
        let expected = || format!("F32 {shape:?}");
        let tensor = file.tensor(&name).map_err(|_| wrong(&name, expected(), "none".into()))?;
        if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
            return Err(wrong(&name, expected(), format!("{:?} {:?}", tensor.dtype(), tensor.shape())));
        }
        names.push(name);
        Ok(tensor.data().as_chunks::<4>().0.iter().map(|word| f32::from_le_bytes(*word)).collect())
    };
    let mut weights = Weights { seen, convolutions: Vec::new() };
    for (layer, conv) in graph.convolutions() {
        let mut take = |part| take(layer, conv, part);
        let bias = take("bias")?;
        let norm = if conv.batch_norm {
            Some(NormWeights { gamma: take("gamma")?, mean: take("mean")?, variance: take("variance")? })
        } else {
            None
        };
        weights.convolutions.push(ConvWeights { bias, norm, kernel: take("kernel")? });
    }
    let mut found = file.names();
    found.sort_unstable();
    names.sort_unstable();
    match found.iter().find(|name| names.binary_search_by(|n| n.as_str().cmp(name)).is_err()) {
        Some(unknown) => Err(wrong(unknown, "no such tensor in this architecture".into(), "one".into())),
        None => Ok(weights),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Architecture, ModelConfig};

    fn model(width: f64, classes: usize) -> (Graph, Weights) {
        let config = ModelConfig { width, classes, ..ModelConfig::of(Architecture::YoloV3Tiny) };
        let graph = config.graph().unwrap();
        let weights = Weights::init(&graph, &config.fields(), &Default::default(), 5);
        (graph, Weights { seen: 12, ..weights })
    }

    #[test]
    fn there_and_back_is_bit_identical() {
        let (graph, weights) = model(0.125, 2);
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.safetensors");
        write(&path, &graph, &weights).unwrap();
        let again = read(&path, &graph).unwrap();
        assert_eq!(again, weights);
        assert_eq!(to_bytes(&graph, &again).unwrap(), std::fs::read(&path).unwrap());
    }

    #[test]
    fn other_networks_and_broken_files_are_named() {
        let (graph, weights) = model(0.125, 2);
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.safetensors");
        write(&path, &graph, &weights).unwrap();
        let with_classes = read(&path, &model(0.125, 1).0).unwrap_err().to_string();
        assert!(with_classes.contains("'layers.15.bias': expected F32 [18], found F32 [21]"), "{with_classes}");
        let wider = read(&path, &model(0.25, 2).0).unwrap_err().to_string();
        assert!(wider.contains("layers.4.bias") && wider.contains("[8]"), "{wider}");

        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 5]).unwrap();
        assert!(read(&path, &graph).unwrap_err().to_string().contains("no safetensors file"));
        let text = String::from_utf8_lossy(&bytes[..200]).into_owned();
        assert!(text.contains(r#"\"format\":1"#), "{text}");
        let mut newer = bytes;
        let at = newer.windows(10).position(|w| w == br#"format\":1"#).unwrap();
        newer[at + 9] = b'9';
        std::fs::write(&path, newer).unwrap();
        assert!(read(&path, &graph).unwrap_err().to_string().contains("format 9, but this program reads up to 1"));
    }
}
