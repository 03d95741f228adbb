//! Wrong words and wrong files: one line that says what, where, and what to do, and the right exit code.
use crate::{tcross, word};

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
