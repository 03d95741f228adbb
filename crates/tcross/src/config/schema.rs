//! What is known of a config from its types: which tables are structs, and the comment of every key.
use serde_json::{Map, Value};

/// A JSON Schema and a place in it.
#[derive(Clone, Copy)]
pub struct Schema<'a> {
    root: &'a Value,
    here: &'a Value,
}

impl<'a> Schema<'a> {
    /// The whole schema.
    pub fn new(root: &'a Value) -> Self {
        Self { root, here: root }
    }

    /// The comment at this place: the key's own, not its type's.
    pub fn comment(&self) -> Option<&'a str> {
        self.here.get("description").and_then(Value::as_str)
    }

    /// The keys of a struct; `None` for values, choices and free tables.
    pub fn fields(&self) -> Option<&'a Map<String, Value>> {
        let target = self.resolved();
        let closed = target.get("additionalProperties") == Some(&Value::Bool(false));
        target.get("properties").and_then(Value::as_object).filter(|_| closed)
    }

    /// The place of a key of a struct.
    pub fn field(&self, key: &str) -> Option<Self> {
        Some(Self { root: self.root, here: self.fields()?.get(key)? })
    }

    /// The items of an array.
    pub fn items(&self) -> Option<Self> {
        Some(Self { root: self.root, here: self.resolved().get("items")? })
    }

    /// Follows references, and `anyOf` of something and null, which is what an optional value looks like.
    fn resolved(&self) -> &'a Value {
        let mut at = self.here;
        loop {
            let optional = at
                .get("anyOf")
                .and_then(Value::as_array)
                .and_then(|all| all.iter().find(|v| v.get("type").and_then(Value::as_str) != Some("null")));
            if let Some(name) = at.get("$ref").and_then(Value::as_str).and_then(|r| r.strip_prefix("#/$defs/")) {
                match self.root.get("$defs").and_then(|d| d.get(name)) {
                    Some(target) => at = target,
                    None => return at,
                }
            } else if let Some(inner) = optional {
                at = inner;
            } else {
                return at;
            }
        }
    }
}
