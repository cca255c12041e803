//! The file beside the maps of a camera: which camera, which part of its sensor, from which recordings.
//!
//! In: text in TOML. Out: [`CameraCalibration`], and its text again.
//! Never: holds pixels, those are in the file of maps that it names. Fails: [`CameraCalibrationFaults`], all at once.

use sofiscope_form::{Fault, Faults, Form, read};
use sofiscope_hal::Region;
use std::fmt::Write;

/// Version of the file.
const VERSION: u64 = 1;

/// Where maps of a camera come from and what they are of.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraCalibration {
    /// Serial number of the camera, where known.
    pub serial: Option<String>,
    /// When, in the form of ISO 8601.
    pub date: String,
    /// Name of the file of maps, beside this one.
    pub maps_file: String,
    /// The part of the sensor.
    pub region: Region,
    /// Counts from which a pixel is saturated.
    pub saturation_counts: u16,
    /// Gain of the middle pixel, counts per electron.
    pub gain_counts_per_electron: f64,
    /// Offset of the middle pixel, counts.
    pub offset_counts: f64,
    /// Read noise of the middle pixel, electrons.
    pub read_noise_electrons: f64,
    /// Pixels that are hot, dead and saturated; a pixel may be more than one of these.
    pub faulty_pixels: [u64; 3],
    /// The recording without light.
    pub dark: String,
    /// The flats of the photon-transfer series.
    pub flats: Vec<String>,
}

/// Everything that is wrong with the file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}", faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
pub struct CameraCalibrationFaults {
    /// All faults in the order of lines.
    pub faults: Vec<Fault>,
}

impl CameraCalibration {
    /// Reads a file.
    ///
    /// # Errors
    /// [`CameraCalibrationFaults`] with every fault.
    pub fn from_toml(text: &str) -> Result<Self, CameraCalibrationFaults> {
        let faults = Faults::new(text);
        let found = read(&faults, whole);
        match (found, faults.into_list()) {
            (Some(calibration), faults) if faults.is_empty() => Ok(calibration),
            (_, faults) => Err(CameraCalibrationFaults { faults }),
        }
    }

    /// The text of the file.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let quoted = |text: &str| toml::Value::from(text).to_string();
        let Region { left, top, width, height } = self.region;
        let [hot, dead, saturated] = self.faulty_pixels;
        let mut text = format!(
            "# Offset, gain, read noise and faults of every pixel of a camera, made by `sofiscope calibrate camera`.\n\
             camera_maps_version = {VERSION}\n\
             date = {}\n",
            quoted(&self.date)
        );
        if let Some(serial) = &self.serial {
            let _ = writeln!(text, "serial = {}", quoted(serial));
        }
        let flats: Vec<String> = self.flats.iter().map(|flat| format!("  {},\n", quoted(flat))).collect();
        let _ = write!(
            text,
            "# Pages: offset (counts), gain (counts per electron), read-noise variance (counts squared),\n\
             # faults (1 hot, 2 dead, 4 saturated, or sums of these), then the standard errors of the first three.\n\
             maps_file = {}\n\
             left_px = {left}\ntop_px = {top}\nwidth_px = {width}\nheight_px = {height}\n\
             saturation_counts = {}\n\
             # Of the middle pixel.\n\
             gain_counts_per_electron = {:?}\noffset_counts = {:?}\nread_noise_electrons = {:?}\n\
             hot_pixels = {hot}\ndead_pixels = {dead}\nsaturated_pixels = {saturated}\n\
             dark_recording = {}\nflat_recordings = [\n{}]\n",
            quoted(&self.maps_file),
            self.saturation_counts,
            self.gain_counts_per_electron,
            self.offset_counts,
            self.read_noise_electrons,
            quoted(&self.dark),
            flats.concat(),
        );
        text
    }
}

fn whole(form: &Form<'_>) -> CameraCalibration {
    let version = form.whole("camera_maps_version", 0..=u64::MAX);
    if form.has("camera_maps_version") && version != VERSION {
        form.fault(
            "camera_maps_version",
            format!("is {version}, and this version of the program reads {VERSION}"),
            "calibrate again with this version",
        );
    }
    let name = form.prose("maps_file");
    let is_plain = |name: &str| !name.is_empty() && !name.contains('/') && name != "..";
    if !is_plain(&name) {
        form.fault("maps_file", "names no file beside this one", "give the name of the file of maps");
    }
    let side = |key| form.whole(key, 4..=100_000) as u32;
    let place = |key| form.whole_if_any(key, 0..=100_000).unwrap_or(0) as u32;
    let pixels = |key| form.whole_if_any(key, 0..=u64::MAX).unwrap_or(0);
    CameraCalibration {
        serial: form.has("serial").then(|| form.text("serial")),
        date: form.text("date"),
        maps_file: name,
        region: Region {
            left: place("left_px"),
            top: place("top_px"),
            width: side("width_px"),
            height: side("height_px"),
        },
        saturation_counts: form.whole("saturation_counts", 1..=u64::from(u16::MAX)) as u16,
        gain_counts_per_electron: form.number("gain_counts_per_electron", 1e-6..=1e6),
        offset_counts: form.number("offset_counts", -1e6..=1e6),
        read_noise_electrons: form.number("read_noise_electrons", 0.0..=1e6),
        faulty_pixels: [pixels("hot_pixels"), pixels("dead_pixels"), pixels("saturated_pixels")],
        dark: form.prose("dark_recording"),
        flats: form.texts_if_any("flat_recordings", 0..=usize::MAX),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> CameraCalibration {
        CameraCalibration {
            serial: Some("A \"1\"".to_owned()),
            date: "2026-01-02".to_owned(),
            maps_file: "camera-r.ome.tif".to_owned(),
            region: Region { left: 16, top: 8, width: 128, height: 72 },
            saturation_counts: 4095,
            gain_counts_per_electron: 2.174,
            offset_counts: 100.25,
            read_noise_electrons: 1.4,
            faulty_pixels: [12, 3, 1],
            dark: "/data/dark \"1\"".to_owned(),
            flats: vec!["/data/flat-1".to_owned(), "/data/flat-2".to_owned()],
        }
    }

    #[test]
    fn what_is_written_is_read() {
        for calibration in [example(), CameraCalibration { serial: None, flats: Vec::new(), ..example() }] {
            assert_eq!(CameraCalibration::from_toml(&calibration.to_toml()).unwrap(), calibration);
        }
    }

    #[test]
    fn all_faults_are_named_and_files_elsewhere_are_refused() {
        let text = example().to_toml().replace("camera-r.ome.tif", "../camera-r.ome.tif");
        let text = text.replace("width_px = 128", "width_px = 0").replace("date", "dates");
        let faults = CameraCalibration::from_toml(&text).unwrap_err().to_string();
        assert!(["maps_file", "width_px", "date"].iter().all(|key| faults.contains(key)), "{faults}");
    }
}
