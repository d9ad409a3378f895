//! Draws the panels.

use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::axis::{Axis, Labels};
use crate::{Envelope, Errors, MotorPicture, Picture};
use pulsetrain_motion::human;

const FAMILY: &str = "sans-serif";

/// The motors' colours by Okabe and Ito, which colour-blind readers can tell apart. doi:10.1038/nmeth.1618
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(120, 120, 120),
];
pub(super) const INK: RGBColor = RGBColor(40, 40, 40);
pub(super) const GRID: RGBColor = RGBColor(225, 225, 225);

/// Lengths in the SVG's units. A PNG has `PNG_SCALE` pixels for each.
const WIDTH: u32 = 1200;
const PNG_SCALE: u32 = 2;
/// A stroke that is shorter than this many pixels becomes part of the next one.
const SHORTEST_STROKE: i32 = 4;
const HEAD: u32 = 64;
const LEGEND_ROW: u32 = 22;
const PANEL_HEIGHT: u32 = 350;
const ERRORS_HEIGHT: u32 = 300;
/// Height of the panels of a machine's figure, which are about square inside.
const FIGURE_HEIGHT: u32 = 598;

/// If the longest interval is more than this many times the shortest one, the axis is logarithmic.
const LOG_ABOVE: f64 = 30.0;

pub(super) fn svg(picture: &Picture) -> Result<String, String> {
    let mut text = String::new();
    let drawing = Drawing { scale: 1, joins: true };
    drawing.draw(picture, SVGBackend::with_string(&mut text, drawing.size(picture)))?;
    Ok(text)
}

/// An SVG of a height that one function draws.
pub(super) fn to_svg(
    height: u32,
    draw: &dyn for<'a> Fn(&Drawing, &Area<SVGBackend<'a>>) -> DrawResult<SVGBackend<'a>>,
) -> Result<String, String> {
    if !register() {
        return Err(NO_FONT.into());
    }
    let mut text = String::new();
    let root = SVGBackend::with_string(&mut text, (WIDTH, height)).into_drawing_area();
    let drawing = Drawing { scale: 1, joins: true };
    let drawn = root.fill(&WHITE).and_then(|()| draw(&drawing, &root)).and_then(|()| root.present());
    drawn.map_err(|error| error.to_string())?;
    drop(root);
    Ok(text)
}

/// What is said if the font is missing.
const NO_FONT: &str = "the built-in font cannot be read";

pub(super) fn png(picture: &Picture) -> Result<Vec<u8>, String> {
    let drawing = Drawing { scale: PNG_SCALE, joins: false };
    let (width, height) = drawing.size(picture);
    let mut pixels = vec![0; 3 * width as usize * height as usize];
    drawing.draw(picture, BitMapBackend::with_buffer(&mut pixels, (width, height)))?;
    let mut file = Vec::new();
    encode(&pixels, (width, height), &mut file).map_err(|error| error.to_string())?;
    Ok(file)
}

/// Writes the file around `pixels`: rows of red, green, blue.
fn encode(pixels: &[u8], (width, height): (u32, u32), file: &mut Vec<u8>) -> Result<(), png::EncodingError> {
    let mut encoder = png::Encoder::new(file, width, height);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    writer.finish()
}

/// In a browser plotters measures text with the page's own font, so there is nothing to register.
#[cfg(target_arch = "wasm32")]
const fn register() -> bool {
    true
}

#[cfg(not(target_arch = "wasm32"))]
fn register() -> bool {
    use plotters::style::{FontStyle, register_font};
    use std::sync::OnceLock;

    /// Registers DejaVu Sans, reduced (assets/LICENSE-DejaVu.txt), as "sans-serif", which is also the font that the SVG
    /// names.
    static FONT: &[u8] = include_bytes!("../assets/DejaVuSans-subset.ttf");
    static REGISTERED: OnceLock<bool> = OnceLock::new();
    *REGISTERED.get_or_init(|| register_font(FAMILY, FontStyle::Normal, FONT).is_ok())
}

pub(super) type Area<DB> = DrawingArea<DB, Shift>;
pub(super) type Chart<'a, DB> = ChartContext<'a, DB, Cartesian2d<Axis, Axis>>;
pub(super) type DrawResult<DB> = Result<(), DrawingAreaErrorKind<<DB as DrawingBackend>::ErrorType>>;

pub(super) struct Drawing {
    scale: u32,
    /// Whether the backend joins the strokes of a line well. The bitmap backend makes spikes at sharp corners.
    joins: bool,
}

/// What surrounds the curves of a panel: title, axes, labels.
pub(super) struct Panel<'a> {
    pub(super) title: &'a str,
    pub(super) x_title: &'a str,
    pub(super) x: Axis,
    pub(super) y: Axis,
}

impl Drawing {
    fn draw<DB: DrawingBackend>(&self, picture: &Picture, backend: DB) -> Result<(), String> {
        if !register() {
            return Err(NO_FONT.into());
        }
        let root = backend.into_drawing_area();
        self.panels(picture, &root).and_then(|()| root.present()).map_err(|error| error.to_string())
    }

    pub(super) fn px(&self, length: u32) -> u32 {
        length * self.scale
    }

    pub(super) fn font(&self, size: u32) -> TextStyle<'static> {
        (FAMILY, self.px(size)).into_font().color(&INK)
    }

    fn size(&self, picture: &Picture) -> (u32, u32) {
        let errors = if has_steps(picture) { error_panels(picture).0 as u32 } else { 0 };
        let figures = picture.figures.len() as u32;
        let height = HEAD
            + (legend_rows(picture) - 1) * LEGEND_ROW
            + figures * FIGURE_HEIGHT
            + upper_rows(picture) * PANEL_HEIGHT
            + errors * ERRORS_HEIGHT;
        (self.px(WIDTH), self.px(height))
    }

    fn panels<DB: DrawingBackend>(&self, picture: &Picture, root: &Area<DB>) -> DrawResult<DB> {
        root.fill(&WHITE)?;
        let (head, body) = root.split_vertically(self.px(HEAD + (legend_rows(picture) - 1) * LEGEND_ROW));
        self.heading(picture, &head)?;
        let figures = picture.figures.len();
        let (above, body) = body.split_vertically(self.px(figures as u32 * FIGURE_HEIGHT));
        if figures > 0 {
            let panels = above.split_evenly((figures, 2));
            for ((figure, colour), areas) in
                picture.figures.iter().zip(COLOURS.into_iter().cycle()).zip(panels.chunks(2))
            {
                if let [all, close] = areas {
                    self.figure(figure, colour, (all, close))?;
                }
            }
        }
        let (upper, errors) = body.split_vertically(self.px(upper_rows(picture) * PANEL_HEIGHT));
        let panels = upper.split_evenly((upper_rows(picture) as usize, 2));
        let motors = &picture.motors;

        let ends = [span(motors, |m| &m.wanted), span(motors, |m| &m.stepped)];
        let end = ends.into_iter().flatten().map(|span| span.1).fold(0.0, f64::max);
        let time = TimeAxis { end: if end > 0.0 { end } else { 1.0 } };
        let unit = Unit::of(motors);

        let mut chart = self.panel(
            &panels[0],
            Panel {
                title: &format!("Position, {}", unit.name),
                x_title: &time.title(),
                x: time.axis(),
                y: unit.axis(motors, |m| [&m.wanted, &m.stepped]),
            },
        )?;
        self.changes(&mut chart, &picture.changes)?;
        for (colour, motor) in coloured(motors) {
            self.line(&mut chart, unit.points(motor, &motor.stepped), light(colour), 5)?;
        }
        for motor in motors {
            self.line(&mut chart, unit.points(motor, &motor.wanted), INK, 1)?;
        }

        if has_steps(picture) {
            self.close_view(picture, &panels[1])?;
            self.intervals(picture, &panels[2])?;
        }

        let mut chart = self.panel(
            &panels[panels.len() - 1],
            Panel {
                title: &format!("Speed, {}/s", unit.name),
                x_title: &time.title(),
                x: time.axis(),
                y: unit.axis(motors, |m| [&m.wanted_speed, &m.stepped_speed]),
            },
        )?;
        self.changes(&mut chart, &picture.changes)?;
        for (colour, motor) in coloured(motors) {
            self.line(&mut chart, unit.points(motor, &motor.stepped_speed), light(colour), 5)?;
        }
        for motor in motors {
            self.line(&mut chart, unit.points(motor, &motor.wanted_speed), INK, 1)?;
        }

        if !has_steps(picture) {
            return Ok(());
        }
        let areas = errors.split_evenly(error_panels(picture));
        for ((colour, motor), area) in coloured(motors).zip(&areas) {
            self.errors(motor, picture.errors, colour, area, &time)?;
        }
        Ok(())
    }

    /// A dashed line at each change of the motion. Of those that are less than a unit of the picture apart, the first alone is drawn: a fader
    /// makes thousands in a minute.
    fn changes<DB: DrawingBackend>(&self, chart: &mut Chart<'_, DB>, changes: &[f64]) -> DrawResult<DB> {
        let (times, heights) = (chart.x_range(), chart.y_range());
        let apart = (times.end - times.start) / f64::from(WIDTH);
        let mut drawn = changes.to_vec();
        drawn.sort_by(f64::total_cmp);
        drawn.dedup_by(|at, before| *at - *before < apart);
        for at in drawn {
            let ends = [(at, heights.start), (at, heights.end)];
            chart.draw_series(DashedLineSeries::new(ends, self.px(4), self.px(4), INK.stroke_width(self.px(1))))?;
        }
        Ok(())
    }

    /// The title, and the legend: a swatch and a name for each motor, then the law's line.
    fn heading<DB: DrawingBackend>(&self, picture: &Picture, area: &Area<DB>) -> DrawResult<DB> {
        let title = if has_steps(picture) {
            format!("{} · tick {}", picture.title, human::seconds(picture.tick_s))
        } else {
            picture.title.clone()
        };
        area.draw(&Text::new(title, (self.px(24) as i32, self.px(10) as i32), self.font(20)))?;
        let style = self.font(14).pos(Pos::new(HPos::Left, VPos::Center));
        let stepped =
            coloured(&picture.motors).map(|(colour, motor)| (stepped_label(motor, picture.errors), light(colour), 5));
        let entries = stepped.chain([(picture.errors.wanted().to_owned(), INK, 1)]);
        for ((column, row), (label, colour, width)) in legend_places(picture).into_iter().zip(entries) {
            let (x, y) = (self.px(column) as i32, self.px(48 + row * LEGEND_ROW) as i32);
            let ends = vec![(x, y), (x + self.px(SWATCH) as i32, y)];
            area.draw(&PathElement::new(ends, colour.stroke_width(self.px(width))))?;
            area.draw(&Text::new(label, (x + self.px(SWATCH + 8) as i32, y), style.clone()))?;
        }
        Ok(())
    }

    pub(super) fn panel<'a, DB: DrawingBackend>(
        &self,
        area: &'a Area<DB>,
        panel: Panel<'_>,
    ) -> Result<Chart<'a, DB>, DrawingAreaErrorKind<DB::ErrorType>> {
        let at = (self.px(24) as i32, self.px(4) as i32);
        area.draw(&Text::new(panel.title.to_owned(), at, self.font(16)))?;
        let mut chart = ChartBuilder::on(area)
            .margin_top(self.px(30))
            .margin_right(self.px(28))
            .margin_left(self.px(8))
            .margin_bottom(self.px(6))
            .x_label_area_size(self.px(44))
            .y_label_area_size(self.px(76))
            .build_cartesian_2d(panel.x, panel.y)?;
        chart
            .configure_mesh()
            .x_labels(7)
            .y_labels(6)
            .max_light_lines(0)
            .bold_line_style(GRID.stroke_width(self.px(1)))
            .axis_style(INK.stroke_width(self.px(1)))
            .label_style(self.font(13))
            .axis_desc_style(self.font(14))
            .x_desc(panel.x_title)
            .set_all_tick_mark_size(self.px(4))
            .draw()?;
        Ok(chart)
    }

    pub(super) fn line<DB: DrawingBackend>(
        &self,
        chart: &mut Chart<'_, DB>,
        points: Vec<(f64, f64)>,
        colour: RGBColor,
        width: u32,
    ) -> DrawResult<DB> {
        let style = colour.stroke_width(self.px(width));
        if self.joins {
            chart.draw_series(LineSeries::new(points, style))?;
        } else {
            // plotters rounds the ends of a stroke to pixels: strokes of a few pixels would look jagged.
            let mut last = None;
            let mut points = points;
            points.retain(|point| {
                let (x, y) = chart.backend_coord(point);
                let far = last.is_none_or(|(x0, y0): (i32, i32)| (x - x0).abs().max((y - y0).abs()) >= SHORTEST_STROKE);
                last = if far { Some((x, y)) } else { last };
                far
            });
            chart.draw_series(points.windows(2).map(|ends| PathElement::new(ends.to_vec(), style)))?;
        }
        Ok(())
    }

    /// The first steps, with each one visible.
    fn close_view<DB: DrawingBackend>(&self, picture: &Picture, area: &Area<DB>) -> DrawResult<DB> {
        let window = picture.close_view().unwrap_or((0.0, 1.0));
        let (factor, time_unit) = human::time_unit(window.1);
        let stairs: Vec<_> = picture.motors.iter().map(|motor| motor.stairs(window)).collect();
        let heights = stairs.iter().chain(picture.motors.iter().map(|m| &m.wanted_closely)).flatten();
        let mut chart = self.panel(
            area,
            Panel {
                title: "Position at the start, steps",
                x_title: &format!("time, {time_unit}"),
                x: Axis::linear(Some(window), 0.0, Labels::Number(factor)),
                y: Axis::linear(join(heights.map(|point| Some((point.1, point.1)))), 0.05, Labels::Number(1.0)),
            },
        )?;
        for ((colour, motor), stairs) in coloured(&picture.motors).zip(stairs) {
            self.line(&mut chart, stairs, colour, 2)?;
            self.line(&mut chart, motor.wanted_closely.clone(), INK, 1)?;
        }
        Ok(())
    }

    fn intervals<DB: DrawingBackend>(&self, picture: &Picture, area: &Area<DB>) -> DrawResult<DB> {
        let range = join(picture.motors.iter().map(|m| m.intervals.range()));
        let steps = join(picture.motors.iter().map(|m| m.intervals.span()));
        let (factor, unit) = human::time_unit(range.map_or(1.0, |range| range.1));
        let (title, y) = match range {
            Some((low, high)) if low > 0.0 && high / low > LOG_ABOVE => {
                ("Interval before each step".into(), Axis::logarithmic((low, high), Labels::Seconds))
            }
            _ => {
                // The axis begins at 0: with a tight one a jitter of one tick would look like a mountain range.
                let range = range.map(|range| (0.0, range.1));
                (format!("Interval before each step, {unit}"), Axis::linear(range, 0.05, Labels::Number(factor)))
            }
        };
        let x = Axis::linear(steps.map(|steps| (0.0, steps.1)), 0.0, Labels::Number(1.0));
        let mut chart = self.panel(area, Panel { title: &title, x_title: "step number", x, y })?;
        for (colour, motor) in coloured(&picture.motors) {
            self.line(&mut chart, motor.intervals.points(), colour, 2)?;
        }
        Ok(())
    }

    /// The error of each step between the bounds of the certificate, and the later bound of a board whose edges may be late.
    fn errors<DB: DrawingBackend>(
        &self,
        motor: &MotorPicture,
        title: Errors,
        colour: RGBColor,
        area: &Area<DB>,
        time: &TimeAxis,
    ) -> DrawResult<DB> {
        let bound = motor.bound_ticks;
        let (low, high) = motor.errors.range().unwrap_or((0.0, 0.0));
        // The axis holds the bounds and the errors that break them.
        let late = bound + motor.late_ticks;
        let range = (low.min(-1.2 * bound), high.max(1.2 * late));
        let title = title.title(&motor.name, &human::significant(bound, 3), motor.late_ticks);
        let y = Axis::linear(Some(range), 0.08, Labels::Number(1.0));
        let mut chart = self.panel(area, Panel { title: &title, x_title: &time.title(), x: time.axis(), y })?;
        if motor.errors.is_exact() {
            let dot = |point| Circle::new(point, self.px(1) + 1, colour.filled());
            chart.draw_series(motor.errors.points().into_iter().map(dot))?;
        } else {
            let stroke = colour.stroke_width(self.px(1));
            let bar = |(x, low, high)| PathElement::new(vec![(x, low), (x, high)], stroke);
            chart.draw_series(motor.errors.bars().map(bar))?;
            // A bar over a single step has no length.
            let single = motor.errors.bars().filter(|(_, low, high)| low == high);
            chart.draw_series(single.map(|(x, y, _)| Circle::new((x, y), self.px(1), colour.filled())))?;
        }
        let later = (motor.late_ticks > 0.0).then_some(late);
        for level in [bound, -bound].into_iter().chain(later) {
            let ends = [(0.0, level), (time.end, level)];
            chart.draw_series(DashedLineSeries::new(ends, self.px(8), self.px(5), INK.stroke_width(self.px(1))))?;
        }
        Ok(())
    }
}

/// The axis of law time that most panels share.
struct TimeAxis {
    end: f64,
}

impl TimeAxis {
    fn title(&self) -> String {
        format!("time, {}", human::time_unit(self.end).1)
    }

    fn axis(&self) -> Axis {
        Axis::linear(Some((0.0, self.end)), 0.0, Labels::Number(human::time_unit(self.end).0))
    }
}

const SWATCH: u32 = 22;

fn stepped_label(motor: &MotorPicture, errors: Errors) -> String {
    format!("{}, {}", motor.name, errors.made())
}

/// Column (in units of the SVG) and row of each entry of the legend, the law's last.
fn legend_places(picture: &Picture) -> Vec<(u32, u32)> {
    // Nearly every character of this size is narrower than 9 units.
    let labels = picture.motors.iter().map(|motor| stepped_label(motor, picture.errors));
    let widths = labels.chain([picture.errors.wanted().to_owned()]);
    let widths = widths.map(|label| SWATCH + 28 + 9 * label.chars().count() as u32);
    let (mut x, mut row) = (24, 0);
    widths
        .map(|width| {
            if x > 24 && x + width > WIDTH {
                (x, row) = (24, row + 1);
            }
            x += width;
            (x - width, row)
        })
        .collect()
}

fn legend_rows(picture: &Picture) -> u32 {
    legend_places(picture).last().map_or(1, |place| place.1 + 1)
}

/// Whether intervals and errors of single steps are drawn.
fn has_steps(picture: &Picture) -> bool {
    !matches!(picture.errors, Errors::Unknown | Errors::Live)
}

/// Rows of panels above the panels of errors.
fn upper_rows(picture: &Picture) -> u32 {
    if has_steps(picture) { 2 } else { 1 }
}

/// Rows and columns of the panels of errors.
fn error_panels(picture: &Picture) -> (usize, usize) {
    let abreast = match picture.motors.len() {
        0 | 1 => 1,
        2 | 4 => 2,
        _ => 3,
    };
    (picture.motors.len().div_ceil(abreast).max(1), abreast)
}

/// Makes a colour paler, so that the law's line is visible on it, and opaque, so that strokes may overlap.
pub(super) fn light(colour: RGBColor) -> RGBColor {
    let pale = |c: u8| 255 - ((255 - u32::from(c)) * 55 / 100) as u8;
    RGBColor(pale(colour.0), pale(colour.1), pale(colour.2))
}

/// The unit of the position axes: the motors' unit if they agree, else steps.
struct Unit {
    name: String,
    own: bool,
}

impl Unit {
    fn of(motors: &[MotorPicture]) -> Unit {
        match motors {
            [first, rest @ ..] if rest.iter().all(|motor| motor.scale.unit == first.scale.unit) => {
                Unit { name: human::unit(&first.scale.unit).to_owned(), own: true }
            }
            _ => Unit { name: "steps".into(), own: false },
        }
    }

    fn steps(&self, motor: &MotorPicture) -> f64 {
        if self.own { motor.scale.steps_per_unit } else { 1.0 }
    }

    fn points(&self, motor: &MotorPicture, curve: &Envelope) -> Vec<(f64, f64)> {
        let steps = self.steps(motor);
        curve.points().into_iter().map(|(x, y)| (x, y / steps)).collect()
    }

    fn axis<'a>(&self, motors: &'a [MotorPicture], curves: impl Fn(&'a MotorPicture) -> [&'a Envelope; 2]) -> Axis {
        let ranges = motors.iter().flat_map(|motor| {
            let steps = self.steps(motor);
            curves(motor).map(|curve| curve.range().map(|(low, high)| (low / steps, high / steps)))
        });
        Axis::linear(join(ranges), 0.05, Labels::Number(1.0))
    }
}

fn coloured(motors: &[MotorPicture]) -> impl Iterator<Item = (RGBColor, &MotorPicture)> {
    COLOURS.into_iter().cycle().zip(motors)
}

fn span(motors: &[MotorPicture], curve: impl Fn(&MotorPicture) -> &Envelope) -> Option<(f64, f64)> {
    join(motors.iter().map(|motor| curve(motor).span()))
}

fn join(ranges: impl Iterator<Item = Option<(f64, f64)>>) -> Option<(f64, f64)> {
    ranges.flatten().reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}
