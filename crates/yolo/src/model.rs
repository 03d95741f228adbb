//! A model: what it is and what it learned, whichever files it lies in.
use crate::{
    config::{MODEL_FORMAT, ModelConfig},
    error::YoloError,
    graph::{Graph, Layer},
    weights::{Weights, cfg, darknet, safetensors},
};
use std::path::{Path, PathBuf};
use tcross_dataset::files;

/// A description and the parameters that fit it.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// What it is.
    pub config: ModelConfig,
    /// What it learned.
    pub weights: Weights,
}

/// Name of the description beside the weights.
pub const MODEL_TOML: &str = "model.toml";

impl ModelConfig {
    /// Reads a `model.toml`.
    ///
    /// # Errors
    /// If it cannot be read, has an unknown key or a value that is not allowed, or is of a newer format.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, YoloError> {
        let path = path.as_ref();
        let text = std::fs::read_to_string(path).map_err(|e| YoloError::io(path, e))?;
        let at = |e: toml::de::Error| {
            let line = e.span().map_or(1, |span| 1 + text[..span.start].matches('\n').count());
            YoloError::line(path, line, e.message())
        };
        let table: toml::Table = toml::from_str(&text).map_err(at)?;
        if let Some(format) = table.get("format").and_then(toml::Value::as_integer)
            && format > i64::from(MODEL_FORMAT)
        {
            return Err(YoloError::Format { path: path.to_owned(), found: format.to_string(), known: MODEL_FORMAT });
        }
        let config: Self = toml::from_str(&text).map_err(at)?;
        config.validate()?;
        Ok(config)
    }

    /// Writes a `model.toml`.
    ///
    /// # Errors
    /// If the folder cannot be written.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), YoloError> {
        let text = toml::to_string(self).map_err(|e| YoloError::broken(&path, e))?;
        files::write_atomically(&path, text).map_err(|e| YoloError::broken(&path, e))
    }
}

impl Model {
    /// Reads a model: a run's folder (its best weights, else its last), a `.safetensors` file with `model.toml` beside it, or a Darknet
    /// `.cfg` or `.weights` file with its partner beside it.
    ///
    /// # Errors
    /// If a file is missing, broken, or does not fit its description.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, YoloError> {
        let path = path.as_ref();
        if path.is_dir() {
            let names = ["best.safetensors", "last.safetensors"].map(|name| path.join(name));
            let found = names.iter().find(|file| file.is_file());
            return Self::load(found.ok_or_else(|| YoloError::broken(path, "holds neither best.safetensors nor last.safetensors"))?);
        }
        match path.extension().and_then(|e| e.to_str()) {
            Some("safetensors") => {
                let config = ModelConfig::read(path.with_file_name(MODEL_TOML))?;
                let weights = safetensors::read(path, &config.graph()?)?;
                Ok(Self { config, weights })
            }
            Some("cfg") => Self::load_darknet(path, partner(path, "weights")?),
            Some("weights") => Self::load_darknet(partner(path, "cfg")?, path),
            _ => Err(YoloError::broken(path, "expected a run's folder, a .safetensors file, or a Darknet .cfg or .weights file")),
        }
    }

    /// Reads a Darknet model from its two files. Batch norm gets the epsilon that Darknet's GPU code uses.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn load_darknet(cfg: impl AsRef<Path>, weights: impl AsRef<Path>) -> Result<Self, YoloError> {
        let config = cfg::read(cfg)?;
        let weights = darknet::read(weights, &config.graph()?)?;
        Ok(Self { config, weights })
    }

    /// Writes `path` (`.safetensors`) and `model.toml` beside it.
    ///
    /// # Errors
    /// If the folder cannot be written.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<(), YoloError> {
        safetensors::write(&path, &self.config.graph()?, &self.weights)?;
        self.config.write(path.as_ref().with_file_name(MODEL_TOML))
    }

    /// Writes `path` with the endings `.cfg` and `.weights`.
    ///
    /// # Errors
    /// If the folder cannot be written, or Darknet does not know such a model.
    pub fn save_darknet(&self, path: impl AsRef<Path>) -> Result<(), YoloError> {
        let path = path.as_ref();
        cfg::write_file(path.with_extension("cfg"), &self.config)?;
        darknet::write(path.with_extension("weights"), &self.weights)
    }
}

/// The file of the same name with this ending or, without one, the only file of the folder with it.
fn partner(path: &Path, extension: &str) -> Result<PathBuf, YoloError> {
    let same = path.with_extension(extension);
    if same.is_file() {
        return Ok(same);
    }
    let dir = path.parent().unwrap_or(Path::new("."));
    let entries = std::fs::read_dir(dir).map_err(|e| YoloError::io(dir, e))?;
    let mut found: Vec<PathBuf> = entries.filter_map(|e| e.ok().map(|e| e.path())).collect();
    found.retain(|file| file.extension().is_some_and(|e| e == extension));
    match found.as_slice() {
        [only] => Ok(only.clone()),
        [] => Err(YoloError::broken(path, format!("needs {} beside it", same.display()))),
        several => Err(YoloError::broken(
            path,
            format!("needs {} beside it; {} other .{extension} files are there", same.display(), several.len()),
        )),
    }
}

/// A line of `model info`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LayerInfo {
    /// Index, from 0.
    pub layer: usize,
    /// Such as `conv 64 3x3/2 leaky`, `shortcut 1`, `route 85, 61`.
    pub what: String,
    /// Output `[channels, height, width]`.
    pub shape: [usize; 3],
    /// Stored values.
    pub parameters: usize,
    /// Floating-point operations, multiply and add counted apart.
    pub flops: u64,
}

/// Every layer of a network with what it costs at its input size.
///
/// # Errors
/// If the layers do not fit together.
pub fn info(config: &ModelConfig) -> Result<Vec<LayerInfo>, YoloError> {
    let graph: Graph = config.graph()?;
    let shapes = graph.shapes(config.input);
    let row = |(layer, kind): (usize, &Layer)| {
        let shape = [shapes[layer].channels, shapes[layer].height, shapes[layer].width];
        let list = |of: &[usize]| of.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
        let (what, parameters, flops) = match kind {
            Layer::Conv(c) => {
                let activation = if c.leaky { "leaky" } else { "linear" };
                let what = format!("conv {} {k}x{k}/{} {activation}", c.filters, c.stride, k = c.kernel);
                (what, c.parameters(), 2 * (c.kernel_len() * shape[1] * shape[2]) as u64)
            }
            Layer::Shortcut { from } => (format!("shortcut {from}"), 0, 0),
            Layer::Route { from } => (format!("route {}", list(from)), 0, 0),
            Layer::Upsample => ("upsample 2x".into(), 0, 0),
            Layer::MaxPool { stride } => (format!("maxpool 2x2/{stride}"), 0, 0),
            Layer::Head { mask } => (format!("yolo, anchors {}", list(mask)), 0, 0),
        };
        LayerInfo { layer, what, shape, parameters, flops }
    };
    Ok(graph.layers().iter().enumerate().map(row).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Architecture;

    fn model() -> Model {
        let config = ModelConfig { width: 0.0625, ..ModelConfig::of(Architecture::YoloV3Tiny) };
        let weights = Weights::init(&config.graph().unwrap(), &config.fields(), &Default::default(), 5);
        Model { config, weights }
    }

    #[test]
    fn every_kind_of_file_gives_the_same_model() {
        let dir = tempfile::tempdir().unwrap();
        let model = model();
        model.save(dir.path().join("last.safetensors")).unwrap();
        assert_eq!(Model::load(dir.path()).unwrap(), model);
        assert_eq!(Model::load(dir.path().join("last.safetensors")).unwrap(), model);
        model.save_darknet(dir.path().join("net")).unwrap();
        assert_eq!(Model::load(dir.path().join("net.cfg")).unwrap(), model);
        assert_eq!(Model::load(dir.path().join("net.weights")).unwrap(), model);
        std::fs::rename(dir.path().join("net.weights"), dir.path().join("other.weights")).unwrap();
        assert_eq!(Model::load(dir.path().join("net.cfg")).unwrap(), model);
    }

    #[test]
    fn what_cannot_be_read_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let message = |path: PathBuf| Model::load(path).unwrap_err().to_string();
        assert!(message(dir.path().to_owned()).contains("neither best.safetensors nor last.safetensors"));
        assert!(message(at("a.onnx")).contains("expected a run's folder"));
        std::fs::write(at("net.cfg"), cfg::write(&model().config).unwrap()).unwrap();
        assert!(message(at("net.cfg")).contains("net.weights beside it"));
        std::fs::write(at("best.safetensors"), "x").unwrap();
        assert!(message(dir.path().to_owned()).contains("model.toml"));

        model().config.write(at("model.toml")).unwrap();
        let text = std::fs::read_to_string(at("model.toml")).unwrap();
        std::fs::write(at("model.toml"), text.replace("classes", "clases")).unwrap();
        let wrong = message(dir.path().to_owned());
        assert!(wrong.contains("model.toml:6: unknown field `clases`"), "{wrong}");
        std::fs::write(at("model.toml"), text.replace("format = 1", "format = 2\nnew_key = 1")).unwrap();
        assert!(message(dir.path().to_owned()).contains("format 2, but this program reads up to 1"));
    }

    #[test]
    fn info_adds_up() {
        let config = ModelConfig::of(Architecture::YoloV3);
        let (rows, graph) = (info(&config).unwrap(), config.graph().unwrap());
        assert_eq!(rows.iter().map(|r| r.parameters).sum::<usize>(), graph.parameters());
        assert_eq!(rows.iter().map(|r| r.flops).sum::<u64>(), graph.flops(config.input));
        assert_eq!((rows[86].what.as_str(), rows[86].shape), ("route 85, 61", [768, 26, 26]));
    }
}
