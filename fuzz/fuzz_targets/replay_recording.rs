//! A recording with images of TIFF.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    sofiscope_fuzz::in_folder(|folder| {
        let names =
            ["recording.json", "ledger.csv", "events.jsonl", "reflection.ome.tif", "transmission.ome.tif"];
        sofiscope_fuzz::write_pieces(folder, &names, data);
        sofiscope_fuzz::replay(&[folder.to_path_buf()]);
    });
});
