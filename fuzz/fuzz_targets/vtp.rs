#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| oviduct_fuzz::run(&oviduct::fuzzing::VTP, bytes));
