//! Law tables: from `law.sine = { … }` to [`Law`]s in steps and seconds.

use super::context::{Context, position_unit, refuse};
use super::points;
use super::reader::{Node, Noted, Read, Section};
use super::winch;
use crate::Time;
use crate::law::{Begin, End, Law, LawError, SCurve, TimerRamp, dds_period};
use crate::quantity::{Base, Quantity, nearest, written};

/// Every law by name, with an example.
const LAWS: &[(&str, &str)] = &[
    ("sine", "sine = { amplitude = \"2.5 rev\", period = \"1 s\", cycles = 10 }"),
    ("formula", "formula = { theta = \"a*sin(2*pi*t)\", unit = \"rev\", duration = \"10 s\", where = { a = 3 } }"),
    ("table", "table = { file = \"path.csv\", time = \"s\", unit = \"rev\" }"),
    ("speed", "speed = { speed = \"2 rev/s\", duration = \"10 s\" }"),
    ("trapezoid", "trapezoid = { distance = \"5 rev\", speed = \"2 rev/s\", acceleration = \"10 rev/s^2\" }"),
    (
        "s_curve",
        "s_curve = { distance = \"5 rev\", speed = \"2 rev/s\", acceleration = \"10 rev/s^2\", jerk = \"100 rev/s^3\" }",
    ),
    ("sweep", "sweep = { frequency = \"0.5 Hz\", swing = \"200 step\", phase = \"0 ms\" }"),
    ("ramp", "ramp = { distance = \"1 rev\", tick = \"8 us\", slowest = 255, fastest = 18, during = 10 }"),
    ("winch", "winch = { axis = \"x\", commands = [\"0 s: a x 100\"], duration = \"5 s\" }"),
    ("rest", "rest = \"1 s\""),
    (
        "sum",
        "sum = [{ sine = { amplitude = \"1 rev\", period = \"1 s\" } }, { speed = { speed = \"2 rev/s\", duration = \"1 s\" } }]",
    ),
    (
        "then",
        "then = [{ trapezoid = { distance = \"5 rev\", speed = \"2 rev/s\", acceleration = \"10 rev/s^2\" } }, { rest = \"1 s\" }]",
    ),
    ("scale", "scale = { by = 0.5, law = { sine = { amplitude = \"1 rev\", period = \"1 s\" } } }"),
    ("shift", "shift = { by = \"90 deg\", law = { sine = { amplitude = \"1 rev\", period = \"1 s\" } } }"),
    ("delay", "delay = { by = \"100 ms\", law = { sine = { amplitude = \"1 rev\", period = \"1 s\" } } }"),
    (
        "repeat",
        "repeat = { times = 3, law = { trapezoid = { distance = \"5 rev\", speed = \"2 rev/s\", acceleration = \"10 rev/s^2\" } } }",
    ),
];

impl Context<'_> {
    /// A table with one law in it.
    pub(super) fn law(&self, node: &Node) -> Read<Law> {
        const EXAMPLE: &str = LAWS[0].1;
        let section = node.any_section("the law".to_owned(), EXAMPLE)?;
        let laws = section.nodes();
        let [law] = laws.as_slice() else {
            let labels = laws.iter().map(|law| (section.key_span(law.key), format!("`{}`", law.key)));
            let labels = if laws.is_empty() { vec![(node.at.clone(), "empty".to_owned())] } else { labels.collect() };
            let help = format!("for several at once use `sum`, for one after the other `then`; known: {}", names());
            return Err(self.reader.note_all(labels, "a motion has exactly one law", help));
        };
        match law.key {
            "sine" => self.sine(law),
            "formula" => self.formula(law),
            "table" => self.table(law),
            "speed" => self.speed(law),
            "trapezoid" => self.trapezoid(law),
            "s_curve" => self.s_curve(law),
            "sweep" => self.sweep(law),
            "ramp" => self.ramp(law),
            "winch" => self.winch(law),
            "rest" => law.duration("1 s").and_then(|duration| self.made(law, Law::rest(duration))),
            "sum" => self.laws(law).and_then(|laws| self.made(law, Law::sum(laws))),
            "then" => self.laws(law).and_then(|laws| self.made(law, Law::then(laws))),
            "scale" => self.scale(law),
            "shift" => self.shift(law),
            "delay" => self.delay(law),
            "repeat" => self.repeat(law),
            unknown => {
                let help = match nearest(unknown, LAWS.iter().map(|law| law.0)) {
                    Some(near) => format!("did you mean `{near}`?"),
                    None => format!("known: {}", names()),
                };
                let at = section.key_span(unknown);
                Err(self.reader.note(at, "not a law", format!("unknown law `{unknown}`"), help))
            }
        }
    }

    /// A list of laws, not empty.
    fn laws(&self, node: &Node) -> Read<Vec<Law>> {
        let list = node.list(example(node.key))?;
        if list.is_empty() {
            return Err(node.note("empty", format!("`{}` has no laws in it", node.key), example(node.key)));
        }
        let laws: Vec<Read<Law>> = list.iter().map(|node| self.law(node)).collect();
        laws.into_iter().collect()
    }

    /// The table of a law's parameters.
    pub(super) fn parameters<'a>(&self, node: &Node<'a>, known: &[&str]) -> Read<Section<'a>> {
        node.section(format!("law `{}`", node.key), known, example(node.key))
    }

    /// What a constructor made of the parameters at `node`.
    pub(super) fn made(&self, node: &Node, law: Result<Law, LawError>) -> Read<Law> {
        law.map_err(|error| node.note("cannot be followed", format!("law `{}`: {error}", node.key), ""))
    }

    fn sine(&self, node: &Node) -> Read<Law> {
        let p = self.parameters(node, &["amplitude", "period", "frequency", "cycles", "dds"])?;
        let amplitude =
            p.need("amplitude", "amplitude = \"2.5 rev\"").and_then(|node| self.gearing.steps(&node, 0, "2.5 rev"));
        let period = period(&p, "sine");
        let cycles = p.get("cycles").map_or(Ok(Some(1)), |node| times(&node));
        self.made(node, Law::sine(amplitude?, period?, cycles?))
    }

    fn speed(&self, node: &Node) -> Read<Law> {
        let p = self.parameters(node, &["speed", "duration"])?;
        let speed = p.need("speed", "speed = \"2 rev/s\"").and_then(|node| self.gearing.steps(&node, 1, "2 rev/s"));
        let duration = p.get("duration").map(|node| node.duration("10 s")).transpose();
        self.made(node, Law::speed(speed?, duration?))
    }

    /// A speed or acceleration, or the motor's own limit where the law has none.
    fn limit(&self, p: &Section, key: &str, per_seconds: u8, limit: Option<f64>, example: &str) -> Read<f64> {
        match (p.get(key), limit) {
            (None, Some(limit)) => Ok(limit),
            _ => {
                let node = p.need(key, &format!("{key} = \"{example}\""))?;
                let steps = self.gearing.steps(&node, per_seconds, example)?;
                node.above_zero(steps)
            }
        }
    }

    fn distance(&self, p: &Section) -> Read<f64> {
        self.gearing.steps(&p.need("distance", "distance = \"5 rev\"")?, 0, "5 rev")
    }

    fn trapezoid(&self, node: &Node) -> Read<Law> {
        let p = self.parameters(node, &["distance", "speed", "acceleration", "deceleration"])?;
        let distance = self.distance(&p);
        let speed = self.limit(&p, "speed", 1, self.limits.max_speed, "2 rev/s");
        let acceleration = self.limit(&p, "acceleration", 2, self.limits.max_acceleration, "10 rev/s^2");
        let deceleration = match p.get("deceleration") {
            // One that is wrong is noted once.
            None => acceleration,
            Some(_) => self.limit(&p, "deceleration", 2, None, "10 rev/s^2"),
        };
        self.made(node, Law::trapezoid(distance?, speed?, acceleration?, deceleration?))
    }

    fn s_curve(&self, node: &Node) -> Read<Law> {
        let p = self.parameters(node, &["distance", "speed", "acceleration", "jerk", "start_speed"])?;
        let distance = self.distance(&p);
        let speed = self.limit(&p, "speed", 1, self.limits.max_speed, "2 rev/s");
        let acceleration = self.limit(&p, "acceleration", 2, self.limits.max_acceleration, "10 rev/s^2");
        let jerk = self.limit(&p, "jerk", 3, None, "100 rev/s^3");
        let start = p.get("start_speed").map_or(Ok(0.0), |node| self.gearing.steps(&node, 1, "0.5 rev/s"));
        let law = SCurve {
            distance: distance?,
            max_speed: speed?,
            max_acceleration: acceleration?,
            max_jerk: jerk?,
            start_speed: start?,
        };
        self.made(node, Law::s_curve(law))
    }

    fn sweep(&self, node: &Node) -> Read<Law> {
        let p = self.parameters(node, &["frequency", "swing", "phase"])?;
        let frequency = p.need("frequency", "frequency = \"0.5 Hz\"").and_then(|node| node.frequency("0.5 Hz"));
        let swing = p.need("swing", "swing = \"200 step\"").and_then(|node| {
            let steps = self.whole_steps(&node, "200 step")?;
            node.above_zero(steps as f64).map(|_| steps.unsigned_abs())
        });
        let phase = p.get("phase").map(|node| node.phase("0.25 turn")).transpose();
        let (frequency_hz, period) = frequency?;
        // As in the sketch: the phase shift is taken modulo the period.
        let delay = phase?.map_or(Time::ZERO, |phase| phase.of(period));
        self.made(node, Law::sweep(frequency_hz, swing?, delay))
    }

    /// An amount that must come to whole steps.
    fn whole_steps(&self, node: &Node, example: &str) -> Read<i64> {
        let steps = self.gearing.steps(node, 0, example)?;
        if (steps - steps.round()).abs() <= 1e-6 && steps.abs() < 1e15 {
            return Ok(steps.round() as i64);
        }
        Err(node.note("not whole steps", format!("`{}` must be whole steps, but comes to {steps}", node.key), ""))
    }

    fn ramp(&self, node: &Node) -> Read<Law> {
        let p = self.parameters(node, &["distance", "tick", "slowest", "fastest", "during"])?;
        let steps = p.need("distance", "distance = \"1 rev\"").and_then(|node| self.whole_steps(&node, "1 rev"));
        let tick = p.need("tick", "tick = \"8 us\"").and_then(|node| node.positive(Base::Time, 0, "8 us"));
        let count = |key: &str, example: &str| {
            // Within 1..=65 535, so it fits.
            p.need(key, example).and_then(|node| node.whole(1..=65_535, example)).map(|n| n as u32)
        };
        let slowest = count("slowest", "slowest = 255");
        let fastest = match (p.get("fastest"), self.limits.max_speed, tick) {
            // The motor's own limit, rounded up to whole ticks as the sketch does.
            (None, Some(max_speed), Ok(tick_s)) => {
                Ok((1.0 / (max_speed * tick_s) - 1e-9).ceil().clamp(1.0, 65_535.0) as u32)
            }
            (None, Some(_), Err(Noted)) => Err(Noted),
            _ => count("fastest", "fastest = 18"),
        };
        let during = p.need("during", "during = 10").and_then(|node| node.whole(0..=65_535, "during = 10"));
        let law = TimerRamp {
            steps: steps?,
            tick_s: tick?,
            start_count: slowest?,
            cruise_count: fastest?,
            accelerate_during: during? as u32,
        };
        self.made(node, Law::timer_ramp(law))
    }

    /// One of the unit that a formula's positions are in, and its steps.
    pub(super) fn position_unit(&self, node: &Node) -> Read<(Quantity, f64)> {
        let one = position_unit(node)?;
        let steps = self.steps_in(node, &one)?;
        Ok((one, steps))
    }

    /// Steps in one of a unit of position, which is used at `node`.
    pub(super) fn steps_in(&self, node: &Node, one: &Quantity) -> Read<f64> {
        let steps = one.value * self.gearing.steps_per(node, one.base)?;
        self.gearing.count(one.unit);
        Ok(steps)
    }

    fn table(&self, node: &Node) -> Read<Law> {
        let p = self.parameters(node, points::LAW_KEYS)?;
        let points = points::read(&p, std::slice::from_ref(self))?;
        Ok(points.laws(&p, |law| self.made(node, law))?.swap_remove(0))
    }

    fn winch(&self, node: &Node) -> Read<Law> {
        let p = self.parameters(node, &["axis", "commands", "file", "duration"])?;
        let axis = winch::axis(&p, self.motor);
        let duration = p.get("duration").map(|node| node.duration("5 s")).transpose();
        let commands = winch::commands(&p, self.load, axis?)?;
        self.made(node, Law::winch(&commands, crate::law::WinchSettings::default(), duration?))
    }

    /// The `law` inside a combinator.
    fn inner(&self, p: &Section, outer: &Node) -> Read<Law> {
        self.law(&p.need("law", example(outer.key))?)
    }

    fn scale(&self, node: &Node) -> Read<Law> {
        let p = self.parameters(node, &["by", "law"])?;
        let by = p.need("by", "by = 0.5").and_then(|node| node.number("by = 0.5"));
        let law = self.inner(&p, node);
        self.made(node, law?.scaled(by?))
    }

    fn shift(&self, node: &Node) -> Read<Law> {
        let p = self.parameters(node, &["by", "law"])?;
        let by = p.need("by", "by = \"90 deg\"").and_then(|node| self.gearing.steps(&node, 0, "90 deg"));
        let law = self.inner(&p, node);
        self.made(node, law?.shifted(by?))
    }

    fn delay(&self, node: &Node) -> Read<Law> {
        let p = self.parameters(node, &["by", "law"])?;
        let by = p.need("by", "by = \"100 ms\"").and_then(|node| node.time("100 ms"));
        let law = self.inner(&p, node);
        self.made(node, law?.delayed(by?))
    }

    fn repeat(&self, node: &Node) -> Read<Law> {
        let p = self.parameters(node, &["times", "law"])?;
        let times = p.need("times", "times = 3").and_then(|node| times(&node));
        let law = self.inner(&p, node);
        self.made(node, law?.repeated(times?))
    }

    /// `begin` and `end` of a motion: what to do where it starts or ends faster than the motor can.
    pub(super) fn blended(&self, motion: &Section, law: Law) -> Read<Law> {
        #[derive(Clone, Copy)]
        enum Manner {
            Delay,
            Ramp,
            RampBehind,
            Jump,
        }
        let manner =
            |key: &str, words: &[(&str, Manner)]| motion.get(key).map(|node| Ok((node.word(words)?, node))).transpose();
        let begin = manner(
            "begin",
            &[
                ("delay", Manner::Delay),
                ("ramp", Manner::Ramp),
                ("ramp-behind", Manner::RampBehind),
                ("jump", Manner::Jump),
            ],
        );
        let end = manner("end", &[("ramp", Manner::Ramp), ("ramp-behind", Manner::RampBehind), ("jump", Manner::Jump)]);
        let at_once = |key: &str| {
            format!("make the motion slower or longer, or write {key} = \"jump\" if the motor can do it at once")
        };
        // What may be written instead where a ramp does not make up for the way that it loses.
        let behind = |law: Result<Law, LawError>| {
            let behind = law.ok().and_then(|law| law.behind().last().copied())?;
            let scale = self.gearing.scale();
            Some((behind, written(behind.steps.abs() / scale.steps_per_unit, &scale.unit)))
        };
        let mut law = law;
        if let Some((manner, place)) = begin? {
            let begin = match manner {
                Manner::Delay => Begin::Delay,
                Manner::Jump => Begin::Jump,
                Manner::Ramp => {
                    let (max_speed, max_acceleration) = self.ramp_limits(&place)?;
                    Begin::Ramp { max_speed, max_acceleration }
                }
                Manner::RampBehind => {
                    let (max_speed, max_acceleration) = self.ramp_limits(&place)?;
                    Begin::RampBehind { max_speed, max_acceleration }
                }
            };
            law = law.clone().beginning(begin).map_err(|error| match begin {
                Begin::Ramp { max_speed, max_acceleration } => {
                    let help =
                        behind(law.beginning(Begin::RampBehind { max_speed, max_acceleration })).map(|(_, left)| {
                            format!(
                                "write begin = \"ramp-behind\": that does not catch up, and stays {left} behind the law"
                            )
                        });
                    place.note("cannot be followed", error.to_string(), help.unwrap_or_else(|| at_once("begin")))
                }
                Begin::RampBehind { .. } => place.note("cannot be followed", error.to_string(), at_once("begin")),
                Begin::Delay => {
                    place.note("cannot be followed", error.to_string(), "write begin = \"ramp\", or \"ramp-behind\"")
                }
                _ => refuse(&place, &error),
            })?;
        }
        if let Some((manner, place)) = end? {
            let end = match manner {
                Manner::Ramp => {
                    let (max_speed, max_acceleration) = self.ramp_limits(&place)?;
                    End::Ramp { max_speed, max_acceleration }
                }
                Manner::RampBehind => {
                    let (max_speed, max_acceleration) = self.ramp_limits(&place)?;
                    End::RampBehind { max_speed, max_acceleration }
                }
                Manner::Jump | Manner::Delay => End::Jump,
            };
            law = law.clone().ending(end).map_err(|error| match end {
                End::Ramp { max_speed, max_acceleration } => {
                    let shorter = behind(law.ending(End::RampBehind { max_speed, max_acceleration }));
                    let help = shorter.filter(|(behind, _)| behind.ends).map(|(_, left)| {
                        format!("write end = \"ramp-behind\": that makes up for nothing, and ends {left} before the law does")
                    });
                    place.note("cannot be followed", error.to_string(), help.unwrap_or_else(|| at_once("end")))
                }
                End::RampBehind { .. } => place.note("cannot be followed", error.to_string(), at_once("end")),
                End::Jump => refuse(&place, &error),
            })?;
        }
        Ok(law)
    }

    fn ramp_limits(&self, place: &Node) -> Read<(f64, f64)> {
        match (self.limits.max_speed, self.limits.max_acceleration) {
            (Some(speed), Some(acceleration)) => Ok((speed, acceleration)),
            _ => {
                let message = format!("a ramp needs limits, but motor `{}` has not both", self.motor);
                Err(place.note("needs limits", message, "give the motor max_speed and max_acceleration"))
            }
        }
    }
}

/// `period` or `frequency`, the one of them that a `what` has; with `dds`, the nearest that a phase accumulator makes.
pub(super) fn period(p: &Section, what: &str) -> Read<Time> {
    let (period, at) = match (p.get("period"), p.get("frequency")) {
        (None, Some(node)) => (node.frequency("1 Hz")?.1, node),
        (Some(_), Some(node)) => {
            let message = format!("a {what} has either a `period` or a `frequency`");
            return Err(node.note("one too many", message, "leave one of them out"));
        }
        _ => {
            let node = p.need("period", "period = \"1 s\"")?;
            (node.duration("1 s")?, node)
        }
    };
    let Some(dds) = p.get("dds") else { return Ok(period) };
    let (_, update) = dds.frequency("50 Hz")?;
    dds_period(period, update).map_err(|error| {
        let labels = vec![(at.at.clone(), "this period".to_owned()), (dds.at.clone(), "these updates".to_owned())];
        at.reader.note_all(labels, error.to_string(), "give a higher `dds`, or leave it out: then the period is exact")
    })
}

/// How often: a whole number, or "forever".
pub(super) fn times(node: &Node) -> Read<Option<u64>> {
    if let Some(text) = node.as_text() {
        return match text {
            "forever" => Ok(None),
            _ => Err(node.note("not a number", format!("`{}` must be a whole number or \"forever\"", node.key), "")),
        };
    }
    Ok(Some(node.whole(1..=i64::MAX, &format!("{} = 3, or \"forever\"", node.key))?.unsigned_abs()))
}

/// An example of a law.
fn example(name: &str) -> &'static str {
    LAWS.iter().find(|law| law.0 == name).map_or(LAWS[0].1, |law| law.1)
}

fn names() -> String {
    LAWS.iter().map(|law| law.0).collect::<Vec<_>>().join(", ")
}
