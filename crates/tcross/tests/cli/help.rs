//! A snapshot of every `--help`. `UPDATE_SNAPSHOTS=1` writes them anew; then look at the difference.
use crate::tcross;
use std::path::Path;

const COMMANDS: [&str; 21] = [
    "",
    "datagen",
    "datagen marker",
    "dataset",
    "dataset check",
    "dataset stats",
    "dataset preview",
    "dataset audit",
    "dataset verify",
    "dataset convert",
    "dataset merge",
    "dataset split",
    "train",
    "infer",
    "eval",
    "reproduce",
    "model",
    "model info",
    "model import",
    "model export",
    "completions",
];

#[test]
fn every_help_is_as_it_was_reviewed() {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cli/help");
    let update = std::env::var_os("UPDATE_SNAPSHOTS").is_some();
    for command in COMMANDS {
        let text = tcross(command.split_whitespace().chain(["--help"])).good().stdout;
        assert!(text.contains("Example:\n  tcross "), "{command}: no example");
        let path = dir.join(format!("tcross {command}").trim().replace(' ', "-") + ".txt");
        if update {
            std::fs::create_dir_all(&dir).unwrap();
            std::fs::write(&path, &text).unwrap();
        }
        let reviewed = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(text == reviewed, "tcross {command} --help differs from {}:\n{text}", path.display());
    }
}

#[test]
fn every_command_is_listed_here() {
    let listed = |parent: &str| -> Vec<String> {
        let text = tcross(parent.split_whitespace().chain(["--help"])).good().stdout;
        let commands = text.lines().skip_while(|l| *l != "Commands:").skip(1).take_while(|l| !l.is_empty());
        commands
            .filter(|l| l.starts_with("  ") && !l.starts_with("   "))
            .filter_map(|l| l.split_whitespace().next())
            .map(str::to_owned)
            .collect()
    };
    for parent in ["", "datagen", "dataset", "model"] {
        for name in listed(parent) {
            let full = format!("{parent} {name}");
            assert!(COMMANDS.contains(&full.trim()), "{full} has no snapshot");
        }
    }
}

#[test]
fn completions_are_written() {
    assert!(tcross(["completions", "bash"]).good().stdout.contains("reproduce"));
}
