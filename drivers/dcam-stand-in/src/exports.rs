//! The functions that a library of DCAM-API 4 exports, and one more that tells the bench what to do.
//!
//! In: structures of the caller, checked for their size. Out: answers as the library gives them.
//! Never: keeps a pointer of the caller. Fails: with the code that the library would give.

#![expect(unsafe_code, reason = "functions of a C library take pointers and have fixed names")]

use std::ffi::{CStr, c_char};
use std::sync::{Condvar, LazyLock, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::bench::Bench;
use crate::codes::Code;
use crate::layout::{
    Attribute, DeviceOpen, DeviceString, Frame, Init, TransferInfo, ValueText, WaitOpen, WaitStart,
};
use crate::spec::{Access, Kind, LINE_FAST_S, PROPERTIES, Spec, find};

/// A structure that begins with its own size.
///
/// # Safety
/// The first field is an `i32`, and every pattern of bytes is a value.
unsafe trait Sized32 {}

macro_rules! sized {
    ($($name:ident: $bytes:literal,)*) => {
        $(
            const _: () = assert!(size_of::<$name>() == $bytes);
            // SAFETY: `repr(C)`, begins with `size: i32`, made of numbers and raw pointers.
            unsafe impl Sized32 for $name {}
        )*
    };
}

sized! {
    Init: 32,
    DeviceOpen: 16,
    DeviceString: 24,
    Attribute: 88,
    ValueText: 32,
    Frame: 64,
    WaitOpen: 24,
    WaitStart: 16,
    TransferInfo: 16,
}

static BENCH: LazyLock<Mutex<Bench>> = LazyLock::new(|| Mutex::new(Bench::new()));
static CHANGED: Condvar = Condvar::new();

fn bench() -> MutexGuard<'static, Bench> {
    BENCH.lock().unwrap_or_else(PoisonError::into_inner)
}

fn answer(result: Result<(), Code>) -> i32 {
    CHANGED.notify_all();
    match result {
        Ok(()) => 1,
        Err(code) => code.0.cast_signed(),
    }
}

/// The caller's structure, if it is there and has the size that it says.
///
/// # Safety
/// `pointer` is null or points to a structure of which at least the size can be read, and which nobody else uses
/// during the call.
unsafe fn checked<'a, T: Sized32>(pointer: *mut T) -> Result<&'a mut T, Code> {
    if pointer.is_null() {
        return Err(Code::INVALIDPARAM);
    }
    // SAFETY: not null, and begins with its size.
    let size = unsafe { pointer.cast::<i32>().read_unaligned() };
    if usize::try_from(size) != Ok(size_of::<T>()) {
        return Err(Code::INVALIDPARAM);
    }
    // SAFETY: not null, of the full size, and by contract used by nobody else.
    Ok(unsafe { &mut *pointer })
}

/// Writes a text with its end.
///
/// # Safety
/// `to` is null or has room for `bytes` bytes.
unsafe fn write_text(text: &str, to: *mut c_char, bytes: i32) -> Result<(), Code> {
    let room = usize::try_from(bytes).unwrap_or(0);
    if to.is_null() || room <= text.len() {
        return Err(Code::INVALIDPARAM);
    }
    // SAFETY: there is room for the text and its end.
    unsafe {
        std::ptr::copy_nonoverlapping(text.as_ptr(), to.cast(), text.len());
        to.add(text.len()).write(0);
    }
    Ok(())
}

/// Declares an exported function with the pointers that its caller has to keep valid.
macro_rules! export {
    ($($name:ident($($argument:ident: $type:ty),*) $body:block)*) => {
        $(
            /// As in dcamapi4.h.
            ///
            /// # Safety
            /// Pointers are null or point to what dcamapi4.h says, used by nobody else during the call.
            #[unsafe(no_mangle)]
            unsafe extern "C" fn $name($($argument: $type),*) -> i32 {
                fn body($($argument: $type),*) -> Result<(), Code> { $body }
                answer(body($($argument),*))
            }
        )*
    };
}

export! {
    dcamapi_init(init: *mut Init) {
        // SAFETY: as the caller promises.
        let init = unsafe { checked(init) }?;
        init.device_count = 2;
        let mut bench = bench();
        if bench.users == 0 {
            for text in [
                std::env::var("SOFISCOPE_DCAM_SCENE").map(|scene| format!("scene {scene}")),
                std::env::var("SOFISCOPE_DCAM_TABLE").map(|path| format!("table {path}")),
                std::env::var("SOFISCOPE_DCAM_CONTROL"),
            ].into_iter().flatten() {
                for command in crate::command::parse(&text).map_err(|_| Code::NOCAMERA)? {
                    bench.obey(command).map_err(|_| Code::NOCAMERA)?;
                }
            }
        }
        bench.users += 1;
        Ok(())
    }

    dcamapi_uninit() {
        let mut bench = bench();
        bench.users = bench.users.saturating_sub(1);
        Ok(())
    }

    dcamdev_open(open: *mut DeviceOpen) {
        // SAFETY: as the caller promises.
        let open = unsafe { checked(open) }?;
        open.handle = bench().open(open.index)?;
        Ok(())
    }

    dcamdev_close(camera: usize) {
        let mut bench = bench();
        bench.note("close".into());
        bench.close(camera)
    }

    dcamdev_getstring(camera: usize, string: *mut DeviceString) {
        // SAFETY: as the caller promises.
        let string = unsafe { checked(string) }?;
        let bench = bench();
        let index = if camera < 2 { camera } else { bench.index_of(camera)? };
        bench.cameras[index].check()?;
        let text = match string.which {
            0x0400_0101 => "simulated bus".to_owned(),
            0x0400_0102 => format!("S/N: {}", bench.serials[index]),
            0x0400_0103 => "sofiscope (simulated)".to_owned(),
            0x0400_0104 => "C11440-22CU (simulated)".to_owned(),
            0x0400_0105 => "2.60.A (simulated)".to_owned(),
            0x0400_0106..=0x0400_0108 => format!("stand-in {} (simulated)", env!("CARGO_PKG_VERSION")),
            _ => return Err(Code::INVALIDPARAM),
        };
        // SAFETY: the structure says how much room its text has.
        unsafe { write_text(&text, string.text, string.text_bytes) }
    }

    dcamprop_getattr(camera: usize, found: *mut Attribute) {
        // SAFETY: as the caller promises.
        let found = unsafe { checked(found) }?;
        bench().camera(camera)?;
        let spec = find(found.property).ok_or(Code::INVALIDPROPERTYID)?;
        (found.flags, found.unit) = (flags(spec), spec.unit);
        (found.least, found.greatest, found.step) = (spec.least, spec.greatest, spec.step);
        found.default = spec.default;
        Ok(())
    }

    dcamprop_getvalue(camera: usize, id: i32, value: *mut f64) {
        let found = bench().camera(camera)?.settings.get(id)?;
        if value.is_null() { return Err(Code::INVALIDPARAM); }
        // SAFETY: not null, as the caller promises a number.
        unsafe { value.write(found) };
        Ok(())
    }

    dcamprop_setvalue(camera: usize, id: i32, value: f64) {
        set(camera, id, value).map(|_| ())
    }

    dcamprop_setgetvalue(camera: usize, id: i32, value: *mut f64, _option: i32) {
        if value.is_null() { return Err(Code::INVALIDPARAM); }
        // SAFETY: not null, as the caller promises a number.
        unsafe { value.write(set(camera, id, value.read())?) };
        Ok(())
    }

    dcamprop_getnextid(camera: usize, id: *mut i32, _option: i32) {
        bench().camera(camera)?;
        if id.is_null() { return Err(Code::INVALIDPARAM); }
        // SAFETY: not null, as the caller promises a number.
        let last = unsafe { id.read() };
        let next = PROPERTIES.iter().find(|spec| spec.id > last).ok_or(Code::NOPROPERTY)?;
        // SAFETY: as above.
        unsafe { id.write(next.id) };
        Ok(())
    }

    dcamprop_getname(camera: usize, id: i32, text: *mut c_char, bytes: i32) {
        bench().camera(camera)?;
        let spec = find(id).ok_or(Code::INVALIDPROPERTYID)?;
        // SAFETY: as the caller promises.
        unsafe { write_text(spec.name, text, bytes) }
    }

    dcamprop_getvaluetext(camera: usize, text: *mut ValueText) {
        // SAFETY: as the caller promises.
        let text = unsafe { checked(text) }?;
        bench().camera(camera)?;
        let Kind::Mode(choices) = find(text.property).ok_or(Code::INVALIDPROPERTYID)?.kind else {
            return Err(Code::NOVALUETEXT);
        };
        let named = choices.iter().find(|(value, _)| f64::from(*value) == text.value);
        let (_, name) = named.ok_or(Code::INVALIDVALUE)?;
        // SAFETY: the structure says how much room its text has.
        unsafe { write_text(name, text.text, text.text_bytes) }
    }

    dcambuf_alloc(camera: usize, frames: i32) {
        let mut bench = bench();
        bench.note("alloc".into());
        bench.camera(camera)?.allocate(usize::try_from(frames).map_err(|_| Code::NOMEMORY)?)
    }

    dcambuf_release(camera: usize, _kind: i32) {
        let mut bench = bench();
        bench.note("release".into());
        let index = bench.index_of(camera)?;
        bench.cameras[index].release()
    }

    dcambuf_lockframe(camera: usize, frame: *mut Frame) {
        // SAFETY: as the caller promises.
        let frame = unsafe { checked(frame) }?;
        let mut bench = bench();
        let (index, place) = bench.draw(camera, frame.slot)?;
        let camera = &bench.cameras[index];
        let (slot, region) = (&camera.slots[place], camera.region.ok_or(Code::NOTREADY)?);
        frame.pixels = slot.pixels.as_ptr().cast();
        (frame.row_bytes, frame.pixel_type) = (2 * region.width as i32, 2);
        (frame.width, frame.height) = (region.width as i32, region.height as i32);
        (frame.left, frame.top) = (region.left as i32, region.top as i32);
        frame.seconds = slot.done_at.as_secs() as u32;
        frame.microseconds = slot.done_at.subsec_micros() as i32;
        (frame.frame_stamp, frame.camera_stamp) = (slot.stamp.cast_signed(), 0);
        Ok(())
    }

    dcamcap_start(camera: usize, _mode: i32) {
        let mut bench = bench();
        bench.note("start".into());
        bench.start(camera)
    }

    dcamcap_stop(camera: usize) {
        let mut bench = bench();
        bench.note("stop".into());
        bench.advance();
        let index = bench.index_of(camera)?;
        bench.cameras[index].stop();
        bench.cameras[index].check()
    }

    dcamcap_status(camera: usize, status: *mut i32) {
        let found = bench().camera(camera)?.status();
        if status.is_null() { return Err(Code::INVALIDPARAM); }
        // SAFETY: not null, as the caller promises a number.
        unsafe { status.write(found) };
        Ok(())
    }

    dcamcap_transferinfo(camera: usize, info: *mut TransferInfo) {
        // SAFETY: as the caller promises.
        let info = unsafe { checked(info) }?;
        let mut bench = bench();
        bench.advance();
        let camera = bench.camera(camera)?;
        (info.newest_slot, info.frame_count) = (camera.newest_slot(), camera.written.cast_signed());
        Ok(())
    }

    dcamwait_open(open: *mut WaitOpen) {
        // SAFETY: as the caller promises.
        let open = unsafe { checked(open) }?;
        open.wait = bench().open_wait(open.handle)?;
        open.supported = 0x1F;
        Ok(())
    }

    dcamwait_close(wait: usize) {
        let mut bench = bench();
        bench.note("wait-close".into());
        bench.close_wait(wait)
    }

    dcamwait_start(wait: usize, start: *mut WaitStart) {
        // SAFETY: as the caller promises.
        let start = unsafe { checked(start) }?;
        let timeout = Duration::from_millis(u64::try_from(start.timeout_ms).unwrap_or(u64::MAX >> 24));
        let begun = Instant::now();
        let mut bench = bench();
        loop {
            if let Some(happened) = bench.happened(wait, start.mask)? {
                start.happened = happened;
                return Ok(());
            }
            let left = timeout.saturating_sub(begun.elapsed());
            if left.is_zero() {
                return Err(Code::TIMEOUT);
            }
            let next = bench.next_in().min(left);
            (bench, _) = CHANGED.wait_timeout(bench, next).unwrap_or_else(PoisonError::into_inner);
        }
    }

    dcamwait_abort(wait: usize) {
        let mut bench = bench();
        bench.note("abort".into());
        bench.abort(wait)
    }
}

/// Tells the bench what to do, in the words of `command.rs`; not part of DCAM-API.
///
/// # Safety
/// `command` ends with 0; `text` is null or has room for `bytes` bytes.
#[unsafe(no_mangle)]
unsafe extern "C" fn sofiscope_dcam_bench(command: *const c_char, text: *mut c_char, bytes: i32) -> i32 {
    // SAFETY: the caller promises a text that ends.
    let command = unsafe { CStr::from_ptr(command) }.to_string_lossy().into_owned();
    let mut bench = bench();
    let told = crate::command::parse(&command)
        .and_then(|commands| commands.into_iter().try_fold(String::new(), |_, command| bench.obey(command)));
    drop(bench);
    CHANGED.notify_all();
    let (words, done) = match told {
        Ok(words) => (words, 1),
        Err(words) => (words, 0),
    };
    // SAFETY: the caller promises the room.
    match unsafe { write_text(&words, text, bytes) } {
        Ok(()) => done,
        Err(code) => code.0.cast_signed(),
    }
}

fn set(camera: usize, id: i32, value: f64) -> Result<f64, Code> {
    let mut bench = bench();
    bench.advance();
    let name = find(id).map_or("?", |spec| spec.name);
    bench.note(format!("set {name} {value}"));
    let camera = bench.camera(camera)?;
    let spec = camera.may_set(id)?;
    camera.settings.set(spec, id, value)?;
    camera.settings.get(id)
}

fn flags(spec: &Spec) -> u32 {
    let kind = match spec.kind {
        Kind::Mode(_) => 0x1000_0001,
        Kind::Long => 2,
        Kind::Real => 3,
    };
    let access = match spec.access {
        Access::Never => 0,
        Access::Stopped => 0x0002_2000,
        Access::Always => 0x0002_3000,
    };
    let step = if spec.step > 0.0 || spec.step == LINE_FAST_S { 0x4000_0000 } else { 0 };
    0x8000_0000 | 0x2000_0000 | 0x0001_0000 | kind | access | step
}
