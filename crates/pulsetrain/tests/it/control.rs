//! `stop`, `status` and `goto`: the control socket of runs, with processes. Nothing here depends on how long something takes.
#![cfg(unix)]

use pulsetrain_testkit::folder::Folder;
use serde_json::Value;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc::{Receiver, channel};

/// A motion that takes minutes in virtual time, with a step each second of it.
const SLOW: &str = "board = \"native\"\n[motor.wheel]\nsteps_per_rev = 200\npulse_high = \"2 us\"\npins = { step = 8, dir = 9 }\n\
    forward = \"high\"\nmax_acceleration = \"1 rev/s^2\"\n[[motion]]\nmotor = \"wheel\"\n\
    law.speed = { speed = \"0.005 rev/s\", duration = \"1000000 s\" }\n";

/// A user with a runtime folder of their own.
struct User {
    folder: Folder,
}

impl User {
    fn new(name: &str) -> User {
        let folder = Folder::new(name);
        std::fs::DirBuilder::new().mode(0o700).create(folder.0.join("run")).unwrap();
        User { folder }
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_pulsetrain"));
        command.args(arguments).env("XDG_RUNTIME_DIR", self.folder.0.join("run")).current_dir(&self.folder.0);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// Exit code and all output, with the breaks of long lines taken out.
    #[track_caller]
    fn says(&self, arguments: &[&str], code: i32) -> String {
        let output = self.command(arguments).output().unwrap();
        let said = all(&output);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        said
    }

    fn sockets(&self) -> Vec<PathBuf> {
        let Ok(folder) = std::fs::read_dir(self.folder.0.join("run/pulsetrain")) else { return Vec::new() };
        let paths = folder.map(|entry| entry.unwrap().path());
        let mut sockets: Vec<PathBuf> =
            paths.filter(|path| path.extension().is_some_and(|end| end == "sock")).collect();
        sockets.sort();
        sockets
    }

    /// A run of the slow motion, in motion.
    fn slow_run(&self, out: &str) -> (Child, Line) {
        std::fs::write(self.folder.0.join("slow.toml"), SLOW).unwrap();
        let run = self.command(&["run", "slow", "--yes", "--out", out]).spawn().unwrap();
        let line = self.line_to(&run);
        (run, line)
    }

    /// A live motion of the slow file, in motion, which reads lines.
    fn live(&self, options: &[&str]) -> (Child, Line) {
        std::fs::write(self.folder.0.join("slow.toml"), SLOW).unwrap();
        let mut command = self.command(&["live", "slow", "--native"]);
        let live = command.args(options).stdin(Stdio::piped()).spawn().unwrap();
        let line = self.line_to(&live);
        (live, line)
    }

    /// A connection to a run that moves.
    fn line_to(&self, run: &Child) -> Line {
        let own = format!("-{}.sock", run.id());
        let socket = loop {
            let own = self.sockets().into_iter().find(|socket| socket.to_string_lossy().ends_with(&own));
            match own {
                Some(socket) => break socket,
                None => std::thread::yield_now(),
            }
        };
        let mut line = Line::open(&socket);
        line.send("{\"follow\":true}");
        line.until(|event| event["event"] == "status" && event["motors"][0]["position"] != 0);
        line.send("{\"follow\":false}");
        line
    }
}

fn all(output: &Output) -> String {
    let text = String::from_utf8(output.stdout.clone()).unwrap() + &String::from_utf8(output.stderr.clone()).unwrap();
    text.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
}

/// A client's end of a control socket. A thread of its own reads it, since a run hangs up on a client that reads nothing for a second.
struct Line {
    stream: UnixStream,
    lines: Receiver<String>,
    first: Value,
}

impl Line {
    fn open(socket: &PathBuf) -> Line {
        let stream = UnixStream::connect(socket).unwrap();
        let (read, lines) = channel();
        let input = BufReader::new(stream.try_clone().unwrap());
        std::thread::spawn(move || input.lines().map_while(Result::ok).try_for_each(|line| read.send(line)));
        let first = serde_json::from_str(&lines.recv().unwrap()).unwrap();
        Line { stream, lines, first }
    }

    fn send(&mut self, line: &str) {
        writeln!(self.stream, "{line}").unwrap();
    }

    /// The next line; `None` at the end.
    fn next(&mut self) -> Option<Value> {
        self.lines.recv().ok().map(|line| serde_json::from_str(&line).unwrap())
    }

    /// The lines up to one that is meant, which is the last.
    fn until(&mut self, is_meant: impl Fn(&Value) -> bool) -> Vec<Value> {
        let mut lines = Vec::new();
        loop {
            lines.push(self.next().expect("a line"));
            if lines.last().is_some_and(&is_meant) {
                return lines;
            }
        }
    }
}

/// The command that a text shows in the end, as its words.
fn shown_command(text: &str) -> Vec<String> {
    let from = text.find("pulsetrain goto").expect("it shows the way back");
    let mut words = vec![String::new()];
    for (part, text) in text[from..].lines().next().unwrap().split('"').enumerate() {
        for (word, text) in text.split(|letter: char| letter == ' ' && part % 2 == 0).enumerate() {
            if word > 0 {
                words.push(String::new());
            }
            words.last_mut().unwrap().push_str(text);
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

/// A second program for the same port is refused. The error names the run that uses the port, and says what to do.
#[test]
fn a_run_that_has_the_port_is_named() {
    let user = User::new("ctl-taken");
    let (run, line) = user.slow_run("out");
    let name = line.first["name"].as_str().unwrap().to_owned();
    let said = user.says(&["goto", "slow.toml", "0.1 rev", "--from", "0 rev", "--port", &name], 2);
    assert!(said.contains(&format!("{name} is in use: the run of slow.toml has it")), "{said}");
    assert!(said.contains(&format!("`pulsetrain stop --port {name}`")), "{said}");
    user.says(&["stop"], 0);
    run.wait_with_output().unwrap();
    // A live motion goes there itself.
    let (mut run, mut line) = user.live(&["--quiet"]);
    let name = line.first["name"].as_str().unwrap().to_owned();
    let said = user.says(&["goto", "slow.toml", "0.1 rev", "--from", "0 rev", "--port", &name], 2);
    assert!(said.contains("the live motion of slow.toml has it") && said.contains("type `goto`"), "{said}");
    // What is refused, and how it ends, in the words that were typed.
    let mut typed = run.stdin.take().unwrap();
    typed.write_all(b"tempo 20\n").unwrap();
    line.until(|event| event["event"] == "refused");
    typed.write_all(b"quit\n").unwrap();
    let said = all(&run.wait_with_output().unwrap());
    assert!(said.contains("refused: tempo 20: a tempo is a number above 0") && said.contains("stopped: "), "{said}");
}

#[test]
fn a_run_is_stopped_and_brought_back() {
    let user = User::new("ctl-stop");
    let (run, mut line) = user.slow_run("out");
    let said = user.says(&["stop"], 0);
    assert!(said.contains("the run of slow.toml at native-") && said.contains("the motors braked from "), "{said}");
    assert!(said.contains("back to the start: pulsetrain goto slow.toml \"0 rev\" --from \""), "{said}");
    // Others hear of it, in this order.
    let events = line.until(|event| event.get("ended").is_some());
    let names: Vec<&Value> =
        events.iter().filter_map(|event| event.get("event")).filter(|name| *name != "status").collect();
    assert_eq!(names, ["stopping"], "{events:?}");
    let last = events.last().unwrap();
    assert_eq!((&last["ended"], &last["motors"][0]["unit"]), (&"stopped".into(), &"rev".into()), "{last}");
    assert_eq!(line.next(), None);
    let output = run.wait_with_output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0), "a stop that was asked for is no failure: {text}");
    assert!(text.contains("within the motors' limits: wheel at "), "{text}");
    let report: Value = serde_json::from_slice(&std::fs::read(user.folder.0.join("out/report.json")).unwrap()).unwrap();
    let steps = report["stopped"]["motors"][0]["steps"].as_i64().unwrap();
    assert!(steps > 0 && last["motors"][0]["steps"] == steps, "{report}");
    assert_eq!(last["motors"][0]["position"].as_f64().unwrap(), steps as f64 / 200.0);
    assert!(std::fs::read_to_string(user.folder.0.join("out/steps.csv")).unwrap().lines().count() > steps as usize);
    assert_is_what_was_made(&user, &text, &report);
    assert!(user.sockets().is_empty(), "its socket is gone");
    // The command that it shows makes as many steps back.
    let command = shown_command(&text);
    let words: Vec<&str> = command[1..].iter().map(String::as_str).collect();
    user.says(&words, 0);
    let report = std::fs::read(user.folder.0.join("out/slow-goto/report.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    assert_eq!(report["motors"][0]["final_position_steps"], -steps, "{report}");
}

/// The report of a stopped run has what was made, not the plan that was ahead of it.
#[track_caller]
fn assert_is_what_was_made(user: &User, text: &str, report: &Value) {
    let (motor, steps) = (&report["motors"][0], report["stopped"]["motors"][0]["steps"].as_i64().unwrap());
    let number = |key: &str| motor[key].as_f64().unwrap();
    assert_eq!(
        (motor["steps"].as_i64(), motor["final_position_steps"].as_i64()),
        (Some(steps), Some(steps)),
        "{report}"
    );
    let end = steps as f64 / 200.0;
    assert_eq!(["lowest", "highest", "end"].map(number), [0.0, end, end], "{report}");
    // A step each second, and no faster.
    assert!((number("top_speed_per_s") - 0.005).abs() < 1e-6, "{report}");
    let csv = std::fs::read_to_string(user.folder.0.join("out/steps.csv")).unwrap();
    let last_s: f64 = csv.lines().next_back().unwrap().split(',').next().unwrap().parse().unwrap();
    assert_eq!(report["duration_s"].as_f64(), Some(last_s), "{report}");
    let row = text.lines().find(|line| line.trim_start().starts_with("wheel ")).expect("a row of the motor");
    let cells: Vec<&str> = row.split_whitespace().take(5).collect();
    let last = text.split("wheel at ").nth(1).and_then(|rest| rest.split(' ').next()).unwrap();
    let [high, end, at] =
        [cells[2], cells[4], last].map(|number| number.replace('\u{202f}', "").parse::<f64>().unwrap());
    assert!((high - at).abs() <= 0.001 * at && high == end, "{text}");
    assert!(text.lines().next().unwrap().ends_with(" made"), "{text}");
}

#[test]
fn one_of_several_runs_is_chosen_or_all() {
    let user = User::new("ctl-several");
    assert!(user.says(&["stop"], 2).contains("nothing runs on this computer"));
    assert!(user.says(&["status"], 0).contains("nothing runs on this computer"));
    let (one, one_line) = user.slow_run("one");
    let (mut other, _) = user.slow_run("other");
    let name = one_line.first["name"].as_str().unwrap();
    let said = user.says(&["stop"], 2);
    assert!(said.contains("2 runs are there") && said.contains(&format!("pulsetrain stop --port {name} ")), "{said}");
    let status = user.says(&["status"], 0);
    assert_eq!(status.matches("slow.toml at native-").count(), 2, "{status}");
    assert!(status.contains(" rev/s"), "{status}");
    assert!(user.says(&["stop", "--port", "native-1"], 2).contains("there is no port native-1"));
    user.says(&["stop", "--port", name], 0);
    assert_eq!(one.wait_with_output().unwrap().status.code(), Some(0));
    assert!(other.try_wait().unwrap().is_none(), "the other one goes on");
    let said = user.says(&["stop", "--all", "--now", "--json"], 0);
    let stopped: Value = serde_json::from_str(&said).unwrap();
    assert_eq!(stopped[0]["ended"], "stopped", "{said}");
    assert_eq!(stopped[0]["brakes_at_s"], Value::Null, "it does not brake");
    let text = String::from_utf8(other.wait_with_output().unwrap().stdout).unwrap();
    assert!(text.contains(" at once: wheel at "), "{text}");
}

#[test]
fn a_client_is_answered_line_by_line_and_cannot_flood_a_run() {
    let user = User::new("ctl-lines");
    let (mut run, mut line) = user.slow_run("out");
    let folder = user.folder.0.join("run/pulsetrain");
    let mode = |path: &PathBuf| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
    assert_eq!((mode(&folder), mode(&user.sockets()[0])), (0o700, 0o600), "for this user alone");
    assert_eq!(line.first["pulsetrain_control"], 1);
    assert_eq!((&line.first["board"], &line.first["motors"][0]["name"]), (&"native".into(), &"wheel".into()));
    let is_answer = |event: &Value| event["event"] != "status";
    for (sent, part) in [
        ("no json", "no line of JSON"),
        ("{\"command\":\"stopp\"}", "unknown variant `stopp`"),
        ("{\"follow\":3}", "true or false"),
        ("[1]", "no command"),
        ("\u{fffd}", "no line of JSON"),
    ] {
        line.send(sent);
        let answer = line.until(is_answer).pop().unwrap();
        assert!(answer["error"].as_str().is_some_and(|error| error.contains(part)), "{sent}: {answer}");
    }
    line.send("{\"command\":\"resume\"}");
    let refused = line.until(is_answer).pop().unwrap();
    assert_eq!((&refused["event"], &refused["command"]["command"]), (&"refused".into(), &"resume".into()));
    line.send("{\"command\":\"pause\"}");
    assert_eq!(line.until(is_answer).pop().unwrap()["event"], "pausing");
    // A line without an end: an error, and nothing more is read of this client.
    let mut endless = Line::open(&user.sockets()[0]);
    endless.stream.write_all(&[b'x'; 5000]).unwrap();
    assert!(endless.next().unwrap()["error"].as_str().unwrap().contains("4096 bytes"));
    // Too many clients are refused; those that are there are served.
    let mut many = Vec::new();
    let full = loop {
        let mut stream = BufReader::new(UnixStream::connect(&user.sockets()[0]).unwrap());
        let mut first = String::new();
        stream.read_line(&mut first).unwrap();
        if first.contains("\"error\"") {
            break first;
        }
        many.push(stream);
        assert!(many.len() < 100, "it takes any number of clients");
    };
    assert!(full.contains("16 clients"), "{full}");
    // One that reads nothing while statuses pour in does not hold up the others, nor the run's end.
    let deaf = many.first_mut().unwrap();
    writeln!(deaf.get_mut(), "{{\"follow\":true}}").unwrap();
    line.send("{\"follow\":true}");
    (0..1500).for_each(|_| drop(line.next().expect("a status")));
    line.send("{\"command\":\"stop\"}");
    assert_eq!(line.until(|event| event.get("ended").is_some()).pop().unwrap()["ended"], "stopped");
    assert_eq!(run.wait().unwrap().code(), Some(0));
}

#[test]
fn dead_sockets_are_removed_and_foreign_folders_refused() {
    let user = User::new("ctl-dead");
    user.says(&["status"], 0);
    let folder = user.folder.0.join("run/pulsetrain");
    // The socket stays when its process is killed.
    drop(UnixListener::bind(folder.join("ttyACM0-1.sock")).unwrap());
    std::fs::write(folder.join("file-2.sock"), "no socket").unwrap();
    assert!(user.says(&["stop"], 2).contains("nothing runs"));
    assert!(!folder.join("ttyACM0-1.sock").exists(), "nobody listens there");
    // A run that is killed leaves one, too.
    let (mut run, _) = user.slow_run("out");
    run.kill().unwrap();
    run.wait().unwrap();
    assert!(user.says(&["status"], 0).contains("nothing runs"));
    // Others could have put something there.
    std::fs::set_permissions(&folder, std::fs::Permissions::from_mode(0o777)).unwrap();
    assert!(user.says(&["stop"], 2).contains("is not this user's alone"));
    let said = user.says(&["goto", "slow.toml", "0.1 rev", "--from", "0 rev"], 0);
    assert!(said.contains("only Ctrl-C can: ") && said.contains("PASS"), "{said}");
}

/// The judge looks for the next step of a law that has none.
#[test]
fn an_endless_rest_is_stopped_and_judged() {
    let user = User::new("ctl-rest");
    let rest = SLOW.replace("speed = \"0.005 rev/s\", duration = \"1000000 s\"", "speed = \"0 rev/s\"");
    std::fs::write(user.folder.0.join("rest.toml"), rest).unwrap();
    let run = user.command(&["run", "rest", "--native", "--for", "forever", "--no-trace"]).spawn().unwrap();
    while user.sockets().is_empty() {
        std::thread::yield_now();
    }
    let mut line = Line::open(&user.sockets()[0]);
    line.send("{\"follow\":true}");
    line.until(|event| event["event"] == "status");
    user.says(&["stop"], 0);
    let output = run.wait_with_output().unwrap();
    let said = all(&output);
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(said.contains("This motion makes no step") && said.contains("PASS: stopped on your order"), "{said}");
}

/// The figure of a path without an end is compared with the path up to the stop.
#[test]
fn the_figure_of_an_endless_path_is_measured_up_to_the_stop() {
    let user = User::new("ctl-figure");
    let circle = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/circle.toml");
    let circle = std::fs::read_to_string(circle).unwrap();
    assert!(circle.contains("cycles = 2"));
    std::fs::write(user.folder.0.join("circle.toml"), circle.replace("cycles = 2", "cycles = \"forever\"")).unwrap();
    let files = ["--native", "--no-trace", "--no-steps"];
    let run =
        user.command(&[&["run", "circle", "--for", "forever", "--out", "out"][..], &files].concat()).spawn().unwrap();
    let _line = user.line_to(&run);
    user.says(&["stop"], 0);
    assert_eq!(run.wait_with_output().unwrap().status.code(), Some(0));
    let report: Value = serde_json::from_slice(&std::fs::read(user.folder.0.join("out/report.json")).unwrap()).unwrap();
    let figure = &report["figures"][0];
    assert!(figure["motor_steps"].as_f64().unwrap() < 1.0 && figure["tip"].as_f64().unwrap() < 0.02, "{figure}");
}

/// A run that plans, or judges at its end, sends no status: `status` does not wait for it.
#[test]
fn status_does_not_wait_for_a_run_that_is_silent() {
    let user = User::new("ctl-silent");
    let (mut run, line) = user.slow_run("out");
    let mut info = line.first.clone();
    info["name"] = "native-7".into();
    let silent = UnixListener::bind(user.folder.0.join("run/pulsetrain/native-7.sock")).unwrap();
    let server = std::thread::spawn(move || {
        for _ in 0..2 {
            let (mut stream, _) = silent.accept().unwrap();
            writeln!(stream, "{info}").unwrap();
            // To its client's end.
            stream.read_to_end(&mut Vec::new()).unwrap();
        }
    });
    let said = user.says(&["status"], 0);
    assert!(said.contains("slow.toml at native-7: no status now; it plans its motion"), "{said}");
    assert!(said.contains(&format!("slow.toml at native-{}, ", run.id())) && said.contains(" rev/s"), "{said}");
    let said = user.says(&["status", "--port", "native-7", "--json"], 0);
    let said: Value = serde_json::from_str(&said).unwrap();
    assert!(said["status"].is_null() && said["run"]["file"] == "slow.toml", "{said}");
    server.join().unwrap();
    run.kill().unwrap();
    run.wait().unwrap();
}

/// A motion without an end, and without files: its edges are judged up to the first change.
#[test]
fn an_endless_run_is_steered_and_stopped() {
    let user = User::new("ctl-endless");
    let endless = SLOW.replace("law.speed = { speed = \"0.005 rev/s\", duration = \"1000000 s\" }", SWING);
    std::fs::write(user.folder.0.join("endless.toml"), endless).unwrap();
    let files = ["--no-trace", "--no-steps"];
    let run =
        user.command(&[&["run", "endless", "--for", "forever", "--out", "out"][..], &files].concat()).spawn().unwrap();
    let _line = user.line_to(&run);
    let said = user.says(&["tempo", "0.5"], 0);
    assert!(said.contains("endless.toml at native-") && said.contains("tempo 0.5 from "), "{said}");
    assert!(user.says(&["tempo", "11"], 2).contains("above 0, and at most 10"));
    // 0.06 rev/s² of the motion itself, and 1 rev/s² for the motor.
    let said = user.says(&["tempo", "10"], 0);
    assert!(said.contains("the highest that the motors follow: wheel: max_acceleration"), "{said}");
    assert!(user.says(&["pause"], 0).contains("the motors rest from "));
    user.says(&["stop"], 0);
    let output = run.wait_with_output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(text.contains("PASS: stopped on your order; no bound broke up to "), "{text}");
    assert!(text.contains("on the native board: a motion without an end, "), "{text}");
    let mut names: Vec<_> =
        std::fs::read_dir(user.folder.0.join("out")).unwrap().map(|file| file.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["plot.svg", "report.json"]);
    let report: Value = serde_json::from_slice(&std::fs::read(user.folder.0.join("out/report.json")).unwrap()).unwrap();
    assert!(
        report["asked_s"].is_null()
            && report["judged_until_s"].as_f64().unwrap() > 0.0
            && report["stopped"]["motors"][0]["steps"].is_i64(),
        "{report}"
    );
    // Only a run can go on for ever.
    let said = user.says(&["plan", "endless", "--for", "forever"], 2);
    assert!(said.contains("a motion without an end has no whole plan"), "{said}");
}

/// A swing of a turn in 20 s, for ever.
const SWING: &str = "law.sine = { amplitude = \"0.5 rev\", period = \"20 s\", cycles = \"forever\" }";

/// Ctrl-C is the same stop.
#[test]
fn an_interrupted_run_tells_where_its_motors_are() {
    let user = User::new("ctl-interrupt");
    let (run, _line) = user.slow_run("out");
    assert!(Command::new("kill").args(["-INT", &run.id().to_string()]).status().unwrap().success());
    let output = run.wait_with_output().unwrap();
    let said = all(&output);
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(
        said.contains("within the motors' limits: wheel at ")
            && said.contains("pulsetrain goto slow.toml \"0 rev\" --from "),
        "{said}"
    );
}

/// A motion of two motors with units of their own, one of which does not begin at 0.
const TWO: &str = "board = \"native\"\n[motor.wheel]\nsteps_per_rev = 200\nmicrosteps = 8\ndriver = \"A4988\"\n\
    pins = { step = 2, dir = 3 }\nforward = \"high\"\nmax_speed = \"2 rev/s\"\nmax_acceleration = \"20 rev/s^2\"\n\
    [motor.arm]\nsteps_per_rev = 200\ndriver = \"A4988\"\nlead = \"8 mm\"\npins = { step = 4, dir = 5 }\nforward = \"high\"\n\
    [[motion]]\nmotor = \"wheel\"\nlaw.formula = { theta = \"45 + 45*sin(2*pi*t/4)^3\", unit = \"deg\", duration = \"4 s\" }\n\
    [[motion]]\nmotor = \"arm\"\nlaw.sine = { amplitude = \"4 mm\", period = \"4 s\", cycles = 1 }\n";

#[test]
fn a_position_is_reached_in_the_units_of_the_file_within_limits() {
    let user = User::new("ctl-goto");
    std::fs::write(user.folder.0.join("two.toml"), TWO).unwrap();
    // Steps that each motor makes; 0 if it stays.
    let check = |arguments: &[&str], expected: [i64; 2]| {
        user.says(&[&["goto", "two", "--native"], arguments].concat(), 0);
        let report = std::fs::read(user.folder.0.join("out/two-goto/report.json")).unwrap();
        let report: Value = serde_json::from_slice(&report).unwrap();
        let steps = [0, 1].map(|motor| report["motors"][motor]["final_position_steps"].as_i64().unwrap());
        assert_eq!(steps, expected, "{arguments:?}");
        let [speed, acceleration] = ["peak_speed_steps_per_s", "peak_acceleration_steps_per_s2"]
            .map(|key| report["motors"][0][key]["value"].as_f64().unwrap());
        assert!(speed <= 3200.0 && acceleration <= 32_000.0, "{speed} {acceleration}");
        assert!(report["verdict"]["ok"].as_bool().unwrap());
    };
    // The wheel begins at 45 deg, and a turn has 1600 steps.
    check(&["90 deg", "--motor", "wheel"], [200, 0]);
    check(&["0.5 rev", "--motor", "wheel", "--from", "0 deg"], [800, 0]);
    check(&["-1 rev", "--motor", "wheel", "--from", "wheel=1 rev"], [-3200, 0]);
    check(&["start", "--from", "wheel=46 deg", "--from", "arm=-8 mm"], [-4, 200]);
    check(&["4 mm", "--motor", "arm"], [0, 100]);
    check(&["100 full-steps", "--motor", "arm", "--from", "1 step"], [0, 99]);
    check(&["1 step", "--motor", "arm"], [0, 1]);
    let refused = |arguments: &[&str], part: &str| {
        let said = user.says(&[&["goto", "two", "--native"], arguments].concat(), 2);
        assert!(said.contains(part), "{arguments:?}: {said}");
    };
    refused(&["90 deg", "--motor", "whel"], "did you mean wheel?");
    refused(&["90"], "a bare number");
    refused(&["90 deg/s"], "is a speed");
    refused(&["90 mm", "--motor", "wheel"], "has no `lead`");
    refused(&["1e12 rev"], "steps away");
    refused(&["0 deg", "--from", "nobody=0 deg"], "the file has no motor nobody");
    refused(&["nan deg"], "is no position");
    let said = user.says(&["goto", "two", "start", "--native"], 0);
    assert!(said.contains("wheel at 45 deg, arm at 0 mm") && said.contains("there already: nothing moves"), "{said}");
}

#[test]
fn a_file_is_found_without_its_ending_and_an_example_is_named() {
    let user = User::new("ctl-names");
    std::fs::create_dir(user.folder.0.join("examples")).unwrap();
    std::fs::write(user.folder.0.join("examples/two.toml"), TWO).unwrap();
    assert!(user.says(&["plan", "examples/two"], 0).starts_with("examples/two.toml fits native: "));
    // A name alone is found among the examples, unless the folder has such a file itself. What names another place is not.
    assert!(user.says(&["plan", "two"], 0).starts_with("examples/two.toml fits native: "));
    for name in ["two.toml", "elsewhere/two"] {
        let said = user.says(&["plan", name], 2);
        assert!(said.contains("cannot read") && said.contains("did you mean examples/two.toml?"), "{said}");
    }
    let said = user.says(&["plan", "three"], 2);
    assert!(said.contains("cannot read") && !said.contains("did you mean"), "{said}");
    assert!(said.contains("`pulsetrain new NAME` writes a motion file"), "{said}");
    std::fs::write(user.folder.0.join("two.toml"), TWO).unwrap();
    assert!(user.says(&["plan", "two"], 0).starts_with("two.toml fits native: "));
}

/// Tests that run firmware on an emulated chip.
mod chips {
    use super::*;

    /// `pulsetrain board`, which ends with the test at the latest.
    struct Served(Child);

    impl Served {
        fn new(user: &User, board: &str) -> Served {
            let mut process = user.command(&["board", board, "--pty", board]).spawn().unwrap();
            let mut first = String::new();
            BufReader::new(process.stdout.as_mut().unwrap()).read_line(&mut first).unwrap();
            assert!(first.contains("a virtual "), "{first}");
            Served(process)
        }
    }

    impl Drop for Served {
        fn drop(&mut self) {
            let interrupted = Command::new("kill").args(["-INT", &self.0.id().to_string()]).status();
            drop(interrupted.map(|_| self.0.wait()));
        }
    }

    fn motion(user: &User, board: &str) {
        let text =
            TWO.replace("native", board).replace("period = \"4 s\", cycles = 1", "period = \"4 s\", cycles = 100");
        let text = text.replace("duration = \"4 s\"", "duration = \"400 s\"");
        std::fs::write(user.folder.0.join("two.toml"), text).unwrap();
    }

    /// The run has the port, so `stop` asks the run. This computer may be too slow for a board in real time: so there are
    /// several tries.
    #[test]
    fn a_run_at_a_port_is_stopped() {
        let user = User::new("ctl-port");
        motion(&user, "uno");
        let stopped = (0..5).find_map(|_| {
            let _served = Served::new(&user, "uno");
            let run = user.command(&["run", "two", "--port", "uno", "--no-rehearsal", "--out", "out"]).spawn().unwrap();
            let mut line = user.line_to(&run);
            assert_eq!(line.first["port"], "uno");
            // By another name of the same port.
            let stop = user.command(&["stop", "--port", &user.folder.path("uno")]).output().unwrap();
            let ended = line.until(|event| event.get("ended").is_some()).pop().unwrap();
            let text = all(&run.wait_with_output().unwrap());
            (ended["ended"] == "stopped").then(|| (all(&stop), stop.status.code(), text))
        });
        let Some((said, code, text)) = stopped else { panic!("no run could be stopped") };
        assert!(said.contains("the run of two.toml at uno: the motors braked from "), "{said}");
        assert_eq!(code, Some(0), "{said}");
        assert!(
            text.contains("Stopped on the way. The file gives no max_acceleration for arm")
                && text.contains("wheel is at "),
            "{text}"
        );
        assert!(
            text.contains("back to the start: pulsetrain goto two.toml start --port uno --from \"wheel="),
            "{text}"
        );
    }

    /// Opening the port resets an Uno: its position has to be told.
    #[test]
    fn nobody_knows_where_an_uno_stands() {
        let user = User::new("ctl-uno");
        let _served = Served::new(&user, "uno");
        std::fs::write(user.folder.0.join("two.toml"), TWO.replace("native", "uno")).unwrap();
        let said = user.says(&["goto", "two", "0 deg", "--motor", "wheel", "--port", "uno"], 2);
        assert!(
            said.contains("the position of wheel is not known") && said.contains("--from \"wheel=0 deg\""),
            "{said}"
        );
    }

    /// A run on a virtual board obeys, too, and one that has not begun does not begin.
    #[test]
    fn a_run_on_a_virtual_board_is_stopped() {
        let user = User::new("ctl-virtual");
        motion(&user, "uno");
        let run = user.command(&["run", "two", "--out", "out"]).spawn().unwrap();
        let mut line = user.line_to(&run);
        assert_eq!(line.first["port"], Value::Null);
        line.send("{\"command\":\"stop_now\"}");
        let events = line.until(|event| event.get("ended").is_some());
        assert!(events.iter().any(|event| event["event"] == "stopped_at_once"), "{events:?}");
        let output = run.wait_with_output().unwrap();
        assert!(output.status.success() && all(&output).contains(" at once: wheel at "), "{}", all(&output));
        let mut trace = String::new();
        std::fs::File::open(user.folder.0.join("out/trace.vcd")).unwrap().read_to_string(&mut trace).unwrap();
        let (_, edges) = trace.split_once("$enddefinitions").expect("the head of a trace");
        assert!(edges.lines().any(|line| line.starts_with('#')) && edges.ends_with('\n'), "{edges}");
    }
}
