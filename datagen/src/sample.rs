//! Image k of a dataset: a pure function of config, seed, backgrounds and k.
use crate::{
    background::Backgrounds,
    config::{Config, Style},
    error::DatagenError,
    hand::{self, video::Moment},
    paper,
};
use image::RgbImage;
use tcross_dataset::{Record, Rng};

/// One image, its truth, and the quality to store it with.
#[derive(Debug)]
pub struct Sample {
    /// The picture.
    pub image: RgbImage,
    /// Its truth.
    pub record: Record,
    /// JPEG quality, 1..=100.
    pub quality: u8,
}

/// Makes image `index`.
///
/// # Errors
/// If no background can be read.
pub fn sample(config: &Config, backgrounds: &Backgrounds, seed: u64, index: u64) -> Result<Sample, DatagenError> {
    let moment = Moment::of(&config.video, config.images, index);
    let backdrop = match &moment {
        Some(moment) => backgrounds.panorama(config, seed, moment)?,
        None => backgrounds.backdrop(config, seed, index)?,
    };
    let quality = config.jpeg_quality.sample(&mut Rng::for_item(seed, "datagen/jpeg", index)).round() as u8;
    let mut record = Record {
        image: format!("{}/{index:05}.jpg", config.split_of(index)),
        width: config.width,
        height: config.height,
        background: Some(backdrop.name.clone()),
        markers: Vec::new(),
        confusers: Vec::new(),
        intrinsics: None,
        distortion: None,
        effects: backdrop.effects.clone(),
    };
    record.effects.insert("jpeg_quality".into(), quality.into());
    let image = match config.style {
        Style::Paper => {
            let mut image = backdrop.into_image();
            record.markers.push(paper::draw(&mut image, &config.paper, &mut Rng::for_item(seed, "datagen/paper", index)));
            image
        }
        Style::HandDrawn => hand::draw(backdrop.into_canvas(), config, seed, index, moment, &mut record),
    };
    Ok(Sample { image, record, quality })
}
