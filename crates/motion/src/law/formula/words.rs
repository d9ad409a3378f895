//! The names that formulas know, and what people write who come from other languages.

use crate::law::double::Double;
use crate::quantity::Quantity;

/// A function of formulas.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FormulaFunction {
    /// Its name.
    pub name: &'static str,
    /// Its arguments, as in "y, x".
    pub arguments: &'static str,
    /// How many arguments it takes, from and to.
    pub(super) count: (usize, usize),
    /// What it gives.
    pub about: &'static str,
    /// For which arguments it has a value.
    pub domain: &'static str,
    /// A call, and what that comes to.
    pub example: (&'static str, &'static str),
}

/// Conditions of one `piecewise`, at most.
const MOST_CONDITIONS: usize = 100;
/// Arguments of `min` and `max`, at most: each is compared with all others.
const MOST_COMPARED: usize = 16;

const fn one(
    name: &'static str,
    about: &'static str,
    domain: &'static str,
    example: (&'static str, &'static str),
) -> FormulaFunction {
    FormulaFunction { name, arguments: "x", count: (1, 1), about, domain, example }
}

const fn several(
    name: &'static str,
    arguments: &'static str,
    count: (usize, usize),
    about: &'static str,
    domain: &'static str,
    example: (&'static str, &'static str),
) -> FormulaFunction {
    FormulaFunction { name, arguments, count, about, domain, example }
}

/// Every function, those of one kind together; likelier ones first.
pub(super) const FUNCTIONS: &[FormulaFunction] = &[
    one("sin", "sine of an angle in rad", "all", ("sin(pi/6)", "0.5")),
    one("cos", "cosine of an angle in rad", "all", ("cos(pi/3)", "0.5")),
    one("tan", "tangent of an angle in rad", "cos(x) != 0", ("tan(pi/4)", "1")),
    one("asin", "the angle whose sine is x", "-1 < x < 1", ("asin(0.5)", "0.5235987755982989")),
    one("acos", "the angle whose cosine is x", "-1 < x < 1", ("acos(0.5)", "1.0471975511965979")),
    one("atan", "the angle whose tangent is x", "all", ("atan(1)", "0.7853981633974483")),
    several(
        "atan2",
        "y, x",
        (2, 2),
        "the angle of the point (x, y), -pi to pi",
        "not both 0",
        ("atan2(1, -1)", "2.356194490192345"),
    ),
    one("sinh", "hyperbolic sine", "all", ("sinh(1)", "1.1752011936438014")),
    one("cosh", "hyperbolic cosine", "all", ("cosh(1)", "1.5430806348152437")),
    one("tanh", "hyperbolic tangent", "all", ("tanh(1)", "0.7615941559557649")),
    one("exp", "e to the power of x", "all", ("exp(1)", "2.718281828459045")),
    one("ln", "natural logarithm", "x > 0", ("ln(e^3)", "3")),
    one("log", "natural logarithm, as `ln`", "x > 0", ("log(e^3)", "3")),
    one("log10", "logarithm to base 10", "x > 0", ("log10(1000)", "3")),
    one("log2", "logarithm to base 2", "x > 0", ("log2(8)", "3")),
    one("sqrt", "square root", "x > 0", ("sqrt(9)", "3")),
    several(
        "pow",
        "x, y",
        (2, 2),
        "x to the power of y, as `x^y`",
        "x > 0; all x if y is a whole number",
        ("pow(2, 10)", "1024"),
    ),
    several("hypot", "x, y", (2, 2), "sqrt(x^2 + y^2)", "not both 0", ("hypot(3, 4)", "5")),
    one("abs", "x without its sign", "all", ("abs(-3)", "3")),
    one("sign", "1, 0 or -1: the sign of x", "all", ("sign(-3)", "-1")),
    several("min", "a, b, …", (2, MOST_COMPARED), "the least of them", "all", ("min(3, 1, 2)", "1")),
    several("max", "a, b, …", (2, MOST_COMPARED), "the largest of them", "all", ("max(3, 1, 2)", "3")),
    several(
        "clamp",
        "x, low, high",
        (3, 3),
        "x, but not below `low` and not above `high`",
        "low <= high",
        ("clamp(7, 0, 5)", "5"),
    ),
    one("floor", "the next whole number down", "|x| < 2^53", ("floor(-2.5)", "-3")),
    one("ceil", "the next whole number up", "|x| < 2^53", ("ceil(-2.5)", "-2")),
    one("round", "the nearest whole number; halves go up", "|x| < 2^53", ("round(2.5)", "3")),
    several(
        "mod",
        "x, m",
        (2, 2),
        "what x is beyond a multiple of m: 0 to m, also for x < 0",
        "m != 0",
        ("mod(-1, 3)", "2"),
    ),
    several("if", "condition, a, b", (3, 3), "a while the condition holds, else b", "all", ("if(2 < 3, 10, 20)", "10")),
    several(
        "piecewise",
        "condition, a, condition, b, …, otherwise",
        (1, 2 * MOST_CONDITIONS + 1),
        "the value behind the first condition that holds, else the last",
        "all",
        ("piecewise(2 < 1, 10, 2 < 3, 20, 30)", "20"),
    ),
    several("not", "condition", (1, 1), "whether the condition does not hold", "all", ("if(not(2 < 1), 10, 20)", "10")),
];

/// The constants.
pub(super) const CONSTANTS: [(&str, Double); 3] = [("pi", Double::PI), ("tau", Double::TAU), ("e", Double::E)];

/// Every function that formulas know, with what it gives, for which arguments, and an example.
///
/// ```
/// let names: Vec<&str> = pulsetrain_motion::law::formula_functions().iter().map(|row| row.name).collect();
/// assert!(names.contains(&"atan2"));
/// ```
#[must_use]
pub fn formula_functions() -> &'static [FormulaFunction] {
    FUNCTIONS
}

pub(super) fn function(name: &str) -> Option<&'static FormulaFunction> {
    FUNCTIONS.iter().find(|row| row.name == name)
}

/// What a constant is called, for other spellings of it: "π", "PI".
pub(super) fn constant(word: &str) -> Option<&'static (&'static str, Double)> {
    let name = match word {
        "π" | "PI" | "Pi" => "pi",
        "τ" | "TAU" | "Tau" => "tau",
        word => word,
    };
    CONSTANTS.iter().find(|row| row.0 == name)
}

/// Where all names are listed.
pub(super) const LIST: &str = "all functions: docs/formulas.md, or `pulsetrain formula --list`";

/// What to write in place of a name that other languages have: (names, what to write).
const ELSEWHERE: &[(&[&str], &str)] = &[
    (&["arcsin"], "write `asin(x)`"),
    (&["arccos"], "write `acos(x)`"),
    (&["arctan", "arctg", "atg"], "write `atan(x)`"),
    (&["arctan2", "atan2d"], "write `atan2(y, x)`"),
    (&["tg"], "write `tan(x)`"),
    (&["sind", "cosd", "tand"], "sin, cos and tan take radians: write `sin(x*pi/180)`"),
    (&["asind", "acosd", "atand"], "asin, acos and atan give the motion's unit: write `asin(x)`, with unit = \"deg\""),
    (
        &["deg2rad", "radians", "toradians", "rad2deg", "degrees", "todegrees"],
        "write `x*pi/180` for rad, `x*180/pi` for degrees; or give an angle with its unit, as in where = { phi = \"90 deg\" }",
    ),
    (&["cot", "ctg"], "write `1/tan(x)`"),
    (&["sec"], "write `1/cos(x)`"),
    (&["csc", "cosec"], "write `1/sin(x)`"),
    (&["asinh", "arsinh", "arcsinh"], "write `ln(x + sqrt(x^2 + 1))`"),
    (&["acosh", "arcosh", "arccosh"], "write `ln(x + sqrt(x^2 - 1))`"),
    (&["atanh", "artanh", "arctanh"], "write `ln((1 + x)/(1 - x))/2`"),
    (&["lg", "log_10"], "write `log10(x)`"),
    (&["ld", "lb"], "write `log2(x)`"),
    (&["log1p"], "write `ln(1 + x)`"),
    (&["expm1"], "write `exp(x) - 1`"),
    (&["exp2"], "write `2^x`"),
    (&["sqr", "square"], "write `x^2`"),
    (&["cbrt"], "write `x^(1/3)`, for x above 0"),
    (&["power"], "write `x^y`"),
    (&["fabs", "absolute"], "write `abs(x)`"),
    (&["sgn", "signum"], "write `sign(x)`"),
    (&["minimum", "fmin"], "write `min(a, b)`"),
    (&["maximum", "fmax"], "write `max(a, b)`"),
    (&["clip", "constrain", "limit", "saturate"], "write `clamp(x, low, high)`"),
    (&["int", "trunc", "fix"], "write `floor(x)`"),
    (&["ceiling"], "write `ceil(x)`"),
    (&["rint", "nint"], "write `round(x)`"),
    (&["frac", "fract"], "write `mod(x, 1)`"),
    (&["fmod", "modulo", "rem", "remainder"], "write `mod(x, m)`, which is never negative for m above 0"),
    (&["div"], "write `floor(a/b)`"),
    (&["where", "select", "iif", "ifelse", "cond", "ternary", "when", "case", "switch"], "write `if(condition, a, b)`"),
    (
        &["else", "then", "elif", "elseif"],
        "write `if(condition, a, b)`, or `piecewise(condition, a, condition, b, otherwise)`",
    ),
    (
        &["heaviside", "step", "unitstep", "u"],
        "write `if(x > 0, 1, 0)`; a law must not jump, so multiply it by what is 0 there",
    ),
    (&["sawtooth", "saw"], "write `mod(t, T)/T`; where it falls back it must not jump"),
    (&["triangle", "tri"], "write `asin(sin(2*pi*f*t))`"),
    (&["lerp", "mix"], "write `a + (b - a)*x`"),
    (&["smoothstep"], "write `x^2*(3 - 2*x)`, with x = clamp(t/T, 0, 1)"),
    (&["sinc"], "write `sin(pi*x)/(pi*x)`, where x is not 0"),
    (
        &["rand", "random", "randn", "rnd", "noise", "perlin", "uniform", "normal"],
        "a law is the same each time, and so has no random numbers; a table may hold some: law.table = { file = \"path.csv\" }",
    ),
    (
        &["diff", "derivative", "integral", "integrate", "cumsum"],
        "a formula is the position itself; `pulsetrain formula` prints its speed and acceleration",
    ),
    (&["sum", "prod", "product"], "write the terms one by one: `a + b + c`"),
    (&["xor"], "write `(a and not b) or (b and not a)`"),
    (&["inf", "infinity", "nan"], "a position is a finite number"),
    (&["time", "seconds", "secs", "millis", "micros", "now"], "the time is `t`, in s"),
];

/// What to write in place of a name that formulas do not have.
pub(super) fn elsewhere(name: &str) -> Option<&'static str> {
    let lower = name.to_lowercase();
    ELSEWHERE.iter().find(|(names, _)| names.contains(&lower.as_str())).map(|(_, write)| *write)
}

/// Whether it is a unit, such as `deg`.
pub(super) fn is_unit(word: &str) -> bool {
    Quantity::parse(&format!("1 {word}")).is_ok()
}

/// Those of `known` that a misspelt name is near to, the nearest first.
pub(super) fn near<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Vec<&'a str> {
    /// A longer word is no misspelt name.
    const MAX_NAME_BYTES: usize = 200;
    if name.len() > MAX_NAME_BYTES {
        return Vec::new();
    }
    let lower = name.to_lowercase();
    let length = lower.chars().count();
    let mut near: Vec<(usize, bool, bool, &str)> = known
        .into_iter()
        .filter_map(|known| {
            let other = known.to_lowercase();
            let distance = strsim::damerau_levenshtein(&other, &lower);
            let begins = other.chars().next() == lower.chars().next();
            let is_near =
                distance == 0 || distance <= 2 && distance < length || length > 1 && other.starts_with(&lower);
            is_near.then(|| (distance, !begins, !(is_within(&lower, &other) || is_within(&other, &lower)), known))
        })
        .collect();
    // Among equals the likelier ones, which come first.
    near.sort_by_key(|(distance, begins, within, _)| (*distance, *begins, *within));
    near.into_iter().map(|(.., known)| known).collect()
}

/// Whether `short` is `long` with letters left out: sn of sin.
fn is_within(short: &str, long: &str) -> bool {
    let mut letters = long.chars();
    short.chars().all(|letter| letters.any(|other| other == letter))
}
