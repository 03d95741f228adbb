//! ONNX files, written: the network from `images` `[batch, 3, height, width]` (RGB, 0..1) to the raw logits of each head, named
//! `head_32`, `head_16` and so on after their strides. `model.toml` goes along as metadata, so that anchors and classes are at hand.
use super::Weights;
use crate::{
    blocks::LEAKY_SLOPE,
    config::ModelConfig,
    error::YoloError,
    graph::{Graph, Layer},
};
use std::path::Path;
use tcross_dataset::files;

/// Version of the operators: the oldest in which everything used here has its present form, so that old runtimes read it, too.
const OPSET: u64 = 13;
const IR_VERSION: u64 = 7;

/// Writes a model as an ONNX file.
///
/// # Errors
/// If the parameters do not fit the layers, or the folder cannot be written.
pub fn write(path: impl AsRef<Path>, config: &ModelConfig, weights: &Weights) -> Result<(), YoloError> {
    files::write_atomically(&path, to_bytes(config, weights)?).map_err(|e| YoloError::broken(&path, e))
}

/// The file's bytes; the same for the same model.
///
/// # Errors
/// If the parameters do not fit the layers.
pub fn to_bytes(config: &ModelConfig, weights: &Weights) -> Result<Vec<u8>, YoloError> {
    let graph = config.graph()?;
    weights.check(&graph)?;
    let description = toml::to_string(config).map_err(|e| YoloError::broken("model.toml", e))?;
    let model = Message::default()
        .number(1, IR_VERSION)
        .text(2, "tcross")
        .text(3, env!("CARGO_PKG_VERSION"))
        .message(7, &graph_proto(config, &graph, weights))
        .message(8, &Message::default().text(1, "").number(2, OPSET))
        .message(14, &Message::default().text(1, "model.toml").text(2, &description));
    Ok(model.0)
}

fn graph_proto(config: &ModelConfig, graph: &Graph, weights: &Weights) -> Message {
    let mut proto = Message::default();
    let output = |layer: usize| format!("layer_{layer}");
    let mut convolutions = weights.convolutions.iter();
    for (at, layer) in graph.layers().iter().enumerate() {
        let before = if at == 0 { "images".to_string() } else { output(at - 1) };
        let node = match layer {
            Layer::Conv(conv) => {
                let Some(parameters) = convolutions.next() else { continue };
                let name = |part: &str| format!("layers.{at}.{part}");
                for (part, values) in parameters.parts() {
                    let kernel = [conv.filters, conv.in_channels, conv.kernel, conv.kernel];
                    let shape = if part == "kernel" { &kernel[..] } else { &kernel[..1] };
                    proto = proto.message(5, &tensor(&name(part), shape, values));
                }
                let (kernel, stride, padding) = (conv.kernel as i64, conv.stride as i64, (conv.kernel / 2) as i64);
                // Each operator but the last writes to a name of its own; the last one to the layer's.
                let steps = 1 + usize::from(conv.batch_norm) + usize::from(conv.leaky);
                let names: Vec<String> =
                    (1..=steps).map(|step| if step == steps { output(at) } else { format!("{}_{step}", output(at)) }).collect();
                let mut inputs = vec![before, name("kernel")];
                if !conv.batch_norm {
                    inputs.push(name("bias"));
                }
                let mut node = Node::new("Conv", &inputs, &names[0])
                    .ints("kernel_shape", &[kernel; 2])
                    .ints("strides", &[stride; 2])
                    .ints("pads", &[padding; 4]);
                if conv.batch_norm {
                    proto = proto.message(1, &node.finish());
                    let inputs = [&names[0], &name("gamma"), &name("bias"), &name("mean"), &name("variance")].map(Clone::clone);
                    node = Node::new("BatchNormalization", &inputs, &names[1]).float("epsilon", config.epsilon as f32);
                }
                if conv.leaky {
                    proto = proto.message(1, &node.finish());
                    node = Node::new("LeakyRelu", &[names[steps - 2].clone()], &names[steps - 1]).float("alpha", LEAKY_SLOPE as f32);
                }
                node
            }
            Layer::Shortcut { from } => Node::new("Add", &[before, output(*from)], &output(at)),
            Layer::Route { from } => {
                Node::new("Concat", &from.iter().map(|layer| output(*layer)).collect::<Vec<_>>(), &output(at)).int("axis", 1)
            }
            Layer::Upsample => {
                let scales = format!("layers.{at}.scales");
                proto = proto.message(5, &tensor(&scales, &[4], &[1.0, 1.0, 2.0, 2.0]));
                Node::new("Resize", &[before, String::new(), scales], &output(at))
                    .text("mode", "nearest")
                    .text("coordinate_transformation_mode", "asymmetric")
                    .text("nearest_mode", "floor")
            }
            Layer::MaxPool { stride } => {
                let end = i64::from(*stride == 1);
                Node::new("MaxPool", &[before], &output(at))
                    .ints("kernel_shape", &[2, 2])
                    .ints("strides", &[*stride as i64; 2])
                    .ints("pads", &[0, 0, end, end])
            }
            Layer::Head { .. } => Node::new("Identity", &[before], &output(at)),
        };
        proto = proto.message(1, &node.finish());
    }
    let (width, height) = (config.input.width, config.input.height);
    proto = proto.text(2, "yolo").message(11, &value("images", [Graph::IMAGE_CHANNELS, height, width]));
    for (layer, _, stride) in graph.heads() {
        let name = format!("head_{stride}");
        proto = proto.message(1, &Node::new("Identity", &[output(layer)], &name).finish());
        proto = proto.message(12, &value(&name, [graph.channels(layer), height / stride, width / stride]));
    }
    proto
}

/// A float32 tensor with a name.
fn tensor(name: &str, shape: &[usize], values: &[f32]) -> Message {
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    let sides = shape.iter().fold(Message::default(), |proto, &side| proto.number(1, side as u64));
    sides.number(2, FLOAT).text(8, name).bytes(9, &bytes)
}

/// An input or output `[batch, ...]` of float32.
fn value(name: &str, shape: [usize; 3]) -> Message {
    let batch = Message::default().message(1, &Message::default().text(2, "batch"));
    let sides = shape.iter().fold(batch, |proto, &side| proto.message(1, &Message::default().number(1, side as u64)));
    let tensor = Message::default().number(1, FLOAT).message(2, &sides);
    Message::default().text(1, name).message(2, &Message::default().message(1, &tensor))
}

/// ONNX's number for float32.
const FLOAT: u64 = 1;

/// An operator with its attributes.
struct Node {
    proto: Message,
    name: String,
    kind: &'static str,
}

impl Node {
    fn new(kind: &'static str, inputs: &[String], output: &str) -> Self {
        let proto = inputs.iter().fold(Message::default(), |proto, input| proto.text(1, input)).text(2, output);
        Self { proto, name: format!("{kind}_{output}"), kind }
    }

    fn finish(self) -> Message {
        self.proto.text(3, &self.name).text(4, self.kind)
    }

    fn attribute(self, name: &str, kind: u64, fill: impl FnOnce(Message) -> Message) -> Self {
        let attribute = fill(Message::default().text(1, name)).number(20, kind);
        Self { proto: self.proto.message(5, &attribute), ..self }
    }

    fn float(self, name: &str, value: f32) -> Self {
        self.attribute(name, 1, |a| a.float(2, value))
    }

    fn int(self, name: &str, value: i64) -> Self {
        self.attribute(name, 2, |a| a.number(3, value as u64))
    }

    fn text(self, name: &str, value: &str) -> Self {
        self.attribute(name, 3, |a| a.text(4, value))
    }

    fn ints(self, name: &str, values: &[i64]) -> Self {
        self.attribute(name, 7, |a| values.iter().fold(a, |a, &v| a.number(8, v as u64)))
    }
}

/// A protocol-buffers message in its wire form: fields of varints, 4-byte floats and length-delimited bytes.
#[derive(Default)]
struct Message(Vec<u8>);

impl Message {
    fn varint(mut self, mut value: u64) -> Self {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
        self
    }

    fn raw(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }

    fn number(self, field: u64, value: u64) -> Self {
        self.varint(field << 3).varint(value)
    }

    fn float(self, field: u64, value: f32) -> Self {
        self.varint(field << 3 | 5).raw(&value.to_le_bytes())
    }

    fn bytes(self, field: u64, value: &[u8]) -> Self {
        self.varint(field << 3 | 2).varint(value.len() as u64).raw(value)
    }

    fn text(self, field: u64, value: &str) -> Self {
        self.bytes(field, value.as_bytes())
    }

    fn message(self, field: u64, value: &Self) -> Self {
        self.bytes(field, &value.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Architecture;

    /// Fields of a message: (number, bytes of a length-delimited field, or value of another).
    fn fields(mut bytes: &[u8]) -> Vec<(u64, Vec<u8>, u64)> {
        fn varint(bytes: &mut &[u8]) -> u64 {
            let mut value = 0;
            for shift in (0..).step_by(7) {
                let (byte, rest) = bytes.split_first().unwrap();
                *bytes = rest;
                value |= u64::from(byte & 0x7f) << shift;
                if byte & 0x80 == 0 {
                    break;
                }
            }
            value
        }
        let mut fields = Vec::new();
        while !bytes.is_empty() {
            let key = varint(&mut bytes);
            let length = match key & 7 {
                0 => {
                    fields.push((key >> 3, Vec::new(), varint(&mut bytes)));
                    continue;
                }
                2 => varint(&mut bytes) as usize,
                5 => 4,
                other => panic!("wire type {other}"),
            };
            fields.push((key >> 3, bytes[..length].to_vec(), 0));
            bytes = &bytes[length..];
        }
        fields
    }

    fn texts(message: &[u8], number: u64) -> Vec<String> {
        fields(message).into_iter().filter(|f| f.0 == number).map(|f| String::from_utf8(f.1).unwrap()).collect()
    }

    /// The file is well formed, every operator reads what an earlier one wrote, and every parameter is there, to the bit.
    #[test]
    fn names_connect_and_parameters_are_complete() {
        for architecture in [Architecture::YoloV3, Architecture::YoloV3Tiny] {
            let config = ModelConfig { width: 0.0625, ..ModelConfig::of(architecture) };
            let weights = Weights::init(&config.graph().unwrap(), &config.fields(), &Default::default(), 5);
            let model = fields(&to_bytes(&config, &weights).unwrap());
            let metadata = &model.iter().find(|f| f.0 == 14).unwrap().1;
            assert_eq!(toml::from_str::<ModelConfig>(&texts(metadata, 2)[0]).unwrap(), config);
            let graph = fields(&model.iter().find(|f| f.0 == 7).unwrap().1);
            let of = |number: u64| graph.iter().filter(move |f| f.0 == number).map(|f| f.1.as_slice());
            let mut known: Vec<String> = of(5).map(|t| texts(t, 8)[0].clone()).chain(["images".into(), String::new()]).collect();
            for node in of(1) {
                for input in texts(node, 1) {
                    assert!(known.contains(&input), "{input}");
                }
                known.extend(texts(node, 2));
            }
            assert!(of(12).all(|output| known.contains(&texts(output, 1)[0])));
            assert_eq!(of(12).count(), config.masks.len());
            let stored: usize = of(5).map(|t| fields(t).iter().find(|f| f.0 == 9).unwrap().1.len()).sum();
            let scales = of(5).filter(|t| texts(t, 8)[0].ends_with("scales")).count();
            assert_eq!(stored, 4 * (config.graph().unwrap().parameters() + 4 * scales));
        }
    }
}
