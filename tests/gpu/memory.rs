//! Device memory: a failed allocation has its own error and leaves no memory allocated, and every
//! batch frees its memory.

use crate::common::{Kept, leave, no_vulkan, open_with, short};
use oviduct::sim::Plan;
use oviduct::sim::gpu::{GpuDevice, GpuError, run_batch};

/// Bytes of a batch that [`GpuDevice::batch_bytes`] does not count: constants, alignment.
const MORE: u64 = 200_000;

pub(crate) fn plans(members: u64) -> Vec<Plan> {
    (1..=members).map(short).collect()
}

/// Runs a batch that exceeds the memory. The sink must not be called, and no memory may stay
/// allocated.
pub(crate) fn refused(device: &GpuDevice, plans: &[Plan]) {
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
fn memory_is_freed_after_every_batch() {
    if no_vulkan() {
        return;
    }
    // The memory suffices for only one batch at a time.
    let device = open_with(&leave(GpuDevice::batch_bytes(&short(1), 2) + MORE));
    // The first batch allocates some memory that the device keeps.
    run_batch(&device, &plans(1), &mut Kept::new(1)).unwrap();
    let idle = device.memory_in_use().unwrap();
    let mut bad = plans(2);
    bad[1].rows[10].stiffness = f32::NAN;
    for round in 0..9 {
        let mut kept = Kept::new(2);
        match round % 3 {
            0 => {}
            // Cancels the only member while work is in flight.
            1 => kept.cancel = Some((0, -19)),
            _ => kept.cancel = Some((0, 10)),
        }
        let plans = if round % 3 == 1 { &plans(1) } else { &bad };
        run_batch(&device, plans, &mut kept).unwrap();
        assert_eq!(device.memory_in_use().unwrap(), idle, "round {round}");
    }
}
