//! Pascal VOC's form: `JPEGImages/x.jpg`, `Annotations/x.xml`, `ImageSets/Main/SPLIT.txt`. Boxes are whole pixels counted
//! from 1, both ends in; a box that is not whole is rounded.
use super::{Labelled, bare, file_name, stem};
use crate::{DatasetError, Marker, Record, Split, dataset::BoxConvention, files};
use std::{collections::BTreeMap, fmt::Write, path::Path};

/// Pictures of all splits lie in one folder: the split is part of the name.
fn name(split: Split, record: &Record) -> String {
    format!("{split}_{}", file_name(record))
}

/// Writes it.
///
/// # Errors
/// If a picture is missing or the folder cannot be written.
pub fn write(set: &Labelled, out: &Path) -> Result<(), DatasetError> {
    set.place_pictures(out, |split, r| Path::new("JPEGImages").join(name(split, r)))?;
    files::create_dir(out.join("Annotations"))?;
    files::create_dir(out.join("ImageSets/Main"))?;
    for (split, rows) in &set.splits {
        let list: String = rows.iter().map(|i| format!("{split}_{}\n", stem(&i.record))).collect();
        files::write_atomically(out.join(format!("ImageSets/Main/{split}.txt")), list)?;
    }
    for (split, record) in set.records() {
        let mut xml = format!(
            "<annotation>\n  <folder>JPEGImages</folder>\n  <filename>{}</filename>\n  <size><width>{}</width><height>{}</height><depth>3</depth></size>\n  <segmented>0</segmented>\n",
            escape(&name(split, record)),
            record.width,
            record.height
        );
        for marker in &record.markers {
            let [x1, y1, x2, y2] = set.inclusive(&marker.bounds).map(|v| v + 1);
            let truncated = u8::from(x1 <= 1 || y1 <= 1 || x2 >= i64::from(record.width) || y2 >= i64::from(record.height));
            let _ = writeln!(
                xml,
                "  <object>\n    <name>{}</name>\n    <pose>Unspecified</pose>\n    <truncated>{truncated}</truncated>\n    <difficult>0</difficult>\n    <bndbox><xmin>{x1}</xmin><ymin>{y1}</ymin><xmax>{x2}</xmax><ymax>{y2}</ymax></bndbox>\n  </object>",
                escape(&marker.shape)
            );
        }
        xml.push_str("</annotation>\n");
        files::write_atomically(out.join(format!("Annotations/{split}_{}.xml", stem(record))), xml)?;
    }
    Ok(())
}

/// Reads it.
///
/// # Errors
/// If a list, a picture or an annotation is missing, or an annotation lacks a tag or has no number where one belongs.
pub fn read(dir: &Path) -> Result<Labelled, DatasetError> {
    let mut splits = BTreeMap::new();
    for split in Split::ALL {
        let list = dir.join(format!("ImageSets/Main/{split}.txt"));
        if list.is_file() {
            let text = files::read_text(&list)?;
            let ids = text.lines().filter_map(|l| l.split_whitespace().next());
            splits.insert(split, ids.map(|id| annotation(&dir.join(format!("Annotations/{id}.xml")))).collect::<Result<Vec<_>, _>>()?);
        }
    }
    if splits.is_empty() {
        return Err(DatasetError::MissingSplit {
            dir: dir.join("ImageSets/Main"),
            split: "train, val or test".into(),
            found: "none".into(),
        });
    }
    Ok(Labelled::in_folder(dir, BoxConvention::Inclusive, splits))
}

fn annotation(path: &Path) -> Result<Record, DatasetError> {
    let text = files::read_text(path)?;
    let line_at = |part: &str| text[..part.as_ptr() as usize - text.as_ptr() as usize].matches('\n').count() + 1;
    let get = |part: &'_ str, tag: &str| {
        inner(part, tag).map(|v| v.trim().to_owned()).ok_or_else(|| DatasetError::line(path, line_at(part), format!("no <{tag}>")))
    };
    let number = |part: &str, tag: &str| -> Result<f64, DatasetError> {
        let word = get(part, tag)?;
        word.parse::<f64>()
            .ok()
            .filter(|v| v.is_finite())
            .ok_or_else(|| DatasetError::line(path, line_at(part), format!("<{tag}> is '{word}', no number")))
    };
    let size = inner(&text, "size").ok_or_else(|| DatasetError::line(path, 1, "no <size>"))?;
    let file = unescape(&get(&text, "filename")?);
    let mut record = bare(format!("JPEGImages/{file}"), (number(size, "width")? as u32, number(size, "height")? as u32));
    let mut rest = text.as_str();
    while let Some(object) = inner(rest, "object") {
        let b = inner(object, "bndbox").ok_or_else(|| DatasetError::line(path, line_at(object), "no <bndbox>"))?;
        let bounds = [number(b, "xmin")? - 1.0, number(b, "ymin")? - 1.0, number(b, "xmax")? - 1.0, number(b, "ymax")? - 1.0];
        if bounds[2] < bounds[0] || bounds[3] < bounds[1] {
            return Err(DatasetError::line(path, line_at(b), "the box is reversed"));
        }
        record.markers.push(Marker::from_box(unescape(&get(object, "name")?), bounds.into()));
        rest = &rest[object.as_ptr() as usize - rest.as_ptr() as usize + object.len()..];
    }
    Ok(record)
}

/// The text between `<tag>` and `</tag>`, the first of them. Such files use no more of XML.
fn inner<'a>(text: &'a str, tag: &str) -> Option<&'a str> {
    let start = text.find(&format!("<{tag}>"))? + tag.len() + 2;
    let end = start + text[start..].find(&format!("</{tag}>"))?;
    Some(&text[start..end])
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

fn unescape(text: &str) -> String {
    text.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_have_a_line() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.xml");
        let xml = "<annotation>\n<filename>a.jpg</filename>\n<size><width>4</width><height>4</height></size>\n<object>\n<name>x</name>\n<bndbox><xmin>q</xmin></bndbox></object></annotation>";
        std::fs::write(&path, xml).unwrap();
        let message = annotation(&path).unwrap_err().to_string();
        assert!(message.contains("a.xml:6") && message.contains("'q'"), "{message}");
    }
}
