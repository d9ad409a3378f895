//! Anything may be asked of a live motion at any time: the motors go on, keep to their limits, and lose no step.
//!
//! `PULSETRAIN_SEED` says other random requests, `PULSETRAIN_ROUNDS` how many times as many.

use crate::live::check_limits;
use pulsetrain::live::{LiveRun, LiveSetpoints, NamedFiles, RunCommand, TypedLine};
use pulsetrain::motion::file::{MOST_OF_A_NAMED_FILE, read_named_text};
use pulsetrain_board::{BoardKind, Edge, Leased};
use pulsetrain_session::drive::Driven;
use pulsetrain_session::prepare::Prepared;
use std::path::Path;
use std::sync::Arc;

/// Examples that can be changed while they run, with the time between two requests, s.
const EXAMPLES: [&str; 9] = [
    "live.toml",
    "sweep.toml",
    "sweep-phases.toml",
    "formula.toml",
    "tutorial.toml",
    "circle.toml",
    "lorenz.toml",
    "delta.toml",
    "s-curve.toml",
];

/// Requests of a round on a motion.
const REQUESTS: u32 = 25;

/// Knuth's generator of 64 bits.
struct Random(u64);

impl Random {
    fn from(&mut self, least: f64, most: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        least + (most - least) * (self.0 >> 40) as f64 / (1u64 << 24) as f64
    }

    /// A line that somebody might type.
    fn line<B: Leased>(&mut self, show: &LiveRun<B>) -> String {
        let (knobs, cues) = (show.setpoints().knobs(), show.setpoints().cues());
        match self.from(0.0, 12.0) as u32 {
            0 => format!("tempo {:.2}", self.from(0.0, 3.0)),
            1 => "tempo 1".to_owned(),
            2 => "pause".to_owned(),
            3 | 4 => "resume".to_owned(),
            5 => "goto 0".to_owned(),
            6 if !cues.is_empty() => "go".to_owned(),
            7 if !cues.is_empty() => "back".to_owned(),
            _ if knobs.is_empty() => "resume".to_owned(),
            kind => {
                let knob = &knobs[self.from(0.0, knobs.len() as f64) as usize];
                // Near what it is, or anything.
                let value =
                    if kind < 11 { knob.value * self.from(0.5, 1.6) } else { knob.value * self.from(-3.0, 20.0) };
                let value = if kind == 8 { value.round() } else { value };
                format!("{} {value}", knob.name)
            }
        }
    }
}

/// Random requests at random times, on the native board or a virtual one.
fn ask_at_random(example: &str, board: Option<&str>, seed: u64) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
    let text = limited(&std::fs::read_to_string(folder.join(example)).unwrap());
    let load = move |named: &Path| read_named_text(&folder.join(named), MOST_OF_A_NAMED_FILE);
    let opened = LiveSetpoints::of(&text, example, board, NamedFiles::LoadedBy(Arc::new(load)));
    let (mut setpoints, contents) = opened.map_err(|error| error.plain()).unwrap();
    let mut prepared = Prepared::new(example.to_owned(), contents, board).unwrap();
    prepared.prove_first(|_| {}).unwrap();
    setpoints.set_up(&prepared.program);
    match board.and_then(BoardKind::named) {
        None => asked(LiveRun::new(Driven::native(&prepared).unwrap(), setpoints, true), example, seed),
        Some(kind) => {
            let driven = Driven::on_virtual(kind, &prepared, kind.usual_baud()).unwrap();
            asked(LiveRun::new(driven, setpoints, true), example, seed);
        }
    }
}

/// A motion file whose motors all have limits: those that it states, or ones that its laws keep to.
fn limited(text: &str) -> String {
    let mut limited = String::new();
    let mut sections = text.split_inclusive('\n').peekable();
    while let Some(line) = sections.next() {
        limited.push_str(line);
        if line.starts_with("[motor.") {
            let mut section = String::new();
            while let Some(line) = sections.next_if(|line| !line.starts_with('[')) {
                section.push_str(line);
            }
            if !section.contains("max_acceleration") && !section.contains("pull_in") {
                limited.push_str("max_speed = \"20 rev/s\"\nmax_acceleration = \"400 rev/s^2\"\n");
            }
            limited.push_str(&section);
        }
    }
    limited
}

fn asked<B: Leased>(mut show: LiveRun<B>, example: &str, seed: u64) {
    println!("{example}, PULSETRAIN_SEED={seed}");
    let (begin, hz) = (show.now(), show.setpoints().setup().board.tick_hz as f64);
    let mut random = Random(seed);
    let mut lines = Vec::new();
    let mut edges = Vec::new();
    let mut run = |show: &mut LiveRun<B>, request: Option<RunCommand>, lines: &[String]| {
        let mut observer = |edge: Edge| edges.push(edge);
        let asked = request.map_or(Ok(None), |request| show.handle(request, &mut observer, &mut |_| {}));
        let stepped = asked.and_then(|_| show.step(&mut observer, &mut |_| {}));
        stepped.unwrap_or_else(|error| panic!("{example}, seed {seed}, after {lines:#?}: {error}"))
    };
    for _ in 0..REQUESTS {
        let at = show.now() + (hz * random.from(0.0, 2.0)) as u64;
        while show.now() < at {
            assert_eq!(run(&mut show, None, &lines), None, "nobody stopped it");
        }
        let line = random.line(&show);
        lines.push(format!("{:.2} s: {line}", (show.now() - begin) as f64 / hz));
        let Ok(TypedLine::Command(request)) = TypedLine::read(&line) else { panic!("{line} is no line") };
        run(&mut show, Some(request), &lines);
    }
    // The board counts what was sent, or this is an error.
    let mut ended = run(&mut show, Some(RunCommand::Stop), &lines);
    while ended.is_none() {
        ended = run(&mut show, None, &lines);
    }
    let checked = check_limits(&edges, show.setpoints().setup());
    checked.unwrap_or_else(|error| panic!("{example}, seed {seed}, after {lines:#?}: {error}"));
}

#[test]
fn nothing_that_is_asked_stops_the_motors() {
    let number = |name: &str| std::env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
    let (seed, rounds) = (number("PULSETRAIN_SEED").unwrap_or(1), number("PULSETRAIN_ROUNDS").unwrap_or(1));
    println!("PULSETRAIN_SEED={seed}");
    for example in EXAMPLES {
        for round in 0..2 * rounds {
            ask_at_random(example, None, seed + round);
        }
    }
}
