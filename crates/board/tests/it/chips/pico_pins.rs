//! Pins of the Pico: which are driven when, what happens to them as the configuration changes, and the enable line.

use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::{Board, Edge, Lease, Leased, Remote, RemoteError, Setup};
use pulsetrain_core::output::{HALF_STEPS, Sequence};
use pulsetrain_core::wire::Reason;
use pulsetrain_core::wire::message::MotorSetup;
use pulsetrain_core::{Direction, Entry, Epoch, Item, Tick32};
use pulsetrain_emulator::Level;
use pulsetrain_testkit::pico::{Pair, TICK_HZ, as_line, coil_levels, coils, pins_of, run, step_dir};

use Direction::{Backward, Forward};

/// GPIO of the gate: an output from the start.
const GATE: u8 = 25;

fn outputs(pico: &VirtualPico) -> Vec<u8> {
    (0..30).filter(|pin| !matches!(pin, 0 | 1 | 25) && pico.chip().is_output(*pin)).collect()
}

fn high(pico: &Remote<VirtualPico>, pin: u8) -> bool {
    pico.port().chip().pin(pin) == Level::High
}

fn setup(motors: Vec<MotorSetup>, enable: Option<(u8, bool)>) -> Setup {
    Setup { pulse_ticks: 125, motors, enable, ..Setup::default() }
}

fn wait(pico: &mut Remote<VirtualPico>, ticks: u64) {
    let until = pico.now() + ticks;
    pico.advance(until, &mut |_: Edge| {});
}

/// Tells a motor an epoch that begins in 20 ms, and waits until then.
fn begin(pico: &mut Remote<VirtualPico>, motor: usize, epoch: u8, runs: &[Item]) {
    let from = pico.now() + pico.round_trip() + TICK_HZ / 50;
    for item in [Item::Anchor { tick: Tick32::of(from) }].iter().chain(runs) {
        pico.push(motor, Entry { epoch: Epoch(epoch), item: *item }).expect("there is room");
    }
    let switched = pico.switch(Epoch(epoch), from, Lease::Last, &[]);
    assert_eq!(switched, Ok(()), "epoch {epoch}, motor {motor}: {:?} {:?}", pico.error(), pico.port());
    let ticks = from - pico.now();
    wait(pico, ticks);
}

/// One configuration after the other: only the pins of the last are outputs, each time.
#[test]
fn another_configuration_leaves_no_pin_of_the_one_before_driven() {
    let mut pico = Remote::open(VirtualPico::new(), 1).expect("it answers");
    assert_eq!(outputs(pico.port()), []);
    assert!(pico.port().chip().is_output(GATE));
    let eight: Vec<_> = (0..8).map(|motor| step_dir(2 + 2 * motor)).collect();
    let six: Vec<_> = (0..6).map(|motor| coils(2 + 4 * motor, Sequence::Full)).collect();
    let setups = [
        setup(eight, Some((22, true))),
        setup(vec![step_dir(4)], Some((3, false))),
        setup(six, None),
        // The enable line is where STEP was, and the reverse.
        setup(vec![step_dir(2), coils(6, Sequence::Half)], Some((26, true))),
        setup(vec![step_dir(26)], Some((2, false))),
        setup(vec![coils(22, Sequence::Half)], None),
        setup((0..5).map(|motor| coils(2 + 4 * motor, Sequence::Half)).collect(), Some((28, true))),
        setup(vec![step_dir(20)], None),
    ];
    for (epoch, setup) in (1..).zip(&setups) {
        pico.configure(setup).unwrap_or_else(|error| panic!("{error}: {setup:?}"));
        // Every motor has moved, so that coils are on, and enable is active.
        for motor in 0..setup.motors.len() {
            begin(&mut pico, motor, 20 * epoch + motor as u8, &[run(3, 1_250_000, Forward)]);
            wait(&mut pico, TICK_HZ / 25);
        }
        let mut wanted: Vec<u8> = setup.motors.iter().flat_map(pins_of).collect();
        wanted.extend(setup.enable.map(|(pin, _)| pin));
        wanted.sort_unstable();
        assert_eq!(outputs(pico.port()), wanted);
        if let Some((pin, active)) = setup.enable {
            assert_eq!(high(&pico, pin), active);
        }
        // What is nobody's is pulled down, as after a reset.
        for pin in (2..29).filter(|pin| !matches!(pin, 23..=25) && !wanted.contains(pin)) {
            assert!(!high(&pico, pin), "pin {pin} after {setup:?}");
        }
    }
}

/// The enable line: off as it is configured, on from Arm to Release, released after a rest and on again with the next step.
#[test]
fn the_enable_line_goes_with_the_motors() {
    for active in [false, true] {
        let mut pico = Remote::open(VirtualPico::new(), 1).expect("it answers");
        let mut setup = setup(vec![step_dir(2)], Some((22, active)));
        // Nothing drives it before.
        assert!(!pico.port().chip().is_output(22));
        pico.configure(&setup).expect("it takes it");
        assert_eq!(high(&pico, 22), active, "armed");
        wait(&mut pico, TICK_HZ / 5);
        assert_eq!(high(&pico, 22), active, "it holds");
        pico.release().expect("at rest");
        assert_eq!(high(&pico, 22), !active);
        // An immediate stop without an idle time holds too.
        pico.arm().expect("at rest");
        begin(&mut pico, 0, 1, &[run(100_000, 10_000, Forward)]);
        let now = pico.now();
        pico.stop_now(now, &mut |_: Edge| {});
        wait(&mut pico, TICK_HZ / 2);
        assert_eq!(high(&pico, 22), active, "it holds");

        setup.idle_ms = Some(100);
        pico.configure(&setup).expect("it takes it");
        let mut edges = Vec::new();
        for epoch in 2..4 {
            begin(&mut pico, 0, epoch, &[run(10, 125_000, Forward)]);
            let until = pico.now() + TICK_HZ / 5;
            pico.advance(until, &mut |edge: Edge| edges.push(edge));
            assert_eq!(high(&pico, 22), !active, "released");
        }
        let ticks = |line: u8, level: bool| {
            edges
                .iter()
                .filter(move |edge| edge.line == line && edge.level == level)
                .map(|edge| edge.tick)
                .collect::<Vec<_>>()
        };
        let (steps, on, off) = (ticks(2, true), ticks(22, active), ticks(22, !active));
        assert_eq!((steps.len(), off.len()), (20, 2));
        // The second time it is switched on while the observer looks; well before the step.
        for (last, off) in [steps[9], steps[19]].iter().zip(&off) {
            let rest = (off - last) / (TICK_HZ / 1000);
            assert!((99..=110).contains(&rest), "{rest} ms after the last step");
        }
        assert!(on.iter().all(|on| steps.iter().all(|step| step.abs_diff(*on) > TICK_HZ / 1000)), "{on:?}");
        // And after a stop.
        begin(&mut pico, 0, 9, &[run(100_000, 10_000, Forward)]);
        assert_eq!(high(&pico, 22), active);
        let now = pico.now();
        pico.stop_now(now, &mut |_: Edge| {});
        wait(&mut pico, TICK_HZ / 20);
        assert_eq!(high(&pico, 22), active, "not yet");
        wait(&mut pico, TICK_HZ / 10);
        assert_eq!(high(&pico, 22), !active);
        // It is on with Arm, and stays for its time.
        pico.arm().expect("at rest");
        assert_eq!(high(&pico, 22), active);
    }
}

/// Coils after an immediate stop: they stay as they are, on at the position's phase or off, and are released after the idle time.
#[test]
fn coils_after_a_stop_obey_the_idle_time() {
    for idle_ms in [None, Some(50)] {
        for motor in [coils(6, Sequence::Half), coils(22, Sequence::Half)] {
            let setup = Setup { idle_ms, ..setup(vec![motor, step_dir(2)], None) };
            let mut pair = Pair::new(&setup);
            let observed = |pair: &mut Pair, ticks: u64| {
                let until = pair.pico.now() + ticks;
                let Pair { setup, pico, edges, .. } = pair;
                pico.advance(until, &mut |edge: Edge| edges.extend(as_line(setup, edge)));
            };
            for round in 0..8 {
                let from = pair.pico.now() + pair.pico.round_trip() + TICK_HZ / 50;
                // The other motor goes on, so that the coils alone may be at rest when it comes.
                for (number, item) in [(0, run(20, 250_000, Backward)), (1, run(1_000_000, 10_000, Forward))] {
                    for item in [Item::Anchor { tick: Tick32::of(from) }, item] {
                        pair.pico.push(number, Entry { epoch: Epoch(round + 1), item }).expect("there is room");
                    }
                }
                assert_eq!(pair.pico.switch(Epoch(round + 1), from, Lease::Last, &[]), Ok(()));
                // Under way, at rest and on, released with the time, and a moment before and after that.
                let last = from + 20 * 250_000;
                let idle = idle_ms.map_or(0, |ms| u64::from(ms) * TICK_HZ / 1000);
                let stop = match round {
                    0..=2 => from + 1_000_000 + 777_000 * u64::from(round),
                    3 => last + idle / 2,
                    4 => last + idle - TICK_HZ / 1000,
                    5 => last + idle - 200_000,
                    6 => last + idle + 50_000,
                    _ => last + idle + TICK_HZ / 50,
                };
                let Pair { setup, pico, edges, .. } = &mut pair;
                let report = pico.stop_now(stop, &mut |edge: Edge| edges.extend(as_line(setup, edge)));
                let before = coil_levels(edges, &motor);
                let phase = report.positions[0].rem_euclid(8) as usize;
                let held = idle_ms.is_none() || report.tick < last + idle;
                assert_eq!(before, if held { HALF_STEPS[phase] } else { 0 }, "round {round}");
                observed(&mut pair, TICK_HZ / 25);
                assert_eq!(coil_levels(&pair.edges, &motor), before, "round {round}: it stays");
                observed(&mut pair, TICK_HZ / 16);
                let after = if idle_ms.is_none() { before } else { 0 };
                assert_eq!(coil_levels(&pair.edges, &motor), after, "round {round}: {idle_ms:?}");
                // It goes on from its phase.
                pair.pico.arm().expect("at rest");
                observed(&mut pair, TICK_HZ / 100);
                assert_eq!(coil_levels(&pair.edges, &motor), after);
            }
        }
    }
}

/// What cannot be: refused with the pin, and the configuration of before stays.
#[test]
fn pins_that_are_not_there_are_refused() {
    let mut pico = Remote::open(VirtualPico::new(), 1).expect("it answers");
    pico.configure(&setup(vec![step_dir(2)], None)).expect("it takes it");
    let half = Sequence::Half;
    let apart = MotorSetup { dir_pin: 6, ..step_dir(4) };
    let cases = [
        (vec![step_dir(0)], None, Reason::Pin, 0),
        (vec![step_dir(22)], None, Reason::Pin, 23),
        (vec![step_dir(25)], None, Reason::Pin, 25),
        (vec![step_dir(28)], None, Reason::Pin, 29),
        (vec![apart], None, Reason::PinMix, 6),
        (vec![coils(23, half)], None, Reason::Pin, 23),
        (vec![coils(26, half)], None, Reason::Pin, 29),
        (vec![coils(254, half)], None, Reason::Pin, 254),
        (vec![coils(2, half), step_dir(5)], None, Reason::PinTaken, 5),
        (vec![coils(20, half), coils(22, half)], None, Reason::PinTaken, 22),
        (vec![coils(22, half), step_dir(27)], None, Reason::PinTaken, 27),
        (vec![step_dir(2)], Some((3, true)), Reason::PinTaken, 3),
        (vec![step_dir(2)], Some((24, true)), Reason::Pin, 24),
    ];
    for (motors, enable, reason, detail) in cases {
        let refused = pico.configure(&setup(motors.clone(), enable));
        let what = "take this configuration";
        assert_eq!(refused, Err(RemoteError::Refused { what, reason, detail }), "{motors:?} {enable:?}");
        assert_eq!(outputs(pico.port()), [2, 3]);
    }
}
