//! Runs `state_packets` of `rhumb-tests` with a fuzzer's bytes.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| rhumb_tests::fuzzing::state_packets(data));
