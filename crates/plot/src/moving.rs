//! A moving picture of one motor: its law, the pulses of its STEP line, and the wheel that they turn. It is an SVG that moves in every browser.

use pulsetrain_motion::law::{Cursor, Law};
use pulsetrain_motion::{LawError, Time};
use std::fmt::Write as _;

/// What a moving picture shows.
#[derive(Clone, Debug)]
pub struct Moving<'a> {
    /// The line above the picture: the law as the motion file has it.
    pub title: &'a str,
    /// The law.
    pub law: &'a Law,
    /// The user's unit of position, and the steps in one of it.
    pub unit: (&'a str, f64),
    /// Steps in a turn of the wheel.
    pub steps_per_turn: f64,
    /// Each step: its time, s, and the position after it, steps from the start.
    pub steps: &'a [(f64, i64)],
    /// How long the picture goes on before it begins again, s.
    pub duration_s: f64,
}

/// The most steps in a moving picture: each is a pulse and a place of the wheel in its file.
pub const MOST_STEPS: usize = 20_000;
/// Points of the law's curve.
const POINTS: u32 = 360;
/// Width and height of the picture, pixels.
const SIZE: (f64, f64) = (960.0, 300.0);
/// The curve's panel: left, top, right, bottom, pixels.
const CURVE: [f64; 4] = [70.0, 70.0, 430.0, 250.0];
/// The panel of the STEP line.
const PULSES: [f64; 4] = [490.0, 120.0, 690.0, 200.0];
/// Centre and radius of the wheel.
const WHEEL: (f64, f64, f64) = (830.0, 160.0, 95.0);
/// Steps that the panel of the STEP line shows at once, where the motor is fastest.
const PULSES_AT_ONCE: f64 = 16.0;
/// Part of that panel before the present place.
const PAST: f64 = 0.5;

/// The most characters of the title, which is 9.6 pixels wide for each.
const MOST_OF_TITLE: usize = 96;

/// A title that fits the picture.
fn shortened(title: &str) -> String {
    if title.chars().count() <= MOST_OF_TITLE {
        return title.to_owned();
    }
    title.chars().take(MOST_OF_TITLE - 1).chain(['…']).collect()
}

impl Moving<'_> {
    /// The picture as SVG.
    ///
    /// # Errors
    /// If the law has no value somewhere.
    pub fn svg(&self) -> Result<String, LawError> {
        let mut cursor = Cursor::new(self.law);
        let start = cursor.at(Time::ZERO)?.position;
        let mut theta = Vec::new();
        for k in 0..=POINTS {
            let t = self.duration_s * f64::from(k) / f64::from(POINTS);
            theta.push((cursor.at(Time::from_seconds(t))?.position - start) / self.unit.1);
        }
        let mut svg = String::new();
        let (width, height) = SIZE;
        let title = shortened(self.title);
        // Writing to a String cannot fail.
        let _ = writeln!(
            svg,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"15\">\n\
             <rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n\
             <text x=\"{}\" y=\"34\" font-family=\"monospace\" font-size=\"16\">{}</text>",
            width / 2.0 - 4.8 * title.chars().count() as f64,
            escaped(&title)
        );
        self.curve(&mut svg, &theta);
        self.pulses(&mut svg);
        self.wheel(&mut svg);
        svg.push_str("</svg>\n");
        Ok(svg)
    }

    fn curve(&self, svg: &mut String, theta: &[f64]) {
        let [left, top, right, bottom] = CURVE;
        let (least, most) = theta.iter().fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(*x), b.max(*x)));
        let span = (most - least).max(f64::MIN_POSITIVE);
        let y = |theta: f64| bottom - (bottom - top) * (theta - least) / span;
        let x = |k: usize| left + (right - left) * k as f64 / f64::from(POINTS);
        let points: Vec<String> =
            theta.iter().enumerate().map(|(k, theta)| format!("{:.1},{:.1}", x(k), y(*theta))).collect();
        let heights: Vec<String> = theta.iter().map(|theta| format!("{:.1}", y(*theta))).collect();
        let (unit, duration) = (escaped(self.unit.0), self.duration_s);
        let _ = writeln!(
            svg,
            "<path d=\"M{left} {top}V{bottom}H{right}\" fill=\"none\" stroke=\"#888\"/>\n\
             <text x=\"{left}\" y=\"{}\" text-anchor=\"middle\">θ, {unit}</text>\n\
             <text x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>\n\
             <text x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>\n\
             <text x=\"{right}\" y=\"{}\" text-anchor=\"end\">{duration} s</text>\n\
             <polyline points=\"{}\" fill=\"none\" stroke=\"#1f77b4\" stroke-width=\"2\"/>\n\
             <circle r=\"6\" cx=\"{left}\" cy=\"{}\" fill=\"#d62728\"><animate attributeName=\"cx\" values=\"{left};{right}\" dur=\"{duration}s\" \
             repeatCount=\"indefinite\"/><animate attributeName=\"cy\" values=\"{}\" dur=\"{duration}s\" \
             repeatCount=\"indefinite\"/></circle>",
            top - 12.0,
            left - 6.0,
            top + 5.0,
            short(most),
            left - 6.0,
            bottom + 5.0,
            short(least),
            bottom + 20.0,
            points.join(" "),
            heights[0],
            heights.join(";"),
        );
    }

    /// The STEP line runs through its panel; the present is in the middle.
    fn pulses(&self, svg: &mut String) {
        let [left, top, right, bottom] = PULSES;
        let fastest = self.steps.windows(2).map(|pair| pair[1].0 - pair[0].0).fold(f64::MAX, f64::min);
        let shown_s = (PULSES_AT_ONCE * fastest).min(self.duration_s);
        let scale = (right - left) / shown_s;
        let now = left + PAST * (right - left);
        let mut path = format!("M{:.1} {bottom}", now - (right - left));
        for (t, _) in self.steps {
            // A pulse is far shorter than a step: it is drawn a quarter of the shortest step wide.
            let (x, wide) = (now + t * scale, 0.25 * fastest.min(shown_s) * scale);
            let _ = write!(path, "H{x:.1}V{top}h{wide:.1}V{bottom}");
        }
        let _ = write!(path, "H{:.1}", now + self.duration_s * scale + (right - left));
        let way = self.duration_s * scale;
        let _ = writeln!(
            svg,
            "<clipPath id=\"line\"><rect x=\"{left}\" y=\"{}\" width=\"{}\" height=\"{}\"/></clipPath>\n\
             <text x=\"{}\" y=\"{}\" text-anchor=\"middle\">STEP</text>\n\
             <g clip-path=\"url(#line)\"><path d=\"{path}\" fill=\"none\" stroke=\"#1f77b4\" stroke-width=\"1.5\">\
             <animateTransform attributeName=\"transform\" type=\"translate\" values=\"0 0;{:.1} 0\" dur=\"{}s\" \
             repeatCount=\"indefinite\"/></path></g>\n\
             <path d=\"M{now} {}V{}\" stroke=\"#d62728\"/>",
            top - 4.0,
            right - left,
            bottom - top + 8.0,
            0.5 * (left + right),
            top - 14.0,
            -way,
            self.duration_s,
            top - 8.0,
            bottom + 8.0,
        );
    }

    /// The wheel jumps with each step, as a motor's does.
    fn wheel(&self, svg: &mut String) {
        let (x, y, radius) = WHEEL;
        let (mut times, mut angles) = ("0".to_owned(), format!("0 {x} {y}"));
        for (t, position) in self.steps.iter().filter(|(t, _)| *t < self.duration_s) {
            let angle = *position as f64 * 360.0 / self.steps_per_turn;
            let _ = write!(times, ";{:.6}", t / self.duration_s);
            let _ = write!(angles, ";{angle:.2} {x} {y}");
        }
        let _ = writeln!(
            svg,
            "<g><circle cx=\"{x}\" cy=\"{y}\" r=\"{radius}\" fill=\"#eee\" stroke=\"#444\" stroke-width=\"2\"/>\
             <path d=\"M{x} {y}V{}\" stroke=\"#d62728\" stroke-width=\"5\"/><circle cx=\"{x}\" cy=\"{y}\" r=\"7\"/>\
             <animateTransform attributeName=\"transform\" type=\"rotate\" calcMode=\"discrete\" keyTimes=\"{times}\" \
             values=\"{angles}\" dur=\"{}s\" repeatCount=\"indefinite\"/></g>",
            y - radius + 6.0,
            self.duration_s,
        );
    }
}

/// A number of an axis, as short as it can be read.
fn short(value: f64) -> String {
    pulsetrain_motion::human::significant(value, 3)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moving_picture_has_each_step_and_ends_where_the_law_does() {
        let law = Law::speed(10.0, Some(Time::SECOND)).unwrap();
        let steps: Vec<(f64, i64)> = (1..=10).map(|k| (0.1 * k as f64 - 0.05, k)).collect();
        let moving = Moving {
            title: "law.speed = \"1 rev/s\" & <more>",
            law: &law,
            unit: ("rev", 10.0),
            steps_per_turn: 10.0,
            steps: &steps,
            duration_s: 1.0,
        };
        let svg = moving.svg().unwrap();
        assert!(svg.starts_with("<svg") && svg.ends_with("</svg>\n"), "{svg}");
        assert!(svg.contains("&amp; &lt;more&gt;"));
        // Ten pulses, ten places of the wheel after the first, and the last is a whole turn.
        assert_eq!(svg.matches("V120h").count(), 10);
        assert!(svg.contains("0;0.050000;0.150000") && svg.contains("360.00 830 160\" dur"), "{svg}");
    }
}
