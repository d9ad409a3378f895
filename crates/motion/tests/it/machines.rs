//! Machines in motion files: what they come to, and what is said of wrong ones.

use std::io;
use std::path::Path;

use expect_test::{Expect, expect};
use proptest::prelude::*;
use pulsetrain_motion::file::{self, FileError};
use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::machine::Kinematics;
use pulsetrain_motion::program::Program;
use pulsetrain_motion::{Law, Time};

/// A table, and a circle that it draws.
const XY: &str =
    concat!(include_str!("xy.toml"), "path.circle = { radius = \"20 mm\", period = \"4 s\", cycles = 2 }\n");

const DELTA: &str = r#"board = "native"

[motor.a]
steps_per_rev = 200
microsteps = 16
driver = "A4988"
pins = { step = 2, dir = 3 }
forward = "high"

[motor.b]
steps_per_rev = 200
microsteps = 16
driver = "A4988"
pins = { step = 4, dir = 5 }
forward = "high"

[motor.c]
steps_per_rev = 200
microsteps = 16
driver = "A4988"
pins = { step = 6, dir = 7 }
forward = "high"

[machine.robot]
kind = "delta"
motors = ["a", "b", "c"]
base = "60 mm"
upper_arm = "70 mm"
forearm = "150 mm"
effector = "25 mm"

[[motion]]
machine = "robot"
path.lines = { points = [[0, 0, -140], [30, 0, -150]], unit = "mm", speed = "100 mm/s", acceleration = "1000 mm/s^2" }
"#;

const CIRCLE: &str = r#"path.circle = { radius = "20 mm", period = "4 s", cycles = 2 }"#;
const LINES: &str = r#"path.lines = { points = [[0, 0, -140], [30, 0, -150]], unit = "mm", speed = "100 mm/s", acceleration = "1000 mm/s^2" }"#;
const MOTION: &str = "\n[[motion]]\nmachine = \"robot\"\n";

fn loader(path: &Path) -> io::Result<String> {
    match path.to_str() {
        Some("path.csv") => Ok("t,x,y,z\n0,0,0,-140\n1,20,10,-150\n2,0,0,-140\n".into()),
        Some("far.csv") => Ok("t,x,y,z\n0,0,0,-140\n1,20,10,-150\n2,0,170,-140\n".into()),
        Some("units.csv") => Ok("z [cm];n;y_mm;t [ms];x (m)\n-14;0;0;0;0\n-15;1;10;1000;0.02\n-14;2;0;2000;0\n".into()),
        Some("other.csv") => Ok("t [s],x [mm],z [mm]\n0,0,0\n1,1,1\n".into()),
        Some("flat.csv") => Ok("t,y,z,u\n0,0,0,0\n1,1,1,1\n".into()),
        Some("turns.csv") => Ok("t,x [deg],y,z\n0,0,0,-140\n1,1,1,-140\n".into()),
        // Each row can be reached, what is between them cannot: the arms cannot fold so far.
        Some("between.csv") => Ok("0,120,0,-40\n1,-120,0,-40\n".into()),
        _ => Err(io::ErrorKind::NotFound.into()),
    }
}

fn read(text: &str) -> Result<Program, FileError> {
    file::read(text, "x.toml", &loader)
}

#[track_caller]
fn program(text: &str) -> Program {
    read(text).unwrap_or_else(|error| panic!("{}", error.plain()))
}

#[track_caller]
fn check_in(good: &str, old: &str, new: &str, expected: Expect) {
    assert!(good.contains(old), "{old:?} is not in the good file");
    let said = match read(&good.replacen(old, new, 1)) {
        Ok(_) => "no problem\n".to_owned(),
        Err(error) => error.plain(),
    };
    expected.assert_eq(&said);
}

/// What is said of the good xy file with `old` replaced by `new`.
#[track_caller]
fn check_xy(old: &str, new: &str, expected: Expect) {
    check_in(XY, old, new, expected);
}

/// The same of the good delta file.
#[track_caller]
fn check_delta(old: &str, new: &str, expected: Expect) {
    check_in(DELTA, old, new, expected);
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
    let program = program(XY);
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
    let program = program(DELTA);
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
    let refused = |z: &str, parameters: &str| read(&path(z, parameters)).unwrap_err().plain();
    expect![[r#"
        x.toml:34:71: formula: it comes to an angle, but `unit` is "cm", which is a length
            give amplitudes as lengths, or multiply by a radius: an angle times a length is an arc
    "#]]
    .assert_eq(&refused("-phi", PARAMETERS));
    expect![[r#"
        x.toml:34:167: `n` must be a length: x is a coordinate of the tip
            write it in mm, cm or m
    "#]]
    .assert_eq(&refused("-14", &format!("{PARAMETERS}, n = \"3 step\"")));
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
fn machines() {
    check_xy(
        "kind = \"xy\"",
        "kind = \"zy\"",
        expect![[r#"
        x.toml:20:8: `kind` must be one of "xy", "delta"
            did you mean "xy"?
    "#]],
    );
    check_xy(
        "kind = \"xy\"\n",
        "",
        expect![[r#"
        x.toml:19:1: machine `table` has no `kind`
            add, for example: kind = "xy", or "delta"
    "#]],
    );
    check_xy(
        "kind = \"xy\"",
        "kind = \"xy\"\nforearm = \"3 mm\"",
        expect![[r#"
        x.toml:21:1: unknown key `forearm` in machine `table`
            known here: kind, motors, max_speed, max_acceleration
    "#]],
    );
    check_xy(
        "[\"x\", \"y\"]",
        "[\"x\"]",
        expect![[r#"
        x.toml:21:10: a machine of this kind has 2 motors, but `motors` lists 1
            write, for example: motors = ["x", "y"]
    "#]],
    );
    check_xy(
        "[\"x\", \"y\"]",
        "[\"x\", \"x\"]",
        expect![[r#"
        x.toml:21:16: motor "x" is in machine `table` already
            a motor is part of one machine, once
    "#]],
    );
    check_xy(
        "[\"x\", \"y\"]",
        "[\"x\", \"z\"]",
        expect![[r#"
        x.toml:21:16: unknown motor "z"
            did you mean "x"?
    "#]],
    );
    check_xy(
        "[machine.table]",
        "[machine]",
        expect![[r#"
        x.toml:20:1: `kind` stands in [machine], but a machine needs a name
            write [machine.table] above it
        x.toml:24:11: unknown machine "table"
            the file has no machines; add [machine.table] with kind = "xy" and motors = ["x", "y"]
    "#]],
    );
    check_xy(
        "[machine.table]",
        "[machine.other]\nkind = \"xy\"\nmotors = [\"y\", \"x\"]\n\n[machine.table]",
        expect![[r#"
            x.toml:25:11: motor "x" is in machine `other` already
                a motor is part of one machine, once
        "#]],
    );
    check_xy(
        "machine = \"table\"",
        "machine = \"tabel\"",
        expect![[r#"
        x.toml:24:11: unknown machine "tabel"
            did you mean "table"?
    "#]],
    );
    check_xy(
        "machine = \"table\"",
        "machine = \"table\"\nmotor = \"x\"",
        expect![[r#"
        x.toml:25:1: a motion has either `machine` or `motor`
            leave one of them out
    "#]],
    );
    check_xy(
        "[[motion]]\nmachine = \"table\"\npath",
        "[[motion]]\nmotors = [\"x\", \"y\"]\npath",
        expect![[r#"
            x.toml:25:1: `path` is for machines
                write `law` for a motor, or name a `machine`
        "#]],
    );
    check_xy(
        CIRCLE,
        "law.rest = \"1 s\"",
        expect![[r#"
        x.toml:23:1: the motion has no `path`
            add, for example: path.circle = { radius = "20 mm", period = "4 s" }
    "#]],
    );
    check_xy(
        CIRCLE,
        &format!("begin = \"jump\"\n{CIRCLE}"),
        expect![[r#"
        x.toml:25:1: a machine's motion has no `begin`
            give `ease`, which keeps to the path
    "#]],
    );
    check_xy(
        CIRCLE,
        &format!("ease = \"9 s\"\n{CIRCLE}"),
        expect![[r#"
        x.toml:25:8: an easing of 9 s is longer than the motion, 8 s
    "#]],
    );
    check_xy(
        "lead = \"40 mm\"\n",
        "backlash = { slack = \"0.1 mm\" }\n",
        expect![[r#"
        x.toml:6:22: motor `x` turns: it has no `lead` that would make mm of its turns
            add to the motor, for example: lead = "8 mm"; or give an angle
        x.toml:6:12: the backlash has no `over`
            add, for example: backlash = { slack = "6 step", over = "20 ms" }
    "#]],
    );
    check_delta(
        "forearm = \"150 mm\"\n",
        "",
        expect![[r#"
        x.toml:24:1: machine `robot` has no `forearm`
            add, for example: forearm = "150 mm"
    "#]],
    );
    check_delta(
        "forearm = \"150 mm\"",
        "forearm = \"150 deg\"",
        expect![[r#"
        x.toml:29:11: `forearm` must be a distance, but this is an angle
            write, for example: forearm = "150 mm"
    "#]],
    );
    check_delta(
        "effector = \"25 mm\"",
        "effector = \"25 mm\"\nangles = [\"90 deg\", \"-30 deg\"]",
        expect![[r#"
        x.toml:31:10: the first of `angles` must be less than the second
    "#]],
    );
    check_delta(
        MOTION,
        &format!("{}motor = \"a\"\nlaw.rest = \"1 s\"\n{MOTION}", "\n[[motion]]\n"),
        expect![[r#"
        x.toml:32:1: motor `a` is an arm of machine `robot`, and moves with it alone
            write machine = "robot" and a path
    "#]],
    );
}

#[test]
fn paths() {
    check_xy(
        "path.circle",
        "path.circel",
        expect![[r#"
        x.toml:25:6: unknown path `circel`
            did you mean `circle`?
    "#]],
    );
    check_xy(
        "radius = \"20 mm\"",
        "radius = \"-20 mm\"",
        expect![[r#"
        x.toml:25:26: `radius` must be more than 0
    "#]],
    );
    check_xy(
        "radius = \"20 mm\"",
        "radius = 20",
        expect![[r#"
        x.toml:25:26: `radius` is a bare number; it needs a unit
            write, for example: radius = "20 mm"
    "#]],
    );
    check_xy(
        "period = \"4 s\"",
        "period = \"30 ms\", dds = \"50 Hz\"",
        expect![[r#"
        x.toml:25:44: a period of 0.03 s cannot be made from updates every 0.02 s; it must be two of them at least, and 2^32 at most
            give a higher `dds`, or leave it out: then the period is exact
    "#]],
    );
    check_xy(
        "motors = [\"x\", \"y\"]",
        "motors = [\"x\", \"y\"]\nmax_speed = \"30 mm/s\"",
        expect![[r#"
            x.toml:26:15: the tip's speed is 31.4 mm/s at its highest, at 0.500000 s, at (14.142, 14.142) mm; limit 30.0 mm/s
                slow the path down, or raise the machine's max_speed
        "#]],
    );
    check_xy(
        "motors = [\"x\", \"y\"]",
        "motors = [\"x\", \"y\"]\nmax_acceleration = \"49 mm/s^2\"",
        expect![[r#"
            x.toml:26:15: the tip's acceleration is 49.3 mm/s² at its highest, at 0.500000 s, at (14.142, 14.142) mm; limit 49.0 mm/s²
                slow the path down, or raise the machine's max_acceleration
        "#]],
    );
    check_xy(
        "cycles = 2",
        "cycles = \"forever\"",
        expect![[r#"
        no problem
    "#]],
    );
    let limited = XY.replace("motors = [\"x\", \"y\"]", "motors = [\"x\", \"y\"]\nmax_speed = \"40 mm/s\"");
    check_in(
        &limited,
        "cycles = 2",
        "cycles = \"forever\"",
        expect![[r#"
        x.toml:26:15: a machine with max_speed or max_acceleration needs paths that end
            give a duration or cycles; `repeat` may be "forever"
    "#]],
    );
    check_in(
        &limited,
        "lead = \"40 mm\"\n",
        "",
        expect![[r#"
        x.toml:18:1: motor `x` has no `lead`: the tip's speed in mm/s is not known
            give the motor a `lead`
    "#]],
    );
    check_xy(
        CIRCLE,
        "path.lorenz = { speed = 0.5 }",
        expect![[r#"
        x.toml:25:15: path `lorenz` has no `scale`
            add, for example: scale = "1 mm"
    "#]],
    );
    check_xy(
        CIRCLE,
        "path.lorenz = { scale = \"1 mm\", speed = -1 }",
        expect![[r#"
        x.toml:25:41: `speed` must be more than 0
    "#]],
    );
    check_xy(
        CIRCLE,
        "path.lorenz = { scale = \"1 mm\", start = [1, 2] }",
        expect![[r#"
        x.toml:25:41: `start` must list three numbers: x, y and z
            start = [1, 1, 25]
    "#]],
    );
    check_xy(
        CIRCLE,
        "path.lorenz = { scale = \"1 mm\", axes = [\"x\", \"w\"] }",
        expect![[r#"
        x.toml:25:46: `axes` must be one of "x", "y", "z"
            did you mean "x"?
    "#]],
    );
    check_xy(
        CIRCLE,
        "path.lorenz = { scale = \"1 mm\", start = [0, 0, 0] }",
        expect![[r#"
        x.toml:25:15: path `lorenz`: an orbit that starts at (0, 0, 0) rests there: begin near it, for example at (1, 1, 25)
    "#]],
    );
    check_xy(
        CIRCLE,
        "path.lorenz = { scale = \"1 mm\", rho = 3000 }",
        expect![[r#"
        x.toml:25:15: path `lorenz`: rho is 3000; it must be from -1000 to 1000
    "#]],
    );
    check_xy(
        CIRCLE,
        "path.formula = { x = \"t\", y = \"sni(t)\", unit = \"mm\" }",
        expect![[r#"
            x.toml:25:32: formula: `sni` is unknown; did you mean `sin`?
                or `sinh`, `sign`, `asin`; all functions: docs/formulas.md, or `pulsetrain formula --list`
        "#]],
    );
    check_xy(
        CIRCLE,
        "path.formula = { x = \"t\", unit = \"mm\" }",
        expect![[r#"
        x.toml:25:16: path `formula` has no `y`
            add, for example: y = "20*cos(2*pi*t)"
    "#]],
    );
    check_xy(
        CIRCLE,
        "path.table = { file = \"path.csv\", unit = \"mm\", columns = [1, 2] }",
        expect![[r#"
        x.toml:25:58: `columns` must list three: time, x and y
            columns = [1, 2, 3], or ["time", "x", "y"] by the header
    "#]],
    );
    check_xy(
        CIRCLE,
        "path.table = { file = \"path.csv\", unit = \"mm\", columns = [\"t\", \"x\", \"w\"] }",
        expect![[r#"
            path.csv:1:1: expected a column `w`, found `t`, `x`, `y`, `z`
        "#]],
    );
    check_xy(
        CIRCLE,
        "path.table = { file = \"other.csv\" }",
        expect![[r#"
        other.csv:1:1: expected a column `y [mm]`, found `t [s]`, `x [mm]`, `z [mm]`
            if column 1 `t [s]` is the time, column 2 `x [mm]` is x and column 3 `z [mm]` is y, write: columns = [1, 2, 3]
    "#]],
    );
    check_xy(
        CIRCLE,
        "path.lines = { points = [[0, 0]], unit = \"mm\", speed = \"1 mm/s\", acceleration = \"1 mm/s^2\" }",
        expect![[r#"
            x.toml:25:25: lines need two points at least, but there are 1
        "#]],
    );
    check_xy(
        CIRCLE,
        "path.lines = { points = [[0, 0], [1, 2, 3]], unit = \"mm\", speed = \"1 mm/s\", acceleration = \"1 mm/s^2\" }",
        expect![[r#"
            x.toml:25:34: a point of this machine is 2 numbers, but this has 3
        "#]],
    );
    check_xy(
        CIRCLE,
        "path.lines = { points = [[0, 0], [0, 0]], unit = \"deg\", speed = \"1 mm/s\" }",
        expect![[r#"
        x.toml:25:50: `unit` must be a unit of length, but is "deg"
            one of: mm, cm, m
        x.toml:25:14: path `lines` has no `acceleration`
            add, for example: acceleration = "1000 mm/s^2"
    "#]],
    );
}

#[test]
fn what_a_delta_robot_cannot() {
    check_delta(
        "[30, 0, -150]",
        "[130, 0, -150]",
        expect![[r#"
            x.toml:34:40: the effector cannot be at (130.000, 0.000, -150.000) mm for arm `b`: its joint is 180.3 mm from the shaft, limits 29.1 to 169.1 mm
                keep the path within what the arms reach
        "#]],
    );
    check_delta(
        "[30, 0, -150]",
        "[30, 0, 150]",
        expect![[r#"
        x.toml:34:40: the effector cannot be at (30.000, 0.000, 150.000) mm: z must be less than 0: below the motors' shafts
            keep the path within what the arms reach
    "#]],
    );
    check_delta(
        LINES,
        "path.table = { file = \"far.csv\", unit = \"mm\" }",
        expect![[r#"
            far.csv:4:1: the effector cannot be at (0.000, 170.000, -140.000) mm for arm `a`: its joint is 170.0 mm aside of the arm, limit 150.0 mm (the forearm)
                keep the path within what the arms reach
        "#]],
    );
    check_delta(
        LINES,
        "path.table = { file = \"flat.csv\", unit = \"mm\" }",
        expect![[r#"
            flat.csv:1:1: expected a column `x [mm]`, found `t`, `y`, `z`, `u`
                if column 1 `t` is the time in s, column 4 `u` is x in mm, column 2 `y` is y in mm and column 3 `z` is z in mm, write: columns = [1, 4, 2, 3], time = "s"
        "#]],
    );
    check_delta(
        LINES,
        "path.table = { file = \"turns.csv\", unit = \"mm\" }",
        expect![[r#"
        turns.csv:1:3: column 2 `x [deg]` is in deg, but x.toml:34:43 says unit = "mm"
            if the header is right, write: unit = "deg"
    "#]],
    );
    check_delta(
        LINES,
        "path.table = { file = \"turns.csv\" }",
        expect![[r#"
            x.toml:34:23: `unit` must be a length: x is a coordinate of the tip
                write it in mm, cm or m
        "#]],
    );
    check_delta(
        LINES,
        "path.table = { file = \"between.csv\", unit = \"mm\" }",
        expect![[r#"
            x.toml:34:14: at 0.065492 s the effector cannot be at (104.282, 0.000, -40.000) mm for arm `a`: its joint is 80.0 mm from the shaft, limits 80.0 to 220.0 mm
                keep the path within what the arms reach
        "#]],
    );
    let formula = |x: &str| {
        format!("path.formula = {{ x = \"{x}\", y = \"0\", z = \"-140\", unit = \"mm\", duration = \"5 s\" }}")
    };
    check_delta(
        LINES,
        &formula("40*t"),
        expect![[r#"
            x.toml:34:16: at 3.191650 s the effector cannot be at (127.666, 0.000, -140.000) mm for arm `b`: its joint is 171.4 mm from the shaft, limits 31.4 to 171.4 mm
                keep the path within what the arms reach
        "#]],
    );
    check_delta(
        LINES,
        &formula("sqrt(t - 1)"),
        expect![[r#"
        x.toml:34:22: θ is undefined at t = 0 s: `sqrt(t - 1)`: the root of what is not positive has no speed or no value
    "#]],
    );
    check_delta(
        LINES,
        &formula("40*t").replace(", duration = \"5 s\"", ""),
        expect![[r#"
        x.toml:34:16: path `formula` has no `duration`
            add, for example: duration = "10 s"
    "#]],
    );
    check_delta(
        LINES,
        &formula("40*t").replace("\"mm\"", "\"deg\""),
        expect![[r#"
        x.toml:34:58: `unit` must be a length: x is a coordinate of the tip
            write it in mm, cm or m
    "#]],
    );
    check_delta(
        LINES,
        "path.circle = { radius = \"20 mm\", period = \"4 s\" }",
        expect![[r#"
        x.toml:34:15: `circle` is a path of xy machines
            a delta robot has formula, table and lines
    "#]],
    );
    check_delta(
        "\"25 mm\"",
        "\"25 mm\"\nangles = [\"-30 deg\", \"15 deg\"]",
        expect![[r#"
            x.toml:35:14: arm `a` would be at 23.2° at 0.003125 s, its farthest; limit 15.0°
                keep the path within what the arms reach
        "#]],
    );
    check_delta(
        "\"25 mm\"",
        "\"25 mm\"\nmax_speed = \"80 mm/s\"",
        expect![[r#"
            x.toml:35:14: the tip's speed is 100.0 mm/s at its highest, at 0.099951 s, at (4.739, 0.000, -141.580) mm; limit 80.0 mm/s
                slow the path down, or raise the machine's max_speed
        "#]],
    );
    check_delta(
        LINES,
        &format!("repeat = 2\n{LINES}"),
        expect![[r#"
        x.toml:34:1: the path does not end where it begins: arm `a` is -7.757° off, each time more
            close the path, or leave `repeat` out
    "#]],
    );
    check_delta(
        MOTION,
        &format!("{MOTION}{LINES}\n{MOTION}"),
        expect![[r#"
        x.toml:38:14: this path does not begin where the one before ends: arm `a` is at 15.465° then, and 23.222° is wanted
            begin it at the last point of the path before
    "#]],
    );
}

#[test]
fn a_closed_path_is_repeated() {
    let closed = LINES.replace("[30, 0, -150]]", "[30, 0, -150], [0, 0, -140]]");
    let program = program(&DELTA.replace(LINES, &format!("repeat = \"forever\"\n{closed}")));
    assert_eq!(program.motors[2].law.end(), None);
}

/// Files in which something has been cut out, or put in.
fn mutated() -> impl Strategy<Value = String> {
    let bases = prop::sample::select(vec![XY, DELTA]);
    let insert = prop_oneof!["[\\[\\]{}=\".,:0-9 \\n-]{0,6}", Just("1e999".to_owned()), Just("path".to_owned())];
    (bases, any::<prop::sample::Index>(), 0_usize..5, insert).prop_map(|(base, at, length, insert)| {
        // The files are ASCII.
        let at = at.index(base.len());
        format!("{}{insert}{}", &base[..at], &base[(at + length).min(base.len())..])
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn mutated_files_never_panic(text in mutated()) {
        if let Err(error) = read(&text) {
            prop_assert!(!error.problems().is_empty());
            for problem in error.problems() {
                for (span, _) in problem.labels() {
                    prop_assert!(problem.source().text().as_bytes().get(span).is_some());
                }
            }
        }
    }
}
