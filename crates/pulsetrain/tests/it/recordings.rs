//! Recordings as people have them: each runs as it is, or with the smoothing that its refusal names; and what is no recording is refused.

use std::fmt::Write as _;
use std::fs;

use pulsetrain::cli;
use pulsetrain::console::Exit;
use pulsetrain_testkit::Random;
use pulsetrain_testkit::folder::Folder;
use pulsetrain_testkit::seed::seed;

fn pulsetrain(args: &[&str]) -> (Exit, String, String) {
    let (mut out, mut err) = (Vec::new(), Vec::new());
    let exit = cli::run([&["pulsetrain"], args].concat(), &mut out, &mut err);
    (exit, String::from_utf8(out).unwrap(), String::from_utf8(err).unwrap())
}

const MOTOR: &str = r#"
steps_per_rev = 200
microsteps = 16
driver = "A4988"
forward = "high"
lead = "40 mm"
max_speed = "4 rev/s"
max_acceleration = "40 rev/s^2"
"#;

fn one_motor(law: &str) -> String {
    format!(
        "board = \"uno\"\n\n[motor.wheel]\npins = {{ step = 8, dir = 9 }}{MOTOR}\n[[motion]]\nmotor = \"wheel\"\nlaw.table = {{ file = \"recording.csv\"{law} }}\n"
    )
}

/// How a recording came to run.
struct Ran {
    /// What its refusals named.
    smooth: Vec<String>,
    /// Root mean square of the distance from the recording, of each column.
    rms: Vec<f64>,
}

/// Runs a recording, and writes into its file what a refusal says, in three tries at most.
#[track_caller]
fn ran(name: &str, csv: &[u8], motion: &str) -> Ran {
    let folder = Folder::new(&format!("recording-{name}"));
    fs::write(folder.0.join("recording.csv"), csv).unwrap();
    let mut text = motion.to_owned();
    let mut smooth = Vec::new();
    for _ in 0..3 {
        let file = folder.write("motion.toml", &text);
        let (exit, out, err) = pulsetrain(&["run", &file, "--native", "--out", &folder.path("out")]);
        if exit == Exit::Success {
            assert!(out.contains("PASS"), "{name}: {out}");
            let (_, json, _) = pulsetrain(&["plan", &file, "--json"]);
            let json: serde_json::Value = serde_json::from_str(&json).unwrap();
            let smoothing = &json["tables"][0]["smoothing"];
            assert_eq!(smoothing.is_null(), smooth.is_empty(), "{name}: {json}");
            let distances = smoothing["distances"].as_array().cloned().unwrap_or_default();
            let rms = distances.iter().map(|distance| distance["rms"].as_f64().unwrap()).collect();
            return Ran { smooth, rms };
        }
        assert_eq!(exit, Exit::Refused, "{name}: {out}{err}");
        let named = err.split("smooth = \"").nth(1).and_then(|rest| rest.split('"').next());
        let named = named.unwrap_or_else(|| panic!("{name}: no smoothing is named:\n{err}"));
        let before = smooth.last().map(|before| format!(", smooth = \"{before}\"")).unwrap_or_default();
        text = text.replace(&format!("recording.csv\"{before}"), &format!("recording.csv\", smooth = \"{named}\""));
        smooth.push(named.to_owned());
    }
    panic!("{name} does not run in three tries: {smooth:?}");
}

/// A recording that is too noisy for its motor: it runs with the smoothing that is named, not far from where it was recorded.
#[track_caller]
fn check_noisy(name: &str, csv: &[u8], motion: &str, most_rms: f64) {
    let Ran { smooth, rms } = ran(name, csv, motion);
    assert!(!smooth.is_empty(), "{name} fits as it is");
    assert!(
        !rms.is_empty() && rms.iter().all(|rms| *rms > 0.0 && *rms < most_rms),
        "{name}: {smooth:?}, off by {rms:?}"
    );
}

/// From 0 to 1, at rest at both ends.
fn turn(t: f64, from: f64, lasts: f64) -> f64 {
    let u = ((t - from) / lasts).clamp(0.0, 1.0);
    u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
}

/// Of about a normal distribution, with a standard deviation of 1.
fn noise(random: &mut Random) -> f64 {
    (0..12).map(|_| random.fraction()).sum::<f64>() - 6.0
}

/// A hand that turns something to and fro, deg, in 4 s.
fn hand(t: f64) -> f64 {
    200.0 * turn(t, 0.4, 1.3) - 260.0 * turn(t, 1.8, 1.2) + 90.0 * turn(t, 3.0, 0.8)
}

#[test]
fn an_encoder_with_1000_rows_a_second() {
    // 2400 counts a turn.
    let mut csv = "t_ms,angle_deg\n".to_owned();
    for k in 0..=4000 {
        let counts = (hand(f64::from(k) / 1000.0) / 0.15).round();
        writeln!(csv, "{k},{:.2}", counts * 0.15).unwrap();
    }
    check_noisy("encoder", csv.as_bytes(), &one_motor(""), 0.2);
}

#[test]
fn a_potentiometer_by_way_of_a_spreadsheet() {
    let mut random = Random::new(seed(25));
    let mut csv = "sep=;\r\nZeit;Winkel\r\ns;°\r\n".to_owned();
    for k in 0..=400 {
        let t = f64::from(k) / 100.0;
        let code = ((hand(t) + 0.4 * noise(&mut random)) / 0.352).round();
        let row = format!("{t:.2};{:.3}\r\n", code * 0.352).replace('.', ",");
        csv.push_str(&row);
    }
    check_noisy("potentiometer", csv.as_bytes(), &one_motor(""), 1.0);
}

/// Its time stamps jitter, begin far from 0, and the wheel turns already when it begins.
#[test]
fn the_gyroscope_of_a_phone() {
    let mut random = Random::new(seed(26));
    let mut csv = "\"Time (s)\",\"Angle (deg)\"\n".to_owned();
    for k in 0..=1200 {
        let t = f64::from(k) / 200.0 + 0.002 * random.fraction();
        let angle = 120.0 * t + 40.0 * (2.0 * t).sin() + 0.05 * noise(&mut random);
        writeln!(csv, "{:.9e},{angle:.9e}", t + 5021.25).unwrap();
    }
    check_noisy("gyroscope", csv.as_bytes(), &one_motor(""), 1.0);
}

/// As its software exports it; now and then the marker is lost.
#[test]
fn motion_capture_with_dropouts() {
    let mut random = Random::new(seed(27));
    let mut csv = "Take 007, of 27.11.2026\tRate: 120 Hz\r\n\r\nFrame\tTime\tWheel.X\r\n\ts\tmm\r\n".to_owned();
    let mut lost = 0;
    for k in 0..=480 {
        let t = f64::from(k) / 120.0;
        if random.one_in(60) {
            lost = random.between(1, 15);
        }
        let x = hand(t) / 4.0 + 0.15 * noise(&mut random);
        let x = if lost > 0 { String::new() } else { format!("{x:.3}") };
        lost = u64::saturating_sub(lost, 1);
        write!(csv, "{k}\t{t:.4}\t{x}\r\n").unwrap();
    }
    let utf16: Vec<u8> = [0xfeff].into_iter().chain(csv.encode_utf16()).flat_map(u16::to_le_bytes).collect();
    check_noisy("mocap", &utf16, &one_motor(", columns = [\"Time\", \"Wheel.X\"]"), 0.4);
}

/// Few frames a second, each with its date.
#[test]
fn a_marker_in_a_film() {
    let mut random = Random::new(seed(28));
    let mut csv = "timestamp,theta [deg]\n".to_owned();
    for k in 0..=240 {
        let t = f64::from(k) / 60.0;
        let angle = hand(t) + 0.8 * noise(&mut random);
        writeln!(csv, "2026-11-27T23:59:{:09.6}Z,{angle:.2}", 10.0 + t).unwrap();
    }
    check_noisy("film", csv.as_bytes(), &one_motor(""), 1.5);
}

/// A row for each count, and none while it rests; from an old program.
#[test]
fn an_encoder_that_logs_its_changes() {
    let mut text = "t a\r".to_owned();
    let mut before = None;
    for k in 0..=60_000 {
        let t = f64::from(k) / 10_000.0;
        let counts = (hand((t - 1.0).max(0.0)) / 0.6).floor();
        if before != Some(counts) || k == 60_000 {
            write!(text, "{:8.1}   {:9.1}\r", t * 1000.0, counts * 0.6).unwrap();
            before = Some(counts);
        }
    }
    check_noisy("changes", text.as_bytes(), &one_motor(", time = \"ms\", unit = \"deg\""), 1.0);
}

/// Two motors draw what a pen drew; the limits are the machine's, and the motors'.
#[test]
fn a_pen_on_a_tablet() {
    let mut random = Random::new(seed(29));
    let mut csv = "# x y t\n".to_owned();
    for k in 0..=1064 {
        let t = f64::from(k) / 133.0;
        let angle = std::f64::consts::TAU * 2.0 * turn(t, 0.2, 7.6);
        let at = |value: f64, random: &mut Random| ((value + 0.03 * noise(random)) / 0.02).round() * 0.02;
        let (x, y) = (at(20.0 * angle.cos(), &mut random), at(12.0 * (2.0 * angle).sin(), &mut random));
        writeln!(csv, "{x:.6e} {y:.6e} {t:.6e}").unwrap();
    }
    let motors = format!(
        "[motor.left]\npins = {{ step = 8, dir = 9 }}{MOTOR}\n[motor.right]\npins = {{ step = 10, dir = 11 }}{MOTOR}\n\
         [machine.plotter]\nkind = \"xy\"\nmotors = [\"left\", \"right\"]\n"
    );
    let path = "[[motion]]\nmachine = \"plotter\"\npath.table = { file = \"recording.csv\", unit = \"mm\" }\n";
    for limits in ["", "max_acceleration = \"1500 mm/s^2\"\n"] {
        check_noisy("pen", csv.as_bytes(), &format!("board = \"uno\"\n\n{motors}{limits}\n{path}"), 0.4);
    }
}

/// The refusal is of an arm, whose law is no table; the smoothing is of the effector's path.
#[test]
fn a_delta_robots_effector() {
    let mut random = Random::new(seed(31));
    let mut csv = "time [s],x [mm],y [mm],z [mm]\n".to_owned();
    for k in 0..=120 {
        let t = f64::from(k) / 30.0;
        let angle = std::f64::consts::TAU * turn(t, 0.3, 3.4);
        let mut at = |value: f64| value + 0.2 * noise(&mut random);
        let (x, y, z) = (at(20.0 * angle.cos()), at(20.0 * angle.sin()), at(-145.0 + 8.0 * angle.cos()));
        writeln!(csv, "{t:.4},{x:.3},{y:.3},{z:.3}").unwrap();
    }
    let arm = |name: &str, step: u8| {
        let motor = MOTOR.replace("lead = \"40 mm\"\n", "").replace("40 rev/s^2", "1.5 rev/s^2");
        format!("[motor.{name}]\npins = {{ step = {step}, dir = {} }}{motor}", step + 1)
    };
    let machine = "[machine.robot]\nkind = \"delta\"\nmotors = [\"a\", \"b\", \"c\"]\nbase = \"60 mm\"\nupper_arm = \"70 mm\"\n\
                   forearm = \"150 mm\"\neffector = \"25 mm\"\n";
    let path = "[[motion]]\nmachine = \"robot\"\nstart = \"1 s\"\npath.table = { file = \"recording.csv\" }\n";
    let arms = [arm("a", 2), arm("b", 4), arm("c", 6)].concat();
    check_noisy("delta", csv.as_bytes(), &format!("board = \"native\"\n\n{arms}{machine}{path}"), 0.4);
}

#[test]
fn what_a_robot_was_sent_runs_as_it_is() {
    let mut csv = "time [s],angle [deg]\n".to_owned();
    for k in 0..=1000 {
        let t = f64::from(k) / 250.0;
        writeln!(csv, "{t},{}", hand(t)).unwrap();
    }
    let Ran { smooth, rms } = ran("robot", csv.as_bytes(), &one_motor(""));
    assert_eq!((smooth.len(), rms.len()), (0, 0));
}

/// Where the motion itself is too much no smoothing is named.
#[test]
fn a_motion_that_smoothing_does_not_cure() {
    let folder = Folder::new("recording-wild");
    let rows: String =
        (0..=400).map(|k| format!("{},{:.3}\n", f64::from(k) / 100.0, 90.0 * (f64::from(k) * 0.5).sin())).collect();
    fs::write(folder.0.join("recording.csv"), format!("t,angle [deg]\n{rows}")).unwrap();
    let file = folder.write("motion.toml", &one_motor(""));
    let (exit, _, err) = pulsetrain(&["plan", &file]);
    assert_eq!(exit, Exit::Refused);
    assert!(err.contains("no smoothing of its table fits that leaves the motion what it is"), "{err}");
    assert!(err.contains("times slower it fits"), "{err}");
}

#[test]
fn the_distance_is_said_to_people_and_to_programs() {
    let folder = Folder::new("recording-distance");
    fs::write(folder.0.join("recording.csv"), "t,angle [deg]\n0,0\n1,0\n1.01,10\n2,10\n").unwrap();
    let file = folder.write("motion.toml", &one_motor(", smooth = \"400 ms\""));
    let (exit, out, err) = pulsetrain(&["plan", &file]);
    assert_eq!(exit, Exit::Success, "{err}");
    let said = out.lines().find(|line| line.contains("table recording.csv")).unwrap();
    assert!(said.contains("; smoothed over 400 ms (−3 dB at 1.25 Hz); from the recording at most 4.9"), "{said}");
    let (_, json, _) = pulsetrain(&["plan", &file, "--json"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let smoothing = &json["tables"][0]["smoothing"];
    assert_eq!((smoothing["over_s"].as_f64(), smoothing["cut_off_hz"].as_f64()), (Some(0.4), Some(1.25)));
    let distance = &smoothing["distances"][0];
    assert_eq!((distance["is"].as_str(), distance["unit"].as_str()), (Some("angle"), Some("deg")));
    let [largest, rms] = ["largest", "rms"].map(|key| distance[key].as_f64().unwrap());
    // Four rows: two at the ends, two at the step, half its height away.
    assert!((4.8..5.0).contains(&largest) && (rms - largest / 2.0_f64.sqrt()).abs() < 0.1, "{distance}");
    assert!((1.0..=1.01).contains(&distance["at_s"].as_f64().unwrap()), "{distance}");
    for (smooth, said) in
        [("3 s", "`smooth` is 3 s, but the recording lasts 2 s"), ("0 s", "more than 0 s"), ("5 Hz", "must be a time")]
    {
        let file = folder.write("motion.toml", &one_motor(&format!(", smooth = \"{smooth}\"")));
        let (exit, _, err) = pulsetrain(&["plan", &file]);
        assert_eq!(exit, Exit::Refused);
        assert!(err.contains(said) && err.contains("motion.toml:15:"), "{err}");
    }
}

/// A message in one line.
fn unwrapped(message: &str) -> String {
    message.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
}

/// Files that are too large, or are none, are refused before they are read: at the table, or as the motion file.
#[test]
fn what_is_no_recording_is_refused_at_once() {
    let folder = Folder::new("recording-none");
    let refused = |named: &str, said: &[&str]| {
        let file = folder.write("motion.toml", &one_motor("").replace("recording.csv", named));
        let (exit, out, err) = pulsetrain(&["plan", &file]);
        assert_eq!((exit, out.as_str()), (Exit::Refused, ""), "{err}");
        let words = unwrapped(&err);
        assert!(said.iter().all(|said| words.contains(said)) && words.contains("motion.toml:15:"), "{named}: {err}");
    };
    // It has no bytes on the disk.
    fs::File::create(folder.0.join("large.csv")).unwrap().set_len(200_000_000).unwrap();
    refused("large.csv", &["200 MB", "64 MB is the most that is read", "keep every tenth row"]);
    fs::write(folder.0.join("long.csv"), "0,0\n".repeat(2_000_001)).unwrap();
    refused("long.csv", &["has 2 000 001 lines; 2 000 000 is the most"]);
    fs::write(folder.0.join("zeros.csv"), vec![0; 1000]).unwrap();
    refused("zeros.csv", &["this is no text"]);
    refused("nowhere.csv", &["cannot read", "paths are relative to the motion file"]);
    fs::create_dir(folder.0.join("folder")).unwrap();
    refused("folder", &["this is a folder, not a file"]);
    let as_motion = |path: &str, said: &str| {
        let (exit, out, err) = pulsetrain(&["plan", path]);
        assert_eq!((exit, out.as_str()), (Exit::Refused, ""));
        assert!(unwrapped(&err).contains(said), "{path}: {err}");
    };
    as_motion(&folder.path("folder"), "this is a folder, not a file");
    as_motion(&folder.path("large.csv"), "16 MB is the most that is read");
    as_motion(&folder.path("zeros.csv"), "this is no text");
    #[cfg(unix)]
    {
        let pipe = folder.path("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for device in ["/dev/zero", "/dev/urandom", &pipe] {
            refused(device, &["this is a device or a pipe, not a file"]);
            as_motion(device, "this is a device or a pipe, not a file");
        }
    }
}

/// A magnetic encoder's angle starts again after each turn: the refusal tells it, and does not offer to smooth the jump away.
#[test]
fn an_angle_that_starts_again_after_each_turn() {
    let mut random = Random::new(seed(31));
    let mut csv = "t,heading [deg]\n".to_owned();
    for k in 0..=800 {
        let t = f64::from(k) / 100.0;
        writeln!(csv, "{t:.2},{:.2}", (700.0 * turn(t, 0.5, 7.0) + 0.1 * noise(&mut random)).rem_euclid(360.0))
            .unwrap();
    }
    let folder = Folder::new("recording-wraps");
    fs::write(folder.0.join("recording.csv"), &csv).unwrap();
    let plan = |more: &str| {
        let file = folder.write("motion.toml", &one_motor(more));
        let (exit, out, err) = pulsetrain(&["plan", &file]);
        (exit, (out + &err).replace('│', " ").split_whitespace().collect::<Vec<_>>().join(" "))
    };
    let (exit, said) = plan("");
    assert_eq!(exit, Exit::Refused, "{said}");
    assert!(said.contains("write wraps = \"1 rev\" in its table") && !said.contains("smooth"), "{said}");
    let (exit, said) = plan(", wraps = \"1 rev\"");
    assert!(exit == Exit::Refused && said.contains("write smooth = \""), "{said}");
    let smooth = said.split("smooth = \"").nth(1).and_then(|rest| rest.split('"').next()).unwrap();
    let (exit, said) = plan(&format!(", wraps = \"1 rev\", smooth = \"{smooth}\""));
    assert_eq!(exit, Exit::Success, "{said}");
    assert!(said.contains("starts again after 1 rev, "), "{said}");
}
