//! The `oviduct` command.

/// glibc would keep the memory of closed connections; .cargo/config.toml has measurements.
#[cfg(not(target_env = "msvc"))]
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

fn main() -> std::process::ExitCode {
    oviduct::cli::run(std::env::args_os().skip(1))
}
