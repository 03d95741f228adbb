//! Reads detections, strictly or with every fault counted. A file is read in blocks whose lines are parsed and scored in
//! parallel, so that memory holds what became of the detections and not the detections.
use crate::{error::EvalError, fast_line, truth::Truth};
use rayon::prelude::*;
use serde::Deserialize;
use std::{
    collections::BTreeMap,
    fmt,
    fs::File,
    io::{BufRead, Read, Seek, SeekFrom},
    path::{Path, PathBuf},
};
use tcross_dataset::{DatasetError, Detection, ImageDetections, PixelBox};

/// What is wrong with a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ProblemKind {
    /// Detections for an image that the truth lacks.
    UnknownImage,
    /// A box of a category that a COCO file does not list.
    UnknownCategory,
    /// A second image or category of one id in a COCO file.
    DuplicateId,
    /// An image of the truth without a line of detections.
    MissingImage,
    /// A score that is not a number from 0 to 1.
    BadScore,
    /// A box with a number that is not finite, or with its sides reversed.
    BadBox,
    /// A second line for one image.
    DuplicateLine,
    /// Another width or height than the truth's.
    OtherSize,
    /// Not JSON of the expected form.
    BadLine,
}

impl ProblemKind {
    /// What was met, and what a lenient reading does about it.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::UnknownImage => "lines or boxes for images that the truth lacks (not scored)",
            Self::UnknownCategory => "boxes of categories that the truth lacks (left out)",
            Self::DuplicateId => "further images or categories of one id (the first counts)",
            Self::MissingImage => "images without a line of detections (scored as empty)",
            Self::BadScore => "detections whose score is not a number from 0 to 1 (left out)",
            Self::BadBox => "boxes that are reversed or not finite (left out)",
            Self::DuplicateLine => "further lines for one image (the first is scored)",
            Self::OtherSize => "images of another size than the truth's (scored as they are)",
            Self::BadLine => "lines that are not JSON of the expected form (left out)",
        }
    }

    /// As a key in `metrics.json`.
    #[must_use]
    pub fn key(self) -> &'static str {
        match self {
            Self::UnknownImage => "unknown_image",
            Self::UnknownCategory => "unknown_category",
            Self::DuplicateId => "duplicate_id",
            Self::MissingImage => "missing_image",
            Self::BadScore => "bad_score",
            Self::BadBox => "bad_box",
            Self::DuplicateLine => "duplicate_line",
            Self::OtherSize => "other_size",
            Self::BadLine => "bad_line",
        }
    }
}

/// One problem and where it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// What is wrong.
    pub kind: ProblemKind,
    /// The file.
    pub path: PathBuf,
    /// 1-based; 0 for what the file lacks.
    pub line: usize,
    /// What was found and what is expected.
    pub message: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            0 => write!(f, "{}: {}", self.path.display(), self.message),
            line => write!(f, "{}:{line}: {}", self.path.display(), self.message),
        }
    }
}

/// How often each kind of problem was met in a lenient reading.
pub type ProblemCounts = BTreeMap<ProblemKind, usize>;

/// Where detections come from.
#[derive(Debug, Clone)]
pub enum DetectionSource {
    /// A JSONL file.
    File(PathBuf),
    /// Memory; already checked by whoever made them.
    Memory(Vec<ImageDetections>),
}

impl From<&Path> for DetectionSource {
    fn from(path: &Path) -> Self {
        Self::File(path.to_owned())
    }
}

impl From<Vec<ImageDetections>> for DetectionSource {
    fn from(rows: Vec<ImageDetections>) -> Self {
        Self::Memory(rows)
    }
}

/// Where the detections of each image can be read again.
#[derive(Debug, Clone)]
pub struct Located {
    source: DetectionSource,
    /// Offset and length in bytes of a file, or index and 0 in memory; one an image of the truth.
    spans: Vec<Option<(u64, u32)>>,
}

impl Located {
    /// The detections of image `index`, read again; those that do not parse as none.
    #[must_use]
    pub fn detections(&self, index: usize) -> Vec<Detection> {
        let Some((at, length)) = self.spans.get(index).copied().flatten() else { return Vec::new() };
        match &self.source {
            DetectionSource::Memory(rows) => rows[at as usize].detections.clone(),
            DetectionSource::File(path) => {
                let read = || -> std::io::Result<Vec<u8>> {
                    let mut bytes = vec![0; length as usize];
                    let mut file = File::open(path)?;
                    file.seek(SeekFrom::Start(at))?;
                    file.read_exact(&mut bytes)?;
                    Ok(bytes)
                };
                read().ok().and_then(|bytes| parse(&bytes).ok()).map_or(Vec::new(), |parsed| parsed.row.detections)
            }
        }
    }
}

/// What a reading gives: one result an image of the truth (`None` where the file has no line for it).
pub struct Reading<T> {
    /// In order of the truth.
    pub images: Vec<Option<T>>,
    /// By kind.
    pub problems: ProblemCounts,
    /// For reading some of them again.
    pub located: Located,
}

/// Reads all detections and maps each image's to a result with `score(index, detections)`.
///
/// # Errors
/// If the file cannot be read; unless `lenient`, if anything in it is wrong.
pub fn read<T: Send>(
    truth: &Truth,
    source: DetectionSource,
    lenient: bool,
    score: impl Fn(usize, &ImageDetections) -> T + Sync,
) -> Result<Reading<T>, EvalError> {
    let n = truth.records.len();
    let path = match &source {
        DetectionSource::File(path) => path.clone(),
        DetectionSource::Memory(_) => "detections in memory".into(),
    };
    let mut sink = Sink { path, images: (0..n).map(|_| None).collect(), spans: vec![None; n], lines: vec![0; n], problems: Vec::new() };
    match &source {
        DetectionSource::Memory(rows) => {
            let scored: Vec<_> = rows.par_iter().map(|row| place(truth, Parsed::from(row.clone()), &score)).collect();
            scored.into_iter().enumerate().for_each(|(k, line)| sink.take(truth, k + 1, (k as u64, 0), line));
        }
        DetectionSource::File(path) => read_file(path, truth, &mut sink, &score)?,
    }
    sink.note_missing(truth);
    let problems = counted(&sink.problems, lenient)?;
    Ok(Reading { images: sink.images, problems, located: Located { source, spans: sink.spans } })
}

/// How often each kind was met or, unless `lenient`, the error that the first of them is.
pub(crate) fn counted(problems: &[Problem], lenient: bool) -> Result<ProblemCounts, EvalError> {
    if let (Some(first), false) = (problems.first(), lenient) {
        return Err(EvalError::Input { first: first.clone(), count: problems.len() });
    }
    let mut counts = ProblemCounts::new();
    problems.iter().for_each(|p| *counts.entry(p.kind).or_default() += 1);
    Ok(counts)
}

/// What is wrong with one thing, and what was found.
pub(crate) type Fault = (ProblemKind, String);

/// A line after parsing: what can be scored, and what had to be left out.
struct Parsed {
    row: ImageDetections,
    faults: Vec<Fault>,
}

impl From<ImageDetections> for Parsed {
    fn from(mut row: ImageDetections) -> Self {
        let mut faults = Vec::new();
        row.detections.retain(|d| {
            let fault = fault_of(d);
            let keep = fault.is_none();
            faults.extend(fault);
            keep
        });
        Self { row, faults }
    }
}

fn fault_of(d: &Detection) -> Option<Fault> {
    let found = <[f64; 4]>::from(d.bounds);
    let bad_box = || {
        (!d.bounds.is_valid())
            .then(|| (ProblemKind::BadBox, format!("box {found:?}: allowed is x_min <= x_max, y_min <= y_max, all finite")))
    };
    bad_score(d.score).or_else(bad_box)
}

/// What is wrong with a score.
pub(crate) fn bad_score(score: f64) -> Option<Fault> {
    (!(0.0..=1.0).contains(&score)).then(|| (ProblemKind::BadScore, format!("score {score}: allowed is a number from 0 to 1")))
}

fn parse(bytes: &[u8]) -> Result<Parsed, Fault> {
    if let Some(row) = fast_line::read(bytes) {
        return Ok(row.into());
    }
    match serde_json::from_slice::<ImageDetections>(bytes) {
        Ok(row) => Ok(row.into()),
        Err(e) => parse_with_nan(bytes).ok_or_else(|| (ProblemKind::BadLine, e.to_string())),
    }
}

/// Text in which Python wrote `NaN` or `Infinity`, which JSON does not know, with `null` in their place; `None` where it has none.
pub(crate) fn without_nan(text: &str) -> Option<String> {
    let some = text.contains("NaN") || text.contains("Infinity");
    some.then(|| text.replace("-Infinity", "null").replace("Infinity", "null").replace("NaN", "null"))
}

/// A line in which Python wrote `NaN` or `Infinity`, which JSON does not know.
fn parse_with_nan(bytes: &[u8]) -> Option<Parsed> {
    #[derive(Deserialize)]
    struct Loose {
        image: String,
        width: u32,
        height: u32,
        detections: Vec<LooseDetection>,
    }
    #[derive(Deserialize)]
    struct LooseDetection {
        score: Option<f64>,
        class: u32,
        #[serde(rename = "box")]
        bounds: [Option<f64>; 4],
    }
    let loose: Loose = serde_json::from_str(&without_nan(std::str::from_utf8(bytes).ok()?)?).ok()?;
    let firm = |d: LooseDetection| Detection {
        score: d.score.unwrap_or(f64::NAN),
        class: d.class,
        bounds: PixelBox::from(d.bounds.map(|v| v.unwrap_or(f64::NAN))),
        pose: None,
    };
    let detections = loose.detections.into_iter().map(firm).collect();
    Some(ImageDetections { image: loose.image, width: loose.width, height: loose.height, detections, ms: None }.into())
}

/// A line after scoring: its image's index and result, and the line's faults.
type Placed<T> = (Option<(usize, T)>, Vec<Fault>);

fn place<T>(truth: &Truth, parsed: Parsed, score: &impl Fn(usize, &ImageDetections) -> T) -> Placed<T> {
    let Parsed { row, mut faults } = parsed;
    let Some(index) = truth.position(&row.image) else {
        faults.push((ProblemKind::UnknownImage, format!("image '{}' is not in {}", row.image, truth.path.display())));
        return (None, faults);
    };
    let record = &truth.records[index];
    if (row.width, row.height) != (record.width, record.height) {
        let (w, h, tw, th) = (row.width, row.height, record.width, record.height);
        faults.push((ProblemKind::OtherSize, format!("'{}' is {w} x {h} here, {tw} x {th} in the truth", row.image)));
    }
    (Some((index, score(index, &row))), faults)
}

/// Collects lines in order of the file.
struct Sink<T> {
    path: PathBuf,
    images: Vec<Option<T>>,
    spans: Vec<Option<(u64, u32)>>,
    lines: Vec<usize>,
    problems: Vec<Problem>,
}

impl<T> Sink<T> {
    fn note(&mut self, line: usize, (kind, message): Fault) {
        self.problems.push(Problem { kind, path: self.path.clone(), line, message });
    }

    fn take(&mut self, truth: &Truth, line: usize, span: (u64, u32), (scored, faults): Placed<T>) {
        if let Some((index, _)) = &scored
            && self.spans[*index].is_some()
        {
            let message = format!("'{}' has detections on line {} already", truth.records[*index].image, self.lines[*index]);
            self.note(line, (ProblemKind::DuplicateLine, message));
            return;
        }
        faults.into_iter().for_each(|fault| self.note(line, fault));
        if let Some((index, result)) = scored {
            self.images[index] = Some(result);
            self.spans[index] = Some(span);
            self.lines[index] = line;
        }
    }

    fn note_missing(&mut self, truth: &Truth) {
        for (k, record) in truth.records.iter().enumerate() {
            if self.spans[k].is_none() {
                let message = format!("no line for '{}' ({} of the truth); an image without detections needs one too", record.image, k + 1);
                self.note(0, (ProblemKind::MissingImage, message));
            }
        }
    }
}

/// Bytes parsed at a time.
const BLOCK: usize = 8 << 20;

fn read_file<T: Send>(
    path: &Path,
    truth: &Truth,
    sink: &mut Sink<T>,
    score: &(impl Fn(usize, &ImageDetections) -> T + Sync),
) -> Result<(), EvalError> {
    let io = |e| DatasetError::io(path, e);
    let mut file = File::open(path).map_err(io)?;
    let (mut start, mut number) = (0u64, 0usize);
    let (mut now, mut next) = (Block::default(), Block::default());
    now.fill(&mut file, &[]).map_err(io)?;
    loop {
        let Block { bytes: block, ends } = &now;
        let Some(&whole) = ends.last() else { return Ok(()) };
        let line = |k: usize| if k == 0 { 0..ends[0] } else { ends[k - 1]..ends[k] };
        let score_line = |k: usize| {
            let bytes = block[line(k)].trim_ascii();
            let placed = || match parse(bytes) {
                Ok(parsed) => place(truth, parsed, score),
                Err(fault) => (None, vec![fault]),
            };
            (!bytes.is_empty()).then(placed)
        };
        // The next block is read while this one is parsed.
        let parse_all = || (0..ends.len()).into_par_iter().map(score_line).collect::<Vec<Option<Placed<T>>>>();
        let (scored, filled) = rayon::join(parse_all, || next.fill(&mut file, &block[whole..]));
        filled.map_err(io)?;
        for (k, placed) in scored.into_iter().enumerate() {
            let span = (start + line(k).start as u64, line(k).len() as u32);
            if let Some(placed) = placed {
                sink.take(truth, number + k + 1, span, placed);
            }
        }
        start += whole as u64;
        number += ends.len();
        std::mem::swap(&mut now, &mut next);
    }
}

/// Whole lines of a file, and the start of the next.
#[derive(Default)]
struct Block {
    bytes: Vec<u8>,
    /// One a line, behind its line feed; the last line of a file may lack one.
    ends: Vec<usize>,
}

impl Block {
    /// Reads on behind `rest`, which the block before has left over, until at least one line is whole or the file ends.
    fn fill(&mut self, file: &mut File, rest: &[u8]) -> std::io::Result<()> {
        self.bytes.clear();
        self.ends.clear();
        self.bytes.extend_from_slice(rest);
        while self.ends.is_empty() {
            let searched = self.bytes.len();
            if file.take(BLOCK as u64).read_to_end(&mut self.bytes)? == 0 {
                if !self.bytes.is_empty() {
                    self.ends.push(self.bytes.len());
                }
                return Ok(());
            }
            let mut unread = &self.bytes[searched..];
            loop {
                let passed = unread.skip_until(b'\n')?;
                let end = self.bytes.len() - unread.len();
                if passed == 0 || self.bytes[end - 1] != b'\n' {
                    break;
                }
                self.ends.push(end);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tcross_dataset::{Record, dataset::BoxConvention};

    fn truth() -> Truth {
        let record = |name: &str| -> Record {
            serde_json::from_str(&format!(
                r#"{{"image":"{name}","width":10,"height":10,"markers":[{{"shape":"t_cross","box":[1,1,5,5]}}]}}"#
            ))
            .unwrap()
        };
        Truth::new(vec![record("a"), record("b"), record("c")], BoxConvention::Continuous, None)
    }

    const GOOD: [&str; 3] = [
        r#"{"image":"a","width":10,"height":10,"detections":[{"score":0.5,"class":0,"box":[1,1,5,5]}]}"#,
        r#"{"image":"b","width":10,"height":10,"detections":[]}"#,
        r#"{"image":"c","width":10,"height":10,"detections":[]}"#,
    ];

    fn read_lines(lines: &[&str], lenient: bool) -> Result<Reading<usize>, EvalError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), lines.join("\n")).unwrap();
        read(&truth(), file.path().into(), lenient, |_, row| row.detections.len())
    }

    #[test]
    fn every_fault_is_told_with_its_line_or_counted() {
        let with = |bad: &'static str, at: usize| {
            let mut lines = GOOD.to_vec();
            lines[at] = bad;
            lines
        };
        let mut twice = GOOD.to_vec();
        twice.push(GOOD[0]);
        let mut unknown = GOOD.to_vec();
        unknown.insert(1, r#"{"image":"z","width":10,"height":10,"detections":[]}"#);
        let cases = [
            (ProblemKind::UnknownImage, unknown, ":2: image 'z'"),
            (ProblemKind::MissingImage, GOOD[..2].to_vec(), "no line for 'c'"),
            (
                ProblemKind::BadScore,
                with(r#"{"image":"b","width":10,"height":10,"detections":[{"score":NaN,"class":0,"box":[1,1,5,5]}]}"#, 1),
                ":2: score NaN",
            ),
            (
                ProblemKind::BadScore,
                with(r#"{"image":"b","width":10,"height":10,"detections":[{"score":1.5,"class":0,"box":[1,1,5,5]}]}"#, 1),
                ":2: score 1.5",
            ),
            (
                ProblemKind::BadBox,
                with(r#"{"image":"c","width":10,"height":10,"detections":[{"score":1,"class":0,"box":[5,1,1,5]}]}"#, 2),
                ":3: box [5.0, 1.0, 1.0, 5.0]",
            ),
            (
                ProblemKind::BadBox,
                with(r#"{"image":"c","width":10,"height":10,"detections":[{"score":1,"class":0,"box":[1,1,Infinity,5]}]}"#, 2),
                ":3: box",
            ),
            (ProblemKind::DuplicateLine, twice, ":4: 'a' has detections on line 1"),
            (ProblemKind::OtherSize, with(r#"{"image":"b","width":9,"height":10,"detections":[]}"#, 1), ":2: 'b' is 9 x 10"),
            (ProblemKind::BadLine, with("{oops", 1), ":2:"),
        ];
        for (kind, lines, words) in cases {
            let message = read_lines(&lines, false).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(message.contains(words), "{kind:?}: {message}");
            let counted = read_lines(&lines, true).unwrap().problems;
            assert_eq!(counted.get(&kind), Some(&1), "{kind:?}");
        }
    }

    #[test]
    fn blocks_hold_whole_lines() {
        let text = "one\n\nthree\nlast";
        let mut file = tempfile::tempfile().unwrap();
        std::io::Write::write_all(&mut file, text.as_bytes()).unwrap();
        file.seek(SeekFrom::Start(0)).unwrap();
        let mut block = Block::default();
        block.fill(&mut file, b"zero and ").unwrap();
        assert_eq!(block.ends, [13, 14, 20]);
        let rest = block.bytes[20..].to_vec();
        block.fill(&mut file, &rest).unwrap();
        assert_eq!((block.bytes.as_slice(), block.ends.as_slice()), (&b"last"[..], &[4][..]));
        block.fill(&mut file, &[]).unwrap();
        assert!(block.ends.is_empty());
    }

    #[test]
    fn good_lines_are_scored_in_order_of_the_truth_and_found_again() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), [GOOD[2], "", GOOD[0], GOOD[1]].join("\n")).unwrap();
        let reading = read(&truth(), file.path().into(), false, |i, row| (i, row.detections.len())).unwrap();
        assert_eq!(reading.images, [Some((0, 1)), Some((1, 0)), Some((2, 0))]);
        assert_eq!(reading.located.detections(0)[0].score, 0.5);
        assert!(reading.located.detections(2).is_empty() && reading.located.detections(7).is_empty());
    }
}
