//! Trainings as a user runs them, as small as they get.
use crate::{tcross, word};
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
epochs = 2
batch = 4
"#;

/// Writes the config and draws the dataset; gives the words that train on it.
fn prepared(dir: &Path) -> Vec<String> {
    let config = dir.join("tiny.toml");
    std::fs::write(&config, TINY).unwrap();
    tcross(["datagen".into(), word(&config), "--out".into(), word(&dir.join("data"))]).good();
    ["train".into(), word(&config), "--data".into(), word(&dir.join("data")), "--out".into(), word(&dir.join("run"))].into()
}

#[test]
fn seeds_are_repeated_and_their_spread_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let words = prepared(dir.path());
    let repeat = |more: &[&str]| tcross(words.iter().map(String::as_str).chain(["--seeds", "2", "--quiet"]).chain(more.iter().copied()));
    let first = repeat(&[]).good();
    let lines: Vec<&str> = first.stdout.lines().collect();
    assert!(lines.len() == 6 && lines[0].starts_with("| seed | epoch | minutes | AP |"), "{}", first.stdout);
    assert!(lines[2].starts_with("| 3 |") && lines[3].starts_with("| 4 |") && lines[4].starts_with("| mean |"), "{}", first.stdout);
    assert!(std::fs::read_to_string(dir.path().join("run/seeds.csv")).unwrap().contains("\ndeviation,"));
    assert!(dir.path().join("run/seed-3/best.safetensors").is_file() && dir.path().join("run/seed-4/metrics.csv").is_file());
    assert!(repeat(&[]).error(1).contains("already holds a run"));
    // What is done is left as it is.
    assert_eq!(repeat(&["--resume"]).good().stdout, first.stdout);
}

/// Processor time over wall time, from the system's books: one thread cannot spend more than one second a second.
#[cfg(target_os = "linux")]
#[test]
fn one_thread_is_one_thread() {
    let dir = tempfile::tempdir().unwrap();
    let mut words = prepared(dir.path());
    words.extend(["--threads".into(), "1".into(), "--set".into(), "train.epochs=40".into(), "--quiet".into()]);
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let start = std::time::Instant::now();
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_tcross")).args(&words).current_dir(root).spawn().unwrap();
    let (mut ticks, mut wall) = (0, 0.0);
    while child.try_wait().unwrap().is_none() {
        if let Ok(stat) = std::fs::read_to_string(format!("/proc/{}/stat", child.id())) {
            let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
            if let [Some(user), Some(system)] = [11, 12].map(|k| fields.get(k).and_then(|f| f.parse::<u64>().ok())) {
                (ticks, wall) = (user + system, start.elapsed().as_secs_f64());
            }
        }
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    assert!(child.wait().unwrap().success());
    let busy = ticks as f64 / 100.0; // the kernel's clock ticks a second
    assert!(wall > 0.2, "too short to tell: {wall} s");
    assert!(busy < 1.1 * wall + 0.1, "{busy} s of processor time in {wall} s");
}

#[test]
fn what_cannot_be_trained_is_told_before_the_first_step() {
    let dir = tempfile::tempdir().unwrap();
    let words = prepared(dir.path());
    let with = |set: &str| tcross(words.iter().map(String::as_str).chain(["--set", set]));
    let huge = ["--set", "train.batch=4096", "--set", "train.multi_scale=[8192]"];
    let huge = tcross(words.iter().map(String::as_str).chain(huge));
    assert!(huge.error(1).contains("free; lower train.batch") || cfg!(not(target_os = "linux")));
    assert!(with("model.classes=2").error(1).contains("train.classes = 0 names: expected 2"));
    assert!(with("train.init='no.weights'").error(1).contains("no.weights"));
    assert!(with("model.anchors=[[1.0, 2.0]]").error(1).contains("model.anchors = 1 anchors: expected 6"));
    let list = dir.path().join("data/train.jsonl");
    let text = std::fs::read_to_string(&list).unwrap();
    let (before, rest) = text.split_once("\"box\":[").unwrap();
    std::fs::write(&list, format!("{before}\"box\":[900.0,{}", rest.split_once(',').unwrap().1)).unwrap();
    let error = with("train.epochs=1").error(1).to_owned();
    assert!(error.contains("train.jsonl:1: marker 0 of train/00000.jpg: box [900.0"), "{error}");
}
