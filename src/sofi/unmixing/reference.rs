//! Reference images that other implementations made, for the tests of the mathematics.
//!
//! In: the name of a file in the folder of reference data. Out: its pages, or nothing where there is no such folder.
//! Never: fetches anything. Fails: a panic, as tests do, when a file that is there cannot be read.

use std::{fs::File, path::Path};

use ndarray::Array2;
use tiff::decoder::{Decoder, DecodingResult};

/// All pages of a reference file, or nothing (and a printed line) if the folder is absent.
pub(in crate::sofi) fn pages(name: &str) -> Option<Vec<Array2<f32>>> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data");
    if !Path::new(folder).is_dir() {
        println!("skipped: no reference data in {folder}");
        return None;
    }
    let file = File::open(Path::new(folder).join(name)).unwrap();
    let mut decoder = Decoder::new(file).unwrap();
    let mut pages = Vec::new();
    loop {
        let (width, height) = decoder.dimensions().unwrap();
        let values: Vec<f32> = match decoder.read_image().unwrap() {
            DecodingResult::F32(values) => values,
            DecodingResult::U16(values) => values.into_iter().map(f32::from).collect(),
            _ => panic!("unexpected pixel type in {name}"),
        };
        let shape = (height as usize, width as usize);
        pages.push(Array2::from_shape_vec(shape, values).unwrap());
        if !decoder.more_images() {
            return Some(pages);
        }
        decoder.next_image().unwrap();
    }
}

/// Largest difference over the root mean square of `expected`; NaN must be in the same places.
pub(in crate::sofi) fn disagreement(image: &Array2<f32>, expected: &Array2<f32>) -> f64 {
    assert_eq!(image.dim(), expected.dim());
    let (mut worst, mut squares, mut count) = (0.0_f64, 0.0, 0.0);
    for (&a, &b) in image.iter().zip(expected) {
        assert_eq!(a.is_nan(), b.is_nan());
        if !b.is_nan() {
            worst = worst.max((f64::from(a) - f64::from(b)).abs());
            squares += f64::from(b).powi(2);
            count += 1.0;
        }
    }
    worst / (squares / count).sqrt()
}
