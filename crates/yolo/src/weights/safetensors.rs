//! Safetensors files: one named float32 tensor a parameter, `layers.12.kernel` and so on, which any tool can read.
//!
//! The only metadata is `tcross`: a JSON object with the format's number and the images seen. (One entry, because the format's library
//! writes several in no fixed order, and the same weights should give the same bytes.)
use super::{ConvWeights, Loaded, NormWeights, Weights};
use crate::{
    error::YoloError,
    graph::{Conv, Graph},
};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use std::{
    collections::{HashMap, HashSet},
    path::Path,
};
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
    let file = Reader::new(path, &bytes)?;
    let convolutions = graph.convolutions().map(|(layer, conv)| file.convolution(layer, conv)).collect::<Result<_, _>>()?;
    file.no_others(graph)?;
    Ok(Weights { seen: file.seen, convolutions })
}

/// Fills the start of a training from the file of the same network, whatever its number of classes: heads of another shape are left as
/// they are.
///
/// # Errors
/// As [`read`], for every convolution but a head's.
pub fn read_start(path: impl AsRef<Path>, graph: &Graph, weights: &mut Weights) -> Result<Loaded, YoloError> {
    let path = path.as_ref();
    weights.check(graph)?;
    let bytes = std::fs::read(path).map_err(|e| YoloError::io(path, e))?;
    let file = Reader::new(path, &bytes)?;
    let mut loaded = Loaded { layers: Vec::new(), of: weights.convolutions.len() };
    for ((layer, conv), to) in graph.convolutions().zip(&mut weights.convolutions) {
        match file.convolution(layer, conv) {
            Ok(from) => {
                *to = from;
                loaded.layers.push(layer);
            }
            Err(_) if graph.is_head(layer) => {}
            Err(error) => return Err(error),
        }
    }
    file.no_others(graph)?;
    Ok(loaded)
}

/// An open file.
struct Reader<'a> {
    path: &'a Path,
    tensors: SafeTensors<'a>,
    seen: u64,
}

impl<'a> Reader<'a> {
    fn new(path: &'a Path, bytes: &'a [u8]) -> Result<Self, YoloError> {
        let broken = |e: &dyn std::fmt::Display| YoloError::broken(path, format!("no safetensors file: {e}"));
        let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(|e| broken(&e))?;
        let tensors = SafeTensors::deserialize(bytes).map_err(|e| broken(&e))?;
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
        Ok(Self { path, tensors, seen })
    }

    fn wrong(&self, name: &str, expected: String, found: String) -> YoloError {
        YoloError::Tensor { path: self.path.to_owned(), name: name.into(), expected, found }
    }

    /// Takes memory only for what the file really holds.
    fn convolution(&self, layer: usize, conv: &Conv) -> Result<ConvWeights, YoloError> {
        let take = |part: &str| {
            let (name, shape) = (format!("layers.{layer}.{part}"), shape(part, conv));
            let expected = || format!("F32 {shape:?}");
            let tensor = self.tensors.tensor(&name).map_err(|_| self.wrong(&name, expected(), "none".into()))?;
            if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
                return Err(self.wrong(&name, expected(), format!("{:?} {:?}", tensor.dtype(), tensor.shape())));
            }
            Ok(tensor.data().as_chunks::<4>().0.iter().map(|word| f32::from_le_bytes(*word)).collect())
        };
        let bias = take("bias")?;
        let norm = if conv.batch_norm {
            Some(NormWeights { gamma: take("gamma")?, mean: take("mean")?, variance: take("variance")? })
        } else {
            None
        };
        Ok(ConvWeights { bias, norm, kernel: take("kernel")? })
    }

    /// Refuses tensors that the network does not have.
    fn no_others(&self, graph: &Graph) -> Result<(), YoloError> {
        let known: HashSet<String> = graph
            .convolutions()
            .flat_map(|(layer, conv)| {
                let norm: &[&str] = if conv.batch_norm { &["gamma", "mean", "variance"] } else { &[] };
                ["bias", "kernel"].iter().chain(norm).map(move |part| format!("layers.{layer}.{part}")).collect::<Vec<_>>()
            })
            .collect();
        let unknown = self.tensors.names().into_iter().filter(|name| !known.contains(*name)).min();
        match unknown {
            Some(name) => Err(self.wrong(name, "no such tensor in this architecture".into(), "one".into())),
            None => Ok(()),
        }
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
    fn a_start_takes_all_but_heads_of_other_class_counts() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.safetensors");
        let (graph, coco) = model(0.125, 80);
        write(&path, &graph, &coco).unwrap();
        let (graph, one) = model(0.125, 1);
        let mut weights = one.clone();
        let loaded = read_start(&path, &graph, &mut weights).unwrap();
        assert_eq!(loaded.to_string(), "11 of 13 convolutions (layers 0-14, 18, 21)");
        assert_eq!((&weights.convolutions[8], &weights.convolutions[9]), (&coco.convolutions[8], &one.convolutions[9]));
        let wider = model(0.25, 1);
        let message = read_start(&path, &wider.0, &mut wider.1.clone()).unwrap_err().to_string();
        assert!(message.contains("layers.4.bias"), "{message}");
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
