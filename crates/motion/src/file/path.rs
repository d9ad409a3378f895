//! Paths of a machine's tip: from `path.circle = { … }` to a law for each of its motors.

use super::context::{Context, Loader, refuse};
use super::laws::{self, period};
use super::machine::{MachineDraft, MachineKind};
use super::motor::{self, Gearing};
use super::points::{self, Points};
use super::problem::{BrokenPath, PathPoint};
use super::reader::{Node, Read, Section};
use crate::Time;
use crate::human;
use crate::law::extent::{Extent, farthest_beyond};
use crate::law::formula::dimension::{Parameter, Unit};
use crate::law::{Cursor, Joint, Law, LawError, Orbit, Sample, least_smoothing};
use crate::machine::Delta;
use crate::program::Limits;
use crate::quantity::{Quantity, nearest, time_assignment};

/// Every path by name, with an example.
const PATHS: &[(&str, &str)] = &[
    ("circle", "circle = { radius = \"20 mm\", period = \"4 s\", cycles = 2 }"),
    ("lorenz", "lorenz = { scale = \"1 mm\", speed = 0.5, duration = \"60 s\" }"),
    ("formula", "formula = { x = \"20*cos(t)\", y = \"20*sin(t)\", unit = \"mm\", duration = \"10 s\" }"),
    ("table", "table = { file = \"path.csv\", unit = \"mm\" }"),
    (
        "lines",
        "lines = { points = [[0, 0], [40, 0], [40, 30]], unit = \"mm\", speed = \"100 mm/s\", acceleration = \"1000 mm/s^2\" }",
    ),
];

/// The names of a tip's coordinates.
const COORDINATES: [&str; 3] = ["x", "y", "z"];

/// Joints that are no farther apart meet, steps.
const MEETS_STEPS: f64 = 1e-3;

/// A path, coordinate by coordinate: in steps of an xy machine's motors, in mm of a delta robot's effector.
struct TipPath<'a> {
    coordinates: Vec<Law>,
    form: PathForm<'a>,
}

enum PathForm<'a> {
    /// In text, with its parameters.
    Text { texts: Vec<&'a str>, parameters: Vec<Parameter>, mm_per_unit: f64, duration: Time },
    /// Polynomials; rows of a file can be pointed at.
    Polynomials { table: Option<(Node<'a>, Box<Points>)> },
    /// Laws of other kinds.
    Other,
}

/// What a path has the motors of its machine do.
pub(super) struct Joints {
    /// The law of each motor, steps.
    pub(super) laws: Vec<Law>,
    /// Where a delta robot's arms are at its end, steps.
    pub(super) end: Vec<f64>,
    /// The tip's path, mm, if it is a delta robot's, from a table, and neither repeated nor eased.
    pub(super) tip: Option<[Law; 3]>,
}

/// A machine and what its paths are read with.
pub(super) struct PathReader<'a> {
    pub(super) machine: &'a MachineDraft,
    pub(super) motors: Vec<&'a motor::MotorDraft>,
    pub(super) load: Loader<'a>,
}

impl PathReader<'_> {
    /// `path = { … }` of a motion, with its `repeat` and `ease`.
    pub(super) fn path(&self, motion: &Section, last: Option<&[f64]>) -> Read<Joints> {
        let node = motion.need("path", "path.circle = { radius = \"20 mm\", period = \"4 s\" }")?;
        for key in ["law", "begin", "end"] {
            if motion.get(key).is_some() {
                let help = if key == "law" { "leave it out" } else { "give `ease`, which keeps to the path" };
                let message = format!("a machine's motion has no `{key}`");
                return Err(motion.reader.note(motion.key_span(key), "not of a machine", message, help));
            }
        }
        let repeat = motion.get("repeat").map(|node| Ok((laws::times(&node)?, node))).transpose();
        let ease = motion.get("ease").map(|node| Ok((node.duration("0.5 s")?, node))).transpose();
        let section = node.any_section("the path".to_owned(), PATHS[0].1)?;
        let paths = section.nodes();
        let [path] = paths.as_slice() else {
            let help = format!("known: {}", names());
            return Err(node.note("not one", "a machine's motion has exactly one path", help));
        };
        let gearings = COORDINATES.map(Gearing::of_mm);
        let limits = Limits::default();
        let contexts: Vec<Context<'_>> = match self.machine.kind {
            MachineKind::Xy => self
                .motors
                .iter()
                .map(|motor| Context {
                    reader: motion.reader,
                    motor: &motor.name,
                    gearing: &motor.gearing,
                    limits: &motor.limits,
                    load: self.load,
                })
                .collect(),
            MachineKind::Delta { .. } => COORDINATES
                .iter()
                .zip(&gearings)
                .map(|(name, gearing)| Context {
                    reader: motion.reader,
                    motor: name,
                    gearing,
                    limits: &limits,
                    load: self.load,
                })
                .collect(),
        };
        let read = match path.key {
            "circle" => self.circle(&contexts, path),
            "lorenz" => self.lorenz(&contexts, path),
            "formula" => formula(&contexts, path),
            "table" => table(&contexts, path),
            "lines" => self.lines(&contexts, path),
            unknown => {
                let help = match nearest(unknown, PATHS.iter().map(|path| path.0)) {
                    Some(near) => format!("did you mean `{near}`?"),
                    None => format!("known: {}", names()),
                };
                let at = section.key_span(unknown);
                return Err(motion.reader.note(at, "not a path", format!("unknown path `{unknown}`"), help));
            }
        }?;
        let joints = match &self.machine.kind {
            MachineKind::Xy => read.coordinates.clone(),
            MachineKind::Delta { arms, .. } => self.arms(arms, path, &read)?,
        };
        let (repeat, ease) = (repeat?, ease?);
        let timed = |laws: Vec<Law>| -> Read<Vec<Law>> {
            laws.into_iter()
                .map(|mut law| {
                    if let Some((times, node)) = &repeat {
                        law = law.repeated(*times).map_err(|error| refuse(node, &error))?;
                    }
                    match &ease {
                        Some((over, node)) => law.eased(*over).map_err(|error| refuse(node, &error)),
                        None => Ok(law),
                    }
                })
                .collect()
        };
        // One cycle is enough: cycles are joined at equal speeds, or the planner refuses them.
        let eased = ease.as_ref().and_then(|(over, _)| {
            let eased = read.coordinates.iter().map(|law| law.clone().eased(*over));
            eased.collect::<Result<Vec<_>, _>>().ok()
        });
        let eased = eased.unwrap_or_default();
        self.keeps_to_limits(path, &read.coordinates, &eased)?;
        self.keeps_to_limits(path, &eased, &eased)?;
        let end = match &self.machine.kind {
            MachineKind::Delta { angles, .. } => {
                self.arms_fit(motion, path, &joints, *angles, repeat.is_some(), last)?
            }
            MachineKind::Xy => Vec::new(),
        };
        let is_recording = matches!(self.machine.kind, MachineKind::Delta { .. })
            && matches!(read.form, PathForm::Polynomials { table: Some(_) })
            && repeat.is_none()
            && ease.is_none();
        let tip = if is_recording { read.coordinates.clone().try_into().ok() } else { None };
        let mut laws = timed(joints)?;
        if let MachineKind::Delta { arms, .. } = &self.machine.kind
            && let Ok(tip) = <[Law; 3]>::try_from(timed(read.coordinates)?)
        {
            // The arms' laws, with the path that they have in common: where it changes, the effector stays on a path.
            let arm = |(arm, law): (usize, Law)| {
                law.of_arm(Joint::new(*arms, arm, self.motors[arm].gearing.steps_per_rad()), tip.clone())
            };
            laws = laws.into_iter().enumerate().map(arm).collect();
        }
        Ok(Joints { laws, end, tip })
    }

    /// Lorenz's and DDS's figures are of two motors that move along their own axes.
    fn xy_only(&self, path: &Node) -> Read<()> {
        match self.machine.kind {
            MachineKind::Xy => Ok(()),
            MachineKind::Delta { .. } => {
                let message = format!("`{}` is a path of xy machines", path.key);
                Err(path.note("not of a delta robot", message, "a delta robot has formula, table and lines"))
            }
        }
    }

    fn circle<'a>(&self, contexts: &[Context<'_>], node: &Node<'a>) -> Read<TipPath<'a>> {
        self.xy_only(node)?;
        let p = parameters(node, &["radius", "period", "frequency", "cycles", "dds"])?;
        let period = period(&p, "circle");
        let cycles = p.get("cycles").map_or(Ok(Some(1)), |node| laws::times(&node));
        let radius = p.need("radius", "radius = \"20 mm\"")?;
        let radii: Read<Vec<f64>> = contexts
            .iter()
            .map(|context| {
                let steps = context.gearing.steps(&radius, 0, "20 mm")?;
                radius.above_zero(steps)
            })
            .collect();
        let (period, cycles) = (period?, cycles?);
        let laws = radii?.into_iter().enumerate().map(|(k, radius)| Law::circle(radius, period, cycles, k));
        Ok(TipPath { coordinates: made(node, laws)?, form: PathForm::Other })
    }

    fn lorenz<'a>(&self, contexts: &[Context<'_>], node: &Node<'a>) -> Read<TipPath<'a>> {
        self.xy_only(node)?;
        let known = ["sigma", "rho", "beta", "start", "axes", "scale", "speed", "duration"];
        let p = parameters(node, &known)?;
        let number =
            |key: &str, without: f64| p.get(key).map_or(Ok(without), |node| node.number(&format!("{key} = {without}")));
        let classic = Orbit::CLASSIC;
        let (sigma, rho, beta) =
            (number("sigma", classic.sigma), number("rho", classic.rho), number("beta", classic.beta));
        let start = p.get("start").map_or(Ok(classic.start), |node| {
            const EXAMPLE: &str = "start = [1, 1, 25]";
            match node.list(EXAMPLE)?.as_slice() {
                [x, y, z] => Ok([x.number(EXAMPLE)?, y.number(EXAMPLE)?, z.number(EXAMPLE)?]),
                _ => Err(node.note("three numbers", "`start` must list three numbers: x, y and z", EXAMPLE)),
            }
        });
        let axes = p.get("axes").map_or(Ok([0, 2]), |node| {
            const EXAMPLE: &str = "axes = [\"x\", \"z\"]";
            match node.list(EXAMPLE)?.as_slice() {
                [a, b] => {
                    let words = [("x", 0), ("y", 1), ("z", 2)];
                    Ok([a.word(&words)?, b.word(&words)?])
                }
                _ => Err(node.note(
                    "two of x, y, z",
                    "`axes` must list two: what the first and the second motor draw",
                    EXAMPLE,
                )),
            }
        });
        let scale = p.need("scale", "scale = \"1 mm\"").and_then(|node| {
            contexts
                .iter()
                .map(|context| {
                    let steps = context.gearing.steps(&node, 0, "1 mm")?;
                    node.above_zero(steps)
                })
                .collect::<Read<Vec<f64>>>()
        });
        let speed = p.get("speed").map_or(Ok(1.0), |node| {
            let speed = node.number("speed = 0.5")?;
            node.above_zero(speed)
        });
        let duration = p.get("duration").map(|node| node.duration("60 s")).transpose();
        let orbit = Orbit { sigma: sigma?, rho: rho?, beta: beta?, start: start? };
        let (axes, speed, duration) = (axes?, speed?, duration?);
        let laws = scale?.into_iter().zip(axes).map(|(scale, axis)| Law::lorenz(orbit, axis, scale, speed, duration));
        Ok(TipPath { coordinates: made(node, laws)?, form: PathForm::Other })
    }

    /// Straight lines from rest to rest.
    fn lines<'a>(&self, contexts: &[Context<'_>], node: &Node<'a>) -> Read<TipPath<'a>> {
        let p = parameters(node, &["points", "unit", "speed", "acceleration", "pause"])?;
        let mm = p.need("unit", "unit = \"mm\"").and_then(|node| mm_per_unit(&node));
        let limit = |key: &str, per_seconds, of_machine: Option<f64>, example| match (p.get(key), of_machine) {
            (None, Some(limit)) => Ok(limit),
            _ => p
                .need(key, &format!("{key} = \"{example}\""))
                .and_then(|node| node.positive(crate::quantity::Base::Length, per_seconds, example)),
        };
        let speed = limit("speed", 1, self.machine.max_speed, "100 mm/s");
        let acceleration = limit("acceleration", 2, self.machine.max_acceleration, "1000 mm/s^2");
        let pause = p.get("pause").map(|node| node.duration("200 ms")).transpose();
        let steps_per_mm: Vec<f64> = contexts
            .iter()
            .map(|context| {
                context.gearing.steps_per_mm().ok_or_else(|| {
                    let message = format!("motor `{}` has no `lead`: lines are in mm", context.motor);
                    node.note("needs lengths", message, "give the motor a `lead`; or write a formula or a table")
                })
            })
            .collect::<Read<_>>()?;
        const EXAMPLE: &str = "points = [[0, 0, -140], [40, 0, -140]]";
        let points = p.need("points", EXAMPLE)?;
        let list = points.list(EXAMPLE)?;
        if list.len() < 2 {
            return Err(points.note(
                "too few",
                format!("lines need two points at least, but there are {}", list.len()),
                "",
            ));
        }
        let (mm, speed, acceleration, pause) = (mm?, speed?, acceleration?, pause?);
        let mut corners: Vec<Vec<f64>> = Vec::new();
        for point in &list {
            let numbers = point.list(EXAMPLE)?;
            if numbers.len() != contexts.len() {
                let (wanted, found) = (contexts.len(), numbers.len());
                return Err(point.note(
                    "not a point",
                    format!("a point of this machine is {wanted} numbers, but this has {found}"),
                    "",
                ));
            }
            let corner = numbers.iter().map(|node| Ok(node.number(EXAMPLE)? * mm)).collect::<Read<Vec<f64>>>()?;
            if corners.last() == Some(&corner) {
                return Err(point.note(
                    "the same",
                    "this is the point before it",
                    "leave it out; to wait there, give `pause`",
                ));
            }
            if let MachineKind::Delta { arms, .. } = &self.machine.kind {
                self.reaches(arms, &corner).map_err(|why| point.note("out of reach", why, WITHIN_REACH))?;
            }
            corners.push(corner);
        }
        let law = |k: usize| -> Result<Law, LawError> {
            let mut laws = Vec::new();
            for ends in corners.windows(2) {
                let distance = ends[0].iter().zip(&ends[1]).map(|(a, b)| (b - a) * (b - a)).sum::<f64>().sqrt();
                let part = (ends[1][k] - ends[0][k]) / distance;
                laws.push(Law::trapezoid(distance, speed, acceleration, acceleration)?.scaled(part * steps_per_mm[k])?);
                if let Some(pause) = pause {
                    laws.push(Law::rest(pause)?);
                }
            }
            Law::then(laws)?.shifted(corners[0][k] * steps_per_mm[k])
        };
        let coordinates = made(node, (0..contexts.len()).map(law))?;
        Ok(TipPath { coordinates, form: PathForm::Polynomials { table: None } })
    }

    /// What each arm of a delta robot does while its effector follows a path.
    fn arms(&self, robot: &Delta, node: &Node, path: &TipPath<'_>) -> Read<Vec<Law>> {
        let steps_per_rad = |arm: usize| self.motors[arm].gearing.steps_per_rad();
        let laws = match &path.form {
            PathForm::Text { texts, parameters, mm_per_unit, duration } => {
                // Lengths are in the formula's own unit, so that its parameters keep their values.
                let robot = robot.in_unit(*mm_per_unit);
                // What its coordinates measure has been looked at; the robot's lengths in the text are plain numbers.
                let parameters: Vec<Parameter> = parameters.iter().map(Parameter::without_dimension).collect();
                let law = |arm| {
                    let text = robot.formula(arm, [texts[0], texts[1], texts[2]]);
                    Law::formula_in(&text, &parameters, &Unit::plain(steps_per_rad(arm)), Some(*duration))
                        .map_err(|error| LawError::Parameter(error.message))
                };
                made(node, (0..3).map(law))?
            }
            PathForm::Polynomials { table } => {
                if let Some((file, points)) = table {
                    for (row, point) in points.positions().enumerate() {
                        self.reaches(robot, &point)
                            .map_err(|why| points.wrong(file, row, "out of reach", why, WITHIN_REACH))?;
                    }
                }
                let [x, y, z] = path.coordinates.as_slice() else {
                    return Err(node.note("three", "a delta robot's path has three coordinates", ""));
                };
                let tip = [x.clone(), y.clone(), z.clone()];
                made(node, (0..3).map(|arm| Law::delta_arm(robot, arm, &tip, steps_per_rad(arm))))?
            }
            PathForm::Other => return Err(node.note("not here", "a delta robot cannot follow this path", "")),
        };
        // All of it is looked at, in enclosures: where an arm does not reach, its law has no value.
        for law in &laws {
            if let Some(error) = broken(law) {
                let LawError::Undefined { at_s, .. } = error else { return Err(refuse(node, &error)) };
                // The enclosures end just before the limit: a little further on is beyond it.
                let why = [0.0, 1e-9, 1e-6, 1e-3].into_iter().find_map(|later| {
                    let at = Time::from_seconds(at_s + later);
                    let point = |law: &Law| Cursor::new(law).at(at).map(|sample| sample.position);
                    let point = path.coordinates.iter().map(point).collect::<Result<Vec<f64>, _>>().ok()?;
                    self.reaches(robot, &point).err()
                });
                return Err(match why {
                    Some(why) => {
                        let mut cursors: Vec<Cursor> = path.coordinates.iter().map(Cursor::new).collect();
                        let tip = |at: Time| {
                            let tip = cursors.iter_mut().map(|cursor| Some(cursor.at(at).ok()?.position));
                            Some((tip.collect::<Option<Vec<f64>>>()?, None))
                        };
                        let shown = self.broken_path(at_s, law_end(&path.coordinates), None, None, tip);
                        node.note_path("leaves the workspace", format!("at {at_s:.6} s {why}"), WITHIN_REACH, shown)
                    }
                    None => refuse(node, &error),
                });
            }
        }
        Ok(laws)
    }

    /// Whether the effector can be at a point, mm; else what is wrong.
    fn reaches(&self, robot: &Delta, point: &[f64]) -> Result<(), String> {
        let &[x, y, z] = point else { return Ok(()) };
        let error = match robot.angles([x, y, z]) {
            Ok(_) => return Ok(()),
            Err(error) => error,
        };
        let who = match error.arm() {
            Some(arm) => format!(" for arm `{}`", self.motors[arm].name),
            None => String::new(),
        };
        Err(format!("the effector cannot be at ({x:.3}, {y:.3}, {z:.3}) mm{who}: {error}"))
    }

    /// Checks the tip's speed and acceleration against the machine's limits. `eased` is the motion with its eased
    /// beginning and end, if that is another one.
    fn keeps_to_limits(&self, node: &Node, coordinates: &[Law], eased: &[Law]) -> Read<()> {
        if coordinates.iter().any(|law| law.end().is_none()) {
            let limited = self.machine.max_speed.is_some() || self.machine.max_acceleration.is_some();
            if limited {
                let message = "a machine with max_speed or max_acceleration needs paths that end";
                return Err(node.note("endless", message, "give a duration or cycles; `repeat` may be \"forever\""));
            }
            return Ok(());
        }
        let (terms, eased) = (self.in_mm(coordinates), self.in_mm(eased));
        let limits = [
            (
                Extent::Speed,
                self.machine.max_speed,
                "speed",
                "mm/s",
                "slow the path down, or raise the machine's max_speed",
            ),
            (
                Extent::Acceleration,
                self.machine.max_acceleration,
                "acceleration",
                "mm/s²",
                "slow the path down, or raise the machine's max_acceleration",
            ),
        ];
        for (extent, limit, what, unit, help) in limits {
            let Some(limit) = limit else { continue };
            let beyond = farthest_beyond(&terms, extent, limit).map_err(|error| refuse(node, &error))?;
            if let Some((at, value)) = beyond {
                let place: Vec<String> = terms
                    .iter()
                    .filter_map(|(law, mm)| Some(format!("{:.3}", Cursor::new(law).at(at).ok()?.position * mm)))
                    .collect();
                let message = format!(
                    "the tip's {what} is {value:.1} {unit} at its highest, at {:.6} s, at ({}) mm; limit {limit:.1} {unit}",
                    at.seconds(),
                    place.join(", "),
                );
                let mut cursors: Vec<(Cursor, f64)> =
                    terms.iter().map(|(law, scale)| (Cursor::new(law), *scale)).collect();
                let look = |at: Time| {
                    let samples = cursors.iter_mut().map(|(cursor, scale)| Some((cursor.at(at).ok()?, *scale)));
                    let samples = samples.collect::<Option<Vec<_>>>()?;
                    let square = |(sample, scale): &(Sample, f64)| {
                        let value = if extent == Extent::Speed { sample.speed } else { sample.acceleration };
                        (value * scale) * (value * scale)
                    };
                    let value = samples.iter().map(square).sum::<f64>().sqrt();
                    Some((samples.into_iter().map(|(sample, scale)| sample.position * scale).collect(), Some(value)))
                };
                // The other limit may ask for more, and so may the beginning and the end.
                let slower = limits.iter().try_fold(1.0, |slowest: f64, (extent, limit, ..)| {
                    let Some(limit) = *limit else { return Some(slowest) };
                    let slower = [&terms, &eased].map(|laws| slowdown(laws, *extent, limit));
                    Some(slowest.max(slower[0]?).max(slower[1]?))
                });
                let limit = Some((format!("the tip's {what}"), unit, limit));
                let shown = self.broken_path(at.seconds(), law_end(coordinates), limit, slower, look);
                let help = match self.smoothing(coordinates) {
                    Some(smooth) => format!("{smooth}; or {help}"),
                    None => help.to_owned(),
                };
                return Err(node.note_path("too fast", message, &help, shown));
            }
        }
        Ok(())
    }

    /// Each coordinate's law, and the millimetres in one of its units.
    fn in_mm<'l>(&self, laws: &'l [Law]) -> Vec<(&'l Law, f64)> {
        let mm_per_step = |k: usize| match self.machine.kind {
            MachineKind::Xy => 1.0 / self.motors[k].gearing.steps_per_mm().unwrap_or(f64::INFINITY),
            MachineKind::Delta { .. } => 1.0,
        };
        laws.iter().enumerate().map(|(k, law)| (law, mm_per_step(k))).collect()
    }

    /// The smoothing with which the tip keeps to the machine's limits, if the path comes from a table.
    fn smoothing(&self, coordinates: &[Law]) -> Option<String> {
        let limits = [(Extent::Speed, self.machine.max_speed), (Extent::Acceleration, self.machine.max_acceleration)];
        let keeps_to = |laws: &[Law]| {
            limits.into_iter().all(|(extent, limit)| {
                limit.is_none_or(|limit| farthest_beyond(&self.in_mm(laws), extent, limit) == Ok(None))
            })
        };
        let laws: Vec<&Law> = coordinates.iter().collect();
        let (over, laws) = least_smoothing(&laws, |laws| Some(keeps_to(laws)))?;
        let off =
            self.in_mm(&laws).into_iter().flat_map(|(law, mm)| law.tables().into_iter().map(move |table| (table, mm)));
        let off = off.map(|(table, mm)| table.distance().largest * mm).fold(0.0, f64::max);
        let (smooth, off) = (time_assignment("smooth", over.seconds()), human::significant(off, 2));
        Some(format!("write {smooth} in the table: smoothed it fits, at most {off} mm from the recording"))
    }

    /// The machine, and its path around the place where it breaks a limit: twice as much after it as before. `look` gives the tip at a time,
    /// and what the limit is of.
    fn broken_path(
        &self,
        at_s: f64,
        end: Option<Time>,
        limit: Option<(String, &'static str, f64)>,
        slower: Option<f64>,
        mut look: impl FnMut(Time) -> Option<(Vec<f64>, Option<f64>)>,
    ) -> BrokenPath {
        const POINTS: u32 = 9;
        let end_s = end.map_or(at_s * 2.0, Time::seconds);
        let span = (0.1 * end_s).min(at_s.max(0.01 * end_s));
        let (from, to) = ((at_s - span).max(0.0), (at_s + 2.0 * span).min(end_s));
        let times = (0..POINTS).map(|k| from + (to - from) * f64::from(k) / f64::from(POINTS - 1));
        let mut times: Vec<f64> = times.chain([at_s]).collect();
        times.sort_by(f64::total_cmp);
        times.dedup();
        let points = times.into_iter().filter_map(|at_s| {
            let (tip, value) = look(Time::from_seconds(at_s))?;
            Some(PathPoint { at_s, tip, value })
        });
        let motors: Vec<&str> = self.motors.iter().map(|motor| motor.name.as_str()).collect();
        let motors = motors.join(", ");
        let is = match &self.machine.kind {
            MachineKind::Xy => format!("an xy machine, motors {motors}"),
            MachineKind::Delta { arms, angles } => {
                let Delta { base_mm, upper_arm_mm, forearm_mm, effector_mm } = arms;
                let angles = angles.map_or_else(String::new, |(least, most)| {
                    format!(", arms from {:.1}° to {:.1}°", least.to_degrees(), most.to_degrees())
                });
                format!(
                    "a delta robot, motors {motors}: base {base_mm} mm, upper arms {upper_arm_mm} mm, forearms {forearm_mm} mm, effector \
                     {effector_mm} mm{angles}"
                )
            }
        };
        BrokenPath { machine: self.machine.name.clone(), is, at_s, limit, slower, points: points.collect() }
    }

    /// Angles within their limits; and what follows begins where the arms are. Gives where they are at the end, steps.
    fn arms_fit(
        &self,
        motion: &Section,
        node: &Node,
        joints: &[Law],
        angles: Option<(f64, f64)>,
        repeated: bool,
        last: Option<&[f64]>,
    ) -> Read<Vec<f64>> {
        let mut last_steps = Vec::new();
        for (arm, law) in joints.iter().enumerate() {
            let (name, per_rad) = (&self.motors[arm].name, self.motors[arm].gearing.steps_per_rad());
            let degrees = |steps: f64| (steps / per_rad).to_degrees();
            let [first, end] = ends(law).map_err(|error| refuse(node, &error))?;
            last_steps.push(end);
            if repeated && (end - first).abs() > MEETS_STEPS {
                let off = degrees(end - first);
                let message =
                    format!("the path does not end where it begins: arm `{name}` is {off:.3}° off, each time more");
                let help = "close the path, or leave `repeat` out";
                return Err(motion.reader.note(motion.key_span("repeat"), "not closed", message, help));
            }
            if let Some(before) = last.and_then(|last| last.get(arm)).filter(|last| (*last - first).abs() > MEETS_STEPS)
            {
                let message = format!(
                    "this path does not begin where the one before ends: arm `{name}` is at {:.3}° then, and {:.3}° is wanted",
                    degrees(*before),
                    degrees(first)
                );
                return Err(node.note("begins elsewhere", message, "begin it at the last point of the path before"));
            }
            let Some((least, most)) = angles else { continue };
            for (sign, limit) in [(1.0, most), (-1.0, -least)] {
                let beyond = farthest_beyond(&[(law, sign / per_rad)], Extent::Value, limit);
                if let Some((at, value)) = beyond.map_err(|error| refuse(node, &error))? {
                    let degrees = |rad: f64| (sign * rad).to_degrees();
                    let message = format!(
                        "arm `{name}` would be at {:.1}° at {:.6} s, its farthest; limit {:.1}°",
                        degrees(value),
                        at.seconds(),
                        degrees(limit)
                    );
                    let mut cursors: Vec<Cursor> = joints.iter().map(Cursor::new).collect();
                    let look = |at: Time| {
                        let MachineKind::Delta { arms, .. } = &self.machine.kind else { return None };
                        let mut rad = [0.0; 3];
                        for ((rad, cursor), motor) in rad.iter_mut().zip(&mut cursors).zip(&self.motors) {
                            *rad = cursor.at(at).ok()?.position / motor.gearing.steps_per_rad();
                        }
                        Some((arms.point(rad)?.to_vec(), Some(rad[arm].to_degrees())))
                    };
                    let limit = Some((format!("the angle of arm `{name}`"), "°", degrees(limit)));
                    let shown = self.broken_path(at.seconds(), law_end(joints), limit, None, look);
                    return Err(node.note_path("beyond `angles`", message, WITHIN_REACH, shown));
                }
            }
        }
        Ok(last_steps)
    }
}

const WITHIN_REACH: &str = "keep the path within what the arms reach";

/// Pieces of a delta robot's path, at most: all are looked at before anything moves.
const MOST_PIECES: usize = 1 << 18;

/// What breaks in a law that ends, if anything does.
fn broken(law: &Law) -> Option<LawError> {
    let too_long =
        || LawError::Parameter(format!("the path has more than {MOST_PIECES} parts: too long to be checked"));
    law.pieces().enumerate().find_map(|(k, piece)| piece.err().or_else(|| (k >= MOST_PIECES).then(too_long)))
}

/// The factor by which the laws must be slower to keep a limit; 1 if they keep it already, or there is none; `None` if
/// it cannot be found.
fn slowdown(laws: &[(&Law, f64)], extent: Extent, limit: f64) -> Option<f64> {
    let Some((_, value)) = farthest_beyond(laws, extent, limit).ok()? else { return Some(1.0) };
    // The worst is known to a thousandth.
    let over = value * 1.001 / limit;
    // Accelerations fall with the square of the time that it takes.
    Some(if extent == Extent::Speed { over } else { over.sqrt() }).filter(|factor| factor.is_finite())
}

/// When the last of some laws ends, if all do.
fn law_end(laws: &[Law]) -> Option<Time> {
    laws.iter().map(Law::end).collect::<Option<Vec<Time>>>()?.into_iter().max()
}

/// Where a law begins and ends, steps.
fn ends(law: &Law) -> Result<[f64; 2], LawError> {
    let mut cursor = Cursor::new(law);
    let first = cursor.at(Time::ZERO)?.position;
    Ok([first, law.end().map_or(Ok(first), |end| cursor.at(end).map(|sample| sample.position))?])
}

fn formula<'a>(contexts: &[Context<'_>], node: &Node<'a>) -> Read<TipPath<'a>> {
    let names = &COORDINATES[..contexts.len()];
    let known = [names, &["unit", "duration", "where"]].concat();
    let p = parameters(node, &known)?;
    let unit = p.need("unit", "unit = \"mm\"");
    let duration = p.get("duration").map(|node| node.duration("10 s")).transpose();
    let is_delta = contexts.len() == 3;
    if is_delta {
        p.need("duration", "duration = \"10 s\"")?;
    }
    let (unit, duration) = (unit?, duration?);
    let (mut coordinates, mut texts, mut parameters, mut scale) = (Vec::new(), Vec::new(), Vec::new(), 1.0);
    for (name, context) in names.iter().zip(contexts) {
        let text = p.need(name, &format!("{name} = \"20*cos(2*pi*t)\""))?;
        let unit = context.formula_unit(&unit)?;
        scale = unit.steps;
        parameters = match p.get("where") {
            Some(node) => context.formula_parameters(&node, &unit)?,
            None => Vec::new(),
        };
        let written = text.text(&format!("{name} = \"20*cos(2*pi*t)\""))?;
        let law = context.formula_of(&text, written, &parameters, &unit, duration)?;
        // Where it is undefined or jumps is an error here, in terms of the coordinate.
        if is_delta && let Some(error) = broken(&law) {
            return Err(refuse(&text, &error));
        }
        coordinates.push(law);
        texts.push(written);
    }
    let form = match duration {
        Some(duration) => PathForm::Text { texts, parameters, mm_per_unit: scale, duration },
        None => PathForm::Other,
    };
    Ok(TipPath { coordinates, form })
}

fn table<'a>(contexts: &[Context<'_>], node: &Node<'a>) -> Read<TipPath<'a>> {
    let p = parameters(node, points::KEYS)?;
    let file = p.need("file", "file = \"path.csv\"")?;
    let points = points::read(&p, contexts)?;
    let coordinates = points.laws(&p, |law| Ok(made(node, [law].into_iter())?.swap_remove(0)))?;
    Ok(TipPath { coordinates, form: PathForm::Polynomials { table: Some((file, Box::new(points))) } })
}

/// Millimetres in a unit of length.
fn mm_per_unit(node: &Node) -> Read<f64> {
    let text = node.text("unit = \"mm\"")?;
    let one = Quantity::parse(&format!("1 {text}")).ok();
    match one.filter(|one| one.base == crate::quantity::Base::Length && one.per_seconds == 0) {
        Some(one) => Ok(one.value),
        None => Err(node.note(
            "not a length",
            format!("`unit` must be a unit of length, but is \"{text}\""),
            "one of: mm, cm, m",
        )),
    }
}

fn parameters<'a>(node: &Node<'a>, known: &[&str]) -> Read<Section<'a>> {
    let example = PATHS.iter().find(|path| path.0 == node.key).map_or(PATHS[0].1, |path| path.1);
    node.section(format!("path `{}`", node.key), known, example)
}

/// What constructors made of the parameters at `node`.
fn made(node: &Node, laws: impl Iterator<Item = Result<Law, LawError>>) -> Read<Vec<Law>> {
    laws.map(|law| law.map_err(|error| node.note("cannot be followed", format!("path `{}`: {error}", node.key), "")))
        .collect()
}

fn names() -> String {
    PATHS.iter().map(|path| path.0).collect::<Vec<_>>().join(", ")
}
