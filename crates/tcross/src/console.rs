//! What the user sees: results on stdout, talk on stderr. Nothing else in the program writes to either.
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::{
    io::{IsTerminal, Write},
    sync::{
        Mutex,
        atomic::{AtomicU8, AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

static QUIET: AtomicU8 = AtomicU8::new(0);
static VERBOSE: AtomicU8 = AtomicU8::new(0);
static WARNINGS: AtomicUsize = AtomicUsize::new(0);
static BAR: Mutex<Option<ProgressBar>> = Mutex::new(None);

/// Obeys `--quiet` and `-v`.
pub fn set(quiet: bool, verbose: u8) {
    QUIET.store(quiet.into(), Ordering::Relaxed);
    VERBOSE.store(verbose, Ordering::Relaxed);
}

/// How often `-v` was given.
pub fn verbosity() -> u8 {
    VERBOSE.load(Ordering::Relaxed)
}

fn quiet() -> bool {
    QUIET.load(Ordering::Relaxed) != 0
}

/// A result, to stdout. A reader that has gone away (`| head`) is no error.
pub fn result(text: &str) {
    let _ = writeln!(std::io::stdout().lock(), "{}", text.trim_end());
}

fn talk(line: &str) {
    let write = || {
        let _ = writeln!(std::io::stderr().lock(), "{line}");
    };
    match BAR.lock().ok().and_then(|bar| bar.clone()) {
        Some(bar) => bar.suspend(write),
        None => write(),
    }
}

/// Talk, unless `--quiet`.
pub fn note(line: &str) {
    if !quiet() {
        talk(line);
    }
}

/// Talk that only `-v` shows.
pub fn detail(line: &str) {
    if verbosity() > 0 {
        note(line);
    }
}

/// A warning: shown also with `--quiet`, and counted.
pub fn warn(line: &str) {
    WARNINGS.fetch_add(1, Ordering::Relaxed);
    talk(&format!("warning: {line}"));
}

/// The one line of an error.
pub fn error(line: &str) {
    talk(&format!("error: {line}"));
}

/// The last line, where there were warnings.
pub fn count_warnings() {
    match WARNINGS.load(Ordering::Relaxed) {
        0 => {}
        1 => note("1 warning"),
        n => note(&format!("{n} warnings")),
    }
}

/// Progress of one long piece of work: a bar on a terminal, otherwise a line every few seconds.
pub struct Progress {
    what: &'static str,
    bar: Option<ProgressBar>,
    total: u64,
    started: Instant,
    said: Instant,
}

impl Progress {
    /// Starts with nothing of `total` done; `what` is a word such as `datagen`.
    pub fn new(what: &'static str, total: u64) -> Self {
        let bar = (std::io::stderr().is_terminal() && !quiet()).then(|| {
            let style = ProgressStyle::with_template("{prefix:>9} {wide_bar} {pos}/{len} {eta:>4} {msg}")
                .unwrap_or_else(|_| ProgressStyle::default_bar());
            let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr_with_hz(8)).with_style(style).with_prefix(what);
            if let Ok(mut current) = BAR.lock() {
                *current = Some(bar.clone());
            }
            bar
        });
        Self { what, bar, total, started: Instant::now(), said: Instant::now() }
    }

    /// `done` of `total` are done; `message` is shown beside them.
    pub fn at(&mut self, done: u64, total: u64, message: &str) {
        self.total = total;
        if let Some(bar) = &self.bar {
            bar.set_length(total);
            bar.set_position(done);
            bar.set_message(message.to_owned());
        } else if self.said.elapsed() >= Duration::from_secs(5) {
            self.said = Instant::now();
            note(&format!("{}: {done}/{total} after {} {message}", self.what, seconds(self.started.elapsed())));
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
            if let Ok(mut current) = BAR.lock() {
                *current = None;
            }
        }
    }
}

/// A duration as people say it: `8.2 s`, `3 min 20 s`, `2 h 05 min`.
pub fn seconds(time: Duration) -> String {
    let whole = time.as_secs();
    match whole {
        0..60 => format!("{:.1} s", time.as_secs_f64()),
        60..3600 => format!("{} min {:02} s", whole / 60, whole % 60),
        _ => format!("{} h {:02} min", whole / 3600, whole / 60 % 60),
    }
}
