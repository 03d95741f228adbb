//! `eval` of COCO's own files: instances as TRUTH, results as DETECTIONS. Such files hold boxes and scores only, so COCO's protocol is all
//! that is scored.
use super::eval::names_of;
use crate::{console, exit::Outcome};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use tcross_dataset::files;
use tcross_eval::{
    coco_json::{read_instances, read_results, score_instances},
    input::ProblemCounts,
    metrics,
    protocol::coco::CocoScores,
    report::{NamedTable, coco_scores},
};

/// Whether a truth is a file of COCO's instances.
pub fn is_instances(truth: &Path) -> bool {
    truth.extension().is_some_and(|e| e == "json") && truth.is_file()
}

/// Scores each file of results, prints the table and, in `out`, writes it beside `metrics.json`.
pub fn run(truth: &Path, results: &[PathBuf], out: Option<&Path>, lenient: bool) -> Outcome {
    let (instances, faults) = read_instances(truth, lenient)?;
    warn(truth, &faults);
    let mut rows: Vec<(String, CocoScores)> = Vec::new();
    let mut blocks: Vec<Value> = Vec::new();
    for (path, name) in results.iter().zip(names_of(results)) {
        super::must_exist(path, "file of results")?;
        let (results, mut problems) = read_results(path, &instances, lenient)?;
        warn(path, &problems);
        faults.iter().for_each(|(kind, n)| *problems.entry(*kind).or_default() += n);
        let scores = score_instances(&instances, &results);
        let mut block = json!({"coco": scores});
        if !problems.is_empty() {
            block["problems"] = metrics::problems(&problems);
        }
        blocks.push(block);
        rows.push((name, scores));
    }
    let named: Vec<(&str, CocoScores)> = rows.iter().map(|(name, scores)| (name.as_str(), *scores)).collect();
    let table = NamedTable::new("coco", coco_scores(&named));
    console::result(&format!("{}\n", table.table.markdown()));
    if let Some(out) = out {
        let metrics = match blocks.as_mut_slice() {
            [only] => only.take(),
            several => {
                several.iter_mut().zip(&rows).for_each(|(block, (name, _))| block["name"] = json!(name));
                json!({"compare": {"files": several}})
            }
        };
        files::create_dir(out)?;
        files::write_atomically(out.join("metrics.json"), format!("{metrics:#}\n"))?;
        table.write(out)?;
        console::note(&format!("{}", out.join("metrics.json").display()));
    }
    Ok(())
}

fn warn(path: &Path, problems: &ProblemCounts) {
    problems.iter().for_each(|(kind, n)| console::warn(&format!("{}: {n} {}", path.display(), kind.words())));
}
