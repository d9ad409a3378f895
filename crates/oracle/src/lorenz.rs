//! The Lorenz equations, by another method than the planner's law: extrapolated midpoint steps.

use crate::crossing::{BITS, Rational, Real, real};

/// x' = σ(y − x), y' = x(ρ − z) − y, z' = xy − βz, from `start`.
///
/// W. B. Gragg's modified midpoint rule with 2, 4, … 24 substeps, extrapolated to none in their squares (R. Bulirsch, J.
/// Stoer, "Numerical treatment of ordinary differential equations by extrapolation methods", Numer. Math. 8, 1966): the error
/// of a step of 1/64 time unit is of order 25 in it.
#[derive(Clone, Debug)]
pub struct Lorenz {
    /// σ, without a unit.
    pub sigma: Rational,
    /// ρ, without a unit.
    pub rho: Rational,
    /// β, without a unit.
    pub beta: Rational,
    /// x, y and z at the beginning.
    pub start: [Rational; 3],
}

/// Integration steps in a unit of time: the error of a step is of the order of (1/64)^25.
const STEPS: u32 = 64;
/// Rows of the extrapolation: 2, 4, … 24 substeps.
const ROWS: u32 = 12;

type State = [Real; 3];

impl Lorenz {
    /// The state at 0, 1/64, 2/64, … units of time.
    pub fn states(&self) -> impl Iterator<Item = [f64; 3]> + '_ {
        let parameters = [real(&self.sigma), real(&self.rho), real(&self.beta)];
        let start = self.start.each_ref().map(real);
        let states = std::iter::successors(Some(start), move |state| Some(step(&parameters, state)));
        states.map(|state| state.each_ref().map(|x| x.to_f64().value()))
    }
}

/// The derivatives of a state.
fn slope([sigma, rho, beta]: &[Real; 3], [x, y, z]: &State) -> State {
    [sigma * (y - x), x * (rho - z) - y, x * y - beta * z]
}

/// a + by·b.
fn plus(a: &State, b: &State, by: &Real) -> State {
    [&a[0] + &b[0] * by, &a[1] + &b[1] * by, &a[2] + &b[2] * by]
}

/// The state one integration step later.
fn step(parameters: &[Real; 3], state: &State) -> State {
    let whole = |n: u32| Real::from(n).with_precision(BITS).value();
    let span = whole(1) / whole(STEPS);
    // Neville's table, a row at a time: column j of row i is free of the first j powers of the substep's square.
    let mut row: Vec<State> = Vec::new();
    for i in 1..=ROWS {
        let mut next = vec![midpoints(parameters, state, &span, 2 * i)];
        for j in 1..i {
            let ratio = whole(i * i) / whole((i - j) * (i - j));
            let by = whole(1) / (ratio - whole(1));
            let (better, before) = (&next[j as usize - 1], &row[j as usize - 1]);
            let change = plus(better, before, &-whole(1));
            let extrapolated = plus(better, &change, &by);
            next.push(extrapolated);
        }
        row = next;
    }
    row.pop().expect("a table of at least one row")
}

/// Gragg's rule, in `n` substeps, n even.
fn midpoints(parameters: &[Real; 3], state: &State, span: &Real, n: u32) -> State {
    let substep = span / Real::from(n).with_precision(BITS).value();
    let twice = &substep + &substep;
    let (mut before, mut here) = (state.clone(), plus(state, &slope(parameters, state), &substep));
    for _ in 1..n {
        let next = plus(&before, &slope(parameters, &here), &twice);
        (before, here) = (here, next);
    }
    let last = plus(&before, &slope(parameters, &here), &substep);
    let half = Real::from(1).with_precision(BITS).value() / Real::from(2);
    let sum = plus(&here, &last, &Real::from(1));
    sum.map(|x| x * &half)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rational;

    /// With σ = 1, ρ = 0 and x = y = 0, z falls by e^-β a unit: the exponential judges the method.
    #[test]
    fn a_decay_is_an_exponential() {
        let zero = rational(0, 1);
        let start = [zero.clone(), zero.clone(), rational(1, 1)];
        let decay = Lorenz { sigma: rational(1, 1), rho: zero, beta: rational(8, 3), start };
        let z = decay.states().nth(2 * STEPS as usize).expect("an endless orbit")[2];
        assert!((z - (-16.0_f64 / 3.0).exp()).abs() < 1e-17, "{z}");
    }
}
