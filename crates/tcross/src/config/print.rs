//! `--print-config`: every key with its comment and its effective value.
use super::schema::Schema;
use crate::exit::{Failure, Outcome};
use schemars::JsonSchema;
use serde::Serialize;
use std::fmt::Write;

/// The config as TOML that can be read back, each key under the comment of its field.
pub fn commented<T: Serialize + JsonSchema>(config: &T) -> Outcome<String> {
    let root = schemars::schema_for!(T).to_value();
    let text = toml::to_string(config).map_err(|e| Failure::new(format!("the config cannot be written: {e}")))?;
    let root = Schema::new(&root);
    let mut out = String::new();
    let mut section = Section { path: String::new(), schema: Some(root), seen: Vec::new() };
    for line in text.lines().filter(|l| !l.is_empty()) {
        if let Some(header) = line.strip_prefix('[') {
            section.close(&text, &mut out);
            let path = header.trim_matches(['[', ']']);
            section = Section { path: path.to_owned(), schema: place(root, path), seen: Vec::new() };
            out.push('\n');
            comment(&mut out, section.schema);
        } else if let Some((key, _)) = line.split_once(" = ") {
            section.seen.push(key.trim_matches('"').to_owned());
            comment(&mut out, section.schema.and_then(|s| s.field(key)));
        }
        let _ = writeln!(out, "{line}");
    }
    section.close(&text, &mut out);
    Ok(out)
}

/// The place of `a.b.c`; arrays of tables are entered.
fn place<'a>(root: Schema<'a>, path: &str) -> Option<Schema<'a>> {
    path.split('.').try_fold(root, |at, key| {
        let field = at.field(key.trim_matches('"'))?;
        Some(field.items().unwrap_or(field))
    })
}

fn comment(out: &mut String, at: Option<Schema>) {
    for line in at.and_then(|s| s.comment()).unwrap_or_default().lines() {
        let _ = writeln!(out, "# {line}");
    }
}

/// One `[section]` while its keys go by.
struct Section<'a> {
    path: String,
    schema: Option<Schema<'a>>,
    seen: Vec<String>,
}

impl Section<'_> {
    /// Keys that are not set, as comments; keys that are sections of their own come later in `text`.
    fn close(&self, text: &str, out: &mut String) {
        let Some((schema, fields)) = self.schema.and_then(|s| Some((s, s.fields()?))) else { return };
        for key in fields.keys().filter(|k| !self.seen.contains(k)) {
            let path = if self.path.is_empty() { key.clone() } else { format!("{}.{key}", self.path) };
            if !["[", "[["].iter().any(|open| text.contains(&format!("{open}{path}"))) {
                comment(out, schema.field(key));
                let _ = writeln!(out, "# {key} =");
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, load};

    #[test]
    fn what_is_printed_reads_back_and_every_key_has_its_comment() {
        let config = Config { backgrounds: Some("photos".into()), ..Config::default() };
        let text = commented(&config).unwrap();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("printed.toml");
        std::fs::write(&path, &text).unwrap();
        assert_eq!(commented(&load(Some(&path), &[]).unwrap()).unwrap(), text);
        let lines: Vec<&str> = text.lines().collect();
        let bare: Vec<&&str> =
            lines.windows(2).filter(|w| w[1].contains(" = ") && !w[1].starts_with('#') && !w[0].starts_with('#')).map(|w| &w[1]).collect();
        // Weights by name are words of the user's, not keys with comments.
        assert!(bare.iter().all(|l| l.split_once(" = ").is_some_and(|(_, v)| v.parse::<f64>().is_ok())), "{bare:#?}");
        assert!(text.contains("# max_minutes ="));
    }
}
