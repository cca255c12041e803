//! A header and bare pixels.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    sofiscope_fuzz::in_folder(|folder| {
        sofiscope_fuzz::write_pieces(folder, &["r.toml", "r.raw"], data);
        let path = folder.join("r.raw");
        sofiscope_fuzz::replay(&[path.clone(), path]);
    });
});
