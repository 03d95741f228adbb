//! Which pictures show nearly the same: a burst, another size, another quality of one photo.
//!
//! Each picture is reduced to 128 differences of brightness between neighbouring cells (a difference hash, along rows and along columns) and to
//! a thumbnail of 8 by 8 colours. Two pictures are alike where few differences change sign and the thumbnails agree.
use image::RgbImage;

/// Signs of differences that may disagree. At most seven, so that of eight equal parts of the hash one is the same in both.
pub const MOST_BITS: u32 = 7;

/// Mean difference of the thumbnails that is still alike, in stored values (0..255).
pub const MOST_COLOR: u32 = 14;

/// What is kept of a picture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Look {
    signs: u128,
    thumbnail: [[u8; 3]; 64],
}

impl Look {
    /// Of a picture of at least one pixel.
    #[must_use]
    pub fn of(image: &RgbImage) -> Self {
        // Means over a grid that both nine and eight cells divide, from a fixed number of pixels whatever the picture's size.
        const FINE: u32 = 72;
        const SAMPLES: u32 = 4;
        let place = |k: u32, size: u32| (u64::from(2 * k + 1) * u64::from(size) / u64::from(2 * FINE * SAMPLES)) as u32;
        let columns: Vec<u32> = (0..FINE * SAMPLES).map(|k| place(k, image.width())).collect();
        let mut fine = vec![[0u32; 3]; (FINE * FINE) as usize];
        for k in 0..FINE * SAMPLES {
            let y = place(k, image.height());
            for (n, x) in columns.iter().enumerate() {
                let pixel = image.get_pixel(*x, y);
                let cell = &mut fine[(k / SAMPLES * FINE) as usize + n / SAMPLES as usize];
                (0..3).for_each(|c| cell[c] += u32::from(pixel[c]));
            }
        }
        let cells = |columns: u32, rows: u32| -> Vec<[u32; 3]> {
            let (w, h) = (FINE / columns, FINE / rows);
            let sum = |k: u32| {
                let (x, y) = (k % columns * w, k / columns * h);
                let part = (y..y + h).flat_map(|j| (x..x + w).map(move |i| (j * FINE + i) as usize));
                part.fold([0u32; 3], |sum, k| std::array::from_fn(|c| sum[c] + fine[k][c])).map(|v| v / (w * h * SAMPLES * SAMPLES))
            };
            (0..columns * rows).map(sum).collect()
        };
        let gray = |cells: Vec<[u32; 3]>| -> Vec<u32> { cells.iter().map(|p| 2 * p[0] + 5 * p[1] + p[2]).collect() };
        let (wide, tall) = (gray(cells(9, 8)), gray(cells(8, 9)));
        let mut signs = 0u128;
        for k in 0..64 {
            let (x, y) = (k % 8, k / 8);
            signs |= u128::from(wide[y * 9 + x] > wide[y * 9 + x + 1]) << k;
            signs |= u128::from(tall[y * 8 + x] > tall[(y + 1) * 8 + x]) << (64 + k);
        }
        let small = cells(8, 8);
        Self { signs, thumbnail: std::array::from_fn(|k| small[k].map(|v| v as u8)) }
    }

    /// True where both show nearly the same.
    #[must_use]
    pub fn is_like(&self, other: &Self) -> bool {
        let color = || -> u32 {
            let pairs = self.thumbnail.as_flattened().iter().zip(other.thumbnail.as_flattened());
            pairs.map(|(a, b)| u32::from(a.abs_diff(*b))).sum::<u32>() / 192
        };
        (self.signs ^ other.signs).count_ones() <= MOST_BITS && color() <= MOST_COLOR
    }

    /// One of the eight equal parts of the signs.
    fn part(&self, k: usize) -> u16 {
        (self.signs >> (16 * k)) as u16
    }
}

/// All pairs that are alike, each once, in order. Pictures are compared only where a part of their signs is the same.
#[must_use]
pub fn pairs(looks: &[Look]) -> Vec<(usize, usize)> {
    let mut found = Vec::new();
    for k in 0..8 {
        let mut order: Vec<usize> = (0..looks.len()).collect();
        order.sort_by_key(|i| (looks[*i].part(k), *i));
        for same in order.chunk_by(|a, b| looks[*a].part(k) == looks[*b].part(k)) {
            for (n, a) in same.iter().enumerate() {
                found.extend(same[n + 1..].iter().filter(|b| looks[*a].is_like(&looks[**b])).map(|b| (*a, *b)));
            }
        }
    }
    found.sort_unstable();
    found.dedup();
    found
}

/// Groups of pictures joined by likeness, directly or through others: for each picture the index of the first of its group. One whose look is
/// not known stands alone.
#[must_use]
pub fn groups(looks: &[Option<Look>]) -> Vec<usize> {
    let (places, known): (Vec<usize>, Vec<Look>) = looks.iter().enumerate().filter_map(|(k, l)| Some((k, l.clone()?))).unzip();
    joined(looks.len(), pairs(&known).into_iter().map(|(a, b)| (places[a], places[b])))
}

/// Groups of `count` things joined by pairs, directly or through others: for each thing the index of the first of its group.
#[must_use]
pub fn joined(count: usize, pairs: impl IntoIterator<Item = (usize, usize)>) -> Vec<usize> {
    let mut first: Vec<usize> = (0..count).collect();
    fn root(first: &[usize], mut k: usize) -> usize {
        while first[k] != k {
            k = first[k];
        }
        k
    }
    for (a, b) in pairs {
        let (a, b) = (root(&first, a), root(&first, b));
        first[a.max(b)] = a.min(b);
    }
    (0..count).map(|k| root(&first, k)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;
    use image::{Rgb, imageops};

    /// A picture of a few soft blobs: as different from the next as photos are.
    fn picture(seed: u64) -> RgbImage {
        let mut rng = Rng::for_item(seed, "test/similar", 0);
        let blobs: Vec<[f64; 6]> = (0..12)
            .map(|_| [rng.unit() * 160.0, rng.unit() * 120.0, rng.uniform(10.0, 40.0), rng.unit(), rng.unit(), rng.unit()])
            .collect();
        RgbImage::from_fn(160, 120, |x, y| {
            let mut sum = [40.0; 3];
            for [bx, by, r, colors @ ..] in &blobs {
                let d2 = (f64::from(x) - bx).powi(2) + (f64::from(y) - by).powi(2);
                (0..3).for_each(|c| sum[c] += 150.0 * colors[c] * (-d2 / (r * r)).exp());
            }
            Rgb(sum.map(|v| v.min(255.0) as u8))
        })
    }

    #[test]
    fn another_size_light_and_a_nudge_are_alike_and_other_pictures_are_not() {
        let pictures: Vec<RgbImage> = (0..40).map(picture).collect();
        let mut looks: Vec<Look> = pictures.iter().map(Look::of).collect();
        looks.push(Look::of(&imageops::resize(&pictures[3], 90, 68, imageops::FilterType::Triangle)));
        looks.push(Look::of(&imageops::crop_imm(&pictures[7], 1, 1, 158, 118).to_image()));
        looks.push(Look::of(&RgbImage::from_fn(160, 120, |x, y| Rgb(pictures[9].get_pixel(x, y).0.map(|v| v.saturating_add(6))))));
        assert_eq!(pairs(&looks), [(3, 40), (7, 41), (9, 42)]);
        let all: Vec<(usize, usize)> = (0..43).flat_map(|a| (a + 1..43).map(move |b| (a, b))).collect();
        let naive: Vec<(usize, usize)> = all.into_iter().filter(|(a, b)| looks[*a].is_like(&looks[*b])).collect();
        assert_eq!(pairs(&looks), naive);
    }

    #[test]
    fn likeness_is_passed_on_within_a_group() {
        let look = |bits: u128| Look { signs: bits, thumbnail: [[0; 3]; 64] };
        let looks = [look(0), look(u128::MAX), look(0b11111), look(0b1111111111)];
        assert!(!looks[0].is_like(&looks[3]));
        let [a, b, c, d] = looks.map(Some);
        assert_eq!(groups(&[a.clone(), b.clone(), c.clone(), d.clone()]), [0, 1, 0, 0]);
        assert_eq!(groups(&[a, b, None, d]), [0, 1, 2, 3], "nothing joins the first and the last without the third");
    }

    #[test]
    fn plain_pictures_of_other_colours_are_not_alike() {
        let plain = |c: u8| Look::of(&RgbImage::from_pixel(20, 20, Rgb([c; 3])));
        assert!(!plain(0).is_like(&plain(200)) && plain(90).is_like(&plain(92)));
    }
}
