//! Darknet's `.weights` files: a header, then float32 values of each convolution in the order of the layers: bias, with batch norm
//! scale, mean and variance, then the kernel. Nothing in the file says what it belongs to, so lengths are checked to the byte.
use super::{ConvWeights, Loaded, NormWeights, Weights};
use crate::{
    config::{Architecture, MOST_CLASSES, ModelConfig},
    error::YoloError,
    graph::Graph,
};
use std::path::{Path, PathBuf};
use tcross_dataset::files;

/// Version 0.2.0, with 8 bytes for the images seen.
const HEADER: usize = 20;

/// A file's bytes and how far they are read.
struct Reader {
    path: PathBuf,
    bytes: Vec<u8>,
    offset: usize,
    seen: u64,
}

impl Reader {
    fn open(path: &Path) -> Result<Self, YoloError> {
        let bytes = std::fs::read(path).map_err(|e| YoloError::io(path, e))?;
        let mut reader = Self { path: path.to_owned(), bytes, offset: 0, seen: 0 };
        let mut version = [0; 3];
        for number in &mut version {
            *number = i32::from_le_bytes(reader.take("header, version")?);
        }
        let [major, minor, revision] = version;
        if !(0..1000).contains(&major) || !(0..1000).contains(&minor) {
            let found = format!("{major}.{minor}.{revision}");
            return Err(YoloError::Format { path: path.to_owned(), found, known: 2 });
        }
        reader.seen = if major * 10 + minor >= 2 {
            u64::from_le_bytes(reader.take("header, images seen")?)
        } else {
            u64::from(u32::from_le_bytes(reader.take("header, images seen")?))
        };
        Ok(reader)
    }

    fn slice(&mut self, part: impl FnOnce() -> String, length: usize) -> Result<&[u8], YoloError> {
        let left = self.bytes.len() - self.offset;
        if left < length {
            return Err(self.length(part(), length, left));
        }
        self.offset += length;
        Ok(&self.bytes[self.offset - length..self.offset])
    }

    fn take<const N: usize>(&mut self, part: &str) -> Result<[u8; N], YoloError> {
        let slice = self.slice(|| part.to_string(), N)?;
        Ok(std::array::from_fn(|i| slice[i]))
    }

    /// Reads the convolutions among the first `layers` layers. Takes memory only for what the file really holds.
    fn convolutions(&mut self, graph: &Graph, layers: usize) -> Result<Weights, YoloError> {
        let mut weights = Weights { seen: self.seen, convolutions: Vec::new() };
        for (layer, conv) in graph.convolutions().take_while(|(layer, _)| *layer < layers) {
            let mut floats = |part: &str, length: usize| {
                let (words, _) = self.slice(|| format!("layer {layer}, {part}"), 4 * length)?.as_chunks::<4>();
                Ok::<Vec<f32>, YoloError>(words.iter().map(|word| f32::from_le_bytes(*word)).collect())
            };
            let bias = floats("bias", conv.filters)?;
            let norm = if conv.batch_norm {
                let (gamma, mean) = (floats("gamma", conv.filters)?, floats("mean", conv.filters)?);
                Some(NormWeights { gamma, mean, variance: floats("variance", conv.filters)? })
            } else {
                None
            };
            weights.convolutions.push(ConvWeights { bias, norm, kernel: floats("kernel", conv.kernel_len())? });
        }
        Ok(weights)
    }

    fn end(&self) -> Result<(), YoloError> {
        match self.bytes.len() - self.offset {
            0 => Ok(()),
            left => Err(self.length("end of file".into(), 0, left)),
        }
    }

    fn length(&self, part: String, expected: usize, found: usize) -> YoloError {
        YoloError::Length { path: self.path.clone(), part, offset: self.offset as u64, expected: expected as u64, found: found as u64 }
    }
}

/// Reads all parameters of a network from a file that holds exactly those.
///
/// # Errors
/// If the file is too short (naming the layer where it ends) or too long, or its header is not Darknet's.
pub fn read(path: impl AsRef<Path>, graph: &Graph) -> Result<Weights, YoloError> {
    let mut reader = Reader::open(path.as_ref())?;
    let weights = reader.convolutions(graph, graph.layers().len())?;
    reader.end()?;
    Ok(weights)
}

/// As [`read`], and tells where the file belongs to the same network with another number of classes.
///
/// # Errors
/// As [`read`].
pub fn read_model(path: impl AsRef<Path>, config: &ModelConfig) -> Result<Weights, YoloError> {
    let path = path.as_ref();
    read(path, &config.graph()?).map_err(|error| explained(error, path, config))
}

/// An error of length, told as what the file is where that can be known: the same network with another number of classes, or another
/// published one.
fn explained(error: YoloError, path: &Path, config: &ModelConfig) -> YoloError {
    let YoloError::Length { .. } = &error else { return error };
    let bytes = std::fs::metadata(path).map_or(0, |file| file.len() as usize).saturating_sub(HEADER);
    if let Ok(Some((found, _))) = with_classes_of(config, bytes) {
        return YoloError::Classes { path: path.to_owned(), expected: config.classes, found };
    }
    let holds = |architecture: &Architecture| {
        let other = ModelConfig::of(*architecture);
        match 4 * other.graph().ok()?.parameters() == bytes {
            true => Some(other.classes),
            false => with_classes_of(&other, bytes).ok()?.map(|(classes, _)| classes),
        }
    };
    let found = [Architecture::YoloV3, Architecture::YoloV3Tiny].iter().find_map(|a| Some((a, holds(a)?)));
    match found {
        Some((name, classes)) => YoloError::Architecture {
            path: path.to_owned(),
            found: format!("{name} with {classes} class(es)"),
            expected: config.summary(),
            source: Box::new(error),
        },
        None => error,
    }
}

/// Number of layers of a cut such as `darknet53.conv.74` or `yolov3-tiny.conv.15`, from the file's name.
#[must_use]
pub fn cut_of(path: impl AsRef<Path>) -> Option<usize> {
    path.as_ref().file_name()?.to_str()?.rsplit_once(".conv.")?.1.parse().ok()
}

/// Fills the start of a training from a file: all parameters; those of a cut (`NAME.conv.N` holds the first N layers); or, where the file
/// is the same network with another number of classes, all but the heads.
///
/// # Errors
/// As [`read_model`]: if the file fits in none of these ways.
pub fn read_start(path: impl AsRef<Path>, config: &ModelConfig, weights: &mut Weights) -> Result<Loaded, YoloError> {
    let path = path.as_ref();
    fill_start(path, config, weights).map_err(|error| explained(error, path, config))
}

fn fill_start(path: &Path, config: &ModelConfig, weights: &mut Weights) -> Result<Loaded, YoloError> {
    let graph = config.graph()?;
    weights.check(&graph)?;
    let mut reader = Reader::open(path)?;
    let all = graph.layers().len();
    let layers = cut_of(path).unwrap_or(all).min(all);
    let other = if layers < all { None } else { with_classes_of(config, reader.bytes.len() - reader.offset)? };
    let read = match &other {
        Some((_, other)) => reader.convolutions(other, all)?,
        None => reader.convolutions(&graph, layers)?,
    };
    reader.end()?;
    let mut loaded = Loaded { layers: Vec::new(), of: weights.convolutions.len() };
    for (((layer, _), to), from) in graph.convolutions().zip(&mut weights.convolutions).zip(read.convolutions) {
        if layer < layers && (other.is_none() || !graph.is_head(layer)) {
            *to = from;
            loaded.layers.push(layer);
        }
    }
    Ok(loaded)
}

/// The same network with the number of classes that `bytes` of parameters belong to, if that is another one.
fn with_classes_of(config: &ModelConfig, bytes: usize) -> Result<Option<(usize, Graph)>, YoloError> {
    let graph_of = |classes| ModelConfig { classes, names: Vec::new(), ..config.clone() }.graph();
    if config.layers.is_some() || 4 * graph_of(config.classes)?.parameters() == bytes {
        return Ok(None);
    }
    // Parameters grow by the same amount with each class.
    let (one, two) = (4 * graph_of(1)?.parameters(), 4 * graph_of(2)?.parameters());
    let classes = 1 + bytes.saturating_sub(one) / (two - one);
    if bytes < one || classes > MOST_CLASSES {
        return Ok(None);
    }
    let graph = graph_of(classes)?;
    Ok((4 * graph.parameters() == bytes).then_some((classes, graph)))
}

/// Writes all parameters, first under a temporary name.
///
/// # Errors
/// If the folder cannot be written.
pub fn write(path: impl AsRef<Path>, weights: &Weights) -> Result<(), YoloError> {
    files::write_atomically(&path, to_bytes(weights)).map_err(|e| YoloError::broken(&path, e))
}

/// Writes the parameters of the first `layers` layers: a cut, by custom named `NAME.conv.LAYERS`, to start other trainings from.
///
/// # Errors
/// If the folder cannot be written.
pub fn write_cut(path: impl AsRef<Path>, graph: &Graph, weights: &Weights, layers: usize) -> Result<(), YoloError> {
    let count = graph.convolutions().filter(|(layer, _)| *layer < layers).count();
    write(path, &Weights { seen: weights.seen, convolutions: weights.convolutions[..count].to_vec() })
}

fn to_bytes(weights: &Weights) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER);
    for number in [0_i32, 2, 0] {
        bytes.extend(number.to_le_bytes());
    }
    bytes.extend(weights.seen.to_le_bytes());
    for convolution in &weights.convolutions {
        for (_, values) in convolution.parts() {
            bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Architecture;

    fn tiny(classes: usize) -> (ModelConfig, Weights) {
        let config = ModelConfig { width: 0.0625, classes, ..ModelConfig::of(Architecture::YoloV3Tiny) };
        let weights = Weights::init(&config.graph().unwrap(), &config.fields(), &Default::default(), 5);
        (config, Weights { seen: 77, ..weights })
    }

    #[test]
    fn there_and_back_is_bit_identical() {
        let (config, weights) = tiny(3);
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.weights");
        write(&path, &weights).unwrap();
        let again = read(&path, &config.graph().unwrap()).unwrap();
        assert_eq!(again, weights);
        assert_eq!(std::fs::read(&path).unwrap(), to_bytes(&again));
    }

    #[test]
    fn cut_short_trailing_and_foreign_files_say_where() {
        let (config, weights) = tiny(3);
        let graph = config.graph().unwrap();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.weights");
        let bytes = to_bytes(&weights);
        let message = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            read(&path, &graph).unwrap_err().to_string()
        };
        let end = bytes.len();
        let cut = message(&bytes[..end - 6]);
        assert!(cut.contains("a.weights: layer 22, kernel: expected") && cut.ends_with(&format!("found {}", 24 * 16 * 4 - 6)), "{cut}");
        let long = message(&[&bytes[..], &[0; 8]].concat());
        assert!(long.contains(&format!("end of file: expected 0 bytes at offset {end}, found 8")), "{long}");
        assert!(message(&bytes[..7]).contains("header, version"));
        assert!(message(&[0xff; 64]).contains("format -1.-1.-1"));
        let other = message(&to_bytes(&tiny(2).1));
        assert!(other.contains("layer"), "{other}");
    }

    /// Files of the published sizes, of which nothing but the header is written.
    #[test]
    fn another_architecture_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("yolov3.weights");
        for (classes, bytes) in [(80, 4 * 62_001_757), (1, 4 * (62_001_757 - 79 * 3 * (1025 + 513 + 257)))] {
            std::fs::write(&path, to_bytes(&Weights::default())).unwrap();
            std::fs::File::options().write(true).open(&path).unwrap().set_len((HEADER + bytes) as u64).unwrap();
            let message = read_model(&path, &tiny(3).0).unwrap_err().to_string();
            let want = format!("holds yolov3 with {classes} class(es): expected yolov3-tiny x 0.0625 with 3 class(es)");
            assert!(message.contains(&want) && message.contains("end of file: expected 0 bytes at offset"), "{message}");
        }
    }

    #[test]
    fn a_start_takes_cuts_and_other_class_counts() {
        let (config, start) = tiny(1);
        let graph = config.graph().unwrap();
        let dir = tempfile::tempdir().unwrap();
        let blank = Weights::zeros(&graph);

        let path = dir.path().join("tiny.conv.15");
        let count = graph.convolutions().filter(|(layer, _)| *layer < 15).count();
        assert_eq!(count, 9);
        write_cut(&path, &graph, &start, 15).unwrap();
        let mut weights = blank.clone();
        let loaded = read_start(&path, &config, &mut weights).unwrap();
        assert_eq!(loaded.to_string(), "9 of 13 convolutions (layers 0-14)");
        assert_eq!((&weights.convolutions[..9], &weights.convolutions[9..]), (&start.convolutions[..9], &blank.convolutions[9..]));

        let path = dir.path().join("coco.weights");
        write(&path, &tiny(80).1).unwrap();
        let mut weights = blank.clone();
        let loaded = read_start(&path, &config, &mut weights).unwrap();
        assert_eq!(loaded.to_string(), "11 of 13 convolutions (layers 0-14, 18, 21)");
        let coco = tiny(80).1;
        for (at, convolution) in weights.convolutions.iter().enumerate() {
            let head = at == 9 || at == 12;
            assert_eq!(convolution, if head { &blank.convolutions[at] } else { &coco.convolutions[at] }, "{at}");
        }

        let mut bytes = to_bytes(&start);
        bytes.extend([0; 4]);
        std::fs::write(&path, bytes).unwrap();
        assert!(read_start(&path, &config, &mut weights).unwrap_err().to_string().contains("end of file"));
    }
}
