//! Our own form: `dataset.toml`, `{train,val,test}.jsonl`, pictures beside them.
use super::Labelled;
use crate::{Dataset, DatasetError, Record, dataset::DatasetHeader, digest, files};
use std::path::Path;

/// Reads it.
///
/// # Errors
/// If no split is there, or a line does not parse.
pub fn read(dir: &Path) -> Result<Labelled, DatasetError> {
    let dataset = Dataset::open(dir)?;
    let splits = dataset.splits().into_iter().map(|s| Ok((s, dataset.records(s)?))).collect::<Result<_, DatasetError>>()?;
    Ok(Labelled::in_folder(dir, dataset.header.boxes, splits))
}

/// Writes it. `dataset.toml` holds what every reader needs, and digests; how a set was made is not known here.
///
/// # Errors
/// If a picture is missing or the folder cannot be written.
pub fn write(set: &Labelled, out: &Path) -> Result<(), DatasetError> {
    set.place_pictures(out, |split, r| Path::new(split.name()).join(super::file_name(r)))?;
    for (split, rows) in &set.splits {
        let rows: Vec<_> =
            rows.iter().map(|i| Record { image: format!("{split}/{}", super::file_name(&i.record)), ..i.record.clone() }).collect();
        files::write_jsonl(out.join(format!("{split}.jsonl")), &rows)?;
    }
    let path = out.join("dataset.toml");
    let digests = digest::of_dataset(&Dataset { dir: out.to_owned(), header: DatasetHeader::default() })?;
    let header = DatasetHeader { format: 1, boxes: set.boxes, digests };
    let text = toml::to_string(&header).map_err(|e| DatasetError::line(&path, 1, e))?;
    files::write_atomically(path, text)
}
