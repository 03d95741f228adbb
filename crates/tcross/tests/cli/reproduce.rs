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
    let missing = reproduce(dir.path(), TINY, &["--only", "train", "--force", "train"]);
    assert_eq!(missing.error(1).matches("infer: its files changed; run it first").count(), 1);
    let forced = reproduce(dir.path(), TINY, &["--force", "infer"]).good();
    assert!(forced.stderr.contains("data: still matches") && forced.stderr.contains("infer: done in"), "{}", forced.stderr);
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

#[test]
fn folders_of_others_are_left_alone() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("out/data");
    std::fs::create_dir_all(&data).unwrap();
    std::fs::write(data.join("precious"), "").unwrap();
    assert!(reproduce(dir.path(), TINY, &[]).error(1).contains("is there already and not from this experiment"));
    assert!(data.join("precious").is_file());
}
