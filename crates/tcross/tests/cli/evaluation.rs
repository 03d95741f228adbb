//! `eval` from the command line: least sizes, sweeps, the threshold that validation chose.
use crate::{tcross, tcross_in, word};
use std::{fmt::Write, path::Path};

/// 60 images of a split with one marker each, of 10 to 39 px, more and more blurred, found below 24 px only where its number is
/// even; detections have rising scores, and every tenth image has a false positive of 15 px.
fn split(dir: &Path, name: &str) {
    let (mut truth, mut found) = (String::new(), String::new());
    for k in 0..60u32 {
        let image = format!(r#""image":"{name}/{k:05}.jpg","width":200,"height":200"#);
        let side = 10 + k / 2;
        let bounds = format!("[20,20,{0},{0}]", 20 + side);
        let blur = f64::from(k) / 100.0 * f64::from(side);
        writeln!(truth, r#"{{{image},"markers":[{{"shape":"t_cross","box":{bounds},"blur_px":{blur}}}]}}"#).unwrap();
        let mut claims = Vec::new();
        if side >= 24 || k % 2 == 0 {
            claims.push(format!(r#"{{"score":{},"class":0,"box":{bounds}}}"#, 0.4 + f64::from(k) / 100.0));
        }
        if k % 10 == 0 {
            claims.push(r#"{"score":0.35,"class":0,"box":[100,100,115,115]}"#.into());
        }
        writeln!(found, r#"{{{image},"detections":[{}]}}"#, claims.join(",")).unwrap();
    }
    std::fs::write(dir.join(format!("{name}.jsonl")), truth).unwrap();
    std::fs::write(dir.join(format!("found-{name}.jsonl")), found).unwrap();
}

fn dataset() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    split(dir.path(), "val");
    split(dir.path(), "test");
    dir
}

fn eval(dir: &Path, words: &[&str]) -> crate::Ran {
    let inside = |w: &&str| if w.ends_with(".jsonl") || *w == "." || *w == "out" { word(&dir.join(w)) } else { (*w).to_owned() };
    tcross(["eval".to_owned()].into_iter().chain(words.iter().map(inside)))
}

fn metrics(dir: &Path) -> serde_json::Value {
    serde_json::from_str(&std::fs::read_to_string(dir.join("out/metrics.json")).unwrap()).unwrap()
}

#[test]
fn least_sizes_and_the_threshold_of_validation() {
    let dir = dataset();
    let words = [".", "found-test.jsonl", "--validation", "found-val.jsonl", "--set", "eval.min_side_px=[24]", "--out", "out"];
    let ran = eval(dir.path(), &words).good();
    let paper = &metrics(dir.path())["paper"];
    // 32 markers of 24 px or more, all found; no false positive is that large.
    let at = &paper["min_side"][0];
    assert_eq!((at["markers"].as_u64(), at["ignored_markers"].as_u64()), (Some(32), Some(28)));
    assert_eq!((at["headline"]["precision"].as_f64(), at["headline"]["recall"].as_f64()), (Some(1.0), Some(1.0)));
    assert_eq!((paper["headline"]["fp"].as_u64(), paper["headline"]["tp"].as_u64()), (Some(6), Some(46)));
    // Above the false positives' score, up to the lowest score of a hit, F1 is highest.
    let chosen = &paper["chosen_on_validation"];
    assert!(chosen["threshold"].as_f64().is_some_and(|t| t > 0.35 && t <= 0.4), "{chosen}");
    assert_eq!(chosen["test"]["precision"].as_f64(), Some(1.0));
    assert!(ran.stdout.contains(">= 24 px") && ran.stdout.contains("ours at 0.36 *"), "{}", ran.stdout);

    let ran = eval(dir.path(), &[".", "found-test.jsonl", "--validation", "found-val.jsonl", "--validation", "found-val.jsonl"]);
    let message = ran.error(2);
    assert!(message.contains("2 files for 1 of DETECTIONS"), "{message}");
}

/// A list in the current folder, by its bare name: its dataset is found beside it, and so is the validation split.
#[test]
fn bare_names_are_found() {
    let dir = dataset();
    std::fs::write(dir.path().join("dataset.toml"), "format = 1\nboxes = \"inclusive\"\n").unwrap();
    tcross_in(dir.path(), ["eval", "test.jsonl", "found-test.jsonl", "--validation", "found-val.jsonl"]).good();
}

/// What was not asked for is not reported.
#[test]
fn one_protocol_alone() {
    let dir = dataset();
    let ran = eval(dir.path(), &[".", "found-test.jsonl", "--protocol", "coco", "--out", "out"]).good();
    assert!(ran.stdout.contains("AP50") && !ran.stdout.contains("The paper"), "{}", ran.stdout);
    let page = std::fs::read_to_string(dir.path().join("out/report.html")).unwrap();
    assert!(page.contains("AP50") && !page.contains("Figure 20") && !page.contains("FROC") && !page.contains("Tables 2 to 7"));
    let tables: Vec<_> = std::fs::read_dir(dir.path().join("out/tables")).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(tables.iter().all(|name| name.to_str().unwrap().starts_with("coco.")), "{tables:?}");
}

#[test]
fn a_sweep_is_a_curve() {
    let dir = dataset();
    eval(dir.path(), &["--sweep", "blur", ".", "found-test.jsonl", "--out", "out"]).good();
    let sweep = &metrics(dir.path())["sweeps"][0];
    let points = sweep["points"].as_array().unwrap();
    assert_eq!((sweep["factor"].as_str(), points.len(), points[2]["recall"].as_f64()), (Some("blur"), 3, Some(1.0)));
    assert_eq!(points[0]["recall"].as_f64(), Some(0.5));
    for file in ["tables/sweeps.md", "tables/sweep-blur.csv", "figures/sweep-blur.svg", "figures/sweep-blur.pdf", "report.html"] {
        assert!(dir.path().join("out").join(file).is_file(), "{file}");
    }

    assert!(eval(dir.path(), &["--sweep", "fog", ".", "found-test.jsonl"]).error(2).contains("'fog' is no factor"));
    assert!(eval(dir.path(), &["--sweep", "light", ".", "found-test.jsonl"]).error(1).contains("does not tell its light"));
    assert!(eval(dir.path(), &["--sweep", "blur", "."]).error(2).contains("3 values required"));
}

#[test]
fn faults_are_errors_with_a_line_or_counted() {
    let dir = dataset();
    let path = dir.path().join("found-test.jsonl");
    let good = std::fs::read_to_string(&path).unwrap();
    let first = good.lines().next().unwrap();
    std::fs::write(&path, format!("{good}{first}\n{{oops\n{}\n", first.replace("00000", "77777"))).unwrap();
    let ran = eval(dir.path(), &[".", "found-test.jsonl"]);
    let message = ran.error(1);
    assert!(message.contains("found-test.jsonl:61: 'test/00000.jpg' has detections on line 1") && message.contains("2 more"), "{message}");
    let ran = eval(dir.path(), &[".", "found-test.jsonl", "--lenient", "--out", "out"]).good();
    assert_eq!(metrics(dir.path())["problems"], serde_json::json!({"unknown_image": 1, "duplicate_line": 1, "bad_line": 1}));
    assert!(ran.stderr.contains("1 further lines for one image"), "{}", ran.stderr);
}

/// COCO's own files are scored as they are; what they cannot hold is said.
#[test]
fn cocos_files_are_scored_as_they_are() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        std::fs::write(dir.path().join(name), text).unwrap();
        word(&dir.path().join(name))
    };
    let truth = write(
        "instances.json",
        r#"{"images":[{"id":7,"file_name":"a.jpg","width":100,"height":100}],"categories":[{"id":1,"name":"marker"}],
            "annotations":[{"id":1,"image_id":7,"category_id":1,"bbox":[10,10,40,40],"area":1600,"iscrowd":0}]}"#,
    );
    let found = write("found.json", r#"[{"image_id":7,"category_id":1,"bbox":[10,10,40,30],"score":0.9}]"#);
    let strange = write("strange.json", r#"[{"image_id":8,"category_id":1,"bbox":[10,10,40,30],"score":0.9}]"#);
    let eval = |words: &[&str]| tcross(["eval"].iter().chain(words).map(|w| (*w).to_owned()));
    let out = word(&dir.path().join("out"));
    eval(&[&truth, &found, "--out", &out]).good();
    // IoU 0.75: a hit at six of the ten levels.
    let coco = &metrics(dir.path())["coco"];
    assert!((coco["ap"].as_f64().unwrap() - 0.6).abs() < 1e-9 && coco["ap50"].as_f64() == Some(1.0), "{coco}");
    assert!(dir.path().join("out/tables/coco.tex").is_file());
    let ran = eval(&[&truth, &strange]);
    let message = ran.error(1);
    assert!(message.contains("strange.json: result 0: is of image 8") && message.contains("--lenient"), "{message}");
    let ran = eval(&[&truth, &strange, "--lenient", "--out", &out]).good();
    assert_eq!(metrics(dir.path())["problems"], serde_json::json!({"unknown_image": 1}));
    assert!(ran.stderr.contains("strange.json: 1 lines or boxes for images that the truth lacks"), "{}", ran.stderr);
    let ran = eval(&[&truth, &found, "--protocol", "paper"]);
    let message = ran.error(2);
    assert!(message.contains("--protocol coco"), "{message}");
}
