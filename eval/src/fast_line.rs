//! The common line of a file of detections, read without a general parser: the keys in the contract's order, no poses. Whatever
//! else a line may hold is left to serde: this reader returns `None` and never an error.
use tcross_dataset::{Detection, ImageDetections, detections::StageTimes};

/// The detections of a line; `None` if it is not of the common form, right or wrong.
pub(crate) fn read(line: &[u8]) -> Option<ImageDetections> {
    let mut at = Cursor { rest: line };
    at.word("{")?;
    at.key("image")?;
    let image = at.text()?.to_owned();
    at.word(",")?;
    at.key("width")?;
    let width = at.whole()?;
    at.word(",")?;
    at.key("height")?;
    let height = at.whole()?;
    at.word(",")?;
    at.key("detections")?;
    at.word("[")?;
    // A detection takes 50 bytes and more.
    let mut detections = Vec::with_capacity(at.rest.len() / 50);
    if at.word("]").is_none() {
        loop {
            detections.push(at.detection()?);
            if at.word(",").is_none() {
                break;
            }
        }
        at.word("]")?;
    }
    let mut ms = None;
    if at.word(",").is_some() {
        at.key("ms")?;
        let end = at.rest.iter().rposition(|b| *b == b'}')?;
        ms = Some(serde_json::from_slice::<StageTimes>(&at.rest[..end]).ok()?);
        at.rest = &at.rest[end..];
    }
    at.word("}")?;
    at.rest.is_empty().then_some(ImageDetections { image, width, height, detections, ms })
}

/// What is left of a line.
struct Cursor<'a> {
    rest: &'a [u8],
}

impl<'a> Cursor<'a> {
    /// Passes over a word and the blanks behind it.
    fn word(&mut self, word: &str) -> Option<()> {
        self.rest = self.rest.strip_prefix(word.as_bytes())?;
        self.blanks();
        Some(())
    }

    fn blanks(&mut self) {
        while let [b' ' | b'\t', rest @ ..] = self.rest {
            self.rest = rest;
        }
    }

    /// Passes over `"name":`.
    fn key(&mut self, name: &str) -> Option<()> {
        let rest = self.rest.strip_prefix(b"\"")?.strip_prefix(name.as_bytes())?;
        self.rest = rest.strip_prefix(b"\"")?;
        self.blanks();
        self.word(":")
    }

    /// A text without escapes.
    fn text(&mut self) -> Option<&'a str> {
        let rest = self.rest.strip_prefix(b"\"")?;
        let end = rest.iter().position(|b| *b == b'"' || *b == b'\\' || *b < 0x20)?;
        self.rest = &rest[end..];
        self.word("\"")?;
        std::str::from_utf8(&rest[..end]).ok()
    }

    /// A whole number.
    fn whole(&mut self) -> Option<u32> {
        let digits = self.rest.iter().take_while(|b| b.is_ascii_digit()).count();
        let (number, rest) = self.rest.split_at(digits);
        if digits > 1 && number[0] == b'0' {
            return None;
        }
        self.rest = rest;
        self.blanks();
        std::str::from_utf8(number).ok()?.parse().ok()
    }

    fn detection(&mut self) -> Option<Detection> {
        self.word("{")?;
        self.key("score")?;
        let score = self.number()?;
        self.word(",")?;
        self.key("class")?;
        let class = self.whole()?;
        self.word(",")?;
        self.key("box")?;
        self.word("[")?;
        let mut sides = [0.0; 4];
        for (k, side) in sides.iter_mut().enumerate() {
            if k > 0 {
                self.word(",")?;
            }
            *side = self.number()?;
        }
        self.word("]")?;
        self.word("}")?;
        Some(Detection { score, class, bounds: sides.into(), pose: None })
    }

    /// A number as JSON writes it, rounded to the nearest double.
    fn number(&mut self) -> Option<f64> {
        let text = self.rest;
        let negative = text.first() == Some(&b'-');
        let mut end = usize::from(negative);
        let mut mantissa = 0u64;
        let mut digits = |end: &mut usize| {
            let start = *end;
            while let Some(b @ b'0'..=b'9') = text.get(*end) {
                mantissa = mantissa.wrapping_mul(10).wrapping_add(u64::from(b - b'0'));
                *end += 1;
            }
            *end - start
        };
        let before = digits(&mut end);
        if before == 0 || (before > 1 && text[usize::from(negative)] == b'0') {
            return None;
        }
        let mut after = 0;
        if text.get(end) == Some(&b'.') {
            end += 1;
            after = digits(&mut end);
            if after == 0 {
                return None;
            }
        }
        // Up to 15 digits and a power of ten up to 22 are exact doubles, and so is their quotient rounded.
        let simple = before + after <= 15 && !matches!(text.get(end), Some(b'e' | b'E'));
        let value = if simple {
            let v = mantissa as f64 / POWERS[after];
            if negative { -v } else { v }
        } else {
            if let Some(b'e' | b'E') = text.get(end) {
                end += 1;
                end += usize::from(matches!(text.get(end), Some(b'+' | b'-')));
                if digits(&mut end) == 0 {
                    return None;
                }
            }
            std::str::from_utf8(&text[..end]).ok()?.parse().ok().filter(|v: &f64| v.is_finite())?
        };
        self.rest = &text[end..];
        self.blanks();
        Some(value)
    }
}

const POWERS: [f64; 16] = [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15];

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// serde's reading, which may miss the nearest double by its last bit.
    fn agrees(line: &str) -> Option<bool> {
        let ours = read(line.as_bytes())?;
        let theirs: ImageDetections = serde_json::from_str(line).ok()?;
        let close = |a: f64, b: f64| (a - b).abs() <= 4.5e-16 * a.abs();
        let same = |(a, b): (&Detection, &Detection)| {
            let (x, y) = (<[f64; 4]>::from(a.bounds), <[f64; 4]>::from(b.bounds));
            a.class == b.class && a.pose == b.pose && close(a.score, b.score) && x.iter().zip(y).all(|(x, y)| close(*x, y))
        };
        let alike = ours.detections.iter().zip(&theirs.detections).all(same) && ours.detections.len() == theirs.detections.len();
        Some(alike && (&ours.image, ours.width, ours.height, ours.ms) == (&theirs.image, theirs.width, theirs.height, theirs.ms))
    }

    #[test]
    fn the_common_line_is_read_and_every_other_left_alone() {
        for line in [
            r#"{"image":"a","width":10,"height":10,"detections":[]}"#,
            r#"{"image":"ä/b.jpg","width":10,"height":10,"detections":[{"score":0.5,"class":0,"box":[1,-1.25,5e0,1.5E+2]}]}"#,
            r#"{"image": "a", "width": 10, "height": 10, "detections": [{"score": 0.5, "class": 0, "box": [1, 1, 5, 5]}, {"score": 1, "class": 3, "box": [1, 1, 5, 5]}]}"#,
            r#"{"image":"a","width":10,"height":10,"detections":[],"ms":{"decode":1.5,"network":2,"pose":0.1}}"#,
        ] {
            assert_eq!(agrees(line), Some(true), "{line}");
        }
        for line in [
            "",
            "{oops",
            r#"{"image":"a\n","width":10,"height":10,"detections":[]}"#,
            r#"{"image":"a","width":010,"height":10,"detections":[]}"#,
            r#"{"image":"a","width":10,"height":10,"detections":[]} x"#,
            r#"{"image":"a","width":10,"height":10,"detections":[,]}"#,
            r#"{"image":"a","width":10,"height":10,"detections":[{"score":NaN,"class":0,"box":[1,1,5,5]}]}"#,
            r#"{"image":"a","width":10,"height":10,"detections":[{"score":1e999,"class":0,"box":[1,1,5,5]}]}"#,
            r#"{"image":"a","width":10,"height":10,"detections":[{"score":.5,"class":0,"box":[1,1,5,5]}]}"#,
            r#"{"image":"a","width":10,"height":10,"detections":[{"score":01.5,"class":0,"box":[1,1,5,5]}]}"#,
            r#"{"image":"a","width":10,"height":10,"detections":[{"score":1.,"class":0,"box":[1,1,5,5]}]}"#,
            r#"{"image":"a","width":10,"height":10,"detections":[{"score":0.5,"class":0,"box":[1,1,5]}]}"#,
            r#"{"image":"a","width":10,"height":10,"detections":[{"score":0.5,"class":0,"box":[1,1,5,5],"pose":{"refused":"x"}}]}"#,
            r#"{"width":10,"image":"a","height":10,"detections":[]}"#,
        ] {
            assert!(read(line.as_bytes()).is_none(), "{line}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(7), ..ProptestConfig::default() })]

        #[test]
        fn numbers_are_the_nearest_doubles(v in any::<f64>().prop_filter("finite", |v| v.is_finite()), digits in 0usize..20) {
            for text in [v.to_string(), format!("{:.digits$}", v % 1e6), format!("{v:e}")] {
                let mut at = Cursor { rest: text.as_bytes() };
                prop_assert_eq!(at.number(), text.parse::<f64>().ok(), "{}", text);
                prop_assert!(at.rest.is_empty());
            }
        }

        #[test]
        fn what_is_read_is_what_serde_reads(
            rows in prop::collection::vec((0.0..=1.0f64, 0u32..9, prop::array::uniform4(-50.0..500.0f64)), 0..6), cut in 0usize..400, put in any::<u8>(),
        ) {
            let detections = rows.iter().map(|(score, class, b)| Detection { score: *score, class: *class, bounds: (*b).into(), pose: None }).collect();
            let row = ImageDetections { image: "test/00001.jpg".into(), width: 416, height: 300, detections, ms: None };
            let line = serde_json::to_string(&row).unwrap();
            prop_assert_eq!(agrees(&line), Some(true));
            // A byte changed: both read the same, or this reader leaves it to serde.
            let mut bytes = line.into_bytes();
            let place = cut % bytes.len();
            bytes[place] = put;
            if let (Some(_), Ok(text)) = (read(&bytes), std::str::from_utf8(&bytes)) {
                prop_assert_eq!(agrees(text), Some(true), "{}", text);
            }
        }
    }
}
