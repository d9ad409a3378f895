//! Draws the figures of machines, from above or in perspective.

use plotters::coord::cartesian::Cartesian2d;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::axis::{Axis, Labels};
use crate::draw::{Area, Chart, DrawResult, Drawing, GRID, INK, Panel, light};
use pulsetrain_motion::human;

/// A machine's figure, as the law has it and as the steps draw it.
#[derive(Clone, Debug, Default)]
pub struct FigurePicture {
    /// The machine's name in the motion file.
    pub name: String,
    /// The unit of all points.
    pub unit: String,
    /// Whether z matters. If it does the figure is drawn in projection.
    pub in_space: bool,
    /// Points of the tip by the law, in order of time.
    pub wanted: Vec<[f64; 3]>,
    /// Points of the tip by the steps, step by step.
    pub stepped: Vec<[f64; 3]>,
    /// Points of the tip by the law, during the steps of the close view.
    pub close_wanted: Vec<[f64; 3]>,
    /// The steps of the close view.
    pub close_stepped: Vec<[f64; 3]>,
}

/// From where a figure in space is seen, degrees: turned about z, and from above.
const TURNED_DEG: f64 = -55.0;
const FROM_ABOVE_DEG: f64 = 25.0;
/// Width over height inside a panel's axes, near enough that circles look round.
const SHAPE: f64 = 490.0 / 518.0;
/// The margin around a figure, as a share of its size.
const MARGIN: f64 = 0.06;

type Flat = (f64, f64);

impl FigurePicture {
    fn flat(&self, [x, y, z]: [f64; 3]) -> Flat {
        if !self.in_space {
            return (x, y);
        }
        let (sin, cos) = libm::sincos(TURNED_DEG.to_radians());
        let (rise, fall) = libm::sincos(FROM_ABOVE_DEG.to_radians());
        // The picture's x axis is at a right angle to the line of sight. Points that are farther away are drawn higher.
        (cos * x - sin * y, fall * z + rise * (sin * x + cos * y))
    }

    fn flats(&self, points: &[[f64; 3]]) -> Vec<Flat> {
        points.iter().map(|point| self.flat(*point)).collect()
    }
}

/// Both axes around all points, at one scale.
fn axes<'a>(points: impl Iterator<Item = &'a Flat>) -> (Axis, Axis) {
    let (mut low, mut high) = ((f64::MAX, f64::MAX), (f64::MIN, f64::MIN));
    for (x, y) in points {
        low = (low.0.min(*x), low.1.min(*y));
        high = (high.0.max(*x), high.1.max(*y));
    }
    let (wide, tall) = ((high.0 - low.0).max(1e-9), (high.1 - low.1).max(1e-9));
    let height = tall.max(wide / SHAPE) * (1.0 + 2.0 * MARGIN);
    let around = |low: f64, high: f64, span: f64| {
        let middle = 0.5 * (low + high);
        Axis::linear(Some((middle - 0.5 * span, middle + 0.5 * span)), 0.0, Labels::Number(1.0))
    };
    (around(low.0, high.0, height * SHAPE), around(low.1, high.1, height))
}

impl Drawing {
    /// Draws the whole figure and, next to it, some steps near its beginning.
    pub(super) fn figure<DB: DrawingBackend>(
        &self,
        figure: &FigurePicture,
        colour: RGBColor,
        areas: (&Area<DB>, &Area<DB>),
    ) -> DrawResult<DB> {
        let unit = human::unit(&figure.unit);
        let (wanted, stepped) = (figure.flats(&figure.wanted), figure.flats(&figure.stepped));
        let space = if figure.in_space { ", in space" } else { ", y over x" };
        let title = format!("Figure of {}, {unit}{space}", figure.name);
        let mut chart = self.figure_chart(figure, areas.0, &title, &[&wanted, &stepped])?;
        self.line(&mut chart, stepped, light(colour), 4)?;
        self.line(&mut chart, wanted, INK, 1)?;
        let (wanted, stepped) = (figure.flats(&figure.close_wanted), figure.flats(&figure.close_stepped));
        let title = format!("{} steps near its beginning, {unit}{space}", figure.close_stepped.len().saturating_sub(1));
        let mut chart = self.figure_chart(figure, areas.1, &title, &[&wanted, &stepped])?;
        // Each motor's step is a stroke of its own along an axis, so corners are places where the tip stood.
        self.line(&mut chart, stepped.clone(), light(colour), 3)?;
        chart.draw_series(stepped.into_iter().map(|point| Circle::new(point, self.px(3), colour.filled())))?;
        self.line(&mut chart, wanted, INK, 1)
    }

    fn figure_chart<'a, DB: DrawingBackend>(
        &self,
        figure: &FigurePicture,
        area: &'a Area<DB>,
        title: &str,
        curves: &[&Vec<Flat>],
    ) -> Result<Chart<'a, DB>, DrawingAreaErrorKind<DB::ErrorType>> {
        if !figure.in_space {
            let (x, y) = axes(curves.iter().copied().flatten());
            return self.panel(area, Panel { title, x_title: "x", x, y });
        }
        let is_close = curves.first().is_some_and(|curve| curve.len() == figure.close_wanted.len());
        let points =
            if is_close { [&figure.close_wanted, &figure.close_stepped] } else { [&figure.wanted, &figure.stepped] };
        let edges = Box3::around(points.into_iter().flatten()).not_flat();
        let corners: Vec<Flat> = edges.corners().into_iter().map(|corner| figure.flat(corner)).collect();
        let (x, y) = axes(corners.iter());
        let at = (self.px(24) as i32, self.px(4) as i32);
        area.draw(&Text::new(title.to_owned(), at, self.font(16)))?;
        let mut chart: ChartContext<'a, DB, Cartesian2d<Axis, Axis>> = ChartBuilder::on(area)
            .margin_top(self.px(40))
            .margin_right(self.px(60))
            .margin_left(self.px(60))
            .margin_bottom(self.px(40))
            .build_cartesian_2d(x, y)?;
        let stroke = GRID.stroke_width(self.px(2));
        for (a, b) in edges.edges() {
            chart.draw_series([PathElement::new(vec![figure.flat(a), figure.flat(b)], stroke)])?;
        }
        // Each axis has its labels along the edge in front.
        let style = self.font(13).pos(Pos::new(HPos::Center, VPos::Center));
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            for (part, label) in
                [(0.0, edges.number(edges.low[axis])), (0.5, name.to_owned()), (1.0, edges.number(edges.high[axis]))]
            {
                let (dx, dy) = [(-24, 14), (28, 14), (-30, 0)][axis];
                let place = chart.backend_coord(&figure.flat(edges.label(axis, part)));
                let place = (place.0 + dx * self.px(1) as i32, place.1 + dy * self.px(1) as i32);
                let origin = area.get_base_pixel();
                area.draw(&Text::new(label, (place.0 - origin.0, place.1 - origin.1), style.clone()))?;
            }
        }
        Ok(chart)
    }
}

/// The box around points in space.
struct Box3 {
    low: [f64; 3],
    high: [f64; 3],
}

impl Box3 {
    fn around<'a>(points: impl Iterator<Item = &'a [f64; 3]>) -> Box3 {
        let mut around = Box3 { low: [f64::MAX; 3], high: [f64::MIN; 3] };
        for point in points {
            let sides = around.low.iter_mut().zip(&mut around.high).zip(point);
            sides.for_each(|((low, high), at)| (*low, *high) = (low.min(*at), high.max(*at)));
        }
        around
    }

    /// Makes no side shorter than a third of the longest one, so that labels have room.
    fn not_flat(mut self) -> Box3 {
        let least = self.longest() / 3.0;
        for (low, high) in self.low.iter_mut().zip(&mut self.high) {
            let lacking = (least - (*high - *low)).max(0.0);
            (*low, *high) = (*low - 0.5 * lacking, *high + 0.5 * lacking);
        }
        self
    }

    fn longest(&self) -> f64 {
        self.low.iter().zip(&self.high).map(|(low, high)| high - low).fold(0.0, f64::max)
    }

    /// Writes a coordinate as a label, rounded to a thousandth of the longest side.
    fn number(&self, coordinate: f64) -> String {
        let unit = libm::exp10(libm::log10((self.longest() / 1000.0).max(f64::MIN_POSITIVE)).ceil());
        // Adding 0 turns −0 into 0.
        human::significant((coordinate / unit).round() * unit + 0.0, 6)
    }

    fn corner(&self, which: usize) -> [f64; 3] {
        [0, 1, 2].map(|axis| if which >> axis & 1 == 1 { self.high[axis] } else { self.low[axis] })
    }

    fn corners(&self) -> Vec<[f64; 3]> {
        (0..8).map(|which| self.corner(which)).collect()
    }

    fn edges(&self) -> impl Iterator<Item = ([f64; 3], [f64; 3])> + '_ {
        (0..8).flat_map(move |which| {
            let ends = (0..3).filter(move |axis| which >> axis & 1 == 0);
            ends.map(move |axis| (self.corner(which), self.corner(which | 1 << axis)))
        })
    }

    /// A point on the edge in front, at the share `part` of the way from low to high.
    fn label(&self, axis: usize, part: f64) -> [f64; 3] {
        // From the picture's point of view low y is in front, and low x is on the left.
        let mut place = match axis {
            0 => [0.0, self.low[1], self.low[2]],
            1 => [self.high[0], 0.0, self.low[2]],
            _ => [self.low[0], self.low[1], 0.0],
        };
        place[axis] = self.low[axis] + part * (self.high[axis] - self.low[axis]);
        place
    }
}
