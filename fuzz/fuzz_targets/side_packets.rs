//! Runs `side_packets` of `rhumb-tests` with a fuzzer's bytes.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| rhumb_tests::fuzzing::side_packets(data));
