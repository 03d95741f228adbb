//! Ctrl-C: the first asks the work to stop where it can, the second ends at once.
use crate::exit::{Failure, Outcome};
use std::sync::{
    Arc, OnceLock,
    atomic::{AtomicBool, Ordering},
};

/// True once Ctrl-C was pressed; long work looks at it.
pub fn flag() -> Arc<AtomicBool> {
    static FLAG: OnceLock<Arc<AtomicBool>> = OnceLock::new();
    Arc::clone(FLAG.get_or_init(Arc::default))
}

/// Listens for Ctrl-C and for the signals by which systems end a job.
pub fn listen() -> Outcome {
    ctrlc::set_handler(|| {
        if flag().swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
        crate::console::note("stopping; once more to end at once");
    })?;
    Ok(())
}

/// An error where the user has asked to stop; `kept` says what was finished and how to go on.
pub fn check(kept: &str) -> Outcome {
    if flag().load(Ordering::SeqCst) { Err(Failure::Interrupted { kept: kept.into() }) } else { Ok(()) }
}
