//! Writes the commit the program was built from into it: datasets, runs and reports carry it.
use std::process::Command;

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

fn main() {
    let commit = git(&["describe", "--always", "--dirty", "--exclude=*"]).unwrap_or_else(|| "unknown".into());
    println!("cargo:rustc-env=TCROSS_COMMIT={commit}");
    // The log of HEAD grows with every commit, checkout and rebase.
    match git(&["rev-parse", "--path-format=absolute", "--git-path", "logs/HEAD"]) {
        Some(log) if std::path::Path::new(&log).exists() => println!("cargo:rerun-if-changed={log}"),
        _ => println!("cargo:rerun-if-changed=build.rs"),
    }
}
