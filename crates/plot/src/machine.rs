//! The figure that a machine draws, by the law and by the steps, and the distance between the two.
//!
//! Between two steps a motor stands while the law goes on. So errors are largest just before or just after a step, and
//! are measured there. A motor with backlash moves the tip only after its slack is used up.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::fmt::{self, Display};

use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::machine::{Kinematics, Machine};
use pulsetrain_motion::program::Program;
use pulsetrain_motion::{Law, Time, human};
use schemars::JsonSchema;
use serde::Serialize;

use crate::FigurePicture;

/// The largest errors of a machine's figure.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct FigureReport {
    /// The machine's name in the motion file.
    pub machine: String,
    /// The unit of the tip's coordinates.
    pub unit: String,
    /// Largest |θ − position| of any of its motors, steps.
    pub motor_steps: f64,
    /// Largest distance of the tip from the law's point of the same time, units.
    pub tip: f64,
    /// Largest distance of the tip from the law's figure at any time, units. Of a circle this is the radial error.
    pub off_figure: f64,
    /// Steps in a unit, of an xy machine whose motors agree.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps_per_unit: Option<f64>,
}

impl Display for FigureReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let FigureReport { machine, unit, motor_steps, tip, off_figure, steps_per_unit } = self;
        let length = |units: f64| {
            let steps = steps_per_unit
                .filter(|_| unit != "step")
                .map_or_else(String::new, |steps| format!("{} steps = ", human::significant(units * steps, 3)));
            format!("{steps}{} {}", human::significant(units, 3), human::unit(unit))
        };
        writeln!(
            f,
            "  figure of {machine}: off the wanted one by {} at most, by {} from where it is wanted then,",
            length(*off_figure),
            length(*tip)
        )?;
        writeln!(f, "  each motor by {} steps", human::significant(*motor_steps, 3))
    }
}

/// The laws of a program's machines for what the motors drive: without the extra way that uses up slack.
#[derive(Clone, Debug)]
pub struct Drawn(Vec<Option<Vec<Law>>>);

impl Drawn {
    /// The laws of each machine. `None` if path and slack cannot be separated.
    #[must_use]
    pub fn of(program: &Program) -> Drawn {
        let law = |motor: &usize| program.motors[*motor].law.without_backlash();
        Drawn(program.machines.iter().map(|machine| machine.motors.iter().map(law).collect()).collect())
    }
}

/// Measures a machine while it runs.
pub struct Figure<'a> {
    machine: &'a Machine,
    /// Steps that were reported, the earliest first. Boards report them motor by motor and stretch by stretch.
    waiting: BinaryHeap<Reverse<Step>>,
    /// The state of each of its motors. Empty if path and slack cannot be separated.
    joints: Vec<Joint>,
    worst: Worst,
    stepped: Trail,
    /// Time, s, and place of the tip, near the beginning.
    close: VecDeque<(f64, [f64; 3])>,
    tick_s: f64,
    /// When the laws end, s; infinite if one has no end.
    end_s: f64,
    /// The time of the last step, s.
    last_s: f64,
}

/// A step: its tick, the index of the motor in the machine, and the motor's position after it.
type Step = (u64, usize, i64);

/// Steps that may wait for earlier steps of other motors. Boards report far fewer of one motor at a time.
const MOST_WAITING: usize = 1 << 21;

/// One motor of the machine.
struct Joint {
    cursor: Cursor,
    /// θ at time zero, steps.
    start: f64,
    slack: f64,
    /// The direction of the first step, ±1.
    first: f64,
    position: f64,
    steps: u64,
    /// Position of what the motor drives, steps.
    drawn: f64,
}

#[derive(Default)]
struct Worst {
    motor_steps: f64,
    tip: f64,
    off_figure: f64,
}

/// Number of points of the law's figure.
const WANTED_POINTS: u32 = 6000;
/// Number of steps in the close view.
const CLOSE_STEPS: usize = 60;
/// Number of steps in the close view at most, until each motor has stepped twice.
const CLOSE_BEFORE: usize = 16;
/// Number of points of the law's figure in the close view.
const CLOSE_POINTS: u32 = 600;

impl<'a> Figure<'a> {
    /// One for each of the program's machines, before the first step.
    pub fn all(program: &'a Program, drawn: &'a Drawn) -> Vec<Figure<'a>> {
        let machines = program.machines.iter().zip(&drawn.0);
        machines.map(|(machine, laws)| Figure::new(program, machine, laws.as_deref().unwrap_or_default())).collect()
    }

    fn new(program: &'a Program, machine: &'a Machine, laws: &'a [Law]) -> Figure<'a> {
        let joint = |(law, slack): (&Law, &f64)| {
            let mut cursor = Cursor::new(law);
            let start = cursor.at(Time::ZERO).ok()?.position;
            Some(Joint { cursor, start, slack: *slack, first: 0.0, position: 0.0, steps: 0, drawn: 0.0 })
        };
        let joints: Option<Vec<Joint>> = laws.iter().zip(&machine.slack).map(joint).collect();
        let ends = machine.motors.iter().map(|motor| program.motors[*motor].law.end());
        let end_s = ends.map(|end| end.map_or(f64::INFINITY, Time::seconds)).fold(0.0, f64::max);
        let mut figure = Figure {
            machine,
            waiting: BinaryHeap::new(),
            tick_s: 1.0 / program.board.tick_hz as f64,
            joints: joints.unwrap_or_default(),
            worst: Worst::default(),
            stepped: Trail::default(),
            close: VecDeque::new(),
            end_s,
            last_s: 0.0,
        };
        if let Some(tip) = figure.drawn() {
            figure.stepped.push(tip);
            figure.close.push_back((0.0, tip));
        }
        figure
    }

    /// Takes a step: at `tick` the program's motor `motor` went to `position`.
    pub fn step(&mut self, motor: usize, tick: u64, position: i64) {
        let Some(k) = self.machine.motors.iter().position(|own| *own == motor) else { return };
        if self.joints.is_empty() {
            return;
        }
        self.waiting.push(Reverse((tick, k, position)));
        if self.waiting.len() > MOST_WAITING {
            self.go_on(MOST_WAITING / 2);
        }
    }

    /// Makes the earliest steps until `left` are waiting. Steps of one tick are one move of the tip.
    fn go_on(&mut self, left: usize) {
        while self.waiting.len() > left
            && let Some(Reverse((tick, k, position))) = self.waiting.pop()
        {
            let t = tick as f64 * self.tick_s;
            self.last_s = t;
            self.measure(t);
            self.joints[k].go_to(position as f64);
            while let Some(&Reverse((same, k, position))) = self.waiting.peek()
                && same == tick
            {
                self.joints[k].go_to(position as f64);
                self.waiting.pop();
            }
            self.measure(t);
            let Some(tip) = self.drawn() else { continue };
            self.stepped.push(tip);
            if self.close.len() <= CLOSE_STEPS {
                self.close.push_back((t, tip));
                // A single motor's steps are no figure: the view begins a little before all motors have stepped.
                if self.close.len() > CLOSE_BEFORE && self.joints.iter().any(|joint| joint.steps < 2) {
                    self.close.pop_front();
                }
            }
        }
    }

    /// The place of the tip by the steps.
    fn drawn(&self) -> Option<[f64; 3]> {
        self.machine.tip(&self.joints.iter().map(|joint| joint.drawn).collect::<Vec<f64>>())
    }

    /// The position of each motor by the law, and the place of the tip with it.
    fn wanted(&mut self, t: f64) -> Option<(Vec<f64>, [f64; 3])> {
        let at = Time::from_seconds(t.clamp(0.0, self.end_s));
        let steps = self.joints.iter_mut().map(|joint| Some(joint.cursor.at(at).ok()?.position - joint.start));
        let steps = steps.collect::<Option<Vec<f64>>>()?;
        let tip = self.machine.tip(&steps)?;
        Some((steps, tip))
    }

    fn measure(&mut self, t: f64) {
        let (Some((steps, tip)), Some(drawn)) = (self.wanted(t), self.drawn()) else { return };
        for (wanted, joint) in steps.into_iter().zip(&self.joints) {
            self.worst.motor_steps = self.worst.motor_steps.max((wanted - joint.drawn).abs());
        }
        let off = distance(tip, drawn);
        self.worst.tip = self.worst.tip.max(off);
        if off > self.worst.off_figure {
            self.worst.off_figure = self.worst.off_figure.max(self.nearest(t, tip, drawn));
        }
    }

    /// The distance of `drawn` from the law's figure near its point `tip` of time `t`, by Newton's method along the
    /// tangent.
    fn nearest(&mut self, t: f64, tip: [f64; 3], drawn: [f64; 3]) -> f64 {
        /// The time over which the tangent is taken, s. Positions are exact to some 1e-12, so the tangent is, to some 1e-7.
        const ASIDE_S: f64 = 1e-5;
        let (mut at, mut here, mut least) = (t, tip, distance(tip, drawn));
        for _ in 0..4 {
            let Some((_, ahead)) = self.wanted(at + ASIDE_S) else { break };
            let along = minus(ahead, here);
            let square = dot(along, along);
            let to = at + ASIDE_S * dot(minus(drawn, here), along) / square;
            // At rest there is no tangent, and far away from the point the figure may have turned.
            if !to.is_finite() || (to - t).abs() > 0.05 {
                break;
            }
            let Some((_, next)) = self.wanted(to) else { break };
            (at, here) = (to, next);
            least = least.min(distance(here, drawn));
        }
        least
    }

    /// The errors of the figure, and its picture. `None` if path and slack cannot be separated.
    pub fn finish(mut self) -> Option<(FigureReport, FigurePicture)> {
        self.go_on(0);
        let end_s = if self.end_s.is_finite() { self.end_s } else { self.last_s };
        let (begin, until) = (self.close.front().map_or(0.0, |p| p.0), self.close.back().map_or(0.0, |p| p.0));
        let mut sample = |from: f64, to: f64, points: u32| {
            let at = |k: u32| from + (to - from) * f64::from(k) / f64::from(points);
            (0..=points).filter_map(|k| Some(self.wanted(at(k))?.1)).collect::<Vec<_>>()
        };
        let wanted = sample(0.0, end_s, WANTED_POINTS);
        // The cursor goes only forward, so a new one begins here.
        let close_wanted = sample(begin, until, CLOSE_POINTS);
        let steps_per_unit = match &self.machine.kinematics {
            Kinematics::Xy { steps_per_unit: [x, y] } if x == y => Some(*x),
            _ => None,
        };
        if wanted.is_empty() {
            return None;
        }
        let report = FigureReport {
            machine: self.machine.name.clone(),
            unit: self.machine.unit.clone(),
            motor_steps: self.worst.motor_steps,
            tip: self.worst.tip,
            off_figure: self.worst.off_figure,
            steps_per_unit,
        };
        let picture = FigurePicture {
            name: self.machine.name.clone(),
            unit: self.machine.unit.clone(),
            in_space: matches!(self.machine.kinematics, Kinematics::Delta { .. }),
            wanted,
            stepped: self.stepped.points,
            close_wanted,
            close_stepped: self.close.into_iter().map(|(_, tip)| tip).collect(),
        };
        Some((report, picture))
    }
}

impl Joint {
    /// Moves the motor to `position`. What it drives follows once the slack is used up.
    fn go_to(&mut self, position: f64) {
        if self.first == 0.0 {
            self.first = (position - self.position).signum();
        }
        self.position = position;
        self.steps += 1;
        // The first way counts as forward: the motor pushes what it drives, which stays ahead by up to the slack when
        // the motor turns.
        let (least, most) =
            if self.first > 0.0 { (position, position + self.slack) } else { (position - self.slack, position) };
        self.drawn = self.drawn.clamp(least, most);
    }
}

/// Points of a curve of any length in bounded memory: if there are too many, every second one is removed.
#[derive(Default)]
struct Trail {
    points: Vec<[f64; 3]>,
    every: u32,
    since: u32,
}

impl Trail {
    fn push(&mut self, point: [f64; 3]) {
        const MOST: usize = 40_000;
        self.since += 1;
        if self.since < self.every {
            return;
        }
        self.since = 0;
        self.points.push(point);
        if self.points.len() > MOST {
            let mut keep = false;
            self.points.retain(|_| {
                keep = !keep;
                keep
            });
            self.every = (2 * self.every).max(2);
        }
    }
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    dot(minus(a, b), minus(a, b)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_motor_with_slack_drives_lags_when_it_turns() {
        let law = pulsetrain_motion::Law::rest(Time::SECOND).unwrap();
        for way in [1.0, -1.0] {
            let mut joint = Joint {
                cursor: Cursor::new(&law),
                start: 0.0,
                slack: 3.0,
                first: 0.0,
                position: 0.0,
                steps: 0,
                drawn: 0.0,
            };
            let mut go = |position: f64| {
                joint.go_to(way * position);
                way * joint.drawn
            };
            let there: Vec<f64> = [1.0, 2.0, 3.0, 4.0, 5.0].into_iter().map(&mut go).collect();
            assert_eq!(there, [1.0, 2.0, 3.0, 4.0, 5.0]);
            let back: Vec<f64> = [4.0, 3.0, 2.0, 1.0, 0.0].into_iter().map(&mut go).collect();
            assert_eq!(back, [5.0, 5.0, 5.0, 4.0, 3.0]);
            let again: Vec<f64> = [1.0, 2.0, 3.0, 4.0].into_iter().map(&mut go).collect();
            assert_eq!(again, [3.0, 3.0, 3.0, 4.0]);
        }
    }

    #[test]
    fn a_trail_stays_bounded_and_keeps_its_beginning() {
        let mut trail = Trail::default();
        for k in 0..1_000_000 {
            trail.push([f64::from(k), 0.0, 0.0]);
        }
        assert!(trail.points.len() <= 40_001 && trail.points.len() > 15_000, "{}", trail.points.len());
        assert_eq!(trail.points[0], [0.0; 3]);
    }
}
