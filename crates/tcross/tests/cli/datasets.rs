//! Datasets through the commands: generated, checked, described, converted, put together.
use crate::{tcross, word};
use std::path::Path;

/// A small set of the smallest config.
fn datagen(out: &Path, more: &[&str]) {
    let mut words = vec!["datagen", "configs/ci.toml", "--images", "40", "--out"];
    let out = word(out);
    words.push(&out);
    words.extend(more);
    tcross(words).good();
}

/// Every file of a folder with its bytes, sorted.
fn contents(dir: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files = Vec::new();
    let mut folders = vec![dir.to_owned()];
    while let Some(folder) = folders.pop() {
        for path in std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
            } else {
                files.push((word(path.strip_prefix(dir).unwrap()), std::fs::read(path).unwrap()));
            }
        }
    }
    files.sort();
    files
}

#[test]
fn shards_become_the_whole_and_are_what_they_were() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    datagen(&at("whole"), &[]);
    for shard in ["0/3", "1/3", "2/3"] {
        datagen(&at(&shard[..1]), &["--shard", shard, "--threads", "1"]);
    }
    let merge = |parts: &[&str], out: &str| {
        let parts = parts.iter().map(|p| word(&at(p)));
        tcross(["dataset".to_owned(), "merge".to_owned()].into_iter().chain(parts).chain(["--out".to_owned(), word(&at(out))]))
    };
    merge(&["0", "1", "2"], "merged").good();
    let (whole, merged) = (contents(&at("whole")), contents(&at("merged")));
    assert_eq!(whole.iter().map(|f| &f.0).collect::<Vec<_>>(), merged.iter().map(|f| &f.0).collect::<Vec<_>>());
    for (a, b) in whole.iter().zip(&merged) {
        assert!(a.1 == b.1, "{} differs:\n{}\n{}", a.0, String::from_utf8_lossy(&a.1), String::from_utf8_lossy(&b.1));
    }
    assert!(merge(&["0", "2"], "half").error(1).contains("shards 1/3 are missing"));
    assert!(!at("half").exists(), "nothing is written of what is not whole");
    assert!(merge(&["0", "1", "2"], "merged").error(1).contains("is not empty"));

    // Each shard names the broken photos that it met.
    for (shard, photos) in [("0", "'b.jpg', 'c.jpg'"), ("2", "'a.jpg', 'c.jpg'")] {
        let path = at(shard).join("dataset.toml");
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replace("skipped = []", &format!("skipped = [{photos}]"))).unwrap();
    }
    merge(&["0", "1", "2"], "broken").good();
    let manifest: toml::Table = toml::from_str(&std::fs::read_to_string(at("broken/dataset.toml")).unwrap()).unwrap();
    assert_eq!(manifest["backgrounds"]["skipped"].to_string(), r#"["a.jpg", "b.jpg", "c.jpg"]"#);

    let verify = || tcross(["dataset".into(), "verify".into(), word(&at("merged"))]);
    assert!(verify().good().stderr.contains("as they were written"));
    let picture = at("merged/test/00009.jpg");
    let mut bytes = std::fs::read(&picture).unwrap();
    bytes.push(0);
    // The picture may be another name of the shard's: it is replaced, not written into.
    std::fs::remove_file(&picture).unwrap();
    std::fs::write(&picture, bytes).unwrap();
    assert!(verify().error(1).contains("test is not as it was written"));
}

#[test]
fn a_set_is_checked_described_shown_and_converted() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| word(&dir.path().join(name));
    datagen(&dir.path().join("set"), &[]);
    assert!(tcross(["dataset", "check", &at("set")]).good().stderr.contains("nothing is wrong"));
    let stats = tcross(["dataset", "stats", &at("set"), "--out", &at("stats")]).good();
    assert!(stats.stdout.contains("images: 28 train, 8 val, 4 test") && stats.stdout.contains("short side"));
    assert!(std::fs::read_to_string(at("stats/short-side.svg")).unwrap().starts_with("<svg"));
    tcross(["dataset", "preview", &at("set"), "--split", "train", "--out", &at("sheet.png"), "--tile", "64"]).good();
    assert_eq!(image::image_dimensions(at("sheet.png")).unwrap(), (6 * 68 + 4, 5 * 68 + 4));
    for format in ["yolo", "yolo-pose", "coco", "voc", "paper"] {
        tcross(["dataset", "convert", &at("set"), "--to", format, "--out", &at(format)]).good();
        let back = format!("{format}-back");
        tcross(["dataset", "convert", &at(format), "--to", "native", "--out", &at(&back)]).good();
        let stats = tcross(["dataset", "stats", &at(&back)]).good().stdout;
        assert!(stats.contains("images: 28 train, 8 val, 4 test"), "{format}: {stats}");
        assert_eq!(stats.lines().nth(1), tcross(["dataset", "stats", &at("set")]).good().stdout.lines().nth(1), "{format}");
    }
    tcross(["dataset", "split", &at("set"), "--parts", "1:1:0", "--out", &at("dealt")]).good();
    assert!(tcross(["dataset", "stats", &at("dealt")]).good().stdout.contains("images: 20 train, 20 val"));
}

#[test]
fn what_is_wrong_is_listed() {
    let dir = tempfile::tempdir().unwrap();
    datagen(dir.path(), &[]);
    std::fs::write(dir.path().join("val/00007.jpg"), "no picture").unwrap();
    let ran = tcross(["dataset".into(), "check".into(), word(dir.path())]);
    assert!(ran.stdout.contains("val/00007.jpg: unreadable image"), "{}", ran.stdout);
    assert!(ran.error(1).contains("1 unreadable image"));
}

#[test]
fn a_dataset_is_audited() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| word(&dir.path().join(name));
    let set = |images: &str, more: &[&str]| {
        let _ = std::fs::remove_dir_all(at("set"));
        let words =
            ["datagen", "configs/presets/paper-exact.toml", "--images", images, "--set", "data.width=128", "--set", "data.height=96"];
        let out = ["--out".to_owned(), at("set")];
        tcross(words.iter().chain(more).map(|w| (*w).to_owned()).chain(out)).good();
    };
    set("400", &[]);
    let audit = tcross(["dataset", "audit", &at("set"), "--out", &at("audit")]).good();
    assert!(
        audit.stdout.contains("place_x") && audit.stderr.contains("every distribution is as asked"),
        "{}{}",
        audit.stdout,
        audit.stderr
    );
    assert!(audit.stdout.contains("data.paper.at_sign_side = int 15..45: only the @ sign has it"), "{}", audit.stdout);
    assert!(std::fs::read_to_string(at("audit/correlations.svg")).unwrap().starts_with("<svg"));
    // What the description says is not what is there.
    let path = dir.path().join("set/dataset.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace("width = \"int 5..60\"", "width = \"int 5..40\"")).unwrap();
    let wrong = tcross(["dataset", "audit", &at("set")]);
    assert!(wrong.stdout.contains("<-- differs") && wrong.error(1).contains("1 distributions differ"), "{}", wrong.stdout);
    set("20", &[]);
    assert!(tcross(["dataset", "audit", &at("set")]).error(1).contains("too few images"));
}

#[test]
fn a_marker_is_drawn_to_print() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| word(&dir.path().join(name));
    let words =
        ["datagen", "marker", "--svg", &at("m.svg"), "--pdf", &at("m"), "--png", &at("m.png"), "--fill", "yellow", "--line", "#102030"];
    tcross(words.iter().copied().chain(["--side-mm", "40"])).good();
    let svg = std::fs::read_to_string(at("m.svg")).unwrap();
    assert!(svg.contains("fill=\"#ffe100\"") && svg.contains("stroke=\"#102030\"") && svg.contains("whole diagonal"));
    assert!(std::fs::read(at("m")).unwrap().starts_with(b"%PDF"));
    assert_eq!(image::image_dimensions(at("m.png")).unwrap(), (500, 500));
    assert!(tcross(["datagen", "marker"]).error(2).contains("--svg, --pdf or --png FILE is missing"));
    assert!(tcross(["datagen", "marker", "--png", "x.png", "--fill", "gren"]).error(2).contains("#rrggbb"));
    assert!(tcross(["datagen", "marker", "--svg", &at("n.svg"), "--side-mm", "1"]).error(1).contains("5 to 2000"));
}

#[test]
fn a_killed_run_is_resumed_to_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let words = |out: &str| {
        let words = ["datagen", "configs/presets/paper-exact.toml", "--images", "2000", "--threads", "1", "--quiet", "--out"];
        let small = ["--set", "data.width=80", "--set", "data.height=64", "--resume"];
        words.map(str::to_owned).into_iter().chain([word(&at(out))]).chain(small.map(str::to_owned)).collect::<Vec<_>>()
    };
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_tcross")).args(words("killed")).current_dir(root).spawn().unwrap();
    let parts = at("killed/.parts");
    let chunks =
        || std::fs::read_dir(&parts).map_or(0, |d| d.flatten().filter(|e| e.path().extension().is_some_and(|x| x == "jsonl")).count());
    while chunks() < 2 && child.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(!at("killed/dataset.toml").exists(), "it was killed before its end");
    tcross(words("killed")).good();
    tcross(words("whole")).good();
    assert!(contents(&at("killed")) == contents(&at("whole")));
}
