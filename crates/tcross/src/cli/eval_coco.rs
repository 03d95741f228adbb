//! `eval` of COCO's own files: instances as TRUTH, results as DETECTIONS. Such files hold boxes and scores only, so COCO's protocol is all
//! that is scored.
use super::eval::name_of;
use crate::{console, exit::Outcome};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use tcross_dataset::files;
use tcross_eval::{
    coco_json::{read_instances, read_results, score_instances},
    protocol::coco::CocoScores,
    report::{NamedTable, coco_scores},
};

/// Whether a truth is a file of COCO's instances.
pub fn is_instances(truth: &Path) -> bool {
    truth.extension().is_some_and(|e| e == "json") && truth.is_file()
}

/// Scores each file of results, prints the table and, in `out`, writes it beside `metrics.json`.
pub fn run(truth: &Path, results: &[PathBuf], out: Option<&Path>) -> Outcome {
    let instances = read_instances(truth)?;
    let mut scored: Vec<(String, CocoScores)> = Vec::new();
    for path in results {
        super::must_exist(path, "file of results")?;
        scored.push((name_of(path, results), score_instances(&instances, &read_results(path)?, path)?));
    }
    let rows: Vec<(&str, CocoScores)> = scored.iter().map(|(name, scores)| (name.as_str(), *scores)).collect();
    let table = NamedTable::new("coco", coco_scores(&rows));
    console::result(&format!("{}\n", table.table.markdown()));
    if let Some(out) = out {
        let block = |(name, scores): &(String, CocoScores)| json!({"name": name, "coco": scores});
        let metrics: Value = match scored.as_slice() {
            [(_, only)] => json!({"coco": only}),
            several => json!({"compare": {"files": several.iter().map(block).collect::<Vec<_>>()}}),
        };
        files::create_dir(out)?;
        files::write_atomically(out.join("metrics.json"), format!("{metrics:#}\n"))?;
        table.write(out)?;
        console::note(&format!("{}", out.join("metrics.json").display()));
    }
    Ok(())
}
