//! Draws the pictures of docs/winch.md that compare the firmware with the sketch. `cargo xtask pictures` runs this.
//!
//! The firmware's steps are edges of the virtual Uno's pins. The sketch's steps come from a model of its path and step
//! generator (`Path.cpp`, `Stepper.cpp`) in this file: an interrupt every 100 µs, and a main loop that is assumed to
//! run once a millisecond.
#![allow(clippy::disallowed_methods, reason = "pictures may differ in the last digit")]

use std::ops::Range;
use std::path::Path;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::{FontStyle, register_font};
use pulsetrain::winch::run::{ScriptControl, on_virtual};
use pulsetrain::winch::script::{Script, parse};
use pulsetrain::winch::talk::Talk;
use pulsetrain_board::virtual_uno::VirtualUno;

static FONT: &[u8] = include_bytes!("../../plot/assets/DejaVuSans-subset.ttf");
const SIZE: (u32, u32) = (1200, 400);
const INK: RGBColor = RGBColor(40, 40, 40);
const GRID: RGBColor = RGBColor(225, 225, 225);
/// Colours by Okabe and Ito, which colour-blind readers can tell apart.
const OURS: RGBColor = RGBColor(0, 114, 178);
const SKETCH: RGBColor = RGBColor(213, 94, 0);

type Failure = Box<dyn std::error::Error>;
type Points = Vec<(f64, f64)>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

fn main() -> Result<(), Failure> {
    let folder = std::env::args().nth(1).ok_or("usage: winch_pictures FOLDER")?;
    register_font("sans-serif", FontStyle::Normal, FONT).map_err(|_| "the font cannot be read")?;
    let picture = |name: &str, panels: [Panel; 2]| -> Result<(), Failure> {
        let path = Path::new(&folder).join(name);
        let root = SVGBackend::new(&path, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        for (panel, area) in panels.iter().zip(root.split_evenly((1, 2))) {
            panel.draw(&area)?;
        }
        root.present()?;
        println!("{}", path.display());
        Ok(())
    };
    picture("winch-even.svg", [even(4000, 20.0)?, even(1234, 40.0)?])?;
    picture("winch-end.svg", end()?)?;
    picture("winch-limits.svg", limits()?)
}

/// Intervals of a constant speed.
fn even(speed: u32, window_ms: f64) -> Result<Panel, Failure> {
    const FROM_S: f64 = 3.0;
    let lines = [(0.0, "l x 10000 100000".to_owned()), (0.0, "g x 2 1".to_owned()), (0.0, format!("v x {speed}"))];
    let window = FROM_S..FROM_S + window_ms * 1e-3;
    let intervals = |steps: &[Step]| -> Points {
        let pairs = steps.windows(2).filter(|pair| window.contains(&pair[1].at_s));
        pairs.map(|pair| ((pair[1].at_s - FROM_S) * 1e3, (pair[1].at_s - pair[0].at_s) * 1e6)).collect()
    };
    let exact = 1e6 / f64::from(speed);
    Ok(Panel {
        title: format!("Interval before each step at {speed} steps/s, µs"),
        x_title: "time, ms",
        x: 0.0..window_ms,
        y: 0.0..exact * 1.5,
        curves: vec![
            Curve { name: "the sketch", points: intervals(&sketch(&lines, 3.2)), colour: SKETCH, look: Look::Dots },
            Curve { name: "the firmware", points: intervals(&firmware(&lines, 3.2)?), colour: OURS, look: Look::Dots },
        ],
        legend: SeriesLabelPosition::LowerRight,
    })
}

/// The last steps of a move.
fn end() -> Result<[Panel; 2], Failure> {
    const END_S: f64 = 12.0;
    let near = 770.0..802.0;
    let lines = [(0.0, "g x 1 1".to_owned()), (0.0, "a x 800".to_owned())];
    let (ours, theirs) = (firmware(&lines, END_S)?, sketch(&lines, END_S));
    let stairs = |steps: &[Step]| -> Points {
        let corners = |pair: &[Step]| [(pair[1].at_s, pair[0].position), (pair[1].at_s, pair[1].position)];
        let points = steps.windows(2).flat_map(corners).filter(|(_, position)| near.contains(position));
        points.chain(steps.last().map(|last| (END_S, last.position))).collect()
    };
    let intervals = |steps: &[Step]| -> Points {
        let pairs = steps.windows(2).filter(|pair| near.contains(&pair[1].position));
        pairs.map(|pair| (pair[1].position, (pair[1].at_s - pair[0].at_s) * 1e3)).collect()
    };
    Ok([
        Panel {
            title: "The end of a move of 800 steps: position, steps".into(),
            x_title: "time, s",
            x: 0.0..END_S,
            y: near.clone(),
            curves: both(stairs(&theirs), stairs(&ours), Look::Line),
            legend: SeriesLabelPosition::LowerRight,
        },
        Panel {
            title: "Interval before each of its last steps, ms".into(),
            x_title: "position, steps",
            x: near.clone(),
            y: 0.0..1100.0,
            curves: both(intervals(&theirs), intervals(&ours), Look::Dots),
            legend: SeriesLabelPosition::UpperLeft,
        },
    ])
}

/// A far target, and limits that are lowered during the move.
fn limits() -> Result<[Panel; 2], Failure> {
    let far = [(0.0, "l x 2000 8000"), (0.0, "g x 1 1"), (0.0, "a x 4000")];
    let down = [(0.0, "l x 10000 100000"), (0.0, "g x 4 1"), (0.0, "v x 4000"), (1.0, "l x 500 5000")];
    let panel = |title: &str, lines: &[(f64, &str)], end_s: f64, limits: &[f64]| -> Result<Panel, Failure> {
        let lines: Vec<_> = lines.iter().map(|(at_s, line)| (*at_s, (*line).to_owned())).collect();
        let mut curves = both(speeds(&sketch(&lines, end_s)), speeds(&firmware(&lines, end_s)?), Look::Line);
        curves.extend(limits.iter().map(|limit| Curve {
            name: "limit of speed",
            points: vec![(0.0, *limit), (end_s, *limit)],
            colour: INK,
            look: Look::Dashes,
        }));
        let most = curves.iter().flat_map(|curve| &curve.points).map(|point| point.1).fold(0.0, f64::max);
        let legend = SeriesLabelPosition::UpperRight;
        Ok(Panel { title: title.into(), x_title: "time, s", x: 0.0..end_s, y: 0.0..most * 1.08, curves, legend })
    };
    Ok([
        panel("To 4000 within 2000 steps/s, 8000 steps/s²: speed, steps/s", &far, 4.0, &[2000.0])?,
        panel("At 1 s `l x 500 5000`: speed, steps/s", &down, 2.5, &[500.0])?,
    ])
}

fn both(theirs: Points, ours: Points, look: Look) -> Vec<Curve> {
    vec![
        Curve { name: "the sketch", points: theirs, colour: SKETCH, look },
        Curve { name: "the firmware", points: ours, colour: OURS, look },
    ]
}

/// The speed as one over each interval: the lowest and the highest of every 5 ms.
fn speeds(steps: &[Step]) -> Points {
    const BIN_S: f64 = 5e-3;
    let speed = |pair: &[Step]| (pair[1].at_s, 1.0 / (pair[1].at_s - pair[0].at_s));
    let all: Points = steps.windows(2).map(speed).collect();
    let bin = |at_s: f64| (at_s / BIN_S) as u64;
    let ends = |few: &[(f64, f64)]| {
        let by_speed = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let low = few.iter().min_by(by_speed).copied();
        let high = few.iter().max_by(by_speed).copied();
        low.into_iter().chain(high.filter(|high| Some(*high) != low)).collect::<Points>()
    };
    all.chunk_by(|a, b| bin(a.0) == bin(b.0)).flat_map(ends).collect()
}

/// A step of x.
#[derive(Clone, Copy)]
struct Step {
    /// Time since the first line, s.
    at_s: f64,
    /// Position after the step.
    position: f64,
}

/// The firmware's steps on the virtual Uno for some lines.
fn firmware(lines: &[(f64, String)], end_s: f64) -> Result<Vec<Step>, Failure> {
    /// STEP and DIR of x on a CNC shield; forward is high.
    const STEP: u8 = 2;
    const DIR: u8 = 5;
    let text: String = lines.iter().map(|(at_s, line)| format!("{at_s} s: {line}\n")).collect();
    let script = Script { lines: parse(&text, "lines").map_err(|error| error.to_string())?, end_s };
    let mut talk = Talk::new(VirtualUno::with_winch());
    talk.ask()?.ok_or("it does not speak text")?;
    let run = on_virtual(&mut talk, &script, |_| ScriptControl::GoOn)?;
    let (mut forward, mut position, mut steps) = (false, 0.0, Vec::new());
    for edge in &run.edges {
        if edge.line == DIR {
            forward = edge.level;
        } else if edge.line == STEP && edge.level {
            position += if forward { 1.0 } else { -1.0 };
            steps.push(Step { at_s: (edge.tick as f64 - run.begin as f64) / 16e6, position });
        }
    }
    Ok(steps)
}

/// The sketch's steps for some lines, by a model of one axis.
fn sketch(lines: &[(f64, String)], end_s: f64) -> Vec<Step> {
    /// `Timer1.initialize(100)`; and the length of a round of the main loop, µs.
    const INTERRUPT_US: u32 = 100;
    const LOOP_US: u32 = 1000;
    let mut sketch = Sketch::new();
    let mut lines = lines.iter().peekable();
    let mut steps = Vec::new();
    for now_us in (0..(end_s * 1e6) as u32).step_by(INTERRUPT_US as usize) {
        if now_us.is_multiple_of(LOOP_US) {
            while let Some((_, line)) = lines.next_if(|(at_s, _)| at_s * 1e6 <= f64::from(now_us)) {
                sketch.obey(line);
            }
            sketch.poll_path(LOOP_US);
        }
        if sketch.poll_stepper(INTERRUPT_US) {
            steps.push(Step { at_s: f64::from(now_us) * 1e-6, position: f64::from(sketch.made) });
        }
    }
    steps
}

/// The state of `Path` and `Stepper`, with the sketch's types.
struct Sketch {
    q: f32,
    speed: f32,
    target: f32,
    drift: f32,
    k: f32,
    b: f32,
    max_speed: f32,
    max_acceleration: f32,
    made: i32,
    wanted: i32,
    elapsed_us: u32,
    interval_us: u32,
}

impl Sketch {
    fn new() -> Sketch {
        Sketch {
            q: 0.0,
            speed: 0.0,
            target: 0.0,
            drift: 0.0,
            k: 4.0 * std::f32::consts::PI * std::f32::consts::PI,
            b: 1.0,
            max_speed: 3500.0,
            max_acceleration: 35_000.0,
            made: 0,
            wanted: 0,
            elapsed_us: 0,
            interval_us: 200,
        }
    }

    fn obey(&mut self, line: &str) {
        let words: Vec<&str> = line.split(' ').collect();
        let value = |at: usize| words.get(at).and_then(|word| word.parse::<f32>().ok()).unwrap_or(0.0);
        match words[0] {
            "a" => self.target = value(2),
            "v" => self.drift = value(2),
            "l" => (self.max_speed, self.max_acceleration) = (value(2), value(3)),
            "g" => {
                self.k = (std::f32::consts::TAU * value(2)).powi(2);
                self.b = 2.0 * self.k.sqrt() * value(3);
            }
            _ => {}
        }
    }

    /// `Path::pollForInterval`, then `path_poll`.
    fn poll_path(&mut self, interval_us: u32) {
        let dt = 1e-6 * interval_us as f32;
        let wanted = self.k * (self.target - self.q) + self.b * (self.drift - self.speed);
        let acceleration = wanted.clamp(-self.max_acceleration, self.max_acceleration);
        self.q += self.speed * dt;
        self.speed += acceleration * dt;
        self.target += self.drift * dt;
        self.speed = self.speed.clamp(-self.max_speed, self.max_speed);
        self.wanted = self.q as i32;
        let speed = (self.speed as i32).unsigned_abs();
        // `setSpeed`: at less than 1 step/s the interval stays as it was.
        if let Some(interval) = 1_000_000_u32.checked_div(speed) {
            self.interval_us = interval.max(1);
        }
    }

    /// `Stepper::pollForInterval`. Gives whether it made a step.
    fn poll_stepper(&mut self, interval_us: u32) -> bool {
        self.elapsed_us += interval_us;
        if self.elapsed_us < self.interval_us {
            return false;
        }
        self.elapsed_us -= self.interval_us;
        let ahead = (self.wanted - self.made).signum();
        self.made += ahead;
        ahead != 0
    }
}

/// Numbers along an axis; with a place behind the point if it is short.
fn whole(range: &Range<f64>) -> impl Fn(&f64) -> String {
    let places = usize::from(range.end - range.start < 5.0);
    move |value| format!("{value:.places$}")
}

#[derive(Clone, Copy)]
enum Look {
    Line,
    Dots,
    Dashes,
}

struct Curve {
    name: &'static str,
    points: Points,
    colour: RGBColor,
    look: Look,
}

struct Panel {
    title: String,
    x_title: &'static str,
    x: Range<f64>,
    y: Range<f64>,
    curves: Vec<Curve>,
    /// A place in the panel without a curve, for the legend.
    legend: SeriesLabelPosition,
}

impl Panel {
    fn draw(&self, area: &Area<'_>) -> Result<(), Failure> {
        let font = |size: i32| ("sans-serif", size).into_font().color(&INK);
        area.draw(&Text::new(self.title.clone(), (24, 8), font(16)))?;
        let mut chart = ChartBuilder::on(area)
            .margin_top(36)
            .margin_right(28)
            .margin_left(8)
            .margin_bottom(6)
            .x_label_area_size(44)
            .y_label_area_size(64)
            .build_cartesian_2d(self.x.clone(), self.y.clone())?;
        chart
            .configure_mesh()
            .max_light_lines(0)
            .bold_line_style(GRID)
            .axis_style(INK)
            .label_style(font(13))
            .axis_desc_style(font(14))
            .x_desc(self.x_title)
            .x_label_formatter(&whole(&self.x))
            .y_label_formatter(&whole(&self.y))
            .draw()?;
        for Curve { name, points, colour, look } in &self.curves {
            let colour = *colour;
            let series = match look {
                Look::Line => chart.draw_series(LineSeries::new(points.clone(), colour.stroke_width(2)))?,
                Look::Dots => chart.draw_series(points.iter().map(|point| Circle::new(*point, 3, colour.filled())))?,
                Look::Dashes => {
                    chart.draw_series(DashedLineSeries::new(points.clone(), 8, 5, colour.stroke_width(1)))?
                }
            };
            series.label(*name).legend(move |(x, y)| Rectangle::new([(x, y - 3), (x + 16, y + 3)], colour.filled()));
        }
        chart
            .configure_series_labels()
            .position(self.legend.clone())
            .background_style(WHITE.mix(0.85))
            .label_font(font(13))
            .draw()?;
        Ok(())
    }
}
