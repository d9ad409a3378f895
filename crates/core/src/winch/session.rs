//! A board that obeys lines of text: four paths, drivers, status lines, the deadman. It has no line, no pin and no clock of its own.
//!
//! Time comes as one call for each millisecond. The board decides when steps are made. A board with several lines to hosts has one
//! session, and a [`LineReader`] for each line. The Uno does the same in assembly: firmware/uno/src/bin/uno-winch/winch.

use super::path::{Limits, Path, Slice};
use super::reply::LineReply;
use super::text::{LineCommand, LineReader};
use crate::wire::Settings;

/// The interval of status lines at first, ms.
pub const FIRST_REPORT_MS: u16 = 200;

/// A stop is over when the path is slower than this, 2^-16 steps/s: 1 step/s.
const STOPPED: u32 = 1 << 16;

/// Four axes, and the state that commands have set.
///
/// ```
/// use pulsetrain_core::winch::letters::InMemory;
/// use pulsetrain_core::winch::session::Session;
/// use pulsetrain_core::winch::text::{Heard, LineReader};
/// let (mut session, mut reader) = (Session::new(), LineReader::new());
/// let mut steps = 0;
/// for byte in *b"enable 1\nv x 1000\n" {
///     if let Heard::Command(verb) = reader.push::<InMemory>(byte) {
///         assert_eq!(session.obey(verb, &mut reader), None, "nothing is to be said");
///     }
/// }
/// for _ in 0..10_000 {
///     steps += u32::from(session.millisecond()[0].count);
/// }
/// assert!(session.drives() && (9_000..11_000).contains(&steps));
/// ```
#[derive(Clone, Debug)]
pub struct Session {
    paths: [Path; 4],
    /// There was a command for axes or for their drivers, so that pins are outputs.
    wired: bool,
    /// The drivers must be on, and paths move.
    drives: bool,
    /// The drivers will be switched off as soon as nothing moves.
    releasing: bool,
    report_ms: u16,
    /// Since the last status line.
    unreported_ms: u32,
    /// The longest silence, while the drivers are on; 0: any.
    deadman_ms: u16,
    /// Since the last command.
    unheard_ms: u32,
    /// The drivers are switched off after this long a rest, ms; 0: never.
    idle_ms: u16,
    /// The time since an axis last moved, or the drivers were switched on, ms.
    rested_ms: u16,
}

impl Default for Session {
    fn default() -> Session {
        Session::new()
    }
}

impl Session {
    /// The state of a board after reset: at rest at 0, drivers off.
    #[must_use]
    pub const fn new() -> Session {
        Session {
            paths: [const { Path::new() }; 4],
            wired: false,
            drives: false,
            releasing: false,
            report_ms: FIRST_REPORT_MS,
            unreported_ms: 0,
            deadman_ms: 0,
            unheard_ms: 0,
            idle_ms: 0,
            rested_ms: 0,
        }
    }

    /// The state after reset of a board with stored settings.
    #[must_use]
    pub fn keeping(settings: &Settings) -> Session {
        let mut session = Session { deadman_ms: settings.deadman_ms, idle_ms: settings.idle_ms, ..Session::new() };
        if let Some(limits) = Limits::new(settings.vmax, settings.amax) {
            session.paths.iter_mut().for_each(|path| path.set_limits(&limits));
        }
        session
    }

    /// Obeys the command that `reader` has just read, and returns the reply.
    pub fn obey(&mut self, verb: LineCommand, reader: &mut LineReader) -> Option<LineReply> {
        self.unheard_ms = 0;
        reader.obey(&mut self.paths);
        let value = reader.value();
        let [low, high, ..] = value.to_le_bytes();
        // The reader refuses values of more than 16 bits here.
        let ms = u16::from_le_bytes([low, high]);
        match verb {
            LineCommand::Target | LineCommand::Move | LineCommand::Drift => self.enable(),
            LineCommand::Enable if value != 0 => self.enable(),
            LineCommand::Enable => (self.wired, self.releasing) = (true, self.drives),
            LineCommand::Impulse | LineCommand::Ramp => (self.wired, self.releasing) = (true, false),
            LineCommand::Gains | LineCommand::Limits => self.wired = true,
            LineCommand::Report => self.report_ms = ms,
            LineCommand::Deadman => self.deadman_ms = ms,
            LineCommand::Strict => reader.set_strict(value != 0),
            LineCommand::Version => return Some(LineReply::Id),
            LineCommand::Ping => return Some(LineReply::Awake),
            LineCommand::Unknown => {}
        }
        None
    }

    /// Ends the host's silence: call it for a line that is no [`LineCommand`].
    pub const fn heard(&mut self) {
        self.unheard_ms = 0;
    }

    /// Whether the host was silent for longer than the deadman allows.
    #[must_use]
    pub const fn deadman_expired(&self) -> bool {
        self.deadman_ms != 0 && self.unheard_ms > self.deadman_ms as u32
    }

    /// Works out the next millisecond of all paths. While the drivers are off, paths stand still.
    pub fn millisecond(&mut self) -> [Slice; 4] {
        if self.drives && self.deadman_ms != 0 && self.unheard_ms == u32::from(self.deadman_ms) {
            self.paths.iter_mut().for_each(Path::stop);
        }
        self.unheard_ms = self.unheard_ms.saturating_add(1);
        self.unreported_ms = self.unreported_ms.saturating_add(1);
        if !self.drives {
            return [Slice::NONE; 4];
        }
        let slices = self.paths.each_mut().map(Path::tick);
        self.rested_ms = if self.is_slow() { self.rested_ms.saturating_add(1) } else { 0 };
        slices
    }

    /// Whether all axes are slower than 1 step/s.
    fn is_slow(&self) -> bool {
        self.paths.iter().all(|path| path.speed().unsigned_abs() < STOPPED)
    }

    /// Whether there was a command for axes or their drivers. Before the first, the board leaves its pins alone.
    #[must_use]
    pub const fn is_wired(&self) -> bool {
        self.wired
    }

    /// Whether the drivers must be on.
    #[must_use]
    pub const fn drives(&self) -> bool {
        self.drives
    }

    /// Whether the drivers must be released when all steps that were worked out are made: after `enable 0` when the paths have stopped, or
    /// after as long a rest as settings say.
    #[must_use]
    pub fn has_stopped(&self) -> bool {
        let is_idle = self.drives && self.idle_ms != 0 && self.rested_ms >= self.idle_ms;
        is_idle || (self.releasing && self.is_slow())
    }

    /// The drivers are off now.
    pub const fn release(&mut self) {
        (self.drives, self.releasing) = (false, false);
    }

    /// Whether a status line is due. Call it before each [`millisecond`](Session::millisecond).
    #[must_use]
    pub const fn is_report_due(&self) -> bool {
        self.unreported_ms >= self.report_ms as u32
    }

    /// Notes that a status line was sent, or that there is no host to read one.
    pub const fn reported(&mut self) {
        self.unreported_ms = 0;
    }

    /// Whether no axis moves or has still to move.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.paths.iter().all(Path::is_at_rest)
    }

    const fn enable(&mut self) {
        (self.wired, self.drives, self.releasing) = (true, true, false);
        self.rested_ms = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::winch::letters::InMemory;
    use crate::winch::text::Heard;

    fn tell(session: &mut Session, lines: &[u8]) {
        let mut reader = LineReader::new();
        for byte in lines {
            if let Heard::Command(verb) = reader.push::<InMemory>(*byte) {
                assert_eq!(session.obey(verb, &mut reader), None);
            }
        }
    }

    /// Milliseconds until the drivers are to be off, and those since the last step; `None` if they stay on for 20 s.
    fn until_off(session: &mut Session) -> Option<(u32, u32)> {
        let mut rested = 0;
        (1..20_000).find_map(|ms| {
            rested = if session.millisecond()[0].count == 0 { rested + 1 } else { 0 };
            session.has_stopped().then_some((ms, rested))
        })
    }

    #[test]
    fn drivers_are_released_after_the_rest_that_is_kept() {
        let settings = Settings { idle_ms: 250, ..Settings::default() };
        let mut session = Session::keeping(&settings);
        assert_eq!(until_off(&mut session), None, "they are off");
        tell(&mut session, b"g x 5 1\nd x 100\n");
        let (ms, rested) = until_off(&mut session).expect("it rests at last");
        assert!(ms > 500 && rested >= 250, "{ms} {rested}");
        // A command that switches them on restarts the time of rest, also where nothing moves.
        tell(&mut session, b"enable 1\n");
        assert_eq!(until_off(&mut session).map(|off| off.0), Some(250));
        let mut session = Session::keeping(&Settings::default());
        tell(&mut session, b"g x 5 1\nd x 100\n");
        assert_eq!(until_off(&mut session), None, "nothing is kept");
    }
}
