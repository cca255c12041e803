//! Compiles the firmware of the gatekeeper for this computer: the same files that run on the board.

fn main() {
    let firmware = "../gatekeeper/firmware/gatekeeper";
    println!("cargo::rerun-if-changed={firmware}");
    println!("cargo::rerun-if-changed=src/sizes.c");
    cc::Build::new()
        .include(firmware)
        .file(format!("{firmware}/gatekeeper_core.c"))
        .file(format!("{firmware}/gatekeeper_frames.c"))
        .file("src/sizes.c")
        .flag_if_supported("-std=c11")
        .warnings(true)
        .extra_warnings(true)
        .compile("gatekeeper_core");
}
