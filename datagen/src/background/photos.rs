//! Photos of a folder, dealt to the splits so that no photo stands in two, and cut to the size of an image.
use crate::{config::Config, error::DatagenError};
use fast_image_resize::{FilterType, PixelType, ResizeAlg, ResizeOptions, Resizer, images::ImageRef};
use image::{DynamicImage, ImageDecoder, ImageReader, RgbImage};
use rayon::prelude::*;
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, OnceLock, PoisonError},
};
use tcross_dataset::{
    Rng, Split,
    similar::{self, Look},
};

/// Decoded photos are kept in memory up to this many bytes, so that several crops of one photo decode it once.
const CACHE_BYTES: usize = 768 << 20;

/// A decoded photo is kept no larger than this many times the image it is cut for.
const KEPT_SCALE: u32 = 4;

/// The usable photos of a folder.
#[derive(Debug, Default)]
pub struct Photos {
    dir: PathBuf,
    names: Vec<String>,
    digest: String,
    unreadable: Mutex<BTreeSet<String>>,
    cache: Mutex<Cache>,
    groups: OnceLock<Vec<usize>>,
    dealt: Mutex<Option<((u64, bool), Arc<[Vec<usize>; 3]>)>>,
}

#[derive(Debug, Default)]
struct Cache {
    photos: BTreeMap<usize, Arc<RgbImage>>,
    bytes: usize,
}

/// A part of a photo.
#[derive(Debug)]
pub struct Cut {
    /// The photo.
    pub name: String,
    /// The part of the largest crop that was drawn from the config; a small photo is cut no smaller than the image.
    pub fraction: f64,
    /// `[x, y, width, height]` in its pixels (of the reduced copy where it is huge).
    pub crop: [f64; 4],
    /// Whether it was mirrored afterwards.
    pub mirrored: bool,
    /// The picture.
    pub image: RgbImage,
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
        Ok(Self { dir: dir.to_owned(), names, digest, unreadable: Mutex::new(unreadable), ..Self::default() })
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

    /// Groups of photos that show nearly the same, each with more than one; known once the photos were looked at.
    #[must_use]
    pub fn near_duplicates(&self) -> Vec<Vec<String>> {
        let mut groups: BTreeMap<usize, Vec<String>> = BTreeMap::new();
        for (photo, first) in self.groups.get().into_iter().flatten().enumerate() {
            groups.entry(*first).or_default().push(self.names[photo].clone());
        }
        groups.into_values().filter(|g| g.len() > 1).collect()
    }

    /// Looks at every photo once, on all threads of the current pool, to find those that show nearly the same. Without it the first
    /// [`Photos::cut`] does the same on one thread.
    pub fn look_at_all(&self, config: &Config) {
        if config.background.near_duplicates_together && self.groups.get().is_none() {
            let looks: Vec<Option<Look>> = (0..self.names.len()).into_par_iter().map(|photo| self.look(photo, size(config))).collect();
            // Another thread may have been faster: it found the same.
            let _ = self.groups.set(similar::groups(&looks));
        }
    }

    fn look(&self, photo: usize, target: (u32, u32)) -> Option<Look> {
        self.load(photo, target, Some(Look::of)).map(|found| found.1)?
    }

    /// The photos of train, val and test: groups of near-duplicates are shuffled by the seed and their photos dealt by place mod 10 like the
    /// images themselves, each group to the split of its first. Where that leaves a split empty, the last groups go to validation and test.
    fn dealt(&self, config: &Config, seed: u64) -> Arc<[Vec<usize>; 3]> {
        let mut dealt = self.dealt.lock().unwrap_or_else(PoisonError::into_inner);
        let key = (seed, config.background.near_duplicates_together);
        if let Some((_, splits)) = dealt.as_ref().filter(|d| d.0 == key) {
            return Arc::clone(splits);
        }
        let alone: Vec<usize> = (0..self.names.len()).collect();
        let first = if key.1 {
            self.groups.get_or_init(|| similar::groups(&alone.iter().map(|photo| self.look(*photo, size(config))).collect::<Vec<_>>()))
        } else {
            &alone
        };
        let mut groups: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        first.iter().enumerate().for_each(|(photo, first)| groups.entry(*first).or_default().push(photo));
        // With fewer than three different photos there is no way to keep them apart.
        let mut groups: Vec<Vec<usize>> =
            if groups.len() < 3 { alone.iter().map(|photo| vec![*photo]).collect() } else { groups.into_values().collect() };
        Rng::for_item(seed, "datagen/photos", 0).shuffle(&mut groups);
        let splits = Arc::new(deal(&groups));
        *dealt = Some((key, Arc::clone(&splits)));
        splits
    }

    /// The crop for image `index`. A photo that cannot be decoded
    /// gives its place to the next one of its split.
    ///
    /// # Errors
    /// If no photo of the split can be decoded.
    pub fn cut(&self, config: &Config, seed: u64, index: u64) -> Result<Cut, DatagenError> {
        let (tens, place) = ((index / 10) as usize, (index % 10) as usize);
        let split = Split::of(place);
        let rank = match split {
            Split::Train => tens * 7 + place,
            Split::Val => tens * 2 + place - 7,
            Split::Test => tens,
        };
        let (name, photo) = self.whole(config, seed, split, rank)?;
        let mut rng = Rng::for_item(seed, "datagen/crop", index);
        let fraction = config.background.crop.sample(&mut rng);
        let (crop, mut image) = crop(&photo, size(config), fraction, &mut rng);
        let mirrored = rng.chance(config.background.mirrored);
        if mirrored {
            image::imageops::flip_horizontal_in_place(&mut image);
        }
        Ok(Cut { name, fraction, crop, mirrored, image })
    }

    /// The whole photo behind video `sequence`, no larger than `width` by `height` asks for.
    ///
    /// # Errors
    /// If no photo of the video's split can be decoded.
    pub fn panorama(
        &self,
        config: &Config,
        seed: u64,
        sequence: u64,
        [width, height]: [u32; 2],
    ) -> Result<(String, RgbImage), DatagenError> {
        // The split of the video's first image.
        let first = (u128::from(sequence) * u128::from(config.images)).div_ceil(u128::from(config.video.sequences.max(1))) as u64;
        let (name, photo) = self.whole(config, seed, config.split_of(first), sequence as usize)?;
        let shrink = (f64::from(width) / f64::from(photo.width())).max(f64::from(height) / f64::from(photo.height()));
        if shrink >= 1.0 {
            return Ok((name, photo.as_ref().clone()));
        }
        let size = |v: u32| ((f64::from(v) * shrink).round() as u32).max(1);
        let whole = [0.0, 0.0, f64::from(photo.width()), f64::from(photo.height())];
        Ok((name, resized(&photo, whole, size(photo.width()), size(photo.height()))))
    }

    /// A whole photo of a split by its place there; one that cannot be decoded gives its place to the next.
    fn whole(&self, config: &Config, seed: u64, split: Split, rank: usize) -> Result<(String, Arc<RgbImage>), DatagenError> {
        let dealt = self.dealt(config, seed);
        let photos = &dealt[split as usize];
        for step in 0..photos.len() {
            let photo = photos[(rank + step) % photos.len()];
            if let Some(decoded) = self.decoded(photo, size(config)) {
                return Ok((self.names[photo].clone(), decoded));
            }
        }
        let skipped = self.skipped().len();
        Err(DatagenError::NoPhotos { dir: self.dir.clone(), found: 0, skipped, needed: 1 })
    }

    fn decoded(&self, photo: usize, target: (u32, u32)) -> Option<Arc<RgbImage>> {
        let kept = self.cache.lock().unwrap_or_else(PoisonError::into_inner).photos.get(&photo).map(Arc::clone);
        kept.or_else(|| self.load(photo, target, None).map(|found| found.0))
    }

    /// Decodes a photo, looks at it, and keeps it no larger than `target` asks for while there is room.
    fn load(&self, photo: usize, target: (u32, u32), look: Option<fn(&RgbImage) -> Look>) -> Option<(Arc<RgbImage>, Option<Look>)> {
        let Some(image) = decode(&self.dir.join(&self.names[photo])) else {
            self.unreadable.lock().unwrap_or_else(PoisonError::into_inner).insert(self.names[photo].clone());
            return None;
        };
        let look = look.map(|look| look(&image));
        let image = Arc::new(reduced(image, target));
        let mut cache = self.cache.lock().unwrap_or_else(PoisonError::into_inner);
        if cache.bytes + image.as_raw().len() <= CACHE_BYTES && !cache.photos.contains_key(&photo) {
            cache.bytes += image.as_raw().len();
            cache.photos.insert(photo, Arc::clone(&image));
        }
        Some((image, look))
    }
}

/// What is asked for is one size a dataset.
fn size(config: &Config) -> (u32, u32) {
    (config.width, config.height)
}

/// Deals groups to train, val and test.
fn deal(groups: &[Vec<usize>]) -> [Vec<usize>; 3] {
    let mut splits: [Vec<usize>; 3] = Default::default();
    let mut place = 0;
    for group in groups {
        splits[Split::of(place) as usize].extend(group);
        place += group.len();
    }
    if splits.iter().any(Vec::is_empty) {
        splits = Default::default();
        for (k, group) in groups.iter().enumerate() {
            let split = [Split::Test, Split::Val].get(groups.len() - 1 - k).copied().unwrap_or(Split::Train);
            splits[split as usize].extend(group);
        }
    }
    splits
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
    let mut target = DynamicImage::ImageRgb8(RgbImage::new(width, height));
    // Both pictures are RGB of 8 bits and the crop lies inside, which is all that can be refused.
    let source = ImageRef::new(photo.width(), photo.height(), photo.as_raw(), PixelType::U8x3);
    let done = source.map(|source| Resizer::new().resize(&source, &mut target, Some(&options)));
    debug_assert!(matches!(done, Ok(Ok(()))), "{done:?}");
    target.into_rgb8()
}
