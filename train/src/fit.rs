//! A whole training: open the data, build the network, step, validate, keep the best, save.
use crate::{
    augment::{Input, Labels, View},
    config::Config,
    data::{Batch, BatchMaker, Loader, Order, Request, Samples},
    device::Accelerator,
    ema::Ema,
    error::TrainError,
    memory::Estimate,
    progress::{Progress, StepReport},
    run::{
        RunDir, draw,
        history::{self, History, Row},
        state::{self, State, Sums},
    },
    schedule::Length,
    step::{StepOutput, Trainer},
    validation::{Validator, metric},
};
use std::{
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};
use tcross_dataset::{Dataset, Rng, Split, files};
use tcross_yolo::{
    AnchorChoice, BoxConvention, LossTerms, ModelConfig, ModelSection, NetSize, Weights, anchors,
    config::AnchorSource,
    weights::{Init, darknet, safetensors},
};

/// How and where a training runs; nothing here changes what it learns.
#[derive(Debug, Clone)]
pub struct RunOptions<'a> {
    /// The run's folder.
    pub out: PathBuf,
    /// Seed of everything that is drawn.
    pub seed: u64,
    /// Set to true to stop after the current step, with everything saved.
    pub stop: &'a AtomicBool,
    /// Goes on with the run in `out`, if there is one.
    pub resume: bool,
    /// Where it computes.
    pub accelerator: Accelerator,
    /// Lines for `log.txt`: commit, CPU, threads.
    pub provenance: Vec<String>,
    /// The text of `config.toml`; absent: the `[model]` and `[train]` sections.
    pub effective_config: Option<String>,
}

impl<'a> RunOptions<'a> {
    /// A new run on the CPU.
    #[must_use]
    pub fn new(out: impl Into<PathBuf>, seed: u64, stop: &'a AtomicBool) -> Self {
        let (accelerator, provenance) = (Accelerator::Cpu, Vec::new());
        Self { out: out.into(), seed, stop, resume: false, accelerator, provenance, effective_config: None }
    }
}

/// Why a training ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// It came to its length.
    Finished,
    /// No better validation for as long as `patience` says.
    EarlyStopped,
    /// It was told to stop; everything is saved.
    Interrupted,
}

/// What a training came to.
#[derive(Debug, Clone, PartialEq)]
pub struct RunSummary {
    /// Why it ended.
    pub end: End,
    /// Steps taken, also before a resume.
    pub steps: u64,
    /// Passes over the training images.
    pub epochs: f64,
    /// Seconds of training, also before a resume.
    pub seconds: f64,
    /// The best value of the metric, and its step.
    pub best: Option<(f64, u64)>,
    /// The rows of `metrics.csv`.
    pub history: History,
}

/// Trains a network on a dataset and writes the run's folder.
///
/// # Errors
/// If a setting is not allowed, the dataset or a file of the run cannot be read or written, memory cannot suffice, a state to resume
/// belongs to another training, or the training diverges.
pub fn fit(
    config: &Config,
    model: &ModelSection,
    dataset: &Dataset,
    options: &RunOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<RunSummary, TrainError> {
    config.validate()?;
    model.validate()?;
    options.accelerator.check()?;
    if RunDir::is_taken(&options.out) && !options.resume {
        return Err(TrainError::RunExists { run: options.out.clone() });
    }
    let mut session = Session::open(config, model, dataset, options, progress)?;
    let end = session.run(progress)?;
    let step = session.progress.step;
    Ok(RunSummary {
        end,
        steps: step,
        epochs: step as f64 / session.length.steps_per_epoch,
        seconds: session.progress.seconds,
        best: session.progress.best,
        history: session.history,
    })
}

/// A training under way.
struct Session<'a> {
    config: &'a Config,
    options: &'a RunOptions<'a>,
    network: ModelConfig,
    trainer: Trainer,
    ema: Ema,
    maker: BatchMaker,
    val: Option<Samples>,
    boxes: tcross_dataset::dataset::BoxConvention,
    length: Length,
    run: RunDir,
    history: History,
    progress: state::Progress,
    saved_at: f64,
}

impl<'a> Session<'a> {
    fn open(
        config: &'a Config,
        model: &ModelSection,
        dataset: &Dataset,
        options: &'a RunOptions<'a>,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Self, TrainError> {
        let budget = (config.cache_gb * 1e9) as usize;
        let val = match dataset.splits().contains(&Split::Val) {
            true => Some(Samples::open(dataset, Split::Val, model.input, &config.classes, budget / 5)?.thinned(config.validate.images)),
            false => None,
        };
        let train = Samples::open(dataset, Split::Train, model.input, &config.classes, budget - budget / 5)?;
        for warning in train.take_warnings().iter().chain(&val.as_ref().map(Samples::take_warnings).unwrap_or_default()) {
            progress(Progress::Warning(warning));
        }
        let (network, anchor_iou) = describe(config, model, dataset, &train, options.seed)?;
        let marked: Vec<bool> = (0..train.count()).map(|k| !train.labels(k).is_empty()).collect();
        let order = Order::new(options.seed, &marked, config.empty_ratio);
        let memory = Estimate::of(config, &network, train.count() + val.as_ref().map_or(0, Samples::count))?;
        memory.check()?;

        let graph = network.graph()?;
        let identity = identity(config, &network, dataset, options.seed)?;
        let state_path = options.out.join("state/state.safetensors");
        let mut start = None;
        let resumed =
            (options.resume && RunDir::is_taken(&options.out)).then(|| State::read(&state_path, &identity, &graph)).transpose()?;
        let state = match resumed {
            Some(state) => state,
            None => {
                let (weights, source) = start_weights(config, &network, options.seed)?;
                start = Some(source);
                State { progress: state::Progress::start(identity), average: weights.clone(), weights, slots: Vec::new() }
            }
        };
        let mut trainer = Trainer::new(config, &network, &state.weights, &options.accelerator)?;
        trainer.set_slots(state.slots);
        let length = Length::new(config, order.images());
        let run = RunDir::open(&options.out, state.progress.step)?;
        let history = History::read(&run.path("metrics.csv"), state.progress.step)?;
        progress(Progress::Opened {
            train: order.images(),
            val: val.as_ref().map_or(0, Samples::count),
            anchors: &network.anchors,
            anchor_iou,
            parameters: graph.parameters(),
            memory: &memory,
            step: state.progress.step,
        });
        let session = Self {
            config,
            options,
            trainer,
            ema: Ema::new(state.average, config.ema),
            maker: BatchMaker { samples: Arc::new(train), order, augment: config.augment.clone(), batch: config.batch, seed: options.seed },
            val,
            boxes: dataset.header.boxes,
            length,
            run,
            history,
            saved_at: state.progress.seconds,
            progress: state.progress,
            network,
        };
        session.describe_run(model, &memory)?;
        start.iter().try_for_each(|source| session.run.log(&format!("weights: {source}")))?;
        Ok(session)
    }

    /// `config.toml`, `model.toml` and the head of `log.txt`.
    fn describe_run(&self, model: &ModelSection, memory: &Estimate) -> Result<(), TrainError> {
        let own = || -> Result<String, toml::ser::Error> {
            #[derive(serde::Serialize)]
            struct Sections<'a> {
                seed: u64,
                model: &'a ModelSection,
                train: &'a Config,
            }
            toml::to_string(&Sections { seed: self.options.seed, model, train: self.config })
        };
        let text = match &self.options.effective_config {
            Some(text) => text.clone(),
            None => own().map_err(|e| TrainError::state(self.run.path("config.toml"), e))?,
        };
        self.run.write("config.toml", &text)?;
        self.network.write(self.run.path("model.toml"))?;
        let verb = if self.progress.step == 0 { "starts" } else { "goes on" };
        self.run.log(&format!("training {verb} at step {} with seed {}", self.progress.step, self.options.seed))?;
        self.options.provenance.iter().try_for_each(|line| self.run.log(line))?;
        self.run.log(&format!("threads: {}", rayon::current_num_threads()))?;
        self.run.log(&format!("memory: {memory}"))
    }

    fn run(&mut self, progress: &mut dyn FnMut(Progress)) -> Result<End, TrainError> {
        let mut loader = Loader::start(&self.maker, self.config.workers);
        let mut asked = self.progress.step;
        loop {
            let fraction = self.length.fraction(self.progress.step, self.progress.seconds);
            if fraction >= 1.0 {
                return self.finish(End::Finished, progress);
            }
            if self.options.stop.load(Ordering::Relaxed) {
                self.save()?;
                self.run.log(&format!("stopped at step {}; --resume goes on", self.progress.step))?;
                return Ok(End::Interrupted);
            }
            let started = Instant::now();
            while loader.pending() < loader.ahead() {
                let fraction = self.length.fraction(asked, self.progress.seconds);
                loader.request(self.request(asked, fraction));
                asked += 1;
            }
            let batch = loader.receive().ok_or_else(|| TrainError::state(&self.options.out, "a batch thread has died"))?;
            self.draw_first(&batch)?;
            let waited = started.elapsed().as_secs_f64();
            self.step(batch, fraction, started, waited, progress)?;
            if self.ends_epoch() && self.end_epoch(progress)? {
                return self.finish(End::EarlyStopped, progress);
            }
            if self.config.save_minutes > 0.0 && self.progress.seconds - self.saved_at > 60.0 * self.config.save_minutes {
                self.save()?;
            }
        }
    }

    fn step(
        &mut self,
        batch: Batch,
        fraction: f64,
        started: Instant,
        waited: f64,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<(), TrainError> {
        let step = self.progress.step;
        let rate = self.config.optimizer.rate * self.config.schedule.factor(step, fraction, &self.length);
        let images = batch.truths.len();
        let output = self.trainer.step(batch, rate, step)?;
        self.check_divergence(&output)?;
        self.ema.update(&self.trainer.weights(), step);
        let taken = started.elapsed().as_secs_f64();
        let p = &mut self.progress;
        p.step += 1;
        p.seconds += taken;
        p.sums.add(&output, taken);
        for warning in self.maker.samples.take_warnings() {
            progress(Progress::Warning(&warning));
        }
        progress(Progress::Step(StepReport {
            step: p.step,
            total_steps: self.length.total_steps,
            epoch: p.step as f64 / self.length.steps_per_epoch,
            fraction: self.length.fraction(p.step, p.seconds),
            loss: output.terms,
            rate,
            images_per_second: images as f64 / taken,
            waiting: waited / taken,
            seconds: p.seconds,
            seconds_left: self.length.seconds_left(p.step, p.seconds),
        }));
        Ok(())
    }

    /// What a step shows, when `fraction` of the training lies before it.
    fn request(&self, step: u64, fraction: f64) -> Request {
        let windows = self.config.windows;
        let (net, view) = match fraction < windows.until {
            true => (NetSize::square(windows.side), View::Window { focus: windows.focus }),
            false => (self.input_size(step), View::Whole),
        };
        Request { step, input: Input { net, view, fraction } }
    }

    /// Size of whole images at a step: drawn anew every few steps where several are allowed.
    fn input_size(&self, step: u64) -> NetSize {
        if self.config.multi_scale.is_empty() {
            return self.network.input;
        }
        let mut rng = Rng::for_item(self.options.seed, "train/input", step / self.config.multi_scale_steps);
        NetSize::square(*rng.choose(&self.config.multi_scale))
    }

    fn draw_first(&self, batch: &Batch) -> Result<(), TrainError> {
        if batch.step < self.config.drawn_batches as u64 {
            self.run.write_picture(&format!("batches/{:05}.jpg", batch.step), &draw::batch(batch))?;
        }
        Ok(())
    }

    /// A loss that is no number, or a thousand times the usual one, ends the training with its batch drawn.
    fn check_divergence(&mut self, output: &StepOutput) -> Result<(), TrainError> {
        let (step, total, usual) = (self.progress.step, output.terms.total(), self.progress.usual_loss);
        // One wild batch moves the usual loss by a tenth at most.
        self.progress.usual_loss = if step == 0 { total } else { 0.99 * usual + 0.01 * total.min(10.0 * usual) };
        let what = if !total.is_finite() {
            format!("the loss is {total}")
        } else if !output.gradient_norm.is_finite() {
            format!("the gradient's norm is {}", output.gradient_norm)
        } else if step > 0 && total > 1000.0 * usual {
            format!("the loss is {total:.3}, usually {usual:.3}")
        } else {
            return Ok(());
        };
        let request = self.request(step, self.length.fraction(step, self.progress.seconds));
        let batch = self.run.write_picture("batches/diverged.jpg", &draw::batch(&self.maker.clone().make(request)))?;
        self.run.log(&format!("diverged at step {step}: {what}"))?;
        Err(TrainError::Diverged { step, what, batch })
    }

    /// True where the last step has completed an epoch after which validation is due.
    fn ends_epoch(&self) -> bool {
        let epoch = |step: u64| (step as f64 / self.length.steps_per_epoch + 1e-9).floor() as u64;
        let now = epoch(self.progress.step);
        now > epoch(self.progress.step - 1) && now.is_multiple_of(self.config.validate.every)
    }

    /// Validates, writes numbers and weights; true if training should stop for want of progress.
    fn end_epoch(&mut self, progress: &mut dyn FnMut(Progress)) -> Result<bool, TrainError> {
        let started = Instant::now();
        let mut row = self.progress.sums.row();
        row.step = self.progress.step;
        row.epoch = row.step as f64 / self.length.steps_per_epoch;
        let fraction = self.length.fraction(row.step.saturating_sub(1), self.progress.seconds);
        row.rate = self.config.optimizer.rate * self.config.schedule.factor(row.step.saturating_sub(1), fraction, &self.length);
        row.images_per_second *= self.config.batch as f64;
        let value = self.validate(&mut row, progress)?;
        let p = &mut self.progress;
        p.validations += 1;
        p.sums = Sums::default();
        p.seconds += started.elapsed().as_secs_f64();
        row.seconds = p.seconds;
        let best = value.is_some_and(|v| p.best.is_none_or(|(b, _)| v > b));
        p.since_best = if best { 0 } else { p.since_best + 1 };
        if let (true, Some(value)) = (best, value) {
            p.best = Some((value, row.step));
        }
        // Without a validation split the last weights are the best that is known.
        if best || self.val.is_none() {
            self.write_weights("best.safetensors")?;
        }
        self.history.rows.push(row);
        self.run.write_history(&self.history)?;
        let scalars: Vec<(&str, f64)> = row.columns().into_iter().filter_map(|(name, value)| Some((name, value?))).collect();
        self.run.scalars(row.step, row.seconds, &scalars)?;
        self.save()?;
        progress(Progress::Epoch { row: &row, best });
        let patience = self.config.validate.patience;
        Ok(patience > 0 && self.progress.since_best >= patience)
    }

    /// Fills in a row's scores and returns the metric.
    fn validate(&mut self, row: &mut Row, progress: &mut dyn FnMut(Progress)) -> Result<Option<f64>, TrainError> {
        let Some(samples) = &self.val else { return Ok(None) };
        progress(Progress::Validating { images: samples.count() });
        let validator = Validator {
            samples,
            boxes: self.boxes,
            model: &self.network,
            accelerator: self.options.accelerator,
            batch: self.config.batch,
            config: &self.config.validate,
            classes: &self.config.classes,
        };
        let detections = validator.detections(&self.ema.weights)?;
        let scores = validator.score(&detections);
        row.scores = history::scores(&scores);
        let every = self.config.validate.worst_every;
        if every > 0 && self.progress.validations.is_multiple_of(every) {
            self.run.write_picture(&format!("batches/worst-{:05}.jpg", row.step), &validator.worst(&detections))?;
        }
        samples.take_warnings().iter().for_each(|warning| progress(Progress::Warning(warning)));
        Ok(metric(&scores, self.config.validate.metric))
    }

    fn finish(&mut self, end: End, progress: &mut dyn FnMut(Progress)) -> Result<End, TrainError> {
        let fresh = self.history.rows.last().is_some_and(|row| row.step == self.progress.step);
        if !fresh && self.progress.sums.steps > 0 {
            self.end_epoch(progress)?;
        }
        let p = &self.progress;
        self.run.log(&format!("ended at step {} after {:.1} s: {end:?}; best {:?}", p.step, p.seconds, p.best))?;
        Ok(end)
    }

    fn write_weights(&self, name: &str) -> Result<(), TrainError> {
        let weights = Weights { seen: self.progress.step * self.config.batch as u64, ..self.ema.weights.clone() };
        self.run.write_weights(name, &self.network, &weights)
    }

    fn save(&mut self) -> Result<(), TrainError> {
        self.write_weights("last.safetensors")?;
        let path = self.run.path("state/state.safetensors");
        State::write(&path, &self.progress, &self.trainer.weights(), &self.ema, self.trainer.slots())?;
        self.saved_at = self.progress.seconds;
        Ok(())
    }
}

impl Sums {
    fn add(&mut self, output: &StepOutput, seconds: f64) {
        let t = &output.terms;
        let values = [t.center, t.size, t.objectness, t.class, t.keypoints, output.gradient_norm];
        self.steps += 1;
        self.seconds += seconds;
        self.values.iter_mut().zip(values).for_each(|(sum, v)| *sum += v);
    }

    /// Means as a row; `images_per_second` holds steps a second.
    fn row(&self) -> Row {
        let [center, size, objectness, class, keypoints, gradient_norm] = self.values.map(|v| v / self.steps.max(1) as f64);
        let loss = LossTerms { center, size, objectness, class, keypoints };
        Row { loss, gradient_norm, images_per_second: self.steps as f64 / self.seconds.max(1e-9), ..Row::default() }
    }
}

/// The network's complete description, with its anchors, and how well k-means' anchors fit.
fn describe(
    config: &Config,
    model: &ModelSection,
    dataset: &Dataset,
    train: &Samples,
    seed: u64,
) -> Result<(ModelConfig, Option<f64>), TrainError> {
    if model.classes > 1 && config.classes.len() != model.classes {
        let found = format!("{} names", config.classes.len());
        return Err(TrainError::value("classes", found, format!("{} (model.classes), so that shapes can be numbered", model.classes)));
    }
    let coco = model.architecture.coco_anchors();
    let (anchors, fit) = match &model.anchors {
        AnchorChoice::List(list) => (list.clone(), None),
        AnchorChoice::Named(AnchorSource::Coco) => (coco, None),
        AnchorChoice::Named(AnchorSource::Kmeans) => {
            let sizes = train.box_sizes();
            if sizes.is_empty() {
                return Err(TrainError::Empty { path: dataset.list_path(Split::Train), what: "marker to take anchors from".into() });
            }
            let fit = anchors::kmeans(&sizes, coco.len(), seed)?;
            (fit.anchors, Some(fit.mean_iou))
        }
    };
    let boxes = match dataset.header.boxes {
        tcross_dataset::dataset::BoxConvention::Continuous => BoxConvention::Continuous,
        tcross_dataset::dataset::BoxConvention::Inclusive => BoxConvention::Inclusive,
    };
    let names = if config.classes.len() == model.classes { config.classes.clone() } else { Vec::new() };
    let network = ModelConfig { names, ..model.resolve(anchors, boxes) };
    network.validate()?;
    Ok((network, fit))
}

/// Random weights, or those of the file that training starts from; and in words, what they are.
fn start_weights(config: &Config, network: &ModelConfig, seed: u64) -> Result<(Weights, String), TrainError> {
    let graph = network.graph()?;
    let init = Init { objectness_bias: config.objectness_bias as f32, class_bias: config.class_bias as f32, ..Init::default() };
    let mut weights = Weights::init(&graph, &network.fields(), &init, seed);
    let Some(path) = &config.init else { return Ok((weights, format!("random, from seed {seed}"))) };
    if Path::new(path).extension().is_some_and(|e| e == "safetensors") {
        return Ok((safetensors::read(path, &graph)?, format!("all of {path}")));
    }
    let loaded = darknet::read_start(path, network, &mut weights)?;
    Ok((weights, format!("{} of {} convolutions from {path}, the others random from seed {seed}", loaded.convolutions, loaded.of)))
}

/// Everything that a resumed training must share with the one that was stopped, a line each: all settings but the lengths and those that
/// do not change what is learned, the network, the data's digests.
fn identity(config: &Config, network: &ModelConfig, dataset: &Dataset, seed: u64) -> Result<String, TrainError> {
    let fixed = Config::default();
    let config = Config {
        epochs: None,
        steps: None,
        max_minutes: None,
        cache_gb: fixed.cache_gb,
        workers: fixed.workers,
        save_minutes: fixed.save_minutes,
        drawn_batches: fixed.drawn_batches,
        ..config.clone()
    };
    let text = |value: Result<String, toml::ser::Error>| value.map_err(|e| TrainError::state(&dataset.dir, e));
    let mut identity = format!("seed = {seed}\n{}{}", text(toml::to_string(&config))?, text(toml::to_string(network))?);
    for split in dataset.splits().into_iter().filter(|split| *split != Split::Test) {
        identity.push_str(&format!("{split}.jsonl = {}\n", files::digest(dataset.list_path(split))?));
    }
    Ok(identity)
}
