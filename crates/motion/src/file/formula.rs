//! Formula laws: θ(t) in text with named parameters.

use super::context::Context;
use super::reader::{Node, Read};
use crate::Time;
use crate::law::Law;
use crate::law::double::Double;
use crate::law::formula::dimension::{Amount, Dimension, Parameter, Unit, WrittenUnit};
use crate::law::formula::taken;
use crate::quantity::{Base, Quantity};

impl Context<'_> {
    pub(super) fn formula(&self, node: &Node) -> Read<Law> {
        let p = self.parameters(node, &["theta", "unit", "duration", "where"])?;
        let theta = p.need("theta", "theta = \"a*sin(2*pi*t)\"")?;
        let unit = p.need("unit", "unit = \"rev\"").and_then(|node| self.formula_unit(&node));
        let duration = p.get("duration").map(|node| node.duration("10 s")).transpose();
        let unit = unit?;
        let parameters = match p.get("where") {
            Some(node) => self.formula_parameters(&node, &unit),
            None => Ok(Vec::new()),
        };
        let text = theta.text("theta = \"a*sin(2*pi*t)\"")?;
        self.formula_of(&theta, text, &parameters?, &unit, duration?)
    }

    /// The law of a formula whose `text` is written at `node`.
    pub(super) fn formula_of(
        &self,
        node: &Node,
        text: &str,
        parameters: &[Parameter],
        unit: &Unit,
        duration: Option<Time>,
    ) -> Read<Law> {
        Law::formula_in(text, parameters, unit, duration).map_err(|error| {
            let at = node.inside(error.offset, error.length);
            self.reader.note(at, "here", format!("formula: {}", error.message), error.help)
        })
    }

    /// The unit of a formula's result. Where a motor has a `lead`, steps are both an angle and a length.
    pub(super) fn formula_unit(&self, node: &Node) -> Read<Unit> {
        let (one, steps) = self.position_unit(node)?;
        let of = match one.base {
            Base::Length => Dimension::LENGTH,
            Base::Step | Base::FullStep if self.gearing.steps_per_mm().is_some() => Dimension::STEPS,
            _ => Dimension::ANGLE,
        };
        let per_rad = match one.base {
            Base::Length => Double::ONE,
            _ if one.unit == "rad" => Double::ONE,
            Base::Turn => Double::from(1.0 / one.value) / Double::TAU,
            _ => Double::from(self.gearing.steps_per_turn() / steps) / Double::TAU,
        };
        let lead = self.gearing.steps_per_lead().filter(|_| one.base == Base::Length).map(|lead| lead / steps);
        Ok(Unit { name: one.unit, of, steps, per_rad, lead })
    }

    /// `where = { … }`: quantities keep what they measure, times are in s, frequencies in Hz, bare numbers are as they are.
    pub(super) fn formula_parameters(&self, node: &Node, unit: &Unit) -> Read<Vec<Parameter>> {
        let section = node.any_section("the formula's parameters".to_owned(), "where = { a = 3, w = \"2 Hz\" }")?;
        let read = section.nodes().into_iter().map(|node| match (taken(node.key), node.as_number()) {
            (Some(by), _) => {
                let (key, message) =
                    (node.key, format!("`{}` is {by} in every formula: no parameter can have this name", node.key));
                let help = format!("give it another name, such as `{key}_1`, here and in the formula");
                Err(self.reader.note(section.key_span(key), "taken", message, help))
            }
            (None, Some(number)) => Ok(Parameter::plain(node.key, number)),
            (None, None) => self.formula_quantity(&node, unit),
        });
        // All of them, so that every bad one is noted.
        let read: Vec<Read<Parameter>> = read.collect();
        read.into_iter().collect()
    }

    fn formula_quantity(&self, node: &Node, unit: &Unit) -> Read<Parameter> {
        let percents = node.as_text().and_then(|text| text.trim().strip_suffix('%')?.trim().parse::<f64>().ok());
        if let Some(percents) = percents {
            let help = format!("write {} = {}", node.key, percents / 100.0);
            return Err(node.note(
                "a percentage",
                format!("`{}`: a formula takes numbers, not percents", node.key),
                help,
            ));
        }
        let quantity = node.quantity("2 Hz")?;
        let Quantity { value, base, .. } = quantity;
        let per = ["", "/s", "/s²", "/s³"][usize::from(quantity.per_seconds.min(3))];
        let amount = |value: Double, unit: &str| Amount { value, unit: format!("{unit}{per}") };
        // A position in steps, in the formula's unit.
        let in_unit = |steps: f64| amount(Double::from(steps / unit.steps), unit.name);
        let in_rad = |turns: f64| amount(Double::TAU * Double::from(turns), "rad");
        let steps_are_lengths = unit.of.is(Dimension::LENGTH);
        let (dimension, outside, in_trig) = match base {
            Base::Turn => {
                let outside =
                    if steps_are_lengths { in_rad(value) } else { in_unit(value * self.gearing.steps_per_turn()) };
                (Dimension::ANGLE, outside, in_rad(value))
            }
            Base::Length => {
                let length = match self.gearing.steps_per_mm() {
                    Some(steps_per_mm) if !unit.of.is(Dimension::ANGLE) => in_unit(value * steps_per_mm),
                    _ => amount(Double::from(value), "mm"),
                };
                (Dimension::LENGTH, length.clone(), length)
            }
            Base::Step | Base::FullStep => {
                let steps = value * self.gearing.steps_per(node, base)?;
                let in_trig = if unit.of.is(Dimension::ANGLE) {
                    in_rad(steps / self.gearing.steps_per_turn())
                } else {
                    in_unit(steps)
                };
                (unit.of, in_unit(steps), in_trig)
            }
            Base::Time | Base::Cycle => {
                let plain =
                    Amount { value: Double::from(value), unit: if base == Base::Time { "s" } else { "Hz" }.to_owned() };
                (Dimension::PLAIN, plain.clone(), plain)
            }
            _ => {
                let message = format!("a formula has no use for {}", quantity.kind());
                let help = "parameters are numbers, positions, speeds, times or frequencies";
                return Err(node.note("not this", message, help));
            }
        };
        Ok(Parameter {
            name: node.key.to_owned(),
            written: node.as_text().unwrap_or_default().trim().to_owned(),
            dimension,
            scale: Some(WrittenUnit {
                number: quantity.number,
                per_s: quantity.per_s,
                base,
                in_turns: quantity.is_in_turns(),
            }),
            is_rate: quantity.per_seconds > 0 && base.is_position(),
            outside,
            in_trig,
        })
    }
}
