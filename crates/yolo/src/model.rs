//! A model: what it is and what it learned, whichever files it lies in.
use crate::{
    config::{MODEL_FORMAT, ModelConfig},
    error::YoloError,
    graph::{Graph, Layer},
    weights::{Loaded, Weights, cfg, darknet, fold, onnx, safetensors},
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
        let mut config: Self = toml::from_str(&text).map_err(at)?;
        if config.heads.is_empty() {
            config.heads = config.architecture.strides();
        }
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

    /// Reads a Darknet model from its two files, and the classes' names where a `.names` file with as many lines lies beside the cfg. Batch
    /// norm gets the epsilon that Darknet's GPU code uses.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn load_darknet(cfg: impl AsRef<Path>, weights: impl AsRef<Path>) -> Result<Self, YoloError> {
        let (cfg, weights) = (cfg.as_ref(), weights.as_ref());
        let mut config = cfg::read(cfg)?;
        config.names = names_beside(cfg, config.classes);
        let weights = darknet::read_model(weights, &config)?;
        Ok(Self { config, weights })
    }

    /// Takes in the weights of another program, whole or cut (`NAME.conv.N`): what [`Self::load`] reads, or a Darknet weights file that belongs
    /// to `cfg`. Of a cut, and where the file has another number of classes than the cfg, the layers that it does not hold are random, drawn
    /// from `seed`.
    ///
    /// # Errors
    /// As [`Self::load`]; and if the file fits the cfg in none of these ways.
    pub fn import(path: impl AsRef<Path>, cfg: Option<&Path>, seed: u64) -> Result<(Self, Loaded), YoloError> {
        let path = path.as_ref();
        let Some(cfg) = cfg else {
            if darknet::cut_of(path).is_some() {
                return Err(YoloError::broken(path, "is a cut, which does not say of which network: name its cfg"));
            }
            let model = Self::load(path)?;
            let layers: Vec<usize> = model.config.graph()?.convolutions().map(|(layer, _)| layer).collect();
            let of = layers.len();
            return Ok((model, Loaded { layers, of }));
        };
        let mut config = cfg::read(cfg)?;
        config.names = names_beside(cfg, config.classes);
        let mut weights = Weights::init(&config.graph()?, &config.fields(), &Default::default(), seed);
        let loaded = darknet::read_start(path, &config, &mut weights)?;
        Ok((Self { config, weights }, loaded))
    }

    /// Writes `path` (`.safetensors`) and `model.toml` beside it.
    ///
    /// # Errors
    /// If the folder cannot be written.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<(), YoloError> {
        safetensors::write(&path, &self.config.graph()?, &self.weights)?;
        self.config.write(path.as_ref().with_file_name(MODEL_TOML))
    }

    /// The same model with every batch norm folded into its convolution. Its outputs do not hang on any program's epsilon, but it cannot be
    /// trained on, and reading it back does not give the original's parameters.
    ///
    /// # Errors
    /// If the layers do not fit together.
    pub fn folded(&self) -> Result<Self, YoloError> {
        let config = cfg::with_layers(self.config.clone(), &self.config.graph()?.without_batch_norm());
        Ok(Self { config, weights: fold::folded(&self.weights, self.config.epsilon) })
    }

    /// Writes the model for other programs to `path` with the format's endings, and says which files these are.
    ///
    /// # Errors
    /// If the folder cannot be written, or the format cannot hold such a model.
    pub fn export(&self, format: ExportFormat, path: impl AsRef<Path>) -> Result<Vec<PathBuf>, YoloError> {
        let file = |extension| path.as_ref().with_extension(extension);
        match format {
            ExportFormat::Darknet => {
                cfg::write_file(file("cfg"), &self.config)?;
                darknet::write(file("weights"), &self.weights)?;
                Ok(vec![file("cfg"), file("weights")])
            }
            ExportFormat::Onnx => {
                onnx::write(file("onnx"), &self.config, &self.weights)?;
                Ok(vec![file("onnx")])
            }
            ExportFormat::Safetensors => {
                self.save(file("safetensors"))?;
                Ok(vec![file("safetensors"), path.as_ref().with_file_name(MODEL_TOML)])
            }
        }
    }
}

/// What [`Model::export`] writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExportFormat {
    /// `.cfg` and `.weights`, for Darknet and OpenCV. Both put another epsilon into batch norm than training did: for the last digits of
    /// the same detections export [`Model::folded`].
    Darknet,
    /// `.onnx`.
    Onnx,
    /// `.safetensors` and `model.toml`.
    Safetensors,
}

impl ExportFormat {
    /// All, with the words that users type.
    pub const ALL: [(&'static str, Self); 3] = [("darknet", Self::Darknet), ("onnx", Self::Onnx), ("safetensors", Self::Safetensors)];
}

impl std::str::FromStr for ExportFormat {
    type Err = YoloError;

    fn from_str(word: &str) -> Result<Self, YoloError> {
        let found = Self::ALL.into_iter().find(|(name, _)| *name == word);
        found.map(|(_, format)| format).ok_or_else(|| YoloError::value("export format", word, Self::ALL.map(|(name, _)| name).join(", ")))
    }
}

/// The file of the same name with this ending or, without one, the only file of the folder with it.
fn partner(path: &Path, extension: &str) -> Result<PathBuf, YoloError> {
    let same = path.with_extension(extension);
    if same.is_file() {
        return Ok(same);
    }
    let dir = files::folder_of(path);
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

/// The lines of the `.names` file beside a cfg, if there is one and it has a line a class.
fn names_beside(cfg: &Path, classes: usize) -> Vec<String> {
    let text = partner(cfg, "names").ok().and_then(|file| std::fs::read_to_string(file).ok()).unwrap_or_default();
    let names: Vec<String> = text.lines().map(|line| line.trim().to_string()).filter(|line| !line.is_empty()).collect();
    if names.len() == classes { names } else { Vec::new() }
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
        model.export(ExportFormat::Darknet, dir.path().join("net")).unwrap();
        assert_eq!(Model::load(dir.path().join("net.cfg")).unwrap(), model);
        assert_eq!(Model::load(dir.path().join("net.weights")).unwrap(), model);
        std::fs::rename(dir.path().join("net.weights"), dir.path().join("other.weights")).unwrap();
        assert_eq!(Model::load(dir.path().join("net.cfg")).unwrap(), model);
    }

    #[test]
    fn names_are_taken_along() {
        let dir = tempfile::tempdir().unwrap();
        model().export(ExportFormat::Darknet, dir.path().join("net")).unwrap();
        std::fs::write(dir.path().join("data.names"), "marker\n").unwrap();
        assert_eq!(Model::load(dir.path().join("net.cfg")).unwrap().config.names, ["marker"]);
        std::fs::write(dir.path().join("data.names"), "marker\ncar\n").unwrap();
        assert!(Model::load(dir.path().join("net.cfg")).unwrap().config.names.is_empty());
    }

    #[test]
    fn cuts_are_taken_in_with_their_cfg() {
        let dir = tempfile::tempdir().unwrap();
        let (model, cut) = (model(), dir.path().join("tiny.conv.15"));
        let graph = model.config.graph().unwrap();
        darknet::write_cut(&cut, &graph, &model.weights, 15).unwrap();
        model.export(ExportFormat::Darknet, dir.path().join("net")).unwrap();
        let cfg = dir.path().join("net.cfg");
        assert!(Model::import(&cut, None, 0).unwrap_err().to_string().contains("name its cfg"));
        let (taken, loaded) = Model::import(&cut, Some(&cfg), 9).unwrap();
        assert_eq!(loaded.to_string(), "9 of 13 convolutions (layers 0-14)");
        assert_eq!(taken.weights.convolutions[..9], model.weights.convolutions[..9]);
        assert_ne!(taken.weights.convolutions[9..], model.weights.convolutions[9..]);
        let (whole, loaded) = Model::import(&cfg, None, 0).unwrap();
        assert!(whole == model && loaded.is_all());
    }

    #[test]
    fn another_class_count_is_said_so() {
        let dir = tempfile::tempdir().unwrap();
        model().export(ExportFormat::Darknet, dir.path().join("one")).unwrap();
        let cfg = cfg::write(&ModelConfig { classes: 80, ..model().config }).unwrap();
        std::fs::write(dir.path().join("one.cfg"), cfg).unwrap();
        let message = Model::load(dir.path().join("one.cfg")).unwrap_err().to_string();
        assert!(message.contains("one.weights holds a network of 1 class(es): expected 80"), "{message}");
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
    fn folding_keeps_the_function() {
        use burn::tensor::{Device, Tensor};
        let mut model = model();
        model.config.input = crate::NetSize::square(64);
        for norm in model.weights.convolutions.iter_mut().filter_map(|c| c.norm.as_mut()) {
            norm.variance.iter_mut().enumerate().for_each(|(i, v)| *v = 0.5 + i as f32 / 7.0);
            norm.mean.iter_mut().enumerate().for_each(|(i, m)| *m = i as f32 / 9.0 - 0.3);
        }
        let folded = model.folded().unwrap();
        assert_eq!(folded.config.architecture, Architecture::DarknetCfg);
        let device = Device::flex();
        let heads = [&model, &folded].map(|m| {
            let network = crate::Yolo::new(&m.config, &m.weights, &device).unwrap();
            network.forward(Tensor::ones([1, 3, 64, 64], &device) * 0.7)
        });
        for (a, b) in heads[0].iter().zip(&heads[1]) {
            let (a, b) = (crate::network::read_logits(a), crate::network::read_logits(b));
            assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-4));
        }
    }

    #[test]
    fn formats_are_named() {
        assert_eq!("onnx".parse::<ExportFormat>().unwrap(), ExportFormat::Onnx);
        assert!("pt".parse::<ExportFormat>().unwrap_err().to_string().contains("expected darknet, onnx, safetensors"));
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
