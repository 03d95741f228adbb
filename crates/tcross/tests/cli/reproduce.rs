//! Whole experiments, as small as they get.
use crate::{Ran, tcross, word};
use std::path::Path;

const TINY: &str = r#"
seed = 3
[data]
images = 30
width = 64
height = 64
markers.side_px = "20..40"
[model]
architecture = "yolov3-tiny"
width = 0.0625
input = [64, 64]
[train]
epochs = 1
batch = 4
[eval]
bootstrap_draws = 50
[[expect]]
metric = "recall"
value = 0.0
source = "nobody"
"#;

const ROWS: &str = r#"
[[run]]
name = "One"
[[run]]
name = "Two, other data"
set.data.markers = { side_px = "10..20" }
network_of = "One"
"#;

fn reproduce(dir: &Path, config: &str, more: &[&str]) -> Ran {
    let path = dir.join("tiny.toml");
    std::fs::write(&path, config).unwrap();
    let words = ["reproduce".to_owned(), word(&path), "--out".into(), word(&dir.join("out"))];
    tcross(words.into_iter().chain(more.iter().map(|w| (*w).to_owned())))
}

#[test]
fn from_data_to_report_and_what_matches_is_skipped() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let plan = reproduce(dir.path(), TINY, &["--dry-run"]).good();
    assert!(plan.stdout.contains("data: would run (not done yet)") && !out.exists(), "{}", plan.stdout);

    let first = reproduce(dir.path(), TINY, &[]).good();
    for file in [
        "data/dataset.toml",
        "run/best.safetensors",
        "run/config.toml",
        "detections.jsonl",
        "eval/metrics.json",
        "report.html",
        "stages.toml",
    ] {
        assert!(out.join(file).is_file(), "{file}");
    }
    assert!(first.stdout.contains("mean IoU"), "{}", first.stdout);
    assert!(first.stdout.contains("expected: ours: recall") && first.stdout.trim_end().ends_with("(nobody): met"), "{}", first.stdout);

    let report = std::fs::read(out.join("report.html")).unwrap();
    let second = reproduce(dir.path(), TINY, &[]).good();
    assert_eq!(second.stderr.matches("still matches, skipped").count(), 4, "{}", second.stderr);
    assert_eq!((second.stdout, std::fs::read(out.join("report.html")).unwrap()), (first.stdout, report));

    // What changes asks for what depends on it, and for nothing else.
    let other = reproduce(dir.path(), TINY, &["--set", "infer.nms=0.3", "--dry-run"]).good();
    assert!(
        other.stderr.contains("train: still matches") && other.stdout.contains("infer: would run (its inputs changed)"),
        "{}{}",
        other.stdout,
        other.stderr
    );
    std::fs::remove_file(out.join("detections.jsonl")).unwrap();
    let missing = reproduce(dir.path(), TINY, &["--only", "eval"]);
    assert_eq!(missing.error(1).matches("infer: its files changed; run it first").count(), 1);
    let forced = reproduce(dir.path(), TINY, &["--force", "infer"]).good();
    assert!(forced.stderr.contains("data: still matches") && forced.stderr.contains("infer: done in"), "{}", forced.stderr);
}

#[test]
fn one_stage_alone_asks_for_nothing_after_it() {
    let dir = tempfile::tempdir().unwrap();
    reproduce(dir.path(), TINY, &["--only", "data"]).good();
    let out = dir.path().join("out");
    assert!(out.join("data/dataset.toml").is_file() && !out.join("run").exists() && !out.join("report.html").exists());
    assert!(reproduce(dir.path(), TINY, &["--only", "infer"]).error(1).contains("train: not done yet; run it first"));
}

#[test]
fn rows_of_a_table_have_folders_and_share_networks() {
    let dir = tempfile::tempdir().unwrap();
    let config = format!("{TINY}{ROWS}");
    let ran = reproduce(dir.path(), &config, &["--quiet"]).good();
    let out = dir.path().join("out");
    assert!(out.join("one/run/best.safetensors").is_file() && out.join("two-other-data/detections.jsonl").is_file());
    assert!(!out.join("two-other-data/run").exists());
    assert!(ran.stdout.contains("| One") && ran.stdout.contains("| Two, other data"), "{}", ran.stdout);
    assert_eq!(ran.stdout.matches("expected: ").count(), 2);
    assert!(ran.stderr.is_empty(), "{}", ran.stderr);

    let wrong = reproduce(dir.path(), &config.replace("network_of = \"One\"", "network_of = \"Once\""), &[]);
    assert!(wrong.error(1).contains("network_of 'Once' is no earlier run; did you mean 'One'?"));
    assert!(reproduce(dir.path(), &config, &["--row", "Won"]).error(2).contains("the config has no such row"));
}

/// A, B that borrows of A, C that borrows of B.
#[test]
fn networks_are_lent_along_a_chain_but_not_in_a_circle() {
    let dir = tempfile::tempdir().unwrap();
    let rows = "[[run]]\nname='A'\n[[run]]\nname='B'\nnetwork_of='A'\n[[run]]\nname='C'\nnetwork_of='B'\n";
    let config = format!("{TINY}{rows}");
    let plan = reproduce(dir.path(), &config, &["--row", "C", "--dry-run"]).good().stdout;
    let lines: Vec<&str> = plan.lines().filter_map(|l| l.split(':').next()).collect();
    assert_eq!(lines, ["A/data", "A/train", "A/infer", "B/data", "B/infer", "C/data", "C/infer", "eval"]);
    let ran = reproduce(dir.path(), &config, &["--row", "C", "--quiet"]).good();
    assert!(ran.stdout.contains("| C") && !dir.path().join("out/c/run").exists(), "{}", ran.stdout);
    let circle = reproduce(dir.path(), &config.replace("name='A'", "name='A'\nnetwork_of='C'"), &["--dry-run"]);
    assert!(circle.error(1).contains("run 'A': network_of 'C' is no earlier run"));
}

#[test]
fn an_expected_run_must_exist_before_anything_is_done() {
    let dir = tempfile::tempdir().unwrap();
    let config = |run: &str| format!("{}run = \"{run}\"\n{ROWS}", TINY.trim_start());
    let ran = reproduce(dir.path(), &config("Onne"), &[]);
    assert!(ran.error(1).contains("tiny.toml: expect: no run 'Onne'; did you mean 'One'?"), "{}", ran.stderr);
    assert!(!dir.path().join("out").exists());
    // A row that is not chosen is still a row.
    reproduce(dir.path(), &config("Two, other data"), &["--row", "One", "--dry-run"]).good();
}

#[test]
fn a_report_holds_only_what_was_just_made() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    assert!(reproduce(dir.path(), TINY, &[]).good().stdout.contains("short side"));
    std::fs::write(out.join("eval/mine.txt"), "").unwrap();
    let second = reproduce(dir.path(), TINY, &["--set", "eval.min_side_px=[]", "--set", "eval.gallery=0"]).good();
    assert!(second.stderr.contains("infer: still matches") && !second.stdout.contains("short side"), "{}", second.stdout);
    assert!(!out.join("eval/tables/min-side.md").exists() && !out.join("eval/galleries").exists());
    assert!(out.join("eval/tables/headline.md").is_file() && out.join("eval/mine.txt").is_file());
}

/// The file counts that training starts from, not only its name.
#[test]
fn other_weights_to_start_from_train_again() {
    let dir = tempfile::tempdir().unwrap();
    let start = dir.path().join("start.weights");
    let init = format!("train.init={}", word(&start));
    let words = ["--set", &init];
    std::fs::write(&start, "no weights").unwrap();
    assert!(reproduce(dir.path(), TINY, &words).error(1).contains("start.weights"));
    let plan = || reproduce(dir.path(), TINY, &[words[0], words[1], "--dry-run"]).good().stdout;
    assert!(plan().contains("train: would run (not finished)"), "{}", plan());
    std::fs::write(&start, "other").unwrap();
    assert!(plan().contains("train: would run (its inputs changed)"), "{}", plan());
}

/// Neither a file that is no picture nor one that ends early stops anything; each is named once.
#[test]
fn broken_photos_are_warned_of_once() {
    let dir = tempfile::tempdir().unwrap();
    let photos = dir.path().join("photos");
    std::fs::create_dir(&photos).unwrap();
    // Patchworks, each its own, and enough of them that no split has only the broken one.
    for k in 0..24u32 {
        let shade = |x: u32, y: u32, c: u32| ((x / 20 + 8 * (y / 20) + 64 * k + 2048 * c).wrapping_mul(2_654_435_761) >> 24) as u8;
        let pixel = |x, y| image::Rgb([shade(x, y, 0), shade(x, y, 1), shade(x, y, 2)]);
        image::RgbImage::from_fn(160, 120, pixel).save(photos.join(format!("{k}.png"))).unwrap();
    }
    std::fs::write(photos.join("none.png"), "no picture").unwrap();
    let whole = std::fs::read(photos.join("5.png")).unwrap();
    std::fs::write(photos.join("early.png"), &whole[..whole.len() / 2]).unwrap();
    let ran = reproduce(dir.path(), TINY, &["--backgrounds", &word(&photos)]).good();
    for name in ["none.png", "early.png"] {
        assert_eq!(ran.stderr.matches(&format!("warning: {name}: skipped")).count(), 1, "{}", ran.stderr);
    }
}

#[test]
fn folders_of_others_are_left_alone() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("out/data");
    std::fs::create_dir_all(&data).unwrap();
    std::fs::write(data.join("precious"), "").unwrap();
    assert!(reproduce(dir.path(), TINY, &[]).error(1).contains("is there already and not from this experiment"));
    assert!(data.join("precious").is_file());
}
