//! What a training starts from: the network's complete description, its first weights, and the identity that a resume is held to.
use crate::{
    config::{Config, Validate},
    data::Samples,
    error::TrainError,
    refine::Refine,
};
use std::path::Path;
use tcross_dataset::{Dataset, Split, files};
use tcross_yolo::{
    AnchorChoice, ModelConfig, ModelSection, Weights, YoloError, anchors,
    config::AnchorSource,
    weights::{Init, darknet, safetensors},
};

/// A marker's centre and four corners.
const MOST_POINTS: usize = 5;

/// The network's complete description, with its anchors, and how well k-means' anchors fit.
pub(crate) fn describe(
    config: &Config,
    model: &ModelSection,
    dataset: &Dataset,
    train: &Samples,
    seed: u64,
) -> Result<(ModelConfig, Option<f64>), TrainError> {
    // A network of one class takes every shape for it where none is named.
    if config.classes.len() != model.classes && !(config.classes.is_empty() && model.classes == 1) {
        let found = format!("{} names", config.classes.len());
        return Err(TrainError::value("classes", found, format!("{} (model.classes), so that shapes can be numbered", model.classes)));
    }
    if model.keypoints > MOST_POINTS || (model.keypoints > 0 && !train.has_points()) {
        let list = dataset.list_path(Split::Train);
        let allowed = match train.has_points() {
            true => format!("0 to {MOST_POINTS}: a marker's centre, then its corners from the stem's on"),
            false => format!("0, since no marker of {} has its corners", list.display()),
        };
        return Err(YoloError::value("model.keypoints", model.keypoints, allowed).into());
    }
    let (anchors, fit) = match &model.anchors {
        AnchorChoice::List(list) => (list.clone(), None),
        AnchorChoice::Named(AnchorSource::Coco) => (model.architecture.coco_anchors(), None),
        AnchorChoice::Named(AnchorSource::Kmeans) => {
            let sizes = train.box_sizes();
            if sizes.is_empty() {
                return Err(TrainError::Empty { path: dataset.list_path(Split::Train), what: "marker to take anchors from".into() });
            }
            let fit = anchors::kmeans(&sizes, model.anchor_count(), seed)?;
            (fit.anchors, Some(fit.mean_iou))
        }
    };
    let names = if config.classes.len() == model.classes { config.classes.clone() } else { Vec::new() };
    let network = ModelConfig { names, ..model.resolve(anchors, dataset.header.boxes) };
    network.validate()?;
    Ok((network, fit))
}

/// Random weights, or those of the file that training starts from; and in words, what they are.
pub(crate) fn weights(config: &Config, network: &ModelConfig, seed: u64) -> Result<(Weights, String), TrainError> {
    let graph = network.graph()?;
    let init = Init { objectness_bias: config.objectness_bias as f32, class_bias: config.class_bias as f32, ..Init::default() };
    let mut weights = Weights::init(&graph, &network.fields(), &init, seed);
    let Some(path) = &config.init else { return Ok((weights, format!("random, from seed {seed}"))) };
    let of_safetensors = Path::new(path).extension().is_some_and(|e| e == "safetensors");
    let loaded = match of_safetensors {
        true => safetensors::read_start(path, &graph, &mut weights)?,
        false => darknet::read_start(path, network, &mut weights)?,
    };
    let rest = if loaded.is_all() { String::new() } else { format!("; the others random, from seed {seed}") };
    Ok((weights, format!("{loaded} of {path}{rest}")))
}

/// Everything that a resumed training must share with the one that was stopped, a line each: all settings but the lengths, patience among
/// them, and those that do not change what is learned, the network, the data's digests.
pub(crate) fn identity(config: &Config, network: &ModelConfig, dataset: &Dataset, seed: u64) -> Result<String, TrainError> {
    let fixed = Config::default();
    let refine = Refine { epochs: fixed.refine.epochs, max_minutes: None, false_cost: fixed.refine.false_cost, ..config.refine.clone() };
    let config = Config {
        refine,
        epochs: None,
        steps: None,
        max_minutes: None,
        cache_gb: fixed.cache_gb,
        workers: fixed.workers,
        save_minutes: fixed.save_minutes,
        drawn_batches: fixed.drawn_batches,
        validate: Validate { patience: fixed.validate.patience, ..config.validate.clone() },
        ..config.clone()
    };
    let text = |value: Result<String, toml::ser::Error>| value.map_err(|e| TrainError::state(&dataset.dir, e));
    let mut identity = format!("seed = {seed}\n{}{}", text(toml::to_string(&config))?, text(toml::to_string(network))?);
    for split in dataset.splits().into_iter().filter(|split| *split != Split::Test) {
        identity.push_str(&format!("{split}.jsonl = {}\n", files::digest(dataset.list_path(split))?));
    }
    Ok(identity)
}
