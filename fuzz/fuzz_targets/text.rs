#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| nonrigid_fuzz::text(bytes));
