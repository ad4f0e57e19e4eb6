//! Device memory: what is not given ends in an error of its own and leaves nothing behind, and what was given comes back
//! after every batch.

use crate::common::{Kept, leave, no_vulkan, open, open_with, plan, short};
use oviduct::sim::Plan;
use oviduct::sim::gpu::{GpuDevice, GpuError, run_batch};
use serde_json::json;
use std::process::Command;

/// What a batch takes besides what [`GpuDevice::batch_bytes`] counts: constants, the clock, alignment.
const MORE: u64 = 200_000;

fn plans(members: u64) -> Vec<Plan> {
    (1..=members).map(short).collect()
}

/// Runs a batch that does not get its memory: nothing is told, and nothing is left of it.
fn refused(device: &GpuDevice, plans: &[Plan]) {
    let before = device.memory_in_use().unwrap();
    let mut kept = Kept::new(plans.len());
    assert_eq!(run_batch(device, plans, &mut kept).unwrap_err(), GpuError::OutOfMemory);
    assert!(kept.sections.iter().all(Vec::is_empty) && kept.reached.iter().all(|&step| step == i64::MIN));
    assert_eq!(device.memory_in_use().unwrap(), before);
    assert!(!device.is_lost());
}

#[test]
fn a_batch_beyond_the_memory_is_refused_and_smaller_ones_run() {
    if no_vulkan() {
        return;
    }
    let two = GpuDevice::batch_bytes(&short(1), 2);
    let device = open_with(&leave(two + MORE));
    refused(&device, &plans(3));
    let mut kept = Kept::new(2);
    run_batch(&device, &plans(2), &mut kept).unwrap();
    assert!(kept.finished.iter().all(Option::is_some));
    refused(&device, &plans(4));
}

#[test]
fn memory_is_given_back_after_every_batch() {
    if no_vulkan() {
        return;
    }
    // Two batches at a time would not find room.
    let device = open_with(&leave(GpuDevice::batch_bytes(&short(1), 2) + MORE));
    // Once anything was done: a device keeps a few bytes until then.
    run_batch(&device, &plans(1), &mut Kept::new(1)).unwrap();
    let idle = device.memory_in_use().unwrap();
    let mut bad = plans(2);
    bad[1].rows[10].stiffness = f32::NAN;
    for round in 0..9 {
        let mut kept = Kept::new(2);
        match round % 3 {
            0 => {}
            // Everything is cancelled with work in flight.
            1 => kept.cancel = Some((0, -19)),
            _ => kept.cancel = Some((0, 10)),
        }
        let plans = if round % 3 == 1 { &plans(1) } else { &bad };
        run_batch(&device, plans, &mut kept).unwrap();
        assert_eq!(device.memory_in_use().unwrap(), idle, "round {round}");
    }
}

/// Set for a child process that is to be left without memory.
const CHILD: &str = "OVIDUCT_TEST_MEMORY_CHILD";

/// Allocations of the driver itself fail: the address space of a child process is limited while it runs.
#[test]
fn a_driver_that_has_no_memory_is_told_from_other_faults() {
    if no_vulkan() {
        return;
    }
    if std::env::var_os(CHILD).is_none() {
        let mut child = Command::new(std::env::current_exe().unwrap());
        child.args(["--exact", "memory::a_driver_that_has_no_memory_is_told_from_other_faults", "--nocapture"]);
        let output = child.env(CHILD, "1").output().unwrap();
        let told = String::from_utf8_lossy(&output.stdout);
        print!("{told}{}", String::from_utf8_lossy(&output.stderr));
        assert!(output.status.success() && told.contains("1 passed"), "{:?}", output.status);
        return;
    }
    let device = open();
    // Everything that is made once is there.
    run_batch(&device, &plans(1), &mut Kept::new(1)).unwrap();
    let large = plan(&json!({ "particles": { "total": { "keys": [[0, 260], [1, 60_000]] }, "outer": 90 }, "wall": { "lobing": 0 } }), 1);
    let large = vec![large; 8];
    let wanted = GpuDevice::batch_bytes(&large[0], large.len());
    assert!(wanted > 400 << 20, "{wanted}");
    limit_address_space(Some(wanted / 2));
    refused(&device, &large);
    run_batch(&device, &plans(2), &mut Kept::new(2)).unwrap();
    limit_address_space(None);
}

/// Leaves this process so many bytes more than it has, or lifts the limit.
fn limit_address_space(more: Option<u64>) {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let has = status.lines().find_map(|line| line.strip_prefix("VmSize:")?.trim().strip_suffix(" kB")).unwrap();
    let limit = more.map_or("unlimited".to_owned(), |more| (1024 * has.parse::<u64>().unwrap() + more).to_string());
    let pid = std::process::id().to_string();
    // The soft limit alone, so that it can be lifted.
    let done = Command::new("prlimit").args(["--pid", &pid, &format!("--as={limit}:")]).status().unwrap();
    assert!(done.success(), "prlimit (Debian package util-linux) failed");
}
