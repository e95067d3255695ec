//! VTP files.
#![no_main]

use nearfield::io::Format;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| nearfield_fuzz::read(bytes, Format::Vtp));
