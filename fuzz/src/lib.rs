//! Shared code of the programs in `fuzz_targets`: limits on memory and processor time per input.

use cap::Cap;
use cpu_time::ThreadTime;
use oviduct::fuzzing::Target;
use std::alloc::System;
use std::sync::Once;
use std::time::Duration;

/// Maximum processor time per input. Unlike libFuzzer's time limit, it does not depend on other
/// processes.
const TIME: Duration = Duration::from_secs(5);

#[global_allocator]
static ALLOCATOR: Cap<System> = Cap::new(System, usize::MAX);

/// Runs a target. An allocation beyond the target's memory limit fails, which ends the program like
/// a panic.
pub fn run(target: &Target, bytes: &[u8]) {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let hook = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            // Printing the panic needs memory, too.
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
