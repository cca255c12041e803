//! Against images that other programs made: an independent slow implementation and the published software.
//!
//! The files lie outside the project; without them these tests say that they skip.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop here")]

mod compare;

use ndarray::Array2;
use sofiscope::files::{FrameBuffer, ImageStack};
use sofiscope::reconstruction::{AllCores, ChainSettings, FlatteningKind, reconstruct};
use sofiscope::sofi::cumulant::{CumulantEngine, CumulantSettings, Drawing, Exposure, Incomplete};
use sofiscope::sofi::grid::{Combinations, VirtualPixelGrid};
use sofiscope::sofi::linearization::{LinearizationSettings, Reconvolution};
use sofiscope::sofi::psf::Psf;
use sofiscope::sofi::spectra::Species;
use sofiscope::sofi::unmixing::{UnmixingMatrix, UnmixingMethod};
use std::path::{Path, PathBuf};

/// Folder of files of other programs, or `None` with a word about it.
fn data(folder: &str) -> Option<PathBuf> {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")).join(folder);
    if path.is_dir() {
        return Some(path);
    }
    println!("skipped: {} is not there", path.display());
    None
}

fn pages(path: &Path) -> Vec<Array2<f32>> {
    let mut stack = ImageStack::open(path).unwrap_or_else(|error| panic!("{error}"));
    let (height, width) = (stack.info().height, stack.info().width);
    let mut buffer = stack.info().buffer();
    let mut pages = Vec::new();
    while stack.read(&mut buffer).unwrap() {
        let values = match &buffer {
            FrameBuffer::Counts(counts) => counts.iter().map(|&count| f32::from(count)).collect(),
            FrameBuffer::Values(values) => values.clone(),
        };
        pages.push(Array2::from_shape_vec((height, width), values).unwrap());
    }
    pages
}

fn draw(settings: CumulantSettings, stacks: &[Vec<Array2<f32>>]) -> Drawing {
    let (height, width) = stacks[0][0].dim();
    let mut engine = CumulantEngine::<f32>::new(settings, height, width).unwrap();
    for (index, _) in stacks[0].iter().enumerate() {
        let planes: Vec<&[f32]> = stacks.iter().map(|stack| stack[index].as_slice().unwrap()).collect();
        engine.push(&AllCores, &[Exposure { index: index as u64, planes: &planes }]).unwrap();
    }
    engine.draw(&AllCores, Incomplete::AtLeastHalf).unwrap()
}

/// Prints and checks the error of every page, relative to its root mean square.
fn assert_agree(what: &str, got: &[Array2<f32>], expected: &[Array2<f32>], tolerance: f64) {
    assert_eq!(got.len(), expected.len(), "{what}: number of pages");
    for (page, (got, expected)) in got.iter().zip(expected).enumerate() {
        assert_eq!(got.dim(), expected.dim(), "{what}: size of page {page}");
        let error = compare::relative_error(got, &expected.mapv(f64::from));
        println!("{what}, page {page}: {error:.2e} of the root mean square (at most {tolerance:.0e})");
        assert!(error <= tolerance, "{what}, page {page}: {error:e}");
    }
}

fn species(transmissions: [f64; 3]) -> Vec<Species> {
    let names = ["Alexa Fluor 488", "Atto 565", "Alexa Fluor 647"];
    names.iter().zip(transmissions).map(|(name, t)| Species::new(name, t).unwrap()).collect()
}

#[test]
fn two_cameras_agree_with_an_independent_implementation() {
    let Some(folder) = data("twocamera") else { return };
    let stacks = ["reflection.tif", "transmission.tif"].map(|file| pages(&folder.join(file)));
    for (order, tolerance) in [(2, 1e-5), (3, 1e-4), (4, 1e-4)] {
        let drawing = draw(CumulantSettings::new(order, 2, 150), &stacks);
        assert_eq!((drawing.runs, drawing.incomplete_samples), (4, 80));
        let expected = |stage: &str| pages(&folder.join(format!("expected_{stage}_order{order}.tif")));
        assert_agree(
            &format!("cumulants of order {order}"),
            &drawing.cumulants,
            &expected("cumulants"),
            tolerance,
        );
        let chain = ChainSettings {
            matrix: UnmixingMatrix::new(order, &species([0.02, 0.35, 0.98])).unwrap(),
            method: UnmixingMethod::PseudoInverse,
            flattening: FlatteningKind::EqualMeans,
            linearization: vec![LinearizationSettings::gaussian(0.9).unwrap(); 3],
        };
        let grid = VirtualPixelGrid::new(order, Combinations::AllClosest).unwrap();
        let stages = reconstruct(&drawing, &grid, &chain).unwrap();
        assert_agree(&format!("unmixed at order {order}"), &stages.unmixed, &expected("unmixed"), tolerance);
        if order == 2 {
            assert_agree("flattened at order 2", &stages.flattened, &expected("flattened"), tolerance);
        }
    }
}

#[test]
fn published_software_gives_the_same_images_with_its_combinations() {
    let Some(folder) = data("sofipackage") else { return };
    let stacks = ["reflection.tif", "transmission.tif"].map(|file| pages(&folder.join(file)));
    let settings =
        CumulantSettings { combinations: Combinations::Sofipackage, ..CumulantSettings::new(2, 2, 64) };
    let drawing = draw(settings, &stacks);
    // Index i of their images is camera position 1 + i/2; theirs end at the last camera pixel.
    let crop = |image: &Array2<f32>| {
        let (height, width) = image.dim();
        image.slice(ndarray::s![2..height - 5, 2..width - 5]).to_owned()
    };
    let cumulants: Vec<_> = drawing.cumulants.iter().map(crop).collect();
    assert_agree("sofipackage, RR RT TT", &cumulants, &pages(&folder.join("expected_order2.tif")), 1e-6);
    let matrix = UnmixingMatrix::new(2, &species([0.02, 0.35, 0.98])).unwrap();
    let kappa: Vec<_> = cumulants.iter().map(|image| image.view()).collect();
    let unmixed = matrix.unmix(&kappa).unwrap();
    assert_agree("sofipackage, unmixed", &unmixed, &pages(&folder.join("expected_unmixed_order2.tif")), 1e-6);
}

#[test]
fn one_camera_images_correlate_with_those_of_the_published_software() {
    let Some(folder) = data("peer") else { return };
    let sigma_px = 2.7 / 2.354_82;
    for (number, least) in [("02", 0.93), ("03", 0.87)] {
        let stack = pages(&folder.join(format!("{number}_noisyvid.tif")));
        let frames = stack.len() as u64;
        let drawing = draw(CumulantSettings::new(2, 1, frames), &[stack]);
        let all_light = ndarray::array![[1.0]];
        let chain = ChainSettings {
            matrix: UnmixingMatrix::from_proportions(2, &["sample".to_owned()], &all_light).unwrap(),
            method: UnmixingMethod::PseudoInverse,
            flattening: FlatteningKind::EqualMeans,
            linearization: vec![LinearizationSettings {
                reconvolution: Reconvolution::None,
                ..LinearizationSettings::new(Psf::gaussian(sigma_px).unwrap())
            }],
        };
        let grid = VirtualPixelGrid::new(2, Combinations::AllClosest).unwrap();
        let ours = reconstruct(&drawing, &grid, &chain).unwrap().linearized.remove(0);
        let theirs = pages(&folder.join(format!("{number}_sofi2_linearized.tif"))).remove(0);
        let best = (0..6).map(|shift| correlation(&ours, &theirs, shift)).fold(-1.0, f64::max);
        println!("stack {number}: correlation {best:.3} with the published software (at least {least})");
        assert!(best >= least, "stack {number}: {best}");
    }
}

/// Pearson correlation where both images are valid; their pixel i is ours `i + shift`.
fn correlation(ours: &Array2<f32>, theirs: &Array2<f32>, shift: usize) -> f64 {
    let pairs: Vec<(f64, f64)> = theirs
        .indexed_iter()
        .filter_map(|((y, x), &b)| ours.get((y + shift, x + shift)).map(|&a| (f64::from(a), f64::from(b))))
        .filter(|(a, _)| a.is_finite())
        .collect();
    let count = pairs.len() as f64;
    let (mean_a, mean_b) =
        (pairs.iter().map(|p| p.0).sum::<f64>() / count, pairs.iter().map(|p| p.1).sum::<f64>() / count);
    let moment =
        |f: &dyn Fn(f64, f64) -> f64| pairs.iter().map(|(a, b)| f(a - mean_a, b - mean_b)).sum::<f64>();
    moment(&|a, b| a * b) / (moment(&|a, _| a * a) * moment(&|_, b| b * b)).sqrt()
}
