//! Jets of all curves against an oracle of 500 bits: divided differences of values that it computes itself.

use dashu::float::FBig;
use proptest::prelude::*;
use pulsetrain_motion::law::{Curve, Ease, Interpolation, Piece, SCurve, TimerRamp};
use pulsetrain_motion::time::Rate;
use pulsetrain_motion::{Law, Time};

type Wide = FBig<dashu::float::round::mode::HalfEven, 2>;

const BITS: usize = 500;

fn wide(x: f64) -> Wide {
    Wide::try_from(x).unwrap().with_precision(BITS).value()
}

/// 2^-64 × `raw`.
fn seconds(t: Time) -> Wide {
    Wide::from(t.raw()).with_precision(BITS).value() / wide(18_446_744_073_709_551_616.0)
}

/// The first eight Taylor coefficients of `f` at `t`, from 17 points around it.
fn coefficients(f: &dyn Fn(Wide) -> Wide, t: &Wide) -> Vec<Wide> {
    let h = wide(2f64.powi(-24));
    let node = |j: usize| wide(j as f64 - 8.0) * &h;
    let mut divided: Vec<Wide> = (0..17).map(|j| f(t.clone() + node(j))).collect();
    for order in 1..17 {
        for j in (order..17).rev() {
            divided[j] = (divided[j].clone() - &divided[j - 1]) / (node(j) - node(j - order));
        }
    }
    // Newton's form to powers of the distance from t.
    let mut c = vec![wide(0.0); 17];
    for j in (0..17).rev() {
        for k in (1..17).rev() {
            c[k] = c[k - 1].clone() - &c[k] * node(j);
        }
        c[0] = &divided[j] - c[0].clone() * node(j);
    }
    c.truncate(8);
    c
}

/// Every coefficient of the piece's jet at `part` of it is within the piece's rounding of the law's.
fn check(what: &str, piece: &Piece, part: f64, f: &dyn Fn(Wide) -> Wide) {
    let (first, last) = (piece.first(), piece.last());
    let u = first + part * (last - first);
    let bounds = piece.curve.bounds(first, last);
    let jet = piece.curve.jet(u);
    let exact = coefficients(f, &(seconds(piece.zero) + wide(u)));
    for k in 0..8 {
        let origin = if k == 0 { wide(piece.origin as f64) } else { wide(0.0) };
        let off = (origin + wide(jet[k]) - &exact[k]).to_f64().value().abs();
        assert!(off <= bounds.rounding[k], "{what}, coefficient {k} at u = {u}: {off:e} > {:e}", bounds.rounding[k]);
    }
}

type KnownFormula = (&'static str, fn(Wide) -> Wide);

/// Each function at least once, in arguments that are sinusoids, polynomials, and neither.
const FORMULAS: [KnownFormula; 14] = [
    ("1000*t + 300*sin(7*t) + 50*cos(31*t + 1)", |t| {
        wide(1000.0) * &t + wide(300.0) * (wide(7.0) * &t).sin() + wide(50.0) * (wide(31.0) * t + wide(1.0)).cos()
    }),
    ("sin(3*t)^2*cos(5*t)", |t| {
        let s = (wide(3.0) * &t).sin();
        s.clone() * s * (wide(5.0) * t).cos()
    }),
    ("(t - 3)^5 - 7*t^3 + 0.5", |t| {
        let x = t.clone() - wide(3.0);
        x.powi(5.into()) - wide(7.0) * t.powi(3.into()) + wide(0.5)
    }),
    ("200*exp(-t/3)*sin(9*t + sin(t))", |t| {
        wide(200.0) * (-t.clone() / wide(3.0)).exp() * (wide(9.0) * &t + t.sin()).sin()
    }),
    ("cos(t^2)", |t| (t.clone() * t).cos()),
    ("ln(2 + sin(t))", |t| (wide(2.0) + t.sin()).ln()),
    ("100*sqrt(1 + t^2)", |t| wide(100.0) * (wide(1.0) + &t * &t).sqrt()),
    ("(1.5 + cos(2*t))^0.75", |t| (wide(1.5) + (wide(2.0) * t).cos()).powf(&wide(0.75))),
    ("(2 + t)^-3", |t| wide(1.0) / (wide(2.0) + t).powi(3.into())),
    ("asin(0.75*sin(t))", |t| (wide(0.75) * t.sin()).asin()),
    ("300*atan(t - 2)", |t| wide(300.0) * (t - wide(2.0)).atan()),
    ("tanh(t - 1)*10", |t| (t - wide(1.0)).tanh() * wide(10.0)),
    ("(1 + t)^sin(t)", |t| (t.sin() * (wide(1.0) + &t).ln()).exp()),
    ("(3*t + 1)/(2 + cos(t))", |t| (wide(3.0) * &t + wide(1.0)) / (wide(2.0) + t.cos())),
];

/// θ of a curve as its parameters say, for curves whose parameters are exact.
fn exact(curve: &Curve, u: Wide) -> Wide {
    match curve {
        Curve::Polynomial(c) => c.iter().rev().fold(wide(0.0), |sum, &c| sum * &u + wide(c)),
        Curve::Cosine { offset, amplitude, omega, phase } => {
            wide(*offset) + wide(*amplitude) * (wide(*omega) * u + wide(*phase)).cos()
        }
        Curve::TimerRamp { u0, x0, factor, linear, quadratic } => {
            let (b, a) = (wide(*linear), wide(*quadratic));
            let root = (b.clone() * &b + wide(4.0) * &a * (u - wide(*u0))).sqrt();
            wide(*x0) + wide(*factor) * (root - b) / (wide(2.0) * a)
        }
        Curve::Sum(curves) => curves.iter().fold(wide(0.0), |sum, c| sum + exact(c, u.clone())),
        Curve::Warped { curve, time } => exact(curve, time.iter().rev().fold(wide(0.0), |sum, &c| sum * &u + wide(c))),
        Curve::Faded { old, new, weight } => {
            let from = exact(old, u.clone());
            let by = exact(new, u.clone()) - &from;
            from + by * weight.iter().rev().fold(wide(0.0), |sum, &c| sum * &u + wide(c))
        }
        Curve::Accurate { curve, .. } => exact(curve, u),
        Curve::Formula(_) | Curve::Joint(_) => unreachable!("formulas and arms have their own tests"),
    }
}

/// How many there are: each as it is, warped in five ways, and faded into the next one, also in the middle of another fade.
const LAWS: usize = 6 * 6 + 2 * 6;

fn laws() -> Vec<Law> {
    let ramp = TimerRamp { steps: 400, tick_s: 8e-6, start_count: 255, cruise_count: 18, accelerate_during: 100 };
    let s =
        SCurve { distance: 9000.0, max_speed: 3000.0, max_acceleration: 9000.0, max_jerk: 1e5, start_speed: -500.0 };
    let sine = Law::sine(2000.0, Time::from_seconds(0.7), Some(2)).unwrap();
    let ramp = Law::timer_ramp(ramp).unwrap();
    let eased = |law: &Law| {
        let at = |part: u64| law.end().unwrap().times(part).divided_by(10);
        let out = law.clone().eased_out(at(1), at(1), at(5)).unwrap();
        let back = law.clone().eased_in(at(4), at(7)).unwrap();
        let twice = back.clone().eased_out(at(0), at(2), at(3)).unwrap();
        let to = |before: f64, rate: f64| {
            let (before, to) = (Rate::of(before).unwrap(), Rate::of(rate).unwrap());
            law.clone().retimed(at(1), Ease { before, after: at(1), over: at(2), to }).unwrap()
        };
        [out, back, twice, to(1.0, 0.3), to(0.7, 3.1)]
    };
    let mut laws = vec![
        sine.clone(),
        Law::trapezoid(-5000.0, 900.0, 700.0, 1100.0).unwrap(),
        Law::s_curve(s).unwrap(),
        ramp.clone(),
        Law::table(&[(0.0, 0.0), (0.3, 200.0), (1.0, 250.0), (1.5, -90.0)], Interpolation::Monotone).unwrap(),
        Law::sum(vec![sine, Law::speed(123.4, Some(Time::SECOND)).unwrap(), ramp.scaled(2.5).unwrap()]).unwrap(),
    ];
    let plain = laws.clone();
    laws.extend(plain.iter().flat_map(eased));
    for (place, law) in plain.iter().enumerate() {
        let next = |by: usize| plain[(place + by) % plain.len()].clone();
        let faded = law.clone().faded(next(1), Time::from_seconds(0.2), Time::from_seconds(0.5)).unwrap();
        laws.push(faded.clone().faded(next(2), Time::from_seconds(0.45), Time::from_seconds(0.6)).unwrap());
        laws.push(faded);
    }
    laws
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, ..ProptestConfig::default() })]

    #[test]
    fn formulas_are_within_their_rounding(which in 0..FORMULAS.len(), index in 0_usize..12, part in 0.0_f64..1.0) {
        let (text, f) = FORMULAS[which];
        let law = Law::formula(text, &[], 1.0, None).unwrap();
        let piece = law.pieces().nth(index).unwrap().unwrap();
        check(text, &piece, part, &f);
    }

    #[test]
    fn curves_are_within_their_rounding(which in 0_usize..LAWS, index in 0_usize..30, part in 0.0_f64..1.0) {
        let law = &laws()[which];
        let pieces: Vec<Piece> = law.pieces().map(Result::unwrap).collect();
        let piece = &pieces[index % pieces.len()];
        let zero = seconds(piece.zero);
        let origin = wide(piece.origin as f64);
        check(&format!("{:?}", piece.curve), piece, part, &|t| origin.clone() + exact(&piece.curve, t - &zero));
    }

    #[test]
    fn curves_remainders_are_within_the_eighth(which in 0_usize..LAWS, index in 0_usize..30, from in 0.0_f64..1.0, to in 0.0_f64..1.0) {
        let law = &laws()[which];
        let pieces: Vec<Piece> = law.pieces().map(Result::unwrap).collect();
        let piece = &pieces[index % pieces.len()];
        let (first, last) = (piece.first(), piece.last());
        let (u, v) = (first + from * (last - first), first + to * (last - first));
        let bounds = piece.curve.bounds(u.min(v), u.max(v));
        let x = wide(v) - wide(u);
        let jet = piece.curve.jet(u);
        let taylor = jet.iter().rev().fold(wide(0.0), |sum, &c| sum * &x + wide(c));
        let off = (exact(&piece.curve, wide(v)) - taylor).to_f64().value().abs();
        let x = x.to_f64().value().abs();
        let rounding = bounds.rounding.iter().rev().fold(0.0, |sum, r| sum * x + r);
        let bound = (bounds.eighth * x.powi(8) + rounding) * (1.0 + 1e-12);
        prop_assert!(off <= bound, "{off:e} > {bound:e}: {:?}", piece.curve);
    }
}
