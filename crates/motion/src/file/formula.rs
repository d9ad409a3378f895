//! Formula laws: θ(t) in text with named parameters.

use super::laws::Context;
use super::reader::{Node, Read};
use crate::Time;
use crate::law::Law;
use crate::quantity::Base;

impl Context<'_> {
    pub(super) fn formula(&self, node: &Node) -> Read<Law> {
        let p = self.parameters(node, &["theta", "unit", "duration", "where"])?;
        let theta = p.need("theta", "theta = \"a*sin(2*pi*t)\"")?;
        let unit = p.need("unit", "unit = \"rev\"").and_then(|node| self.unit(&node));
        let duration = p.get("duration").map(|node| node.duration("10 s")).transpose();
        let steps_per_unit = unit?;
        let parameters = match p.get("where") {
            Some(node) => self.formula_parameters(&node, steps_per_unit),
            None => Ok(Vec::new()),
        };
        let text = theta.text("theta = \"a*sin(2*pi*t)\"")?;
        self.formula_of(&theta, text, &parameters?, steps_per_unit, duration?)
    }

    /// The law of a formula whose `text` is written at `node`.
    pub(super) fn formula_of(
        &self,
        node: &Node,
        text: &str,
        parameters: &[(String, f64)],
        steps_per_unit: f64,
        duration: Option<Time>,
    ) -> Read<Law> {
        Law::formula(text, parameters, steps_per_unit, duration).map_err(|error| {
            let at = node.inside(error.offset, error.length);
            self.reader.note(at, "here", format!("formula: {}", error.message), "")
        })
    }

    /// `where = { … }`: positions in the formula's unit, times in s, frequencies in Hz, bare numbers as they are.
    pub(super) fn formula_parameters(&self, node: &Node, steps_per_unit: f64) -> Read<Vec<(String, f64)>> {
        let section = node.any_section("the formula's parameters".to_owned(), "where = { a = 3, w = \"2 Hz\" }")?;
        let read = section.nodes().into_iter().map(|node| {
            let value = match node.as_number() {
                Some(number) => number,
                None => {
                    let quantity = node.quantity("2 Hz")?;
                    match quantity.base {
                        base if base.is_position() => {
                            quantity.value * self.gearing.steps_per(&node, base)? / steps_per_unit
                        }
                        Base::Time | Base::Cycle => quantity.value,
                        _ => {
                            let message = format!("a formula has no use for {}", quantity.kind());
                            let help = "parameters are numbers, positions, speeds, times or frequencies";
                            return Err(node.note("not this", message, help));
                        }
                    }
                }
            };
            Ok((node.key.to_owned(), value))
        });
        // All of them, so that every bad one is noted.
        let read: Vec<Read<(String, f64)>> = read.collect();
        read.into_iter().collect()
    }
}
