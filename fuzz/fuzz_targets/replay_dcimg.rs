//! A `.dcimg` file for each camera.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    sofiscope_fuzz::in_folder(|folder| {
        sofiscope_fuzz::write_pieces(folder, &["r.dcimg"], data);
        let path = folder.join("r.dcimg");
        sofiscope_fuzz::replay(&[path.clone(), path]);
    });
});
