//! Answers commands; knows who has control, and takes it away from whoever stays silent.

use std::collections::VecDeque;
use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rustix::net::{AddressFamily, SocketAddrV4, SocketType, sockopt};

use super::gvcp::{self, Command, Request, Status};
use super::gvsp::Packets;
use super::registers::{DISCOVERY_BYTES, Effect, Registers};
use super::{FrameSource, GigeRecord, GigeSettings, exposures, sending};

/// Longest wait for a command; also how soon a raised flag is seen.
const LONGEST_WAIT: Duration = Duration::from_millis(10);
/// Frames whose packets can be sent again.
const KEPT: usize = 8;

/// A camera on its address.
pub struct GigeCamera {
    settings: GigeSettings,
    source: Box<dyn FrameSource>,
    control: UdpSocket,
    discovery: Option<UdpSocket>,
    stream: UdpSocket,
    record: GigeRecord,
}

impl std::fmt::Debug for GigeCamera {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("GigeCamera").field("settings", &self.settings).finish_non_exhaustive()
    }
}

impl GigeCamera {
    /// Takes the address; commands wait until the camera is served.
    ///
    /// # Errors
    /// When the address is not one of this computer, or taken.
    pub fn open(settings: GigeSettings, source: impl FrameSource + 'static) -> io::Result<Self> {
        let control = UdpSocket::bind((settings.address, gvcp::PORT))?;
        control.set_read_timeout(Some(LONGEST_WAIT))?;
        let stream = UdpSocket::bind((settings.address, 0))?;
        // Cameras are found by broadcast as well; where that is not allowed, their address is enough.
        let discovery = broadcasts().ok();
        let record = GigeRecord::default();
        Ok(Self { settings, source: Box::new(source), control, discovery, stream, record })
    }

    /// What the camera will have done to its own frames.
    #[must_use]
    pub fn record(&self) -> GigeRecord {
        self.record.clone()
    }

    /// Lives until `over` is raised.
    ///
    /// # Errors
    /// When the network fails.
    pub fn serve(self, over: &AtomicBool) -> io::Result<()> {
        let Self { settings, mut source, control, discovery, stream, record } = self;
        let state =
            State { registers: Registers::new(&settings), controller: None, run: 0, software_pulses: 0 };
        let body = Body {
            settings,
            state: Mutex::new(state),
            changed: Condvar::new(),
            kept: Mutex::new(VecDeque::new()),
            stream,
            record,
            is_silent: AtomicBool::new(false),
            is_over: AtomicBool::new(false),
        };
        std::thread::scope(|scope| {
            scope.spawn(|| exposures::run(&body, source.as_mut()));
            if let Some(discovery) = &discovery {
                scope.spawn(|| body.answer_broadcasts(discovery, &control));
            }
            let served = body.answer(&control, over);
            body.is_over.store(true, Relaxed);
            body.changed.notify_all();
            served
        })
    }
}

/// A socket that hears what is sent to everybody.
fn broadcasts() -> io::Result<UdpSocket> {
    let socket = rustix::net::socket(AddressFamily::INET, SocketType::DGRAM, None)?;
    sockopt::set_socket_reuseaddr(&socket, true)?;
    rustix::net::bind(&socket, &SocketAddrV4::new(Ipv4Addr::BROADCAST, gvcp::PORT))?;
    let socket = UdpSocket::from(socket);
    socket.set_read_timeout(Some(LONGEST_WAIT))?;
    Ok(socket)
}

/// What both threads of a camera share.
pub(super) struct Body {
    pub(super) settings: GigeSettings,
    state: Mutex<State>,
    pub(super) changed: Condvar,
    kept: Mutex<VecDeque<Arc<Packets>>>,
    pub(super) stream: UdpSocket,
    pub(super) record: GigeRecord,
    /// A fault: nothing is answered any more.
    pub(super) is_silent: AtomicBool,
    pub(super) is_over: AtomicBool,
}

pub(super) struct State {
    pub(super) registers: Registers,
    /// Who has control, and when it was last heard.
    controller: Option<(SocketAddr, Duration)>,
    /// Acquisitions begun.
    pub(super) run: u64,
    pub(super) software_pulses: u64,
}

impl Body {
    pub(super) fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Keeps a frame for a while, should its packets be asked for again.
    pub(super) fn keep(&self, frame: Arc<Packets>) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.len() == KEPT {
            kept.pop_front();
        }
        kept.push_back(frame);
    }

    fn kept(&self, block_id: u16) -> Option<Arc<Packets>> {
        let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.iter().rev().find(|frame| frame.block_id == block_id).cloned()
    }

    fn answer(&self, control: &UdpSocket, over: &AtomicBool) -> io::Result<()> {
        let mut datagram = [0; 1024];
        while !over.load(Relaxed) {
            let now = crate::monotonic();
            self.miss_heartbeat(now);
            let Some((length, from)) = received(control.recv_from(&mut datagram))? else { continue };
            if self.is_silent.load(Relaxed) {
                continue;
            }
            if let Some(request) = gvcp::request(&datagram[..length])
                && let Some(answer) = self.obey(&request, from, now)
            {
                // Whoever asked may be gone already.
                let _gone = control.send_to(&answer, from);
            }
        }
        Ok(())
    }

    fn answer_broadcasts(&self, discovery: &UdpSocket, control: &UdpSocket) {
        let mut datagram = [0; 1024];
        while !self.is_over.load(Relaxed) {
            let Ok(Some((length, from))) = received(discovery.recv_from(&mut datagram)) else { continue };
            if let Some(request) = gvcp::request(&datagram[..length])
                && request.command == Command::Discover
                && !self.is_silent.load(Relaxed)
                && let Some(answer) = self.obey(&request, from, crate::monotonic())
            {
                let _gone = control.send_to(&answer, from);
            }
        }
    }

    /// Takes control away from whoever has it; the camera stops.
    pub(super) fn lose_control(&self) {
        self.state().take_control(None, 0);
        self.changed.notify_all();
    }

    /// Whoever has control and stays silent loses it, and the camera stops.
    fn miss_heartbeat(&self, now: Duration) {
        let state = self.state();
        let heartbeat = state.registers.heartbeat();
        let is_missed = state.controller.is_some_and(|(_, heard)| now.saturating_sub(heard) > heartbeat);
        drop(state);
        if is_missed {
            self.lose_control();
        }
    }

    fn obey(&self, request: &Request<'_>, from: SocketAddr, now: Duration) -> Option<Vec<u8>> {
        if let Command::Resend { block_id, first, last } = request.command {
            if !self.settings.faults.no_resend
                && let Some(frame) = self.kept(block_id)
            {
                sending::send_again(self, &frame, first..=last);
            }
            return None;
        }
        let mut state = self.state();
        if let Some((controller, heard)) = &mut state.controller
            && *controller == from
        {
            *heard = now;
        }
        let mut payload = Vec::new();
        let status = match self.apply(&mut state, request, from, now, &mut payload) {
            Ok(()) => Status::Success,
            Err(status) => status,
        };
        request.wants_ack.then(|| gvcp::acknowledgement(request, status, &payload))
    }

    fn apply(
        &self,
        state: &mut State,
        request: &Request<'_>,
        from: SocketAddr,
        now: Duration,
        payload: &mut Vec<u8>,
    ) -> Result<(), Status> {
        match request.command {
            Command::Discover => payload.extend(state.registers.read(0, DISCOVERY_BYTES)?),
            Command::ReadRegisters(addresses) => {
                for address in addresses.chunks_exact(4).filter_map(gvcp::word) {
                    payload.extend(state.registers.read(address, 4)?);
                }
            }
            Command::WriteRegisters(pairs) => {
                for (index, pair) in pairs.chunks_exact(8).enumerate() {
                    let address = gvcp::word(pair).ok_or(Status::InvalidParameter)?;
                    self.write(state, address, &pair[4..], from, now)?;
                    *payload = vec![0, 0, 0, u8::try_from(index + 1).unwrap_or(u8::MAX)];
                }
            }
            Command::ReadMemory { address, num_bytes } => {
                payload.extend(address.to_be_bytes());
                payload.extend(state.registers.read(address, num_bytes)?);
            }
            Command::WriteMemory { address, bytes } => {
                self.write(state, address, bytes, from, now)?;
                payload.extend([0, 0]);
                payload.extend(u16::try_from(bytes.len()).unwrap_or(0).to_be_bytes());
            }
            Command::Resend { .. } | Command::Unknown(_) => return Err(Status::NotImplemented),
        }
        Ok(())
    }

    fn write(
        &self,
        state: &mut State,
        address: u32,
        bytes: &[u8],
        from: SocketAddr,
        now: Duration,
    ) -> Result<(), Status> {
        if state.controller.is_some_and(|(controller, _)| controller != from) {
            return Err(Status::AccessDenied);
        }
        match state.registers.write(address, bytes)? {
            Effect::None => {}
            Effect::Acquisition(begins) => {
                state.run += u64::from(begins && !state.registers.is_exposing);
                state.registers.is_exposing = begins;
            }
            Effect::SoftwareTrigger => state.software_pulses += 1,
            Effect::TestPacket(size) => {
                let destination = state.registers.setup().destination;
                // A test packet that does not get through is what the test is for.
                let _lost = self.stream.send_to(&vec![0; size.saturating_sub(28)], destination);
            }
            Effect::Control(0) => state.take_control(None, 0),
            Effect::Control(privilege) => state.take_control(Some((from, now)), privilege),
        }
        self.changed.notify_all();
        Ok(())
    }
}

impl State {
    fn take_control(&mut self, controller: Option<(SocketAddr, Duration)>, privilege: u32) {
        self.controller = controller;
        self.registers.set_control(privilege);
        self.registers.is_exposing &= controller.is_some();
    }
}

/// A datagram, or `None` when none came in time.
fn received(result: io::Result<(usize, SocketAddr)>) -> io::Result<Option<(usize, SocketAddr)>> {
    match result {
        Ok(datagram) => Ok(Some(datagram)),
        Err(error)
            if matches!(
                error.kind(),
                io::ErrorKind::WouldBlock
                    | io::ErrorKind::TimedOut
                    | io::ErrorKind::Interrupted
                    | io::ErrorKind::ConnectionRefused
            ) =>
        {
            Ok(None)
        }
        Err(error) => Err(error),
    }
}
