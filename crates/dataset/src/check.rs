//! Looks for everything that can be wrong with a dataset, and reports all of it, not the first.
use crate::{
    Dataset, DatasetError, Marker, Record, Split, files, picture,
    similar::{self, Look},
};
use rayon::prelude::*;
use std::{collections::BTreeMap, fmt};

/// What is wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fault {
    /// A line of a list is no record.
    Line,
    /// The picture is missing or cannot be decoded.
    Unreadable,
    /// The picture has another size than its record says.
    Size,
    /// A box is reversed, not finite, or outside the picture.
    Box,
    /// A marker that covers no pixel.
    NoPixels,
    /// Corners, centre or homography contradict each other.
    Geometry,
    /// The same picture twice.
    Duplicate,
    /// The same picture, nearly the same picture, or the same photo behind it, in two splits.
    Leak,
}

impl Fault {
    /// In a word or two.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Line => "bad line",
            Self::Unreadable => "unreadable image",
            Self::Size => "wrong size",
            Self::Box => "bad box",
            Self::NoPixels => "label without pixels",
            Self::Geometry => "contradicting geometry",
            Self::Duplicate => "duplicate",
            Self::Leak => "leak between splits",
        }
    }
}

/// One thing that is wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// What kind.
    pub fault: Fault,
    /// The picture, or the list and its line.
    pub place: String,
    /// What was found.
    pub found: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}: {}", self.place, self.fault.name(), self.found)
    }
}

/// What was looked at and what is wrong with it.
#[derive(Debug, Clone, Default)]
pub struct CheckReport {
    /// Images a split.
    pub images: BTreeMap<Split, usize>,
    /// Markers of all splits.
    pub markers: usize,
    /// In order of split and image.
    pub problems: Vec<Problem>,
}

/// Checks every line and decodes every picture.
///
/// # Errors
/// If the folder is no dataset at all. What is wrong inside is in the report.
pub fn check(dir: impl AsRef<std::path::Path>) -> Result<CheckReport, DatasetError> {
    let dataset = Dataset::open(dir)?;
    let mut report = CheckReport::default();
    let mut pictures: BTreeMap<String, (Split, String)> = BTreeMap::new();
    let mut photos: BTreeMap<String, Split> = BTreeMap::new();
    let mut seen: Vec<(Split, String, Look)> = Vec::new();
    for split in dataset.splits() {
        let (records, mut problems) = lines(&dataset, split)?;
        let looked: Vec<(Option<(String, Look)>, Vec<Problem>)> = records.par_iter().map(|r| look(&dataset, r)).collect();
        for (record, (picture, found)) in records.iter().zip(looked) {
            problems.extend(found);
            let mut say = |fault, found: String| problems.push(Problem { fault, place: record.image.clone(), found });
            if let Some((digest, look)) = picture {
                if let Some((other, image)) = pictures.get(&digest) {
                    let fault = if *other == split { Fault::Duplicate } else { Fault::Leak };
                    say(fault, format!("the same bytes as {image}"));
                } else {
                    pictures.insert(digest, (split, record.image.clone()));
                    seen.push((split, record.image.clone(), look));
                }
            }
            if let Some(photo) = record.photo() {
                match photos.get(photo) {
                    Some(other) if *other != split => say(Fault::Leak, format!("the photo {photo} is in {other} too")),
                    _ => {
                        photos.insert(photo.to_owned(), split);
                    }
                }
            }
            report.markers += record.markers.len();
        }
        report.images.insert(split, records.len());
        report.problems.extend(problems);
    }
    let looks: Vec<Look> = seen.iter().map(|s| s.2.clone()).collect();
    for (a, b) in similar::pairs(&looks).into_iter().filter(|(a, b)| seen[*a].0 != seen[*b].0) {
        let found = format!("nearly the same picture as {}", seen[a].1);
        report.problems.push(Problem { fault: Fault::Leak, place: seen[b].1.clone(), found });
    }
    Ok(report)
}

/// The records of a split that parse, and a problem for each line that does not.
fn lines(dataset: &Dataset, split: Split) -> Result<(Vec<Record>, Vec<Problem>), DatasetError> {
    let (mut records, mut problems) = (Vec::new(), Vec::new());
    for (k, line) in files::read_text(dataset.list_path(split))?.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
        match serde_json::from_str(line) {
            Ok(record) => records.push(record),
            Err(e) => problems.push(Problem { fault: Fault::Line, place: format!("{split}.jsonl:{}", k + 1), found: e.to_string() }),
        }
    }
    Ok((records, problems))
}

/// The digest and the look of a record's picture, and what is wrong with both.
fn look(dataset: &Dataset, record: &Record) -> (Option<(String, Look)>, Vec<Problem>) {
    let mut problems = Vec::new();
    let mut say = |fault, found: String| problems.push(Problem { fault, place: record.image.clone(), found });
    let path = dataset.image_path(record);
    let picture = match std::fs::read(&path).map_err(|e| DatasetError::io(&path, e)).and_then(|bytes| Ok((picture::read(&path)?, bytes))) {
        Ok((image, bytes)) => {
            if (image.width(), image.height()) != (record.width, record.height) {
                say(Fault::Size, format!("{}x{}, the record says {}x{}", image.width(), image.height(), record.width, record.height));
            }
            Some((files::digest_bytes(bytes), Look::of(&image)))
        }
        Err(e) => {
            let found = match e {
                DatasetError::Image { message, .. } => message,
                other => other.to_string(),
            };
            say(Fault::Unreadable, found);
            None
        }
    };
    for (k, marker) in record.markers.iter().enumerate() {
        for (fault, found) in marker_faults(dataset, record, marker) {
            say(fault, format!("marker {k}: {found}"));
        }
    }
    (picture, problems)
}

fn marker_faults(dataset: &Dataset, record: &Record, marker: &Marker) -> Vec<(Fault, String)> {
    let mut faults = Vec::new();
    let (b, one) = (marker.bounds, dataset.header.boxes.extra());
    let (w, h) = (f64::from(record.width), f64::from(record.height));
    let numbers: [f64; 4] = b.into();
    if !b.is_valid() {
        faults.push((Fault::Box, format!("{numbers:?} is reversed or not finite")));
    } else if b.x_min < 0.0 || b.y_min < 0.0 || b.x_max + one > w || b.y_max + one > h {
        faults.push((Fault::Box, format!("{numbers:?} reaches outside {w}x{h}")));
    } else if (b.width() + one) * (b.height() + one) <= 0.0 {
        faults.push((Fault::NoPixels, format!("{numbers:?} has no area")));
    }
    if marker.visible == Some(0.0) || marker.mask.as_ref().is_some_and(|m| m.iter().skip(1).step_by(2).all(|n| *n == 0)) {
        faults.push((Fault::NoPixels, "nothing of it is visible".into()));
    }
    if let Some(corners) = &marker.corners {
        let tolerance = 0.01 * corners.side_px().max(1.0);
        let far = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        if corners.signed_area() <= 0.0 {
            faults.push((Fault::Geometry, "the corners do not run clockwise".into()));
        }
        if let Some(map) = &marker.homography {
            let unit = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
            let worst = unit.iter().zip(corners.0).map(|(u, c)| far(map.apply(*u), c)).fold(0.0, f64::max);
            // A bent sheet or a lens moves corners away from any plane's map.
            if worst.is_nan() || worst > 10.0 * tolerance {
                faults.push((Fault::Geometry, format!("the homography misses a corner by {worst:.2} px")));
            }
        }
        // Other shapes' angles point elsewhere: a triangle's to the middle of its upper side.
        if let (Some(angle), Some(center), Some(stem)) = (marker.angle, marker.center, marker.stem.and_then(|k| corners.0.get(k as usize)))
        {
            let off = (crate::geom::quad::angle_deg(stem[0] - center[0], stem[1] - center[1]) - angle + 180.0).rem_euclid(360.0) - 180.0;
            if off.abs() > 10.0 {
                faults.push((Fault::Geometry, format!("the angle is {off:.1} degrees off the stem's corner")));
            }
        }
    }
    faults
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{dataset::BoxConvention, formats};

    #[test]
    fn every_fault_is_found() {
        let (from, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let dir = dir.path();
        let mut set = formats::tests::random_set(from.path(), 9, BoxConvention::Continuous);
        let mut row = |split: Split, k: usize, change: &dyn Fn(&mut Record)| change(&mut set.splits.get_mut(&split).unwrap()[k].record);
        row(Split::Train, 1, &|r| {
            r.markers[0].bounds = [5.0, 5.0, 500.0, 9.0].into();
            r.background = Some("a.jpg".into());
        });
        row(Split::Train, 2, &|r| {
            r.markers[0].angle = r.markers[0].angle.map(|a| (a + 90.0) % 360.0);
            r.markers[1].bounds = [5.0, 5.0, 5.0, 9.0].into();
        });
        row(Split::Val, 0, &|r| r.background = Some("a.jpg".into()));
        row(Split::Val, 1, &|r| r.width += 1);
        formats::native::write(&set, dir).unwrap();
        std::fs::remove_file(dir.join("test/00000.png")).unwrap();
        std::fs::write(dir.join("test/00000.png"), "no picture").unwrap();
        std::fs::copy(dir.join("train/00000.png"), dir.join("val/00002.png.new")).unwrap();
        std::fs::rename(dir.join("val/00002.png.new"), dir.join("val/00002.png")).unwrap();
        let list = dir.join("test.jsonl");
        let text = files::read_text(&list).unwrap() + "{}\n";
        files::write_atomically(&list, text).unwrap();
        let report = check(dir).unwrap();
        let kinds: std::collections::BTreeSet<Fault> = report.problems.iter().map(|p| p.fault).collect();
        for fault in [Fault::Line, Fault::Unreadable, Fault::Size, Fault::Box, Fault::NoPixels, Fault::Geometry, Fault::Leak] {
            assert!(kinds.contains(&fault), "{fault:?}: {:#?}", report.problems);
        }
        assert!(report.problems.iter().any(|p| p.to_string().contains("test.jsonl:4: bad line")));
    }
}
