//! A JPEG encoder for the one kind of file that datasets hold: baseline, colour at half resolution, the standard's Huffman codes.
//!
//! Strips of sixteen lines become luma and chroma ([`strip`]), eight blocks at a time are transformed and quantised ([`transform`]), and the
//! coefficients that are not zero, found with a mask of bits, become codes ([`entropy`]). Everything is integers and safe code, compiled for the
//! machine's widest vectors, so that a picture has the same bytes on every machine: those of the plain code of the crate `jpeg-encoder`
//! 0.7.1, to which the tests hold it. (With that crate's feature `simd` bytes depend on the machine: its AVX2 code rounds some coefficients
//! another way.)
mod entropy;
mod strip;
mod tables;
mod transform;

use entropy::{BitWriter, Codes};
use image::RgbImage;
use strip::{LINES, Strip};
use tables::{AC, Code, DC, ZIGZAG};
use tcross_kernels::simd::{Portable, widest};
use transform::{BLOCKS, Group, Quantiser};

/// The largest width or height of a JPEG file.
pub const LARGEST: u32 = 65535;

/// The picture as a JPEG file at a quality of 1 to 100 (the IJG's scale); `None` where it is empty or larger than [`LARGEST`].
#[must_use]
pub fn encode(image: &RgbImage, quality: u8) -> Option<Vec<u8>> {
    Some(widest(Scan::of(image, quality)?))
}

/// All before the first coefficient.
fn write_head(file: &mut Vec<u8>, width: u16, height: u16, quantisers: &[Quantiser; 2]) {
    file.extend([0xff, 0xd8]);
    let mut segment = |marker: u8, parts: &[&[u8]]| {
        let length = 2 + parts.iter().map(|part| part.len()).sum::<usize>() as u16;
        file.extend([0xff, marker]);
        file.extend(length.to_be_bytes());
        parts.iter().for_each(|part| file.extend_from_slice(part));
    };
    // JFIF 1.2, square pixels, no thumbnail.
    segment(0xe0, &[b"JFIF\0", &[1, 2, 0, 0, 1, 0, 1, 0, 0]]);
    // Of 8 bits; three components: number, samples across and down in a unit of 16 x 16 pixels, table of divisors.
    segment(0xc0, &[&[8], &height.to_be_bytes(), &width.to_be_bytes(), &[3, 0, 0x22, 0, 1, 0x11, 1, 2, 0x11, 1]]);
    for (number, quantiser) in (0..).zip(quantisers) {
        segment(0xdb, &[&[number], &ZIGZAG.map(|place| quantiser.divisors[usize::from(place)])]);
    }
    for number in 0..2 {
        for (kind, Code { lengths, symbols }) in [(0, &DC[number]), (0x10, &AC[number])] {
            segment(0xc4, &[&[kind | number as u8], lengths, symbols]);
        }
    }
    // One scan of all components, each with its codes, of all coefficients.
    segment(0xda, &[&[3, 0, 0, 1, 0x11, 2, 0x11, 0, 63, 0]]);
}

/// All coefficients of a picture, on their way to the file.
struct Scan<'a> {
    rgb: &'a [u8],
    width: usize,
    quantisers: [Quantiser; 2],
    /// Its head.
    file: Vec<u8>,
}

impl<'a> Scan<'a> {
    fn of(image: &'a RgbImage, quality: u8) -> Option<Self> {
        let sides = [image.width(), image.height()].map(|side| u16::try_from(side).ok().filter(|side| *side > 0));
        let [Some(width), Some(height)] = sides else { return None };
        let quantisers = [0, 1].map(|component| Quantiser::new(component, quality));
        let mut file = Vec::with_capacity(1 << 16);
        write_head(&mut file, width, height, &quantisers);
        Some(Self { rgb: image.as_raw(), width: width.into(), quantisers, file })
    }
}

impl Portable for Scan<'_> {
    /// The whole file.
    type Output = Vec<u8>;

    /// Writes them unit by unit of 16 x 16 pixels: four blocks of luma, one of blue, one of red.
    #[inline(always)]
    fn run(self) -> Vec<u8> {
        let Self { rgb, width, quantisers, mut file } = self;
        let height = rgb.len() / (3 * width);
        let units = width.div_ceil(LINES);
        let mut strip = Strip::new(width, 8 * BLOCKS);
        let mut rows: [Vec<Group>; 3] = std::array::from_fn(|_| (0..strip.stride / (8 * BLOCKS)).map(|_| Group::new()).collect());
        let codes = [0, 1].map(Codes::new);
        let mut writer = BitWriter::new(6 * units);
        let mut last = [0; 3];
        for first in (0..height).step_by(LINES) {
            strip.fill(rgb, width, first);
            for ((samples, groups), quantiser) in strip.block_rows().zip(&mut rows).zip([&quantisers[0], &quantisers[0], &quantisers[1]]) {
                for (k, group) in groups.iter_mut().enumerate() {
                    group.transform(&samples[k * 8 * BLOCKS..], strip.stride, quantiser);
                }
            }
            for unit in 0..units {
                let luma = [(0, 2 * unit), (0, 2 * unit + 1), (1, 2 * unit), (1, 2 * unit + 1)].map(|place| (place, 0));
                let chroma = [((2, unit), 1), ((2, units + unit), 2)];
                for ((row, block), component) in luma.into_iter().chain(chroma) {
                    let group = &rows[row][block / BLOCKS];
                    writer.put_block(group, block % BLOCKS, &mut last[component], &codes[component.min(1)]);
                }
            }
            writer.flush(&mut file);
        }
        writer.finish(&mut file);
        file.extend([0xff, 0xd9]);
        file
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
    use proptest::prelude::*;
    use tcross_dataset::Rng;
    use tcross_kernels::simd::at_each_width;

    /// What the crate `jpeg-encoder` makes of the picture.
    fn judge(image: &RgbImage, quality: u8) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(&mut bytes, quality);
        encoder.set_sampling_factor(SamplingFactor::F_2_2);
        encoder.encode(image.as_raw(), image.width() as u16, image.height() as u16, ColorType::Rgb).unwrap();
        bytes
    }

    /// Smooth colours with some noise, which no two blocks share.
    fn picture(width: u32, height: u32, noise: f64, seed: u64) -> RgbImage {
        let mut rng = Rng::for_item(seed, "test/jpeg", 0);
        let [a, b, c] = std::array::from_fn(|_| rng.uniform(0.5, 9.0));
        RgbImage::from_fn(width, height, |x, y| {
            let (x, y) = (f64::from(x) / 64.0, f64::from(y) / 64.0);
            let waves = [libm::sin(a * x + b * y), libm::sin(b * x - c * y), libm::cos(c * x + a * y)];
            image::Rgb(waves.map(|wave| (128.0 + 120.0 * wave + noise * rng.uniform(-1.0, 1.0)).clamp(0.0, 255.0) as u8))
        })
    }

    /// With every kind of vectors that this machine has.
    fn same(image: &RgbImage, quality: u8) {
        let ((width, height), theirs) = (image.dimensions(), judge(image, quality));
        for (kind, ours) in at_each_width(|| Scan::of(image, quality).unwrap()).iter().enumerate() {
            let differ = ours.iter().zip(&theirs).position(|(a, b)| a != b);
            assert!(
                *ours == theirs,
                "{width}x{height} at {quality}, vectors {kind}: byte {differ:?} of {} and {}",
                ours.len(),
                theirs.len()
            );
        }
        assert!(encode(image, quality).unwrap() == theirs);
    }

    #[test]
    fn every_quality_gives_the_bytes_of_the_judge() {
        for quality in 1..=100 {
            same(&picture(80, 48, 40.0, quality.into()), quality);
        }
    }

    #[test]
    fn runs_of_zeros_full_range_and_stuffed_bytes_are_coded_alike() {
        for quality in [3, 50, 90, 100] {
            for level in [0, 1, 127, 128, 254, 255] {
                same(&RgbImage::from_pixel(33, 17, image::Rgb([level; 3])), quality);
            }
            // Chessboards hold the largest coefficients that there are.
            same(&RgbImage::from_fn(64, 64, |x, y| image::Rgb([if (x + y) % 2 == 0 { 255 } else { 0 }; 3])), quality);
            same(&RgbImage::from_fn(64, 64, |x, y| image::Rgb([if (x / 8 + y / 8) % 2 == 0 { 255 } else { 0 }, 0, 255])), quality);
            same(&picture(416, 416, 255.0, 1), quality);
        }
    }

    #[test]
    fn it_can_be_decoded_and_shows_the_picture() {
        let image = picture(131, 77, 0.0, 4);
        let decoded = image::load_from_memory(&encode(&image, 95).unwrap()).unwrap().to_rgb8();
        assert_eq!(decoded.dimensions(), image.dimensions());
        let error: f64 = image.as_raw().iter().zip(decoded.as_raw()).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
        assert!(error / (image.as_raw().len() as f64) < 40.0, "{error}");
    }

    #[test]
    fn what_has_no_pixels_or_too_many_is_refused() {
        assert!(encode(&RgbImage::new(0, 8), 90).is_none() && encode(&RgbImage::new(8, 0), 90).is_none());
        assert!(encode(&RgbImage::new(LARGEST + 1, 1), 90).is_none() && encode(&RgbImage::new(LARGEST, 1), 90).is_some());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Sizes that fill no block, single pixels and lines included.
        #[test]
        fn any_picture_gives_the_bytes_of_the_judge(width in 1u32..90, height in 1u32..90, quality in 1u8..=100, noise in 0.0..300.0f64, seed: u64) {
            same(&picture(width, height, noise, seed), quality);
        }
    }
}
