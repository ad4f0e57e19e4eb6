//! A driver whose allocations fail.

use crate::common::{Kept, found, no_vulkan, open, plan};
use crate::memory::{plans, refused};
use oviduct::sim::gpu::{AdapterKind, GpuDevice, run_batch};
use serde_json::json;
use std::process::Command;

/// Environment variable of the child process that runs out of memory.
const CHILD: &str = "OVIDUCT_TEST_MEMORY_CHILD";

/// Allocations of the driver itself fail, because the test limits the address space of a child
/// process. Only a software adapter keeps its memory in that address space.
#[test]
fn a_driver_without_memory_is_distinguished_from_other_faults() {
    if no_vulkan() || found()[0].kind != AdapterKind::Software {
        return;
    }
    if std::env::var_os(CHILD).is_none() {
        let mut child = Command::new(std::env::current_exe().unwrap());
        child.args(["--exact", "starved::a_driver_without_memory_is_distinguished_from_other_faults", "--nocapture"]);
        let output = child.env(CHILD, "1").output().unwrap();
        let told = String::from_utf8_lossy(&output.stdout);
        print!("{told}{}", String::from_utf8_lossy(&output.stderr));
        assert!(output.status.success() && told.contains("1 passed"), "{:?}", output.status);
        return;
    }
    let device = open();
    // Run a batch first, so that the driver has made its one-time allocations.
    run_batch(&device, &plans(1), &mut Kept::new(1)).unwrap();
    let large = plan(
        &json!({ "particles": { "total": { "keys": [[0, 50_000], [1, 60_000]] }, "outer": 90 }, "wall": { "lobing": 0 } }),
        1,
    );
    let large = vec![large; 8];
    let wanted = GpuDevice::batch_bytes(&large[0], large.len());
    assert!(wanted > 400 << 20, "{wanted}");
    limit_address_space(Some(wanted / 2));
    refused(&device, &large);
    run_batch(&device, &plans(2), &mut Kept::new(2)).unwrap();
    limit_address_space(None);
}

/// Limits the address space of this process to its current size plus `more` bytes, or removes the
/// limit.
fn limit_address_space(more: Option<u64>) {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let has = status.lines().find_map(|line| line.strip_prefix("VmSize:")?.trim().strip_suffix(" kB")).unwrap();
    let limit = more.map_or("unlimited".to_owned(), |more| (1024 * has.parse::<u64>().unwrap() + more).to_string());
    let pid = std::process::id().to_string();
    // Set only the soft limit, so that it can be removed again.
    let done = Command::new("prlimit").args(["--pid", &pid, &format!("--as={limit}:")]).status().unwrap();
    assert!(done.success(), "prlimit (Debian package util-linux) failed");
}
