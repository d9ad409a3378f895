//! What happens to files: outputs lose none, and inputs are read with bounds.
#![cfg(target_os = "linux")]

use crate::bounded::{Bounds, bounded, said};
use pulsetrain_testkit::folder::Folder;
use std::collections::BTreeSet;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::process::Command;

/// A recording moves the motor for 0.4 s.
const MOTION: &str = "board = \"uno\"\n[motor.wheel]\nsteps_per_rev = 200\npulse_high = \"2 us\"\npins = { step = 8, dir = 9 }\n\
    forward = \"high\"\nmax_acceleration = \"2000 rev/s^2\"\n[[motion]]\nmotor = \"wheel\"\n\
    law.table = { file = \"table.csv\", unit = \"step\" }\n";
const TABLE: &str = "t,x\n0,0\n0.2,3\n0.4,0\n";
const WINCH: &str = "0 s: a x 10\n";

/// A folder with a motion, what it names, a script, a capture, a log and an image.
struct Desk(Folder);

impl Desk {
    fn new(name: &str) -> Desk {
        let desk = Desk(Folder::new(name));
        desk.0.write("m.toml", MOTION);
        desk.0.write("table.csv", TABLE);
        desk.0.write("script.txt", WINCH);
        desk.0.write("live.toml", crate::live::TEXT);
        desk
    }

    fn run(&self, arguments: &[&str], input: &str, code: i32) -> String {
        let output = bounded(&self.0.0, Bounds::default(), arguments, input.as_bytes());
        let said = said(&output);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        said
    }

    fn text(&self, name: &str) -> String {
        String::from_utf8_lossy(&std::fs::read(self.0.path(name)).unwrap()).into_owned()
    }

    /// The names of all files.
    fn names(&self) -> BTreeSet<String> {
        let entries = std::fs::read_dir(&self.0.0).unwrap();
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect()
    }
}

#[test]
fn no_output_takes_the_place_of_an_input() {
    let desk = Desk::new("output-input");
    desk.run(&["run", "m.toml", "--out", "first"], "", 0);
    desk.run(&["live", "live.toml", "--native", "--log", "show.jsonl"], "stop\n", 0);
    std::fs::copy(desk.0.path("first/steps.csv"), desk.0.path("steps.csv")).unwrap();
    std::fs::create_dir(desk.0.path("sub")).unwrap();
    symlink("../table.csv", desk.0.path("sub/linked.svg")).unwrap();
    std::fs::hard_link(desk.0.path("m.toml"), desk.0.path("hard.svg")).unwrap();
    symlink("live.toml", desk.0.path("soft.vcd")).unwrap();
    // Recordings and motions that are called as outputs are.
    for (name, file) in [("steps.csv", "a.toml"), ("plot.svg", "b.toml"), ("report.json", "c.toml")] {
        let named = format!("in-{file}/{name}");
        std::fs::create_dir(desk.0.path(&format!("in-{file}"))).unwrap();
        desk.0.write(&named, TABLE);
        desk.0.write(file, &MOTION.replace("table.csv", &named));
    }
    std::fs::write(desk.0.path("m.svg"), MOTION).unwrap();
    std::fs::write(desk.0.path("table.hex"), TABLE).unwrap();
    desk.0.write("hex.toml", &MOTION.replace("table.csv", "table.hex"));
    desk.0.write("report.json", WINCH);
    let cases: [(&[&str], &str, &str); 17] = [
        (&["live", "live.toml", "--native", "--log", "live.toml"], "live.toml", "--log"),
        (&["live", "live.toml", "--native", "--trace", "./sub/../live.toml"], "live.toml", "--trace"),
        (&["live", "live", "--native", "--trace", "soft.vcd"], "live.toml", "--trace"),
        (&["live", "m.toml", "--native", "--log", "table.csv"], "table.csv", "--log"),
        (&["serve", "m.toml", "--native", "--page", "127.0.0.1:0", "--log", "m.toml"], "m.toml", "--log"),
        (&["plot", "m.toml", "--out", "sub/linked.svg"], "table.csv", "--out"),
        (&["plot", "m.toml", "--out", "hard.svg"], "m.toml", "--out"),
        (&["plot", "m.svg"], "m.svg", "--out"),
        (&["run", "a.toml", "--out", "in-a.toml"], "in-a.toml/steps.csv", "--out"),
        (&["run", "b.toml", "--out", "in-b.toml"], "in-b.toml/plot.svg", "--out"),
        (&["run", "c.toml", "--out", "in-c.toml"], "in-c.toml/report.json", "--out"),
        (&["replay", "show.jsonl", "--trace", "show.jsonl"], "show.jsonl", "--trace"),
        (&["replay", "show.jsonl", "--plot", "show.jsonl"], "show.jsonl", "--plot"),
        (&["bake", "hex.toml", "--output", "table.hex", "--no-rehearsal"], "table.hex", "--output"),
        (&["winch", "report.json", "--native", "--out", "."], "report.json", "--out"),
        (&["film", "steps.csv", "m.toml", "--out", "first", "--python", "none"], "first/steps.csv", ""),
        (
            &[
                "board",
                "uno",
                "--tcp",
                "127.0.0.1:0",
                "--for",
                "0.01 s",
                "--image",
                "first/steps.csv",
                "--trace",
                "first/steps.csv",
            ],
            "first/steps.csv",
            "",
        ),
    ];
    for (arguments, kept, option) in cases {
        let before = (desk.text(kept), desk.names());
        let said = desk.run(arguments, "stop\n", 2);
        assert!(said.contains(option), "{arguments:?}: {said}");
        if !option.is_empty() {
            assert!(said.contains("the command reads it"), "{arguments:?}: {said}");
        }
        assert_eq!((desk.text(kept), desk.names()), before, "{arguments:?}");
    }
}

#[test]
fn no_output_takes_the_place_of_another() {
    let desk = Desk::new("output-output");
    desk.0.write("x", "kept");
    symlink("x", desk.0.path("y")).unwrap();
    for (log, trace) in [("x", "x"), ("x", "./x"), ("new", "new"), ("x", "y")] {
        let before = desk.names();
        let said = desk.run(&["live", "live.toml", "--native", "--log", log, "--trace", trace], "stop\n", 2);
        assert!(said.contains("another file of the command"), "{said}");
        assert_eq!((desk.text("x").as_str(), desk.names()), ("kept", before));
    }
    let devices = ["live", "live.toml", "--native", "--log", "/dev/null", "--trace", "/dev/null"];
    desk.run(&devices, "stop\n", 0);
    let said = desk.run(&["live", "live.toml", "--native", "--log", "/dev/stdout"], "stop\n", 0);
    assert!(said.contains("\"pulsetrain_log\":1") && said.contains("stopped:"), "{said}");
    // The shell's output is a file, too.
    let script = "exec \"$0\" live live.toml --native --log out.txt > out.txt";
    let mut command = Command::new("sh");
    command.args(["-c", script, env!("CARGO_BIN_EXE_pulsetrain")]).current_dir(&desk.0.0);
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    assert!(said_of(&output.stderr).contains("the command's own output goes there"), "{output:?}");
}

fn said_of(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).replace('│', " ").split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Each log and each trace of a live motion is there afterwards, also those of runs that were killed, and of runs that did not begin.
#[test]
fn logs_and_traces_of_live_lose_none() {
    let desk = Desk::new("logs");
    let live = ["live", "live.toml", "--native", "--log", "show.jsonl", "--trace", "show.vcd"];
    let mut firsts = Vec::new();
    for number in 0..3 {
        desk.0.write("live.toml", &format!("# {number}\n{}", crate::live::TEXT));
        desk.run(&live, "stop\n", 0);
        firsts.push(format!("# {number}"));
    }
    for (name, number) in [("show.jsonl.1", 0), ("show.jsonl.2", 1), ("show.jsonl", 2)] {
        assert!(desk.text(name).lines().next().unwrap().contains(&firsts[number]), "{name}");
        assert!(desk.text(&name.replace("jsonl", "vcd")).contains("$enddefinitions"), "{name}");
    }
    // A start that fails leaves all as it is.
    let before = (desk.names(), desk.text("show.jsonl"), desk.text("show.vcd"));
    let refused: [&[&str]; 4] = [
        &["--page", "no.such.host:1"],
        &["--osc", "1.2.3.4:5"],
        &["--board", "no such board"],
        &["--midi", "no such port"],
    ];
    for more in refused {
        let arguments: Vec<&str> = live.iter().chain(more).copied().collect();
        desk.run(&arguments, "stop\n", 2);
        assert_eq!((desk.names(), desk.text("show.jsonl"), desk.text("show.vcd")), before, "{more:?}");
    }
    let port = ["live", "live.toml", "--port", "/dev/null", "--no-rehearsal", "--log", "show.jsonl"];
    desk.run(&port, "stop\n", 2);
    assert_eq!((desk.names(), desk.text("show.jsonl"), desk.text("show.vcd")), before);
}

/// What was there before a file that cannot be written whole is there afterwards; and nothing is left beside it.
#[test]
fn a_disk_without_room_loses_nothing() {
    let desk = Desk::new("full");
    desk.run(&["run", "m.toml", "--out", "out"], "", 0);
    let names = ["report.json", "steps.csv", "trace.vcd", "plot.svg"];
    let before = names.map(|name| desk.text(&format!("out/{name}")));
    let tight = Bounds { file_blocks: 0, ..Bounds::default() };
    for command in [&["run", "m.toml", "--out", "out"][..], &["plot", "m.toml", "--out", "out/plot.svg"]] {
        let output = bounded(&desk.0.0, tight, command, b"");
        assert_eq!(output.status.code(), Some(2), "{command:?}: {}", said(&output));
        assert!(said(&output).contains("--out"), "{}", said(&output));
        assert_eq!(names.map(|name| desk.text(&format!("out/{name}"))), before, "{command:?}");
        assert_eq!(std::fs::read_dir(desk.0.path("out")).unwrap().count(), 4);
    }
}

/// A file that may not be written is not replaced; a link stays one; and who may read a file stays so.
#[test]
fn a_replaced_file_stays_what_it_was() {
    let desk = Desk::new("replaced");
    let set = |name: &str, mode: u32| {
        std::fs::set_permissions(desk.0.path(name), std::fs::Permissions::from_mode(mode)).unwrap();
    };
    desk.0.write("kept.svg", "kept");
    set("kept.svg", 0o444);
    let said = desk.run(&["plot", "m.toml", "--out", "kept.svg"], "", 2);
    assert!(said.contains("you may not") && said.contains("--out"), "{said}");
    assert_eq!(desk.text("kept.svg"), "kept");
    desk.0.write("far.svg", "old");
    set("far.svg", 0o640);
    symlink("far.svg", desk.0.path("link.svg")).unwrap();
    desk.run(&["plot", "m.toml", "--out", "link.svg"], "", 0);
    assert!(std::fs::symlink_metadata(desk.0.path("link.svg")).unwrap().is_symlink());
    assert!(desk.text("far.svg").contains("<svg"));
    assert_eq!(std::fs::metadata(desk.0.path("far.svg")).unwrap().permissions().mode() & 0o777, 0o640);
    symlink("not-yet.svg", desk.0.path("dangling.svg")).unwrap();
    desk.run(&["plot", "m.toml", "--out", "dangling.svg"], "", 0);
    assert!(desk.text("not-yet.svg").contains("<svg"));
    let long = format!("{}.svg", "n".repeat(251));
    desk.run(&["plot", "m.toml", "--out", &long], "", 0);
    assert!(desk.text(&long).contains("<svg"));
}

/// A pipe that nobody reads, and a pipe that somebody reads.
#[test]
fn a_pipe_takes_an_output_if_somebody_reads_it() {
    let desk = Desk::new("pipes-out");
    assert!(Command::new("mkfifo").arg(desk.0.path("pipe.svg")).status().unwrap().success());
    let refused = desk.run(&["plot", "m.toml", "--out", "pipe.svg"], "", 2);
    assert!(refused.contains("nobody reads this pipe"), "{refused}");
    let reader = Command::new("cat").arg(desk.0.path("pipe.svg")).stdout(std::process::Stdio::piped()).spawn().unwrap();
    // Until the reader opens it, nobody reads it.
    let output = loop {
        let output = bounded(&desk.0.0, Bounds::default(), &["plot", "m.toml", "--out", "pipe.svg"], b"");
        if !said(&output).contains("nobody reads") {
            break output;
        }
    };
    let drawn = reader.wait_with_output().unwrap().stdout;
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    assert!(said_of(&drawn).contains("<svg"));
}

/// Devices never end, and pipes that nobody writes to never begin.
#[test]
fn what_is_no_file_is_refused_before_it_is_read() {
    let desk = Desk::new("inputs");
    assert!(Command::new("mkfifo").arg(desk.0.path("pipe")).status().unwrap().success());
    symlink("/dev/zero", desk.0.path("zero.toml")).unwrap();
    std::fs::File::create(desk.0.path("huge")).unwrap().set_len(20_000_000_000).unwrap();
    desk.0.write("named.toml", &MOTION.replace("table.csv", "/dev/zero"));
    desk.0.write("piped.toml", &MOTION.replace("table.csv", "pipe"));
    let commands: [&[&str]; 16] = [
        &["verify", "?", "m.toml"],
        &["replay", "?"],
        &["winch", "?", "--native"],
        &["verbs", "?", "--board", "pico"],
        &["flash", "uno", "--port", "/dev/null", "--image", "?"],
        &["flash", "pico", "--port", ".", "--image", "?"],
        &["board", "uno", "--tcp", "127.0.0.1:0", "--image", "?"],
        &["board", "uno", "--tcp", "127.0.0.1:0", "--bootloader", "?"],
        &["film", "?", "m.toml", "--python", "none"],
        &["run", "?"],
        &["plan", "?"],
        &["live", "?", "--native"],
        &["motor", "--file", "?"],
        &["bake", "?", "--output", "x.hex"],
        &["explain", "?"],
        &["verbs", "script.txt", "--board", "pico", "--motors", "?"],
    ];
    let tight = Bounds { memory_mb: 700, processor_s: 5, ..Bounds::default() };
    for command in commands {
        for input in ["/dev/zero", "pipe", "huge", "zero.toml"] {
            // A film of any size is read by another program, which this test does not have.
            if command[0] == "film" && input == "huge" {
                continue;
            }
            let arguments: Vec<&str> = command.iter().map(|word| if *word == "?" { input } else { word }).collect();
            let output = bounded(&desk.0.0, tight, &arguments, b"");
            let said = said(&output);
            assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
            // The folder is no drive of a Pico, which is said first.
            if command[1] != "pico" {
                let why = if input == "huge" { "is the most that is read" } else { "a device or a pipe, not a file" };
                assert!(said.contains(why), "{arguments:?}: {said}");
            }
        }
    }
    for file in ["named.toml", "piped.toml"] {
        assert!(desk.run(&["plan", file], "", 2).contains("a device or a pipe, not a file"));
    }
}

/// A line without an end, and lines without an end.
#[test]
fn standard_input_takes_no_memory() {
    let desk = Desk::new("typed");
    let tight = Bounds { memory_mb: 700, processor_s: 20, ..Bounds::default() };
    let endless = [vec![b'a'; 50_000_000], b"\nversion\nquit\n".to_vec()].concat();
    let output = bounded(&desk.0.0, tight, &["winch", "--native"], &endless);
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    assert!(said(&output).contains("err long"), "{}", said(&output));
    let endless = [vec![b'a'; 50_000_000], b"\nstop\n".to_vec()].concat();
    let output = bounded(&desk.0.0, tight, &["live", "live.toml", "--native"], &endless);
    assert_eq!(output.status.code(), Some(0), "{}", said(&output));
}

/// Sizes that grew with the square of what they count. Each took more than a minute.
#[test]
fn large_inputs_take_a_moment() {
    let desk = Desk::new("large");
    let (head, motion) = MOTION.split_at(MOTION.find("[[motion]]").unwrap());
    let many = |count: usize, text: &dyn Fn(usize) -> String| (0..count).map(text).collect::<String>();
    let table = |name: &str, text: &str| {
        desk.0.write(name, text);
        MOTION.replace("table.csv", name)
    };
    let sines = |count: usize| {
        let terms: Vec<String> = (1..=count).map(|k| format!("0.0001*sin({k}.5*t)")).collect();
        format!(
            "{head}[[motion]]\nmotor = \"wheel\"\nlaw.formula = {{ theta = \"{}\", unit = \"deg\", duration = \"1 s\" }}\n",
            terms.join("+")
        )
    };
    let cases = [
        ("keys", format!("{}{MOTION}", many(300_000, &|k| format!("k{k} = 1\n")))),
        ("keys of a motor", format!("{head}{}{motion}", many(300_000, &|k| format!("k{k} = 1\n")))),
        ("motors", format!("{MOTION}{}", many(100_000, &|k| format!("[motor.m{k}]\nsteps_per_rev = 200\n")))),
        (
            "motions",
            format!(
                "{MOTION}{}",
                many(100_000, &|_| "[[motion]]\nmotor = \"wheel\"\nlaw.rest = { duration = \"1 s\" }\n".to_owned())
            ),
        ),
        (
            "motions of nobody",
            format!(
                "{MOTION}{}",
                many(100_000, &|k| format!("[[motion]]\nmotor = \"m{k}\"\nlaw.rest = {{ duration = \"1 s\" }}\n"))
            ),
        ),
        ("cues", format!("{MOTION}{}", many(100_000, &|k| format!("[[cue]]\nname = \"c{k}\"\n")))),
        (
            "knobs",
            format!("{MOTION}[live.knobs]\n{}", many(100_000, &|k| format!("k{k} = {{ target = \"wheel.a{k}\" }}\n"))),
        ),
        ("quotes", format!("{MOTION}x = {}", "\"".repeat(3_000_000))),
        ("brackets", format!("x = {}", "[".repeat(3_000_000))),
        ("columns", table("columns.csv", &many(200_000, &|k| format!("c{k},")))),
        ("columns of numbers", table("numbers.csv", &"1,".repeat(200_000))),
        ("columns of one name", table("same.csv", &format!("{}\n0,1\n", "t,".repeat(900)))),
        ("quotes in a table", table("quotes.csv", &"\"".repeat(3_000_000))),
        ("lines of quotes", table("lines.csv", &format!("t,x\n{}", "\"\n".repeat(1_000_000)))),
        ("comments", table("comments.csv", &format!("{}t,x\n0,y\n", "# c\n".repeat(1_000_000)))),
        ("4000 sines", sines(4000)),
        ("5000 sines", sines(5000)),
    ];
    for (name, text) in cases {
        let file = format!("{}.toml", name.replace(' ', "-"));
        desk.0.write(&file, &text);
        // To explain a sum of thousands takes long, and says how far it is.
        let commands = if name.ends_with("sines") { &["plan"][..] } else { &["plan", "explain"] };
        for command in commands {
            let output = bounded(&desk.0.0, Bounds::default(), &[command, &file], b"");
            assert_eq!(output.status.code(), Some(2), "{command} {name}: {}", said(&output));
            assert!(output.stdout.len() + output.stderr.len() < 20_000, "{command} {name}");
        }
    }
    let said = desk.run(&["plan", "keys.toml"], "", 2);
    assert_eq!(said.matches("unknown key").count(), 10, "{said}");
    assert!(said.contains("and 299990 more"), "{said}");
}

/// Names in files, in arguments and of files: none of them is an order for a terminal, and JSON stays what it was.
#[test]
fn names_are_no_orders_for_a_terminal() {
    let desk = Desk::new("orders");
    let name = "w\u{1b}[2J\u{202e}\u{9b}31m\r";
    let quoted = "w\\u001b[2J\\u202e\\u009b31m\\r";
    desk.0.write(
        "orders.toml",
        &MOTION
            .replace("[motor.wheel]", &format!("[motor.\"{quoted}\"]"))
            .replace("\"wheel\"", &format!("\"{quoted}\"")),
    );
    let file = format!("{name}.toml");
    desk.0.write(&file, "board = \"unö\"\n");
    let no_file = format!("no{name}");
    let commands: [&[&str]; 9] = [
        &["plan", "orders.toml"],
        &["plan", "orders.toml", "--json"],
        &["run", "orders.toml", "--native", "--out", "out", "--verbose"],
        &["run", "orders.toml", "--native", "--out", "out", "--json"],
        &["plan", &file],
        &["plan", &file, "--json"],
        &["plan", &no_file],
        &["goto", &file, "x", name],
        &[name],
    ];
    for arguments in commands {
        let output = bounded(&desk.0.0, Bounds::default(), arguments, b"");
        for stream in [&output.stdout, &output.stderr] {
            let text = std::str::from_utf8(stream).unwrap();
            assert!(!text.contains(pulsetrain::clean::is_order), "{arguments:?}: {text:?}");
        }
        if arguments.contains(&"--json") && arguments.contains(&"orders.toml") {
            let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
            assert_eq!(json["motors"][0]["name"], name, "{json}");
        }
    }
    let report = desk.text("out/report.json");
    assert!(!report.contains(pulsetrain::clean::is_order), "{report:?}");
}

/// A spreadsheet works out what begins so. The file is still read as what it was.
#[test]
fn a_motor_is_no_formula_of_a_spreadsheet() {
    let desk = Desk::new("spreadsheet");
    for (number, name) in ["=HYPERLINK(1)", "+1", "-1", "@SUM(1)", "\\t=1", "'=1", " =1"].into_iter().enumerate() {
        let (file, out) = (format!("m{number}.toml"), format!("out{number}"));
        desk.0.write(
            &file,
            &MOTION
                .replace("[motor.wheel]", &format!("[motor.\"{name}\"]"))
                .replace("\"wheel\"", &format!("\"{name}\"")),
        );
        desk.run(&["run", &file, "--native", "--out", &out], "", 0);
        let steps = desk.text(&format!("{out}/steps.csv"));
        let field = steps.lines().nth(1).unwrap().split(',').nth(1).unwrap();
        assert!(field.starts_with("\"'"), "{field}");
        desk.run(&["verify", &format!("{out}/steps.csv"), &file], "", 0);
    }
}
