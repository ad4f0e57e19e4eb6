//! The memory and the file descriptors of this process, under the names that the client libraries
//! of Prometheus use. Linux only.

use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::{Registry, Unit};

/// Gauges of this process.
#[derive(Debug)]
pub(super) struct Process {
    resident: Gauge,
    open: Gauge,
    most: Gauge,
}

impl Process {
    /// Registers the gauges, if this system tells their values.
    pub(super) fn register(registry: &mut Registry) -> Option<Self> {
        let (resident, open, most) = (Gauge::default(), Gauge::default(), Gauge::default());
        let process = Self { resident, open, most };
        process.read()?;
        let memory = "Resident memory of this process";
        registry.register_with_unit("process_resident_memory", memory, Unit::Bytes, process.resident.clone());
        registry.register("process_open_fds", "Open file descriptors of this process", process.open.clone());
        registry.register("process_max_fds", "Most file descriptors of this process", process.most.clone());
        Some(process)
    }

    /// Sets the gauges; `None` if a value is unknown.
    pub(super) fn read(&self) -> Option<()> {
        let status = std::fs::read_to_string("/proc/self/status").ok()?;
        self.resident.set(number(&status, "VmRSS:")?.checked_mul(1024)?);
        let limits = std::fs::read_to_string("/proc/self/limits").ok()?;
        // No number if there is no limit.
        self.most.set(number(&limits, "Max open files").unwrap_or(i64::MAX));
        self.open.set(i64::try_from(std::fs::read_dir("/proc/self/fd").ok()?.count()).ok()?);
        Some(())
    }
}

/// The number that follows `name` in a line of a file of `/proc`.
fn number(text: &str, name: &str) -> Option<i64> {
    text.lines().find_map(|line| line.strip_prefix(name)?.split_whitespace().next()?.parse().ok())
}
