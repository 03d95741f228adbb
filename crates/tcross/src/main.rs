//! The program `tcross`: words in, words out. Everything it does is done by the crates of the stages.
mod cli;
mod config;
mod console;
mod exit;
mod nearest;
mod stages;
mod stop;
mod work;

fn main() -> std::process::ExitCode {
    exit::guard(cli::run)
}
