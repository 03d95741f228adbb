//! Darknet's cfg files, in and out.
use crate::{
    config::{Architecture, BATCH_NORM_EPSILON, BoxConvention, MODEL_FORMAT, ModelConfig, NetSize},
    error::YoloError,
    fields::BoxFields,
    graph::{Conv, Graph, Layer},
};
use std::{
    fmt::Write,
    path::{Path, PathBuf},
};
use tcross_dataset::files;

/// A section of a cfg, such as `[convolutional]`.
struct Section<'a> {
    path: &'a Path,
    line: usize,
    name: &'a str,
    entries: Vec<(usize, &'a str, &'a str)>,
}

/// What the `[yolo]` sections say; all agree on it.
#[derive(Debug, Clone, PartialEq)]
struct Heads {
    anchors: Vec<[f32; 2]>,
    classes: usize,
    scale_xy: f32,
}

/// Reads a cfg file: the model's description, of a named architecture where the layers are one's.
///
/// # Errors
/// A line that is not understood, or layers that do not fit together.
pub fn read(path: impl AsRef<Path>) -> Result<ModelConfig, YoloError> {
    let path = path.as_ref();
    let text = std::fs::read_to_string(path).map_err(|e| YoloError::io(path, e))?;
    parse(path, &text)
}

/// As [`read`], from text; `path` is only named in errors.
///
/// # Errors
/// As [`read`].
pub fn parse(path: impl AsRef<Path>, text: &str) -> Result<ModelConfig, YoloError> {
    let path = path.as_ref();
    let all = sections(path, text)?;
    let Some((net, body)) = all.split_first().filter(|(first, _)| matches!(first.name, "net" | "network")) else {
        return Err(YoloError::line(path, 1, "expected [net] as the first section"));
    };
    let input = NetSize { width: net.required("width")?, height: net.required("height")? };
    if net.number("channels", Graph::IMAGE_CHANNELS)? != Graph::IMAGE_CHANNELS {
        return Err(net.wrong("channels", "3"));
    }
    let (graph, heads) = build(path, body)?;
    let Some(Heads { anchors, classes, scale_xy }) = heads else {
        return Err(YoloError::line(path, all.last().map_or(1, |s| s.line), "no [yolo] section"));
    };
    let config = ModelConfig {
        format: MODEL_FORMAT,
        architecture: Architecture::DarknetCfg,
        width: 1.0,
        depth: 1.0,
        channel_multiple: 8,
        classes,
        keypoints: 0,
        names: Vec::new(),
        input,
        anchors,
        heads: graph.heads().map(|(_, _, stride)| stride).collect(),
        masks: graph.heads().map(|(_, mask, _)| mask.to_vec()).collect(),
        scale_xy,
        boxes: BoxConvention::Continuous,
        epsilon: BATCH_NORM_EPSILON,
        layers: None,
    };
    let config = named(&config, &graph).unwrap_or_else(|| with_layers(config, &graph));
    config.validate()?;
    Ok(config)
}

/// The description of a network that keeps its layers as text.
#[must_use]
pub fn with_layers(config: ModelConfig, graph: &Graph) -> ModelConfig {
    let layers = Some(write_layers(graph, &config));
    ModelConfig { architecture: Architecture::DarknetCfg, width: 1.0, depth: 1.0, channel_multiple: 8, layers, ..config }
}

/// The same network as a scaled named architecture, if it is one.
fn named(config: &ModelConfig, graph: &Graph) -> Option<ModelConfig> {
    let widest = graph.convolutions().filter(|(layer, _)| !graph.is_head(*layer)).map(|(_, c)| c.filters).max()?;
    let depths = [1.0, 0.75, 0.5, 0.25];
    let candidates = [Architecture::YoloV3, Architecture::YoloV3Tiny].into_iter().flat_map(|architecture| {
        depths.into_iter().flat_map(move |depth| [8, 1].map(|channel_multiple| (architecture, depth, channel_multiple)))
    });
    candidates
        .map(|(architecture, depth, channel_multiple)| ModelConfig {
            architecture,
            depth,
            channel_multiple,
            width: widest as f64 / (32 * graph.max_stride()) as f64,
            ..config.clone()
        })
        .find(|candidate| candidate.graph().is_ok_and(|g| g == *graph))
}

/// The layers of a cfg's text; a `[net]` section is passed over. `path` is only named in errors.
///
/// # Errors
/// A line that is not understood, or layers that do not fit together.
pub fn layers(path: impl AsRef<Path>, text: &str) -> Result<Graph, YoloError> {
    let path = path.as_ref();
    let all = sections(path, text)?;
    let body = if all.first().is_some_and(|s| s.name.starts_with("net")) { &all[1..] } else { &all };
    Ok(build(path, body)?.0)
}

/// The cfg of a model, which Darknet and OpenCV read.
///
/// # Errors
/// If the model's boxes carry keypoints, which Darknet does not know.
pub fn write(config: &ModelConfig) -> Result<String, YoloError> {
    if config.keypoints > 0 {
        return Err(YoloError::value("model.keypoints", config.keypoints, "0 for Darknet's files"));
    }
    let NetSize { width, height } = config.input;
    let net = format!("[net]\nbatch=1\nsubdivisions=1\nwidth={width}\nheight={height}\nchannels=3\n");
    Ok(net + &write_layers(&config.graph()?, config))
}

fn sections<'a>(path: &'a Path, text: &'a str) -> Result<Vec<Section<'a>>, YoloError> {
    let mut sections: Vec<Section> = Vec::new();
    for (index, raw) in text.lines().enumerate() {
        let (line, content) = (index + 1, raw.split(['#', ';']).next().unwrap_or_default().trim());
        if content.is_empty() {
            continue;
        }
        if let Some(name) = content.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            sections.push(Section { path, line, name, entries: Vec::new() });
            continue;
        }
        let Some((key, value)) = content.split_once('=') else {
            return Err(YoloError::line(path, line, format!("'{content}': expected [section] or key=value")));
        };
        let Some(section) = sections.last_mut() else {
            return Err(YoloError::line(path, line, format!("'{content}' stands before the first [section]")));
        };
        section.entries.push((line, key.trim(), value.trim()));
    }
    Ok(sections)
}

impl Section<'_> {
    fn entry(&self, key: &str) -> Option<(usize, &str)> {
        self.entries.iter().rev().find(|e| e.1 == key).map(|e| (e.0, e.2))
    }

    fn wrong(&self, key: &str, allowed: impl std::fmt::Display) -> YoloError {
        match self.entry(key) {
            Some((line, value)) => YoloError::line(self.path, line, format!("{key}={value}: expected {allowed}")),
            None => YoloError::line(self.path, self.line, format!("[{}] lacks {key}=: expected {allowed}", self.name)),
        }
    }

    fn number(&self, key: &str, default: usize) -> Result<usize, YoloError> {
        if self.entry(key).is_none() { Ok(default) } else { self.required(key) }
    }

    fn required(&self, key: &str) -> Result<usize, YoloError> {
        self.entry(key).and_then(|(_, v)| v.parse().ok()).ok_or_else(|| self.wrong(key, "a whole number"))
    }

    fn numbers<T: std::str::FromStr>(&self, key: &str) -> Result<Vec<T>, YoloError> {
        let parsed = self.entry(key).and_then(|(_, v)| v.split(',').map(|n| n.trim().parse().ok()).collect());
        parsed.ok_or_else(|| self.wrong(key, "numbers with commas between"))
    }

    /// Refuses a key that would change what the layer does.
    fn only_knows(&self, keys: &[&str]) -> Result<(), YoloError> {
        match self.entries.iter().find(|e| !keys.contains(&e.1)) {
            None => Ok(()),
            Some((line, key, _)) => Err(YoloError::line(
                self.path,
                *line,
                format!("[{}] with '{key}', which this program does not know: expected one of {}", self.name, keys.join(", ")),
            )),
        }
    }

    fn is(&self, key: &str, only: &str) -> Result<(), YoloError> {
        if self.entry(key).is_none_or(|(_, value)| value == only) { Ok(()) } else { Err(self.wrong(key, only)) }
    }

    /// Absolute index of a layer that may be counted back from this one.
    fn layer(&self, key: &str, here: usize, index: i64) -> Result<usize, YoloError> {
        let absolute = if index < 0 { here as i64 + index } else { index };
        let found = usize::try_from(absolute).ok().filter(|at| *at < here);
        found.ok_or_else(|| self.wrong(key, format!("layers before this one, number {here}")))
    }

    fn convolution(&self, in_channels: usize) -> Result<Conv, YoloError> {
        self.only_knows(&["batch_normalize", "filters", "size", "stride", "pad", "padding", "activation"])?;
        let kernel = self.number("size", 1)?;
        let padding = if self.number("pad", 0)? != 0 { kernel / 2 } else { self.number("padding", 0)? };
        if padding != kernel / 2 {
            return Err(self.wrong("pad", "1 (padding of half the size)"));
        }
        let leaky = match self.entry("activation").map(|e| e.1) {
            Some("leaky") => true,
            Some("linear") => false,
            _ => return Err(self.wrong("activation", "leaky or linear")),
        };
        let batch_norm = self.number("batch_normalize", 0)? != 0;
        Ok(Conv { in_channels, filters: self.required("filters")?, kernel, stride: self.number("stride", 1)?, batch_norm, leaky })
    }

    fn yolo(&self, channels: usize) -> Result<(Vec<usize>, Heads), YoloError> {
        self.is("new_coords", "0")?;
        let values: Vec<f32> = self.numbers("anchors")?;
        let (pairs, rest) = values.as_chunks::<2>();
        if !rest.is_empty() || self.number("num", pairs.len())? != pairs.len() {
            return Err(self.wrong("num", format!("{} (pairs in anchors=)", pairs.len())));
        }
        let mask: Vec<usize> = self.numbers("mask")?;
        if mask.is_empty() || mask.iter().any(|m| *m >= pairs.len()) {
            return Err(self.wrong("mask", format!("indices below {}", pairs.len())));
        }
        let classes = self.required("classes")?;
        let wanted = mask.len() * BoxFields::plain(classes).len();
        if channels != wanted {
            return Err(
                self.wrong("classes", format!("a number that fits the {channels} filters before ({classes} classes need {wanted})"))
            );
        }
        let scale_xy = self.entry("scale_x_y").map_or(Some(1.0), |(_, v)| v.parse::<f32>().ok());
        let scale_xy = scale_xy.filter(|scale| (1.0..=3.0).contains(scale)).ok_or_else(|| self.wrong("scale_x_y", "1 to 3"))?;
        Ok((mask, Heads { anchors: pairs.to_vec(), classes, scale_xy }))
    }
}

fn build(path: &Path, sections: &[Section]) -> Result<(Graph, Option<Heads>), YoloError> {
    let (mut graph, mut heads) = (Graph::new(), None);
    for (here, section) in sections.iter().enumerate() {
        let layer = match section.name {
            "convolutional" | "conv" => Layer::Conv(section.convolution(graph.next_channels())?),
            "shortcut" => {
                section.only_knows(&["from", "activation"])?;
                section.is("activation", "linear")?;
                let from: Vec<i64> = section.numbers("from")?;
                let [from] = from[..] else { return Err(section.wrong("from", "one layer")) };
                Layer::Shortcut { from: section.layer("from", here, from)? }
            }
            "route" => {
                section.only_knows(&["layers"])?;
                let from = section.numbers("layers")?.into_iter().map(|index| section.layer("layers", here, index));
                Layer::Route { from: from.collect::<Result<_, _>>()? }
            }
            "upsample" => {
                section.only_knows(&["stride"])?;
                section.is("stride", "2")?;
                Layer::Upsample
            }
            "maxpool" => {
                section.only_knows(&["size", "stride"])?;
                section.is("size", "2")?;
                Layer::MaxPool { stride: section.number("stride", 1)? }
            }
            "yolo" => {
                let (mask, found) = section.yolo(graph.next_channels())?;
                let first = heads.get_or_insert_with(|| found.clone());
                if first.scale_xy != found.scale_xy {
                    return Err(section.wrong("scale_x_y", format!("{}, as in the first [yolo]", first.scale_xy)));
                }
                if *first != found {
                    return Err(section.wrong("anchors", "the same anchors and classes in every [yolo]"));
                }
                Layer::Head { mask }
            }
            other => {
                let known = "convolutional, shortcut, route, upsample, maxpool, yolo";
                return Err(YoloError::line(path, section.line, format!("[{other}]: expected one of {known}")));
            }
        };
        graph.push(layer).map_err(|e| YoloError::line(path, section.line, e))?;
    }
    Ok((graph, heads))
}

fn write_layers(graph: &Graph, config: &ModelConfig) -> String {
    let ModelConfig { anchors, classes, scale_xy, .. } = config;
    let list = |values: &[usize]| values.iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
    let pairs: Vec<String> = anchors.iter().map(|[w, h]| format!("{w},{h}")).collect();
    let mut text = String::new();
    for (here, layer) in graph.layers().iter().enumerate() {
        let section = match layer {
            Layer::Conv(c) => format!(
                "[convolutional]\n{}filters={}\nsize={}\nstride={}\npad=1\nactivation={}\n",
                if c.batch_norm { "batch_normalize=1\n" } else { "" },
                c.filters,
                c.kernel,
                c.stride,
                if c.leaky { "leaky" } else { "linear" }
            ),
            // OpenCV takes a shortcut's layer only as counted back.
            Layer::Shortcut { from } => format!("[shortcut]\nfrom=-{}\nactivation=linear\n", here - from),
            Layer::Route { from } => format!("[route]\nlayers={}\n", list(from)),
            Layer::Upsample => "[upsample]\nstride=2\n".into(),
            Layer::MaxPool { stride } => format!("[maxpool]\nsize=2\nstride={stride}\n"),
            Layer::Head { mask } => format!(
                "[yolo]\nmask={}\nanchors={}\nclasses={classes}\nnum={}\njitter=.3\nignore_thresh=.7\ntruth_thresh=1\nrandom=1\n{}",
                list(mask),
                pairs.join(", "),
                anchors.len(),
                if *scale_xy == 1.0 { String::new() } else { format!("scale_x_y={scale_xy}\n") }
            ),
        };
        // Writing to a String cannot fail.
        let _ = write!(text, "\n# layer {here}\n{section}");
    }
    text
}

/// Writes a model's cfg file.
///
/// # Errors
/// As [`write`], or if the folder cannot be written.
pub fn write_file(path: impl Into<PathBuf>, config: &ModelConfig) -> Result<(), YoloError> {
    let path = path.into();
    files::write_atomically(&path, write(config)?).map_err(|e| YoloError::broken(&path, e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn written_models_are_read_back_equal() {
        let section = |architecture| ModelConfig { width: 0.25, classes: 2, ..ModelConfig::of(architecture) };
        for config in [
            section(Architecture::YoloV3),
            section(Architecture::YoloV3Tiny),
            ModelConfig { depth: 0.5, ..section(Architecture::YoloV3) },
            ModelConfig { scale_xy: 1.5, ..section(Architecture::YoloV3) },
            ModelConfig { masks: vec![vec![3, 4, 5], vec![1, 2, 3]], ..section(Architecture::YoloV3Tiny) },
        ] {
            assert_eq!(parse("net.cfg", &write(&config).unwrap()).unwrap(), config);
        }
    }

    #[test]
    fn networks_without_a_name_keep_their_layers() {
        let config = ModelConfig { width: 0.25, ..ModelConfig::of(Architecture::YoloV3Tiny) };
        let text = write(&config).unwrap().replacen("filters=16", "filters=24", 1);
        let read = parse("odd.cfg", &text).unwrap();
        assert_eq!(read.architecture, Architecture::DarknetCfg);
        let toml = toml::to_string(&read).unwrap();
        let again: ModelConfig = toml::from_str(&toml).unwrap();
        assert_eq!(again.graph().unwrap(), layers("odd.cfg", &text).unwrap());
        assert_eq!(again.geometry(again.input).heads[1].stride_px, 16);
    }

    #[test]
    fn bad_lines_are_named() {
        let good = write(&ModelConfig::of(Architecture::YoloV3Tiny)).unwrap();
        for (from, to, words) in [
            ("filters=16", "filters=x", "filters=x: expected a whole number"),
            ("[upsample]\nstride=2", "[upsample]\nstride=4", "stride=4: expected 2"),
            ("[maxpool]", "[avgpool]", "[avgpool]: expected one of"),
            ("layers=19,8", "layers=19,80", "layers=19,80: expected layers before this one"),
            ("classes=1", "classes=2", "classes=2: expected a number that fits the 18 filters before (2 classes need 21)"),
            ("activation=leaky", "activation=mish", "activation=mish: expected leaky or linear"),
            ("width=416", "width=400", "model.input (width) = 400: expected a multiple of 32"),
            ("pad=1", "groups=2", "'groups', which this program does not know"),
            ("[net]\nbatch=1", "[net]\nbatch", "net.cfg:2: 'batch': expected [section] or key=value"),
            ("mask=0,1,2", "mask=4,5,6", "mask=4,5,6: expected indices below 6"),
            ("random=1", "scale_x_y=4", "scale_x_y=4: expected 1 to 3"),
            ("random=1", "scale_x_y=2", "[yolo] lacks scale_x_y=: expected 2, as in the first [yolo]"),
        ] {
            assert!(good.contains(from), "{from}");
            let message = parse("net.cfg", &good.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }
}
