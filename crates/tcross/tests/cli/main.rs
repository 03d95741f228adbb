//! The program as a user meets it: words in, words out, files, exit codes.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests may panic too")]
mod datasets;
mod evaluation;
mod help;
mod model;
mod reproduce;
mod train;
mod wrong_usage;

use std::{
    path::Path,
    process::{Command, Output},
};

/// Runs the program in the repository's root.
fn tcross<S: AsRef<std::ffi::OsStr>>(words: impl IntoIterator<Item = S>) -> Ran {
    tcross_in(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../.."), words)
}

/// Runs the program in a folder.
fn tcross_in<S: AsRef<std::ffi::OsStr>>(dir: &Path, words: impl IntoIterator<Item = S>) -> Ran {
    let output = Command::new(env!("CARGO_BIN_EXE_tcross")).args(words).current_dir(dir).output().expect("the program starts");
    Ran::from(output)
}

/// What came out.
struct Ran {
    code: i32,
    stdout: String,
    stderr: String,
}

impl From<Output> for Ran {
    fn from(output: Output) -> Self {
        let text = |bytes| String::from_utf8(bytes).expect("UTF-8");
        Self { code: output.status.code().unwrap_or(-1), stdout: text(output.stdout), stderr: text(output.stderr) }
    }
}

impl Ran {
    /// The same, having made sure that all went well.
    #[track_caller]
    fn good(self) -> Self {
        assert_eq!(self.code, 0, "{}{}", self.stdout, self.stderr);
        self
    }

    /// The one line of the error, having made sure that it is one and the last.
    #[track_caller]
    fn error(&self, code: i32) -> &str {
        assert_eq!(self.code, code, "{}{}", self.stdout, self.stderr);
        let errors: Vec<&str> = self.stderr.lines().filter(|l| l.starts_with("error: ")).collect();
        assert_eq!(errors.len(), 1, "{}", self.stderr);
        errors[0]
    }
}

/// A path as a word of a command.
fn word(path: &Path) -> String {
    path.to_str().expect("UTF-8").to_owned()
}
