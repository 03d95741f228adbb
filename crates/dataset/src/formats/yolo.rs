//! YOLO's form: `images/SPLIT/x.jpg`, `labels/SPLIT/x.txt` with a line `class cx cy w h` a marker (0..1), and `data.yaml`.
use super::{Labelled, bare, file_name, pictures_in, relative, stem};
use crate::{DatasetError, Marker, PixelBox, Record, Split, dataset::BoxConvention, files, picture};
use std::{collections::BTreeMap, fmt::Write, path::Path};

/// Writes it.
///
/// # Errors
/// If a picture is missing or the folder cannot be written.
pub fn write(set: &Labelled, out: &Path) -> Result<(), DatasetError> {
    write_with(set, out, "", |_, _, _| {})
}

/// Reads it.
///
/// # Errors
/// If `data.yaml` names no classes, a picture cannot be read, or a label line is not of this form.
pub fn read(dir: &Path) -> Result<Labelled, DatasetError> {
    read_with(dir, |marker, rest, _| if rest.is_empty() { Ok(marker) } else { Err(format!("{} numbers too many", rest.len())) })
}

/// Both YOLO forms: `more` adds to `data.yaml`, `add` to a label's line.
pub(super) fn write_with(set: &Labelled, out: &Path, more: &str, add: impl Fn(&mut String, &Marker, &Record)) -> Result<(), DatasetError> {
    let shapes = set.shapes();
    set.place_pictures(out, |split, r| Path::new("images").join(split.name()).join(file_name(r)))?;
    for (split, record) in set.records() {
        let (w, h) = (f64::from(record.width), f64::from(record.height));
        let mut text = String::new();
        for marker in &record.markers {
            let b = set.continuous(&marker.bounds);
            let [cx, cy] = b.center();
            let class = shapes.binary_search(&marker.shape).unwrap_or(0);
            let _ = write!(text, "{class} {} {} {} {}", short(cx / w), short(cy / h), short(b.width() / w), short(b.height() / h));
            add(&mut text, marker, record);
            text.push('\n');
        }
        let path = out.join("labels").join(split.name()).join(format!("{}.txt", stem(record)));
        files::create_dir(path.parent().unwrap_or(out))?;
        files::write_atomically(path, text)?;
    }
    let mut yaml = String::from("# Labels of this folder for YOLO trainers.\npath: .\n");
    for split in set.splits.keys() {
        let _ = writeln!(yaml, "{split}: images/{split}");
    }
    yaml.push_str(more);
    yaml.push_str("names:\n");
    for (k, shape) in shapes.iter().enumerate() {
        let _ = writeln!(yaml, "  {k}: {shape}");
    }
    files::write_atomically(out.join("data.yaml"), yaml)
}

/// Ten digits after the point: a ten-millionth of a pixel.
pub(super) fn short(value: f64) -> String {
    let text = format!("{value:.10}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// What turns a box and the numbers after it into a marker; `Err` says what is wrong with the numbers.
pub(super) type Finish = dyn Fn(Marker, &[f64], (f64, f64)) -> Result<Marker, String>;

/// Both YOLO forms: `finish` takes the numbers after the box.
pub(super) fn read_with(
    dir: &Path,
    finish: impl Fn(Marker, &[f64], (f64, f64)) -> Result<Marker, String> + 'static,
) -> Result<Labelled, DatasetError> {
    let finish: Box<Finish> = Box::new(finish);
    let names = class_names(&dir.join("data.yaml"))?;
    let mut splits = BTreeMap::new();
    for split in Split::ALL {
        let folder = dir.join("images").join(split.name());
        if !folder.is_dir() {
            continue;
        }
        let mut rows = Vec::new();
        for path in pictures_in(&folder)? {
            let mut record = bare(relative(&path, dir), picture::dimensions(&path)?);
            let labels = dir.join("labels").join(split.name()).join(format!("{}.txt", stem(&record)));
            if labels.is_file() {
                let size = (f64::from(record.width), f64::from(record.height));
                for (k, line) in files::read_text(&labels)?.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
                    record.markers.push(marker(line, &names, size, &finish).map_err(|e| DatasetError::line(&labels, k + 1, e))?);
                }
            }
            rows.push(record);
        }
        splits.insert(split, rows);
    }
    if splits.is_empty() {
        return Err(DatasetError::MissingSplit { dir: dir.join("images"), split: "train, val or test".into(), found: "none".into() });
    }
    Ok(Labelled::in_folder(dir, BoxConvention::Continuous, splits))
}

fn marker(line: &str, names: &[String], (w, h): (f64, f64), finish: &Finish) -> Result<Marker, String> {
    let numbers: Vec<f64> =
        line.split_whitespace().map(|v| v.parse().map_err(|_| format!("'{v}' is no number"))).collect::<Result<_, _>>()?;
    let [class, cx, cy, bw, bh, rest @ ..] = numbers.as_slice() else {
        return Err(format!("{} numbers; expected at least 5: class cx cy w h", numbers.len()));
    };
    let shape = names.get(*class as usize).filter(|_| class.fract() == 0.0 && *class >= 0.0);
    let shape = shape.ok_or_else(|| format!("class {class}; data.yaml names 0 to {}", names.len().saturating_sub(1)))?;
    if ![cx, cy, bw, bh].iter().all(|v| (0.0..=1.0).contains(*v)) {
        return Err(format!("box {cx} {cy} {bw} {bh}; every number must be in 0..1"));
    }
    finish(Marker::from_box(shape, PixelBox::from_center(cx * w, cy * h, bw * w, bh * h)), rest, (w, h))
}

/// The names of `data.yaml`: a map `0: name`, a list `- name`, or `[a, b]`; no more of YAML than such files use.
fn class_names(path: &Path) -> Result<Vec<String>, DatasetError> {
    let text = files::read_text(path)?;
    let clean = |s: &str| s.trim().trim_matches(['"', '\'']).to_owned();
    let mut lines = text.lines().enumerate().skip_while(|(_, l)| !l.starts_with("names:"));
    let Some((at, first)) = lines.next() else { return Err(DatasetError::unfit(path, "no key `names`", "the classes' names")) };
    let inline = first.trim_start_matches("names:").trim();
    if let Some(list) = inline.strip_prefix('[').and_then(|l| l.strip_suffix(']')) {
        return Ok(list.split(',').map(clean).filter(|n| !n.is_empty()).collect());
    }
    let mut names = Vec::new();
    for (k, line) in lines.take_while(|(_, l)| l.starts_with([' ', '-'])) {
        let entry = line.trim();
        let name = match (entry.strip_prefix('-'), entry.split_once(':')) {
            (Some(name), _) => name,
            (None, Some((index, name))) if index.trim().parse() == Ok(names.len()) => name,
            _ => return Err(DatasetError::line(path, k + 1, format!("'{entry}'; expected '{}: name'", names.len()))),
        };
        names.push(clean(name));
    }
    if names.is_empty() {
        return Err(DatasetError::line(path, at + 1, "`names` is empty; expected the classes' names"));
    }
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_labels_are_named() {
        let names = vec!["t_cross".to_owned()];
        let finish: Box<Finish> = Box::new(|m, _, _| Ok(m));
        for (line, word) in [
            ("0 0.5 0.5 0.1", "4 numbers"),
            ("1 0.5 0.5 0.1 0.1", "class 1"),
            ("0 x 0 0 0", "'x'"),
            ("0 1.5 0 0 0", "0..1"),
            ("0 NaN 0 0 0", "0..1"),
        ] {
            let message = marker(line, &names, (10.0, 10.0), &finish).unwrap_err();
            assert!(message.contains(word), "{message}");
        }
    }

    #[test]
    fn lists_of_names() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("data.yaml");
        for text in ["names: [a, 'b']\n", "nc: 2\nnames:\n  0: a\n  1: \"b\"\nmore: 1\n", "names:\n- a\n- b\n"] {
            std::fs::write(&path, text).unwrap();
            assert_eq!(class_names(&path).unwrap(), ["a", "b"]);
        }
        std::fs::write(&path, "names:\n  1: a\n").unwrap();
        assert!(class_names(&path).unwrap_err().to_string().contains("data.yaml:2"));
    }
}
