//! Layers of a config: read strictly one by one, then laid over each other.
use super::{Config, Extends, schema::Schema};
use crate::{
    exit::{Failure, Outcome},
    nearest,
};
use schemars::JsonSchema;
use serde::{Serialize, de::DeserializeOwned};
use std::path::{Path, PathBuf};
use tcross_dataset::files;
use toml::{Table, Value};

/// One layer: where it comes from, and its keys.
#[derive(Debug, Clone)]
pub struct Layer {
    table: Table,
}

impl Layer {
    /// Reads TOML text; `origin` names it in errors.
    fn parse<T: DeserializeOwned>(text: &str, origin: &str) -> Outcome<Self> {
        let explain = |e: &toml::de::Error| Failure::new(format!("{origin}{}: {}", line_of(text, e), sentence(e.message())));
        toml::from_str::<T>(text).map_err(|e| explain(&e))?;
        Ok(Self { table: toml::from_str(text).map_err(|e| explain(&e))? })
    }

    /// A file after all those it extends; `open` are the files that led here.
    fn chain<T: DeserializeOwned + JsonSchema>(path: &Path, open: &mut Vec<PathBuf>) -> Outcome<Vec<Self>> {
        if !path.is_file() {
            let by = open.last().map_or(String::new(), |p| format!(" (extended by {})", p.display()));
            return Err(Failure::new(format!("{}: no such config{by}{}", path.display(), nearest::path_hint(path))));
        }
        if open.iter().any(|p| p == path) {
            return Err(Failure::new(format!("{}: extends itself", path.display())));
        }
        open.push(path.to_owned());
        let mut layer = Self::parse::<T>(&files::read_text(path)?, &path.display().to_string())?;
        let parents = match layer.table.remove("extends") {
            Some(parents) => parents.try_into::<Extends>().map_err(|e| Failure::new(format!("{}: extends: {e}", path.display())))?,
            None => Extends::default(),
        };
        let beside = |parent: &Path| tidy(&path.with_file_name("").join(parent));
        let mut layers = Vec::new();
        for parent in parents.files() {
            layers.extend(Self::chain::<T>(&beside(parent), open)?);
        }
        let rows = layer.table.get_mut("run").and_then(Value::as_array_mut);
        for row in rows.into_iter().flatten().filter_map(Value::as_table_mut) {
            Self::inline::<T>(row, beside, open)?;
        }
        open.pop();
        layers.push(layer);
        Ok(layers)
    }

    /// Turns the files that a row extends into changes of the row, under its own.
    fn inline<T: DeserializeOwned + JsonSchema>(row: &mut Table, beside: impl Fn(&Path) -> PathBuf, open: &mut Vec<PathBuf>) -> Outcome {
        // It was read strictly already.
        let Some(Ok(parents)) = row.remove("extends").map(Value::try_into::<Extends>) else { return Ok(()) };
        let root = schemars::schema_for!(T).to_value();
        let mut set = Table::new();
        for parent in parents.files() {
            for layer in Self::chain::<T>(&beside(parent), open)? {
                lay(&mut set, layer.table, Schema::new(&root));
            }
        }
        if let Some(Value::Table(own)) = row.remove("set") {
            lay(&mut set, own, Schema::new(&root));
        }
        row.insert("set".into(), Value::Table(set));
        Ok(())
    }

    /// `section.key=value`; the value is TOML, or a bare word.
    fn set<T: DeserializeOwned>(assignment: &str) -> Outcome<Self> {
        let Some((key, value)) = assignment.split_once('=') else {
            return Err(Failure::usage(format!("--set {assignment}: expected section.key=value, such as --set train.epochs=5")));
        };
        let quoted = Value::String(value.trim().to_owned()).to_string();
        let text = match format!("x = {value}").parse::<Table>() {
            Ok(_) => format!("{key} = {value}"),
            Err(_) => format!("{key} = {quoted}"),
        };
        let layer = Self::parse::<T>(&text, "");
        layer
            .or_else(|e| Self::parse::<T>(&format!("{key} = {quoted}"), "").map_err(|_| e))
            .map_err(|e| Failure::usage(format!("--set {assignment}: {}", e.to_string().trim_start_matches([':', '1', ' ']))))
    }
}

/// `dir/../other` without the detour, so that messages read well.
fn tidy(path: &Path) -> PathBuf {
    path.components().fold(PathBuf::new(), |mut out, part| {
        if part.as_os_str() == ".." && out.file_name().is_some() {
            out.pop();
        } else {
            out.push(part);
        }
        out
    })
}

fn line_of(text: &str, error: &toml::de::Error) -> String {
    error.span().map_or(String::new(), |s| format!(":{}", text[..s.start].matches('\n').count() + 1))
}

/// serde's words with the nearest allowed name in place of a long list.
fn sentence(message: &str) -> String {
    let words: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    match words.split_first() {
        Some((found, allowed)) if message.starts_with("unknown") && !allowed.is_empty() => {
            match nearest::name(found, allowed.iter().copied()) {
                Some(best) => format!(
                    "{} `{found}`; did you mean `{best}`?",
                    if message.contains("variant") { "unknown value" } else { "unknown key" }
                ),
                None => message.replace("unknown field", "unknown key").replace("unknown variant", "unknown value"),
            }
        }
        _ => message.lines().map(str::trim).collect::<Vec<_>>().join("; "),
    }
}

/// Lays `above` over `below`: structs key by key, everything else as a whole.
fn lay(below: &mut Table, above: Table, schema: Schema) {
    for (key, value) in above {
        let field = schema.field(&key);
        match (below.get_mut(&key), value, field) {
            (Some(Value::Table(old)), Value::Table(new), Some(field)) if field.fields().is_some() => lay(old, new, field),
            (_, value, _) => {
                below.insert(key, value);
            }
        }
    }
}

fn merged<T: DeserializeOwned + JsonSchema>(layers: impl IntoIterator<Item = Layer>, origin: &str) -> Outcome<T> {
    let root = schemars::schema_for!(T).to_value();
    let mut table = Table::new();
    for layer in layers {
        lay(&mut table, layer.table, Schema::new(&root));
    }
    table.try_into().map_err(|e: toml::de::Error| Failure::new(format!("{origin}: {}", sentence(e.message()))))
}

/// The effective config of a file (or of none: the defaults) and of `--set`.
///
/// # Errors
/// Names file, line and key of the first thing that is wrong, and the nearest known name.
pub fn load(path: Option<&Path>, set: &[String]) -> Outcome<Config> {
    let mut layers = path.map_or(Ok(Vec::new()), |p| Layer::chain::<Config>(p, &mut Vec::new()))?;
    for assignment in set {
        layers.push(Layer::set::<Config>(assignment)?);
    }
    let origin = path.map_or("the defaults".into(), |p| p.display().to_string());
    merged(layers, &origin)
}

/// `config` with the keys of `change` laid over it; `origin` names the change in errors.
///
/// # Errors
/// If a key or a value is not known.
pub fn with(config: &Config, change: &impl Serialize, origin: &str) -> Outcome<Config> {
    let text = |value: Result<String, toml::ser::Error>| value.map_err(|e| Failure::new(format!("{origin}: {e}")));
    let base = Layer::parse::<Config>(&text(toml::to_string(config))?, origin)?;
    let change = text(toml::to_string(change))?;
    let change = Layer::parse::<Config>(&change, origin).map_err(|e| Failure::new(drop_line(&e.to_string(), origin)))?;
    merged([base, change], origin)
}

/// The line of a text nobody has seen is of no use.
fn drop_line(message: &str, origin: &str) -> String {
    match message.strip_prefix(origin) {
        Some(rest) => format!("{origin}: {}", rest.trim_start_matches(|c: char| c == ':' || c == ' ' || c.is_ascii_digit())),
        None => message.to_owned(),
    }
}

/// A digest of a section's effective values: equal for configs that mean the same.
pub fn digest_of(section: &impl Serialize) -> Outcome<String> {
    let text = toml::to_string(section).map_err(|e| Failure::new(format!("a section of the config cannot be written: {e}")))?;
    Ok(files::digest_bytes(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(dir: &Path, name: &str, text: &str) -> PathBuf {
        let path = dir.join(name);
        std::fs::write(&path, text).unwrap();
        path
    }

    #[test]
    fn later_layers_win_key_by_key() {
        let dir = tempfile::tempdir().unwrap();
        write(
            dir.path(),
            "base.toml",
            "seed = 1\n[data]\nimages = 10\nwidth = 64\n[data.markers]\nshapes = { t_cross = 1.0, star = 1.0 }\ncut = 0.5",
        );
        write(dir.path(), "recipe.toml", "[train]\nbatch = 3\n[data]\nwidth = 96");
        let path = write(dir.path(), "top.toml", "extends = ['base.toml', 'recipe.toml']\n[data.markers]\nshapes = { cross = 1.0 }");
        let config = load(Some(&path), &["data.images=30".into(), "data.markers.side_px=8..9".into()]).unwrap();
        assert_eq!((config.seed, config.data.images, config.data.width, config.train.batch), (1, 30, 96, 3));
        // Structs are merged; choices by weight are replaced as a whole.
        assert_eq!((config.data.markers.cut, config.data.markers.shapes.len()), (0.5, 1));
    }

    #[test]
    fn a_row_extends_files_of_its_own() {
        let dir = tempfile::tempdir().unwrap();
        write(dir.path(), "preset.toml", "seed = 9\n[data]\nimages = 10\nwidth = 64");
        let path = write(dir.path(), "top.toml", "[[run]]\nname = 'a'\nextends = 'preset.toml'\nset.data.width = 96");
        let config = load(Some(&path), &[]).unwrap();
        let row = with(&config, &config.run[0].set, "run 'a'").unwrap();
        assert_eq!((config.seed, row.seed, row.data.images, row.data.width), (0, 9, 10, 96));
        let path = write(dir.path(), "top.toml", "[[run]]\nname = 'a'\nextends = 'preset.tml'");
        assert!(load(Some(&path), &[]).unwrap_err().to_string().contains("preset.tml: no such config (extended by "));
    }

    #[test]
    fn errors_have_file_line_and_the_nearest_name() {
        let dir = tempfile::tempdir().unwrap();
        let cases = [
            ("seed = 1\n\n[data]\nimgaes = 3", "a.toml:4: unknown key `imgaes`; did you mean `images`?"),
            ("[data]\nimages = 'x'", "a.toml:2: invalid type"),
            ("[data]\nstyle = 'hand-drwn'", "a.toml:2: unknown value `hand-drwn`; did you mean `hand-drawn`?"),
            ("[data\n", "a.toml:1: "),
            ("extends = 'b.toml'", "b.toml: no such config (extended by "),
            ("extends = 'a.toml'", "a.toml: extends itself"),
        ];
        for (text, want) in cases {
            let path = write(dir.path(), "a.toml", text);
            let message = load(Some(&path), &[]).unwrap_err().to_string();
            assert!(message.contains(want), "{message}");
        }
        for (set, want) in
            [("data.imges=3", "did you mean `images`"), ("data", "expected section.key=value"), ("data.images=many", "invalid type")]
        {
            let message = load(None, &[set.into()]).unwrap_err().to_string();
            assert!(message.starts_with(&format!("--set {set}: ")) && message.contains(want), "{message}");
        }
    }

    #[test]
    fn a_change_is_laid_over_a_config() {
        let base = load(None, &["data.images=30".into()]).unwrap();
        let change: toml::Table = toml::from_str("[data]\nwidth = 64\n[eval.paper]\ntable = 5\nrow = 'T cross of thickness 2'").unwrap();
        let changed = with(&base, &change, "run 'x'").unwrap();
        assert_eq!((changed.data.images, changed.data.width, changed.eval.paper.map(|p| p.table)), (30, 64, Some(5)));
        let wrong: toml::Table = toml::from_str("[data]\nwidht = 64").unwrap();
        assert_eq!(with(&base, &wrong, "run 'x'").unwrap_err().to_string(), "run 'x': unknown key `widht`; did you mean `width`?");
    }
}
