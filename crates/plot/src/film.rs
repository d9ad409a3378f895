//! A film over the law, and their difference, as the tutorial's paper has it.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::axis::{Axis, Labels};
use crate::draw::{self, Area, DrawResult, Drawing, INK, Panel, light};
use pulsetrain_motion::human;

/// What a film shows of one wheel.
#[derive(Clone, Debug, Default)]
pub struct FilmPicture {
    /// The line above the panels.
    pub title: String,
    /// Law time of each frame, s; the wheel's angle in it and the law's, degrees; the angle's standard deviation,
    /// degrees, 0 if it is not known.
    pub frames: Vec<FilmFrame>,
    /// The law: time, s, and angle, degrees; as dense as a line needs.
    pub law: Vec<(f64, f64)>,
    /// The limit on |difference|, degrees.
    pub limit_deg: f64,
    /// Law times at which steps were lost or added, s, and what is written there.
    pub notes: Vec<(f64, String)>,
}

/// One frame of a film.
#[derive(Clone, Copy, Debug)]
pub struct FilmFrame {
    /// Law time, s.
    pub at_s: f64,
    /// Angle in the film, degrees.
    pub angle_deg: f64,
    /// Angle by the law, degrees.
    pub law_deg: f64,
    /// Standard deviation of the angle, degrees.
    pub sigma_deg: f64,
}

const SEEN: RGBColor = RGBColor(0, 114, 178);
const NOTE: RGBColor = RGBColor(213, 94, 0);
/// Heights in the SVG's units.
const HEAD: u32 = 64;
const ANGLE_HEIGHT: u32 = 420;
const DIFFERENCE_HEIGHT: u32 = 320;
/// Height of a row of notes, as a share of the panel; and the most rows.
const NOTE_ROW: f64 = 0.09;
const MOST_ROWS: usize = 4;
/// Error bars reach this many standard deviations.
const BAR_SIGMAS: f64 = 3.0;

impl FilmPicture {
    /// The picture as SVG.
    ///
    /// # Errors
    /// If the drawing library fails; the text is the library's.
    pub fn svg(&self) -> Result<String, String> {
        draw::to_svg(HEAD + ANGLE_HEIGHT + DIFFERENCE_HEIGHT, &|drawing, root| drawing.film(self, root))
    }

    fn time_range(&self) -> (f64, f64) {
        let times = self.frames.iter().map(|frame| frame.at_s);
        let (low, high) = times.fold((f64::MAX, f64::MIN), |(low, high), t| (low.min(t), high.max(t)));
        if low < high { (low, high) } else { (0.0, 1.0) }
    }
}

impl Drawing {
    fn film<DB: DrawingBackend>(&self, film: &FilmPicture, root: &Area<DB>) -> DrawResult<DB> {
        let (head, body) = root.split_vertically(self.px(HEAD));
        head.draw(&Text::new(film.title.clone(), (self.px(24) as i32, self.px(10) as i32), self.font(20)))?;
        let y = self.px(48) as i32;
        head.draw(&Circle::new((self.px(35) as i32, y), self.px(4), SEEN.filled()))?;
        head.draw(&Text::new("film", (self.px(48) as i32, y - self.px(8) as i32), self.font(14)))?;
        let ends = vec![(self.px(110) as i32, y), (self.px(132) as i32, y)];
        head.draw(&PathElement::new(ends, INK.stroke_width(self.px(2))))?;
        head.draw(&Text::new("law", (self.px(140) as i32, y - self.px(8) as i32), self.font(14)))?;

        let (above, below) = body.split_vertically(self.px(ANGLE_HEIGHT));
        let (from, to) = film.time_range();
        let (factor, unit) = human::time_unit(to.abs().max(from.abs()));
        let time = || Axis::linear(Some((from, to)), 0.0, Labels::Number(factor));
        let x_title = format!("time, {unit}");

        let angles = film.frames.iter().map(|frame| frame.angle_deg).chain(film.law.iter().map(|point| point.1));
        let range = angles.fold((f64::MAX, f64::MIN), |(low, high), a| (low.min(a), high.max(a)));
        let y = Axis::linear((range.0 <= range.1).then_some(range), 0.06, Labels::Number(1.0));
        let panel = Panel { title: "Angle of the wheel, °: film over law", x_title: &x_title, x: time(), y };
        let mut chart = self.panel(&above, panel)?;
        self.line(&mut chart, film.law.clone(), INK, 2)?;
        let dot = |frame: &FilmFrame| Circle::new((frame.at_s, frame.angle_deg), self.px(3), light(SEEN).filled());
        chart.draw_series(film.frames.iter().map(dot))?;

        let difference = |frame: &FilmFrame| frame.angle_deg - frame.law_deg;
        let limit = film.limit_deg;
        let (low, high) = film
            .frames
            .iter()
            .map(difference)
            .fold((-1.1 * limit, 1.1 * limit), |(low, high), d| (low.min(d), high.max(d)));
        // Notes have rows of their own above all that is drawn.
        let rows = film.notes.len().min(MOST_ROWS);
        let row = NOTE_ROW * (high - low) / (1.0 - NOTE_ROW * rows as f64);
        let range = (low, high + row * rows as f64);
        let title = format!("Film − law, °; limit: {}; bars: {BAR_SIGMAS} σ", human::significant(limit, 3));
        let y = Axis::linear(Some(range), 0.08, Labels::Number(1.0));
        let mut chart = self.panel(&below, Panel { title: &title, x_title: &x_title, x: time(), y })?;
        let bar = |frame: &FilmFrame| {
            let (at, half) = (difference(frame), BAR_SIGMAS * frame.sigma_deg);
            PathElement::new(
                vec![(frame.at_s, at - half), (frame.at_s, at + half)],
                light(SEEN).stroke_width(self.px(1)),
            )
        };
        chart.draw_series(film.frames.iter().filter(|frame| frame.sigma_deg > 0.0).map(bar))?;
        let dot = |frame: &FilmFrame| Circle::new((frame.at_s, difference(frame)), self.px(2), SEEN.filled());
        chart.draw_series(film.frames.iter().map(dot))?;
        for level in [limit, -limit] {
            let style = INK.stroke_width(self.px(1));
            chart.draw_series(DashedLineSeries::new([(from, level), (to, level)], self.px(8), self.px(5), style))?;
        }
        for (k, (at_s, note)) in film.notes.iter().enumerate() {
            let line = vec![(*at_s, range.0), (*at_s, range.1)];
            chart.draw_series([PathElement::new(line, NOTE.stroke_width(self.px(1)))])?;
            // In the right half the text ends at the line, so that it stays in the picture.
            let side = if *at_s > 0.5 * (from + to) { HPos::Right } else { HPos::Left };
            let style = self.font(13).pos(Pos::new(side, VPos::Top));
            let at = (*at_s, range.1 - row * (k % rows) as f64);
            chart.draw_series([Text::new(format!(" {note} "), at, style)])?;
        }
        Ok(())
    }
}
