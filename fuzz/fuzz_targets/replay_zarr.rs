//! The description of an array and one of its chunks.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    sofiscope_fuzz::in_folder(|folder| {
        let names = ["r.zarr/zarr.json", "r.zarr/0/zarr.json", "r.zarr/c/0/0/0"];
        sofiscope_fuzz::write_pieces(folder, &names, data);
        let path = folder.join("r.zarr");
        sofiscope_fuzz::replay(std::slice::from_ref(&path));
        sofiscope_fuzz::replay(&[path.clone(), path]);
    });
});
