//! Fuzzes the target that `FUZZ_TARGET` names; `tests/fuzz/run` starts it.
#![no_main]

use std::sync::LazyLock;

use rhumb_tests::fuzzing::{Target, target};

static TARGET: LazyLock<&Target> = LazyLock::new(|| {
    let name = std::env::var("FUZZ_TARGET").expect("FUZZ_TARGET names the target");
    target(&name).unwrap_or_else(|| panic!("there is no target {name}"))
});

libfuzzer_sys::fuzz_target!(|data: &[u8]| (TARGET.run)(data));
