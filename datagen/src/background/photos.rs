//! Photos of a folder, dealt to the splits so that no photo stands in two, and cut to the size of an image.
use crate::{config::Config, error::DatagenError};
use fast_image_resize::{FilterType, ResizeAlg, ResizeOptions, Resizer};
use image::{DynamicImage, ImageDecoder, ImageReader, RgbImage};
use rayon::prelude::*;
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};
use tcross_dataset::{Rng, Split};

/// Decoded photos are kept in memory up to this many bytes, so that several crops of one photo decode it once.
const CACHE_BYTES: usize = 768 << 20;

/// A decoded photo is kept no larger than this many times the image it is cut for.
const KEPT_SCALE: u32 = 4;

/// The usable photos of a folder.
#[derive(Debug)]
pub struct Photos {
    dir: PathBuf,
    names: Vec<String>,
    digest: String,
    unreadable: Mutex<BTreeSet<String>>,
    cache: Mutex<Cache>,
}

#[derive(Debug, Default)]
struct Cache {
    photos: BTreeMap<usize, Arc<RgbImage>>,
    bytes: usize,
}

impl Photos {
    /// Lists every JPEG, PNG and WebP below `dir` in order of name, and passes over those whose header cannot be read.
    ///
    /// # Errors
    /// If a folder cannot be read, or fewer than three photos are usable (each split needs one).
    pub fn open(dir: &Path) -> Result<Self, DatagenError> {
        let mut files = Vec::new();
        list(dir, dir, &mut files)?;
        files.sort();
        let headers: Vec<Option<blake3::Hash>> = files.par_iter().map(|name| header(&dir.join(name))).collect();
        let mut hasher = blake3::Hasher::new();
        let (mut names, mut unreadable) = (Vec::new(), BTreeSet::new());
        for (name, header) in files.into_iter().zip(headers) {
            match header {
                Some(hash) => {
                    hasher.update(name.as_bytes()).update(hash.as_bytes());
                    names.push(name);
                }
                None => _ = unreadable.insert(name),
            }
        }
        if names.len() < 3 {
            return Err(DatagenError::NoPhotos { dir: dir.to_owned(), found: names.len(), skipped: unreadable.len(), needed: 3 });
        }
        let digest = hasher.finalize().to_hex().to_string();
        Ok(Self { dir: dir.to_owned(), names, digest, unreadable: Mutex::new(unreadable), cache: Mutex::default() })
    }

    /// Number of photos whose header could be read.
    #[must_use]
    pub fn count(&self) -> usize {
        self.names.len()
    }

    /// Of names, lengths and the first 64 KiB of every photo.
    #[must_use]
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// Names of the photos that could not be used so far.
    #[must_use]
    pub fn skipped(&self) -> Vec<String> {
        self.unreadable.lock().unwrap_or_else(PoisonError::into_inner).iter().cloned().collect()
    }

    /// The photos of a split: shuffled by the seed, then dealt by place mod 10 like the images themselves. With fewer than ten photos the
    /// last ones go to validation and test, so that no split is empty.
    #[must_use]
    pub fn of_split(&self, seed: u64, split: Split) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.names.len()).collect();
        Rng::for_item(seed, "datagen/photos", 0).shuffle(&mut order);
        let n = order.len();
        let of = |place: usize| {
            if n < 10 { [Split::Test, Split::Val].get(n - 1 - place).copied().unwrap_or(Split::Train) } else { Split::of(place) }
        };
        order.into_iter().enumerate().filter(|(place, _)| of(*place) == split).map(|(_, photo)| photo).collect()
    }

    /// The crop for image `index`: the photo's name, `[x, y, width, height]` in its pixels, and the picture. A photo that cannot be decoded
    /// gives its place to the next one of its split.
    ///
    /// # Errors
    /// If no photo of the split can be decoded.
    pub fn cut(&self, config: &Config, seed: u64, index: u64) -> Result<(String, [f64; 4], RgbImage), DatagenError> {
        let photos = self.of_split(seed, Split::of(index as usize));
        let (tens, place) = ((index / 10) as usize, (index % 10) as usize);
        let rank = match Split::of(place) {
            Split::Train => tens * 7 + place,
            Split::Val => tens * 2 + place - 7,
            Split::Test => tens,
        };
        let target = (config.width, config.height);
        for step in 0..photos.len() {
            let photo = photos[(rank + step) % photos.len()];
            if let Some(decoded) = self.decoded(photo, target) {
                let mut rng = Rng::for_item(seed, "datagen/crop", index);
                let (crop, mut image) = crop(&decoded, target, config.background.crop.sample(&mut rng), &mut rng);
                if rng.chance(config.background.mirrored) {
                    image::imageops::flip_horizontal_in_place(&mut image);
                }
                return Ok((self.names[photo].clone(), crop, image));
            }
        }
        let skipped = self.skipped().len();
        Err(DatagenError::NoPhotos { dir: self.dir.clone(), found: 0, skipped, needed: 1 })
    }

    fn decoded(&self, photo: usize, target: (u32, u32)) -> Option<Arc<RgbImage>> {
        let lock = |m| Mutex::lock(m).unwrap_or_else(PoisonError::into_inner);
        if let Some(kept) = lock(&self.cache).photos.get(&photo) {
            return Some(Arc::clone(kept));
        }
        let Some(image) = decode(&self.dir.join(&self.names[photo])) else {
            self.unreadable.lock().unwrap_or_else(PoisonError::into_inner).insert(self.names[photo].clone());
            return None;
        };
        let image = Arc::new(reduced(image, target));
        let mut cache = lock(&self.cache);
        if cache.bytes + image.as_raw().len() <= CACHE_BYTES && !cache.photos.contains_key(&photo) {
            cache.bytes += image.as_raw().len();
            cache.photos.insert(photo, Arc::clone(&image));
        }
        Some(image)
    }
}

fn list(root: &Path, dir: &Path, files: &mut Vec<String>) -> Result<(), DatagenError> {
    for entry in fs::read_dir(dir).map_err(|e| DatagenError::io(dir, e))? {
        let path = entry.map_err(|e| DatagenError::io(dir, e))?.path();
        if path.is_dir() {
            list(root, &path, files)?;
        } else if path.extension().is_some_and(|e| ["jpg", "jpeg", "png", "webp"].iter().any(|k| e.eq_ignore_ascii_case(k))) {
            let relative = path.strip_prefix(root).unwrap_or(&path);
            files.push(relative.components().map(|c| c.as_os_str().to_string_lossy()).collect::<Vec<_>>().join("/"));
        }
    }
    Ok(())
}

/// A digest of a photo's length and first 64 KiB; `None` where its header says that there is no picture.
fn header(path: &Path) -> Option<blake3::Hash> {
    use std::io::Read;
    let length = fs::metadata(path).ok()?.len();
    let mut head = Vec::new();
    fs::File::open(path).ok()?.take(1 << 16).read_to_end(&mut head).ok()?;
    let (width, height) = ImageReader::open(path).ok()?.with_guessed_format().ok()?.into_dimensions().ok()?;
    (width > 0 && height > 0).then(|| blake3::Hasher::new().update(&length.to_le_bytes()).update(&head).finalize())
}

/// The picture as one should see it: turned as its EXIF says, 8 bits, red green blue.
fn decode(path: &Path) -> Option<RgbImage> {
    let mut decoder = ImageReader::open(path).ok()?.with_guessed_format().ok()?.into_decoder().ok()?;
    let orientation = decoder.orientation().ok()?;
    let mut image = DynamicImage::from_decoder(decoder).ok()?;
    image.apply_orientation(orientation);
    Some(image.into_rgb8()).filter(|i| i.width() > 0 && i.height() > 0)
}

/// A huge photo made smaller before it is kept.
fn reduced(image: RgbImage, (width, height): (u32, u32)) -> RgbImage {
    let shrink = (f64::from(width * KEPT_SCALE) / f64::from(image.width())).max(f64::from(height * KEPT_SCALE) / f64::from(image.height()));
    if shrink >= 1.0 {
        return image;
    }
    let size = |v: u32| ((f64::from(v) * shrink).round() as u32).max(1);
    let (w, h) = (size(image.width()), size(image.height()));
    resized(&image, [0.0, 0.0, f64::from(image.width()), f64::from(image.height())], w, h)
}

/// A random crop of the target's shape, and where it was taken.
fn crop(photo: &RgbImage, (width, height): (u32, u32), fraction: f64, rng: &mut Rng) -> ([f64; 4], RgbImage) {
    let (w, h) = (f64::from(photo.width()), f64::from(photo.height()));
    let largest = (w / f64::from(width)).min(h / f64::from(height));
    let scale = (largest * fraction).max(largest.min(1.0));
    let (cw, ch) = ((f64::from(width) * scale).min(w).round().max(1.0), (f64::from(height) * scale).min(h).round().max(1.0));
    let place = |room: f64, rng: &mut Rng| rng.int(0, room.max(0.0) as i64) as f64;
    let rect = [place(w - cw, rng), place(h - ch, rng), cw, ch];
    (rect, resized(photo, rect, width, height))
}

/// Box filter when shrinking (OpenCV's `INTER_AREA`), bilinear when enlarging.
fn resized(photo: &RgbImage, [x, y, w, h]: [f64; 4], width: u32, height: u32) -> RgbImage {
    let filter = if w > f64::from(width) { FilterType::Box } else { FilterType::Bilinear };
    let options = ResizeOptions::new().crop(x, y, w, h).resize_alg(ResizeAlg::Convolution(filter));
    let mut out = RgbImage::new(width, height);
    let source = DynamicImage::ImageRgb8(photo.clone());
    let mut target = DynamicImage::ImageRgb8(out);
    // Both pictures are RGB of 8 bits and the crop lies inside, which is all that can be refused.
    let done = Resizer::new().resize(&source, &mut target, Some(&options));
    debug_assert!(done.is_ok(), "{done:?}");
    out = target.into_rgb8();
    out
}
