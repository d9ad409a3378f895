//! A live motion's board at a port: it may be unplugged and come back, and its positions are kept.

use pulsetrain_board::remote::in_words;
use pulsetrain_board::serial::{self, Listed, Usb};
use pulsetrain_board::{Board, BoardClock, Remote, RemoteError, Serial, WithReference};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::Cause;
use pulsetrain_motion::program::Program;
use pulsetrain_session::control::{Ended, Status};
use pulsetrain_session::drive::{DriveError, Driven, session_number, set_up, setup};
use pulsetrain_session::prepare::Prepared;

use crate::clock::Onward;
use crate::last_positions::{self, Keeper};
use crate::live::{FoundBoard, LiveBoard};
use pulsetrain_report::positions::start;
use pulsetrain_trace::Line;

/// A session with a board at a serial port.
type AtPort = Driven<WithReference<Remote<Serial>>>;

/// How a live motion begins.
pub(super) enum LiveBeginning<B> {
    /// The motors are about to move.
    Moving(Driven<B>),
    /// The motors rest where the motion begins.
    AtRest(Driven<B>),
    /// The board is still to be looked for.
    Resume,
}

impl<B> LiveBeginning<B> {
    pub(super) fn of(driven: Driven<B>, is_at_rest: bool) -> LiveBeginning<B> {
        if is_at_rest { LiveBeginning::AtRest(driven) } else { LiveBeginning::Moving(driven) }
    }

    /// The lines of its trace.
    pub(super) fn lines(&self) -> &[Line] {
        match self {
            LiveBeginning::Moving(driven) | LiveBeginning::AtRest(driven) => &driven.lines,
            LiveBeginning::Resume => &[],
        }
    }
}

/// A board at a serial port.
pub(super) struct OnPort {
    port: String,
    /// The port's USB device, by which it is found at another name.
    usb: Option<Usb>,
    /// The motion, with the motors as they are set up now.
    prepared: Prepared,
    baud: Baud,
    keeper: Keeper,
    known: Known,
    /// The board that answered the last look.
    answered: Option<Remote<Serial>>,
}

/// What is known of the board's positions.
enum Known {
    /// They are those of a session.
    Running,
    /// Of a session that was lost: its clock, the port's time, which goes on, and each motor's start, steps.
    Lost { clock: BoardClock, time: Onward, start: Vec<f64> },
    /// What an earlier run has kept.
    Kept,
}

impl OnPort {
    /// A board with which a session has begun; or, if `resumes`, one of which an earlier run has kept the positions.
    pub(super) fn new(port: &str, prepared: Prepared, baud: Baud, resumes: bool) -> OnPort {
        OnPort {
            port: port.to_owned(),
            usb: usb_at(port, &serial::list()),
            keeper: Keeper::new(port),
            prepared,
            baud,
            known: if resumes { Known::Kept } else { Known::Running },
            answered: None,
        }
    }

    /// What the board that answers knows of the positions.
    fn ask(&self, remote: &mut Remote<Serial>) -> Result<FoundBoard, RemoteError> {
        // Motors may still brake, or go on to the end of their plan.
        remote.wait_for_rest(|| true)?;
        let status = remote.status()?;
        let counts: Vec<i64> = status.motors.as_slice().iter().map(|motor| motor.position.into()).collect();
        let now = remote.now();
        let program = &self.prepared.program;
        let info = remote.info();
        let reset = || format!("the board was reset ({})", in_words(info.last_reset));
        let is_counted = matches!(
            info.last_stop,
            Cause::None
                | Cause::Finished
                | Cause::HostLost
                | Cause::Lapsed
                | Cause::RanDry
                | Cause::BadItem
                | Cause::CheckFailed
                | Cause::StepMissed
                | Cause::Braked
        );
        let found = match &self.known {
            Known::Lost { clock, time, start } => {
                let expected = clock.tick_at(time.now()).unwrap_or(0);
                // A board that was reset counts its ticks from 0. Its clock may be off by a part in a hundred.
                let doubt = expected / 100 + u64::from(info.tick_hz) / 5;
                if now + doubt < expected || counts.len() != program.motors.len() {
                    return Ok(FoundBoard::Unknown(reset()));
                }
                Some(start.iter().zip(&counts).map(|(start, count)| start + *count as f64).collect())
            }
            _ if counts.len() != program.motors.len() => return Ok(FoundBoard::Unknown(reset())),
            _ => last_positions::recall(&self.port, program, &counts, now),
        };
        Ok(match found {
            Some(_) if !is_counted => {
                FoundBoard::Unknown(format!("the board stopped its motors at once ({})", in_words(info.last_stop)))
            }
            Some(found) => FoundBoard::Known(found),
            None => FoundBoard::Unknown("no run of this computer has left the positions at this board".to_owned()),
        })
    }
}

impl LiveBoard<WithReference<Remote<Serial>>> for OnPort {
    fn keep(&mut self, status: &Status, is_resting: bool) {
        let counts: Vec<i64> = status.motors.iter().map(|motor| motor.position).collect();
        self.keeper.goes_on(&self.prepared.program, &counts, status.at_s, is_resting);
    }

    fn close(&mut self, mut driven: AtPort, ended: Option<&Ended>) {
        if let Some(ended) = ended.filter(|ended| ended.uncertain.is_none()) {
            let clock = driven.board_mut().now();
            self.keeper.ends(&self.prepared.program, &ended.counted, clock);
        }
        self.keeper.finish();
        // The next program need not wait until the board takes this host for lost.
        drop(driven.close());
    }

    fn port(&self) -> Option<&str> {
        Some(&self.port)
    }

    fn lose(&mut self, mut driven: AtPort) {
        let board = driven.board_mut();
        let (clock, time) = (board.clock().clone(), Onward::from(pulsetrain_board::Port::now(board.port())));
        let start = self.prepared.program.motors.iter().map(start).collect();
        self.known = Known::Lost { clock, time, start };
        // The port is closed: the system may not give its name to the board otherwise.
        drop(driven);
    }

    fn look(&mut self) -> FoundBoard {
        let Some(port) =
            find_again(&self.port, self.usb.as_ref(), &serial::list(), |name| std::path::Path::new(name).exists())
        else {
            return FoundBoard::Nothing;
        };
        self.answered = None;
        let Ok(serial) = Serial::open(&port, false) else { return FoundBoard::Nothing };
        let Ok(mut remote) = Remote::open(serial, session_number()) else { return FoundBoard::Nothing };
        match self.ask(&mut remote) {
            Ok(found @ FoundBoard::Known(_)) => {
                self.answered = Some(remote);
                found
            }
            Ok(found) => {
                // Others may use the board until somebody says where the motors are.
                remote.close();
                found
            }
            Err(_) => {
                remote.close();
                FoundBoard::Nothing
            }
        }
    }

    fn last(&self) -> Option<Vec<f64>> {
        self.keeper.last(&self.prepared.program)
    }

    fn begin(&mut self, positions: &[f64]) -> Result<(AtPort, Program), DriveError> {
        let mut prepared = self.prepared.clone();
        for (motor, steps) in prepared.program.motors.iter_mut().zip(positions) {
            let rest = pulsetrain_motion::Law::speed(0.0, None).and_then(|rest| rest.shifted(*steps));
            if let Ok(rest) = rest {
                motor.law = rest;
            }
        }
        prepared.program.machines.clear();
        let remote = match self.answered.take() {
            Some(remote) => remote,
            None => {
                let list = serial::list();
                let port = find_again(&self.port, self.usb.as_ref(), &list, |_| true);
                let serial = Serial::open(port.as_deref().unwrap_or(&self.port), false).map_err(RemoteError::from)?;
                Remote::open(serial, session_number())?
            }
        };
        last_positions::forget(&self.port);
        let remote = set_up(remote, &setup(&prepared.program), self.baud, session_number(), || true)?;
        let driven = Driven::on_board(&prepared, remote, None)?;
        self.known = Known::Running;
        self.prepared = prepared;
        Ok((driven, self.prepared.program.clone()))
    }
}

/// The USB device at a port.
fn usb_at(port: &str, list: &[Listed]) -> Option<Usb> {
    // A symbolic link to a port has another name.
    let path = |name: &str| std::fs::canonicalize(name).unwrap_or_else(|_| name.into());
    list.iter().find(|listed| path(&listed.name) == path(port))?.usb.clone()
}

/// The name at which a board is found again: its port's, if the same device is there; or that of another port with the same USB device, by its serial
/// number.
fn find_again(port: &str, usb: Option<&Usb>, list: &[Listed], exists: impl Fn(&str) -> bool) -> Option<String> {
    let Some(usb) = usb else { return exists(port).then(|| port.to_owned()) };
    let is_same = |listed: &&Listed| {
        let there = listed.usb.as_ref();
        there
            .is_some_and(|there| (there.vendor, there.product, &there.serial) == (usb.vendor, usb.product, &usb.serial))
    };
    let at_name = list.iter().find(|listed| listed.name == port);
    match at_name {
        Some(listed) if is_same(&listed) => Some(port.to_owned()),
        // Without a serial number another device of its kind could be taken for it.
        _ if usb.serial.is_none() => None,
        _ => list.iter().find(is_same).map(|listed| listed.name.clone()),
    }
    .or_else(|| {
        (at_name.is_none() && exists(port) && usb_at(port, list).as_ref() == Some(usb)).then(|| port.to_owned())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_is_found_again_by_its_name_or_its_serial_number() {
        let usb = |serial: Option<&str>| Usb {
            vendor: 0x1209,
            product: 1,
            name: Some("Pulsetrain".to_owned()),
            serial: serial.map(str::to_owned),
        };
        let port = |name: &str, usb: Option<Usb>| Listed { name: name.to_owned(), usb };
        let check = |usb: Option<Usb>, list: &[Listed], exists: &[&str], expected: Option<&str>| {
            let found = find_again("/dev/x0", usb.as_ref(), list, |name| exists.contains(&name));
            assert_eq!(found.as_deref(), expected, "{usb:?} in {list:?}");
        };
        // A port that is no USB device, such as a virtual board's.
        check(None, &[], &["/dev/x0"], Some("/dev/x0"));
        check(None, &[], &[], None);
        let a = || usb(Some("A"));
        check(Some(a()), &[port("/dev/x0", Some(a()))], &["/dev/x0"], Some("/dev/x0"));
        check(Some(a()), &[port("/dev/x1", Some(a()))], &[], Some("/dev/x1"));
        check(Some(a()), &[port("/dev/x0", Some(usb(Some("B"))))], &["/dev/x0"], None);
        let both = [port("/dev/x0", Some(usb(Some("B")))), port("/dev/x1", Some(a()))];
        check(Some(a()), &both, &["/dev/x0", "/dev/x1"], Some("/dev/x1"));
        check(Some(a()), &[], &[], None);
        check(Some(usb(None)), &[port("/dev/x0", Some(usb(None)))], &["/dev/x0"], Some("/dev/x0"));
        check(Some(usb(None)), &[port("/dev/x1", Some(usb(None)))], &[], None);
    }
}
