//! One bit of one segment changes on its way to the board: the verdict must see it on the pins.

use proptest::prelude::*;
use pulsetrain_board::{Config, Edge, MotorConfig, Native, Wiring};
use pulsetrain_core::{Direction, Entry, Epoch, Item, Segment, Tick32};
use pulsetrain_motion::file;
use pulsetrain_motion::program::Program;
use pulsetrain_plan::{Ensemble, Move};
use pulsetrain_trace::verdict::{Options, judge};
use pulsetrain_trace::{Trace, lines};
use std::path::Path;

/// The tutorial's sine: 158 segments.
fn tutorial() -> (Program, Vec<(Segment, Direction)>) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/tutorial.toml");
    let program = file::load(&path).unwrap();
    let mut ensemble = Ensemble::new(&program).unwrap();
    let mut segments = Vec::new();
    while let Some(next) = ensemble.next_move(0).unwrap() {
        let Move::Run { segment, direction } = next else { panic!("the tutorial has no dwell") };
        segments.push((segment, direction));
    }
    drop(ensemble);
    (program, segments)
}

/// Ticks of all steps, by integers alone.
fn scheduled(segments: &[(Segment, Direction)]) -> Vec<i128> {
    let mut accumulator = 1_i128 << 15;
    let mut ticks = Vec::new();
    for (segment, _) in segments {
        ticks.extend((1..=segment.count).map(|k| (accumulator + segment.span(k)) >> 16));
        accumulator += segment.span(segment.count);
    }
    ticks
}

/// Whether the verdict accepts the edges that a board makes of the segments.
fn passes(program: &Program, segments: &[(Segment, Direction)]) -> bool {
    let timing = program.motors[0].timing.ticks(program.board.tick_hz);
    let wiring = Wiring::StepDir {
        step: 0,
        dir: 1,
        forward_high: false,
        pulse_ticks: u32::try_from(timing.pulse_high).unwrap(),
        setup_ticks: u32::try_from(timing.dir_setup).unwrap(),
    };
    let motors = vec![MotorConfig { wiring, pull_in_ticks: u64::MAX }];
    let mut board = Native::new(&Config { fraction_bits: program.board.registers.fraction_bits, motors }).unwrap();
    let mut edges = Vec::new();
    let mut push = |board: &mut Native, item| {
        let mut entry = Entry { epoch: Epoch(0), item };
        while let Err(returned) = board.push(0, entry) {
            entry = returned;
            let until = board.now() + 16_000;
            board.advance(until, &mut |edge: Edge| edges.push(edge));
        }
    };
    push(&mut board, Item::Anchor { tick: Tick32(0) });
    for &(segment, direction) in segments {
        push(&mut board, Item::Run { segment, direction });
    }
    board.advance(64_000_000, &mut |edge: Edge| edges.push(edge));
    let edges = edges.iter().map(|e| pulsetrain_trace::Edge { tick: e.tick, line: e.line, level: e.level }).collect();
    let trace = Trace { tick_hz: program.board.tick_hz, lines: lines::of(program), edges };
    judge(&trace, program, &Options::default()).is_ok_and(|report| report.ok)
}

#[test]
fn the_plan_itself_passes() {
    let (program, segments) = tutorial();
    assert!(passes(&program, &segments));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    /// A bit that moves a step by more than twice the bound, or makes more or fewer steps, must be seen. The lowest
    /// bits of a fraction move no step by a tick.
    #[test]
    fn a_bit_of_a_segment_is_seen(which: prop::sample::Index, field in 0..5, bit in 0u32..40) {
        let (program, mut segments) = tutorial();
        let before = scheduled(&segments);
        let (segment, direction) = &mut segments[which.index(158)];
        match field {
            0 => segment.count ^= 1 << (bit % 8),
            1 => segment.interval ^= 1 << bit,
            2 => segment.add ^= 1 << (bit % 32),
            3 => segment.add2 ^= 1 << (bit % 32),
            _ => *direction = direction.reversed(),
        }
        let after = scheduled(&segments);
        let moved = before.iter().zip(&after).any(|(a, b)| (a - b).abs() > 2);
        let seen = moved || before.len() != after.len() || field == 4;
        prop_assume!(seen);
        prop_assert!(!passes(&program, &segments));
    }
}
