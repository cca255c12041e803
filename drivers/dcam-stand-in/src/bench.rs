//! The bench: two cameras, their trigger lines, the handles that programs have.
//!
//! In: calls of the library, commands, the time. Out: answers, frames. Never: waits; the exports do.
//! Fails: [`Code`].

use std::path::Path;
use std::time::Duration;

use sofiscope_hal::Channel;
use sofiscope_virtual::OpticalTable;
use sofiscope_virtual::table::Quantity;

use crate::camera::Camera;
use crate::codes::{Code, event};
use crate::command::{Command, Fault};
use crate::line::Line;
use crate::view::View;

/// Handles of cameras begin here, those of waits there: no two are ever the same.
const CAMERA_HANDLES: usize = 0x5F00_0000;
const WAIT_HANDLES: usize = 0x6F00_0000;
const MOST_CALLS: usize = 4096;

/// A scene for whoever names none.
const DEFAULT_SCENE: &str = "beads";

/// A wait that a program opened.
#[derive(Debug)]
struct Wait {
    handle: usize,
    camera: usize,
    /// Frames that it was told of.
    seen: u32,
    aborted: bool,
}

/// Everything behind the library.
#[derive(Debug)]
pub(crate) struct Bench {
    pub(crate) cameras: [Camera; 2],
    pub(crate) serials: [String; 2],
    /// Handle of each camera while it is open.
    open: [Option<usize>; 2],
    waits: Vec<Wait>,
    /// The trigger line and the first output of camera 0.
    lines: [Line; 2],
    /// Camera 1 hears the output of camera 0.
    cable: bool,
    table: Option<(OpticalTable, f64)>,
    scene: String,
    view: Option<View>,
    handles: usize,
    pub(crate) users: u32,
    journal: Vec<String>,
    /// When the bench was set up, on the clock of the optical table.
    begun: Duration,
}

impl Bench {
    pub(crate) fn new() -> Self {
        Self {
            cameras: Default::default(),
            serials: ["000001".into(), "000002".into()],
            open: [None; 2],
            waits: Vec::new(),
            lines: Default::default(),
            cable: false,
            table: None,
            scene: DEFAULT_SCENE.into(),
            view: None,
            handles: 0,
            users: 0,
            journal: Vec::new(),
            begun: sofiscope_virtual::monotonic(),
        }
    }

    fn now(&self) -> Duration {
        sofiscope_virtual::monotonic().saturating_sub(self.begun)
    }

    pub(crate) fn note(&mut self, call: String) {
        if self.journal.len() < MOST_CALLS {
            self.journal.push(call);
        }
    }

    /// Lets everything happen that is due.
    pub(crate) fn advance(&mut self) {
        let now = self.now();
        if let Some((table, seen)) = &mut self.table {
            let pulses = table.get(Quantity::Pulses);
            let number = (pulses - *seen).clamp(0.0, 1e4) as u32;
            if number > 0 {
                let last = Duration::try_from_secs_f64(table.get(Quantity::LastPulse)).unwrap_or_default();
                let last = last.saturating_sub(self.begun).min(now);
                // Several at once are spread evenly since the one before.
                let total = self.lines[0].total();
                let before = total.checked_sub(1).and_then(|number| self.lines[0].at(number)).unwrap_or(last);
                let gap = last.saturating_sub(before) / number;
                for back in (0..number).rev() {
                    self.lines[0].pulse(last.saturating_sub(gap * back));
                }
            }
            *seen = pulses;
        }
        self.lines[0].advance(now);
        let [line, output] = &mut self.lines;
        let [first, second] = &mut self.cameras;
        let gives = first.settings.gives_frame_pulses();
        first.advance(line, now, |at| {
            if gives {
                output.pulse(at);
            }
        });
        second.advance(if self.cable { output } else { line }, now, |_| {});
    }

    /// When something happens next; soon when somebody else's table gives the pulses.
    pub(crate) fn next_in(&self) -> Duration {
        let polled = if self.table.is_some() { Duration::from_millis(1) } else { Duration::from_millis(50) };
        let next = self.cameras.iter().enumerate();
        let next = next.filter_map(|(index, camera)| camera.next_at(self.line_of(index))).min();
        next.map_or(polled, |at| at.saturating_sub(self.now()).min(polled)).max(Duration::from_micros(50))
    }

    fn line_of(&self, camera: usize) -> &Line {
        &self.lines[usize::from(camera == 1 && self.cable)]
    }

    pub(crate) fn open(&mut self, index: i32) -> Result<usize, Code> {
        let index = usize::try_from(index).ok().filter(|index| *index < 2).ok_or(Code::INVALIDCAMERA)?;
        if self.users == 0 {
            return Err(Code::NOTREADY);
        }
        self.cameras[index].check().map_err(|_| Code::INVALIDCAMERA)?;
        if self.open[index].is_some() {
            return Err(Code::ALREADYOPENED);
        }
        self.handles += 1;
        let handle = CAMERA_HANDLES + self.handles;
        self.open[index] = Some(handle);
        Ok(handle)
    }

    pub(crate) fn close(&mut self, handle: usize) -> Result<(), Code> {
        let index = self.index_of(handle)?;
        self.waits.retain(|wait| wait.camera != index);
        self.cameras[index].stop();
        let released = self.cameras[index].release();
        self.open[index] = None;
        released
    }

    /// The place of an open camera.
    pub(crate) fn index_of(&self, handle: usize) -> Result<usize, Code> {
        self.open.iter().position(|open| *open == Some(handle)).ok_or(Code::INVALIDHANDLE)
    }

    /// The camera of a handle, if it is plugged in.
    pub(crate) fn camera(&mut self, handle: usize) -> Result<&mut Camera, Code> {
        let index = self.index_of(handle)?;
        self.cameras[index].check()?;
        Ok(&mut self.cameras[index])
    }

    pub(crate) fn start(&mut self, handle: usize) -> Result<(), Code> {
        self.camera(handle)?;
        self.advance();
        let (index, now) = (self.index_of(handle)?, self.now());
        self.waits.iter_mut().filter(|wait| wait.camera == index).for_each(|wait| wait.seen = 0);
        let line = &self.lines[usize::from(index == 1 && self.cable)];
        self.cameras[index].start(line, now)
    }

    pub(crate) fn open_wait(&mut self, camera: usize) -> Result<usize, Code> {
        let camera = self.index_of(camera)?;
        self.handles += 1;
        let handle = WAIT_HANDLES + self.handles;
        self.waits.push(Wait { handle, camera, seen: 0, aborted: false });
        Ok(handle)
    }

    pub(crate) fn close_wait(&mut self, handle: usize) -> Result<(), Code> {
        let place = self.waits.iter().position(|wait| wait.handle == handle).ok_or(Code::INVALIDHANDLE)?;
        self.waits.swap_remove(place);
        Ok(())
    }

    pub(crate) fn abort(&mut self, handle: usize) -> Result<(), Code> {
        self.waits.iter_mut().find(|wait| wait.handle == handle).ok_or(Code::INVALIDHANDLE)?.aborted = true;
        Ok(())
    }

    /// What a wait can tell now; nothing while it has to go on.
    pub(crate) fn happened(&mut self, handle: usize, mask: i32) -> Result<Option<i32>, Code> {
        self.advance();
        let wait = self.waits.iter_mut().find(|wait| wait.handle == handle).ok_or(Code::INVALIDHANDLE)?;
        let camera = &mut self.cameras[wait.camera];
        camera.check()?;
        if std::mem::take(&mut wait.aborted) {
            return Err(Code::ABORT);
        }
        if camera.lost > 0 {
            camera.lost -= 1;
            return Err(Code::LOSTFRAME);
        }
        if camera.too_frequent > 0 {
            camera.too_frequent -= 1;
            return Err(Code::TOOFREQUENTTRIGGER);
        }
        if mask & event::FRAME_READY != 0 && camera.written != wait.seen {
            wait.seen = camera.written;
            return Ok(Some(event::FRAME_READY));
        }
        let stopped = mask & event::STOPPED != 0 && !camera.is_capturing();
        Ok(stopped.then_some(event::STOPPED))
    }

    /// Draws the frame of a buffer, unless it is drawn; gives the buffer's place.
    pub(crate) fn draw(&mut self, handle: usize, slot: i32) -> Result<(usize, usize), Code> {
        self.camera(handle)?;
        let index = self.index_of(handle)?;
        let camera = &mut self.cameras[index];
        let place = usize::try_from(if slot < 0 { camera.newest_slot() } else { slot });
        let place = place.ok().filter(|place| *place < camera.slots.len()).ok_or(Code::INVALIDFRAMEINDEX)?;
        if place >= camera.written as usize {
            return Err(Code::INVALIDFRAMEINDEX);
        }
        let region = camera.region.ok_or(Code::NOTREADY)?;
        let slot = &mut camera.slots[place];
        if slot.drawn != Some(slot.stamp) {
            let channel = Channel::BOTH[index];
            let view = match &mut self.view {
                Some(view) => view,
                empty => empty.insert(View::named(&self.scene).map_err(|_| Code::FAILREADCAMERA)?),
            };
            view.expose(channel, slot.exposure, region, &mut slot.pixels);
            slot.drawn = Some(slot.stamp);
        }
        Ok((index, place))
    }

    /// Does what it is told; gives an answer, or what was wrong.
    pub(crate) fn obey(&mut self, command: Command) -> Result<String, String> {
        self.advance();
        match command {
            Command::Reset => {
                let (users, view) = (self.users, self.view.take());
                let scene = std::mem::take(&mut self.scene);
                *self = Self { users, view, scene, handles: self.handles, ..Self::new() };
            }
            Command::Scene(name) => {
                self.view = Some(View::named(&name)?);
                self.scene = name;
            }
            Command::Serials(serials) => self.serials = serials,
            Command::Table(path) => {
                let table =
                    OpticalTable::join(Path::new(&path)).map_err(|error| format!("{path}: {error}"))?;
                let seen = table.get(Quantity::Pulses);
                self.table = Some((table, seen));
            }
            Command::Pulses(period, number) => {
                let now = self.now();
                if !self.lines[0].start(now, period, number) {
                    return Err("busy".into());
                }
            }
            Command::StopPulses => {
                let now = self.now();
                self.lines[0].stop(now);
            }
            Command::Cable(is_there) => self.cable = is_there,
            Command::Camera(index, fault) => self.break_camera(index, fault),
            Command::Journal => return Ok(std::mem::take(&mut self.journal).join("\n")),
            Command::Open => {
                let cameras = self.open.iter().flatten().count();
                let rings = self.cameras.iter().filter(|camera| !camera.slots.is_empty()).count();
                return Ok(format!("{} {cameras} {} {rings}", self.users, self.waits.len()));
            }
        }
        Ok(String::new())
    }

    fn break_camera(&mut self, index: usize, fault: Fault) {
        let faults = &mut self.cameras[index].faults;
        match fault {
            Fault::Lose(stamp) => {
                faults.lose.insert(stamp);
            }
            Fault::Miss(pulse) => {
                faults.miss.insert(pulse);
            }
            Fault::Unplug => faults.unplugged = true,
            Fault::Plug => (faults.unplugged, faults.unplug_after) = (false, None),
            Fault::UnplugAfter(frames) => faults.unplug_after = Some(frames),
            Fault::Busy(times) => faults.busy = times,
        }
    }
}
