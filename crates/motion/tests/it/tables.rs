//! Tables from CSV: which column is what, in which unit, and what is told of it.

use std::path::Path;

use proptest::prelude::*;
use pulsetrain_motion::file::{self, Contents};
use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::{Law, Time};

const MOTOR: &str = r#"board = "native"

[motor.wheel]
steps_per_rev = 200
microsteps = 2
driver = "DQ542MA"
pins = { step = 8, dir = 9 }
forward = "low"
lead = "8 mm"

[[motion]]
motor = "wheel"
"#;

/// 400 steps are a revolution, and 8 mm.
fn read(csv: &str, options: &str) -> Result<Contents, String> {
    let text = format!("{MOTOR}law.table = {{ file = \"a.csv\"{options} }}\n");
    let load = |path: &Path| {
        assert_eq!(path, Path::new("a.csv"));
        Ok(csv.to_owned())
    };
    file::read_contents(&text, "x.toml", &load).map_err(|error| error.plain())
}

fn at(law: &Law, seconds: f64) -> f64 {
    Cursor::new(law).at(Time::from_seconds(seconds)).unwrap().position
}

/// What a table does at some times, s and steps, and what is told of its columns.
#[track_caller]
fn check(csv: &str, options: &str, points: &[(f64, f64)], told: &str) {
    let contents = read(csv, options).unwrap_or_else(|error| panic!("{csv}\n{error}"));
    let law = &contents.program.motors[0].law;
    for (seconds, steps) in points {
        assert!((at(law, *seconds) - steps).abs() < 1e-9, "{csv}at {seconds} s: {}", at(law, *seconds));
    }
    let last = points.last().unwrap().0;
    assert!((law.end().unwrap().seconds() - last).abs() < 1e-9, "{csv}ends at {} s", law.end().unwrap().seconds());
    let tables: Vec<String> = contents.tables.iter().map(ToString::to_string).collect();
    assert_eq!(tables, [format!("a.csv: {told}")]);
}

#[test]
fn names_say_which_column_is_what() {
    let (deg, points) = (", unit = \"deg\"", [(0.0, 0.0), (0.5, 100.0), (1.0, 200.0)]);
    check(
        "i,t,a\n0,0,0\n1,0.5,90\n2,1,180\n",
        deg,
        &points,
        "time = column 2 `t`, s; angle = column 3 `a`, deg; column 1 `i` is not used",
    );
    check("a,t\n0,0\n90,0.5\n180,1\n", deg, &points, "time = column 2 `t`, s; angle = column 1 `a`, deg");
    check("t,a\n0,0\n0.5,90\n1,180\n", deg, &points, "time = column 1 `t`, s; angle = column 2 `a`, deg");
    check("0,0\n0.5,90\n1,180\n", deg, &points, "time = column 1, s; angle = column 2, deg");
    check("0,0,\n0.5,90,\n1,180,\n", deg, &points, "time = column 1, s; angle = column 2, deg");
    // The motor's own column goes before others; pandas leaves the index without a title.
    check(
        ",other,wheel,Time\n0,7,0,0\n1,7,90,0.5\n2,7,180,1\n",
        deg,
        &points,
        "time = column 4 `Time`, s; angle = column 3 `wheel`, deg; column 1, column 2 `other` are not used",
    );
    // As numpy writes a header.
    check("# a;t\n0;0\n90;0.5\n180;1\n", deg, &points, "time = column 2 `t`, s; angle = column 1 `a`, deg");
    check("# ms,deg\n0,0\n500,90\n1000,180\n", "", &points, "time = column 1 `ms`, ms; angle = column 2 `deg`, deg");
    // No titles: amounts.
    check("# 100 ms, 40 deg\n0,0\n0.5,90\n1,180\n", deg, &points, "time = column 1, s; angle = column 2, deg");
    check(
        "\u{feff}t;A\r\n0;0\r\n\r\n0.5;90\r\n;\r\n1;180\r\n",
        deg,
        &points,
        "time = column 1 `t`, s; angle = column 2 `A`, deg",
    );
    check(
        "n,t,x,y\n0,0,5,0\n1,0.5,5,90\n2,1,5,180\n",
        ", unit = \"deg\", columns = [\"t\", 4]",
        &points,
        "time = column 2 `t`, s; angle = column 4 `y`, deg; column 1 `n`, column 3 `x` are not used",
    );
}

#[test]
fn headers_give_units() {
    let points = [(0.0, 0.0), (0.5, 100.0), (1.0, 200.0)];
    let times = [
        ("Time [ms]", "ms", 1e3),
        ("t (us)", "us", 1e6),
        ("time in min", "min", 1.0 / 60.0),
        ("t / h", "h", 1.0 / 3600.0),
        ("time_ms", "ms", 1e3),
        ("milliseconds", "ms", 1e3),
        ("t_s", "s", 1.0),
    ];
    let angles = [
        ("angle [deg]", "angle", "deg", 180.0),
        ("theta (rad)", "angle", "rad", std::f64::consts::PI),
        ("phi in degrees", "angle", "deg", 180.0),
        ("a / turn", "angle", "turn", 0.5),
        ("pos_rev", "angle", "rev", 0.5),
        ("wheel steps", "position", "steps", 200.0),
        ("x [mm]", "position", "mm", 4.0),
        ("x [cm]", "position", "cm", 0.4),
        ("x [in]", "position", "in", 4.0 / 25.4),
        ("position (m)", "position", "m", 0.004),
        ("deg", "angle", "deg", 180.0),
    ];
    for (time, time_unit, ends) in times {
        for (angle, what, unit, turn) in angles {
            let csv = format!("{angle},{time}\n0,0\n{},{}\n{turn},{ends}\n", turn / 2.0, ends / 2.0);
            let told = format!("time = column 2 `{time}`, {time_unit}; {what} = column 1 `{angle}`, {unit}");
            check(&csv, "", &points, &told);
        }
    }
}

/// Of a table below that header: which columns are used and in which units; else what is said, and the fixes that are offered. All
/// columns grow, and none of them counts rows.
fn what_is_read(header: &str) -> String {
    let header = header.replace("\\n", "\n").replace("\\t", "\t").replace("\\u{feff}", "\u{feff}");
    let last = header.lines().last().unwrap();
    let separator = ['\t', ';', ','].into_iter().find(|separator| last.contains(*separator)).unwrap_or(',');
    let (separator, width) =
        if last.starts_with('#') { (',', 2) } else { (separator, last.split(separator).count().max(1)) };
    let row = |n: usize| {
        let cells: Vec<String> = (0..width).map(|column| (n * (n + 2) + column).to_string()).collect();
        cells.join(&separator.to_string()) + "\n"
    };
    let csv = header.clone() + "\n" + &(0..4).map(row).collect::<String>();
    let said = match read(&csv, "") {
        Err(said) if said.contains("law `table` has no `unit`") => match read(&csv, ", unit = \"deg\"") {
            Ok(contents) => return listed(&contents),
            Err(said) => said,
        },
        Err(said) => said,
        Ok(contents) => return listed(&contents),
    };
    let message = said.lines().next().unwrap().splitn(4, ':').last().unwrap().trim_start();
    let offers: Vec<String> = said
        .lines()
        .filter_map(|line| line.split_once(", write: "))
        .map(|(condition, fix)| {
            let contents = read(&csv, &format!(", {fix}")).unwrap_or_else(|error| panic!("{csv}{fix}: {error}"));
            for (used, what) in contents.tables[0].columns.iter().zip(["the time", "the position"]) {
                let (_, after) = condition.split_once(&format!("{} is {what}", used.column)).expect(condition);
                let unit = after.strip_prefix(" in ").map(|unit| unit.split([',', ' ']).next().unwrap());
                assert!(unit.is_none_or(|unit| unit == used.unit), "{condition}: {used:?}");
            }
            format!(" | {fix}")
        })
        .collect();
    format!("{message}{}", offers.concat())
}

/// `time 1 ms; angle 2 deg`
fn listed(contents: &Contents) -> String {
    let columns = contents.tables[0].columns.iter().map(|used| {
        let number = used.column.split(' ').nth(1).unwrap();
        format!("{} {number} {}", used.what, used.unit)
    });
    columns.collect::<Vec<String>>().join("; ")
}

/// A line each: a header, and how a table below it is read.
#[test]
fn headers() {
    const HEADERS: &str = include_str!("headers.txt");
    let read: Vec<String> = HEADERS
        .lines()
        .map(|line| match line.split_once(" => ") {
            Some((header, _)) => format!("{header} => {}", what_is_read(header)),
            None => line.to_owned(),
        })
        .collect();
    let headers = HEADERS.lines().filter(|line| line.contains(" => ")).count();
    assert!(headers >= 150, "{headers}");
    expect_test::expect_file!["headers.txt"].assert_eq(&(read.join("\n") + "\n"));
}

/// What counts rows is no time, and what does not grow is none either: they are not offered.
#[test]
fn numbers_tell_which_columns_are_offered() {
    let offered = |csv: &str, expected: &[&str]| {
        let said = read(csv, ", unit = \"deg\"").err().unwrap_or_else(|| panic!("{csv}is read"));
        let offers: Vec<&str> =
            said.lines().filter_map(|line| line.split_once(", write: ")).map(|(_, fix)| fix).collect();
        assert_eq!(offers, expected, "{csv}{said}");
        for fix in offers {
            read(csv, &format!(", unit = \"deg\", {fix}")).unwrap_or_else(|error| panic!("{csv}{error}"));
        }
    };
    offered("Bild,angle\n0,0\n1,10.5\n2,15\n", &[]);
    offered("Bild,Uhr,angle\n0,0.1,0\n1,0.3,10\n2,0.4,15\n", &["columns = [2, 3], time = \"s\""]);
    offered("Wert 1,Wert 2\n5,0\n3,0.5\n4,0.7\n", &["columns = [2, 1], time = \"s\""]);
    offered("Stunde 1,angle\n0,0\n1,10\n2,15\n", &["columns = [1, 2], time = \"s\""]);
    offered("0,0,5\n1,0.5,3\n2,0.7,9\n", &["columns = [2, 3], time = \"s\""]);
    offered("5,0\n3,0.5\n4,0.7\n", &["columns = [2, 1], time = \"s\""]);
    offered("t,foo\n0,0\n1,oops\n", &[]);
    offered("frame,angle\n0,0\n10,5\n25,7\n", &[]);
}

/// What is to be written in the header keeps the unit, the order and the separator that the file has; it works where the numbers are right.
#[test]
fn headers_that_are_offered_keep_units() {
    const CALL: &str = "if they are there under other names, call them so in the header: ";
    let offered = |csv: &str, header: &str| {
        let said = read(csv, "").err().unwrap_or_else(|| panic!("{csv}is read"));
        let found = said.lines().find_map(|line| line.trim().strip_prefix(CALL));
        assert_eq!(found, Some(header), "{csv}{said}");
        let separator = header.chars().find(|c| [',', ';', '\t'].contains(c)).unwrap();
        let rows = format!("{header}\n0{separator}0\n10{separator}10\n");
        read(&rows, "").unwrap_or_else(|error| panic!("{rows}{error}"));
    };
    offered("ms,crank\n0,0\n1000,oops\n900,2\n", "time [ms],angle [deg]");
    offered("ms;crank\n0;0\n1000;0,5x\n", "time [ms];angle [deg]");
    offered("crank\tms\n0\t0\noops\t10\n", "angle [deg]\ttime [ms]");
    offered("dt [ms],angle [rev]\n0,0\n1,10\n", "time [ms],angle [rev]");
    offered("frame;angle\n0;0\n1;10\n", "time [s];angle [deg]");
    // What the unit says holds although the times do not increase.
    let csv = "ms,crank\n0,0\n1000,90\n900,180\n";
    let said = read(csv, ", unit = \"deg\"").map(|_| ()).unwrap_err();
    assert!(said.contains("column 1 `ms` is the time and column 2 `crank` is the position in deg"), "{said}");
    assert!(said.trim_end().ends_with("write: columns = [1, 2]"), "{said}");
    let said = read(csv, ", unit = \"deg\", columns = [1, 2]").map(|_| ()).unwrap_err();
    assert!(said.starts_with("a.csv:4:1: times must increase"), "{said}");
    let right = csv.replace("900", "1900");
    check(
        &right,
        ", unit = \"deg\", columns = [1, 2]",
        &[(1.0, 100.0), (1.9, 200.0)],
        "time = column 1 `ms`, ms; angle = column 2 `crank`, deg",
    );
}

#[test]
fn decimal_commas_and_misspelt_columns() {
    let said = |csv: &str, options: &str| read(csv, &format!(", unit = \"deg\"{options}")).map(|_| ()).unwrap_err();
    let help = |said: String| said.lines().nth(1).unwrap_or_default().trim().to_owned();
    let points = [(0.0, 0.0), (0.5, 100.0)];
    check("t;a\n0;0\n0,5;90\n", ", unit = \"deg\"", &points, "time = column 1 `t`, s; angle = column 2 `a`, deg");
    check(
        "t,a\n0,0\n\"0,5\",\"9,0e1\"\n",
        ", unit = \"deg\"",
        &points,
        "time = column 1 `t`, s; angle = column 2 `a`, deg",
    );
    check("0,0;0,0\n0,5;90,0\n", ", unit = \"deg\"", &points, "time = column 1, s; angle = column 2, deg");
    assert_eq!(
        help(said("0,0,0,0\n0,5,90,0\n", "")),
        "if these are decimal commas, separate the columns with `;` or tabs, or write decimals with a point: 0.5"
    );
    assert_eq!(help(said("t;a\n0;0\n1;1.234,5\n", "")), "write no sign for thousands: 1234.5, or 1234,5");
    assert!(said("t;a\n0;0\n0,5,1;1\n", "").starts_with("a.csv:3:1: expected a number, found `0,5,1` in column 1 `t`"));
    assert_eq!(
        said("t;a\n0;0\n0.5;1,234\n", ""),
        "a.csv:3:5: column 2 `a` has `1,234`, but numbers above it are written with a decimal point\n    \
         write all numbers with a decimal point, or all with a decimal comma; a sign for thousands is none\n"
    );
    let csv = "when,where\n0,0\n0.5,90\n";
    assert_eq!(help(said(csv, ", columns = [\"when\", \"wher\"]")), "did you mean \"where\"?");
    read(csv, ", unit = \"deg\", columns = [\"when\", \"where\"]").unwrap();
}

/// What a clock gives is not read as seconds.
#[test]
fn clocks() {
    let said = |rows: &str, options: &str| read(&format!("timestamp,angle\n{rows}"), options).map(|_| ()).unwrap_err();
    for (first, unit) in [("1700000000000", "ms"), ("1700000000000000", "us"), ("1700000000000000000", "ns")] {
        let rows = format!("{first},0\n{},5\n", first.replacen("17", "18", 1));
        let expected = format!(
            "a.csv:2:1: column 1 `timestamp` begins at {first}: a date of a clock, but not in s\n    \
             if it counts {unit}, write: time = \"{unit}\"\n"
        );
        assert_eq!(said(&rows, ", unit = \"deg\""), expected);
        let told = format!("time = column 1 `timestamp`, {unit}; angle = column 2 `angle`, deg");
        let contents =
            read(&format!("timestamp,angle\n{rows}"), &format!(", unit = \"deg\", time = \"{unit}\"")).unwrap();
        assert_eq!(contents.tables[0].to_string(), format!("a.csv: {told}"));
    }
    check(
        "timestamp,angle\n1700000000.5,0\n1700000001.5,180\n",
        ", unit = \"deg\"",
        &[(0.0, 0.0), (1.0, 200.0)],
        "time = column 1 `timestamp`, s; angle = column 2 `angle`, deg",
    );
    let date = "24.11.2026 10:00";
    let expected = format!(
        "a.csv:2:1: expected a number, found `{date}` in column 1 `timestamp`\n    \
         a date is written like 2026-11-27T10:00:00.5; or count seconds from the first row\n"
    );
    assert_eq!(said(&format!("{date},0\n{date},5\n"), ", unit = \"deg\""), expected);
    // All digits of a clock that counts ns since 1970.
    check(
        "timestamp [ns],angle\n1700000000123456789,0\n1700000000123457789,90\n",
        ", unit = \"deg\"",
        &[(0.0, 0.0), (1e-6, 100.0)],
        "time = column 1 `timestamp [ns]`, ns; angle = column 2 `angle`, deg",
    );
}

/// Dates and times of day as ISO 8601 has them: the motion begins at the first.
#[test]
fn moments() {
    let deg = ", unit = \"deg\"";
    let points = [(0.0, 0.0), (0.5, 100.0), (1.0, 200.0)];
    for (title, [first, second, third], unit) in [
        ("timestamp", ["2026-11-27T10:00:00Z", "2026-11-27T10:00:00.5Z", "2026-11-27T10:00:01.000Z"], "date and time"),
        ("time", ["2028-02-28 23:59:59.5", "2028-02-29 00:00:00", "2028-02-29 00:00:00.5"], "date and time"),
        (
            "Time (UTC)",
            ["2026-12-31T23:59:59.5+00:00", "2027-01-01T00:00:00Z", "2027-01-01T01:00:00.5+01:00"],
            "date and time",
        ),
        ("t", ["10:00:59.25", "10:00:59.75", "10:01:00.25"], "time of day"),
    ] {
        let csv = format!("{title},angle\n{first},0\n{second},90\n{third},180\n");
        check(&csv, deg, &points, &format!("time = column 1 `{title}`, {unit}; angle = column 2 `angle`, deg"));
    }
    let said = |first: &str, second: &str, options: &str| {
        read(&format!("t,a\n{first},0\n{second},90\n"), &format!("{deg}{options}")).map(|_| ()).unwrap_err()
    };
    assert!(said("10:00:00", "2026-11-27T10:00:01", "").contains("a.csv:3:1: expected a time as in the first row"));
    assert!(said("10:00:00", "1", "").contains("a.csv:3:1: expected a time as in the first row"));
    assert!(said("23:59:59", "00:00:00", "").contains("`00:00:00` after a later or equal time"));
    assert!(said("10:00:00", "10:00:01", ", time = \"s\"").contains("times of day, which have no unit"));
}

/// As instruments, spreadsheets, phones and numpy write recordings.
#[test]
fn forms_of_recordings() {
    let deg = ", unit = \"deg\"";
    let points = [(0.0, 0.0), (0.5, 100.0), (1.0, 200.0)];
    let ta = "time = column 1 `t`, s; angle = column 2 `a`, deg";
    let plain = "time = column 1, s; angle = column 2, deg";
    for (csv, told) in [
        ("sep=;\nt;a\n0;0\n0,5;90\n1;180\n", ta),
        ("\"sep=;\"\r\nt;a\r\n0;0\r\n0,5;90\r\n1;180\r\n", ta),
        ("sep=,\nt,a\n0,0\n0.5,90\n1,180\n", ta),
        ("SEP=\t\nt\ta\n0\t0\n0,5\t90\n1\t180\n", ta),
        ("t|a\n0|0\n0.5|90\n1|180\n", ta),
        // Old Macs.
        ("t,a\r0,0\r0.5,90\r1,180\r", ta),
        ("t,a\r\n0,0\r\n\r\n0.5,90\r\n1,180", ta),
        // Spaces.
        ("t a\n0 0\n0.5 90\n1 180\n", ta),
        ("  t     a\n 0.0   0\n 0.5  90 \n 1.0 180\n", ta),
        ("0,0 0,0\n0,5 90,0\n1,0 180,0\n", plain),
        ("0.000e+00 0.000e+00\n5.000e-01 9.000e+01\n1.000e+00 1.800e+02\n", plain),
        ("# t a\n0.000e+00 0.000e+00\n5.000e-01 9.000e+01\n1.000e+00 1.800e+02\n", ta),
        // Spaces behind commas are none.
        ("t, a\n0, 0\n0.5, 90\n1, 180\n", ta),
        // MATLAB.
        ("% a motion, 3 rows\nt,a\n0,0\n% half-way\n0.5,90\n1,180\n", ta),
        ("% t,a\n0,0\n0.5,90\n1,180\n", ta),
        // Headers of several lines; what is above them is not read.
        ("Ürecording 12, of Monday, 3 pm\nRate;100 Hz\n\nt;a\n0;0\n0,5;90\n1;180\n", ta),
        ("My motion\nt,a\n-----\n0,0\n0.5,90\n1,180\n", ta),
        ("My motion\n0,0\n0.5,90\n1,180\n", plain),
        (
            "| t | a |\n|---|---|\n| 0 | 0 |\n| 0.5 | 90 |\n| 1 | 180 |\n",
            "time = column 2 `t`, s; angle = column 3 `a`, deg; column 1, column 4 are not used",
        ),
    ] {
        check(csv, deg, &points, told);
    }
    let ms = "time = column 1 `t`, ms; angle = column 2 `a`, rev";
    for csv in [
        "t,a\nms,rev\n0,0\n500,0.25\n1000,0.5\n",
        "t;a\n[ms];[rev]\n0;0\n500;0,25\n1000;0,5\n",
        "Exported by a program\nt\ta\n(ms)\t(rev)\n0\t0\n500\t0.25\n1000\t0.5\n",
        "t   a\nms  rev\n0 0\n500 0.25\n1000 0.5\n",
    ] {
        check(csv, "", &points, ms);
    }
    check(
        "Time [ms]   Angle [rev]\n0 0\n500 0.25\n1000 0.5\n",
        "",
        &points,
        "time = column 1 `Time [ms]`, ms; angle = column 2 `Angle [rev]`, rev",
    );
    check(
        "\"t\" \"my a\" \"wheel\"\n0 7 0\n0.5 7 90\n1 7 180\n",
        deg,
        &points,
        "time = column 1 `t`, s; angle = column 3 `wheel`, deg; column 2 `my a` is not used",
    );
    // A camera that lost the marker.
    check(
        "t,a\n0,0\n0.25,\n0.5,90\n0.6,NaN\n0.7,n/a\n1,180\n",
        deg,
        &points,
        &format!("{ta}; 3 rows without a position are left out"),
    );
    // Columns in doubt stay in doubt.
    let said = |csv: &str| read(csv, deg).map(|_| ()).unwrap_err();
    assert!(said("time and angle of Monday\n0,0\n1,5\n").contains("expected a column `time [s]`"));
    assert!(said("# time and angle\n0 0\n1 5\n").contains("a header without `#`"));
    assert!(
        said("t a\n0 0\n1\n").starts_with("a.csv:3:1: a table needs two")
            || said("t a\n0 0\n1\n").contains("needs two points")
    );
    // Places are those of the file.
    assert!(
        said("Prose, and more of it\nt   a\n0   0\n  1   5°\n")
            .starts_with("a.csv:4:7: expected a number, found `5°` in column 2 `a`")
    );
    assert!(said("t,a\r0,0\r1,x\r").starts_with("a.csv:3:3: expected a number, found `x`"));
    assert!(
        said("t,a\n0,0\n1,5\n1,6\n")
            .starts_with("a.csv:4:1: times must increase from line to line, but column 1 `t` has 1 after 1")
    );
}

/// No choice of columns makes a speed a position.
#[test]
fn chosen_columns_keep_their_units() {
    for choice in ["[1, 2]", "[\"t\", \"rpm\"]"] {
        let said = read("t,rpm\n0,0\n1,5\n", &format!(", unit = \"deg\", columns = {choice}")).map(|_| ()).unwrap_err();
        let expected = "expected a unit of position (rev, deg, rad, mm, cm, m, in, step, full-step), found `rpm`\n";
        assert_eq!(said, format!("a.csv:1:3: {expected}"));
    }
}

#[test]
fn rows_longer_than_the_first_are_refused() {
    for first in ["t,a\n", "# t,a\n0,0\n", "0,0,\n", "t,a\n0,0,,\n"] {
        let csv = format!("{first}1,5,10\n2,5,20\n");
        let line = first.matches('\n').count() + 1;
        let expected = format!(
            "a.csv:{line}:5: expected 2 columns as in the first row, found `10` in column 3\n    \
             a comma separates columns here: write decimals with a point, 0.5, or separate the columns with `;` or tabs\n"
        );
        assert_eq!(read(&csv, ", unit = \"deg\"").unwrap_err(), expected, "{csv}");
    }
    let said = read("t;a\n0;0\n1;5;10\n", ", unit = \"deg\"").unwrap_err();
    assert_eq!(said, "a.csv:3:5: expected 2 columns as in the first row, found `10` in column 3\n");
}

/// As people write tables: any order, separator, units and columns beside.
#[derive(Clone, Debug)]
struct Written {
    order: Vec<usize>,
    separator: char,
    time: (&'static str, f64),
    angle: (&'static str, f64),
    others: Vec<&'static str>,
}

fn written() -> impl Strategy<Value = Written> {
    let times = prop::sample::select(vec![
        ("t", 1.0),
        ("Time [s]", 1.0),
        ("time (ms)", 1e3),
        ("TIME_ms", 1e3),
        ("t in us", 1e6),
        ("milliseconds", 1e3),
        ("zeit / ms", 1e3),
        ("elapsed [ms]", 1e3),
        ("timestamp [us]", 1e6),
    ]);
    let angles = prop::sample::select(vec![
        ("a [deg]", 1.0),
        ("Angle (rad)", std::f64::consts::PI / 180.0),
        ("theta_deg", 1.0),
        ("θ [°]", 1.0),
        ("phi in turns", 1.0 / 360.0),
        ("wheel [step]", 400.0 / 360.0),
        ("servo [deg]", 1.0),
        ("pos mm", 8.0 / 360.0),
    ]);
    let others = prop::sample::subsequence(vec!["i", "frame", "speed [rad/s]", "note", "", "current [mA]"], 0..=4);
    (times, angles, others, prop::sample::select(vec![',', ';', '\t'])).prop_flat_map(
        |(time, angle, others, separator)| {
            let columns: Vec<usize> = (0..others.len() + 2).collect();
            Just(columns).prop_shuffle().prop_map(move |order| Written {
                order,
                separator,
                time,
                angle,
                others: others.clone(),
            })
        },
    )
}

proptest! {
    /// However a table is written, it is the same motion as the plain one.
    #[test]
    fn any_way_of_writing_is_the_same_motion(
        written in written(),
        rows in prop::collection::vec((1_u32..500, -2000_i32..2000), 2..9),
    ) {
        let mut time_ms = 0;
        let rows: Vec<(u32, i32)> = rows.into_iter().map(|(wait, angle)| { time_ms += wait; (time_ms, angle) }).collect();
        let plain: String = rows.iter().map(|(ms, deg)| format!("{},{deg}\n", f64::from(*ms) * 1e-3)).collect();
        let Written { order, separator, time, angle, others } = written;
        let line = |cells: Vec<String>| {
            let cells: Vec<&str> = order.iter().map(|k| cells[*k].as_str()).collect();
            cells.join(&separator.to_string()) + "\n"
        };
        let with = |first: [String; 2], rest: &dyn Fn(usize) -> String| {
            first.into_iter().chain((0..others.len()).map(rest)).collect::<Vec<String>>()
        };
        let mut csv = line(with([time.0.to_owned(), angle.0.to_owned()], &|k| others[k].to_owned()));
        for (n, (ms, deg)) in rows.iter().enumerate() {
            let cells = [f64::from(*ms) * 1e-3 * time.1, f64::from(*deg) * angle.1].map(|value| value.to_string());
            csv += &line(with(cells, &|_| n.to_string()));
        }
        let plain = read(&plain, ", unit = \"deg\"").unwrap();
        let other = read(&csv, "");
        prop_assert!(other.is_ok(), "{csv}{}", other.unwrap_err());
        let other = other.unwrap();
        let (plain, other) = (&plain.program.motors[0].law, &other.program.motors[0].law);
        let end = plain.end().unwrap().seconds();
        prop_assert!((other.end().unwrap().seconds() - end).abs() < 1e-9);
        for k in 0..=20 {
            let seconds = end * f64::from(k) / 20.0 * (1.0 - 1e-9);
            prop_assert!((at(plain, seconds) - at(other, seconds)).abs() < 1e-4, "{csv}at {seconds} s");
        }
    }

    /// Any titles give a motion or an error that names the file.
    #[test]
    fn any_header_is_read_or_refused(header in "[a-z \\[\\]()/_,;#\"'°θ]{0,40}", options in "(, unit = \"deg\")?(, columns = \\[[12], [12]\\])?") {
        if let Err(error) = read(&format!("{header}\n0,0\n1,1\n"), &options) {
            prop_assert!(error.starts_with("a.csv:") || error.starts_with("x.toml:"), "{error}");
        }
    }
}

/// Counts and volts: the motion file says what 1 is.
#[test]
fn raw_values_of_sensors() {
    let columns = ", columns = [1, 2], time = \"ms\", unit = \"0.15 deg\"";
    // 2400 counts are a turn of 400 steps.
    check(
        "ms,counts\n0,0\n500,600\n1000,2400\n",
        columns,
        &[(0.0, 0.0), (0.5, 100.0), (1.0, 400.0)],
        "time = column 1 `ms`, ms; angle = column 2 `counts`, 0.15 deg",
    );
    // A potentiometer that counts the other way.
    check(
        "time [s];pot [V]\n0;2,5\n1;1,5\n",
        ", columns = [1, 2], unit = \"-54 deg\"",
        &[(0.0, -150.0), (1.0, -90.0)],
        "time = column 1 `time [s]`, s; angle = column 2 `pot [V]`, -54 deg",
    );
    let refused = |csv: &str, options: &str, part: &str| {
        let error = read(csv, options).unwrap_err();
        assert!(error.contains(part), "{error}");
    };
    let what_one_is = "if 1 in the file is not 1 of that unit, write what it is: unit = \"0.15 deg\"";
    for header in ["ms,counts", "t,encoder_count", "t,adc", "time,pot [V]", "t,raw"] {
        refused(&format!("{header}\n0,0\n1,1.5\n"), "", what_one_is);
        refused(&format!("{header}\n0,0\n1,1.5\n"), "", "write: columns = [1, 2]");
    }
    refused("t,a\n0,0\n1,1\n", ", unit = \"0 deg\"", "then all positions are 0");
    refused("t,a\n0,0\n1,1\n", ", unit = \"5 deg/s\"", "must be a unit of position");
    refused("t,a [deg]\n0,0\n1,1\n", ", unit = \"0.15 deg\"", "is in deg, but x.toml");
    assert!(!read("t,foo\n0,0\n1,1\n", "").unwrap_err().contains(what_one_is));
}

/// Distances are in the unit alone: an error of 1 is 1 deg, not 1 count.
#[test]
fn distances_are_in_the_unit_alone() {
    let csv = "t,counts\n0,0\n1,0\n2,100\n3,0\n4,0\n";
    let contents = read(csv, ", columns = [1, 2], unit = \"0.5 deg\", smooth = \"2 s\"").unwrap();
    let distance = &contents.tables[0].smoothing.as_ref().unwrap().distances[0];
    assert_eq!((distance.unit.as_str(), distance.at_s), ("deg", 2.0));
    assert!((1.0..50.0).contains(&distance.largest), "{distance}");
}

#[test]
fn rows_of_one_time_are_averaged_where_a_table_is_smoothed() {
    let csv = "t,a [deg]\n0,0\n0,90\n0,45\n1,90\n2,180\n2,360\n";
    let contents = read(csv, ", smooth = \"1 s\"").unwrap();
    let law = &contents.program.motors[0].law;
    // The ends of what is smoothed stay where they are.
    assert_eq!([at(law, 0.0), at(law, 2.0)], [50.0, 300.0]);
    let told = contents.tables[0].to_string();
    assert!(told.contains("3 rows have the time of the row before: their mean is taken; smoothed over 1 s"), "{told}");
    let error = read(csv, "").unwrap_err();
    assert!(error.contains("with smooth = \"50 ms\" rows of one time are averaged"), "{error}");
    let back = read("t,a [deg]\n0,0\n2,90\n1,45\n", ", smooth = \"1 s\"").unwrap_err();
    assert!(back.contains("has 1 after 2") && back.contains("sort the lines by time"), "{back}");
}

/// A magnetic encoder, a compass: the angle starts again after each turn.
#[test]
fn angles_that_start_again_go_on() {
    let csv = "t,a [deg]\n0,350\n1,10\n2,100\n3,200\n4,300\n5,40\n6,300\n7,200\n";
    check(
        csv,
        ", wraps = \"360 deg\"",
        &[(0.0, 3500.0 / 9.0), (1.0, 3700.0 / 9.0), (4.0, 6600.0 / 9.0), (5.0, 7600.0 / 9.0), (7.0, 5600.0 / 9.0)],
        "time = column 1 `t`, s; angle = column 2 `a [deg]`, deg; starts again after 360 deg, 3 times",
    );
    // The same in counts of 4096 a turn, and before the mean of equal times is taken.
    let contents = read(
        "t,counts\n0,4090\n1,4\n1,4094\n2,10\n",
        ", columns = [1, 2], unit = \"0.087890625 deg\", wraps = \"1 rev\", smooth = \"1 s\"",
    );
    let contents = contents.unwrap();
    let motor = &contents.program.motors[0];
    let law = &motor.law;
    // Reports have the table's unit.
    assert_eq!(motor.scale.unit, "deg");
    assert!(contents.tables[0].to_string().contains("starts again after 1 rev, "), "{}", contents.tables[0]);
    assert_eq!([at(law, 0.0), at(law, 2.0)], [4090.0, 4106.0].map(|counts| counts / 4096.0 * 400.0));
    let error = read(csv, ", wraps = \"0 deg\"").unwrap_err();
    assert!(error.contains("`wraps` must be more than 0"), "{error}");
}

/// What a phone's logger calls its columns.
#[test]
fn a_column_with_a_unit_goes_before_axes_without_one() {
    check(
        "seconds_elapsed,z,y,x,yaw (deg)\n0,1,2,3,0\n1,4,4,4,90\n",
        "",
        &[(0.0, 0.0), (1.0, 100.0)],
        "time = column 1 `seconds_elapsed`, s; angle = column 5 `yaw (deg)`, deg; column 2 `z`, column 3 `y`, column 4 `x` are not used",
    );
    // The clock counts ns from 1970.
    check(
        "time,seconds_elapsed,yaw (deg)\n1764237600000000000,0,0\n1764237601000000000,1,90\n",
        "",
        &[(0.0, 0.0), (1.0, 100.0)],
        "time = column 2 `seconds_elapsed`, s; angle = column 3 `yaw (deg)`, deg; column 1 `time` is not used",
    );
    let error = read("t,x,y,yaw (deg),pitch (deg)\n0,1,2,3,4\n", "").unwrap_err();
    assert!(error.contains("expected one column for the position"), "{error}");
}
