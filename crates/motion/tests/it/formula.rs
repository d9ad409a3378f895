//! Formulas: the language, its errors, and what planning rests on: jets, enclosures, windows.

use proptest::prelude::*;
use pulsetrain_motion::law::{Class, Cursor, Curve, FormulaFunction, Piece, formula_functions};
use pulsetrain_motion::{Law, LawError, Time, file};
use std::f64::consts::{PI, TAU};

fn law(text: &str) -> Law {
    Law::formula(text, &[("a".into(), 2.5), ("width".into(), 4.0)], 1.0, Some(Time::from_seconds(8.0))).unwrap()
}

fn at(text: &str, t: f64) -> f64 {
    Cursor::new(&law(text)).at(Time::from_seconds(t)).unwrap().position
}

#[track_caller]
fn check(text: &str, t: f64, expected: f64) {
    let got = at(text, t);
    assert!((got - expected).abs() <= 1e-12 * (1.0 + expected.abs()), "{text} at {t}: {got}, not {expected}");
}

#[test]
fn precedence() {
    check("-2^2", 0.0, -4.0);
    check("2^3^2", 0.0, 512.0);
    check("2^-1", 0.0, 0.5);
    check("1 - 2 - 3", 0.0, -4.0);
    check("8 / 4 / 2", 0.0, 1.0);
    check("2*-3", 0.0, -6.0);
    check("1e3 + .5", 0.0, 1000.5);
    check("(1 + 2)*3*a", 0.0, 22.5);
    check("if(0 < t < 2 and not t > 1 or 1 == 2, 3*t, 3)", 0.5, 1.5);
    check("2**3**2", 0.0, 512.0);
    check("-t²", 3.0, -9.0);
    check("2^t²", 3.0, 512.0);
    check("sin(t)² + cos(t)²", 0.7, 1.0);
    check("(t + 1)³ − 2·t × 3 ÷ 2", 1.0, 5.0);
    check("10⁻² + (1 + t)⁻¹", 1.0, 0.51);
    check("2^-t²", 1.0, 0.5);
    check("PI - π + Pi - pi + τ - tau", 0.0, 0.0);
    check("if(t ≤ 1 && t ≥ 1 || t ≠ 1, 1, 0)", 1.0, 1.0);
    check("e^t", 1.0, std::f64::consts::E);
    check("max(1, 5, 3, t) + min(4, 2, 7)", 0.5, 7.0);
    check("a - 1 - 2 - 3 + 4", 0.0, 0.5);
}

#[test]
fn values() {
    let t = 0.7_f64;
    for (text, expected) in [
        ("sin(t)*cos(t)*tan(t)", t.sin() * t.sin()),
        ("asin(t/2) + acos(t/2)", std::f64::consts::FRAC_PI_2),
        ("atan(t)*t", t.atan() * t),
        ("atan2(t, -1)", t.atan2(-1.0)),
        ("atan2(-t, 0.1)", (-t).atan2(0.1)),
        ("sinh(t) + cosh(t) - exp(t) + tanh(t)", t.tanh()),
        ("ln(1 + t) * log(2 + t)", t.ln_1p() * (2.0 + t).ln()),
        ("sqrt(1 + t) * pow(1 + t, 1.5) / (1 + t)^2.0", 1.0),
        ("hypot(1 + t, 2)", (1.0 + t).hypot(2.0)),
        ("(1 + t)^t", (1.0 + t).powf(t)),
        ("(2 + sin(t))^-3", (2.0 + t.sin()).powi(-3)),
        ("abs(t - 5) + min(t, 3) + max(t, 3) + clamp(t, 1, 2)", 4.3 + 0.7 + 3.0 + 1.0),
        ("floor(a) + ceil(a) + round(a) + mod(-1, 3) + sign(-2)", 2.0 + 3.0 + 3.0 + 2.0 - 1.0),
        ("piecewise(t < 0.5, 1, t < 1, 1, 1) + e - e + pi - tau/2", 1.0),
        ("exp(-t)*t^3 + 7", (-t).exp() * t * t * t + 7.0),
    ] {
        check(text, t, expected);
    }
}

#[track_caller]
fn refused(text: &str, place: &str, message: &str) {
    let error = Law::formula(text, &[("a".into(), 2.5), ("width".into(), 4.0)], 1.0, None).unwrap_err();
    assert_eq!(&text[error.offset..error.offset + error.length], place, "{error:?}");
    assert!(error.message.contains(message), "{error:?}");
}

#[test]
fn errors_point_at_the_place() {
    refused("2*t + sni(t)", "sni", "did you mean `sin`?");
    refused("widht*t", "widht", "did you mean `width`?");
    refused("2*(t + 1", "(", "never closed");
    refused("sin(2*pi*t + cos(3*t)", "(", "never closed");
    refused("sin(", "(", "never closed");
    refused("2*t + ", "", "is expected here");
    refused("2 t", "t", "write `2*t`");
    refused("sin(2πt)", "π", "write `2*π*t`");
    refused("sin(2*πt)", "πt", "write `π*t`");
    refused("90*sin(τf(t))", "τf", "write `τ*f(…)`");
    refused("x = 3*t", "x", "a formula has no `x =`");
    refused("theta=90*sin(t)", "theta", "a formula has no `theta =`");
    refused("x == 3", "x", "is unknown");
    refused("2 3", "3", "an operator or the end");
    refused("2*(t 3)", "3", "an operator or `)`");
    refused("sin(t, 2)", "sin(t, 2)", "takes 1 argument; here are 2");
    refused("atan2(t)", "atan2(t)", "takes 2 arguments; here are 1");
    refused("rand()", "rand", "is unknown");
    refused("sin()", "sin()", "takes 1 argument; here are 0");
    refused("t < 2", "t < 2", "this is a condition");
    refused("if(t, 1, 2)", "t", "this is a number");
    refused("sin + 1", "sin", "is a function");
    refused("1e999*t", "1e999", "no number");
    refused(&"(".repeat(5000), "(", "nested more than");
    refused("piecewise(t < 2, 1)", "piecewise(t < 2, 1)", "for all other times");
    refused("", "", "is empty");
    refused("  ", "  ", "is empty");
}

/// Each mistake, where the error points, and what it says to write.
#[test]
fn what_was_meant_is_said_at_the_place() {
    for (text, place, write) in [
        ("sn(t)", "sn", "did you mean `sin`?"),
        ("cs(t)", "cs", "did you mean `cos`?"),
        ("snh(t)", "snh", "did you mean `sinh`?"),
        ("Sin(t)", "Sin", "did you mean `sin`?"),
        ("SQRT(t)", "SQRT", "did you mean `sqrt`?"),
        ("foo(t)", "foo", "`pulsetrain formula --list`"),
        ("sn(t)", "sn", "docs/formulas.md"),
        ("T*2", "T", "did you mean `t`?"),
        ("np.sin(t)", "np.sin", "write `sin` alone"),
        ("math.sin(t)", "math.sin", "write `sin` alone"),
        ("Math.sin(t)", "Math.sin", "write `sin` alone"),
        ("2*np.pi*t", "np.pi", "write `pi` alone"),
        ("Math.PI*t", "Math.PI", "write `pi` alone"),
        ("numpy.arcsin(t/9)", "numpy.arcsin", "write `asin(x)`"),
        ("scipy.signal.sawtooth(t)", "scipy.signal.sawtooth", "write `mod(t, T)/T`"),
        ("t < 1 ? 2 : 3", "?", "write `if(t < 1, a, b)`"),
        ("2*(t < 1 ? 2 : 3)", "?", "a choice is written with if"),
        ("where(t < 1, 2, 3)", "where", "write `if(condition, a, b)`"),
        ("np.where(t < 1, 2, 3)", "np.where", "write `if(condition, a, b)`"),
        ("IF(t < 1, 2, 3)", "IF", "did you mean `if`?"),
        ("if t < 1 then 2 else 3", "if", "write `if(t)`"),
        ("2*t if t < 1 else 3", "if", "write `if(condition, a, b)`"),
        ("90 sin(t)", "s", "write `90*sin(…)`"),
        ("2t", "t", "write `2*t`"),
        ("2π", "π", "write `2*pi`"),
        ("t(2 + t)", "(", "write `t*(…)`"),
        ("(t + 1)(t + 2)", "(", "write `(t + 1)*(…)`"),
        ("(t + 1)2.5", "2.5", "write `(…)*2.5`"),
        ("sin²(2*t)", "sin²", "write `sin(2*t)^2`"),
        ("sin^2(2*t)", "sin^2", "write `sin(2*t)^2`"),
        ("sin**2(2*t)", "sin**2", "write `sin(2*t)^2`"),
        ("tan^-1(t)", "tan^-1", "write `atan(t)` for the inverse"),
        ("sin⁻¹(t)", "sin⁻¹", "write `asin(t)` for the inverse"),
        ("sin t", "sin", "write `sin(t)`"),
        ("sin 2*pi*t + 3", "sin", "write `sin(2*pi*t)`"),
        ("(3 + cos 2*t)", "cos", "write `cos(2*t)`"),
        ("sin[t]", "sin", "round brackets"),
        ("arcsin(t/9)", "arcsin", "write `asin(x)`"),
        ("log(t, 10)", "log(t, 10)", "`log10(x)`"),
        ("lg(t)", "lg", "write `log10(x)`"),
        ("exp^t", "exp^", "write `exp(t)`"),
        ("exp^(2*t)", "exp^", "write `exp(2*t)`"),
        ("sin(90°)", "°", "where = { x = \"90 °\" }"),
        ("sin(90 deg)", "deg", "where = { x = \"90 deg\" }"),
        ("90deg*t", "deg", "a formula has none"),
        ("sin(90*deg)", "deg", "a formula has none"),
        ("5 mm*t", "mm", "where = { x = \"5 mm\" }"),
        ("t*2 s", "s", "where = { x = "),
        ("if(t = 1, 2, 3)", "=", "write `==`"),
        ("if(t === 1, 2, 3)", "===", "write `==`"),
        ("if(t <> 1, 2, 3)", "<>", "write `!=`"),
        ("if(t =< 1, 2, 3)", "=<", "write `<=`"),
        ("if(t < 1 & t > 0, 2, 3)", "&", "write `and`"),
        ("if(t < 1 | t > 0, 2, 3)", "|", "`or`"),
        ("if(t < 1 AND t > 0, 2, 3)", "AND", "write `and`"),
        ("theta = 2*t", "theta", "write what stands behind it alone: `2*t`"),
        ("t % 3", "%", "write `mod(t, …)`"),
        ("2*t % 3", "%", "write `mod("),
        ("t*50%", "%", "write `0.5`"),
        ("t mod 3", "mod", "write `mod(t, …)`"),
        ("t // 3", "//", "write `floor(a/b)`"),
        ("rand()", "rand", "no random numbers"),
        ("t*random(1)", "random", "no random numbers"),
        ("√(t)", "√", "write `sqrt(x)`"),
        ("|t|", "|", "write `abs(x)`"),
        ("½*t", "½", "write `0.5`"),
        ("t!", "!", "no factorial"),
        ("2*t)", ")", "closes nothing"),
        ("2*[t + 1]", "[", "write `(`"),
        ("{t}", "{", "write `(`"),
        ("t ^2^", "", "is expected here"),
        ("t²^3", "^", "which power comes first?"),
        ("t * * 2", "*", "without a blank"),
        ("1_000*t", "_000", "write `1000`"),
        ("2 x t", "x", "for times write `*`"),
        ("$a*t", "$", "plain name"),
        ("\\sin(t)", "\\", "LaTeX"),
        ("sinc(t)", "sinc", "write `sin(pi*x)/(pi*x)`"),
        ("sind(t)", "sind", "radians"),
        ("degrees(t)", "degrees", "`x*180/pi`"),
        ("min(t)", "min(t)", "takes 2 to 16 arguments"),
        ("clamp(t, 1)", "clamp(t, 1)", "write `clamp(x, low, high)`"),
        ("sin(t,)", "sin(t,)", ""),
        ("a(t)", "(", "write `a*(…)`"),
        ("phi*t", "phi", "parameters here: `a`, `width`"),
    ] {
        if write.is_empty() {
            continue;
        }
        let parameters = [("a".to_owned(), 2.5), ("width".to_owned(), 4.0)];
        let error = Law::formula(text, &parameters, 1.0, Some(Time::SECOND)).unwrap_err();
        let told = format!("{}; {}", error.message, error.help);
        assert_eq!(&text[error.offset..error.offset + error.length], place, "{text}: {told}");
        assert!(told.contains(write), "{text}: {told}");
    }
}

/// A long sum, product or condition is not nested: it is played, or refused for its length.
#[test]
fn long_formulas_are_played_or_refused_for_their_length() {
    let sum = |count: usize, term: fn(usize) -> String| (0..count).map(term).collect::<Vec<_>>().join(" + ");
    for (text, t, expected) in [
        (sum(5000, |_| "t".to_owned()), 2.0, 10_000.0),
        (sum(5000, |k| format!("{k}")), 0.0, 12_497_500.0),
        (
            sum(5000, |k| format!("sin({}*t)/5000", 1 + k % 50)),
            0.1,
            (1..=50).map(|k| (0.1 * f64::from(k)).sin()).sum::<f64>() / 50.0,
        ),
        (format!("1{}", " - 2 + 3".repeat(2500)), 0.0, 2501.0),
        (format!("t{}", "*2/2".repeat(1000)), 3.0, 3.0),
        (format!("if({}t < 9, 4, 4)", "t < 9 and ".repeat(300)), 1.0, 4.0),
    ] {
        let law = Law::formula(&text, &[], 1.0, Some(Time::SECOND.times(3))).unwrap_or_else(|error| panic!("{error}"));
        let got = Cursor::new(&law).at(Time::from_seconds(t)).unwrap().position;
        assert!((got - expected).abs() <= 1e-9 * (1.0 + expected.abs()), "{}…: {got}, not {expected}", &text[..40]);
    }
    let refused = |text: &str| Law::formula(text, &[], 1.0, None).unwrap_err();
    let long = sum(50_000, |_| "t".to_owned());
    let error = refused(&long);
    assert!(error.message.contains("too long: 60000 operations at most"), "{error}");
    assert!(error.offset > 100_000 && error.length == 1, "{error:?}");
    for text in [
        format!("2{}", "^2".repeat(100_000)),
        format!("{}t", "-".repeat(100_000)),
        format!("{}t{}", "sin(".repeat(100_000), ")".repeat(100_000)),
        format!("if({}t < 1, 1, 1)", "not ".repeat(100_000)),
    ] {
        assert!(refused(&text).message.contains("nested more than 64 deep"), "{}…", &text[..20]);
    }
    let pieces = format!("piecewise({}0)", "t < 1, 0, ".repeat(101));
    assert!(refused(&pieces).message.contains("takes 1 to 201 arguments; here are 203"), "{:?}", refused(&pieces));
    let pieces = format!("piecewise({}0)", "t < 1, 0, ".repeat(100));
    assert!(Law::formula(&pieces, &[], 1.0, None).is_ok());
}

#[track_caller]
fn breaks(text: &str, at_s: f64, why: &str) {
    let pieces: Result<Vec<Piece>, LawError> = law(text).pieces().collect();
    let error = pieces.unwrap_err();
    let (LawError::Undefined { at_s: at, .. } | LawError::Jump { at_s: at, .. }) = error else { panic!("{error:?}") };
    assert!((at - at_s).abs() < 1e-9, "{error}");
    assert!(error.to_string().contains(why), "{error}");
}

#[test]
fn broken_laws_are_refused_with_the_time() {
    breaks("mod(100*t, 300)", 3.0, "jumps");
    breaks("if(t < 5, 10*t, 70)", 5.0, "jumps");
    breaks("sqrt(5 - t)*t", 5.0, "`sqrt(5 - t)`: the root of what is not positive has no speed");
    breaks("1/(t - 2)", 2.0, "`1/(t - 2)`: a division by 0");
    breaks("ln(sin(t) - 0.5*cos(3*t)^2)", 0.0, "logarithm");
    breaks("tan(t)", std::f64::consts::FRAC_PI_2, "`tan(t)`: a division by 0");
    breaks("asin(t/4)", 4.0, "arcsine");
    breaks("max(sin(t*t)^2 + cos(t*t)^2, 1)", 0.0, "is not known when this changes its sign");
    breaks("exp(exp(t))", 1e15_f64.ln().ln(), "beyond 1e15 steps");
}

/// What is so large that it has no next whole number, or is infinite: found by fuzzing, it went on for ever.
#[test]
fn wholes_that_cannot_be_told_apart_are_refused() {
    for text in
        ["mod(t, t^7)", "mod(t, 0 + t^7 )", "floor(1e300*t)", "floor(exp(1000*t))", "round(1/t)", "ceil(-1e17*t)"]
    {
        let law = Law::formula(text, &[], 200.0, Some(Time::SECOND)).unwrap();
        assert!(law.pieces().take(10_000).any(|piece| piece.is_err()), "{text} is no law");
    }
    breaks("t + 0*mod(t, t^7)", 0.0, "`mod(t, t^7)`: it is so large that its whole numbers cannot be told apart");
}

#[test]
fn branches_meet_at_their_exact_time() {
    let pieces: Vec<Piece> = law("abs(100*t - 230) + max(50*sin(2*t), 20)").pieces().collect::<Result<_, _>>().unwrap();
    let cuts: Vec<f64> = pieces.iter().map(|p| p.start.seconds()).collect();
    assert!(cuts.iter().any(|t| (t - 2.3).abs() < 1e-14), "{cuts:?}");
    let corner = (0.4_f64).asin() / 2.0;
    assert!(cuts.iter().any(|t| (t - corner).abs() < 1e-14), "{cuts:?}");
    assert!(pieces.len() < 60, "{} pieces", pieces.len());
}

#[test]
fn sums_of_sines_are_plain_curves_and_keep_their_phase_for_days() {
    let law = Law::formula("1000*t + 300*sin(7*t) + 50*sin(31*t)", &[], 1.0, None).unwrap();
    assert_eq!(law.class(), Class::Enclosed);
    let day = 86_400 * 3;
    let piece = law.pieces().find(|p| p.as_ref().is_ok_and(|p| p.end > Time::SECOND.times(day))).unwrap().unwrap();
    let Curve::Accurate { curve, .. } = &piece.curve else { panic!("{:?}", piece.curve) };
    let Curve::Sum(curves) = &**curve else { panic!("{curve:?}") };
    assert!(curves.iter().all(|c| matches!(c, Curve::Polynomial(_) | Curve::Cosine { .. })));
    // 7 rad/s for three days is 288 769 turns and this much.
    let u = (Time::SECOND.times(day) - piece.zero).seconds();
    let got = (piece.origin - 1000 * day as i64) as f64 + piece.curve.value(u);
    let expected = 300.0 * sin_of(7 * day) + 50.0 * sin_of(31 * day);
    assert!((got - expected).abs() < 1e-9, "{got} {expected}");
}

/// The sine of a whole number, by 128-bit fixed point.
fn sin_of(n: u64) -> f64 {
    // 2π = its f64 + 2.449…e-16, in units of 2^-100.
    let head = std::f64::consts::TAU;
    let head = ((head.trunc() as u128) << 100) + (((head.fract() * 2f64.powi(53)) as u128) << 47);
    let tau = head + (2.449_293_598_294_706_4e-16 * 2f64.powi(100)) as u128;
    let angle = ((u128::from(n) << 100) % tau) as f64 / 2f64.powi(100);
    angle.sin()
}

/// A motor with that `lead`, or none, under a formula.
fn motor(lead: &str, unit: &str, theta: &str, parameters: &str) -> Law {
    read(lead, unit, theta, parameters).unwrap_or_else(|error| panic!("{}", error.plain()))
}

fn read(lead: &str, unit: &str, theta: &str, parameters: &str) -> Result<Law, file::FileError> {
    let text = format!(
        "board = \"native\"\n[motor.m]\nsteps_per_rev = 200\nmicrosteps = 16\npins = {{ step = 2, dir = 3 }}\nforward = \"high\"\n\
         driver = \"A4988\"\n{lead}\n[[motion]]\nmotor = \"m\"\n\
         law.formula = {{ theta = \"{theta}\", unit = \"{unit}\", duration = \"8 s\", where = {{ {parameters} }} }}\n"
    );
    let none = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
    file::read(&text, "x.toml", &none).map(|mut program| program.motors.remove(0).law)
}

const LEAD: &str = "lead = \"8 mm\"";

fn in_steps(unit: &str) -> f64 {
    match unit {
        "deg" => 3200.0 / 360.0,
        "rad" => 3200.0 / TAU,
        "rev" => 3200.0,
        "mm" => 400.0,
        "cm" => 4000.0,
        "full-step" => 16.0,
        _ => 1.0,
    }
}

/// Of a formula's value at some times, in its unit.
#[track_caller]
fn plays((lead, unit, theta, parameters): (&str, &str, &str, &str), expected: impl Fn(f64) -> f64) {
    let law = motor(lead, unit, theta, parameters);
    let mut cursor = Cursor::new(&law);
    for t in [0.0, 0.3, 1.0, 2.7, 6.2] {
        let got = cursor.at(Time::from_seconds(t)).unwrap().position / in_steps(unit);
        let wanted = expected(t);
        assert!(
            (got - wanted).abs() <= 1e-11 * (1.0 + wanted.abs()),
            "{theta} in {unit} at {t} s: {got}, not {wanted}"
        );
    }
}

#[test]
fn angles_are_in_radians_in_sin_and_in_the_unit_elsewhere() {
    let shifted = "A*(1+sin(2*pi*0.5*t-phi))";
    plays(("", "deg", shifted, "A = 40, phi = \"90 deg\""), |t| 40.0 * (1.0 - (PI * t).cos()));
    plays(("", "rev", shifted, "A = \"40 deg\", phi = \"0.25 rev\""), |t| (1.0 - (PI * t).cos()) / 9.0);
    let omega: f64 = "3.14159265".parse().unwrap();
    plays(("", "deg", "90*sin(omega*t)", "omega = \"3.14159265 rad/s\""), |t| 90.0 * (omega * t).sin());
    plays(("", "deg", "90*sin(f*t)", "f = \"30 rpm\""), |t| 90.0 * (PI * t).sin());
    plays(("", "deg", "90*sin(f*t)", "f = \"0.5 Hz\""), |t| 90.0 * (0.5 * t).sin());
    plays(("", "deg", "20*sin(a*t^2)", "a = \"90 deg/s^2\""), |t| 20.0 * (0.5 * PI * t * t).sin());
    plays(("", "deg", "phi + 10*t", "phi = \"0.25 rev\""), |t| 90.0 + 10.0 * t);
    plays(("", "deg", "phi*cos(phi)*t", "phi = \"60 deg\""), |t| 30.0 * t);
    plays(("", "deg", "tan(phi)*t + cos(2*t + if(phi > 1, 1, 0))", "phi = \"60 deg\""), |t| {
        3.0_f64.sqrt() * t + (2.0 * t + 1.0).cos()
    });
    plays(("", "deg", "if(phi > 1.5, 7, 8)*t", "phi = \"2 deg\""), |t| 7.0 * t);
    // A shift in time, and a swing from the speed that it has.
    plays(("", "deg", "v/(2*pi*f)*sin(2*pi*f*t)", "v = \"90 deg/s\", f = \"0.5 Hz\""), |t| 90.0 / PI * (PI * t).sin());
    plays(("", "deg", "mod(w*t, 720) + 0*t", "w = \"0.25 rev/s\""), |t| 90.0 * t);
    plays(("", "deg", "90*sin(pi/4*w*t)", "w = \"1 rad/s\""), |t| 90.0 * (PI / 4.0 * t).sin());
    plays((LEAD, "mm", "pi/2*r*phi*t", "r = \"20 mm\", phi = \"90 deg\""), |t| 5.0 * PI * PI * t);
}

/// What looks like a conversion by hand, and is a gear, an amplitude or a unit.
#[test]
fn factors_that_are_meant_are_played() {
    plays(("", "deg", "6*n*t", "n = \"30 rpm\""), |t| 1080.0 * t);
    plays(("", "deg", "n/gear*t", "n = \"30 rpm\", gear = 60"), |t| 3.0 * t);
    plays(("", "deg", "n*a/b*t", "n = \"30 rpm\", a = 60, b = 20"), |t| 540.0 * t);
    plays(("", "step", "1000*t/T", "T = \"500 ms\""), |t| 2000.0 * t);
    plays(("", "rev", "phi/deg/360*t", "phi = \"90 deg\", deg = \"1 deg\""), |t| 0.25 * t);
    plays(("", "deg", "v/r*rad*t", "v = \"50 mm/s\", r = \"20 mm\", rad = \"1 rad\""), |t| (2.5 * t).to_degrees());
    plays(("", "deg", "v/r*t*180/pi", "v = \"50 mm/s\", r = \"20 mm\""), |t| (2.5 * t).to_degrees());
    plays((LEAD, "mm", "v/w*sin(w*t)", "v = \"50 mm/s\", w = \"10 rad/s\""), |t| 5.0 * (10.0 * t).sin());
    plays((LEAD, "mm", "screw*n/turn*t", "screw = \"8 mm\", n = \"30 rpm\", turn = \"1 rev\""), |t| 4.0 * t);
    plays(("", "deg", "20*sin((360*f*t + 90)*pi/180)", "f = \"500 mHz\""), |t| 20.0 * (PI * t).cos());
}

/// The tables of docs/formulas.md: what is good, what is refused, and what to write instead.
#[test]
fn the_documented_formulas_are_what_the_tables_say() {
    let section = DOCS.split("## Dimensions").nth(1).unwrap().split("\n## ").next().unwrap();
    let is_good = |theta: &str| {
        let parameters = "phi = \"90 deg\", x = \"5 mm\", r = \"20 mm\", f = \"0.5 Hz\", n = \"30 rpm\", rad = \"1 rad\", y = \"3 mm\"";
        read("", "deg", theta, parameters).is_ok()
    };
    let mut rows = [0, 0];
    for cells in section.lines().filter(|line| line.starts_with("| `")).map(|line| line.split('|').collect::<Vec<_>>())
    {
        let formula = |cell: &str| cell.split('`').nth(1).unwrap().to_owned();
        let is_refused = cells.len() == 5;
        rows[usize::from(is_refused)] += 1;
        assert_eq!(is_good(&formula(cells[1])), !is_refused, "{}", cells[1]);
        assert!(!is_refused || is_good(&formula(cells[3])), "{}", cells[3]);
    }
    assert_eq!(rows, [4, 12]);
}

const DOCS: &str = include_str!("../../../../docs/formulas.md");

/// "`2^3^2` = 512" and "`t²` = 0.25 at t = 0.5": the formula, its value and the time.
fn documented_examples() -> Vec<(&'static str, f64, f64)> {
    let examples = DOCS.match_indices("` = ").filter_map(|(end, _)| {
        let formula = &DOCS[DOCS[..end].rfind('`')? + 1..end];
        let number = |text: &'static str| {
            text[..text.find(|c: char| !(c.is_ascii_digit() || matches!(c, '-' | '.'))).unwrap_or(text.len())]
                .trim_end_matches('.')
                .parse::<f64>()
                .ok()
        };
        let rest = &DOCS[end + 4..];
        let value = number(rest)?;
        let line = rest.lines().next()?;
        let at = line.split("`").next()?.split_once(" at t = ").and_then(|(_, time)| number(time));
        Some((formula, value, at.unwrap_or(0.0)))
    });
    examples.collect()
}

#[test]
fn every_example_of_the_docs_comes_to_what_they_say() {
    let examples = documented_examples();
    assert!(examples.len() > 55, "only {} examples", examples.len());
    for (text, value, t) in examples {
        check(text, t, value);
    }
}

/// The motion files' lines in the docs are read.
#[test]
fn every_block_of_the_docs_is_a_law() {
    let blocks: Vec<&str> = DOCS.split("```toml\n").skip(1).filter_map(|rest| rest.split("```").next()).collect();
    assert!(!blocks.is_empty());
    for block in blocks {
        let text = format!(
            "board = \"native\"\n[motor.m]\nsteps_per_rev = 200\npins = {{ step = 2, dir = 3 }}\nforward = \"high\"\ndriver = \"A4988\"\n\
             [[motion]]\nmotor = \"m\"\n{block}"
        );
        let none = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
        file::read(&text, "x.toml", &none).unwrap_or_else(|error| panic!("{}", error.plain()));
    }
}

/// The table of functions in the docs is the program's own.
#[test]
fn the_docs_list_every_function() {
    let row = |function: &FormulaFunction| {
        let FormulaFunction { name, arguments, about, domain, example: (call, value), .. } = function;
        let bars = |text: &str| text.replace('|', "\\|");
        format!("| `{name}({arguments})` | {} | {} | `{call}` = {value} |\n", bars(about), bars(domain))
    };
    let expected: String = formula_functions().iter().map(row).collect();
    assert!(DOCS.contains(&expected), "docs/formulas.md must have these rows:\n{expected}");
    for function in formula_functions() {
        let (call, value) = function.example;
        check(call, 0.0, value.parse().unwrap());
    }
}

/// What is refused in another spelling, and what the error says to write.
#[test]
fn the_docs_say_what_to_write_in_place_of_other_spellings() {
    let section = DOCS.split("## Other spellings").nth(1).unwrap().split("\n## ").next().unwrap();
    let rows: Vec<_> = section.lines().filter(|line| line.starts_with("| `")).collect();
    assert!(rows.len() >= 30, "{} rows", rows.len());
    for row in rows {
        let mut cells = row.split('`').skip(1).step_by(2);
        let (wrong, right) = (cells.next().unwrap(), cells.next().unwrap());
        let error = Law::formula(wrong, &[], 1.0, Some(Time::SECOND)).unwrap_err();
        let told = format!("{} {}", error.message, error.help);
        assert!(told.contains(right), "{wrong}: {told}");
    }
    let accepted = section.split("These are accepted: ").nth(1).unwrap().split(". ").next().unwrap();
    for spelling in accepted.split('`').skip(1).step_by(2) {
        let text = match spelling {
            "π" | "PI" => format!("{spelling}*t"),
            "²" => "t²".to_owned(),
            "&&" | "||" => format!("if(t < 1 {spelling} t < 2, t, t)"),
            "≤" | "≥" | "≠" => format!("if(t {spelling} 1, t, t)"),
            operator => format!("t {operator} 2"),
        };
        assert!(Law::formula(&text, &[], 1.0, Some(Time::SECOND)).is_ok(), "{text}");
    }
}

#[test]
fn inverse_functions_give_angles() {
    plays(("", "deg", "asin(0.5)*t", ""), |t| 30.0 * t);
    plays(("", "rev", "atan2(-1, 1)*t + acos(0.5)", ""), |t| t / -8.0 + 1.0 / 6.0);
    plays((LEAD, "mm", "20*2/pi*asin(sin(pi*t/2)*0.9)", ""), |t| 40.0 / PI * (0.9 * (PI * t / 2.0).sin()).asin());
    // A crank of 20 mm and a rod of 60 mm.
    let rod = "asin(r*sin(w*t)/l)";
    plays(("", "deg", rod, "r = \"20 mm\", l = \"6 cm\", w = \"1 rad/s\""), |t| (t.sin() / 3.0).asin().to_degrees());
    plays((LEAD, "deg", rod, "r = \"20 mm\", l = \"6 cm\", w = \"1 rad/s\""), |t| (t.sin() / 3.0).asin().to_degrees());
    plays(("", "deg", "sin(asin(t/10))", ""), |t| t / 10.0);
    plays(("", "step", "atan(t)", ""), |t| t.atan() * 3200.0 / TAU);
    // A triangle: the peak is A.
    plays(("", "deg", "A*asin(0.8*sin(t))/asin(1)", "A = \"90 deg\""), |t| (0.8 * t.sin()).asin().to_degrees());
}

#[test]
fn lengths_keep_to_lengths() {
    plays((LEAD, "mm", "sqrt(r^2 - (s*sin(t))^2)", "r = \"5 cm\", s = \"30 mm\""), |t| {
        (2500.0 - 900.0 * t.sin().powi(2)).sqrt()
    });
    plays((LEAD, "mm", "hypot(r, s + 3*t) - min(r, 0)", "r = \"5 cm\", s = \"30 mm\""), |t| {
        50f64.hypot(30.0 + 3.0 * t)
    });
    plays((LEAD, "cm", "(r^3)^(1/3)*t*0 + r", "r = \"80 mm\""), |_| 8.0);
    // The cycloid: an angle times a length is an arc.
    plays((LEAD, "mm", "r*w*t - r*sin(w*t)", "r = \"20 mm\", w = \"90 deg/s\""), |t| {
        20.0 * (PI / 2.0 * t - (PI / 2.0 * t).sin())
    });
    plays((LEAD, "mm", "a*exp(-t/T)", "a = \"20 mm\", T = \"500 ms\""), |t| 20.0 * (-2.0 * t).exp());
}

/// Steps are angles where the unit is one or the motor turns, lengths where the unit is one; else both fit.
#[test]
fn steps_are_angles_or_lengths() {
    plays(("", "deg", "A*t + 10*sin(B*t)", "A = \"320 step\", B = \"800 step\""), |t| {
        36.0 * t + 10.0 * (PI / 2.0 * t).sin()
    });
    plays(("", "step", "A*t + 10*sin(A*t)", "A = \"90 deg\""), |t| 800.0 * t + 10.0 * (PI / 2.0 * t).sin());
    plays(("", "full-step", "A + 1*t", "A = \"90 deg\""), |t| 50.0 + t);
    plays((LEAD, "mm", "A*sin(A/l*t)", "A = \"800 step\", l = \"4 mm\""), |t| 2.0 * (t / 2.0).sin());
    plays((LEAD, "step", "A*sin(t) + B*t", "A = \"2 mm\", B = \"1 step\""), |t| 800.0 * t.sin() + t);
    plays((LEAD, "step", "A*sin(t) + B*t + 5", "A = \"90 deg\", B = \"1 full-step\""), |t| {
        800.0 * t.sin() + 16.0 * t + 5.0
    });
}

/// Formulas that are defined everywhere, with branches that meet.
fn formulas() -> impl Strategy<Value = String> {
    let leaf = prop_oneof![
        (-30..30_i32).prop_map(|n| format!("{}", f64::from(n) / 4.0)),
        Just("t".to_string()),
        Just("a*t".to_string()),
        (1..40_i32).prop_map(|w| format!("sin({w}*t)")),
    ];
    leaf.prop_recursive(4, 24, 3, |inner| {
        let two = (inner.clone(), inner.clone());
        prop_oneof![
            two.clone().prop_map(|(a, b)| format!("({a} + {b})")),
            two.clone().prop_map(|(a, b)| format!("({a} - {b})")),
            two.clone().prop_map(|(a, b)| format!("{a}*{b}")),
            two.clone().prop_map(|(a, b)| format!("max({a}, {b})")),
            two.prop_map(|(a, b)| format!("({a})/(2 + sin({b}))")),
            inner.clone().prop_map(|a| format!("cos({a})")),
            inner.clone().prop_map(|a| format!("atan({a})")),
            inner.clone().prop_map(|a| format!("tanh({a})")),
            inner.clone().prop_map(|a| format!("abs({a})")),
            inner.clone().prop_map(|a| format!("sqrt(1 + ({a})^2)")),
            inner.clone().prop_map(|a| format!("(1.5 + cos({a}))^0.7")),
            inner.clone().prop_map(|a| format!("ln(3 + sin({a}))")),
            inner.clone().prop_map(|a| format!("asin(0.9*sin({a}))")),
            inner.clone().prop_map(|a| format!("exp(-({a})^2)")),
            inner.prop_map(|a| format!("(2 + cos({a}))^-2")),
        ]
    })
}

proptest! {
    #[test]
    fn no_text_makes_the_parser_panic(text in "\\PC{0,60}") {
        let _ = Law::formula(&text, &[("a".into(), 1.0)], 1.0, None);
    }

    #[test]
    fn no_formula_like_text_does_either(text in "([-+*/^(),.<>=! ]|[0-9]{1,3}|t|a|sin|if|piecewise|floor|mod|and|not|e|pi){0,40}") {
        if let Ok(law) = Law::formula(&text, &[("a".into(), 1.0)], 1.0, Some(Time::SECOND)) {
            for piece in law.pieces().take(50) {
                let Ok(piece) = piece else { break };
                prop_assert!(piece.start < piece.end);
            }
        }
    }

    /// The enclosure of the eighth derivative and of the roundings, against the curve's own values.
    #[test]
    fn taylor_s_remainder_is_within_the_bounds(text in formulas(), from in 0.0_f64..1.0, to in 0.0_f64..1.0) {
        for piece in law(&text).pieces().take(20) {
            let Ok(piece) = piece else { break };
            let (first, last) = (piece.first(), piece.last());
            let bounds = piece.curve.bounds(first, last);
            let (u, v) = (first + from * (last - first), first + to * (last - first));
            let (jet, x) = (piece.curve.jet(u), v - u);
            let taylor = jet.iter().rev().fold(0.0, |sum, c| sum * x + c);
            let slack: f64 = bounds.rounding.iter().rev().fold(0.0, |sum, r| sum * x.abs() + r) + bounds.rounding[0];
            // The test's own sum and the place v are rounded.
            let own = jet.iter().rev().fold(0.0, |sum, c| sum * x.abs() + c.abs()) * 20.0 * f64::EPSILON;
            let off = (piece.curve.value(v) - taylor).abs();
            let bound = bounds.eighth * x.powi(8) + slack + own + jet[1].abs() * v * f64::EPSILON;
            prop_assert!(off <= bound, "{text}: {off:e} > {bound:e}, x = {x}, {bounds:?}");
        }
    }

    #[test]
    fn no_text_with_dimensions_makes_the_parser_panic(
        text in "([-+*/^(),<]|[0-9]{1,2}|t|phi|x|s|f|sin\\(|asin\\(|sqrt\\(|max\\(|floor\\(|if\\(|pi){0,30}",
        unit in "deg|rad|step|mm", has_lead in any::<bool>(),
    ) {
        let parameters = "phi = \"90 deg\", x = \"5 mm\", s = \"5 step/s\", f = \"0.5 Hz\"";
        if let Err(error) = read(if has_lead { LEAD } else { "" }, &unit, &text, parameters) {
            prop_assert!(error.problems().iter().all(|problem| problem.place().0 >= 8), "{}", error.plain());
        }
    }

    /// One motion, said in different units.
    #[test]
    fn units_change_no_law(a in 1.0_f64..400.0, w in -400.0_f64..400.0, phi in -400.0_f64..400.0, k in 0.0_f64..0.9) {
        let theta = "A*(1 + sin(w*t - phi)) + w*t*cos(phi)/2 + asin(k*sin(w*t/3)) + max(phi, w*t - A)";
        let laws: Vec<Law> = [("deg", 1.0), ("rad", TAU / 360.0), ("rev", 1.0 / 360.0)]
            .into_iter()
            .flat_map(|(unit, size)| {
                let parameters = format!(
                    "A = \"{:e} {unit}\", w = \"{:e} {unit}/s\", phi = \"{:e} {unit}\", k = {k:e}",
                    a * size, w * size, phi * size
                );
                ["deg", "rad", "rev", "step"].map(|unit| motor("", unit, theta, &parameters))
            })
            .collect();
        let per_degree = in_steps("deg");
        for t in [0.0, 0.37, 1.9, 7.1] {
            let turned = w * t - phi;
            let expected = a * (1.0 + turned.to_radians().sin())
                + w * t * phi.to_radians().cos() / 2.0
                + (k * (w * t / 3.0).to_radians().sin()).asin().to_degrees()
                + phi.max(w * t - a);
            for (which, law) in laws.iter().enumerate() {
                let got = Cursor::new(law).at(Time::from_seconds(t)).unwrap().position / per_degree;
                prop_assert!((got - expected).abs() < 1e-9 * (1.0 + expected.abs()), "{which} at {t} s: {got}, not {expected}");
            }
        }
    }

    #[test]
    fn windows_follow_without_gaps_and_meet(text in formulas()) {
        let law = law(&text);
        let mut end = Time::ZERO;
        let mut position: Option<f64> = None;
        for piece in law.pieces().take(400) {
            let Ok(piece) = piece else { break };
            prop_assert_eq!(piece.start, end);
            prop_assert!(piece.end > piece.start);
            let first = piece.origin as f64 + piece.curve.value(piece.first());
            if let Some(position) = position {
                prop_assert!((first - position).abs() < 1e-5 * (1.0 + position.abs()), "{} at {}", text, piece.start.seconds());
            }
            position = Some(piece.origin as f64 + piece.curve.value(piece.last()));
            end = piece.end;
        }
    }
}

/// A window is worked out once, from whatever time the formula is read. It is the window that a new formula of the same text has. An endless formula
/// forgets its windows.
#[test]
fn windows_are_kept_and_stay_the_same() {
    let new = || Law::formula("exp(sin(9*t))/(2 + cos(t))", &[], 200.0, None).unwrap();
    let span = |piece: &Piece| (piece.start, piece.end);
    let pieces = |law: &Law| law.pieces().take(20).map(Result::unwrap).collect::<Vec<Piece>>();
    let law = new();
    let first = pieces(&law);
    // Windows that were made apart count as different.
    assert_eq!(first, pieces(&law));
    assert_ne!(first, pieces(&new()));
    assert!(first.iter().map(span).eq(pieces(&new()).iter().map(span)));
    let far = law.pieces().take(10_000).map(Result::unwrap).last().unwrap();
    let far_from = |law: &Law| law.pieces_from(far.start).next().unwrap().unwrap();
    assert_eq!(span(&far_from(&law)), span(&far));
    assert_eq!(span(&far_from(&new())), span(&far));
    assert_ne!(first, pieces(&law));
    assert!(first.iter().map(span).eq(pieces(&law).iter().map(span)));
    // Of a formula of 60 kB few are kept.
    let terms: Vec<String> = (0..2500).map(|k| format!("sin({}.25*t + exp(-t))", k % 7 + 1)).collect();
    let long = Law::formula(&terms.join(" + "), &[], 0.1, None).unwrap();
    let first = long.pieces().next();
    assert_eq!(first, long.pieces().next());
    long.pieces().take(150).for_each(|piece| drop(piece.unwrap()));
    assert_ne!(first, long.pieces().next());
}
