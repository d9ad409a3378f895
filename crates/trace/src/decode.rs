//! The decoder: edges to what each motor and its driver see, which is steps, pulses, DIR setup and hold.

use pulsetrain_motion::program::{CoilSequence, Program, Wiring};

use crate::lines::{self, NoSuchLine};
use crate::steps::{Step, StepTrace};
use crate::{Edge, Line, Trace};

/// An event of a motor, in order of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A step.
    Step {
        /// Whether the position counts up.
        forward: bool,
        /// Ticks since DIR last changed; `None` if it never changed, and for coils.
        since_dir: Option<u64>,
    },
    /// STEP fell after this many ticks HIGH.
    High(u64),
    /// STEP rose after this many ticks LOW.
    Low(u64),
    /// STEP rose for the first time since DIR changed, this many ticks after the change.
    Setup(u64),
    /// DIR changed this many ticks after STEP fell; 0 if STEP was HIGH.
    Hold(u64),
    /// The coils changed to a pattern that is more than one step away; IN1 is bit 0.
    CoilJump {
        /// The last pattern that was in the sequence.
        from: u8,
        /// The pattern after.
        to: u8,
    },
}

/// The edges of a trace are not in order of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("an edge at tick {tick} comes after one at tick {after}")]
pub struct Backwards {
    /// The later edge's tick.
    pub tick: u64,
    /// The tick of the edge before it.
    pub after: u64,
}

/// Turns edges into the events of each motor.
pub struct Decoder {
    /// For each line, the motors that use it, and the role of the line.
    listeners: Vec<Vec<(usize, Role)>>,
    levels: Vec<bool>,
    drivers: Vec<Driver>,
    tick: u64,
    /// Edges of the present tick. They are handled together, because their order in a file means nothing.
    waiting: Vec<Edge>,
}

#[derive(Clone, Copy)]
enum Role {
    Step,
    Dir,
    Coil(u8),
}

enum Driver {
    StepDir {
        forward_high: bool,
        step: bool,
        dir: bool,
        rose: Option<u64>,
        fell: Option<u64>,
        turned: Option<u64>,
        /// Whether DIR has changed since STEP last rose.
        setup_due: bool,
    },
    Coils {
        sequence: &'static [u8],
        pattern: u8,
        phase: usize,
    },
}

impl Decoder {
    /// A decoder for a trace with these lines.
    ///
    /// # Errors
    /// If a line that a motor needs is missing.
    pub fn new(lines: &[Line], program: &Program) -> Result<Decoder, NoSuchLine> {
        let mut listeners = vec![Vec::new(); lines.len()];
        let mut drivers = Vec::new();
        for (index, motor) in program.motors.iter().enumerate() {
            let mut initial = [false; 4];
            for (i, (pin, role)) in lines::roles(&motor.wiring).into_iter().enumerate() {
                let line = lines::find(lines, &motor.name, role, pin)?;
                let role = match role {
                    "step" => Role::Step,
                    "dir" => Role::Dir,
                    _ => Role::Coil(i as u8),
                };
                listeners[line].push((index, role));
                initial[i] = lines[line].initial;
            }
            drivers.push(match &motor.wiring {
                Wiring::StepDir { forward_high, .. } => Driver::StepDir {
                    forward_high: *forward_high,
                    step: initial[0],
                    dir: initial[1],
                    rose: None,
                    fell: None,
                    turned: None,
                    setup_due: false,
                },
                Wiring::Coils { sequence, .. } => {
                    let sequence = patterns(*sequence);
                    let pattern = (0..4).map(|i| u8::from(initial[i]) << i).sum();
                    let phase = sequence.iter().position(|p| *p == pattern).unwrap_or(0);
                    Driver::Coils { sequence, pattern, phase }
                }
            });
        }
        let levels = lines.iter().map(|line| line.initial).collect();
        Ok(Decoder { listeners, levels, drivers, tick: 0, waiting: Vec::new() })
    }

    /// Adds an edge, and passes the events (motor, tick, event) of earlier ticks to `sink`. An edge that does not
    /// change the level, or that is on a line without a role, has no effect.
    ///
    /// # Errors
    /// If the edge is earlier than the last one.
    pub fn push(&mut self, edge: Edge, sink: &mut impl FnMut(usize, u64, Event)) -> Result<(), Backwards> {
        if edge.tick < self.tick {
            return Err(Backwards { tick: edge.tick, after: self.tick });
        }
        // If a line changes twice within a tick, the order in the file counts.
        if edge.tick > self.tick || self.waiting.iter().any(|w| w.line == edge.line) {
            self.flush(sink);
            self.tick = edge.tick;
        }
        match self.levels.get_mut(usize::from(edge.line)) {
            Some(level) if *level != edge.level => {
                *level = edge.level;
                self.waiting.push(edge);
            }
            _ => {}
        }
        Ok(())
    }

    /// Passes on the events of the last tick.
    pub fn flush(&mut self, sink: &mut impl FnMut(usize, u64, Event)) {
        let Decoder { listeners, drivers, waiting, tick, .. } = self;
        // The order within a tick: STEP falls, DIR changes, STEP rises. Coils are read after all of them have changed.
        for turn in 0..4 {
            for edge in waiting.iter() {
                for &(motor, role) in &listeners[usize::from(edge.line)] {
                    let sink = &mut |event| sink(motor, *tick, event);
                    match (turn, role, edge.level) {
                        (0, Role::Step, false) => drivers[motor].step_falls(*tick, sink),
                        (0, Role::Coil(coil), level) => drivers[motor].coil(coil, level),
                        (1, Role::Dir, level) => drivers[motor].dir(level, *tick, sink),
                        (2, Role::Step, true) => drivers[motor].step_rises(*tick, sink),
                        (3, Role::Coil(_), _) => drivers[motor].coils_settle(sink),
                        _ => {}
                    }
                }
            }
        }
        waiting.clear();
    }
}

impl Driver {
    fn step_falls(&mut self, tick: u64, sink: &mut impl FnMut(Event)) {
        if let Driver::StepDir { step, rose, fell, .. } = self {
            *step = false;
            *fell = Some(tick);
            if let Some(rose) = rose {
                sink(Event::High(tick - *rose));
            }
        }
    }

    fn dir(&mut self, level: bool, tick: u64, sink: &mut impl FnMut(Event)) {
        if let Driver::StepDir { step, dir, rose, fell, turned, setup_due, .. } = self {
            *dir = level;
            match (*step && rose.is_some(), *fell) {
                (true, _) => sink(Event::Hold(0)),
                (false, Some(fell)) => sink(Event::Hold(tick - fell)),
                (false, None) => {}
            }
            *turned = Some(tick);
            *setup_due = true;
        }
    }

    fn step_rises(&mut self, tick: u64, sink: &mut impl FnMut(Event)) {
        if let Driver::StepDir { forward_high, step, dir, rose, fell, turned, setup_due } = self {
            *step = true;
            *rose = Some(tick);
            if let Some(fell) = fell {
                sink(Event::Low(tick - *fell));
            }
            let since_dir = turned.map(|turned| tick - turned);
            if let (true, Some(since)) = (*setup_due, since_dir) {
                sink(Event::Setup(since));
            }
            *setup_due = false;
            sink(Event::Step { forward: dir == forward_high, since_dir });
        }
    }

    fn coil(&mut self, coil: u8, level: bool) {
        if let Driver::Coils { pattern, .. } = self {
            *pattern = *pattern & !(1 << coil) | u8::from(level) << coil;
        }
    }

    /// Compares the pattern with the last one of the sequence. Coils that are all off keep their phase.
    fn coils_settle(&mut self, sink: &mut impl FnMut(Event)) {
        let Driver::Coils { sequence, pattern, phase } = self else { return };
        if *pattern == 0 {
            return;
        }
        let length = sequence.len();
        let from = sequence[*phase];
        let Some(found) = sequence.iter().position(|p| p == pattern) else {
            sink(Event::CoilJump { from, to: *pattern });
            return;
        };
        let moved = (found + length - *phase) % length;
        *phase = found;
        match moved {
            0 => {}
            1 => sink(Event::Step { forward: true, since_dir: None }),
            back if back == length - 1 => sink(Event::Step { forward: false, since_dir: None }),
            _ => sink(Event::CoilJump { from, to: *pattern }),
        }
    }
}

/// The patterns of one electrical cycle, forward, from phase 0; IN1 is bit 0. Source: the Pico plotter's program, which
/// calls this direction counterclockwise.
fn patterns(sequence: CoilSequence) -> &'static [u8] {
    match sequence {
        CoilSequence::Wave => &[0b1000, 0b0100, 0b0010, 0b0001],
        CoilSequence::Full => &[0b1001, 0b1100, 0b0110, 0b0011],
        CoilSequence::Half => &[0b1001, 0b1000, 0b1100, 0b0100, 0b0110, 0b0010, 0b0011, 0b0001],
    }
}

/// The steps that edges make; motors in the program's order, at most 256.
///
/// # Errors
/// As [`Decoder::new`]; edges that go back in time end the steps.
pub fn steps(trace: &Trace, program: &Program) -> Result<StepTrace, NoSuchLine> {
    let mut decoder = Decoder::new(&trace.lines, program)?;
    let motors = program.motors.iter().take(256).map(|motor| motor.name.clone()).collect();
    let mut steps = Vec::new();
    let mut sink = |motor: usize, tick, event| {
        if let (Event::Step { forward, .. }, Ok(motor)) = (event, u8::try_from(motor)) {
            steps.push(Step { motor, tick, forward });
        }
    };
    for edge in &trace.edges {
        if decoder.push(*edge, &mut sink).is_err() {
            break;
        }
    }
    decoder.flush(&mut sink);
    Ok(StepTrace { tick_hz: trace.tick_hz, motors, steps })
}
