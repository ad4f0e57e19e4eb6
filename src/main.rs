//! The `oviduct` command.

/// glibc keeps the memory of connections that have closed (docs/performance.md, "Allocator").
#[cfg(not(target_env = "msvc"))]
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

fn main() -> std::process::ExitCode {
    oviduct::cli::run(std::env::args_os().skip(1))
}
