//! Darknet's cfg files.
use crate::{error::YoloError, graph::Graph};
use std::path::Path;

/// The layers of a cfg's text; `[net]` is passed over. `path` is only named in errors.
///
/// # Errors
/// A line that is not understood, or layers that do not fit together.
pub fn layers(path: impl AsRef<Path>, text: &str) -> Result<Graph, YoloError> {
    let _ = (path, text);
    todo!("next step")
}
