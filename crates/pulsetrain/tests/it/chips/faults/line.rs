//! A line to a virtual board with one fault, at a byte or at a time.

use super::bench::Chip;
use pulsetrain_board::{Edge, Link, Port, PortError};
use pulsetrain_core::wire::Baud;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A direction on the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    ToBoard = 0,
    ToHost = 1,
}

/// Faults of a byte.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Mishap {
    Dropped,
    /// One bit changes; its number.
    Flipped(u8),
    Doubled,
    /// It changes places with the byte after it.
    Swapped,
}

/// The fault.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Fault {
    Nothing,
    /// A fault of one byte, which is counted from the port's opening.
    Byte {
        way: Way,
        at: u64,
        mishap: Mishap,
    },
    /// From then on nothing passes for a time.
    Silence {
        from: Duration,
        lasts: Duration,
    },
    /// From then on the computer does not have the port any more.
    Unplugged {
        from: Duration,
    },
    /// Then the host stops for a time. The board's bytes wait for it.
    Stall {
        at: Duration,
        lasts: Duration,
    },
    /// Then some bytes come to the board that no host has sent.
    Burst {
        at: Duration,
        bytes: u16,
    },
    /// Then another program opens the port.
    Opened {
        at: Duration,
    },
    /// From then on the host is slow: each look at the line takes this long.
    Slow {
        from: Duration,
        look: Duration,
    },
    /// Then another host says Hello.
    Hello {
        at: Duration,
    },
    /// Then the board's program hangs.
    Hung {
        at: Duration,
    },
    /// The adapter accepts every rate, but stays at its first.
    Stuck,
}

/// The line. Its clones share one state.
pub(crate) struct Line<P>(Arc<Mutex<Struck<P>>>);

impl<P> Clone for Line<P> {
    fn clone(&self) -> Line<P> {
        Line(Arc::clone(&self.0))
    }
}

struct Struck<P> {
    board: P,
    fault: Fault,
    /// Bytes that have gone each way.
    gone: [u64; 2],
    /// The first of two bytes that change places.
    swapped: Option<u8>,
    /// Bytes that came while the host stood still.
    held: Vec<u8>,
    /// All edges so far, and how many of them the host has got.
    edges: Vec<Edge>,
    told: usize,
}

impl<P: Chip> Line<P> {
    pub(crate) fn new(board: P, fault: Fault) -> Line<P> {
        let struck = Struck { board, fault, gone: [0; 2], swapped: None, held: Vec::new(), edges: Vec::new(), told: 0 };
        Line(Arc::new(Mutex::new(struck)))
    }

    /// Replaces the fault, from now on.
    pub(crate) fn set(&self, fault: Fault) {
        self.0.lock().unwrap().fault = fault;
    }

    /// Number of bytes so far.
    pub(crate) fn gone(&self, way: Way) -> u64 {
        self.0.lock().unwrap().gone[way as usize]
    }

    /// All edges so far.
    pub(crate) fn all_edges(&self) -> Vec<Edge> {
        let mut struck = self.0.lock().unwrap();
        struck.look();
        struck.edges.clone()
    }

    /// Forgets the edges so far, but keeps the levels of the lines in `kept`.
    pub(crate) fn forget_edges(&self, kept: &[u8]) {
        let mut struck = self.0.lock().unwrap();
        struck.look();
        let last = kept.iter().filter_map(|line| struck.edges.iter().rfind(|edge| edge.line == *line).copied());
        struck.edges = last.collect();
        struck.told = struck.edges.len();
    }

    /// Lets the board run for a time without a host.
    pub(crate) fn leave_alone(&self, lasts: Duration) {
        let mut struck = self.0.lock().unwrap();
        let until = struck.board.now() + lasts;
        struck.run(until, &mut Vec::new());
    }

    /// The port's time at a tick of the board.
    pub(crate) fn time_of(&self, tick: u64) -> Duration {
        let cycle = tick + self.0.lock().unwrap().board.zero().expect("its clock runs");
        Duration::from_nanos((u128::from(cycle) * 1_000_000_000 / u128::from(P::CYCLES_PER_S)) as u64)
    }
}

impl<P: Chip> Struck<P> {
    fn run(&mut self, until: Duration, into: &mut Vec<u8>) {
        while self.board.now() < until {
            self.board.receive(until, into).expect("a virtual port is always there");
        }
        self.look();
    }

    fn look(&mut self) {
        self.board.edges(&mut self.edges);
    }

    /// The part of bytes on their way that passes.
    fn pass(&mut self, way: Way, bytes: &[u8]) -> Vec<u8> {
        if let Fault::Silence { from, lasts } = self.fault
            && (from..from + lasts).contains(&self.board.now())
        {
            return Vec::new();
        }
        let mut passed = Vec::with_capacity(bytes.len() + 1);
        for byte in bytes {
            let place = self.gone[way as usize];
            self.gone[way as usize] += 1;
            let mishap = match self.fault {
                Fault::Byte { way: at_way, at, mishap } if (at_way, at) == (way, place) => Some(mishap),
                _ => None,
            };
            match mishap {
                Some(Mishap::Dropped) => {}
                Some(Mishap::Flipped(bit)) => passed.push(byte ^ (1 << bit)),
                Some(Mishap::Doubled) => passed.extend([*byte; 2]),
                Some(Mishap::Swapped) => self.swapped = Some(*byte),
                None => {
                    passed.push(*byte);
                    if matches!(self.fault, Fault::Byte { way: at_way, .. } if at_way == way) {
                        passed.extend(self.swapped.take());
                    }
                }
            }
        }
        passed
    }

    /// What is due at a time that may come now, or before `until`.
    fn strike(&mut self, until: Duration) -> Duration {
        let now = self.board.now();
        match self.fault {
            Fault::Stall { at, lasts } if now >= at => {
                self.fault = Fault::Nothing;
                let mut held = std::mem::take(&mut self.held);
                self.run(now + lasts, &mut held);
                self.held = held;
            }
            Fault::Burst { at, bytes } if now >= at => {
                self.fault = Fault::Nothing;
                let noise: Vec<u8> = (1..=bytes).map(|k| (k % 251) as u8 + 1).collect();
                self.board.send(&noise).expect("a virtual port is always there");
            }
            Fault::Opened { at } if now >= at => {
                self.fault = Fault::Nothing;
                self.look();
                self.board.reset();
            }
            Fault::Hello { at } if now >= at => {
                self.fault = Fault::Nothing;
                let (mut other, mut hello) = (Link::new(0x0074_6865), Vec::new());
                other.hello(now);
                other.output(now, &mut hello);
                self.board.send(&hello).expect("a virtual port is always there");
            }
            Fault::Hung { at } if now >= at => {
                self.fault = Fault::Nothing;
                self.board.hang();
            }
            Fault::Stall { at, .. }
            | Fault::Burst { at, .. }
            | Fault::Opened { at }
            | Fault::Hello { at }
            | Fault::Hung { at } => return until.min(at),
            Fault::Slow { from, look } if now >= from => {
                let mut held = std::mem::take(&mut self.held);
                self.run(now + look, &mut held);
                self.held = held;
            }
            Fault::Nothing
            | Fault::Byte { .. }
            | Fault::Silence { .. }
            | Fault::Unplugged { .. }
            | Fault::Slow { .. }
            | Fault::Stuck => {}
        }
        until
    }

    fn is_there(&self) -> Result<(), PortError> {
        match self.fault {
            Fault::Unplugged { from } if self.board.now() >= from => {
                Err(PortError::Gone { name: "the port".to_owned(), why: "No such device".to_owned() })
            }
            _ => Ok(()),
        }
    }
}

impl<P: Chip> Port for Line<P> {
    fn now(&self) -> Duration {
        self.0.lock().unwrap().board.now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        let mut struck = self.0.lock().unwrap();
        struck.is_there()?;
        let passed = struck.pass(Way::ToBoard, bytes);
        struck.board.send(&passed)
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        let mut struck = self.0.lock().unwrap();
        let had = into.len();
        while into.len() == had && struck.board.now() < until {
            let until = struck.strike(until);
            let mut bytes = std::mem::take(&mut struck.held);
            if bytes.is_empty() {
                struck.board.receive(until, &mut bytes)?;
            }
            struck.is_there()?;
            let passed = struck.pass(Way::ToHost, &bytes);
            into.extend(passed);
        }
        struck.look();
        Ok(())
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        let mut struck = self.0.lock().unwrap();
        let baud = if matches!(struck.fault, Fault::Stuck) { Baud::B115200 } else { baud };
        struck.board.set_baud(baud)
    }

    fn edges(&mut self, into: &mut Vec<Edge>) {
        let mut struck = self.0.lock().unwrap();
        struck.look();
        into.extend(&struck.edges[struck.told..]);
        struck.told = struck.edges.len();
    }
}
