//! The law of a delta robot's arm, from the path of its effector.

use super::combine::{MOST_PARTS, too_many};
use super::{Curve, Double, Law, LawError, Piece, Pieces};
use crate::Time;
use crate::machine::Delta;

impl Law {
    /// What arm 0, 1 or 2 of `robot` does while the effector follows x, y and z, in mm, which end and are polynomials piece
    /// by piece (tables, lines): its angle times `steps_per_rad`.
    ///
    /// Each stretch of polynomials becomes a formula: crossings are enclosed, and an arm that does not reach is an error of
    /// the law's [`pieces`](Law::pieces).
    ///
    /// # Errors
    /// [`LawError::Parameter`] if they never end, or have pieces that are no polynomials or more than 2^20; and their own.
    pub fn delta_arm(robot: &Delta, arm: usize, tip: &[Law; 3], steps_per_rad: f64) -> Result<Law, LawError> {
        if tip.iter().any(|law| law.end().is_none()) {
            return Err(LawError::Parameter("the path never ends".into()));
        }
        let mut terms: [(Pieces, Option<Piece>); 3] = [0, 1, 2].map(|k| (tip[k].pieces(), None));
        let (mut at, mut laws) = (Time::ZERO, Vec::new());
        'stretches: loop {
            for (pieces, piece) in &mut terms {
                while piece.as_ref().is_none_or(|piece| piece.end <= at) {
                    match pieces.next() {
                        Some(next) => *piece = Some(next?),
                        None => break 'stretches,
                    }
                }
            }
            if laws.len() == MOST_PARTS {
                return Err(too_many("to follow"));
            }
            let ends = terms.iter().filter_map(|(_, piece)| piece.as_ref().map(|piece| piece.end));
            let Some(end) = ends.min() else { break };
            let mut texts = [const { String::new() }; 3];
            for (text, (_, piece)) in texts.iter_mut().zip(&terms) {
                if let Some(piece) = piece {
                    *text = in_powers_of_t(piece, at)?;
                }
            }
            let text = robot.formula(arm, [&texts[0], &texts[1], &texts[2]]);
            let law = Law::formula(&text, &[], steps_per_rad, Some(end - at));
            laws.push(law.map_err(|error| LawError::Parameter(error.message))?);
            at = end;
        }
        Law::then(laws)
    }
}

/// A piece as the text of a polynomial of the time since `start`.
fn in_powers_of_t(piece: &Piece, start: Time) -> Result<String, LawError> {
    let mut curve = piece.curve.clone();
    curve.rezero(Double::from(start) - Double::from(piece.zero));
    let Curve::Polynomial(mut c) = curve.plain() else {
        return Err(LawError::Parameter("a part of the path is no polynomial".into()));
    };
    c.resize(c.len().max(1), 0.0);
    c[0] += piece.origin as f64;
    let mut terms = c.iter().rev();
    let highest = terms.next().map_or_else(String::new, |c| format!("({c:?})"));
    Ok(terms.fold(highest, |text, c| format!("({text}*t + ({c:?}))")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::{Cursor, Interpolation};

    #[test]
    fn an_arm_follows_a_table() {
        let robot = Delta { base_mm: 60.0, upper_arm_mm: 70.0, forearm_mm: 150.0, effector_mm: 25.0 };
        let coordinate = |values: [f64; 4]| {
            let rows: Vec<(f64, f64)> = [0.0, 0.5, 1.25, 2.0].into_iter().zip(values).collect();
            Law::table(&rows, Interpolation::Monotone).unwrap()
        };
        let tip = [
            coordinate([0.0, 30.0, 30.0, -20.0]),
            coordinate([0.0, 10.0, -40.0, -40.0]),
            coordinate([-150.0, -140.0, -160.0, -150.0]),
        ];
        for arm in 0..3 {
            let law = Law::delta_arm(&robot, arm, &tip, 500.0).unwrap();
            assert_eq!(law.end(), Some(Time::from_seconds(2.0)));
            let mut cursor = Cursor::new(&law);
            let mut cursors = tip.each_ref().map(Cursor::new);
            for k in 0..=200 {
                let t = Time::from_seconds(f64::from(k) / 100.0);
                let point = cursors.each_mut().map(|cursor| cursor.at(t).unwrap().position);
                let wanted = robot.angles(point).unwrap()[arm] * 500.0;
                assert!((cursor.at(t).unwrap().position - wanted).abs() < 1e-8, "arm {arm} at {} s", t.seconds());
            }
        }
    }
}
