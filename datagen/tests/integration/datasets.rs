use std::{collections::BTreeMap, fs, path::Path, sync::atomic::AtomicBool};
use tcross_datagen::{Backgrounds, Config, DatagenError, Dist, GenerateOptions, Style, generate};
use tcross_dataset::{Dataset, Split};

fn small(style: Style) -> Config {
    Config { style, images: 20, width: 128, height: 96, markers: small_markers(), ..Default::default() }
}

fn small_markers() -> tcross_datagen::config::MarkersConfig {
    tcross_datagen::config::MarkersConfig { side_px: Dist::log(8.0, 96.0), ..Default::default() }
}

fn make(config: &Config, out: &Path, change: impl FnOnce(&mut GenerateOptions)) -> Result<tcross_datagen::Summary, DatagenError> {
    let mut options = GenerateOptions { out: out.to_owned(), seed: 5, ..Default::default() };
    change(&mut options);
    generate(config, &Backgrounds::embedded(), &options, &AtomicBool::new(false), &mut |_| {})
}

/// Every file's bytes, by name.
fn contents(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![dir.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                files.insert(path.strip_prefix(dir).unwrap().to_string_lossy().into_owned(), fs::read(&path).unwrap());
            }
        }
    }
    files
}

#[test]
fn bytes_do_not_depend_on_threads() {
    for style in [Style::HandDrawn, Style::Paper] {
        let made = [1, 2, 5].map(|threads| {
            let dir = tempfile::tempdir().unwrap();
            make(&small(style), dir.path(), |o| o.threads = Some(threads)).unwrap();
            contents(dir.path())
        });
        assert_eq!(made[0].len(), 20 + 6);
        assert!(made[0] == made[1] && made[0] == made[2]);
    }
}

#[test]
fn another_seed_makes_other_images() {
    let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    make(&small(Style::HandDrawn), a.path(), |_| {}).unwrap();
    make(&small(Style::HandDrawn), b.path(), |o| o.seed = 6).unwrap();
    let (a, b) = (contents(a.path()), contents(b.path()));
    assert!(a.iter().filter(|(name, _)| name.ends_with(".jpg")).all(|(name, bytes)| b[name] != *bytes));
}

#[test]
fn shards_and_single_images_are_parts_of_the_whole() {
    let whole = tempfile::tempdir().unwrap();
    make(&small(Style::HandDrawn), whole.path(), |_| {}).unwrap();
    let whole = contents(whole.path());
    let mut lines = BTreeMap::<String, Vec<u8>>::new();
    let mut pictures = 0;
    for index in 0..3 {
        let dir = tempfile::tempdir().unwrap();
        make(&small(Style::HandDrawn), dir.path(), |o| o.shard = Some((index, 3))).unwrap();
        for (name, bytes) in contents(dir.path()) {
            if name.ends_with(".jsonl") {
                lines.entry(name).or_default().extend(bytes);
            } else if name.ends_with(".jpg") {
                assert!(whole[&name] == bytes, "{name}");
                pictures += 1;
            }
        }
    }
    assert_eq!(pictures, 20);
    assert!(lines.iter().all(|(name, bytes)| whole[name] == *bytes));
    let dir = tempfile::tempdir().unwrap();
    make(&small(Style::HandDrawn), dir.path(), |o| o.only = Some(13)).unwrap();
    assert!(contents(dir.path())["train/00013.jpg"] == whole["train/00013.jpg"]);
}

#[test]
fn an_interrupted_run_is_resumed_to_the_same_bytes() {
    let config = Config { images: 600, width: 48, height: 48, ..small(Style::Paper) };
    let config = Config {
        paper: tcross_datagen::config::PaperConfig {
            width: Dist::int(5, 20),
            height: Dist::int(6, 20),
            at_sign_side: Dist::int(15, 20),
            ..config.paper
        },
        ..config
    };
    let (whole, cut) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    make(&config, whole.path(), |_| {}).unwrap();
    let options = GenerateOptions { out: cut.path().to_owned(), seed: 5, ..Default::default() };
    let stop = AtomicBool::new(false);
    let stopped =
        generate(&config, &Backgrounds::embedded(), &options, &stop, &mut |_| stop.store(true, std::sync::atomic::Ordering::Relaxed));
    assert!(matches!(stopped, Err(DatagenError::Stopped)));
    assert!(!cut.path().join("dataset.toml").exists());
    let other = make(&config, cut.path(), |o| (o.resume, o.seed) = (true, 6));
    assert!(matches!(other, Err(DatagenError::Mismatch { .. })));
    let summary = make(&config, cut.path(), |o| o.resume = true).unwrap();
    assert_eq!(summary.resumed, 256);
    assert!(contents(whole.path()) == contents(cut.path()));
}

#[test]
fn a_finished_dataset_is_never_lost_to_another() {
    let (config, dir) = (small(Style::HandDrawn), tempfile::tempdir().unwrap());
    make(&config, dir.path(), |_| {}).unwrap();
    let whole = contents(dir.path());
    let others: [fn(&mut GenerateOptions); 3] = [|o| o.only = Some(3), |o| o.shard = Some((0, 2)), |o| o.seed = 99];
    for other in others {
        for resume in [false, true] {
            let answer = make(&config, dir.path(), |o| {
                other(o);
                o.resume = resume;
            });
            assert!(matches!(answer, Err(DatagenError::Mismatch { .. })));
        }
    }
    // A job array sent again finds its part done.
    let again = make(&config, dir.path(), |o| o.resume = true).unwrap();
    assert_eq!(again.resumed, 20);
    assert!(contents(dir.path()) == whole);
    make(&config, dir.path(), |_| {}).unwrap();
    assert!(contents(dir.path()) == whole);
}

#[test]
fn truth_is_complete_and_inside() {
    let dir = tempfile::tempdir().unwrap();
    let config = Config { images: 60, ..small(Style::HandDrawn) };
    let summary = make(&config, dir.path(), |_| {}).unwrap();
    let dataset = Dataset::open(dir.path()).unwrap();
    let records: Vec<_> = Split::ALL.into_iter().flat_map(|s| dataset.records(s).unwrap()).collect();
    assert_eq!(records.len(), 60);
    let markers: Vec<_> = records.iter().flat_map(|r| &r.markers).collect();
    assert_eq!(markers.len() as u64, summary.manifest.markers);
    assert!(markers.len() > 30 && records.iter().any(|r| r.markers.is_empty()));
    for m in markers {
        assert!(m.bounds.is_valid() && m.bounds.x_min >= 0.0 && m.bounds.x_max <= 128.0 && m.bounds.y_max <= 96.0, "{:?}", m.bounds);
        let corners = m.corners.unwrap();
        assert!(corners.signed_area() > 0.0);
        let visible = m.visible.unwrap();
        assert!((0.0..=1.0).contains(&visible));
        let h = m.homography.unwrap();
        let first = h.apply([0.0, 0.0]);
        assert!((first[0] - corners.0[0][0]).abs() < 1e-6 && (first[1] - corners.0[0][1]).abs() < 1e-6);
        let mask: u32 = m.mask.as_ref().unwrap().iter().sum();
        assert!(mask <= 128 * 96);
    }
}

#[test]
fn a_full_folder_of_someone_else_is_left_alone() {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("train")).unwrap();
    fs::write(dir.path().join("train/mine.txt"), "precious").unwrap();
    make(&small(Style::Paper), dir.path(), |_| {}).unwrap();
    assert_eq!(fs::read(dir.path().join("train/mine.txt")).unwrap(), b"precious");
}

#[test]
fn a_dataset_says_what_it_is() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("README.md"), "mine").unwrap();
    make(&small(Style::HandDrawn), dir.path(), |_| {}).unwrap();
    assert_eq!(fs::read_to_string(dir.path().join("README.md")).unwrap(), "mine", "a card of someone else stays");
    let croissant: serde_json::Value = serde_json::from_slice(&fs::read(dir.path().join("croissant.json")).unwrap()).unwrap();
    assert_eq!(croissant["conformsTo"][0], "http://mlcommons.org/croissant/1.0");
    let responsible = croissant.as_object().unwrap().keys().filter(|k| k.starts_with("rai:")).count();
    assert!(responsible >= 12, "{responsible}");
    // Its records point at keys that are there.
    let lines = fs::read_to_string(dir.path().join("train.jsonl")).unwrap();
    let records = lines.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let record = records.into_iter().find(|r| !r["markers"].as_array().unwrap().is_empty()).unwrap();
    for field in croissant["recordSet"][0]["field"].as_array().unwrap() {
        let column = &record[field["source"]["extract"]["column"].as_str().unwrap()];
        match field["source"]["transform"]["jsonPath"].as_str() {
            Some(path) => assert!(column[0].get(path.trim_start_matches("$.")).is_some(), "{path}"),
            None => assert!(!column.is_null(), "{field}"),
        }
    }
    let other = tempfile::tempdir().unwrap();
    make(&small(Style::Paper), other.path(), |_| {}).unwrap();
    let card = fs::read_to_string(other.path().join("README.md")).unwrap();
    assert!(card.contains("20 images of 128x96 pixels with 20 annotated") && card.contains("| train | 14 |"), "{card}");
}

fn video() -> Config {
    let mut config = Config { images: 40, width: 192, height: 128, ..Default::default() };
    config.markers.per_image = Dist::constant(1.0);
    config.markers.side_px = Dist::log(30.0, 60.0);
    config.markers.hues = vec![0.0, 120.0, 240.0];
    config.markers.cut = 0.0;
    config.confusers.near_misses = Dist::constant(0.0);
    config.video.sequences = 8;
    config
}

#[test]
fn a_video_is_one_marker_in_one_split_that_moves() {
    let dir = tempfile::tempdir().unwrap();
    make(&video(), dir.path(), |o| o.threads = Some(2)).unwrap();
    let dataset = Dataset::open(dir.path()).unwrap();
    let mut videos: BTreeMap<u64, Vec<tcross_dataset::Record>> = BTreeMap::new();
    for record in Split::ALL.into_iter().flat_map(|s| dataset.records(s).unwrap()) {
        videos.entry(record.effects["video"]["sequence"].as_u64().unwrap()).or_default().push(record);
    }
    assert_eq!(videos.len(), 8);
    for (sequence, frames) in &videos {
        assert_eq!(frames.len(), 5);
        let of = |f: &dyn Fn(&tcross_dataset::Record) -> String| frames.iter().map(f).collect::<std::collections::BTreeSet<_>>().len();
        assert_eq!(of(&|r| r.image.split('/').next().unwrap().to_owned()), 1, "{sequence}: one split");
        assert_eq!(
            of(&|r| format!("{:?}", (r.markers[0].fill.clone(), r.markers[0].seed, r.background.clone()))),
            1,
            "{sequence}: one marker"
        );
        assert_eq!(of(&|r| format!("{:?}", r.markers[0].center)), 5, "{sequence}: it moves");
        let times: Vec<f64> = frames.iter().map(|r| r.effects["video"]["time_s"].as_f64().unwrap()).collect();
        assert!((times[1] - times[0] - 1.0 / 3.0).abs() < 1e-3);
    }
    // A frame alone is the same frame.
    let one = tempfile::tempdir().unwrap();
    make(&video(), one.path(), |o| o.only = Some(13)).unwrap();
    let name = dataset.records(Split::Train).unwrap()[13].image.clone();
    assert!(contents(one.path())[&name] == contents(dir.path())[&name]);
    let mut wrong = video();
    wrong.markers.per_image = Dist::int(0, 2);
    assert!(make(&wrong, one.path(), |_| {}).unwrap_err().to_string().contains("data.markers.per_image"));
}

/// A folder on a file system of its own, of so many KiB; `None` where this process may not mount one.
struct Disk(std::path::PathBuf);

impl Disk {
    fn new(dir: &Path, kib: u32) -> Option<Self> {
        let mounted = std::process::Command::new("mount").args(["-t", "tmpfs", "-o", &format!("size={kib}k"), "tmpfs"]).arg(dir).output();
        let done = mounted.is_ok_and(|m| m.status.success());
        if !done {
            eprintln!("skipped: no right to mount a small disk");
        }
        done.then(|| Self(dir.to_owned()))
    }

    fn remount(&self, how: &str) {
        let done = std::process::Command::new("mount").args(["-o", &format!("remount,{how}")]).arg(&self.0).status();
        assert!(done.unwrap().success());
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = std::process::Command::new("umount").arg(&self.0).status();
    }
}

#[test]
fn a_full_or_read_only_disk_loses_nothing_that_was_finished() {
    let dir = tempfile::tempdir().unwrap();
    let Some(disk) = Disk::new(dir.path(), 2600) else { return };
    let out = dir.path().join("set");
    let config = Config { images: 800, ..small(Style::Paper) };
    let full = make(&config, &out, |_| {}).unwrap_err().to_string();
    assert!(full.contains(&out.display().to_string()) && full.to_lowercase().contains("space"), "{full}");
    let finished =
        fs::read_dir(out.join(".parts")).unwrap().filter(|e| e.as_ref().unwrap().path().extension().is_some_and(|e| e == "jsonl")).count();
    assert!(finished >= 1, "the disk holds one chunk at least");
    disk.remount("ro");
    let locked = make(&config, &out, |o| o.resume = true).unwrap_err().to_string();
    assert!(locked.contains(&out.display().to_string()) && locked.to_lowercase().contains("read-only"), "{locked}");
    disk.remount("rw,size=32m");
    let resumed = make(&config, &out, |o| o.resume = true).unwrap();
    assert_eq!(resumed.resumed, 256 * finished as u64);
    let whole = tempfile::tempdir().unwrap();
    make(&config, whole.path(), |_| {}).unwrap();
    assert!(contents(whole.path()) == contents(&out));
}
