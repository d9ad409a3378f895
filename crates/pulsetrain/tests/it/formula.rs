//! `pulsetrain formula` as a user has it; and motion files whose mistakes the command line shows.

use expect_test::expect_file;
use pulsetrain::cli;
use pulsetrain::console::Exit;
use pulsetrain_testkit::folder::Folder;
use serde_json::Value;

fn pulsetrain(args: &[&str]) -> (Exit, String, String) {
    let (mut out, mut err) = (Vec::new(), Vec::new());
    let exit = cli::run([&["pulsetrain"], args].concat(), &mut out, &mut err);
    (exit, String::from_utf8(out).unwrap(), String::from_utf8(err).unwrap())
}

fn figures(args: &[&str]) -> Value {
    let (exit, out, err) = pulsetrain(&[&["formula", "--json"], args].concat());
    assert_eq!((exit, err.as_str()), (Exit::Success, ""), "{args:?}");
    serde_json::from_str(&out).unwrap()
}

#[track_caller]
fn near(value: &Value, expected: f64) {
    let value = value.as_f64().unwrap_or(f64::NAN);
    assert!((value - expected).abs() <= 1e-6 * (1.0 + expected.abs()), "{value}, not {expected}");
}

#[test]
fn it_prints_values_range_peaks_and_first_steps() {
    let (exit, out, err) = pulsetrain(&["formula", "90*sin(2*pi*0.5*t)^3", "--unit", "deg", "--duration", "10 s"]);
    assert_eq!((exit, err.as_str()), (Exit::Success, ""));
    expect_file!["golden/formula.txt"].assert_eq(&out);
    let (exit, out, err) = pulsetrain(&["formula", "--list"]);
    assert_eq!((exit, err.as_str()), (Exit::Success, ""));
    expect_file!["golden/formula-list.txt"].assert_eq(&out);
}

#[test]
fn the_figures_are_those_of_the_formula() {
    let of = figures(&[
        "a*t^2 - b",
        "--where",
        "a = 10 mm/s^2, b = 5",
        "--unit",
        "mm",
        "--lead",
        "8 mm",
        "--duration",
        "2 s",
        "--at",
        "0.5 s",
        "--at",
        "0 s",
    ]);
    near(&of["points"][0]["position"], -2.5);
    near(&of["points"][0]["speed"], 10.0);
    near(&of["points"][0]["acceleration"], 20.0);
    near(&of["points"][1]["position"], -5.0);
    near(&of["lowest"]["value"], -5.0);
    near(&of["highest"]["value"], 35.0);
    near(&of["highest"]["at_s"], 2.0);
    near(&of["peak_speed"]["value"], 40.0);
    assert_eq!(of["parameters"][0]["written"], "10 mm/s^2");
    // Its end is faster than a motor stops at once.
    assert!(of["refused"]["message"].as_str().unwrap().contains("pull-in"), "{of}");

    let of = figures(&["100*t + 30*sin(7*t)", "--unit", "step", "--duration", "3 s", "--steps", "200"]);
    // The last place where it turns round: 100 + 210·cos(7t) = 0.
    let top = (-10.0 / 21.0_f64).acos() + 6.0 * std::f64::consts::PI;
    near(&of["highest"]["value"], 100.0 * top / 7.0 + 30.0 * top.sin());
    near(&of["highest"]["at_s"], top / 7.0);
    near(&of["peak_speed"]["value"], 310.0);
    near(&of["peak_acceleration"]["value"], 1470.0);
    let steps = of["steps"]["first"].as_array().unwrap();
    assert_eq!(steps.len(), 200);
    let tick_s = of["steps"]["tick_s"].as_f64().unwrap();
    for step in steps {
        // A step is made half-way to the next position, up to the hysteresis and the proven error.
        let at = step["at_s"].as_f64().unwrap();
        let theta = 100.0 * at + 30.0 * (7.0 * at).sin();
        assert!((step["tick"].as_f64().unwrap() * tick_s - at).abs() < 1e-12);
        assert!((theta - step["position"].as_f64().unwrap()).abs() < 0.55, "{step}: {theta}");
    }
    assert!(steps.windows(2).all(|pair| pair[0]["tick"].as_u64() < pair[1]["tick"].as_u64()));

    let of = figures(&["-2*sin(t)^2", "--unit", "rev", "--duration", "4 s", "--board", "uno"]);
    near(&of["lowest"]["value"], -2.0);
    near(&of["lowest"]["at_s"], std::f64::consts::FRAC_PI_2);
    assert_eq!(of["steps"]["board"], "uno");
    let of = figures(&["90*t/10", "--unit", "revs", "--steps-per-rev", "48", "--microsteps", "2", "--steps", "0"]);
    near(&of["highest"]["value"], 90.0);
    assert_eq!(of["steps"]["count"], 90 * 96);
    let of = figures(&["t/10", "--unit", "in", "--lead", "10 mm", "--steps", "1"]);
    near(&of["highest"]["value"], 1.0);
    assert_eq!(of["steps"]["count"], 4064);
}

#[test]
fn it_draws_the_formula() {
    let folder = Folder::new("formula-plot");
    let path = folder.path("x.svg");
    let (exit, out, err) = pulsetrain(&["formula", "90*sin(t)^3", "--plot", &path]);
    assert_eq!((exit, err.as_str()), (Exit::Success, ""), "{out}");
    assert!(std::fs::read_to_string(&path).unwrap().starts_with("<svg"));
    let (exit, _, err) = pulsetrain(&["formula", "90*sin(t)^3", "--plot", &folder.path("x.jpg")]);
    assert!(exit == Exit::Refused && err.contains("name it .svg or .png"), "{err}");
}

#[test]
fn mistakes_are_shown_at_their_place_with_what_to_write() {
    let cases: &[(&[&str], &[&str])] = &[
        (&["90*sn(t)"], &["did you mean `sin`?", "theta = '90*sn(t)'", "`pulsetrain formula --list`"]),
        (&["90 sin(t)"], &["write `90*sin(…)`"]),
        (&["2*(t + 1"], &["this bracket is never closed"]),
        (&["'"], &["a formula has no quotes"]),
        (&["t", "--unit", "degrees"], &["write unit = \"deg\""]),
        (&["t", "--unit", "s"], &["must be a unit of position"]),
        (&["t", "--unit", "mm"], &["--lead \"8 mm\""]),
        (&["t", "--duration", "5"], &["has no unit", "duration = \"5 s\""]),
        (&["t", "--duration", "0,5 s"], &["write duration = \"0.5 s\""]),
        (&["a*t", "--where", "a = 5 degrees"], &["write a = \"5 deg\""]),
        (&["a*t", "--where", "a"], &["gives no parameter a value", "--where \"a = 3\""]),
        (&["a*t", "--where", "sin = 3"], &["`sin` is a function in every formula"]),
        (&["b*t", "--where", "a = 3"], &["`b` is unknown", "parameters here: `a`"]),
        (&["t", "--at", "5 seconds"], &["write \"5 s\""]),
        (&["t", "--at", "20 s"], &["after the formula's end at 10 s"]),
        (&["1/(t - 2)"], &["`1/(t - 2)`: a division by 0"]),
        (&["if(t < 5, 10*t, 70)"], &["jumps"]),
        (&["1000*sin(9*t)", "--unit", "rev", "--board", "uno"], &["steps/s"]),
        (&[], &["<THETA>"]),
        (&["t", "--board", "unno"], &["there are"]),
    ];
    for (args, told) in cases {
        let (exit, _, err) = pulsetrain(&[&["formula"], *args].concat());
        assert_eq!(exit, Exit::Refused, "{args:?}: {err}");
        for told in *told {
            assert!(err.contains(told), "{args:?}: {err}");
        }
    }
}

/// What a user meets who writes such a file.
#[test]
fn wrong_files_are_shown_in_few_words() {
    let folder = Folder::new("wrong-files");
    let wheel = "[motor.wheel]\nsteps_per_rev = 200\nmicrosteps = 8\ndriver = \"EasyDriver\"\npins = { step = 8, dir = 9 }\nforward = \"high\"\n";
    let motion = "[[motion]]\nmotor = \"wheel\"\nlaw.trapezoid = { distance = \"1 rev\", speed = \"1 rev/s\", acceleration = \"10 rpm/s\" }\n";
    let many: String =
        (0..500).map(|k| wheel.replace("wheel", &format!("m{k}")).replace("EasyDriver", "A9999")).collect();
    let first = motion.replace("wheel", "m0");
    let sum = vec!["sin(t)/5000"; 5000].join(" + ");
    let flat = format!(
        "[[motion]]\nmotor = \"wheel\"\nlaw.formula = {{ theta = \"{sum}\", unit = \"rad\", duration = \"1 s\" }}\nbegin = \"jump\"\nend = \"jump\"\n"
    );
    let good = format!("board = \"uno\"\n{wheel}{motion}").replace("10 rpm/s", "2 rev/s^2");
    for (name, text, exit, told, times) in [
        ("empty", String::new(), Exit::Refused, "`pulsetrain new NAME`", 1),
        ("acceleration", format!("board = \"uno\"\n{wheel}{motion}"), Exit::Refused, "  × ", 1),
        (
            "write",
            format!("board = \"uno\"\n{wheel}{motion}"),
            Exit::Refused,
            "write acceleration = \"0.166667 rev/s^2\"",
            1,
        ),
        ("many", format!("board = \"uno\"\n{many}{first}"), Exit::Refused, "  × ", 10),
        (
            "more",
            format!("board = \"uno\"\n{many}{first}").replace("10 rpm/s", "2 rev/s^2"),
            Exit::Refused,
            "and 491 more",
            1,
        ),
        ("brace", good.replace("2 rev/s^2\" }", "2 rev/s^2\""), Exit::Refused, "this `{` is never closed", 1),
        ("easydriver", good, Exit::Success, "wheel", 1),
        ("flat", format!("board = \"native\"\n{wheel}{flat}"), Exit::Success, "fits native", 1),
    ] {
        let path = folder.write(&format!("{name}.toml"), &text);
        let (ended, out, err) = pulsetrain(&["plan", &path]);
        let shown = out + &err;
        assert_eq!(ended, exit, "{name}: {shown}");
        assert!(
            shown.matches(told).count() >= times && (exit == Exit::Success || shown.matches(told).count() == times),
            "{name}: {shown}"
        );
    }
}
