//! The native winch: text in, edges out.

use proptest::prelude::*;
use pulsetrain_board::native_winch::{DIR_PINS, ENABLE_PIN, NativeWinch, STEP_PINS};
use pulsetrain_board::{Edge, Port, VirtualBoard};
use pulsetrain_core::wire::Baud;
use std::time::Duration;

const TICK_HZ: f64 = 16e6;
const TICKS_PER_MS: u64 = 16_000;

/// A winch, what it said and what its pins did.
struct Lab {
    winch: NativeWinch,
    heard: Vec<u8>,
    edges: Vec<Edge>,
}

impl Lab {
    fn new() -> Lab {
        Lab { winch: NativeWinch::new(), heard: Vec::new(), edges: Vec::new() }
    }

    fn run_to(&mut self, ms: u64) {
        let until = Duration::from_millis(ms);
        while self.winch.now() < until {
            self.winch.receive(until, &mut self.heard).unwrap();
        }
        self.winch.edges(&mut self.edges);
    }

    fn run(&mut self, ms: u64) {
        self.run_to(u64::try_from(self.winch.now().as_millis()).unwrap() + ms);
    }

    fn tell(&mut self, line: &str) {
        self.winch.send(format!("{line}\n").as_bytes()).unwrap();
    }

    /// The lines that were said. One that is under way does not count.
    fn lines(&self) -> impl Iterator<Item = &str> {
        let text = str::from_utf8(&self.heard).unwrap();
        text.rsplit_once("\r\n").map_or("", |(whole, _)| whole).split("\r\n")
    }

    /// What was said, but for statuses.
    fn replies(&self) -> Vec<&str> {
        self.lines().filter(|line| !line.is_empty() && !line.starts_with("txyza ")).collect()
    }

    /// The clock's µs and the positions of each status.
    fn statuses(&self) -> Vec<(u64, [i64; 4])> {
        let of_line = |line: &str| {
            let numbers: Vec<i64> = line.strip_prefix("txyza ")?.split(' ').map(|word| word.parse().unwrap()).collect();
            let [usec, x, y, z, a] = numbers[..] else { panic!("{line}") };
            Some((u64::try_from(usec).unwrap(), [x, y, z, a]))
        };
        self.lines().filter_map(of_line).collect()
    }

    /// Each axis' steps: tick and position after it. DIR is up a while before, and pulses last.
    fn steps(&self) -> [Vec<(u64, i64)>; 4] {
        let mut steps = [const { Vec::new() }; 4];
        let (mut forward, mut turned, mut risen) = ([false; 4], [0; 4], [None; 4]);
        let mut last = 0;
        for edge in &self.edges {
            assert!(edge.tick >= last, "edges in order of time");
            last = edge.tick;
            if let Some(axis) = DIR_PINS.iter().position(|pin| *pin == edge.line) {
                assert!(risen[axis].is_none(), "DIR of axis {axis} turns in a pulse at {}", edge.tick);
                (forward[axis], turned[axis]) = (edge.level, edge.tick);
            }
            let Some(axis) = STEP_PINS.iter().position(|pin| *pin == edge.line) else { continue };
            if edge.level {
                assert!(edge.tick - turned[axis] >= 16, "DIR of axis {axis} 1 µs before {}", edge.tick);
                let position = steps[axis].last().map_or(0, |step: &(u64, i64)| step.1);
                steps[axis].push((edge.tick, if forward[axis] { position + 1 } else { position - 1 }));
                risen[axis] = Some(edge.tick);
            } else {
                let pulse = edge.tick - risen[axis].take().expect("a pulse");
                assert!(pulse >= 16, "a pulse of {pulse} ticks");
            }
        }
        steps
    }
}

#[test]
fn a_hundred_commands_back_to_back() {
    let mut lab = Lab::new();
    lab.winch.send("d x 10\n".repeat(100).as_bytes()).unwrap();
    lab.run_to(20_000);
    assert_eq!(lab.winch.positions(), [1000, 0, 0, 0]);
    assert_eq!(lab.steps()[0].last().unwrap().1, 1000);
    assert!(lab.winch.is_at_rest());
}

#[test]
fn it_answers() {
    let mut lab = Lab::new();
    for line in ["ping", "version", "a x nan", "a 5", "strict 1", "a xq 1", "d x 5*00", "srate 0"] {
        lab.tell(line);
    }
    lab.run_to(50);
    let expected = [
        "awake",
        "awake",
        "id StepperWinch Nov 21 2026",
        "err number 3",
        "err flags 2",
        "err flags 2",
        "err checksum 3",
        "dbg invalid srate value",
    ];
    assert_eq!(lab.replies(), expected);
    assert!(lab.statuses().is_empty(), "the first is due after 200 ms");
    lab.run_to(999);
    let clocks: Vec<u64> = lab.statuses().iter().map(|status| status.0).collect();
    assert_eq!(clocks, [200_000, 400_000, 600_000, 800_000]);
}

#[test]
fn every_line_of_a_burst_is_answered() {
    let mut lab = Lab::new();
    lab.winch.send("q\n".repeat(32).as_bytes()).unwrap();
    lab.winch.send("version\n".repeat(100).as_bytes()).unwrap();
    lab.tell("a x nan");
    lab.run_to(1000);
    let replies = lab.replies();
    assert_eq!(replies.iter().filter(|reply| **reply == "err command 1").count(), 32);
    assert_eq!(replies.iter().filter(|reply| reply.starts_with("id ")).count(), 100);
    assert_eq!((replies.len(), replies.last()), (134, Some(&"err number 3")), "and one `awake`");
}

#[test]
fn drivers_are_off_until_it_is_to_move_and_after_a_stop() {
    let mut lab = Lab::new();
    lab.tell("g xy 2 1");
    lab.tell("r y 100");
    lab.run_to(500);
    assert!(!lab.winch.is_enabled() && lab.winch.positions() == [0; 4], "what is told moves nothing yet");
    lab.tell("v x 3000");
    lab.run_to(1500);
    assert!(lab.winch.is_enabled() && lab.winch.positions()[0] > 1000 && lab.winch.positions()[1] > 90);
    lab.tell("enable 0");
    lab.run(200);
    assert!(!lab.winch.is_enabled() && lab.winch.is_at_rest());
    let enables: Vec<_> = lab.edges.iter().filter(|edge| edge.line == ENABLE_PIN).collect();
    assert!(matches!(enables[..], [off, on, _] if off.level && !on.level), "{enables:?}");
    // 3000 steps/s at 35 000 steps/s² are 86 ms; a line and a slice come before.
    let (told, released) = (1500 * TICKS_PER_MS, enables[2].tick);
    assert!(released - told < 92 * TICKS_PER_MS, "{} ms", (released - told) / TICKS_PER_MS);
    let last_step = lab.steps()[0].last().unwrap().0;
    assert!(last_step < released && last_step > told + 80 * TICKS_PER_MS);
    // A command for a new target meanwhile keeps them on.
    lab.tell("v x 3000");
    lab.run(1000);
    lab.tell("enable 0");
    lab.run(20);
    lab.tell("v x 0");
    lab.run(1000);
    assert!(lab.winch.is_enabled());
}

#[test]
fn silence_stops_it_if_it_is_to() {
    let mut lab = Lab::new();
    lab.tell("deadman 100");
    lab.tell("v xyza 1000 1000 1000 1000");
    lab.run_to(2000);
    assert!(lab.winch.is_at_rest() && lab.winch.is_enabled());
    let last = lab.steps()[0].last().unwrap().0;
    assert!(last < 150 * TICKS_PER_MS, "{last}");
    lab.tell("v x 1000");
    for _ in 0..20 {
        lab.tell("ping");
        lab.run(90);
    }
    assert!(!lab.winch.is_at_rest(), "it was talked to");
}

#[test]
fn a_reset_begins_anew() {
    let mut lab = Lab::new();
    lab.tell("v x 1000");
    lab.run_to(1000);
    assert!(lab.winch.positions()[0] > 0);
    VirtualBoard::reset(&mut lab.winch);
    lab.edges.clear();
    lab.heard.clear();
    lab.run_to(1500);
    assert_eq!((lab.winch.positions(), lab.winch.is_enabled()), ([0; 4], false));
    assert_eq!(lab.replies(), ["awake"]);
    assert_eq!(lab.statuses()[0].0, 200_000, "its clock begins anew");
    lab.winch.set_baud(Baud::B250k).unwrap();
    lab.tell("v x 1000");
    lab.run(500);
    assert!(!lab.winch.is_enabled(), "at another rate it hears noise");
}

/// A line for some axes, and for each of them the limits that it sets.
fn line() -> impl Strategy<Value = (String, Option<(f64, f64)>, [bool; 4])> {
    let number = prop_oneof![
        3 => (-3000..3000_i32).prop_map(|steps| ("a", steps)),
        3 => (-800..800_i32).prop_map(|steps| ("d", steps)),
        2 => (-15_000..15_000_i32).prop_map(|speed| ("v", speed)),
        1 => (-200..200_i32).prop_map(|steps| ("r", steps)),
        1 => (0..4000_i32).prop_map(|speed| ("s", speed)),
    ];
    let axes = prop::sample::subsequence(vec![0, 1, 2, 3], 1..=4);
    let pair = prop_oneof![
        (1..2000_i32, 7..500_i32).prop_map(|(f, ratio)| ("g", f64::from(f) / 100.0, f64::from(ratio) / 100.0)),
        (50..12_000_i32, 300..300_000_i32).prop_map(|(v, a)| ("l", v.into(), a.into())),
    ];
    let named = |axes: &[usize]| axes.iter().map(|axis| "xyza".as_bytes()[*axis] as char).collect::<String>();
    let given = |axes: &[usize]| std::array::from_fn(|axis| axes.contains(&axis));
    prop_oneof![
        3 => (number, axes.clone()).prop_map(move |((verb, value), axes)| {
            let values = (0..).zip(&axes).map(|(n, _)| format!(" {}", value - n * value / 3)).collect::<String>();
            (format!("{verb} {}{values}", named(&axes)), None, given(&axes))
        }),
        1 => (pair, axes).prop_map(move |((verb, first, second), axes)| {
            let limits = (verb == "l").then_some((first, second));
            (format!("{verb} {} {first} {second}", named(&axes)), limits, given(&axes))
        }),
    ]
}

/// What an axis may do in each millisecond: vmax and amax.
struct Allowed {
    ms: Vec<(f64, f64)>,
    vmax: f64,
    amax: f64,
}

impl Allowed {
    /// From the highest of both in the 8 ms in which a line comes into effect.
    fn until(&mut self, ms: u64, (vmax, amax): (f64, f64)) {
        let begun = self.ms.len() as u64;
        for now in begun..ms {
            // Whatever is faster than vmax goes down by amax.
            let last = self.ms.last().map_or(0.0, |last| last.0);
            let recent = if now < begun + 8 { (self.vmax.max(vmax), self.amax.max(amax)) } else { (vmax, amax) };
            let slower = if now < begun + 8 { last } else { last - amax * 1e-3 };
            self.ms.push((recent.0.max(slower), recent.1));
        }
        (self.vmax, self.amax) = (vmax, amax);
    }

    fn over(&self, from: u64, to: u64) -> (f64, f64) {
        let ms = (from / TICKS_PER_MS).saturating_sub(1)..=(to / TICKS_PER_MS);
        let at = |ms: u64| self.ms[(ms as usize).min(self.ms.len() - 1)];
        ms.map(at).reduce(|a, b| (a.0.max(b.0), a.1.max(b.1))).unwrap()
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    /// Whatever it is told, it keeps vmax and amax, makes the steps that it reports, and ends at rest on its target.
    #[test]
    fn random_scripts(script in prop::collection::vec((1..700_u64, line()), 1..14), ends in prop::array::uniform4(-2000..2000_i64)) {
        let mut lab = Lab::new();
        lab.tell("srate 7");
        let mut allowed = [(); 4].map(|()| Allowed { ms: Vec::new(), vmax: 3500.0, amax: 35e3 });
        let mut limits = [(3500.0, 35e3); 4];
        let mut now = 0;
        let mut last = ["g xyza 2 1", "l xyza 5000 50000", "s xyza 0 0 0 0", "v xyza 0 0 0 0"].map(String::from).to_vec();
        last.push(format!("a xyza {} {} {} {}", ends[0], ends[1], ends[2], ends[3]));
        let last = last.into_iter().map(|line| {
            let limits = line.starts_with('l').then_some((5000.0, 50e3));
            (20, (line, limits, [true; 4]))
        });
        for (wait, (line, new, axes)) in script.into_iter().chain(last) {
            now += wait;
            lab.run_to(now);
            for axis in 0..4 {
                allowed[axis].until(now, limits[axis]);
                if let (true, Some((vmax, amax))) = (axes[axis], new) {
                    limits[axis] = (f64::min(vmax, 10e3), f64::min(amax, 250e3));
                }
            }
            lab.tell(&line);
        }
        lab.run_to(now + 16_000);
        for (allowed, limits) in allowed.iter_mut().zip(limits) {
            allowed.until(now + 16_000, limits);
        }
        prop_assert_eq!(lab.replies(), ["awake"]);
        prop_assert_eq!(lab.winch.positions().map(i64::from), ends);
        prop_assert!(lab.winch.is_at_rest());

        let steps = lab.steps();
        for (axis, (steps, allowed)) in steps.iter().zip(&allowed).enumerate() {
            let mut before: Option<(u64, f64)> = None;
            for step in steps.windows(3) {
                let [(_, older), (from, old), (to, new)] = *step else { unreachable!() };
                // A turn's interval is less than a step.
                if (new > old) != (old > older) {
                    before = None;
                    continue;
                }
                let speed = TICK_HZ / (to - from) as f64;
                let (vmax, _) = allowed.over(from, to);
                // Spacing is within a tick at both ends.
                let slack = 3.0 * speed / TICK_HZ;
                prop_assert!(speed <= vmax * (1.0 + slack), "axis {}: {} steps/s, not {}, at {}", axis, speed, vmax, to);
                if let Some((begun, last)) = before {
                    let (_, amax) = allowed.over(begun, to);
                    let most = amax * ((to - begun) as f64 / TICK_HZ + 1e-3) + slack * (speed + last);
                    prop_assert!((speed - last).abs() <= most, "axis {}: {} to {} steps/s at {}", axis, last, speed, to);
                }
                before = Some((from, speed));
            }
        }
        let statuses = lab.statuses();
        prop_assert!(statuses.len() as u64 > now / 8);
        for (usec, positions) in statuses {
            for (axis, position) in positions.into_iter().enumerate() {
                let begun = steps[axis].partition_point(|step| step.0 <= usec * 16);
                let made = if begun == 0 { 0 } else { steps[axis][begun - 1].1 };
                prop_assert_eq!(position, made, "axis {} at {} µs", axis, usec);
            }
        }
    }
}

/// Says a line and gives what is answered within `ms`.
fn ask(lab: &mut Lab, line: &str, ms: u64) -> Vec<String> {
    let before = lab.replies().len();
    lab.tell(line);
    lab.run(ms);
    lab.replies()[before..].iter().map(|line| (*line).to_owned()).collect()
}

/// The lines that tell axes directly: steps at their ticks, done lines, and whose the axes are.
#[test]
fn verbs_move_axes_from_where_a_path_left_them() {
    let mut lab = Lab::new();
    lab.run(20);
    assert_eq!(ask(&mut lab, "speed x 63", 20), ["err period 64"]);
    assert_eq!(ask(&mut lab, "move x", 20), ["err missing 3"]);
    assert!(!lab.winch.is_enabled(), "no refused line enables the drivers");
    ask(&mut lab, "g x 5 1", 20);
    ask(&mut lab, "d x 40", 20);
    assert_eq!(ask(&mut lab, "move x 5", 3000), ["err path"]);
    ask(&mut lab, "enable 0", 100);
    assert_eq!((lab.winch.positions(), lab.winch.is_enabled()), ([40, 0, 0, 0], false));

    // Verbs have the axes, where the path left them.
    let begun = lab.edges.len();
    let at = ask(&mut lab, "speed xy 32000 8000", 20);
    assert!(at.len() == 1 && at[0].ends_with(" x 40 - y 0 -"), "{at:?}");
    assert!(lab.winch.is_enabled());
    assert_eq!(ask(&mut lab, "dir x -1", 20).len(), 1);
    let lines = ask(&mut lab, "move xy 3 100", 100);
    let first: u64 = lines[0].split(' ').nth(1).and_then(|tick| tick.parse().ok()).expect("a tick");
    let done = [format!("done x {} 1", first + 96_000), format!("done y {} 1", first + 800_000)];
    assert_eq!(lines[1..], done);
    let steps = lab.steps();
    let ticks = |count: u64, period: u64| (0..count).map(move |step| first + step * period);
    assert!(steps[0][40..].iter().copied().eq(ticks(3, 32_000).zip([39, 38, 37])));
    assert!(steps[1].iter().map(|(tick, _)| *tick).eq(ticks(100, 8000)));
    assert!(lab.edges[begun..].iter().any(|edge| edge.line == DIR_PINS[0] && !edge.level));
    assert_eq!(ask(&mut lab, "a x 7", 20), ["err verbs"]);

    // A deadman ends a run; positions go on in status lines; enable 0 begins anew.
    ask(&mut lab, "srate 10", 5);
    ask(&mut lab, "run y", 20);
    assert_eq!(ask(&mut lab, "deadman 40", 100), ["uncertain y"], "x rests");
    let stood = lab.winch.positions();
    lab.run(100);
    assert_eq!(lab.winch.positions(), stood);
    assert_eq!(lab.statuses().last().map(|(_, positions)| *positions), Some(stood.map(i64::from)));
    assert!(stood[1] > 200 && stood[0] == 37, "{stood:?}");
    assert_eq!(ask(&mut lab, "enable 0", 30), ["awake"]);
    assert_eq!((lab.winch.positions(), lab.winch.is_enabled(), lab.winch.is_at_rest()), ([0; 4], false, true));
    // Done lines of many short moves wait for room.
    for _ in 0..60 {
        lab.tell("move xyza 1");
    }
    let before = lab.replies().len();
    lab.run(2000);
    let told = lab.replies()[before..].iter().filter(|line| line.starts_with("done a ")).count();
    assert_eq!(told, lab.winch.positions()[3].unsigned_abs() as usize);
    assert!(told > 20, "{told}");
}

/// What `enable 0` stops stays stopped, also if more comes in the same packet; and nothing of that goes by in silence.
#[test]
fn enable_0_stops_whatever_comes_with_it() {
    for (behind, answers) in [
        ("dir x 1", vec!["err moving", "awake"]),
        ("run x", vec!["err moving", "awake"]),
        ("enable 1", vec!["err moving", "awake"]),
        ("enable 0", vec!["awake"]),
        ("a x 5", vec!["err verbs", "awake"]),
    ] {
        let mut lab = Lab::new();
        lab.run(20);
        lab.run(20);
        assert_eq!(ask(&mut lab, "speed x 12500", 30).len(), 1);
        assert_eq!(ask(&mut lab, "run x", 30).len(), 1);
        // Both lines end in the same millisecond.
        assert_eq!(ask(&mut lab, &format!("\n\n\n\nenable 0\n{behind}"), 30), answers, "{behind}");
        let stood = lab.steps()[0].len();
        lab.run(100);
        assert_eq!((lab.winch.is_enabled(), lab.steps()[0].len()), (false, stood), "{behind}");
        // Then all begins anew.
        assert_eq!(ask(&mut lab, "move x 1", 30).len(), 2, "{behind}");
    }
}

/// Paths' commands are not obeyed while verbs have the axes, and that is told.
#[test]
fn paths_commands_are_refused_while_verbs_have_the_axes() {
    let mut lab = Lab::new();
    lab.run(20);
    assert_eq!(ask(&mut lab, "run x", 30).len(), 1);
    for line in ["a x 7", "d x 7", "v x 7", "r x 7", "s x 7", "g x 5 1", "l x 100 100"] {
        assert_eq!(ask(&mut lab, line, 30), ["err verbs"], "{line}");
    }
}

/// A line that is refused does not put the deadman off.
#[test]
fn the_deadman_hears_no_refused_line() {
    let mut lab = Lab::new();
    lab.run(20);
    for line in ["speed x 12500", "move x 1000000", "move x 5"] {
        assert_eq!(ask(&mut lab, line, 30).len(), 1, "{line}");
    }
    ask(&mut lab, "deadman 200", 30);
    let before = lab.replies().len();
    for line in ["move x 5", "a x 5", "speed x 1", "move x 5", "r x 5", "move x 5"] {
        ask(&mut lab, line, 30);
    }
    lab.run(50);
    let (told, refused): (Vec<_>, Vec<_>) =
        lab.replies()[before..].iter().copied().partition(|line: &&str| !line.starts_with("err "));
    assert_eq!((told, refused.len()), (vec!["uncertain x"], 6), "the deadman has struck");
    let stood = lab.winch.positions();
    lab.run(100);
    assert_eq!(lab.winch.positions(), stood, "the deadman's time is over");
}
