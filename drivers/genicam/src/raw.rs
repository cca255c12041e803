//! The calls into Aravis that have no safe form in its Rust binding.
#![expect(
    unsafe_code,
    reason = "the binding gives the bytes of a buffer as a pointer, and no serial numbers"
)]

use std::ffi::{CStr, c_char, c_uint};
use std::net::SocketAddrV4;
use std::os::fd::BorrowedFd;
use std::sync::{Mutex, PoisonError};

use aravis::Buffer;
use rustix::net::{SocketType, sockopt};

/// A camera that answers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Found {
    /// By which Aravis opens it.
    pub(crate) id: String,
    pub(crate) model: String,
    pub(crate) serial: String,
    /// Address on the network; empty on USB.
    pub(crate) address: String,
}

/// The list of devices is one for the whole process.
static DEVICE_LIST: Mutex<()> = Mutex::new(());

/// Asks all networks and ports for cameras; takes about a second.
pub(crate) fn cameras() -> Vec<Found> {
    let _guard = DEVICE_LIST.lock().unwrap_or_else(PoisonError::into_inner);
    // SAFETY: these functions take no pointers; the lock keeps other threads from replacing the list meanwhile.
    let number = unsafe {
        aravis_sys::arv_update_device_list();
        aravis_sys::arv_get_n_devices()
    };
    (0..number)
        .map(|index| Found {
            id: text(aravis_sys::arv_get_device_id, index),
            model: text(aravis_sys::arv_get_device_model, index),
            serial: text(aravis_sys::arv_get_device_serial_nbr, index),
            address: text(aravis_sys::arv_get_device_address, index),
        })
        .collect()
}

/// A text of the list of devices; called under its lock only.
fn text(get: unsafe extern "C" fn(c_uint) -> *const c_char, index: c_uint) -> String {
    // SAFETY: `get` is one of the readers of the list above, `index` is below its length, and the lock is held; a
    // reader gives null or a text that ends with zero and lives as long as the list.
    unsafe {
        let text = get(index);
        if text.is_null() { String::new() } else { CStr::from_ptr(text).to_string_lossy().into_owned() }
    }
}

/// A buffer whose memory is there: the first frame shall not wait for the system to find its pages.
pub(crate) fn buffer(num_bytes: usize) -> Buffer {
    let buffer = Buffer::new_allocate(num_bytes);
    let (data, _received) = buffer.data();
    if !data.is_null() {
        // SAFETY: the buffer was just made with `num_bytes` bytes of its own, and nobody else knows it.
        unsafe { data.write_bytes(0, num_bytes) };
    }
    buffer
}

/// Gives the socket of a stream its receive buffer at once; returns whether it was found.
///
/// Aravis does so with the first packet only, when the first frame may have lost some already.
pub(crate) fn enlarge_receive_buffer(port: u16, num_bytes: u32) -> bool {
    let Ok(descriptors) = std::fs::read_dir("/proc/self/fd") else { return false };
    let numbers = descriptors.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse::<i32>().ok());
    for number in numbers {
        // SAFETY: the number is used for two system calls at once and never closed; were it closed and used anew by
        // another thread meanwhile, `getsockname` tells, as no other socket has the port of a stream that lives.
        let socket = unsafe { BorrowedFd::borrow_raw(number) };
        let name = rustix::net::getsockname(socket).ok().and_then(|name| SocketAddrV4::try_from(name).ok());
        let is_stream = sockopt::socket_type(socket) == Ok(SocketType::DGRAM);
        if is_stream && name.is_some_and(|name| name.port() == port) {
            return sockopt::set_socket_recv_buffer_size(socket, num_bytes as usize).is_ok();
        }
    }
    false
}

/// The bytes that a buffer received.
pub(crate) fn bytes(buffer: &Buffer) -> &[u8] {
    let (data, length) = buffer.data();
    if data.is_null() || length == 0 {
        return &[];
    }
    // SAFETY: a buffer taken from its stream is written by nobody until it is given back, which takes it by value
    // and thus ends this borrow; `arv_buffer_get_data` gives its own memory and how much of it was received.
    unsafe { std::slice::from_raw_parts(data, length) }
}
