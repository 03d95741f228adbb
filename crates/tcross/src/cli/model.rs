//! `tcross model info,import,export MODEL`
use super::{example, must_exist, required};
use crate::{
    console,
    exit::{Failure, Outcome},
};
use clap::Subcommand;
use std::{
    fmt::Write,
    path::{Path, PathBuf},
};
use tcross_dataset::files;
use tcross_yolo::{Model, model::ExportFormat, refiner::REFINER, weights::darknet};

const IMPORT: &str = "model import yolov3-tiny.cfg --out models/coco";
const EXPORT: &str = "model export runs/quickstart/run --to onnx --out marker.onnx";

/// Looks at a model, or takes its weights in and out
#[derive(clap::Args)]
#[command(after_help = example(EXPORT), subcommand_required = true)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// Shows every layer with its output, parameters and operations
    #[command(after_help = example("model info runs/quickstart/run"))]
    Info {
        /// A run's folder, a .safetensors file with its model.toml, or a Darknet .cfg with its .weights beside it
        model: PathBuf,
    },
    /// Reads a model of another program and writes it as safetensors with model.toml
    #[command(after_help = example(IMPORT))]
    Import {
        /// A Darknet .cfg with its .weights beside it; with --cfg any weights file, also a cut such as darknet53.conv.74
        model: PathBuf,
        /// The network that the weights belong to; layers that the file does not hold are random
        #[arg(long, value_name = "FILE.cfg")]
        cfg: Option<PathBuf>,
        /// Folder to write
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
    },
    /// Writes a model for other programs
    #[command(after_help = example(EXPORT))]
    Export {
        /// As for info
        model: PathBuf,
        /// darknet, onnx or safetensors
        #[arg(long, value_parser = |s: &str| s.parse::<ExportFormat>())]
        to: ExportFormat,
        /// File to write; its ending follows the format
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
        /// Folds batch norm into the convolutions first; what is written cannot be trained on
        #[arg(long)]
        folded: bool,
        /// Darknet: writes the first N layers only, as FILE.conv.N, to start other trainings from
        #[arg(long, value_name = "N", conflicts_with = "folded")]
        cut: Option<usize>,
    },
}

pub fn run(args: Args) -> Outcome {
    match args.what {
        What::Info { model } => {
            console::result(&info(&load(&model)?)?);
            Ok(())
        }
        What::Import { model, cfg, out } => {
            let out = required(&out, "--out DIR", IMPORT)?;
            must_exist(&model, "model")?;
            let (model, loaded) = Model::import(&model, cfg.as_deref(), 0)?;
            files::create_dir(out)?;
            model.save(out.join("best.safetensors"))?;
            let rest = if loaded.is_all() { "" } else { "; the others are random: train before use" };
            console::note(&format!("{}: {}; {loaded}{rest}", out.display(), model.config.summary()));
            Ok(())
        }
        What::Export { model, to, out, folded, cut } => {
            let out = required(&out, "--out FILE", EXPORT)?;
            if model.join(REFINER).is_file() {
                console::warn(&format!("{}: the second stage stays behind: no other program's format has one", model.display()));
            }
            let model = load(&model)?;
            files::create_dir(files::folder_of(out))?;
            if let Some(layers) = cut {
                return write_cut(&model, to, layers, out);
            }
            let model = if folded { model.folded()? } else { model };
            for file in model.export(to, out)? {
                let bytes = std::fs::metadata(&file).map_or(0, |m| m.len());
                console::note(&format!("{}: {:.2} MB", file.display(), bytes as f64 / 1e6));
            }
            Ok(())
        }
    }
}

fn write_cut(model: &Model, to: ExportFormat, layers: usize, out: &Path) -> Outcome {
    let graph = model.config.graph()?;
    if to != ExportFormat::Darknet {
        return Err(Failure::usage("--cut is Darknet's; type --to darknet"));
    }
    if layers == 0 || layers > graph.layers().len() {
        let backbone = graph.backbone();
        return Err(Failure::usage(format!("--cut {layers}: expected 1 to {} layers (the backbone has {backbone})", graph.layers().len())));
    }
    let path = out.with_extension(format!("conv.{layers}"));
    darknet::write_cut(&path, &graph, &model.weights, layers)?;
    console::note(&path.display().to_string());
    Ok(())
}

fn load(path: &Path) -> Outcome<Model> {
    must_exist(path, "model")?;
    Ok(Model::load(path)?)
}

fn info(model: &Model) -> Outcome<String> {
    let config = &model.config;
    let rows = tcross_yolo::model::info(config)?;
    let (parameters, flops) = rows.iter().fold((0, 0), |(p, f), r| (p + r.parameters, f + r.flops));
    let mut text = format!("{}, input {}, boxes {:?}\n", config.summary(), config.input, config.boxes).to_lowercase();
    let backbone = match config.graph()?.backbone() {
        0 => "there is no backbone".into(),
        layers => format!("the backbone is layers 0-{}", layers - 1),
    };
    let _ = writeln!(text, "{parameters} parameters, {:.3} GFLOP an image; {backbone}", flops as f64 / 1e9);
    let geometry = config.geometry(config.input);
    for head in &geometry.heads {
        let anchors: Vec<String> = head.mask.iter().map(|&m| config.anchors[m]).map(|[w, h]| format!("{w}x{h}")).collect();
        let _ = writeln!(text, "head of stride {}: {}x{} cells, anchors {}", head.stride_px, head.columns, head.rows, anchors.join(", "));
    }
    if !config.names.is_empty() {
        let _ = writeln!(text, "classes: {}", config.names.join(", "));
    }
    let _ = writeln!(text, "\n{:>5}  {:<28} {:>16} {:>12} {:>12}", "layer", "what", "output", "parameters", "MFLOP");
    for row in &rows {
        let [channels, height, width] = row.shape;
        let output = format!("{channels}x{height}x{width}");
        let _ = writeln!(text, "{:>5}  {:<28} {output:>16} {:>12} {:>12.2}", row.layer, row.what, row.parameters, row.flops as f64 / 1e6);
    }
    let _ = writeln!(text, "{:>5}  {:<28} {:>16} {parameters:>12} {:>12.2}", "", "all", "", flops as f64 / 1e6);
    Ok(text)
}
