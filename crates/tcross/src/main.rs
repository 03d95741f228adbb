//! The program `tcross`: words in, words out. Everything it does is done by the crates of the stages.
mod cli;
mod config;
mod console;
mod exit;
mod nearest;
mod stages;
mod stop;
mod work;

/// A training step takes and frees the same large buffers again and again; nothing else keeps what it frees.
#[global_allocator]
static POOL: tcross_kernels::allocator::Pool = tcross_kernels::allocator::Pool::new();

fn main() -> std::process::ExitCode {
    exit::guard(cli::run)
}
