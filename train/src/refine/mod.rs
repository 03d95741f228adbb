//! Trains the second stage: the finished detector claims, the refiner learns which claims are markers and where their boxes lie.
mod claims;
mod loss;
mod memory;

use crate::{
    config::{ClipBy, Config, Optimizer, OptimizerKind, Schedule, within},
    ema::Ema,
    error::TrainError,
    fit::{End, RunOptions},
    learner::Learner,
    pass::{Passed, parameter_gradients},
    progress::{Progress, StepReport},
    run::{
        RunDir,
        state::{self, State, Sums},
    },
    schedule::Length,
    validation::metric,
};
use burn::tensor::{Device, Tensor, TensorData};
use claims::{Claim, Truth};
use memory::{Memory, Seen};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::{sync::atomic::Ordering, time::Instant};
use tcross_dataset::{Dataset, ImageDetections, Record, Rng, Split, files, picture};
use tcross_eval::ValidationScores;
use tcross_kernels::ops::Path;
use tcross_yolo::{
    BoxFields, Detector, LossTerms, Refiner, Weights,
    network::read_logits,
    refiner::{
        Frame, Glance, Opinion, REFINER, RefinerNet, frame,
        net::{self, OUTPUTS},
        polar::{COLUMNS, RINGS, VIEW},
    },
    weights::safetensors,
};

/// The second stage, which looks at each claim of the trained detector again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Refine {
    /// Length in passes: as many looks as there are claims, though some claims are looked at more often than others; 0 for no second stage.
    pub epochs: f64,
    /// Length in minutes of wall time, after those of the detector; the length that ends first counts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_minutes: Option<f64>,
    /// Training images whose claims are learned from, evenly spread; 0 for all.
    pub images: usize,
    /// Claims in a step.
    pub batch: usize,
    /// Parts of a batch that go through the network side by side. 1 to `batch`.
    pub batch_parts: usize,
    /// The optimiser. Its rate rises over the first twentieth of the steps and falls by a cosine.
    pub optimizer: Optimizer,
    /// Decay of the moving average of the weights, which is what is kept; 0 for none.
    pub ema: f64,
    /// Deviation of the logarithm of a view's width and of its height; half of it that of a frame's stretch and slant.
    pub scale: f64,
    /// Deviation of a view's middle, in half sides; half of it in a frame.
    pub shift: f64,
    /// How many missed markers a false claim is as bad as: what is a marker with odds of `false_cost` to 1 gets a score of 0.5. At 1, scores
    /// are probabilities.
    pub false_cost: f64,
}

impl Default for Refine {
    fn default() -> Self {
        Self {
            epochs: 0.0,
            max_minutes: None,
            images: 0,
            batch: 128,
            batch_parts: 1,
            optimizer: Optimizer { kind: OptimizerKind::Adamw, rate: 3e-3, decay: 0.05, ..Optimizer::default() },
            ema: 0.998,
            scale: 0.1,
            shift: 0.07,
            false_cost: 1.0,
        }
    }
}

impl Refine {
    pub(crate) fn validate(&self) -> Result<(), TrainError> {
        within("refine.epochs", self.epochs, 0.0, 1e6)?;
        if let Some(minutes) = self.max_minutes {
            within("refine.max_minutes", minutes, 1e-3, 1e6)?;
        }
        within("refine.batch", self.batch as f64, 1.0, 65536.0)?;
        if !(1..=self.batch).contains(&self.batch_parts) {
            return Err(TrainError::value("refine.batch_parts", self.batch_parts, format!("1 to {} (train.refine.batch)", self.batch)));
        }
        within("refine.ema", self.ema, 0.0, 0.999_999)?;
        within("refine.scale", self.scale, 0.0, 1.0)?;
        within("refine.shift", self.shift, 0.0, 1.0)?;
        within("refine.false_cost", self.false_cost, 1e-3, 1e3)?;
        self.optimizer.validate("refine.optimizer")
    }
}

/// Norm to which a step's gradient is scaled down.
const CLIP: f64 = 10.0;
/// Share of later looks at a claim that are not in its frame, but where the first was.
const BOXED: f64 = 0.25;
/// Share of the steps over which the rate rises.
const WARMUP: f64 = 0.05;
/// Name of what a stopped training goes on from.
const STATE: &str = "state/refiner.safetensors";

/// Trains a second stage for the best detector of the finished run in `options.out`, by `config.refine`.
///
/// # Errors
/// If a setting is not allowed, or a file of the run or of the dataset cannot be read or written.
pub fn refine(config: &Config, dataset: &Dataset, options: &RunOptions, progress: &mut dyn FnMut(Progress)) -> Result<End, TrainError> {
    config.validate()?;
    let run = RunDir::open(&options.out, 0)?;
    Work { config, dataset, options, run: &run, identity: "" }.fit(progress)
}

/// A detector that is trained, and where its second stage belongs.
pub(crate) struct Work<'a> {
    pub config: &'a Config,
    pub dataset: &'a Dataset,
    pub options: &'a RunOptions<'a>,
    pub run: &'a RunDir,
    /// What the detector was trained from.
    pub identity: &'a str,
}

impl Work<'_> {
    /// Trains the second stage of the run's best detector, or goes on with it, and keeps it where validation says that it helps.
    pub fn fit(&self, progress: &mut dyn FnMut(Progress)) -> Result<End, TrainError> {
        let started = Instant::now();
        let mut detector = Detector::load(&self.options.out)?;
        detector.refiner = None;
        let mut told = |done, of| progress(Progress::Claims { done, of });
        let found = claims::collect(&detector, self.dataset, self.config.refine.images, self.options.seed, self.options.stop, &mut told)?;
        let Some(claims) = found else { return Ok(End::Interrupted) };
        let of_markers = claims.iter().filter(|claim| claim.truth.is_some()).count();
        if of_markers == 0 || of_markers == claims.len() {
            progress(Progress::Warning("no second stage: the detector's claims are all of one kind"));
            return Ok(End::Finished);
        }
        self.run.log(&format!(
            "second stage: {} claims, {of_markers} of markers, {:.1} s",
            claims.len(),
            started.elapsed().as_secs_f64()
        ))?;
        let (mut state, memory) = self.start(claims.len())?;
        if state.progress.step == 0 {
            // Finding the claims is part of the time; a resumed training has counted it already.
            state.progress.seconds = started.elapsed().as_secs_f64();
        }
        match self.learn(&claims, state, memory, progress)? {
            Some((weights, at)) => self.keep(detector, &weights, &at, progress).map(|()| End::Finished),
            None => Ok(End::Interrupted),
        }
    }

    /// Where a stopped training of the same second stage was, else the beginning.
    fn start(&self, claims: usize) -> Result<(State, Memory), TrainError> {
        let identity = format!("{}best.safetensors = {}\n", self.identity, files::digest(self.run.path("best.safetensors"))?);
        let layers = net::layers();
        let seed = self.options.seed;
        let saved = self.options.resume.then(|| State::read(&self.run.path(STATE), &identity, &layers).ok()).flatten().and_then(|state| {
            let memory = Memory::again(seed, claims, state.progress.claims, &state.claims)?;
            Some((state, memory))
        });
        let weights = || Weights::init(&layers, &BoxFields::plain(1), &Default::default(), seed);
        let fresh = || State {
            progress: state::Progress::start(identity),
            average: weights(),
            weights: weights(),
            slots: Vec::new(),
            claims: Vec::new(),
        };
        Ok(saved.unwrap_or_else(|| (fresh(), Memory::new(seed, claims))))
    }

    /// Steps until the end, to the averaged weights; none if stopped. What was learned is saved in both cases.
    fn learn(
        &self,
        claims: &[Claim],
        state: State,
        mut memory: Memory,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Option<(Weights, state::Progress)>, TrainError> {
        let config = &self.config.refine;
        let State { progress: mut at, weights, average, slots, .. } = state;
        let device = Device::flex().autodiff();
        let copy = || Ok(RefinerNet::new(&weights, &device)?);
        let mut learner = Learner::new(config.batch_parts, &config.optimizer, CLIP, ClipBy::Global, copy)?;
        learner.set_slots(slots);
        let mut ema = Ema::new(average, config.ema);
        let steps_per_epoch = claims.len() as f64 / config.batch as f64;
        let length = Length::of_steps(steps_per_epoch, (config.epochs * steps_per_epoch).ceil() as u64, config.max_minutes);
        let schedule = Schedule { warmup: WARMUP, ..Schedule::default() };
        let mut pass_sums = Sums::default();
        let (save_seconds, mut saved_at) = (60.0 * self.config.save_minutes, at.seconds);
        loop {
            let started = Instant::now();
            let fraction = length.fraction(at.step, at.seconds);
            let ends = fraction >= 1.0 || self.options.stop.load(Ordering::Relaxed);
            if ends || (save_seconds > 0.0 && at.seconds - saved_at > save_seconds) {
                if config.ema == 0.0 {
                    ema.weights = learner.weights();
                }
                at.claims = memory.at();
                State::write(&self.run.path(STATE), &at, &learner.weights(), &ema, learner.slots(), &memory.numbers())?;
                saved_at = at.seconds;
            }
            if ends {
                return Ok((fraction >= 1.0).then_some((ema.weights, at)));
            }
            let looks = self.looks(&mut memory, at.step);
            let views: Vec<View> = looks.par_iter().map(|look| View::new(*look, &claims[look.claim])).collect();
            let mut passed = learner.pass(parts(&views, config.batch_parts), |network, part| pass(network, part, &device))?;
            passed.terms = told(&views, &passed.said);
            for (view, said) in views.iter().zip(passed.said.chunks_exact(OUTPUTS)) {
                memory.note(view.look.claim, view.seen(&Opinion::of(said)));
            }
            let rate = config.optimizer.rate * schedule.factor(at.step, fraction, &length);
            let output = learner.learn(passed, rate, at.step);
            if !output.gradient_norm.is_finite() {
                let what = format!("the second stage's gradient is no number at step {}: try a lower train.refine.optimizer.rate", at.step);
                return Err(TrainError::state(self.run.path(STATE), what));
            }
            if config.ema > 0.0 {
                ema.update(&learner.weights(), at.step);
            }
            let taken = started.elapsed().as_secs_f64();
            at.step += 1;
            at.seconds += taken;
            pass_sums.add(&output, taken);
            let epoch = at.step as f64 / steps_per_epoch;
            if epoch.floor() > ((at.step - 1) as f64 / steps_per_epoch).floor() {
                let row = std::mem::take(&mut pass_sums).row();
                let rate = row.images_per_second * config.batch as f64;
                self.run.log(&format!(
                    "second stage: pass {:.0}: score {:.4}, box {:.4}, frame {:.4}, {rate:.0} claims/s",
                    epoch.floor(),
                    row.loss.objectness,
                    row.loss.center,
                    row.loss.size
                ))?;
            }
            progress(Progress::Refined(StepReport {
                step: at.step,
                total_steps: length.total_steps,
                epoch,
                fraction: length.fraction(at.step, at.seconds),
                loss: output.terms,
                rate,
                images_per_second: config.batch as f64 / taken,
                waiting: 0.0,
                seconds: at.seconds,
                seconds_left: length.seconds_left(at.step, at.seconds),
            }));
        }
    }

    /// Which claims a step looks at, by what is remembered of them, and how, each drawn from (seed, step, place in the batch): where the
    /// detector saw it the first time, later mostly in the frame in which it was seen last.
    fn looks(&self, memory: &mut Memory, step: u64) -> Vec<Look> {
        let config = &self.config.refine;
        let chosen: Vec<_> = (0..config.batch).map(|_| memory.next()).collect();
        let look = |(k, (claim, weight)): (u64, (usize, f32))| {
            let mut rng = Rng::for_item(self.options.seed, "refine/glance", step * config.batch as u64 + k);
            let seen = memory.seen(claim).filter(|_| !rng.chance(BOXED));
            let glance = seen.map(|seen| glance_at(&mut rng, config, &seen.frame)).unwrap_or_else(|| glance(&mut rng, config));
            Look { claim, weight, glance, framed: seen.is_some() }
        };
        (0..).zip(chosen).map(look).collect()
    }

    /// Writes the second stage where it helps on validation images, or where there are none.
    fn keep(
        &self,
        detector: Detector,
        weights: &Weights,
        at: &state::Progress,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<(), TrainError> {
        let mut weights = weights.clone();
        net::move_logits(&mut weights, -self.config.refine.false_cost.ln() as f32);
        let refiner = Refiner::new(&weights, detector.model().boxes)?;
        let path = self.run.path(REFINER);
        let scores = self.validate(detector, refiner)?;
        let words = |scores: &[ValidationScores; 2]| {
            let both = |of: fn(&ValidationScores) -> Option<f64>| {
                let [before, after] = scores.each_ref().map(|s| of(s).map_or("-".into(), |v| format!("{v:.3}")));
                format!("{before} -> {after}")
            };
            format!(
                "AP {}, AP50 {}, mean IoU {}, precision {}, recall {}",
                both(|s| s.ap),
                both(|s| s.ap50),
                both(|s| s.mean_iou),
                both(|s| s.precision),
                both(|s| s.recall)
            )
        };
        let text = scores.as_ref().map_or("no validation images".into(), words);
        self.run.log(&format!("second stage: {} steps, {:.1} s; {text}", at.step, at.seconds))?;
        let helps = scores.as_ref().is_none_or(|[before, after]| {
            let of = |scores| metric(scores, self.config.validate.metric).unwrap_or(0.0);
            of(after) > of(before)
        });
        progress(Progress::SecondStage { words: &text, kept: helps });
        if helps {
            safetensors::write(&path, &net::layers(), &weights)?;
        } else if path.exists() {
            std::fs::remove_file(&path).map_err(|e| TrainError::state(&path, e))?;
        }
        Ok(())
    }

    /// Scores without and with a second stage on the validation images; none where there are none.
    fn validate(&self, detector: Detector, refiner: Refiner) -> Result<Option<[ValidationScores; 2]>, TrainError> {
        let listed = std::fs::metadata(self.dataset.list_path(Split::Val)).is_ok_and(|list| list.len() > 0);
        if !listed {
            return Ok(None);
        }
        let records = claims::thinned(self.dataset, Split::Val, self.config.validate.images)?;
        let config =
            tcross_eval::Config { threshold: self.config.validate.threshold, classes: self.config.classes.clone(), ..Default::default() };
        let score = |refiner: Option<Refiner>| {
            let mut detector = detector.clone();
            detector.refiner = refiner;
            let look = |detector: &mut Detector, record: &Record| {
                let image = picture::read(self.dataset.image_path(record)).ok()?;
                let (width, height) = image.dimensions();
                Some(ImageDetections { image: record.image.clone(), width, height, detections: detector.detect(&image), ms: None })
            };
            let looked: Vec<_> = records.par_iter().map_init(|| detector.clone(), look).collect();
            let (seen, found): (Vec<Record>, Vec<_>) =
                records.iter().zip(looked).filter_map(|(record, found)| Some((record.clone(), found?))).unzip();
            tcross_eval::validate(&seen, &found, self.dataset.header.boxes, &config)
        };
        Ok(Some([score(None), score(Some(refiner))]))
    }
}

/// How a claim is seen where the detector saw it: mirrored, turned over, moved and stretched a little, its colours exchanged.
fn glance(rng: &mut Rng, config: &Refine) -> Glance {
    let half = [0; 2].map(|_| {
        let side = (config.scale * rng.normal()).clamp(-1.0, 1.0).exp() as f32;
        if rng.chance(0.5) { -side } else { side }
    });
    let center = half.map(|half| half * (config.shift * rng.normal()) as f32);
    let axes = if rng.chance(0.5) { [[0.0, half[0]], [half[1], 0.0]] } else { [[half[0], 0.0], [0.0, half[1]]] };
    colored(rng, Glance { center, axes, ..Glance::default() })
}

/// How a frame is seen: turned anyhow, mirrored, moved, stretched and slanted a little, its colours exchanged.
fn glance_at(rng: &mut Rng, config: &Refine, frame: &Frame) -> Glance {
    let (sin, cos) = rng.uniform(0.0, std::f64::consts::TAU).sin_cos();
    let mirror = if rng.chance(0.5) { -1.0 } else { 1.0 };
    let turn = [[cos as f32, (-sin * mirror) as f32], [sin as f32, (cos * mirror) as f32]];
    let jitter = |rng: &mut Rng| (0.5 * config.scale * rng.normal()).clamp(-0.2, 0.2) as f32;
    let slant = [[1.0 + jitter(rng), jitter(rng)], [jitter(rng), 1.0 + jitter(rng)]];
    let at = Glance::at(frame);
    let moved = frame::apply(&at.axes, [0; 2].map(|_| (0.5 * config.shift * rng.normal()) as f32));
    colored(rng, Glance { center: [at.center[0] + moved[0], at.center[1] + moved[1]], ..at.after(&slant).after(&turn) })
}

/// With colours exchanged.
fn colored(rng: &mut Rng, glance: Glance) -> Glance {
    let mut channels = [0, 1, 2];
    rng.shuffle(&mut channels);
    Glance { channels, negative: rng.chance(0.5), ..glance }
}

/// How a claim is looked at.
#[derive(Debug, Clone, Copy)]
struct Look {
    claim: usize,
    /// How many looks this one stands for.
    weight: f32,
    glance: Glance,
    /// Whether it is in the frame in which the claim was seen before.
    framed: bool,
}

/// What the network is shown, and what is to be said of it.
struct View<'a> {
    look: Look,
    claim: &'a Claim,
    pixels: Vec<f32>,
    /// The marker as it is seen; none for no marker.
    truth: Option<Truth>,
}

impl<'a> View<'a> {
    fn new(look: Look, claim: &'a Claim) -> Self {
        let mut pixels = vec![0.0; VIEW];
        look.glance.look(&claim.patch, &mut pixels);
        Self { look, claim, pixels, truth: claim.truth.map(|truth| truth.seen(&look.glance)) }
    }

    /// How many views this one stands for.
    fn weight(&self) -> f32 {
        self.look.weight * self.claim.weight
    }

    fn judge(&self, said: &[f32]) -> loss::ViewLoss {
        loss::judge(said, self.look.framed, self.claim.logit, self.truth).times(self.weight())
    }

    /// What is to be remembered of it.
    fn seen(&self, said: &Opinion) -> Seen {
        let score = 1.0 / (1.0 + (-self.claim.logit - said.logits[usize::from(self.look.framed)]).exp());
        let error = if self.truth.is_some() { 1.0 - score } else { score };
        Seen { frame: self.look.glance.unseen_frame(&said.frame).sound(), error }
    }
}

/// A batch in parts of about the same size.
fn parts<T>(all: &[T], parts: usize) -> Vec<&[T]> {
    (0..parts).map(|k| &all[k * all.len() / parts..(k + 1) * all.len() / parts]).collect()
}

/// Takes views through the network, to the gradient of each of its parameters.
fn pass(network: &RefinerNet, views: &[View], device: &Device) -> Result<Passed, TrainError> {
    let count = views.len();
    let pixels: Vec<f32> = views.iter().flat_map(|view| view.pixels.iter().copied()).collect();
    let outputs = network.forward(Tensor::from_data(TensorData::new(pixels, [count, 3, RINGS, COLUMNS]), device));
    let said = read_logits(&outputs);
    let of_view = |(said, view): (&[f32], &View)| view.judge(said).gradient.map(|g| g / count as f32);
    let gradient = said.chunks_exact(OUTPUTS).zip(views).flat_map(of_view).collect();
    let gradients = parameter_gradients(network, Path::for_device(device), [(outputs, gradient)]);
    Ok(Passed { images: count, terms: LossTerms::default(), said, gradients })
}

/// The loss as it is told: its mean over all claims, that of places over those where there is one to be said.
fn told(views: &[View], said: &[f32]) -> LossTerms {
    let judged: Vec<_> = views.iter().zip(said.chunks_exact(OUTPUTS)).map(|(view, said)| (view, view.judge(said))).collect();
    let mean = |of: fn(&loss::ViewLoss) -> f32, counts: fn(&View) -> bool| {
        let counted = || judged.iter().filter(|(view, _)| counts(view));
        let weight: f64 = counted().map(|(view, _)| f64::from(view.weight())).sum();
        counted().map(|(_, one)| f64::from(of(one))).sum::<f64>() / weight.max(1.0)
    };
    LossTerms {
        objectness: mean(|one| one.score, |_| true),
        center: mean(|one| one.bounds, |view| view.truth.is_some() && !view.look.framed),
        size: mean(|one| one.frame, |view| view.truth.is_some()),
        ..LossTerms::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{fit, toy};
    use std::{fs, sync::atomic::AtomicBool};
    use tcross_yolo::{Architecture, ModelSection, NetSize};

    /// A detector that claims something everywhere, and a second stage for it.
    fn config(epochs: f64) -> Config {
        let refine = Refine { epochs, batch: 32, batch_parts: 2, images: 12, ..Refine::default() };
        Config { steps: Some(2), epochs: None, batch: 4, objectness_bias: -1.0, refine, drawn_batches: 0, ..Config::default() }
    }

    fn model() -> ModelSection {
        ModelSection { architecture: Architecture::YoloV3Tiny, width: 0.0625, input: NetSize::square(64), ..ModelSection::default() }
    }

    /// What a training of the toy says of its second stage, and the files it leaves.
    fn train(
        config: &Config,
        data: &std::path::Path,
        out: &std::path::Path,
        resume: bool,
        stop_at: u64,
    ) -> (End, Option<bool>, Vec<[f64; 3]>) {
        let stop = AtomicBool::new(false);
        let options = RunOptions { resume, ..RunOptions::new(out, 1, &stop) };
        let (mut kept, mut losses) = (None, Vec::new());
        let summary = fit(config, &model(), &Dataset::open(data).unwrap(), &options, &mut |news| match news {
            Progress::Refined(step) => {
                losses.push([step.loss.objectness, step.loss.center, step.loss.size]);
                stop.store(step.step == stop_at, Ordering::Relaxed);
            }
            Progress::SecondStage { kept: helps, .. } => kept = Some(helps),
            _ => {}
        });
        (summary.unwrap().end, kept, losses)
    }

    #[test]
    fn it_learns_helps_and_can_be_stopped_anywhere() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        toy::write(&at("data"), 12, 4, 64).unwrap();
        let (end, kept, losses) = train(&config(30.0), &at("data"), &at("a"), false, u64::MAX);
        for (k, what, share) in [(0, "score", 0.5), (1, "box", 0.7), (2, "frame", 0.7)] {
            // A step without a marker in a box says nothing of boxes.
            let mean = |part: &[[f64; 3]]| {
                let told: Vec<f64> = part.iter().map(|loss| loss[k]).filter(|loss| *loss > 0.0).collect();
                told.iter().sum::<f64>() / told.len() as f64
            };
            let part = losses.len() / 4;
            let (first, last) = (mean(&losses[..part]), mean(&losses[losses.len() - part..]));
            assert!(end == End::Finished && last < share * first, "{what}: {first} -> {last}");
        }
        assert_eq!((kept, at("a").join(REFINER).is_file()), (Some(true), true));

        let half = losses.len() as u64 / 2;
        // With one thread: parts one after another give what they give side by side.
        let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let (end, kept, _) = alone.install(|| train(&config(30.0), &at("data"), &at("b"), false, half));
        assert_eq!((end, kept, at("b").join(REFINER).exists()), (End::Interrupted, None, false));
        let (end, _, rest) = train(&config(30.0), &at("data"), &at("b"), true, u64::MAX);
        assert_eq!((end, rest.len() as u64), (End::Finished, losses.len() as u64 - half));
        assert!(fs::read(at("a").join(REFINER)).unwrap() == fs::read(at("b").join(REFINER)).unwrap(), "the same bits");
        // A finished one is not trained again, but may be lengthened.
        assert!(train(&config(30.0), &at("data"), &at("b"), true, u64::MAX).2.is_empty());
        assert!(!train(&config(30.5), &at("data"), &at("b"), true, u64::MAX).2.is_empty());
    }

    /// Without anything but markers among the claims there is nothing to learn, which is no failure.
    #[test]
    fn claims_of_one_kind_are_said() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        toy::write(&at("data"), 4, 2, 64).unwrap();
        let silent = Config { objectness_bias: -20.0, ..config(1.0) };
        let (end, kept, losses) = train(&silent, &at("data"), &at("run"), false, u64::MAX);
        assert_eq!((end, kept, losses.len(), at("run").join(REFINER).exists()), (End::Finished, None, 0, false));
    }

    #[test]
    fn parts_share_out_all_views() {
        let all: Vec<usize> = (0..8).collect();
        let sizes = |count, n| parts(&all[..count], n).iter().map(|part| part.len()).collect::<Vec<_>>();
        assert_eq!((sizes(8, 1), sizes(8, 2), sizes(7, 3)), (vec![8], vec![4, 4], vec![2, 2, 3]));
        assert_eq!(parts(&all, 3).concat(), all);
    }
}
