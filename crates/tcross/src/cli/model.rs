//! `tcross model info,import,export MODEL`
use super::{example, must_exist, required};
use crate::{console, exit::Outcome};
use clap::Subcommand;
use std::{
    fmt::Write,
    path::{Path, PathBuf},
};
use tcross_yolo::{Model, model::ExportFormat};

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
        /// A Darknet .cfg with its .weights beside it
        model: PathBuf,
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
    },
}

pub fn run(args: Args) -> Outcome {
    match args.what {
        What::Info { model } => {
            console::result(&info(&load(&model)?)?);
            Ok(())
        }
        What::Import { model, out } => {
            let out = required(&out, "--out DIR", IMPORT)?;
            let model = load(&model)?;
            tcross_dataset::files::create_dir(out)?;
            model.save(out.join("best.safetensors"))?;
            console::note(&format!("{}: {} parameters", out.display(), model.config.graph()?.parameters()));
            Ok(())
        }
        What::Export { model, to, out, folded } => {
            let out = required(&out, "--out FILE", EXPORT)?;
            let model = load(&model)?;
            let model = if folded { model.folded()? } else { model };
            for file in model.export(to, out)? {
                console::note(&file.display().to_string());
            }
            Ok(())
        }
    }
}

fn load(path: &Path) -> Outcome<Model> {
    must_exist(path, "model")?;
    Ok(Model::load(path)?)
}

fn info(model: &Model) -> Outcome<String> {
    let rows = tcross_yolo::model::info(&model.config)?;
    let mut text = format!("{:>5}  {:<28} {:>16} {:>12} {:>12}\n", "layer", "what", "output", "parameters", "MFLOP");
    for row in &rows {
        let [channels, height, width] = row.shape;
        let output = format!("{channels}x{height}x{width}");
        let _ = writeln!(text, "{:>5}  {:<28} {output:>16} {:>12} {:>12.2}", row.layer, row.what, row.parameters, row.flops as f64 / 1e6);
    }
    let (parameters, flops) = rows.iter().fold((0, 0), |(p, f), r| (p + r.parameters, f + r.flops));
    let _ = writeln!(text, "{:>5}  {:<28} {:>16} {parameters:>12} {:>12.2}", "", "all", "", flops as f64 / 1e6);
    Ok(text)
}
