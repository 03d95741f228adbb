//! What a training leaves on disk: weights, state, numbers, curves and pictures.
pub mod curves;
pub mod draw;
pub mod history;
pub mod state;
pub mod tensorboard;

use crate::error::TrainError;
use history::History;
use std::{
    fs::OpenOptions,
    io::Write,
    path::{Path, PathBuf},
};
use tcross_dataset::{DatasetError, files};
use tcross_yolo::{ModelConfig, Weights, weights::safetensors};
use tensorboard::EventFile;

/// The folder of a run.
pub struct RunDir {
    dir: PathBuf,
    events: EventFile,
}

impl RunDir {
    /// Opens the folder, with event files that start at `step`.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn open(dir: &Path, step: u64) -> Result<Self, TrainError> {
        for part in ["", "state", "curves", "batches"] {
            files::create_dir(dir.join(part))?;
        }
        Ok(Self { dir: dir.to_owned(), events: EventFile::create(dir, step)? })
    }

    /// True where the folder holds a run already.
    #[must_use]
    pub fn is_taken(dir: &Path) -> bool {
        ["metrics.csv", "last.safetensors", "state/state.safetensors"].iter().any(|name| dir.join(name).exists())
    }

    /// A file or folder of the run.
    #[must_use]
    pub fn path(&self, name: &str) -> PathBuf {
        self.dir.join(name)
    }

    /// Writes a text file.
    ///
    /// # Errors
    /// If the folder cannot be written.
    pub fn write(&self, name: &str, text: &str) -> Result<(), TrainError> {
        Ok(files::write_atomically(self.path(name), text)?)
    }

    /// Writes weights beside `model.toml`.
    ///
    /// # Errors
    /// If the folder cannot be written.
    pub fn write_weights(&self, name: &str, model: &ModelConfig, weights: &Weights) -> Result<(), TrainError> {
        Ok(safetensors::write(self.path(name), &model.graph()?, weights)?)
    }

    /// Writes a picture as JPEG.
    ///
    /// # Errors
    /// If the folder cannot be written.
    pub fn write_picture(&self, name: &str, picture: &image::RgbImage) -> Result<PathBuf, TrainError> {
        let path = self.path(name);
        let mut bytes = Vec::new();
        let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 88);
        picture.write_with_encoder(encoder).map_err(|e| DatasetError::Image { path: path.clone(), message: e.to_string() })?;
        files::write_atomically(&path, bytes)?;
        Ok(path)
    }

    /// Adds a line to `log.txt`.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn log(&self, line: &str) -> Result<(), TrainError> {
        let path = self.path("log.txt");
        let append = || writeln!(OpenOptions::new().create(true).append(true).open(&path)?, "{line}");
        append().map_err(|e| DatasetError::io(&path, e).into())
    }

    /// Writes numbers as TensorBoard scalars. `seconds` is the training's own clock.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn scalars(&mut self, step: u64, seconds: f64, values: &[(String, f64)]) -> Result<(), TrainError> {
        Ok(self.events.scalars(step, seconds, values)?)
    }

    /// Writes `metrics.csv` and the curves.
    ///
    /// # Errors
    /// If the folder cannot be written.
    pub fn write_history(&self, history: &History) -> Result<(), TrainError> {
        self.write("metrics.csv", &history.to_csv())?;
        curves::plots(history).iter().try_for_each(|(name, plot)| self.write(&format!("curves/{name}.svg"), &plot.svg()))
    }
}
