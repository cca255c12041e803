//! A TIFF stack for both cameras.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    sofiscope_fuzz::in_folder(|folder| {
        sofiscope_fuzz::write_pieces(folder, &["r.tif"], data);
        let path = folder.join("r.tif");
        sofiscope_fuzz::replay(std::slice::from_ref(&path));
        sofiscope_fuzz::replay(&[path.clone(), path]);
    });
});
