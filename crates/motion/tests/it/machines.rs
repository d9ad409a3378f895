//! Machines in motion files: what they come to. `file_errors.rs` has what is said of wrong ones.

use std::sync::LazyLock;

use proptest::prelude::*;
use pulsetrain_motion::file::{self, FileError};
use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::machine::Kinematics;
use pulsetrain_motion::program::Program;
use pulsetrain_motion::{Law, Time};

use crate::file_errors::{good, lies_in_its_file, loader};

/// A table, and a circle that it draws.
static XY: LazyLock<&str> = LazyLock::new(|| good("xy.toml"));
static DELTA: LazyLock<&str> = LazyLock::new(|| good("delta.toml"));
const CIRCLE: &str = r#"path.circle = { radius = "20 mm", period = "4 s", cycles = 2 }"#;
const LINES: &str = r#"path.lines = { points = [[0, 0, -140], [30, 0, -150]], unit = "mm", speed = "100 mm/s", acceleration = "1000 mm/s^2" }"#;
const MOTION: &str = "\n[[motion]]\nmachine = \"robot\"\n";

fn read(text: &str) -> Result<Program, FileError> {
    file::read(text, "x.toml", &loader)
}

#[track_caller]
fn program(text: &str) -> Program {
    read(text).unwrap_or_else(|error| panic!("{}", error.plain()))
}

fn at(law: &Law, seconds: f64) -> f64 {
    Cursor::new(law).at(Time::from_seconds(seconds)).unwrap().position
}

/// Where a program's first machine's tip is wanted.
fn tip(program: &Program, seconds: f64) -> [f64; 3] {
    let machine = &program.machines[0];
    let moved = machine.motors.iter().map(|motor| {
        let law = &program.motors[*motor].law;
        at(law, seconds) - at(law, 0.0)
    });
    machine.tip(&moved.collect::<Vec<f64>>()).unwrap()
}

#[track_caller]
fn close(got: [f64; 3], wanted: [f64; 3]) {
    let off = got.iter().zip(wanted).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off < 1e-9, "{got:?}, wanted {wanted:?}");
}

#[test]
fn a_circle_goes_round() {
    let program = program(&XY);
    assert_eq!(program.machines[0].unit, "mm");
    assert_eq!(program.machines[0].kinematics, Kinematics::Xy { steps_per_unit: [80.0, 80.0] });
    for k in 0..=80 {
        let angle = std::f64::consts::TAU * f64::from(k) / 40.0;
        close(tip(&program, f64::from(k) * 0.1), [20.0 * angle.cos(), 20.0 * angle.sin(), 0.0]);
    }
}

#[test]
fn an_easing_keeps_the_circle_and_takes_its_time() {
    let program = program(&XY.replace("[[motion]]", "[[motion]]\nease = \"1 s\""));
    assert_eq!(program.motors[0].law.end(), Some(Time::from_seconds(9.0)));
    for k in 0..=90 {
        let [x, y, _] = tip(&program, f64::from(k) * 0.1);
        assert!((x.hypot(y) - 20.0).abs() < 1e-9);
    }
    let sample = Cursor::new(&program.motors[1].law).at(Time::ZERO).unwrap();
    assert_eq!((sample.speed, sample.acceleration), (0.0, 0.0));
}

#[test]
fn a_later_path_begins_where_the_one_before_ends_and_all_motors_with_it() {
    // y is busy for 3 s on its own; then both draw.
    let before = "[[motion]]\nmotor = \"y\"\nlaw.trapezoid = { distance = \"30 mm\", speed = \"11 mm/s\", acceleration = \"40 mm/s^2\" }\n\n[[motion]]\nmachine";
    let program = program(&XY.replace("[[motion]]\nmachine", before));
    let begin = program.motors[1].law.end().unwrap().seconds() - 8.0;
    close(tip(&program, begin), [20.0, 0.0, 0.0]);
    close(tip(&program, begin + 1.0), [0.0, 20.0, 0.0]);
    // Before it the other motor waits, and the pen is 30 mm lower.
    close(tip(&program, 0.0), [20.0, -30.0, 0.0]);
}

/// From the z axis the orbit falls to (0, 0, 0), and rests: in 300 units of its time below all that f64 knows.
#[test]
fn an_orbit_that_comes_to_rest_rests() {
    let path =
        "path.lorenz = { axes = [\"x\", \"z\"], start = [0, 0, 5], scale = \"2 mm\", speed = 3, duration = \"100 s\" }";
    let program = program(&XY.replace(CIRCLE, path));
    for at_s in [0.1, 1.0, 99.0] {
        let [x, z] = [0, 1].map(|motor| at(&program.motors[motor].law, at_s) / 160.0);
        assert!(x == 0.0 && (z - 5.0 * (-8.0 * at_s).exp()).abs() < 1e-9, "({x}, {z}) at {at_s} s");
    }
}

#[test]
fn the_lorenz_equations_hold_along_its_path() {
    let path = "path.lorenz = { axes = [\"x\", \"y\"], scale = \"2 mm\", speed = 0.5, duration = \"10 s\" }";
    let xy = program(&XY.replace(CIRCLE, path));
    let z = program(&XY.replace(CIRCLE, &path.replace("[\"x\", \"y\"]", "[\"z\", \"z\"]")));
    let [mut x, mut y] = [0, 1].map(|motor: usize| Cursor::new(&xy.motors[motor].law));
    let mut z = Cursor::new(&z.motors[0].law);
    // Of 2 mm a unit and 80 steps a mm; half a unit of time a second.
    let of = |cursor: &mut Cursor, t| {
        let sample = cursor.at(Time::from_seconds(t)).unwrap();
        (sample.position / 160.0, sample.speed / 160.0 / 0.5)
    };
    assert_eq!((of(&mut x, 0.0).0, of(&mut y, 0.0).0, of(&mut z, 0.0).0), (1.0, 1.0, 25.0));
    for k in 0..1000 {
        let t = f64::from(k) * 0.01;
        let ((x, dx), (y, dy), (z, dz)) = (of(&mut x, t), of(&mut y, t), of(&mut z, t));
        let off = [dx - 10.0 * (y - x), dy - (x * (28.0 - z) - y), dz - (x * y - 8.0 / 3.0 * z)];
        assert!(off.iter().all(|off| off.abs() < 1e-9), "{off:?} at {t} s");
    }
}

#[test]
fn a_delta_robot_goes_straight() {
    let program = program(&DELTA);
    close(tip(&program, 0.0), [0.0, 0.0, -140.0]);
    let end = program.motors[0].law.end().unwrap().seconds();
    close(tip(&program, end), [30.0, 0.0, -150.0]);
    for k in 0..=100 {
        let [x, y, z] = tip(&program, end * f64::from(k) / 100.0);
        assert!(y.abs() < 1e-9 && (z + 140.0 + x / 3.0).abs() < 1e-9, "({x}, {y}, {z})");
    }
}

#[test]
fn a_delta_robot_follows_tables_and_formulas() {
    let table = program(&DELTA.replace(LINES, "path.table = { file = \"path.csv\", unit = \"mm\" }"));
    // Columns by their names, each in its own unit.
    let units = program(&DELTA.replace(LINES, "path.table = { file = \"units.csv\" }"));
    for (t, point) in [(0.0, [0.0, 0.0, -140.0]), (1.0, [20.0, 10.0, -150.0]), (2.0, [0.0, 0.0, -140.0])] {
        close(tip(&table, t), point);
        close(tip(&units, t), point);
    }
    let formula = "path.formula = { x = \"r*cos(t)\", y = \"r*sin(t)\", z = \"-14 + t/5\", unit = \"cm\", duration = \"5 s\", where = { r = \"20 mm\" } }";
    let formula =
        program(&DELTA.replace(LINES, formula).replace(MOTION, "\n[[motion]]\nmachine = \"robot\"\nease = \"1 s\"\n"));
    for k in 0..=60 {
        let [x, y, z] = tip(&formula, f64::from(k) * 0.1);
        let t = (z + 140.0) / 2.0;
        assert!((x - 20.0 * t.cos()).abs() < 1e-8 && (y - 20.0 * t.sin()).abs() < 1e-8, "({x}, {y}, {z})");
    }
}

/// Angles are in radians in sin and cos; lengths, arcs and the robot's own lengths are in the path's unit.
#[test]
fn angles_in_a_delta_robot_s_formulas_are_angles() {
    let path = |z: &str, parameters: &str| {
        let path = format!(
            "path.formula = {{ x = \"r*cos(w*t - phi)\", y = \"r*sin(w*t - phi)\", z = \"{z}\", unit = \"cm\", duration = \"5 s\", \
             where = {{ {parameters} }} }}"
        );
        DELTA.replace(LINES, &path)
    };
    const PARAMETERS: &str = "r = \"20 mm\", w = \"45 deg/s\", phi = \"90 deg\"";
    let text = path("-14 + r/4*acos(cos(phi/3))*w*t", PARAMETERS).replace(MOTION, &format!("{MOTION}ease = \"1 s\"\n"));
    let robot = program(&text);
    let quarter = std::f64::consts::FRAC_PI_4;
    for k in 0..=60 {
        let [x, y, z] = tip(&robot, f64::from(k) * 0.1);
        // 5 mm times 30° in radians times the angle that it has turned by.
        let turned = (z + 140.0) / (5.0 * quarter * 2.0 / 3.0);
        let angle = turned - 2.0 * quarter;
        assert!((x - 20.0 * angle.cos()).abs() < 1e-8 && (y - 20.0 * angle.sin()).abs() < 1e-8, "({x}, {y}, {z})");
    }
    let used = robot.motors[2].law.formula_parameters()[0];
    assert_eq!(used[0].outside, Some((2.0, "cm".to_owned())));
    assert_eq!(used[2].in_trig, Some((2.0 * quarter, "rad".to_owned())));
}

#[test]
fn slack_is_of_the_machine() {
    let text =
        XY.replacen("forward = \"high\"", "forward = \"high\"\nbacklash = { slack = \"0.1 mm\", over = \"20 ms\" }", 1);
    let program = program(&text);
    assert_eq!(program.machines[0].slack, [8.0, 0.0]);
    let law = &program.motors[0].law;
    assert!((at(law, 3.0) - at(&law.without_backlash().unwrap(), 3.0) - 8.0).abs() < 1e-9);
}

#[test]
fn a_closed_path_is_repeated() {
    let closed = LINES.replace("[30, 0, -150]]", "[30, 0, -150], [0, 0, -140]]");
    let program = program(&DELTA.replace(LINES, &format!("repeat = \"forever\"\n{closed}")));
    assert_eq!(program.motors[2].law.end(), None);
}

/// Files in which something has been cut out, or put in.
fn mutated() -> impl Strategy<Value = String> {
    let bases = prop::sample::select(vec![*XY, *DELTA]);
    let insert = prop_oneof!["[\\[\\]{}=\".,:0-9 \\n-]{0,6}", Just("1e999".to_owned()), Just("path".to_owned())];
    (bases, any::<prop::sample::Index>(), 0_usize..5, insert).prop_map(|(base, at, length, insert)| {
        // The files are ASCII.
        let at = at.index(base.len());
        format!("{}{insert}{}", &base[..at], &base[(at + length).min(base.len())..])
    })
}

proptest! {
    #[test]
    fn mutated_files_never_panic(text in mutated()) {
        if let Err(error) = read(&text) {
            lies_in_its_file(&error);
        }
    }
}
