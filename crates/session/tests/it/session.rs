//! Sessions: what a board does under them is the plan, tick by tick, or a stop that was planned.

use crate::onward::onward;
use proptest::prelude::*;
use pulsetrain_board::lease::{ExtendRefused, Lease, LeaseState, Leased, TrimRefused};
use pulsetrain_board::{
    Board, Config, Edge, Faults, LinkError, MotorConfig, Native, Observer, RemoteError, ScheduledStep, Sizer,
    StopReport, SwitchRefused, Wiring,
};
use pulsetrain_core::braking::Limit;
use pulsetrain_core::wire::message::Event;
use pulsetrain_core::{Direction, Entry, Epoch, Item, RegisterWidths};
use pulsetrain_motion::program::{self, DriverTiming, Limits, Motor, Program, Scale, Tolerance};
use pulsetrain_motion::time::Rate;
use pulsetrain_motion::{Grid, Law, Time, boards, law::Cursor};
use pulsetrain_plan::{Ensemble, Move, Settings};
use pulsetrain_session::fade::{Begins, Change};
use pulsetrain_session::{Session, SessionError};
use pulsetrain_testkit::limits;
use std::collections::VecDeque;
use std::sync::Arc;

pub(super) const TICK_HZ: u64 = 16_000_000;
const TIMING: DriverTiming =
    DriverTiming { pulse_high_ns: 1000, pulse_low_ns: 1000, dir_setup_ns: 500, dir_hold_ns: 500 };
/// Pulse, hold and setup, ticks.
const REVERSAL: u64 = 32;
/// STEP of motor m is line m, DIR line 16 + m, or 16 if it is shared.
const FIRST_DIR: u8 = 16;

pub(super) fn motor(index: usize, law: Law, shared: bool, limits: Limits) -> Motor {
    let index = u8::try_from(index).unwrap();
    let dir = if shared { FIRST_DIR } else { FIRST_DIR + index };
    Motor {
        name: format!("m{index}"),
        law,
        wiring: program::Wiring::StepDir { step: index, dir, forward_high: true, enable: None },
        timing: TIMING,
        limits,
        scale: Scale { unit: "rev".into(), steps_per_unit: 200.0, steps_per_rev: 200.0 },
        winding: None,
        driver: None,
    }
}

pub(super) fn program(fraction_bits: u32, motors: Vec<Motor>) -> Program {
    let board = program::BoardLimits {
        profile: &boards::NATIVE,
        name: "native".into(),
        tick_hz: TICK_HZ,
        registers: RegisterWidths::with_fraction_bits(fraction_bits),
        max_motors: 16,
        min_interval_ticks: vec![160],
        hardware_timed: true,
        turn_ticks: 0,
        one_timing: false,
        shared_steps: None,
        segment_ticks: Vec::new(),
    };
    Program {
        board,
        grid: Grid::NEAREST,
        tolerance: Tolerance::Ticks(1.0),
        idle_ms: None,
        motors,
        machines: Vec::new(),
        queue_parts: Vec::new(),
    }
}

/// A native board with a shorter queue, on which one bit of one segment may tip over.
pub(super) struct Bench {
    native: Native,
    missing: usize,
    /// Which run of motor 0, and which bit of its interval.
    flip: Option<(usize, u32)>,
    runs: usize,
    /// From so many items on it takes no more.
    full_after: usize,
    items: usize,
    /// How long an extension is on its way, ticks; those that are, and when each arrives.
    delay: u64,
    on_their_way: VecDeque<(Lease, Vec<Limit>, u64)>,
    lost: Option<RemoteError>,
    /// The answer to an order to brake gets lost with the line, and perhaps the order.
    cut_at_brake: Option<bool>,
    /// What the board said last of its lease, since the line is cut.
    heard: Option<LeaseState>,
    /// So many switches come when their tick is past.
    late_switches: u32,
    /// So many extensions are refused: at once, or by the board's answer.
    refusals: u32,
    refuses_at_once: bool,
    /// Whether the extensions were accepted whose answers are due, oldest first.
    answers: VecDeque<bool>,
}

impl Bench {
    pub(super) fn new(program: &Program, capacity: usize) -> Bench {
        let timing = TIMING.ticks(TICK_HZ);
        let motor = |motor: &Motor| match motor.wiring {
            program::Wiring::StepDir { step, dir, forward_high, .. } => MotorConfig {
                wiring: Wiring::StepDir {
                    step,
                    dir,
                    forward_high,
                    pulse_ticks: u32::try_from(timing.pulse_high).unwrap(),
                    setup_ticks: u32::try_from(timing.dir_setup).unwrap(),
                },
                pull_in_ticks: u64::MAX,
            },
            program::Wiring::Coils { .. } => unreachable!("motors of these tests have STEP and DIR"),
        };
        let motors = program.motors.iter().map(motor).collect();
        let native = Native::new(&Config { fraction_bits: program.board.registers.fraction_bits, motors }).unwrap();
        let native = native.with_dir_hold(u32::try_from(timing.dir_hold).unwrap());
        let missing = native.credit(0) - capacity;
        Bench {
            native,
            missing,
            flip: None,
            runs: 0,
            full_after: usize::MAX,
            items: 0,
            delay: 0,
            on_their_way: VecDeque::new(),
            lost: None,
            cut_at_brake: None,
            heard: None,
            late_switches: 0,
            refusals: 0,
            refuses_at_once: false,
            answers: VecDeque::new(),
        }
    }
}

impl Board for Bench {
    fn push(&mut self, motor: usize, mut entry: Entry) -> Result<(), Entry> {
        if self.room(motor) == 0 {
            return Err(entry);
        }
        if let (0, Item::Run { segment, .. }) = (motor, &mut entry.item) {
            if let Some((_, bit)) = self.flip.filter(|(run, _)| *run == self.runs) {
                segment.interval ^= 1 << bit;
            }
            self.runs += 1;
        }
        self.items += 1;
        self.native.push(motor, entry)
    }
    fn discard(&mut self, epoch: Epoch) {
        Board::discard(&mut self.native, epoch);
    }
    fn room(&self, motor: usize) -> usize {
        if self.items < self.full_after { self.native.credit(motor).saturating_sub(self.missing) } else { 0 }
    }
    fn sizer(&self, motor: usize) -> Sizer {
        self.native.sizer(motor)
    }
    fn round_trip(&self) -> u64 {
        self.native.round_trip()
    }
    fn horizon(&self) -> u64 {
        self.native.horizon()
    }
    fn now(&self) -> u64 {
        self.native.now()
    }
    fn epoch(&self) -> Epoch {
        Board::epoch(&self.native)
    }
    fn advance(&mut self, until: u64, observer: &mut impl Observer) {
        while let Some((lease, limits, at)) =
            self.on_their_way.pop_front_if(|(.., at)| self.lost.is_none() && *at <= until)
        {
            self.native.advance(at, observer);
            self.native.extend(lease, &limits).unwrap();
        }
        self.native.advance(until, observer);
    }
    fn lost(&self) -> Option<&RemoteError> {
        self.lost.as_ref()
    }
    fn stop_now(&mut self, tick: u64, observer: &mut impl Observer) -> StopReport {
        self.native.stop_now(tick, observer)
    }
    fn positions(&self) -> Vec<i64> {
        self.native.positions()
    }
    fn is_idle(&self) -> bool {
        self.native.idle()
    }
    fn faults(&self, motor: usize) -> Faults {
        self.native.faults(motor)
    }
    fn events(&mut self) -> Vec<Event> {
        self.native.events()
    }
}

impl Leased for Bench {
    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[Limit]) -> Result<(), SwitchRefused> {
        if let Some(left) = self.late_switches.checked_sub(1) {
            self.late_switches = left;
            self.native.advance(tick, &mut |_: Edge| {});
        }
        self.native.switch(epoch, tick, lease, limits)
    }
    fn extend(&mut self, lease: Lease, limits: &[Limit]) -> Result<(), ExtendRefused> {
        if let Some(left) = self.refusals.checked_sub(1) {
            self.refusals = left;
            if self.refuses_at_once {
                return Err(ExtendRefused::Late { horizon: self.native.horizon() });
            }
            self.answers.push_back(false);
            return Ok(());
        }
        if self.delay == 0 {
            self.native.extend(lease, limits)?;
            self.native.extended();
            self.answers.push_back(true);
            return Ok(());
        }
        self.on_their_way.push_back((lease, limits.to_vec(), self.native.now() + self.delay));
        Ok(())
    }
    fn extended(&mut self) -> Option<bool> {
        if self.lost.is_some() { None } else { self.answers.pop_front().or_else(|| self.native.extended()) }
    }
    fn await_extensions(&mut self) {
        for (lease, limits, _) in self.on_their_way.drain(..).filter(|_| self.lost.is_none()) {
            self.native.extend(lease, &limits).unwrap();
        }
    }
    fn trim(&mut self, until: u64, items: &[usize]) -> Result<(), TrimRefused> {
        self.native.trim(until, items)
    }
    fn brake(&mut self) -> Option<u64> {
        if let Some(hears) = self.cut_at_brake {
            (self.lost, self.heard) = (Some(RemoteError::Link(LinkError::Lost)), Some(self.lease()));
            if hears {
                self.native.brake();
            }
            return None;
        }
        self.native.brake()
    }
    fn lease(&self) -> LeaseState {
        self.heard.unwrap_or_else(|| Leased::lease(&self.native))
    }
}

/// Counts pulses as drivers would, and keeps the steps that the stepgen scheduled.
pub(super) struct Lab {
    levels: u32,
    /// DIR line of each motor.
    dirs: Vec<u8>,
    pub(super) counted: Vec<i64>,
    pub(super) steps: Vec<Vec<(u64, i64)>>,
}

impl Lab {
    pub(super) fn new(program: &Program) -> Lab {
        let dirs = program.motors.iter().map(|motor| motor.wiring.pins()[1]);
        let motors = program.motors.len();
        Lab { levels: 0, dirs: dirs.collect(), counted: vec![0; motors], steps: vec![Vec::new(); motors] }
    }
}

impl Lab {
    /// Whether all motors have the same DIR line.
    fn is_shared(&self) -> bool {
        self.dirs.len() > 1 && self.dirs.iter().all(|dir| *dir == FIRST_DIR)
    }
}

impl Observer for Lab {
    fn edge(&mut self, edge: Edge) {
        self.levels ^= 1 << edge.line;
        if edge.level && edge.line < FIRST_DIR {
            let motor = usize::from(edge.line);
            self.counted[motor] += if self.levels >> self.dirs[motor] & 1 == 1 { 1 } else { -1 };
        }
    }

    fn step(&mut self, step: ScheduledStep) {
        self.steps[step.motor].push((step.tick, i64::from(step.direction.sign())));
    }
}

/// All steps of a program's plan, replayed in wide integers.
pub(super) fn planned(program: &Program) -> Option<Vec<Vec<(u64, i64)>>> {
    let fraction_bits = program.board.registers.fraction_bits;
    let mut ensemble = Ensemble::new(program).ok()?;
    let mut all = Vec::new();
    for motor in 0..program.motors.len() {
        let mut accumulator = 1_i128 << (fraction_bits - 1);
        let mut steps = Vec::new();
        while let Some(next) = ensemble.next_move(motor).ok()? {
            match next {
                Move::Dwell { ticks } => accumulator += i128::from(ticks) << fraction_bits,
                Move::Run { segment, direction } => {
                    let sign = if direction == Direction::Forward { 1 } else { -1 };
                    steps.extend(
                        (1..=segment.count)
                            .map(|k| (u64::try_from((accumulator + segment.span(k)) >> fraction_bits).unwrap(), sign)),
                    );
                    accumulator += segment.span(segment.count);
                }
            }
        }
        all.push(steps);
    }
    Some(all)
}

/// A law without jumps, and its largest acceleration.
fn smooth_law() -> impl Strategy<Value = (Law, f64)> {
    let sine = (2.0..300.0f64, any::<bool>(), 0.15..1.2f64, 1u64..3).prop_map(|(a, negative, period, cycles)| {
        let period = period.max((a / 800.0).sqrt());
        let omega = std::f64::consts::TAU / period;
        let amplitude = if negative { -a } else { a };
        (Law::sine(amplitude, Time::from_seconds(period), Some(cycles)).unwrap(), a * omega * omega)
    });
    let trapezoid = (-900.0..900.0f64, 50.0..3000.0f64, 2000.0..40_000.0f64).prop_map(|(distance, speed, a)| {
        (Law::trapezoid(distance + 3.0f64.copysign(distance), speed, a, a).unwrap(), a)
    });
    prop_oneof![sine, trapezoid]
}

fn motors(shared: bool) -> impl Strategy<Value = Vec<Motor>> {
    let limited = (smooth_law(), any::<bool>(), prop_oneof![Just(0.0), 1.0..200.0f64], 0.0..0.3f64);
    prop::collection::vec(limited, 1..=4).prop_map(move |motors| {
        let motor = |(index, ((law, hardest), limited, pull_in, delay)): (usize, ((Law, f64), bool, f64, f64))| {
            let max_acceleration = limited.then_some(hardest * 1.1);
            let law = law.delayed(Time::from_seconds(delay)).unwrap();
            motor(index, law, shared, Limits { max_speed: None, max_acceleration, pull_in })
        };
        motors.into_iter().enumerate().map(motor).collect()
    })
}

fn programs() -> impl Strategy<Value = Program> {
    let motors = prop_oneof![2 => motors(false), 1 => motors(true)];
    (prop_oneof![Just(16u32), Just(32)], motors).prop_map(|(bits, motors)| program(bits, motors))
}

/// Steps are pulses, and both are what the host replays; nothing comes closer than it may.
pub(super) fn check_counts<B: Leased>(session: &Session<B>, lab: &Lab, program: &Program) -> Result<(), TestCaseError> {
    let now = session.board().now();
    for (motor, steps) in lab.steps.iter().enumerate() {
        let count: i64 = steps.iter().map(|(_, sign)| sign).sum();
        prop_assert_eq!(session.board().positions()[motor], count);
        prop_assert_eq!(lab.counted[motor], count, "pulses of motor {}", motor);
        prop_assert_eq!(session.count_at(motor, now - 1), Some(count), "replay of motor {}", motor);
        prop_assert_eq!(session.board().faults(motor), Faults::default());
        let least = Settings::of(program, &program.motors[motor]).min_interval_ticks;
        for pair in steps.windows(2) {
            let gap = if pair[0].1 == pair[1].1 { least } else { REVERSAL.max(least) };
            prop_assert!(pair[1].0 - pair[0].0 >= gap, "motor {motor}: {pair:?} closer than {gap}");
        }
    }
    Ok(())
}

/// At every step that is remembered the host knows the count before and after, and between steps as well.
pub(super) fn check_replay<B: Leased>(session: &Session<B>, lab: &Lab, ticks: &[u64]) -> Result<(), TestCaseError> {
    for (motor, steps) in lab.steps.iter().enumerate() {
        let mut count = 0;
        for &(tick, sign) in steps {
            if let Some(replayed) = session.count_at(motor, tick - 1) {
                prop_assert_eq!(replayed, count, "motor {} before {}", motor, tick);
                prop_assert_eq!(session.count_at(motor, tick), Some(count + sign), "motor {} at {}", motor, tick);
            }
            count += sign;
        }
        for &tick in ticks.iter().filter(|tick| **tick < session.board().now()) {
            if let Some(replayed) = session.count_at(motor, tick) {
                let count: i64 = steps.iter().filter(|(t, _)| *t <= tick).map(|(_, sign)| sign).sum();
                prop_assert_eq!(replayed, count, "motor {} at {}", motor, tick);
            }
        }
    }
    Ok(())
}

pub(super) fn check_acceleration(steps: &[(u64, i64)], limit: f64, doubt: f64) -> Result<(), TestCaseError> {
    limits::check_acceleration(steps, TICK_HZ, limit, doubt).map_err(TestCaseError::fail)
}

/// Lets the board come to rest without the host.
pub(super) fn let_run_out<B: Leased>(session: &mut Session<B>, lab: &mut Lab) {
    let committed_until = session.committed_until();
    let end = session.last_step().unwrap_or(0).max(session.board().now());
    let end = if committed_until == u64::MAX { end } else { end.max(committed_until) };
    session.board_mut().advance(end + 1000, lab);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn a_session_changes_no_tick(program in programs(), capacity in 128usize..=256) {
        let Some(planned) = planned(&program) else { return Err(TestCaseError::reject("no plan")) };
        let mut lab = Lab::new(&program);
        let mut session = Session::new(Bench::new(&program, capacity), program.clone()).unwrap();
        let mut progress = 0;
        let report = session.run(&mut lab, |tick| progress = progress.max(tick));
        prop_assert_eq!(report.failure, None);
        prop_assert_eq!(&report.counted, &report.replayed);
        prop_assert!(progress > report.last_step);
        for (steps, planned) in lab.steps.iter().zip(&planned) {
            let from_zero: Vec<_> = steps.iter().map(|(tick, sign)| (tick - report.zero, *sign)).collect();
            prop_assert_eq!(&from_zero, planned);
        }
        check_counts(&session, &lab, &program)?;
    }

    #[test]
    fn a_lost_host_is_a_planned_stop(
        program in programs(),
        capacity in 128usize..=256,
        lost_s in 0.0..1.5f64,
        looks in prop::collection::vec(0u64..30_000_000, 8),
    ) {
        prop_assume!(planned(&program).is_some());
        let mut lab = Lab::new(&program);
        let mut session = Session::new(Bench::new(&program, capacity), program.clone()).unwrap();
        prop_assert_eq!(session.advance((lost_s * TICK_HZ as f64) as u64, &mut lab), Ok(()));
        let_run_out(&mut session, &mut lab);
        prop_assert!(session.board().is_idle());
        check_counts(&session, &lab, &program)?;
        check_replay(&session, &lab, &looks)?;
        check_stops(&session, &lab, &program)?;
    }

    #[test]
    fn a_host_that_stood_still_is_told_since_when(
        program in programs(),
        asleep_s in 0.0..0.4f64,
        late in 0u64..10_000,
        looks in prop::collection::vec(0u64..30_000_000, 8),
    ) {
        prop_assume!(planned(&program).is_some());
        let mut lab = Lab::new(&program);
        let mut session = Session::new(Bench::new(&program, 256), program.clone()).unwrap();
        prop_assert_eq!(session.advance((asleep_s * TICK_HZ as f64) as u64, &mut lab), Ok(()));
        if session.is_complete() {
            return Ok(());
        }
        let committed_until = session.committed_until();
        session.board_mut().advance(committed_until + late, &mut lab);
        let refused = session.fill();
        let Err(SessionError::Stopped { at_s, late_s, .. }) = refused else { panic!("{refused:?}") };
        prop_assert_eq!((at_s * TICK_HZ as f64).round() as u64, committed_until - session.zero());
        prop_assert_eq!((late_s * TICK_HZ as f64).round() as u64, late + 1);
        let report = session.run(&mut lab, |_| {});
        prop_assert_eq!(&report.counted, &report.replayed);
        check_counts(&session, &lab, &program)?;
        check_replay(&session, &lab, &looks)?;
        check_stops(&session, &lab, &program)?;
    }

    #[test]
    fn a_stop_at_any_time_stays_within_the_limits(
        program in programs(),
        stops_s in 0.0..1.5f64,
        looks in prop::collection::vec(0u64..30_000_000, 8),
    ) {
        prop_assume!(planned(&program).is_some());
        let mut lab = Lab::new(&program);
        let mut session = Session::new(Bench::new(&program, 256), program.clone()).unwrap();
        prop_assert_eq!(session.advance((stops_s * TICK_HZ as f64) as u64, &mut lab), Ok(()));
        let stops = session.stop();
        prop_assert!(stops.is_ok(), "{:?}", stops);
        // At once, or after a step of a motor that had just turned at speed.
        prop_assert!(stops.unwrap() <= session.earliest());
        let report = session.run(&mut lab, |_| {});
        prop_assert_eq!(report.failure, None);
        prop_assert_eq!(&report.counted, &report.replayed);
        check_counts(&session, &lab, &program)?;
        check_replay(&session, &lab, &looks)?;
        check_stops(&session, &lab, &program)?;
    }

    #[test]
    fn changes_go_on_from_where_the_motors_are(
        program in programs(),
        changes in prop::collection::vec((0.0..0.5f64, 0u64..100_000, smooth_law()), 1..4),
        looks in prop::collection::vec(0u64..30_000_000, 8),
    ) {
        prop_assume!(planned(&program).is_some());
        let arena: Vec<std::cell::OnceCell<Program>> = changes.iter().map(|_| std::cell::OnceCell::new()).collect();
        let mut lab = Lab::new(&program);
        let mut session = Session::new(Bench::new(&program, 256), program.clone()).unwrap();
        let mut current = &program;
        for ((after_s, ahead, (law, hardest)), cell) in changes.iter().zip(&arena) {
            let until = session.board().now() + (after_s * TICK_HZ as f64) as u64;
            prop_assert_eq!(session.advance(until, &mut lab), Ok(()));
            let at = session.earliest() + ahead;
            let mut next = current.clone();
            for (index, motor) in next.motors.iter_mut().enumerate() {
                let state = session.state(index, at).unwrap();
                motor.limits.max_acceleration = None;
                motor.law = onward(state, law, *hardest);
            }
            let next = cell.get_or_init(|| next);
            match session.change(at, next.clone()) {
                Ok(()) => current = next,
                // Motors that share a DIR line may want to turn too close together, or step by step.
                Err(SessionError::Plan(_)) if lab.is_shared() => continue,
                Err(SessionError::Waiting { .. }) => continue,
                Err(error) => return Err(TestCaseError::fail(error.to_string())),
            }
            prop_assert_eq!(session.zero(), at);
            let look = at + (0.1 * TICK_HZ as f64) as u64;
            prop_assert_eq!(session.advance(look, &mut lab), Ok(()));
            check_counts(&session, &lab, current)?;
            check_replay(&session, &lab, &looks)?;
            for (index, motor) in current.motors.iter().enumerate() {
                let theta = Cursor::new(&motor.law).at(Time::from_ratio((look - at).cast_signed(), TICK_HZ)).unwrap();
                let count = session.count_at(index, look).unwrap() as f64;
                prop_assert!((theta.position - count).abs() < 1.6, "motor {index}: {count}, law {}", theta.position);
            }
        }
        let report = session.run(&mut lab, |_| {});
        prop_assert_eq!(&report.counted, &report.replayed);
        check_counts(&session, &lab, current)?;
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn pauses_keep_path_limits_and_counts(
        program in programs(),
        pauses in prop::collection::vec((0.0..0.6f64, 0.0..0.3f64), 1..4),
    ) {
        let Some(planned) = planned(&program) else { return Err(TestCaseError::reject("no plan")) };
        let mut lab = Lab::new(&program);
        let mut session = Session::new(Bench::new(&program, 256), program.clone()).unwrap();
        let ticks = |seconds: f64| (seconds * TICK_HZ as f64) as u64;
        for (after_s, rest_s) in pauses {
            let until = session.board().now() + ticks(after_s);
            prop_assert_eq!(session.advance(until, &mut lab), Ok(()));
            let rests = match session.pause() {
                Ok(rests) => rests,
                // Over by then, or too much for one motor; or motors that share a DIR line turn too close together.
                Err(SessionError::Late { .. } | SessionError::Pause(_)) => continue,
                // The change before it waits, and it may be asked again.
                Err(SessionError::Waiting { at, until }) => {
                    prop_assert!(session.board().now() <= until && until <= at + 1, "{at} waits for {until}");
                    continue;
                }
                Err(SessionError::Plan(_) | SessionError::QueueTooShort { .. }) if lab.is_shared() => continue,
                Err(error) => return Err(TestCaseError::fail(error.to_string())),
            };
            prop_assert_eq!(session.pause(), Ok(rests), "once is enough");
            prop_assert_eq!(session.advance(rests, &mut lab), Ok(()));
            check_counts(&session, &lab, &program)?;
            let halted = lab.counted.clone();
            prop_assert_eq!(session.advance(rests + ticks(rest_s), &mut lab), Ok(()));
            prop_assert_eq!(&lab.counted, &halted, "at rest");
            match session.resume() {
                Ok(at_speed) => prop_assert!(at_speed > rests),
                Err(SessionError::Pause(_)) => return Ok(()),
                Err(SessionError::Plan(_) | SessionError::QueueTooShort { .. }) if lab.is_shared() => return Ok(()),
                Err(error) => return Err(TestCaseError::fail(error.to_string())),
            }
            prop_assert_eq!(session.resume(), Err(SessionError::NotPaused));
        }
        let report = session.run(&mut lab, |_| {});
        prop_assert_eq!(report.failure, None);
        prop_assert_eq!(&report.counted, &report.replayed);
        check_counts(&session, &lab, &program)?;
        for ((steps, planned), m) in lab.steps.iter().zip(&planned).zip(&program.motors) {
            // The same steps, at other times.
            let way = |steps: &[(u64, i64)]| steps.iter().map(|(_, sign)| *sign).collect::<Vec<_>>();
            if !lab.is_shared() {
                prop_assert_eq!(way(steps), way(planned));
                if let Some(limit) = m.limits.max_acceleration.filter(|_| m.limits.pull_in == 0.0) {
                    check_acceleration(steps, limit, 1.5)?;
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// At any tempo the motors make the same steps in the same order, within the same limits.
    #[test]
    fn tempos_keep_path_limits_and_counts(
        program in programs(),
        tempos in prop::collection::vec((0.0..0.6f64, 0.05..3.0f64), 1..6),
    ) {
        let Some(planned) = planned(&program) else { return Err(TestCaseError::reject("no plan")) };
        let mut lab = Lab::new(&program);
        let mut session = Session::new(Bench::new(&program, 256), program.clone()).unwrap();
        let mut made = 0;
        for (after_s, rate) in tempos {
            let until = session.board().now() + (after_s * TICK_HZ as f64) as u64;
            prop_assert_eq!(session.advance(until, &mut lab), Ok(()));
            let wanted = Rate::of(rate).unwrap();
            match session.set_tempo(wanted) {
                Ok(tempo) => {
                    made += 1;
                    prop_assert!(tempo.rate == wanted || (tempo.rate < wanted && tempo.ceiling.is_some()), "{tempo:?}");
                    prop_assert!(tempo.rate >= wanted.min(Rate::ONE) && tempo.from >= until, "{tempo:?}");
                }
                // Over by then, too much for one motor, or behind another change.
                Err(SessionError::Late { .. } | SessionError::Pause(_) | SessionError::Waiting { .. }) => {}
                Err(SessionError::Plan(_) | SessionError::QueueTooShort { .. }) if lab.is_shared() => {}
                Err(error) => return Err(TestCaseError::fail(error.to_string())),
            }
        }
        let report = session.run(&mut lab, |_| {});
        // A motor that has no headroom for a share of a DIR line may be refused on the way; it brakes then.
        if lab.is_shared() && report.failure.is_some() {
            return Ok(());
        }
        prop_assert_eq!(report.failure, None, "after {} tempos", made);
        prop_assert_eq!(&report.counted, &report.replayed);
        check_counts(&session, &lab, &program)?;
        for ((steps, planned), m) in lab.steps.iter().zip(&planned).zip(&program.motors) {
            let way = |steps: &[(u64, i64)]| steps.iter().map(|(_, sign)| *sign).collect::<Vec<_>>();
            if !lab.is_shared() {
                prop_assert_eq!(way(steps), way(planned));
                if let Some(limit) = m.limits.max_acceleration.filter(|_| m.limits.pull_in == 0.0) {
                    check_acceleration(steps, limit, 1.5)?;
                }
            }
        }
    }
}

/// Two motors, a change of tempo: from then on each step of both comes at the time that the tempo gives it, to a tick.
#[test]
fn a_tempo_is_exact_and_keeps_phases() {
    let limits = Limits { max_speed: None, max_acceleration: Some(200_000.0), pull_in: 1e9 };
    let sine = |period_ms: u64| Law::sine(400.0, Time::SECOND.times(period_ms).divided_by(1000), Some(20)).unwrap();
    let program = program(16, vec![motor(0, sine(700), false, limits), motor(1, sine(900), false, limits)]);
    let plain = planned(&program).unwrap();
    for rate in [0.25, 0.7, 2.0] {
        let mut lab = Lab::new(&program);
        let mut session = Session::new(Bench::new(&program, 256), program.clone()).unwrap();
        session.advance(session.zero() + 2 * TICK_HZ, &mut lab).unwrap();
        let tempo = session.set_tempo(Rate::of(rate).unwrap()).unwrap();
        assert_eq!((tempo.rate.get(), tempo.ceiling), (Rate::of(rate).unwrap().get(), None));
        let rate = tempo.rate.get();
        assert_eq!(session.run(&mut lab, |_| {}).failure, None);
        let mut offsets = Vec::new();
        for (steps, plain) in lab.steps.iter().zip(&plain) {
            assert_eq!(steps.len(), plain.len());
            let after = steps.iter().zip(plain).filter(|((tick, _), _)| *tick > tempo.from);
            // The tick at which the laws' time would have been 0.
            offsets.extend(after.map(|((tick, _), (own, _))| *tick as f64 - *own as f64 / rate));
        }
        let (least, most) = offsets.iter().fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(*x), b.max(*x)));
        // A step is within a tick of its time, in both runs.
        assert!(offsets.len() > 10_000 && most - least < 2.0 * (1.0 + 1.0 / rate), "{rate}: {least} to {most}");
    }
}

#[test]
fn a_beginning_that_came_too_late_is_sent_again() {
    let limits = Limits { max_speed: None, max_acceleration: Some(20_000.0), pull_in: 0.0 };
    let program =
        program(16, vec![motor(0, Law::trapezoid(500.0, 2000.0, 15_000.0, 15_000.0).unwrap(), false, limits)]);
    for (late, begins) in [(0, true), (3, true), (4, false)] {
        let mut bench = Bench::new(&program, 256);
        bench.late_switches = late;
        let mut lab = Lab::new(&program);
        match Session::new(bench, program.clone()) {
            Ok(mut session) => {
                let report = session.run(&mut lab, |_| {});
                assert_eq!((begins, report.failure, report.counted, &lab.counted), (true, None, vec![500], &vec![500]));
            }
            Err(error) => assert_eq!((begins, error), (false, SessionError::NotBegun)),
        }
    }
}

/// A motion that is getting up to speed is paused once it is. While the board has not begun that, the session says when to ask again.
#[test]
fn a_pause_behind_a_change_that_waits_is_asked_for_again() {
    let law = Law::trapezoid(-783.632, 2_703.109_272, 14_202.035_558, 14_202.035_558).unwrap();
    let law = law.delayed(Time::from_raw(244_849_131_954_227_328)).unwrap();
    let limits = Limits { max_speed: None, max_acceleration: Some(15_622.239), pull_in: 0.0 };
    let program = program(16, vec![motor(0, law, false, limits)]);
    let mut lab = Lab::new(&program);
    let mut session = Session::new(Bench::new(&program, 256), program.clone()).unwrap();
    assert_eq!(session.advance(session.board().now() + 290_808, &mut lab), Ok(()));
    let rests = session.pause().unwrap();
    assert_eq!(session.advance(rests, &mut lab), Ok(()));
    let at_speed = session.resume().unwrap();
    let Err(SessionError::Waiting { at, until }) = session.pause() else {
        panic!("the board goes over to the resumption first")
    };
    assert!(session.board().now() <= until && until < at && at == at_speed);
    assert_eq!(session.advance(until, &mut lab), Ok(()));
    let rests = loop {
        match session.pause() {
            Ok(rests) => break rests,
            Err(SessionError::Waiting { at: again, until }) => {
                assert!(again == at && until > session.board().now());
                assert_eq!(session.advance(until, &mut lab), Ok(()));
            }
            Err(error) => panic!("{error}"),
        }
    };
    assert_eq!(session.advance(rests, &mut lab), Ok(()));
    check_counts(&session, &lab, &program).unwrap();
    session.resume().unwrap();
    assert_eq!(session.run(&mut lab, |_| {}).failure, None);
    check_counts(&session, &lab, &program).unwrap();
}

#[test]
fn after_a_pause_every_motor_is_as_late_as_the_others() {
    let sine = |a, period| Law::sine(a, Time::from_seconds(period), Some((4.0 / period) as u64)).unwrap();
    let limits = Limits { max_speed: None, max_acceleration: Some(60_000.0), pull_in: 0.0 };
    let laws = [sine(400.0, 1.0), sine(-150.0, 0.5), sine(90.0, 0.25)];
    let program = program(16, laws.into_iter().enumerate().map(|(k, law)| motor(k, law, false, limits)).collect());
    let run = |pauses: bool| {
        let mut lab = Lab::new(&program);
        let mut session = Session::new(Bench::new(&program, 256), program.clone()).unwrap();
        let zero = session.zero();
        let mut at_speed = 0;
        if pauses {
            session.advance(zero + TICK_HZ * 13 / 10, &mut lab).unwrap();
            let rests = session.pause().unwrap();
            assert!(rests < session.board().now() + TICK_HZ / 2, "paused after {rests} ticks");
            assert_eq!(session.resume(), Err(SessionError::Early { at: session.earliest(), earliest: rests }));
            session.advance(rests + TICK_HZ / 3, &mut lab).unwrap();
            at_speed = session.resume().unwrap();
            // During the easing another pause waits for its end.
            session.advance(session.zero(), &mut lab).unwrap();
            let rests = session.pause().unwrap();
            assert!(rests > at_speed);
            session.advance(rests, &mut lab).unwrap();
            at_speed = session.resume().unwrap();
        }
        assert_eq!(session.run(&mut lab, |_| {}).failure, None);
        (lab.steps, zero, at_speed)
    };
    let (plain, zero, _) = run(false);
    let (paused, again, at_speed) = run(true);
    assert_eq!(zero, again);
    let late = plain[0].last().map(|(tick, _)| paused[0].last().unwrap().0 - tick).unwrap();
    assert!(late > TICK_HZ / 3);
    let mut compared = 0;
    for (plain, paused) in plain.iter().zip(&paused) {
        assert_eq!(plain.len(), paused.len());
        for (before, after) in plain.iter().zip(paused) {
            assert_eq!(before.1, after.1);
            if after.0 < zero + TICK_HZ {
                assert_eq!(before, after);
            } else if after.0 >= at_speed {
                // Two certificates of a tick.
                assert!((before.0 + late).abs_diff(after.0) <= 3, "{} and not {late} late", after.0 - before.0);
                compared += 1;
            }
        }
    }
    assert!(compared > 2000, "{compared} steps");
}

#[test]
fn a_motion_that_brakes_as_hard_as_it_may_is_paused_when_it_can_be() {
    // 1 s up, 1 s down, all that the motor can do.
    let limits = Limits { max_speed: None, max_acceleration: Some(1000.5), pull_in: 0.0 };
    let law = Law::trapezoid(1000.0, 1000.0, 1000.0, 1000.0).unwrap();
    let program = program(16, vec![motor(0, law, false, limits)]);
    let mut lab = Lab::new(&program);
    let mut session = Session::new(Bench::new(&program, 256), program.clone()).unwrap();
    session.advance(session.zero() + TICK_HZ * 5 / 4, &mut lab).unwrap();
    let rests = session.pause().unwrap();
    session.advance(rests, &mut lab).unwrap();
    check_acceleration(&lab.steps[0], 1000.5, 1.5).unwrap();
    session.resume().unwrap();
    let report = session.run(&mut lab, |_| {});
    assert_eq!((report.failure, report.counted), (None, vec![1000]));
    check_acceleration(&lab.steps[0], 1000.5, 1.5).unwrap();
}

/// From the last steps of the plan on, the motors slow down within their limits.
fn check_stops<B: Leased>(session: &Session<B>, lab: &Lab, program: &Program) -> Result<(), TestCaseError> {
    for (motor, (steps, m)) in lab.steps.iter().zip(&program.motors).enumerate() {
        let Some(limit) = m.limits.max_acceleration else { continue };
        // Steps on a shared DIR line may be put off.
        let doubt = if lab.is_shared() { 1.5 + REVERSAL as f64 } else { 1.5 };
        let first = steps.iter().position(|(tick, _)| *tick >= session.committed_until()).unwrap_or(steps.len());
        check_acceleration(&steps[first.saturating_sub(2)..], limit, doubt)?;
        limits::check_last_step(steps, TICK_HZ, limit, m.limits.pull_in)
            .map_err(|why| TestCaseError::fail(format!("motor {motor}: {why}")))?;
        let peak = session.certificate(motor).peak_speed.0;
        let stopping = steps.last().map_or(0, |(tick, _)| tick.saturating_sub(session.committed_until()));
        // An ideal stop takes v/a. Core's takes up to twice as many steps, and at its end a step or two of 1/√(2a).
        let longest_s = 2.5 * peak / limit + 2.0 / (2.0 * limit).sqrt();
        let took_s = stopping as f64 / TICK_HZ as f64;
        prop_assert!(
            took_s <= longest_s,
            "motor {motor} takes {took_s} s to stop from {peak} steps/s with {limit} steps/s²"
        );
    }
    Ok(())
}

/// Whether steps seen up to now differ from what the host replays.
fn deviates<B: Leased>(session: &Session<B>, lab: &Lab, since: usize, before: i64) -> bool {
    let mut count = before;
    lab.steps[0][since..].iter().any(|(tick, sign)| {
        let was = session.count_at(0, tick - 1);
        let expected = was == Some(count) && session.count_at(0, *tick) == Some(count + sign);
        count += sign;
        !expected
    })
}

/// Runs a sinusoid with one bit of a segment tipped over, and compares every 50 ms.
fn noticed(flip: Option<(usize, u32)>) -> bool {
    let law = Law::sine(300.0, Time::SECOND, Some(2)).unwrap();
    let program = program(16, vec![motor(0, law, false, Limits::default())]);
    let mut bench = Bench::new(&program, 256);
    bench.flip = flip;
    let mut lab = Lab::new(&program);
    let mut session = Session::new(bench, program.clone()).unwrap();
    for slice in 1..50 {
        let (since, before) = (lab.steps[0].len(), session.board().positions()[0]);
        let until = slice * TICK_HZ / 20;
        session.advance(until, &mut lab).unwrap();
        let replayed = session.count_at(0, until);
        if deviates(&session, &lab, since, before) || replayed != Some(session.board().positions()[0]) {
            return true;
        }
    }
    false
}

#[test]
fn a_bit_that_tips_over_is_noticed() {
    assert!(!noticed(None));
    for run in 0..6 {
        for bit in 16..26 {
            assert!(noticed(Some((run, bit))), "bit {bit} of run {run}");
        }
    }
}

#[test]
fn an_endless_law_runs_until_it_is_stopped() {
    let law = Law::sine(500.0, Time::SECOND, None).unwrap();
    let program = program(32, vec![motor(0, law, false, Limits::default())]);
    let mut lab = Lab::new(&program);
    let mut session = Session::new(Bench::new(&program, 96), program.clone()).unwrap();
    session.advance(100 * TICK_HZ, &mut lab).unwrap();
    assert!(!session.is_complete());
    session.stop().unwrap();
    let report = session.run(&mut lab, |_| {});
    assert_eq!(report.failure, None);
    assert!(lab.steps[0].len() > 199_000);
    assert_eq!(report.counted, lab.counted);
}

#[test]
fn what_cannot_be_sent_is_refused_before_anything_moves() {
    let law = Law::sine(500.0, Time::SECOND, None).unwrap();
    let one = program(32, vec![motor(0, law.clone(), false, Limits::default())]);
    let two = program(32, (0..2).map(|m| motor(m, law.clone(), false, Limits::default())).collect());
    let begin = |bench: Bench, program: &Program| Session::new(bench, program.clone()).err();
    for capacity in [0, 1] {
        let none = begin(Bench::new(&one, capacity), &one);
        assert!(matches!(none, Some(SessionError::QueueTooShort { motor: 0, .. })), "{none:?}");
    }
    assert_eq!(begin(Bench::new(&one, 256), &two), Some(SessionError::Motors { program: 2, board: 1 }));
    let mut session = Session::new(Bench::new(&one, 256), one.clone()).unwrap();
    let earliest = session.earliest();
    assert_eq!(session.change(earliest - 1, one.clone()), Err(SessionError::Early { at: earliest - 1, earliest }));
    assert_eq!(
        session.change(earliest, one.clone()),
        Err(SessionError::Waiting { at: earliest, until: session.zero() + 1 })
    );
    session.advance(session.zero(), &mut |_: Edge| {}).unwrap();
    let latest = session.committed_until();
    assert_eq!(session.change(latest + 1, one.clone()), Err(SessionError::Late { at: latest + 1, latest }));
}

#[test]
fn a_queue_without_room_for_what_comes_next_is_a_stop() {
    let law = Law::sine(500.0, Time::SECOND, Some(2)).unwrap();
    let program = program(32, vec![motor(0, law, false, Limits::default())]);
    let mut lab = Lab::new(&program);
    let mut bench = Bench::new(&program, 256);
    bench.full_after = 60;
    let mut session = Session::new(bench, program.clone()).unwrap();
    let report = session.run(&mut lab, |_| {});
    assert!(matches!(report.failure, Some(SessionError::QueueTooShort { motor: 0, .. })), "{:?}", report.failure);
    assert_eq!(report.counted, report.replayed);
    assert_eq!(report.counted, lab.counted);
    assert_eq!(report.faults, [Faults::default()]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// The answer to the last extension never comes: the board has taken it, or has not.
    #[test]
    fn a_cable_that_is_cut_leaves_two_counts(
        program in programs(), cut_s in 0.0..1.5f64, delay in 1u64..1_000_000, took in 0usize..4,
    ) {
        prop_assume!(planned(&program).is_some());
        let mut lab = Lab::new(&program);
        let mut bench = Bench::new(&program, 256);
        bench.delay = delay;
        let mut session = Session::new(bench, program.clone()).unwrap();
        prop_assert_eq!(session.advance((cut_s * TICK_HZ as f64) as u64, &mut lab), Ok(()));
        let bench = session.board_mut();
        bench.lost = Some(RemoteError::Link(LinkError::Lost));
        let took = took.min(bench.on_their_way.len());
        for (lease, limits, _) in bench.on_their_way.iter().take(took) {
            bench.native.extend(*lease, limits).unwrap();
        }
        let was_complete = session.is_complete();
        let report = session.run(&mut lab, |_| {});
        prop_assert_eq!(report.failure.is_some(), !was_complete);
        // Those that may have been taken, the last first.
        let mut otherwise = report.replayed_otherwise.into_iter().rev();
        let replayed = took.checked_sub(1).and_then(|last| otherwise.nth(last)).unwrap_or(report.replayed);
        prop_assert_eq!(&report.counted, &replayed);
        prop_assert_eq!(&lab.counted, &replayed);
    }

    /// A host is lost, or stops, or goes on to another motion, about the tick at which it goes over to another.
    #[test]
    fn about_a_change_motors_brake_within_their_limits(
        (speed, limit) in (200.0..3000.0f64, 5000.0..40_000.0f64),
        parts in prop::collection::vec(0.2..1.0f64, 1..4),
        bits in prop_oneof![Just(16u32), Just(32)],
        ahead in 0u64..400_000,
        after in -100_000i64..200_000,
        stops in any::<bool>(),
    ) {
        let limits = Limits { max_speed: None, max_acceleration: Some(limit), pull_in: 0.0 };
        let up = |part: f64| Law::trapezoid(20_000.0, speed * part, limit * 0.9, limit * 0.9).unwrap();
        let program = program(bits, parts.iter().enumerate().map(|(k, part)| motor(k, up(*part), false, limits)).collect());
        let mut lab = Lab::new(&program);
        let mut session = Session::new(Bench::new(&program, 256), program.clone()).unwrap();
        session.advance(TICK_HZ, &mut lab).unwrap();
        let at = session.earliest() + ahead;
        let mut next = program.clone();
        for (index, motor) in next.motors.iter_mut().enumerate() {
            let state = session.state(index, at).unwrap();
            motor.law = onward(state, &Law::trapezoid(100.0, speed, limit * 0.9, limit * 0.9).unwrap(), limit * 0.9);
        }
        session.change(at, next).unwrap();
        let until = at.saturating_add_signed(after).max(session.board().now());
        session.advance(until, &mut lab).unwrap();
        if stops {
            let stops = session.stop().unwrap();
            // After a step of each motor at the latest.
            prop_assert!(stops <= until + 1 + (TICK_HZ as f64 / (speed * 0.2)) as u64 + REVERSAL);
        }
        let_run_out(&mut session, &mut lab);
        session.fill().ok();
        prop_assert!(session.board().is_idle());
        for (motor, steps) in lab.steps.iter().enumerate() {
            // The law goes on from where the motor is, less than a step off.
            check_acceleration(&steps[steps.len().saturating_sub(500)..], limit * 1.02, 3.0)?;
            prop_assert_eq!(session.count_at(motor, session.board().now() - 1), Some(lab.counted[motor]));
        }
        // And it goes on from rest.
        let at = session.earliest();
        let mut next = program.clone();
        for (index, motor) in next.motors.iter_mut().enumerate() {
            let state = session.state(index, at).unwrap();
            prop_assert!(state.speed == 0.0 && state.count == lab.counted[index]);
            motor.law = onward(state, &Law::trapezoid(-100.0, speed, limit, limit).unwrap(), limit);
        }
        let before = lab.counted.clone();
        session.change(at, next).unwrap();
        let report = session.run(&mut lab, |_| {});
        prop_assert_eq!(report.failure, None);
        prop_assert_eq!(&lab.counted, &before.iter().map(|count| count - 100).collect::<Vec<_>>());
        prop_assert_eq!(report.counted, report.replayed);
    }
}

/// The lease before an extension that is refused stands, whether the board answers so or the line refuses it at once.
#[test]
fn a_refused_extension_leaves_the_lease_as_it_was() {
    let limits = Limits { max_speed: None, max_acceleration: Some(40_000.0), pull_in: 0.0 };
    let law = Law::sine(300.0, Time::from_seconds(0.6), Some(6)).unwrap();
    let program = program(16, vec![motor(0, law, false, limits)]);
    let planned = planned(&program).unwrap();
    for at_once in [false, true] {
        for refusals in [1, 2, 5, u32::MAX] {
            let mut lab = Lab::new(&program);
            let mut session = Session::new(Bench::new(&program, 256), program.clone()).unwrap();
            session.advance(TICK_HZ, &mut lab).unwrap();
            let lease = session.committed_until();
            (session.board_mut().refusals, session.board_mut().refuses_at_once) = (refusals, at_once);
            session.fill().unwrap();
            assert_eq!(session.committed_until(), lease);
            let report = session.run(&mut lab, |_| {});
            assert_eq!((&report.counted, &report.counted), (&report.replayed, &lab.counted));
            check_acceleration(&lab.steps[0], 40_000.0, 1.5).unwrap();
            let steps = lab.steps[0].iter().map(|(tick, sign)| (tick - report.zero, *sign));
            if refusals == u32::MAX {
                // All of them: the motor brakes from the end of that lease on.
                let until = lease - report.zero;
                let is_before = |(tick, _): &(u64, i64)| *tick < until;
                assert!(report.failure.is_some() && steps.len() < planned[0].len());
                assert!(steps.filter(is_before).eq(planned[0].iter().copied().filter(is_before)));
            } else {
                assert_eq!((report.failure, session.board().refusals), (None, 0));
                assert!(steps.eq(planned[0].iter().copied()));
            }
        }
    }
}

/// A change to a plan that brakes harder asks the board for that first. If it refuses, the old motion goes on.
#[test]
fn a_change_whose_limits_are_refused_is_tried_again_or_not_made() {
    let law = |swing: f64| Law::sine(swing, Time::from_seconds(0.6), None).unwrap();
    let limited = |limit: f64| Limits { max_speed: None, max_acceleration: Some(limit), pull_in: 0.0 };
    let begun = program(16, vec![motor(0, law(100.0), false, limited(20_000.0))]);
    let next = Arc::new(program(16, vec![motor(0, law(200.0), false, limited(40_000.0))]));
    for at_once in [false, true] {
        for (refusals, is_made) in [(1, true), (2, true), (u32::MAX, false)] {
            let mut lab = Lab::new(&begun);
            let mut session = Session::new(Bench::new(&begun, 256), begun.clone()).unwrap();
            session.advance(TICK_HZ, &mut lab).unwrap();
            (session.board_mut().refusals, session.board_mut().refuses_at_once) = (refusals, at_once);
            let change = Change { program: Arc::clone(&next), over: None, begins: Begins::WithTheMotion };
            let changed = session.change_to(&change);
            if !is_made {
                assert!(matches!(changed, Err(SessionError::Switch(SwitchRefused::Late { .. }))), "{changed:?}");
            }
            assert_eq!(changed.is_ok(), is_made, "{changed:?}");
            session.board_mut().refusals = 0;
            let now = session.board().now();
            session.advance(now + 2 * TICK_HZ, &mut lab).unwrap();
            let counts = |from: u64| {
                let mut count = 0;
                let after = lab.steps[0].iter().filter_map(|(tick, sign)| {
                    count += sign;
                    (*tick >= from).then_some(count)
                });
                { after }.max().unwrap()
            };
            assert_eq!(counts(now + TICK_HZ), if is_made { 400 } else { 200 });
            session.stop().unwrap();
            let report = session.run(&mut lab, |_| {});
            assert_eq!((report.failure, &report.counted), (None, &report.replayed));
            check_acceleration(&lab.steps[0], 40_000.0, 1.5).unwrap();
        }
    }
}

/// A plan that ends gets its own limits, since its lease is not extended again, and the plan before it brakes by them until then.
#[test]
fn a_plan_that_ends_may_bring_lower_limits() {
    const LOW: f64 = 9000.0;
    let limited = |limit: f64| Limits { max_speed: None, max_acceleration: Some(limit), pull_in: 0.0 };
    let law = Law::sine(300.0, Time::from_seconds(0.6), None).unwrap();
    let begun = program(16, vec![motor(0, law, false, limited(40_000.0))]);
    // From rest, with a plan that the board has at once; and from full speed, with one whose end it gets while the change waits for its tick.
    for (begin_s, distance) in [(1.2, 3.0), (1.05, 10.0)] {
        for stops in [None, Some(false), Some(true)] {
            let mut lab = Lab::new(&begun);
            let mut session = Session::new(Bench::new(&begun, 256), begun.clone()).unwrap();
            let begin = session.zero() + (begin_s * TICK_HZ as f64) as u64;
            session.advance(begin - TICK_HZ / 100, &mut lab).unwrap();
            assert!(session.earliest() < begin);
            let state = session.state(0, begin).unwrap();
            let mut next = begun.clone();
            next.motors[0].limits = limited(LOW);
            next.motors[0].law =
                onward(state, &Law::trapezoid(distance, 400.0, 0.9 * LOW, 0.9 * LOW).unwrap(), 0.9 * LOW);
            session.change(begin, next).unwrap();
            assert!(session.is_complete(), "the lease has no end");
            let steps_before = lab.steps[0].len();
            if let Some(is_before) = stops {
                if !is_before {
                    session.advance(begin + TICK_HZ / 200, &mut lab).unwrap();
                }
                session.stop().unwrap();
            }
            let report = session.run(&mut lab, |_| {});
            assert_eq!((report.failure, &report.counted, &report.counted), (None, &report.replayed, &lab.counted));
            assert_eq!(report.faults, [Faults::default()]);
            let steps = &lab.steps[0];
            // At its full speed the old law has next to no acceleration, and at its turn all that it has.
            let is_slow = |(tick, _): &&(u64, i64)| begin_s == 1.05 || *tick >= begin;
            let slow: Vec<(u64, i64)> = steps[steps_before..].iter().filter(is_slow).copied().collect();
            check_acceleration(&slow, LOW * 1.02, 3.0).unwrap();
            // At its full speed a motor needs 548 steps to brake by the low limit, and 123 by the other one.
            if begin_s == 1.05 {
                assert!(steps.len() - steps_before > 500, "{} steps", steps.len() - steps_before);
            }
        }
    }
}

/// The answer to an order to brake never comes: the board brakes, or goes on to the end of its lease, and nobody knows which.
#[test]
fn a_stop_that_is_not_answered_leaves_no_count() {
    let limits = Limits { max_speed: None, max_acceleration: Some(20_000.0), pull_in: 0.0 };
    let program = program(16, vec![motor(0, Law::trapezoid(20_000.0, 2000.0, 9000.0, 9000.0).unwrap(), false, limits)]);
    for hears in [false, true] {
        let mut lab = Lab::new(&program);
        let mut session = Session::new(Bench::new(&program, 256), program.clone()).unwrap();
        session.advance(TICK_HZ, &mut lab).unwrap();
        session.board_mut().cut_at_brake = Some(hears);
        assert_eq!(session.stop(), Err(SessionError::Lost(RemoteError::Link(LinkError::Lost))));
        let report = session.run(&mut lab, |_| {});
        assert!(report.stop_unanswered);
        assert_eq!(report.counted == report.replayed, !hears);
    }
}

/// Ticks of 32 bits come back within a rest.
#[test]
fn a_motor_may_rest_for_longer_than_its_ticks_last() {
    let wave = Law::sine(300.0, Time::SECOND, Some(1)).unwrap();
    let rest = || Law::rest(Time::from_seconds(700.0)).unwrap();
    let late = Law::then(vec![wave.clone(), rest(), wave.clone()]).unwrap();
    let on = Law::sine(40.0, Time::from_seconds(2.0), Some(351)).unwrap();
    for bits in [16, 32] {
        let limits = Limits { max_speed: None, max_acceleration: Some(20_000.0), pull_in: 0.0 };
        let program = program(bits, vec![motor(0, late.clone(), false, limits), motor(1, on.clone(), false, limits)]);
        let planned = planned(&program).unwrap();
        let mut lab = Lab::new(&program);
        let mut session = Session::new(Bench::new(&program, 256), program.clone()).unwrap();
        let report = session.run(&mut lab, |_| {});
        assert_eq!((report.failure, &report.counted), (None, &report.replayed));
        for (steps, planned) in lab.steps.iter().zip(&planned) {
            assert!(steps.iter().map(|(tick, sign)| (tick - report.zero, *sign)).eq(planned.iter().copied()));
        }
    }
}
