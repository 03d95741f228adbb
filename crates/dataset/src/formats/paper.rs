//! The paper's lists: `train.txt`, `val.txt`, `test.txt` with a line `id path width height (class x1 y1 x2 y2)*` an image,
//! boxes as whole pixels with both ends in, and `data.names`. The authors' list of real photos,
//! `id path width height 0 x1 y1 x2 y2 cx cy angle p1x p1y .. p4x p4y`, is read too.
use super::{Labelled, bare, file_name, with_geometry};
use crate::{DatasetError, Marker, Record, Split, dataset::BoxConvention, files, geom::quad::Quad};
use std::{collections::BTreeMap, fmt::Write, path::Path};

/// Writes it.
///
/// # Errors
/// If a picture is missing or the folder cannot be written.
pub fn write(set: &Labelled, out: &Path) -> Result<(), DatasetError> {
    let shapes = set.shapes();
    set.place_pictures(out, |split, r| Path::new(split.name()).join(file_name(r)))?;
    for (split, rows) in &set.splits {
        let mut text = String::new();
        for (k, record) in rows.iter().map(|i| &i.record).enumerate() {
            let _ = write!(text, "{k} {split}/{} {} {}", file_name(record), record.width, record.height);
            for marker in &record.markers {
                let class = shapes.binary_search(&marker.shape).unwrap_or(0);
                let [x1, y1, x2, y2] = set.inclusive(&marker.bounds);
                let _ = write!(text, " {class} {x1} {y1} {x2} {y2}");
            }
            text.push('\n');
        }
        files::write_atomically(out.join(format!("{split}.txt")), text)?;
    }
    files::write_atomically(out.join("data.names"), shapes.iter().map(|s| format!("{s}\n")).collect::<String>())
}

/// Reads it.
///
/// # Errors
/// If no list is there, or a line is not of this form.
pub fn read(dir: &Path) -> Result<Labelled, DatasetError> {
    let names = dir.join("data.names");
    let names: Vec<String> = if names.is_file() {
        files::read_text(&names)?.lines().map(|l| l.trim().to_owned()).filter(|l| !l.is_empty()).collect()
    } else {
        vec!["marker".into()]
    };
    let mut splits = BTreeMap::new();
    for split in Split::ALL {
        let list = dir.join(format!("{split}.txt"));
        if list.is_file() {
            let text = files::read_text(&list)?;
            let rows = text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty());
            let rows = rows.map(|(k, line)| record(line, &names).map_err(|e| DatasetError::line(&list, k + 1, e)));
            splits.insert(split, rows.collect::<Result<Vec<_>, _>>()?);
        }
    }
    if splits.is_empty() {
        return Err(DatasetError::unfit(dir, "no list", "train.txt, val.txt or test.txt"));
    }
    Ok(Labelled::in_folder(dir, BoxConvention::Inclusive, splits))
}

fn record(line: &str, names: &[String]) -> Result<Record, String> {
    let mut words = line.split_whitespace();
    let mut next = |what: &str| words.next().ok_or_else(|| format!("no {what}; expected id path width height (class x1 y1 x2 y2)*"));
    let _id = next("id")?;
    let path = next("path")?.to_owned();
    let mut size = |what: &str| next(what).and_then(|w| w.parse::<u32>().map_err(|_| format!("{what} '{w}' is no whole number")));
    let mut record = bare(path, (size("width")?, size("height")?));
    let numbers: Vec<f64> =
        words.map(|v| v.parse().ok().filter(|v: &f64| v.is_finite()).ok_or(format!("'{v}' is no number"))).collect::<Result<_, _>>()?;
    let marker = |five: &[f64]| {
        let shape = names
            .get(five[0] as usize)
            .filter(|_| five[0] >= 0.0)
            .ok_or_else(|| format!("class {}; data.names has {}", five[0], names.len()))?;
        let bounds = [five[1], five[2], five[3], five[4]];
        if bounds[2] < bounds[0] || bounds[3] < bounds[1] {
            return Err(format!("reversed box {bounds:?}"));
        }
        Ok(Marker::from_box(shape, bounds.into()))
    };
    if numbers.len() == 16 {
        let point = |k: usize| [numbers[8 + 2 * k], numbers[9 + 2 * k]];
        let mut real =
            with_geometry(marker(&numbers[..5])?, Quad([point(0), point(1), point(2), point(3)]), Some([numbers[5], numbers[6]]));
        real.angle = Some(numbers[7]);
        record.markers.push(real);
    } else if numbers.len().is_multiple_of(5) {
        record.markers = numbers.chunks(5).map(marker).collect::<Result<_, _>>()?;
    } else {
        return Err(format!("{} numbers after the size; expected five a marker, or the 16 of a tagged photo", numbers.len()));
    }
    Ok(record)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_kinds_of_lines() {
        let names = vec!["marker".to_owned()];
        let plain = record("9 test/9.jpg 416 312 0 10 20 30 40 0 1 2 3 4", &names).unwrap();
        assert_eq!((plain.markers.len(), plain.width), (2, 416));
        let real = record("0 a.jpg 1280 720 0 10 20 30 40 20 30 45 30 20 30 40 10 40 10 20", &names).unwrap();
        let marker = &real.markers[0];
        assert_eq!((marker.center, marker.angle), (Some([20.0, 30.0]), Some(45.0)));
        assert_eq!(marker.corners.unwrap().0[0], [30.0, 20.0]);
    }

    #[test]
    fn bad_lines_are_named() {
        let names = vec!["marker".to_owned()];
        for (line, word) in [
            ("1 a.jpg", "width"),
            ("1 a.jpg x 3", "'x'"),
            ("1 a.jpg 4 4 1 0 0 1 1", "class 1"),
            ("1 a.jpg 4 4 0 0 0", "3 numbers"),
            ("1 a.jpg 4 4 0 3 0 1 1", "reversed"),
        ] {
            assert!(record(line, &names).unwrap_err().contains(word), "{line}");
        }
    }
}
