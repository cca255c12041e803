//! The functions that Madlib exports, and one more that tells the bench what to do.
//!
//! In: handles and numbers. Out: answers as Madlib gives them. Never: keeps a pointer of the caller.
//! Fails: with the codes of Madlib.h.

#![expect(unsafe_code, reason = "functions of a C library take pointers and have fixed names")]

use std::ffi::{CStr, c_char};
use std::sync::{Condvar, LazyLock, Mutex, MutexGuard, Once, PoisonError};
use std::time::{Duration, Instant};

use crate::bench::{Bench, code};

/// ProductInformation of Madlib.h.
#[repr(C, packed)]
struct ProductInformation {
    axes: u8,
    adc_bits: i16,
    dac_bits: i16,
    product_id: i16,
    firmware_version: i16,
    firmware_profile: i16,
}

const _: () = assert!(size_of::<ProductInformation>() == 11);

static BENCH: LazyLock<Mutex<Bench>> = LazyLock::new(|| {
    let mut bench = Bench::new();
    let table = std::env::var("SOFISCOPE_MADLIB_TABLE").map(|path| format!("table {path}"));
    let control = std::env::var("SOFISCOPE_MADLIB_CONTROL");
    for text in [table, control].into_iter().flatten() {
        for command in text.split(';').filter(|command| !command.trim().is_empty()) {
            if let Err(error) = bench.obey(command) {
                eprintln!("simulated Nano-Drive: {error}");
            }
        }
    }
    Mutex::new(bench)
});
static CHANGED: Condvar = Condvar::new();

fn lock() -> MutexGuard<'static, Bench> {
    BENCH.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The bench, after the time that a slow call takes.
fn bench() -> MutexGuard<'static, Bench> {
    static TABLE: Once = Once::new();
    TABLE.call_once(|| {
        let spawned = std::thread::Builder::new().name("piezo-to-table".into()).spawn(tell_table);
        if let Err(error) = spawned {
            eprintln!("simulated Nano-Drive: the optical table will not see motions: {error}");
        }
    });
    let mut bench = lock();
    if let Some(time) = bench.slowness() {
        let begun = Instant::now();
        while let Some(left) = time.checked_sub(begun.elapsed()) {
            (bench, _) = CHANGED.wait_timeout(bench, left).unwrap_or_else(PoisonError::into_inner);
        }
    }
    CHANGED.notify_all();
    bench
}

/// Shows the table where the piezo is, each millisecond while it moves.
fn tell_table() {
    let mut bench = lock();
    loop {
        bench.advance();
        bench = if bench.is_moving() {
            CHANGED.wait_timeout(bench, Duration::from_millis(1)).unwrap_or_else(PoisonError::into_inner).0
        } else {
            CHANGED.wait(bench).unwrap_or_else(PoisonError::into_inner)
        };
    }
}

fn answer(result: Result<(), i32>) -> i32 {
    result.err().unwrap_or(0)
}

fn number(result: Result<f64, i32>) -> f64 {
    result.unwrap_or_else(f64::from)
}

/// A pointer of the caller, written to unless it is null.
///
/// # Safety
/// `to` is null or may be written to.
unsafe fn write<T>(to: *mut T, value: T) {
    if !to.is_null() {
        // SAFETY: not null, and the caller promises the rest; packed structures need no alignment.
        unsafe { to.write_unaligned(value) };
    }
}

#[unsafe(no_mangle)]
extern "C" fn MCL_InitHandle() -> i32 {
    bench().take(false).unwrap_or(0)
}

#[unsafe(no_mangle)]
extern "C" fn MCL_InitHandleOrGetExisting() -> i32 {
    bench().take(true).unwrap_or(0)
}

#[unsafe(no_mangle)]
extern "C" fn MCL_GrabHandle(product: u16) -> i32 {
    let mut bench = bench();
    let fits = i32::from(product) == i32::from(product_id(bench.bits));
    if fits { bench.take(false).unwrap_or(0) } else { 0 }
}

#[unsafe(no_mangle)]
extern "C" fn MCL_GrabHandleOrGetExisting(product: u16) -> i32 {
    let mut bench = bench();
    let fits = i32::from(product) == i32::from(product_id(bench.bits));
    if fits { bench.take(true).unwrap_or(0) } else { 0 }
}

#[unsafe(no_mangle)]
extern "C" fn MCL_GrabAllHandles() -> i32 {
    bench().take(true).map_or(0, |_| 1)
}

/// # Safety
/// `handles` is null or has room for `number` handles.
#[unsafe(no_mangle)]
unsafe extern "C" fn MCL_GetAllHandles(handles: *mut i32, number: i32) -> i32 {
    match bench().handle() {
        Some(handle) if number > 0 => {
            // SAFETY: room for one, as the caller promises.
            unsafe { write(handles, handle) };
            1
        }
        _ => 0,
    }
}

#[unsafe(no_mangle)]
extern "C" fn MCL_NumberOfCurrentHandles() -> i32 {
    bench().handle().map_or(0, |_| 1)
}

#[unsafe(no_mangle)]
extern "C" fn MCL_GetHandleBySerial(serial: i16) -> i32 {
    let bench = bench();
    if bench.serial == serial { bench.handle().unwrap_or(0) } else { 0 }
}

#[unsafe(no_mangle)]
extern "C" fn MCL_ReleaseHandle(handle: i32) {
    bench().release(handle);
}

#[unsafe(no_mangle)]
extern "C" fn MCL_ReleaseAllHandles() {
    bench().release_all();
}

#[unsafe(no_mangle)]
extern "C" fn MCL_SingleReadN(axis: u32, handle: i32) -> f64 {
    number(bench().read(axis, handle))
}

#[unsafe(no_mangle)]
extern "C" fn MCL_SingleReadZ(handle: i32) -> f64 {
    number(bench().read(3, handle))
}

#[unsafe(no_mangle)]
extern "C" fn MCL_SingleWriteN(um: f64, axis: u32, handle: i32) -> i32 {
    answer(bench().write(um, axis, handle))
}

#[unsafe(no_mangle)]
extern "C" fn MCL_SingleWriteZ(um: f64, handle: i32) -> i32 {
    answer(bench().write(um, 3, handle))
}

#[unsafe(no_mangle)]
extern "C" fn MCL_MonitorN(um: f64, axis: u32, handle: i32) -> f64 {
    let mut bench = bench();
    number(bench.write(um, axis, handle).and_then(|()| bench.read(axis, handle)))
}

#[unsafe(no_mangle)]
extern "C" fn MCL_MonitorZ(um: f64, handle: i32) -> f64 {
    MCL_MonitorN(um, 3, handle)
}

#[unsafe(no_mangle)]
extern "C" fn MCL_GetCalibration(axis: u32, handle: i32) -> f64 {
    number(bench().calibration(axis, handle))
}

#[unsafe(no_mangle)]
extern "C" fn MCL_GetSerialNumber(handle: i32) -> i32 {
    let mut bench = bench();
    bench.check(handle).map_or_else(|code| code, |()| i32::from(bench.serial))
}

/// # Safety
/// `product` is null or may be written to.
#[unsafe(no_mangle)]
unsafe extern "C" fn MCL_GetProductInfo(product: *mut ProductInformation, handle: i32) -> i32 {
    let mut bench = bench();
    if product.is_null() {
        return code::BAD_ARGUMENT;
    }
    let checked = bench.check(handle);
    if checked.is_ok() {
        let found = ProductInformation {
            axes: 4,
            adc_bits: bench.bits,
            dac_bits: bench.bits,
            product_id: product_id(bench.bits),
            firmware_version: 1,
            // Last target readable, sequences.
            firmware_profile: 0x0008 | 0x0100,
        };
        // SAFETY: not null, as the caller promises.
        unsafe { write(product, found) };
    }
    answer(checked)
}

#[unsafe(no_mangle)]
extern "C" fn MCL_DeviceAttached(_milliseconds: i32, handle: i32) -> bool {
    bench().is_attached(handle)
}

/// # Safety
/// Pointers are null or may be written to.
#[unsafe(no_mangle)]
unsafe extern "C" fn MCL_GetCommandedPosition(x: *mut f64, y: *mut f64, z: *mut f64, handle: i32) -> i32 {
    let target = bench().target(handle);
    if let Ok(target) = target {
        // SAFETY: as the caller promises.
        unsafe {
            write(x, 0.0);
            write(y, 0.0);
            write(z, target);
        }
    }
    answer(target.map(|_| ()))
}

/// # Safety
/// Pointers are null or may be written to.
#[unsafe(no_mangle)]
unsafe extern "C" fn MCL_GetFirmwareVersion(version: *mut i16, profile: *mut i16, handle: i32) -> i32 {
    let checked = bench().check(handle);
    if checked.is_ok() {
        // SAFETY: as the caller promises.
        unsafe {
            write(version, 1);
            write(profile, 0x0008 | 0x0100);
        }
    }
    answer(checked)
}

/// # Safety
/// Pointers are null or may be written to.
#[unsafe(no_mangle)]
unsafe extern "C" fn MCL_DLLVersion(version: *mut i16, revision: *mut i16) {
    // SAFETY: as the caller promises.
    unsafe {
        write(version, 0);
        write(revision, 1);
    }
}

#[unsafe(no_mangle)]
extern "C" fn MCL_CorrectDriverVersion() -> bool {
    true
}

/// Tells the bench what to do, in the words of `bench.rs`; Madlib has no such function, which tells a driver that
/// this device is simulated.
///
/// # Safety
/// `command` ends with 0; `text` has room for `bytes` bytes.
#[unsafe(no_mangle)]
unsafe extern "C" fn sofiscope_madlib_bench(command: *const c_char, text: *mut c_char, bytes: i32) -> i32 {
    // SAFETY: the caller promises a text that ends.
    let command = unsafe { CStr::from_ptr(command) }.to_string_lossy().into_owned();
    let told = lock().obey(&command);
    CHANGED.notify_all();
    let (words, done) = told.map_or_else(|words| (words, 0), |words| (words, 1));
    let room = usize::try_from(bytes).unwrap_or(0);
    if text.is_null() || words.len() >= room {
        return 0;
    }
    // SAFETY: there is room for the words and their end.
    unsafe {
        std::ptr::copy_nonoverlapping(words.as_ptr(), text.cast(), words.len());
        text.add(words.len()).write(0);
    }
    done
}

/// Model code of a single axis with so many bits.
fn product_id(bits: i16) -> i16 {
    if bits == 20 { 0x2201 } else { 0x2001 }
}
