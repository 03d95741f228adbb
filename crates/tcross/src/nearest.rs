//! "Did you mean": the nearest known name for a word nobody knows.
use std::path::Path;
use tcross_dataset::files;

/// The candidate most like `word`, if any is like it enough to be a slip of the fingers.
pub fn name<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let likeness = |c: &str| strsim::jaro_winkler(&word.to_lowercase(), &c.to_lowercase());
    let best = candidates.into_iter().max_by(|a, b| likeness(a).total_cmp(&likeness(b)))?;
    (likeness(best) >= 0.75).then_some(best)
}

/// `; did you mean 'x'?`, or nothing.
pub fn hint<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> String {
    name(word, candidates).map_or(String::new(), |best| format!("; did you mean '{best}'?"))
}

/// `; did you mean 'dir/other'?` for a path that does not exist, from what lies beside it.
pub fn path_hint(path: &Path) -> String {
    let folder = files::folder_of(path);
    let Ok(entries) = std::fs::read_dir(folder) else {
        return format!("; the folder {} does not exist either", folder.display());
    };
    let mut beside: Vec<String> = entries.flatten().filter_map(|e| e.file_name().into_string().ok()).collect();
    beside.sort();
    let word = path.file_name().unwrap_or_default().to_string_lossy();
    name(&word, beside.iter().map(String::as_str))
        .map_or(String::new(), |best| format!("; did you mean '{}'?", path.with_file_name(best).display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_are_recognised_and_strangers_are_not() {
        let known = ["images", "seed", "width", "height"];
        assert_eq!(name("imgaes", known), Some("images"));
        assert_eq!(name("with", known), Some("width"));
        assert_eq!(name("quux", known), None);
        assert_eq!(hint("sed", known), "; did you mean 'seed'?");
    }

    #[test]
    fn files_too() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("quickstart.toml"), "").unwrap();
        assert!(path_hint(&dir.path().join("quikstart.toml")).ends_with("quickstart.toml'?"));
        assert!(path_hint(&dir.path().join("no/quickstart.toml")).contains("does not exist either"));
    }
}
