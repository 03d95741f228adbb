//! Finding and reading the reference files.
use std::path::{Path, PathBuf};

/// A folder of the reference data, or none (with a message) where it is absent.
pub fn folder(name: &str) -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let shared = if beside.is_dir() { beside } else { PathBuf::from(std::env::var_os("TCROSS_SHARED").unwrap_or_default()) };
    let dir = shared.join("golden").join(name);
    if !dir.is_dir() {
        eprintln!("skipped: no reference data at {}", dir.display());
        return None;
    }
    Some(dir)
}

/// Shape and values of a `.npy` file of little-endian float32 in C order.
pub fn npy(path: impl AsRef<Path>) -> (Vec<usize>, Vec<f32>) {
    let bytes = std::fs::read(path.as_ref()).unwrap_or_else(|e| panic!("{}: {e}", path.as_ref().display()));
    assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
    let start = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let header = std::str::from_utf8(&bytes[10..start]).unwrap();
    assert!(header.contains("'<f4'") && header.contains("'fortran_order': False"), "{header}");
    let shape = header.split('(').nth(1).unwrap().split(')').next().unwrap();
    let shape: Vec<usize> = shape.split(',').filter_map(|n| n.trim().parse().ok()).collect();
    let values: Vec<f32> = bytes[start..].as_chunks::<4>().0.iter().map(|w| f32::from_le_bytes(*w)).collect();
    assert_eq!(values.len(), shape.iter().product::<usize>());
    (shape, values)
}

pub fn json(path: impl AsRef<Path>) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

pub fn max_difference(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(x, y)| (x - y).abs()).fold(0.0, f32::max)
}
