//! What the programs in `fuzz_targets` share: limits on the memory and the time that an input may take.

use cap::Cap;
use cpu_time::ThreadTime;
use oviduct::fuzzing::Target;
use std::alloc::System;
use std::sync::Once;
use std::time::Duration;

/// Most processor time of a run; unlike the time that libFuzzer limits, it does not depend on other processes.
const TIME: Duration = Duration::from_secs(5);

#[global_allocator]
static ALLOCATOR: Cap<System> = Cap::new(System, usize::MAX);

/// Runs a target. An allocation beyond its limit fails, which ends the program like a panic.
pub fn run(target: &Target, bytes: &[u8]) {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let hook = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            // The trace of a panic takes memory too.
            unlimited();
            hook(panic);
        }));
    });
    let most = ALLOCATOR.allocated() + (target.memory)(bytes.len());
    ALLOCATOR.set_limit(most).expect("the limit is above what is allocated");
    let begun = ThreadTime::now();
    (target.run)(bytes);
    unlimited();
    assert!(begun.elapsed() < TIME, "the input takes {:?}", begun.elapsed());
}

fn unlimited() {
    ALLOCATOR.set_limit(usize::MAX).expect("there is no greater limit");
}
