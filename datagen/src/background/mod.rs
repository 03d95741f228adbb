//! What stands behind the markers: crops of photos, or embedded scenes that need no file.
use crate::{
    canvas::Canvas,
    config::Config,
    error::DatagenError,
    hand::video::{BEYOND, Moment},
};
use image::RgbImage;
use serde_json::{Map, Value};
use std::path::Path;
use tcross_dataset::Rng;

pub mod embedded;
pub mod photos;

use photos::{Cut, Photos};

/// Where backgrounds come from.
#[derive(Debug)]
pub enum Backgrounds {
    /// Scenes drawn by the program.
    Embedded,
    /// Photos of a folder.
    Photos(Box<Photos>),
}

/// One background, cut to the size of an image.
#[derive(Debug)]
pub struct Backdrop {
    /// The photo's path, or `embedded/<kind>`.
    pub name: String,
    /// How it was cut.
    pub effects: Map<String, Value>,
    picture: Picture,
}

#[derive(Debug)]
enum Picture {
    Stored(RgbImage),
    Light(Canvas),
}

impl Backdrop {
    /// As stored numbers.
    #[must_use]
    pub fn into_image(self) -> RgbImage {
        match self.picture {
            Picture::Stored(image) => image,
            Picture::Light(canvas) => canvas.to_image(),
        }
    }

    /// As light.
    #[must_use]
    pub fn into_canvas(self) -> Canvas {
        match self.picture {
            Picture::Stored(image) => Canvas::from_image(&image),
            Picture::Light(canvas) => canvas,
        }
    }
}

impl Backgrounds {
    /// The scenes that need no file.
    #[must_use]
    pub fn embedded() -> Self {
        Self::Embedded
    }

    /// The photos of a folder and all below it.
    ///
    /// # Errors
    /// If the folder cannot be read or holds fewer than three usable photos.
    pub fn open(dir: impl AsRef<Path>) -> Result<Self, DatagenError> {
        Photos::open(dir.as_ref()).map(|photos| Self::Photos(Box::new(photos)))
    }

    /// `embedded` or `photos`.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Embedded => "embedded",
            Self::Photos(_) => "photos",
        }
    }

    /// Number of photos; 0 for embedded scenes, which are made anew for every image.
    #[must_use]
    pub fn count(&self) -> usize {
        match self {
            Self::Embedded => 0,
            Self::Photos(photos) => photos.count(),
        }
    }

    /// Names, sizes and first 64 KiB of the photos, or the version of the embedded scenes, in one word.
    #[must_use]
    pub fn digest(&self) -> String {
        match self {
            Self::Embedded => format!("embedded-{}", embedded::VERSION),
            Self::Photos(photos) => photos.digest().to_owned(),
        }
    }

    /// Photos that could not be used so far, by name, sorted.
    #[must_use]
    pub fn skipped(&self) -> Vec<String> {
        match self {
            Self::Embedded => Vec::new(),
            Self::Photos(photos) => photos.skipped(),
        }
    }

    /// Does on all threads what the first background of a dataset would do on one.
    pub fn prepare(&self, config: &Config) {
        if let Self::Photos(photos) = self {
            photos.look_at_all(config);
        }
    }

    /// Groups of photos that show nearly the same and therefore stand in one split.
    #[must_use]
    pub fn near_duplicates(&self) -> Vec<Vec<String>> {
        match self {
            Self::Embedded => Vec::new(),
            Self::Photos(photos) => photos.near_duplicates(),
        }
    }

    /// The background of image `index`.
    ///
    /// # Errors
    /// If every photo of the image's split is unreadable.
    pub fn backdrop(&self, config: &Config, seed: u64, index: u64) -> Result<Backdrop, DatagenError> {
        match self {
            Self::Embedded => {
                let (name, canvas) = embedded::paint(config, &mut Rng::for_item(seed, "datagen/scene", index));
                Ok(Backdrop { name, effects: Map::new(), picture: Picture::Light(canvas) })
            }
            Self::Photos(photos) => {
                let Cut { name, fraction, crop, mirrored, image } = photos.cut(config, seed, index)?;
                let mut effects = Map::new();
                effects.insert("crop".into(), serde_json::json!(crop));
                effects.insert("mirrored".into(), mirrored.into());
                effects.insert("asked".into(), serde_json::json!({ "crop": (fraction * 1e4).round() / 1e4 }));
                Ok(Backdrop { name, effects, picture: Picture::Stored(image) })
            }
        }
    }

    /// What lies around the frame of a video: a whole photo, or a scene larger than the frame.
    ///
    /// # Errors
    /// If every photo of the video's split is unreadable.
    pub fn panorama(&self, config: &Config, seed: u64, moment: &Moment) -> Result<Backdrop, DatagenError> {
        let size = [config.width, config.height].map(|v| (f64::from(v) * BEYOND) as u32);
        match self {
            Self::Embedded => {
                let larger = Config { width: size[0], height: size[1], ..config.clone() };
                let (name, canvas) = embedded::paint(&larger, &mut Rng::for_item(seed, "datagen/panorama", moment.sequence));
                Ok(Backdrop { name, effects: Map::new(), picture: Picture::Light(canvas) })
            }
            Self::Photos(photos) => {
                let (name, photo) = photos.panorama(config, seed, moment.sequence, size)?;
                Ok(Backdrop { name, effects: Map::new(), picture: Picture::Stored(photo) })
            }
        }
    }
}
