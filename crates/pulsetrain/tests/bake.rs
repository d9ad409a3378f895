//! Tables for boards without a host: what they hold, and that nothing adds up in what repeats.

use std::io;

use pulsetrain::bake::table::{PERIOD_BITS, Turn};
use pulsetrain::bake::{BakeError, Row, Sketch, Table, tables};
use pulsetrain_motion::file;
use pulsetrain_motion::program::Program;
use pulsetrain_plan::{Ensemble, Move};

const HZ: u64 = 16_000_000;

fn program(motion: &str) -> Program {
    let text = format!(
        "board = \"uno\"\ntolerance = \"1 tick\"\n[motor.wheel]\nsteps_per_rev = 200\ndriver = \"A4988\"\n\
         pins = {{ step = 8, dir = 9 }}\nforward = \"high\"\n[[motion]]\nmotor = \"wheel\"\n{motion}\n"
    );
    file::read(&text, "wheel.toml", &|_| Err(io::ErrorKind::NotFound.into())).unwrap()
}

/// Steps of rows from a time on (ticks · 2^-16), as the sketch makes them: time and way.
fn played(rows: &[Row], mut at: u128) -> Vec<(u128, bool)> {
    let mut steps = Vec::new();
    for row in rows {
        if row.count == 0 {
            at += u128::from(row.ticks) << 16;
        }
        let mut interval = i128::from(row.ticks) << 16 | i128::from(row.part);
        let mut add = i128::from(row.add);
        for _ in 0..row.count {
            at = at.checked_add_signed(interval).unwrap();
            steps.push((at, row.backward));
            interval += add;
            add += i128::from(row.add2);
        }
    }
    steps
}

/// The same from the planner.
fn planned(program: &Program, most: usize) -> Vec<(u128, bool)> {
    let mut ensemble = Ensemble::new(program).unwrap();
    let (mut at, mut steps) = (0x8000i128, Vec::new());
    while let Some(next) = ensemble.next_move(0).unwrap() {
        match next {
            Move::Dwell { ticks } => at += i128::from(ticks) << 16,
            Move::Run { segment, direction } => {
                let backward = direction == pulsetrain_core::Direction::Backward;
                steps.extend((1..=segment.count).map(|k| ((at + segment.span(k)).cast_unsigned(), backward)));
                at += segment.span(segment.count);
            }
        }
        if steps.len() >= most {
            break;
        }
    }
    steps
}

fn table(program: &Program) -> Table {
    tables(program).unwrap().remove(0)
}

#[test]
fn a_motion_that_ends_is_the_plan_bit_for_bit() {
    for motion in [
        "law.sine = { amplitude = \"2 rev\", period = \"1 s\", cycles = 2 }",
        "law.trapezoid = { distance = \"3 rev\", speed = \"2 rev/s\", acceleration = \"4 rev/s^2\" }",
        "start = \"40 s\"\nlaw.sine = { amplitude = \"0.01 rev\", period = \"90 s\", cycles = 1 }",
    ] {
        let program = program(motion);
        let table = table(&program);
        assert_eq!(table.turn, None);
        let steps = played(&table.rows, 0x8000);
        assert!(steps.len() > 3 && steps == planned(&program, usize::MAX), "{motion}");
        assert_eq!(table.steps, steps.len() as u64);
    }
}

#[test]
fn what_repeats_is_the_plan_and_a_turn_ends_where_the_next_begins() {
    for motion in [
        "law.sine = { amplitude = \"0.5 rev\", period = \"1 s\", cycles = \"forever\" }",
        "start = \"0.1 s\"\nlaw.sine = { amplitude = \"0.3 rev\", period = \"0.7300011 s\", cycles = \"forever\" }",
        "law.sweep = { frequency = \"4 Hz\", swing = \"25 step\", phase = \"0 ms\" }",
        "repeat = \"forever\"\nlaw.then = [ { rest = \"0.5 s\" }, { trapezoid = { distance = \"1 rev\", speed = \"2 rev/s\", \
         acceleration = \"8 rev/s^2\" } } ]",
    ] {
        let program = program(motion);
        let table = table(&program);
        let Turn { from, base, period } = table.turn.expect("it repeats");
        let steps = played(&table.rows, 0x8000);
        let head = played(&table.rows[..from], 0x8000);
        let turn = played(&table.rows[from..], base.into());
        assert_eq!(head.last().map(|step| step.0), Some(base.into()), "{motion}: it begins with the step before");
        assert_eq!([head, turn.clone()].concat(), steps);
        let plan = planned(&program, steps.len() + turn.len());
        assert_eq!(steps, plan[..steps.len()], "{motion}");
        // The next turn is what the planner goes on with, within both certificates and a tick.
        for (step, later) in turn.iter().zip(&plan[steps.len()..]) {
            let moved = step.0 + (period >> (PERIOD_BITS - 16));
            assert!(moved.abs_diff(later.0) <= 3 << 16 && step.1 == later.1, "{motion}: {moved} {later:?}");
        }
    }
}

/// A year of turns, added up as the sketch does it, against the product.
#[test]
fn nothing_adds_up_in_a_year() {
    for seconds in ["0.73", "1", "0.3000000007", "2.71828182845"] {
        let program = program(&format!(
            "law.sine = {{ amplitude = \"0.2 rev\", period = \"{seconds} s\", cycles = \"forever\" }}"
        ));
        let Turn { base, period, .. } = table(&program).turn.expect("it repeats");
        // As the sketch, but for the wrapping of ticks: 16 bits below them, and 32 bits more beside.
        let (step, rest) = ((period >> 32) as u64, period as u32);
        let (mut at, mut carry) = (u128::from(base), 0u32);
        let turns = (365.25 * 86_400.0 / seconds.parse::<f64>().unwrap()) as u64;
        for _ in 0..turns {
            at += u128::from(step);
            let (sum, over) = carry.overflowing_add(rest);
            (carry, at) = (sum, at + u128::from(over));
        }
        // n · P, exact: P has units of 2^-64 s.
        let law = program.motors[0].law.cycle().unwrap().1.raw().cast_unsigned();
        let product = (law * u128::from(HZ) * u128::from(turns)) >> 48;
        let apart = (at - u128::from(base)).abs_diff(product);
        assert!(apart <= 2, "{seconds} s: {apart} / 65536 of a tick after {turns} turns");
    }
}

#[test]
fn what_cannot_be_baked_is_told() {
    let endless = program("law.formula = { theta = \"0.1*sin(t)\", unit = \"rev\" }");
    assert!(matches!(tables(&endless), Err(BakeError::Endless { motor }) if motor == "wheel"));
    let waits = program("start = \"140 s\"\nlaw.sine = { amplitude = \"0.1 rev\", period = \"1 s\", cycles = 1 }");
    assert!(matches!(tables(&waits), Err(BakeError::Wait { limit_s, .. }) if (134.0..135.0).contains(&limit_s)));
    // Waits that are short enough each, and not together.
    let waits = program(
        "law.then = [ { rest = \"100 s\" }, { rest = \"50 s\" }, { sine = { amplitude = \"0.1 rev\", period = \"1 s\", cycles = 1 } } ]",
    );
    assert!(matches!(tables(&waits), Err(BakeError::Wait { wait_s, .. }) if (134.0..150.2).contains(&wait_s)));
    let fast = program("law.sine = { amplitude = \"20 rev\", period = \"1 s\" }");
    let error = Sketch::new(&fast, "fast").unwrap_err();
    assert!(matches!(error, BakeError::TooFast { rate_hz, .. } if rate_hz > 20_000.0), "{error}");
    // 4000 steps * 2 pi: 25 100 steps/s, where 14 000 fit.
    assert!(error.to_string().contains("the motion 1.8"), "{error}");
    let mut pico = program("law.sine = { amplitude = \"0.1 rev\", period = \"1 s\" }");
    pico.board.name = "pico".into();
    assert!(matches!(Sketch::new(&pico, "pico"), Err(BakeError::Board { .. })));
}
