//! Wrong words and wrong files: one line that says what, where, and what to do, and the right exit code.
use crate::{tcross, tcross_in, word};

#[test]
fn wrong_words_end_with_2_and_say_what_to_type() {
    let cases: [(&[&str], &str); 12] = [
        (&[], "type for instance: tcross reproduce configs/quickstart.toml"),
        (&["datagen"], "<CONFIG> is missing; type for instance: tcross datagen configs/presets/hand-drawn.toml"),
        (&["datagen", "configs/ci.toml"], "--out DIR is missing; type for instance: tcross datagen"),
        (&["dataset"], "one of check, stats, preview, audit, verify, convert, merge, split"),
        (&["infer", "model"], "INPUT is missing"),
        (&["reprodcue", "x"], "'reproduce'"),
        (&["train", "x", "--devcie", "cpu"], "'--device'"),
        (&["train", "x", "--device", "tpu"], "expected cpu, wgpu or cuda"),
        (&["datagen", "configs/ci.toml", "--shard", "3/3"], "I from 0 to N-1"),
        (&["dataset", "convert", "d", "--to", "yol"], "expected one of native, yolo"),
        (&["reproduce", "configs/ci.toml", "--set", "data.imges=3"], "unknown key `imges`; did you mean `images`?"),
        (&["eval", "a", "b", "--protocol", "papper"], "expected paper, coco or pose"),
    ];
    for (words, want) in cases {
        let ran = tcross(words.iter().copied());
        assert!(ran.error(2).contains(want), "{words:?}: {}", ran.stderr);
        assert!(ran.stdout.is_empty(), "{words:?}");
    }
}

#[test]
fn wrong_files_end_with_1_and_name_the_nearest() {
    let cases: [(&[&str], &str); 7] = [
        (
            &["datagen", "configs/quikstart.toml", "--out", "x"],
            "configs/quikstart.toml: no such config; did you mean 'configs/quickstart.toml'?",
        ),
        (
            &["datagen", "configs/ci.toml", "--out", "x", "--backgrounds", "configz"],
            "configz: no such folder of backgrounds; did you mean 'configs'?",
        ),
        (&["dataset", "check", "crates/datasett"], "no such dataset; did you mean 'crates/dataset'?"),
        (&["dataset", "check", "configs"], "no split"),
        (&["infer", "configs/ci.toml", "README.md"], "configs/ci.toml"),
        (&["model", "info", "no-such-model"], "no-such-model: no such model"),
        (&["datagen", "configs/ci.toml", "--out", "x", "--set", "data.width=7"], "data.width = 7: allowed is 32 to 8192"),
    ];
    for (words, want) in cases {
        let ran = tcross(words.iter().copied());
        assert!(ran.error(1).contains(want), "{words:?}: {}", ran.stderr);
    }
}

#[test]
fn a_wrong_key_has_file_and_line() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("wrong.toml");
    std::fs::write(&path, "seed = 1\n\n[train]\nbacth = 4\n").unwrap();
    let ran = tcross(["train".into(), word(&path)]);
    assert!(ran.error(1).ends_with("wrong.toml:4: unknown key `bacth`; did you mean `batch`?"), "{}", ran.stderr);
}

#[test]
fn the_effective_config_is_shown_with_comments() {
    let shown = tcross(["datagen", "configs/ci.toml", "--print-config", "--set", "data.images=77", "--seed", "9"]).good().stdout;
    assert!(
        shown.contains("# Width of an image in pixels.\nwidth = 96\n")
            && shown.contains("\nimages = 77\n")
            && shown.contains("\nseed = 9\n")
    );
}

/// Every command that takes a config shows it, whatever else it would need.
#[test]
fn every_command_shows_its_config() {
    let commands = [("datagen", true), ("train", true), ("infer", false), ("eval", false), ("reproduce", true)];
    for (command, needs_config) in commands {
        let words = [command, "--print-config", "--set", "seed=77"];
        let shown = tcross(words.iter().chain(needs_config.then_some(&"configs/ci.toml"))).good().stdout;
        assert!(shown.contains("\nseed = 77\n") && shown.contains("\n[eval]\n"), "{command}: {shown}");
    }
    let help = tcross(["--help"]).good().stdout;
    let all =
        help.lines().skip_while(|l| *l != "Commands:").skip(1).take_while(|l| !l.is_empty()).filter_map(|l| l.split_whitespace().next());
    for command in all.filter(|command| commands.iter().all(|(known, _)| known != command)) {
        assert!(!tcross([command, "--help"]).stdout.contains("--print-config"), "{command}");
    }
}

/// What is typed and does nothing is a slip, which is told.
#[test]
fn idle_options_are_told() {
    let dir = tempfile::tempdir().unwrap();
    image::RgbImage::new(8, 8).save(dir.path().join("a.png")).unwrap();
    let image = r#""image":"a.png","width":8,"height":8"#;
    std::fs::write(dir.path().join("found.jsonl"), format!("{{{image},\"detections\":[]}}\n")).unwrap();
    std::fs::write(dir.path().join("test.jsonl"), format!("{{{image},\"markers\":[]}}\n")).unwrap();
    std::fs::write(dir.path().join("a.toml"), "").unwrap();
    std::fs::write(dir.path().join("truth.json"), r#"{"images":[],"categories":[],"annotations":[]}"#).unwrap();
    let cases: [(&[&str], &str); 9] = [
        (&["infer", "a.png", "--boxes", "found.jsonl", "--fps", "3"], "--fps does nothing here: INPUT is neither a video nor a camera"),
        (&["infer", "a.png", "--boxes", "found.jsonl", "--smooth"], "--smooth does nothing here"),
        (&["infer", "camera:9", "--boxes", "found.jsonl", "--split", "val"], "--split does nothing here: INPUT is a video or a camera"),
        (&["eval", "test.jsonl", "found.jsonl", "--split", "test"], "--split does nothing here: test.jsonl is the list of one split"),
        (&["eval", "truth.json", "found.jsonl", "--split", "test"], "--split does nothing here: truth.json: COCO's files"),
        (&["eval", "truth.json", "found.jsonl", "--thresholds", "0.5"], "--thresholds does nothing here"),
        (&["eval", "truth.json", "found.jsonl", "--config", "a.toml"], "--config does nothing here"),
        (&["eval", "truth.json", "found.jsonl", "--set", "eval.seed=3"], "--set does nothing here"),
        (&["eval", "truth.json", "found.jsonl", "--protocol", "paper"], "--protocol does nothing here"),
    ];
    for (words, want) in cases {
        let ran = tcross_in(dir.path(), words);
        assert!(ran.error(2).contains(want), "{words:?}: {}", ran.stderr);
    }
    tcross_in(dir.path(), ["eval", "test.jsonl", "found.jsonl"]).good();
}

#[cfg(unix)]
#[test]
fn words_that_are_no_text_are_told_too() {
    use std::os::unix::ffi::OsStringExt;
    let strange = std::ffi::OsString::from_vec(vec![b'x', 0xff]);
    let ran = tcross(["eval".into(), strange, "--nonsense".into()]);
    assert!(ran.error(2).contains("'--nonsense'"), "{}", ran.stderr);
}

#[test]
fn every_config_is_valid() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
    let mut folders = vec![root];
    let mut seen = 0;
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "toml") {
                tcross(["reproduce".into(), word(&path), "--dry-run".into(), "--out".into(), "target/no-such-folder".into()]).good();
                seen += 1;
            }
        }
    }
    assert!(seen >= 7, "{seen}");
}
