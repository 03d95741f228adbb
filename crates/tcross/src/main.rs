//! The program `tcross`.
fn main() {}
