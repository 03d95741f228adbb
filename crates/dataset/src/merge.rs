//! Puts several sets into one: the shards of one job, or sets from different places.
use crate::{
    DatasetError,
    formats::{Gathering, Labelled},
};
use std::path::Path;

/// All pictures of all sets, in order of name. A name that an earlier set uses gets the set's number in front
/// (`2-00009.jpg`); shards of one job never collide.
///
/// # Errors
/// If no set is given, or the sets read their boxes differently.
pub fn merge(sets: &[(&Path, Labelled)]) -> Result<Labelled, DatasetError> {
    let Some((first_dir, first)) = sets.first() else { return Err(DatasetError::unfit("merge", "no dataset", "at least one")) };
    let mut merged = Gathering::new(first.boxes);
    for (k, (dir, set)) in sets.iter().enumerate() {
        if set.boxes != first.boxes {
            return Err(DatasetError::unfit(
                dir,
                format!("{:?} boxes", set.boxes),
                format!("{:?} boxes as in {}", first.boxes, first_dir.display()),
            ));
        }
        for (split, item) in set.items() {
            merged.add(split, item.clone(), &(k + 1).to_string());
        }
    }
    Ok(merged.finish())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{dataset::BoxConvention, digest, formats};

    #[test]
    fn nothing_is_lost_and_names_stay_apart() {
        let (a, b, out) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let set = |dir: &Path, seed| formats::tests::random_set(dir, seed, BoxConvention::Continuous);
        let merged = merge(&[(a.path(), set(a.path(), 1)), (b.path(), set(b.path(), 2))]).unwrap();
        formats::native::write(&merged, out.path()).unwrap();
        let back = formats::native::read(out.path()).unwrap();
        assert_eq!(back.records().count(), 18);
        assert!(out.path().join("test/2-00001.png").is_file() && out.path().join("test/00001.png").is_file());
        assert!(digest::verify(out.path()).unwrap().is_empty());
        let inclusive = formats::tests::random_set(b.path(), 2, BoxConvention::Inclusive);
        assert!(merge(&[(a.path(), set(a.path(), 1)), (b.path(), inclusive)]).is_err());
    }
}
