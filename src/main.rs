//! The `oviduct` command.

fn main() -> std::process::ExitCode {
    oviduct::cli::run(std::env::args_os().skip(1))
}
