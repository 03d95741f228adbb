//! A whole training: open the data, build the network, step, validate, keep the best, save.
use crate::{
    augment::{Input, Labels, View},
    config::Config,
    data::{Batch, BatchMaker, Loader, Order, Request, Samples},
    device::Accelerator,
    divergence,
    ema::Ema,
    error::TrainError,
    memory::Estimate,
    progress::{Progress, StepReport},
    refine,
    run::{
        RunDir, draw,
        history::{self, History, Row},
        state::{self, State, Sums},
    },
    schedule::Length,
    start,
    step::{StepOutput, Trainer},
    validation::{Validator, metric},
};
use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};
use tcross_dataset::{Dataset, Rng, Split, dataset::BoxConvention};
use tcross_yolo::{LossTerms, ModelConfig, ModelSection, NetSize, Weights};

/// How and where a training runs. But for the seed, and the last bits on another device, nothing here changes what it learns.
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
    let mut end = session.run(progress)?;
    if end != End::Interrupted && config.refine.epochs > 0.0 {
        let identity = &session.progress.identity;
        let refined = refine::Work { config, dataset, options, run: &session.run, identity }.fit(progress)?;
        end = if refined == End::Interrupted { refined } else { end };
    }
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
    boxes: BoxConvention,
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
        // A split without images, whose list is empty, is none.
        let val = match std::fs::metadata(dataset.list_path(Split::Val)).is_ok_and(|list| list.len() > 0) {
            true => Some(Samples::open(dataset, Split::Val, model.input, &config.classes, budget / 5)?.thinned(config.validate.images)),
            false => None,
        };
        let train = Samples::open(dataset, Split::Train, model.input, &config.classes, budget - budget / 5)?;
        for warning in train.take_warnings().iter().chain(&val.as_ref().map(Samples::take_warnings).unwrap_or_default()) {
            progress(Progress::Warning(warning));
        }
        let (network, anchor_iou) = start::describe(config, model, dataset, &train, options.seed)?;
        let marked: Vec<bool> = (0..train.count()).map(|k| !train.labels(k).is_empty()).collect();
        let order = Order::new(options.seed, &marked, config.empty_ratio);
        let memory = Estimate::of(config, &network, train.count() + val.as_ref().map_or(0, Samples::count))?;
        memory.check(options.accelerator)?;

        let graph = network.graph()?;
        let identity = start::identity(config, &network, dataset, options.seed)?;
        let state_path = options.out.join("state/state.safetensors");
        let mut source = None;
        let resumed =
            (options.resume && RunDir::is_taken(&options.out)).then(|| State::read(&state_path, &identity, &graph)).transpose()?;
        let state = match resumed {
            Some(state) => state,
            None => {
                let (weights, words) = start::weights(config, &network, options.seed)?;
                source = Some(words);
                State {
                    progress: state::Progress::start(identity),
                    average: weights.clone(),
                    weights,
                    slots: Vec::new(),
                    claims: Vec::new(),
                }
            }
        };
        let mut trainer = Trainer::new(config, &network, &state.weights, &options.accelerator)?;
        trainer.set_slots(state.slots);
        let length = Length::new(config, order.images(), network.input);
        let run = RunDir::open(&options.out, state.progress.step)?;
        let history = History::read(&run.path("metrics.csv"), state.progress.step)?;
        progress(Progress::Opened {
            train: order.images(),
            val: val.as_ref().map_or(0, Samples::count),
            anchors: &network.anchors,
            anchor_iou,
            parameters: graph.parameters(),
            memory: &memory,
            weights: source.as_deref(),
            step: state.progress.step,
        });
        let session = Self {
            config,
            options,
            trainer,
            ema: Ema::new(state.average, config.ema),
            maker: BatchMaker {
                samples: Arc::new(train),
                order,
                augment: config.augment.clone(),
                batch: config.batch,
                keypoints: network.keypoints,
                seed: options.seed,
            },
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
        source.iter().try_for_each(|source| session.run.log(&format!("weights: {source}")))?;
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
        if !self.options.provenance.iter().any(|line| line.starts_with("threads: ")) {
            self.run.log(&format!("threads: {}", rayon::current_num_threads()))?;
        }
        self.run.log(&format!("memory: {memory}"))
    }

    fn run(&mut self, progress: &mut dyn FnMut(Progress)) -> Result<End, TrainError> {
        if self.out_of_patience() {
            return Ok(End::EarlyStopped); // it had ended before it was resumed
        }
        // Where there is one thread only, it makes the batches too.
        let mut loader = Loader::start(&self.maker, self.config.workers.min(rayon::current_num_threads() - 1));
        let mut asked = self.progress.step;
        loop {
            let length = self.planned();
            let fraction = length.fraction(self.progress.step, self.progress.seconds);
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
                let fraction = length.fraction(asked, self.progress.seconds);
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

    /// The length, with the clock's end early enough for the validation that follows the last step.
    fn planned(&self) -> Length {
        let p = &self.progress;
        // Before the first validation: a forward pass takes a third of a step's time.
        let images = p.sums.steps as f64 * self.config.batch as f64;
        let guess = self.val.as_ref().map_or(0.0, |val| val.count() as f64) * p.sums.seconds / (3.0 * images).max(1.0);
        let reserve = p.validation_seconds.unwrap_or(guess);
        Length { max_seconds: self.length.max_seconds.map(|limit| (limit - reserve).max(0.5 * limit)), ..self.length }
    }

    fn out_of_patience(&self) -> bool {
        let patience = self.config.validate.patience;
        patience > 0 && self.progress.since_best >= patience
    }

    fn step(
        &mut self,
        batch: Batch,
        fraction: f64,
        started: Instant,
        waited: f64,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<(), TrainError> {
        let (step, request, images) = (self.progress.step, batch.request, batch.truths.len());
        let rate = self.config.optimizer.rate * self.config.schedule.factor(step, fraction, &self.length);
        let output = self.trainer.step(batch, rate, step)?;
        self.check_divergence(request, rate, &output)?;
        if self.config.ema > 0.0 {
            self.ema.update(&self.trainer.weights(), step);
        }
        let taken = started.elapsed().as_secs_f64();
        let p = &mut self.progress;
        p.step += 1;
        p.seconds += taken;
        p.sums.add(&output, taken);
        for warning in self.maker.samples.take_warnings() {
            progress(Progress::Warning(&warning));
        }
        let (length, p) = (self.planned(), &self.progress);
        progress(Progress::Step(StepReport {
            step: p.step,
            total_steps: self.length.total_steps,
            epoch: p.step as f64 / self.length.steps_per_epoch,
            fraction: length.fraction(p.step, p.seconds),
            loss: output.terms,
            rate,
            images_per_second: images as f64 / taken,
            waiting: waited / taken,
            seconds: p.seconds,
            seconds_left: length.seconds_left(p.step, p.seconds),
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
        let step = batch.request.step;
        if step < self.config.drawn_batches as u64 {
            self.run.write_picture(&format!("batches/{step:05}.jpg"), &draw::batch(batch))?;
        }
        Ok(())
    }

    /// Ends a training that has gone astray, with its batch written down.
    fn check_divergence(&mut self, request: Request, rate: f64, output: &StepOutput) -> Result<(), TrainError> {
        let step = request.step;
        let Some(what) = divergence::judge(output, step, &mut self.progress.usual_loss) else { return Ok(()) };
        let batch = self.maker.make(request);
        let batch = divergence::write(&self.run, &self.maker.samples, &batch, rate, output, &what)?;
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
        self.settle();
        let mut row = self.progress.sums.row();
        row.step = self.progress.step;
        row.epoch = row.step as f64 / self.length.steps_per_epoch;
        let fraction = self.planned().fraction(row.step.saturating_sub(1), self.progress.seconds);
        row.rate = self.config.optimizer.rate * self.config.schedule.factor(row.step.saturating_sub(1), fraction, &self.length);
        row.images_per_second *= self.config.batch as f64;
        let (value, network) = self.validate(&mut row, progress)?;
        let (validated, steps_took) = (started.elapsed(), self.progress.sums.seconds);
        let p = &mut self.progress;
        p.validations += 1;
        p.sums = Sums::default();
        row.seconds = p.seconds + validated.as_secs_f64();
        let best = value.is_some_and(|v| p.best.is_none_or(|(b, _)| v > b));
        if let (true, Some(value)) = (best, value) {
            p.best = Some((value, row.step));
        }
        // Without a validation split the last weights are the best that is known.
        if best || self.val.is_none() {
            p.since_best = 0;
            self.write_weights("best.safetensors")?;
        } else {
            p.since_best += 1;
        }
        self.history.rows.push(row);
        self.run.write_history(&self.history)?;
        self.run.scalars(row.step, row.seconds, &row.tags())?;
        let took = started.elapsed();
        self.progress.seconds += took.as_secs_f64();
        self.progress.validation_seconds = Some(took.as_secs_f64());
        let rest = took.saturating_sub(network).as_secs_f64();
        self.run.log(&format!(
            "step {}: validation took {:.2} s, {:.2} s of it the network; the rest, curves and best weights included, is {:.2} % of the {:.1} s of steps before it",
            row.step,
            took.as_secs_f64(),
            network.as_secs_f64(),
            100.0 * rest / steps_took.max(1e-9),
            steps_took
        ))?;
        self.save()?;
        progress(Progress::Epoch { row: &row, best });
        Ok(self.out_of_patience())
    }

    /// Fills in a row's scores and returns the metric, and how long the network took.
    fn validate(&mut self, row: &mut Row, progress: &mut dyn FnMut(Progress)) -> Result<(Option<f64>, Duration), TrainError> {
        let Some(samples) = &self.val else { return Ok((None, Duration::ZERO)) };
        progress(Progress::Validating { images: samples.count() });
        let validator = Validator {
            samples,
            boxes: self.boxes,
            model: &self.network,
            accelerator: self.options.accelerator,
            path: self.trainer.path(),
            batch: self.config.batch,
            config: &self.config.validate,
            classes: &self.config.classes,
        };
        let (detections, network) = validator.detections(&self.ema.weights)?;
        let scores = validator.score(&detections);
        row.scores = history::scores(&scores);
        let every = self.config.validate.worst_every;
        if every > 0 && self.progress.validations.is_multiple_of(every) {
            self.run.write_picture(&format!("batches/worst-{:05}.jpg", row.step), &validator.worst(&detections))?;
        }
        samples.take_warnings().iter().for_each(|warning| progress(Progress::Warning(warning)));
        Ok((metric(&scores, self.config.validate.metric), network))
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

    /// Without a moving average the weights themselves are validated and kept.
    fn settle(&mut self) {
        if self.config.ema == 0.0 {
            self.ema.weights = self.trainer.weights();
        }
    }

    fn save(&mut self) -> Result<(), TrainError> {
        self.settle();
        self.write_weights("last.safetensors")?;
        let path = self.run.path("state/state.safetensors");
        State::write(&path, &self.progress, &self.trainer.weights(), &self.ema, self.trainer.slots(), &[])?;
        self.saved_at = self.progress.seconds;
        Ok(())
    }
}

impl Sums {
    /// Takes in a step that took so long.
    pub(crate) fn add(&mut self, output: &StepOutput, seconds: f64) {
        let t = &output.terms;
        let values = [t.center, t.size, t.objectness, t.class, t.keypoints, output.gradient_norm];
        self.steps += 1;
        self.seconds += seconds;
        self.values.iter_mut().zip(values).for_each(|(sum, v)| *sum += v);
    }

    /// Means as a row; `images_per_second` holds steps a second.
    pub(crate) fn row(&self) -> Row {
        let [center, size, objectness, class, keypoints, gradient_norm] = self.values.map(|v| v / self.steps.max(1) as f64);
        let loss = LossTerms { center, size, objectness, class, keypoints };
        Row { loss, gradient_norm, images_per_second: self.steps as f64 / self.seconds.max(1e-9), ..Row::default() }
    }
}
