//! For tests: a dataset that takes seconds to learn, green squares with a blue diagonal on coloured noise.
use image::{Rgb, RgbImage};
use std::path::Path;
use tcross_dataset::{DatasetError, Marker, PixelBox, Quad, Record, Rng, Split, files};

/// Writes `train` and `val` images (and as many of `test` as of `val`) of `side` x `side` pixels, one marker each.
pub fn write(dir: &Path, train: usize, val: usize, side: u32) -> Result<(), DatasetError> {
    for (split, count) in [(Split::Train, train), (Split::Val, val), (Split::Test, val)] {
        files::create_dir(dir.join(split.name()))?;
        let records: Vec<Record> = (0..count).map(|k| record(dir, split, k, side)).collect::<Result<_, _>>()?;
        files::write_jsonl(dir.join(format!("{split}.jsonl")), &records)?;
    }
    files::write_atomically(dir.join("dataset.toml"), "format = 1\nboxes = \"continuous\"\n")
}

fn record(dir: &Path, split: Split, index: usize, side: u32) -> Result<Record, DatasetError> {
    let mut rng = Rng::for_item(1, &format!("test/toy/{split}"), index as u64);
    let base = [0; 3].map(|_| rng.int(60, 180));
    let mut image = RgbImage::from_fn(side, side, |_, _| Rgb(base.map(|v| (v + rng.int(-30, 30)) as u8)));
    let size = rng.int(i64::from(side) / 4, i64::from(side) / 2) as u32;
    let (x, y) = (rng.int(0, i64::from(side - size)) as u32, rng.int(0, i64::from(side - size)) as u32);
    for (u, v) in (0..size).flat_map(|v| (0..size).map(move |u| (u, v))) {
        let color = if u.abs_diff(v) <= size / 12 { Rgb([0, 0, 200]) } else { Rgb([0, 200, 0]) };
        image.put_pixel(x + u, y + v, color);
    }
    let name = format!("{split}/{index:05}.png");
    image.save(dir.join(&name)).map_err(|e| DatasetError::Image { path: dir.join(&name), message: e.to_string() })?;
    let bounds = PixelBox::from([x, y, x + size, y + size].map(f64::from));
    // The diagonal starts at the stem's corner, the upper left.
    let PixelBox { x_min, y_min, x_max, y_max } = bounds;
    let corners = [[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max]];
    Ok(Record {
        image: name,
        width: side,
        height: side,
        background: None,
        markers: vec![Marker { corners: Some(Quad(corners)), center: Some(bounds.center()), ..Marker::from_box("t_cross", bounds) }],
        confusers: Vec::new(),
        intrinsics: None,
        distortion: None,
        effects: serde_json::Map::new(),
    })
}
