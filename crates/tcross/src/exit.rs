//! How the program ends: 0 done, 1 failed, 2 wrong usage, 130 stopped by Ctrl-C.
use crate::console;
use std::{error::Error, fmt, panic, process::ExitCode};

/// Why a command did not finish.
#[derive(Debug)]
pub enum Failure {
    /// The words typed make no sense: exit code 2.
    Usage(String),
    /// The work failed: exit code 1, one line `error: what, where, what to do`.
    Failed {
        /// The one line.
        line: String,
        /// Shown by `-vv`.
        cause: Option<Box<dyn Error + Send + Sync>>,
    },
    /// Ctrl-C: exit code 130, everything finished so far is kept.
    Interrupted {
        /// What was kept and how to go on.
        kept: String,
    },
}

/// What every command returns.
pub type Outcome<T = ()> = Result<T, Failure>;

impl Failure {
    /// A failure that is said in one line.
    pub fn new(line: impl Into<String>) -> Self {
        Self::Failed { line: line.into(), cause: None }
    }

    /// Wrong usage.
    pub fn usage(line: impl Into<String>) -> Self {
        Self::Usage(line.into())
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Usage(line) | Self::Failed { line, .. } => f.write_str(line),
            Self::Interrupted { kept } => write!(f, "stopped; {kept}"),
        }
    }
}

/// Every library error is a failure in its own words.
impl<E: Error + Send + Sync + 'static> From<E> for Failure {
    fn from(error: E) -> Self {
        // Causes that the message does not already contain are joined to it.
        let mut line = error.to_string();
        let mut cause = error.source();
        while let Some(inner) = cause {
            let words = inner.to_string();
            if !line.contains(&words) {
                line = format!("{line}: {words}");
            }
            cause = inner.source();
        }
        Self::Failed { line: line.split('\n').map(str::trim).collect::<Vec<_>>().join(" "), cause: Some(Box::new(error)) }
    }
}

/// Runs the program: an error becomes its line and its exit code, and a panic, which is a fault of ours, one line too.
pub fn guard(run: impl FnOnce() -> Outcome + panic::UnwindSafe) -> ExitCode {
    if std::env::var_os("RUST_BACKTRACE").is_none() {
        panic::set_hook(Box::new(|info| {
            console::error(
                &format!("a fault of this program ({info}); please report it with the command that led here").replace('\n', " "),
            );
        }));
    }
    let code = match panic::catch_unwind(run) {
        Ok(Ok(())) => 0,
        Ok(Err(failure)) => {
            console::error(&failure.to_string());
            if let Failure::Failed { cause: Some(cause), .. } = &failure
                && console::verbosity() >= 2
            {
                console::note(&format!("{cause:#?}"));
            }
            match failure {
                Failure::Failed { .. } => 1,
                Failure::Usage(_) => 2,
                Failure::Interrupted { .. } => 130,
            }
        }
        Err(_) => 1,
    };
    console::count_warnings();
    ExitCode::from(code)
}
