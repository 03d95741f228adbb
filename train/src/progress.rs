//! What a training tells while it runs.
use crate::{memory::Estimate, run::history::Row};
use tcross_yolo::LossTerms;

/// News of a training.
#[derive(Debug)]
pub enum Progress<'a> {
    /// The data is open and the network is built.
    Opened {
        /// Images in an epoch.
        train: usize,
        /// Validation images.
        val: usize,
        /// `[width, height]` in net-input pixels.
        anchors: &'a [[f32; 2]],
        /// Mean IoU of the training boxes with their best anchor, where they were found by k-means.
        anchor_iou: Option<f64>,
        /// Of the network.
        parameters: usize,
        /// What it will need.
        memory: &'a Estimate,
        /// Where the weights come from; none after a resume.
        weights: Option<&'a str>,
        /// The step that training starts from: above 0 after a resume.
        step: u64,
    },
    /// A step is done.
    Step(StepReport),
    /// Validation starts.
    Validating {
        /// Images that it looks at.
        images: usize,
    },
    /// A row of `metrics.csv` is complete; `best` if its weights are the best so far.
    Epoch {
        /// The row.
        row: &'a Row,
        /// Whether the metric is the highest so far.
        best: bool,
    },
    /// The finished detector looks at the training images, for the second stage to learn from.
    Claims {
        /// Images done.
        done: usize,
        /// All images.
        of: usize,
    },
    /// A step of the second stage is done; its images are claims.
    Refined(StepReport),
    /// The second stage is trained.
    SecondStage {
        /// Validation scores without it and with it.
        words: &'a str,
        /// Whether it helps, and is kept.
        kept: bool,
    },
    /// Something that is no failure, naming its file.
    Warning(&'a str),
}

/// One step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepReport {
    /// Steps taken.
    pub step: u64,
    /// Where the number of steps is known beforehand.
    pub total_steps: Option<u64>,
    /// Passes over the training images so far.
    pub epoch: f64,
    /// Share of the training that is done, 0..=1.
    pub fraction: f64,
    /// The parts of the loss.
    pub loss: LossTerms,
    /// Learning rate.
    pub rate: f64,
    /// Of this step alone.
    pub images_per_second: f64,
    /// Share of the step's time that was spent waiting for its batch.
    pub waiting: f64,
    /// Seconds of training so far.
    pub seconds: f64,
    /// Seconds still to go, from the pace so far.
    pub seconds_left: Option<f64>,
}
