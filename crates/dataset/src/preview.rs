//! A contact sheet: many pictures on one, with the truth drawn on them.
use crate::{Dataset, DatasetError, Record, Split, draw, picture};
use image::{Rgb, RgbImage, imageops};
use rayon::prelude::*;

/// What a sheet looks like.
#[derive(Debug, Clone)]
pub struct Sheet {
    /// Pictures, spread evenly over the split.
    pub images: usize,
    /// Pictures a row.
    pub columns: usize,
    /// Longer side of a picture in pixels.
    pub tile_px: u32,
    /// Whether the truth is drawn.
    pub truth: bool,
}

impl Default for Sheet {
    fn default() -> Self {
        Self { images: 30, columns: 6, tile_px: 256, truth: true }
    }
}

/// Draws the sheet of a split.
///
/// # Errors
/// If the split has no images, or one of those shown cannot be read.
pub fn contact_sheet(dataset: &Dataset, split: Split, sheet: &Sheet) -> Result<RgbImage, DatasetError> {
    let records = dataset.records(split)?;
    let shown = records.len().min(sheet.images.max(1));
    if shown == 0 {
        return Err(DatasetError::unfit(dataset.list_path(split), "no images", "at least one"));
    }
    let picked: Vec<&Record> = (0..shown).map(|k| &records[k * records.len() / shown]).collect();
    let tiles: Vec<RgbImage> = picked.par_iter().map(|r| tile(dataset, r, sheet)).collect::<Result<_, _>>()?;
    let columns = sheet.columns.clamp(1, shown);
    // Rows and columns as high and wide as their largest picture.
    let cell = tiles.iter().fold([1, 1], |[w, h], tile| [tile.width().max(w), tile.height().max(h)]);
    let (step, gap) = (cell.map(|side| side + 4), 4);
    let (width, height) = (columns as u32 * step[0] + gap, shown.div_ceil(columns) as u32 * step[1] + gap);
    let mut page = RgbImage::from_pixel(width, height, Rgb([255; 3]));
    for (k, tile) in tiles.iter().enumerate() {
        let (x, y) = ((k % columns) as u32 * step[0] + gap, (k / columns) as u32 * step[1] + gap);
        let center = |of: u32, free: u32| i64::from((of - free) / 2);
        let (dx, dy) = (center(cell[0], tile.width()), center(cell[1], tile.height()));
        imageops::replace(&mut page, tile, i64::from(x) + dx, i64::from(y) + dy);
    }
    Ok(page)
}

fn tile(dataset: &Dataset, record: &Record, sheet: &Sheet) -> Result<RgbImage, DatasetError> {
    let path = dataset.image_path(record);
    let image = picture::read(&path)?;
    let scale = f64::from(sheet.tile_px) / f64::from(image.width().max(image.height()).max(1));
    let side = |v: u32| ((f64::from(v) * scale).round() as u32).clamp(1, sheet.tile_px);
    let mut small = imageops::resize(&image, side(image.width()), side(image.height()), imageops::FilterType::Triangle);
    if sheet.truth {
        draw::truth(&mut small, record, dataset.header.boxes, scale);
    }
    Ok(small)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{dataset::BoxConvention, formats};

    #[test]
    fn a_sheet_has_its_size_and_shows_the_truth() {
        let dir = tempfile::tempdir().unwrap();
        let set = formats::tests::random_set(dir.path(), 2, BoxConvention::Continuous);
        let out = tempfile::tempdir().unwrap();
        formats::native::write(&set, out.path()).unwrap();
        let dataset = Dataset::open(out.path()).unwrap();
        let sheet = Sheet { images: 9, columns: 2, tile_px: 64, truth: true };
        let page = contact_sheet(&dataset, Split::Test, &sheet).unwrap();
        let shown: Vec<RgbImage> = dataset.records(Split::Test).unwrap().iter().map(|r| tile(&dataset, r, &sheet).unwrap()).collect();
        let most = |side: fn(&RgbImage) -> u32| shown.iter().map(side).max().unwrap();
        // Three pictures in two columns.
        assert_eq!(page.dimensions(), (2 * (most(RgbImage::width) + 4) + 4, 2 * (most(RgbImage::height) + 4) + 4));
        // Flat pictures in flat rows.
        for record in dataset.records(Split::Test).unwrap() {
            RgbImage::from_pixel(80, 40, Rgb([90, 120, 30])).save(dataset.image_path(&record)).unwrap();
        }
        assert_eq!(contact_sheet(&dataset, Split::Test, &sheet).unwrap().dimensions(), (2 * (64 + 4) + 4, 2 * (32 + 4) + 4));
        let page = contact_sheet(&dataset, Split::Test, &sheet).unwrap();
        let plain = contact_sheet(&dataset, Split::Test, &Sheet { truth: false, ..sheet }).unwrap();
        assert_ne!(page, plain);
    }
}
