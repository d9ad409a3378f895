//! `pulsetrain film`: judges a clip of a wheel with two marks.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;
use miette::miette;
use pulsetrain_motion::Time;
use pulsetrain_motion::program::{Program, Wheel};
use pulsetrain_motion::quantity::{Base, Quantity};
use pulsetrain_plot::{FilmFrame, FilmPicture};
use pulsetrain_trace::camera::{AngleUnit, Frame, Track};
use pulsetrain_trace::verdict::{self, FilmReport, JudgeError, Options};

use crate::arguments::{self, Alignment};
use crate::console::Access;
use crate::console::{self, Console, Exit};
use crate::files::{inputs, outputs};
use crate::film::{self, Settings, Tracked};
use crate::load;

#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  pulsetrain film clip.mp4 examples/first-uno.toml
  pulsetrain film clip.mov crank.toml --limit \"2 deg\" --exposure 1/500
  pulsetrain film slow-motion.mov crank.toml --slow 8
  pulsetrain film clip.mp4 crank.toml --frame \"120 mm x 80 mm\" --mark red --mark blue")]
pub(crate) struct FilmArgs {
    /// The clip, as the camera wrote it: MP4, MOV, AVI, MKV
    pub(crate) video: PathBuf,
    /// Motion file (TOML)
    pub(crate) file: PathBuf,
    /// How far the wheel may be from the motion [default: the motor's film_limit, else 1 deg or 1 step]
    #[arg(long, value_name = "ANGLE", value_parser = arguments::angle)]
    pub(crate) limit: Option<Quantity>,
    /// The motor whose wheel was filmed, if the motion file has several
    #[arg(long, value_name = "MOTOR")]
    pub(crate) motor: Option<String>,
    /// How long the shutter is open for a frame: "2 ms", 1/500
    #[arg(long, alias = "shutter", value_name = "TIME", value_parser = arguments::exposure)]
    pub(crate) exposure: Option<f64>,
    /// Time from the first row of a frame to the last (rolling shutter), 0 if there is none [default: it is found]
    #[arg(long, value_name = "TIME", value_parser = arguments::readout)]
    pub(crate) readout: Option<f64>,
    /// How many times slower the clip plays than the wheel turned: 8 for 240 frames a second that play as 30
    #[arg(long, value_name = "FACTOR", value_parser = factor, default_value = "1")]
    pub(crate) slow: f64,
    /// Begin at this time of the clip
    #[arg(long, value_name = "TIME", value_parser = arguments::duration)]
    pub(crate) from: Option<Time>,
    /// End at this time of the clip
    #[arg(long, value_name = "TIME", value_parser = arguments::duration)]
    pub(crate) to: Option<Time>,
    /// A mark on the wheel, by its colour or its place in the first frame: red, "#d02020", 320,140. Give it twice
    #[arg(long, value_name = "MARK", value_parser = mark)]
    pub(crate) mark: Vec<Place>,
    /// Four marks around the wheel correct an oblique view: width and height of their rectangle, from middle to middle
    #[arg(long, value_name = "W x H", value_parser = rectangle)]
    pub(crate) frame: Option<[f64; 2]>,
    /// Where a mark around the wheel is in the first frame, in pixels: 40,30. Give it four times
    #[arg(long, value_name = "X,Y", value_parser = corner, requires = "frame")]
    pub(crate) corner: Vec<Place>,
    /// What is fitted before the clip is judged
    #[arg(long, value_enum, default_value_t = Alignment::StartAndRate)]
    pub(crate) align: Alignment,
    /// Judge only up to this time of the motion
    #[arg(long, value_name = "TIME", value_parser = arguments::duration)]
    pub(crate) until: Option<Time>,
    /// Folder to write to [default: out/ and the clip's name]
    #[arg(long, value_name = "FOLDER")]
    pub(crate) out: Option<PathBuf>,
    /// The Python with OpenCV and PyAV [default: PULSETRAIN_PYTHON, else the one that the message about it makes, else python3]
    #[arg(long, value_name = "PROGRAM")]
    pub(crate) python: Option<PathBuf>,
    /// Print the report as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// A place in the picture, or a colour: blue, green, red.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Place(Vec<f64>);

/// Colours that `--mark` knows, as blue, green, red.
const COLOURS: [(&str, [f64; 3]); 12] = [
    ("red", [40.0, 40.0, 210.0]),
    ("green", [60.0, 170.0, 50.0]),
    ("blue", [210.0, 90.0, 30.0]),
    ("yellow", [40.0, 220.0, 235.0]),
    ("orange", [30.0, 130.0, 240.0]),
    ("pink", [180.0, 110.0, 240.0]),
    ("purple", [160.0, 50.0, 130.0]),
    ("cyan", [220.0, 200.0, 40.0]),
    ("black", [25.0, 25.0, 25.0]),
    ("white", [240.0, 240.0, 240.0]),
    ("grey", [128.0, 128.0, 128.0]),
    ("gray", [128.0, 128.0, 128.0]),
];

fn mark(text: &str) -> Result<Place, String> {
    let lower = text.trim().to_lowercase();
    if let Some((_, bgr)) = COLOURS.iter().find(|(name, _)| *name == lower) {
        return Ok(Place(bgr.to_vec()));
    }
    if let Some(digits) = lower.strip_prefix('#').filter(|digits| digits.len() == 6 && digits.is_ascii()) {
        let part = |at: usize| u8::from_str_radix(&digits[at..at + 2], 16).map(f64::from);
        if let (Ok(red), Ok(green), Ok(blue)) = (part(0), part(2), part(4)) {
            return Ok(Place(vec![blue, green, red]));
        }
    }
    let names: Vec<&str> = COLOURS.iter().map(|(name, _)| *name).collect();
    corner(text)
        .map_err(|_| format!("write a colour ({}; \"#d02020\") or a place in pixels: 320,140", names.join(", ")))
}

fn corner(text: &str) -> Result<Place, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse::<f64>().ok()).collect();
    let numbers = numbers.filter(|numbers| numbers.len() == 2 && numbers.iter().all(|number| number.is_finite()));
    numbers.map(Place).ok_or_else(|| "write it in pixels, from the top left: 320,140".to_owned())
}

fn rectangle(text: &str) -> Result<[f64; 2], String> {
    let example = "write it like \"120 mm x 80 mm\"";
    let sides: Vec<&str> = text.split(['x', '×']).map(str::trim).collect();
    let side = |text: &str| {
        let quantity = Quantity::parse(text).ok().filter(|quantity| quantity.base == Base::Length);
        let value = quantity.map(|quantity| quantity.value).or_else(|| text.parse().ok());
        value.filter(|value: &f64| *value > 0.0 && value.is_finite())
    };
    match sides[..] {
        [width, height] => match (side(width), side(height)) {
            (Some(width), Some(height)) if (0.02..50.0).contains(&(width / height)) => Ok([width, height]),
            (Some(_), Some(_)) => Err("one side is more than fifty times the other".to_owned()),
            _ => Err(example.to_owned()),
        },
        _ => Err(example.to_owned()),
    }
}

fn factor(text: &str) -> Result<f64, String> {
    let number = text.trim_end_matches(['x', '×']).parse::<f64>().ok();
    number
        .filter(|number| (0.01..=10_000.0).contains(number))
        .ok_or_else(|| "write how many times slower, 0.01 to 10000, like 8".to_owned())
}

pub(crate) fn run(args: &FilmArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    // What is wrong with the motion is said before the clip is read, which takes longer.
    let (prepared, wheels) = load::with_wheels(&args.file, None)?;
    let program = &prepared.program;
    let wheel = wheel_of(program, &wheels, args.motor.as_deref(), args.limit.as_ref())?;
    if !matches!(args.mark.len(), 0 | 2) {
        return Err(miette!(
            help = "name both marks: --mark red --mark blue",
            "--mark is there once for each of the two marks"
        ));
    }
    if !matches!(args.corner.len(), 0 | 4) {
        return Err(miette!("--corner is there four times, or not at all"));
    }
    // A clip that is not there needs no Python to say so.
    drop(inputs::open(&args.video, u64::MAX - 1)?);
    let stem = args.video.file_stem().map_or_else(|| "film".into(), |stem| stem.to_string_lossy().into_owned());
    let folder = args.out.clone().unwrap_or_else(|| Path::new("out").join(stem));
    std::fs::create_dir_all(&folder).map_err(|error| Access::write(&folder, "--out", error))?;
    outputs::claim_all(&folder, &["track.csv", "film.svg", "marks.png", "report.json"], "--out")?;
    let marks = outputs::part_path(&folder.join("marks.png"));

    let places = |places: &[Place]| places.iter().map(|place| place.0.clone()).collect();
    let settings = Settings {
        video: film::text(&args.video),
        exposure_s: args.exposure.unwrap_or(0.0),
        readout_s: args.readout,
        slow: args.slow,
        from_s: args.from.map(Time::seconds),
        to_s: args.to.map(Time::seconds),
        marks: places(&args.mark),
        frame: args.frame,
        corners: places(&args.corner),
        picture: Some(film::text(&marks)),
    };
    let tracked = film::track(&settings, args.python.as_deref(), console);
    if marks.exists() {
        let path = folder.join("marks.png");
        outputs::take_place(&marks, &path).map_err(|error| Access::write(&path, "--out", error))?;
    }
    let tracked = tracked?;
    outputs::write(&folder.join("track.csv"), "--out", track_csv(&tracked).as_bytes())?;
    let track = track_of(&tracked, 1.0);
    let options = Options { align: args.align.into(), until_s: args.until.map(Time::seconds), ..Options::default() };
    let judge = |track: &Track| verdict::judge_film(track, program, args.motor.as_deref(), wheel, &options);
    let report = judge(&track).map_err(|error| unjudged(&error, &args.video, &folder))?;
    let slower = if report.ok || report.jumps.iter().any(verdict::Jump::is_certain) || args.slow != 1.0 {
        None
    } else {
        SLOWER.into_iter().find(|slow| judge(&track_of(&tracked, *slow)).is_ok_and(|report| report.ok))
    };
    let picture = film_picture(&report, &args.video, &args.file);
    let svg = picture.svg().map_err(|error| miette!("cannot draw the film: {error}"))?;
    outputs::write(&folder.join("film.svg"), "--out", svg.as_bytes())?;
    let both = serde_json::json!({ "film": &tracked, "verdict": &report });
    outputs::write(&folder.join("report.json"), "--out", console::json(&both)?.as_bytes())?;

    if args.json {
        console.print_json(&both)?;
    } else {
        console.print(about_clip(&args.video, &tracked, args.exposure.is_some()))?;
        console.print(format_args!("{report}\n"))?;
        if let Some(slow) = slower {
            console.print(format_args!("As slow motion it would fit: say --slow {slow}\n"))?;
        }
        console.print(format_args!("{}: track.csv, film.svg, marks.png, report.json\n", folder.display()))?;
    }
    Ok(if report.ok { Exit::Success } else { Exit::BoundBroken })
}

/// How many times slower than they were filmed cameras play clips: 120, 240, 480, 960 frames a second as 24, 25, 30, 60.
const SLOWER: [f64; 12] = [2.0, 4.0, 8.0, 5.0, 10.0, 4.8, 9.6, 16.0, 32.0, 20.0, 40.0, 38.4];

/// The wheel of a motor, with the limit that was asked for.
pub(crate) fn wheel_of(
    program: &Program,
    wheels: &[Wheel],
    motor: Option<&str>,
    limit: Option<&Quantity>,
) -> miette::Result<Option<Wheel>> {
    let index = match motor {
        Some(name) => program.motors.iter().position(|motor| motor.name == name),
        None => (program.motors.len() == 1).then_some(0),
    };
    let names = || program.motors.iter().map(|motor| motor.name.as_str()).collect::<Vec<_>>().join(", ");
    let Some(index) = index else {
        let example = program.motors.first().map_or("wheel", |motor| motor.name.as_str());
        return Err(miette!(
            help = format!("say which, for example: --motor {example}"),
            "a film shows one wheel; the motion file has the motors {}",
            names()
        ));
    };
    let Some(wheel) = wheels.get(index).copied() else { return Ok(None) };
    let limit_steps = limit.map(|limit| match limit.base {
        Base::Turn => limit.value * wheel.units.steps_per_turn,
        _ => limit.value,
    });
    Ok(Some(Wheel { limit_steps: limit_steps.or(wheel.limit_steps), ..wheel }))
}

fn unjudged(error: &JudgeError, video: &Path, folder: &Path) -> miette::Report {
    miette!(
        help = format!(
            "{} shows which marks were followed, {} the angles",
            folder.join("marks.png").display(),
            folder.join("track.csv").display()
        ),
        "{}: {error}",
        video.display()
    )
}

fn track_of(tracked: &Tracked, slower: f64) -> Track {
    let frame =
        |[time_s, angle, sigma]: &[f64; 3]| Frame { time_s: time_s / slower, angle: *angle, sigma: Some(*sigma) };
    Track { unit: AngleUnit::Degrees, frames: tracked.frames.iter().map(frame).collect() }
}

fn track_csv(tracked: &Tracked) -> String {
    let mut text = String::from("time [s],angle [deg],sigma [deg]\n");
    for [time_s, angle_deg, sigma_deg] in &tracked.frames {
        let _ = writeln!(text, "{time_s:.7},{angle_deg:.5},{sigma_deg:.5}");
    }
    text
}

/// Film over law, and their difference.
pub(crate) fn film_picture(report: &FilmReport, track: &Path, file: &Path) -> FilmPicture {
    let frame = |point: &verdict::FilmPoint| FilmFrame {
        at_s: point.at_s,
        angle_deg: point.angle_deg,
        law_deg: point.law_deg,
        sigma_deg: point.sigma_deg,
    };
    let name = |path: &Path| path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let verdict = if report.ok { "PASS" } else { "FAIL" };
    FilmPicture {
        title: format!("{} over {}, {}: {verdict}", name(track), name(file), report.motor),
        frames: report.points.iter().map(frame).collect(),
        law: report.law_line.clone(),
        limit_deg: report.limit_deg,
        notes: report.jumps.iter().map(|jump| (0.5 * (jump.from_s + jump.to_s), jump.to_string())).collect(),
    }
}

/// What the clip shows, and what was allowed for.
fn about_clip(video: &Path, tracked: &Tracked, knows_exposure: bool) -> String {
    let Tracked { in_clip, interval_s, longest_gap_s, lost, one_mark, repeated, not_fitting, .. } = tracked;
    let span_s =
        tracked.frames.last().map_or(0.0, |last| last[0]) - tracked.frames.first().map_or(0.0, |first| first[0]);
    let mut text = format!("{}: {in_clip} frames in {span_s:.2} s, {:.1} a second", video.display(), 1.0 / interval_s);
    if *longest_gap_s > 1.6 * interval_s {
        let _ = write!(text, "; the longest gap is {:.0} ms", 1e3 * longest_gap_s);
    }
    text.push('\n');
    let [first, second] = &tracked.marks;
    let _ = writeln!(
        text,
        "  marks: {} at {:.0},{:.0} and {} at {:.0},{:.0}, {:.0} pixels apart{}",
        first.colour,
        first.x,
        first.y,
        second.colour,
        second.x,
        second.y,
        tracked.apart_px,
        if tracked.alike { "; they look alike, so that half a turn between frames is too much" } else { "" }
    );
    let rows = [
        (*lost, "frames without a mark, left out"),
        (*one_mark, "frames with one mark hidden"),
        (*repeated, "frames that repeat the one before, left out"),
        (*not_fitting, "frames whose marks do not fit the wheel, left out"),
    ];
    for (count, what) in rows.into_iter().filter(|(count, _)| *count > 0) {
        let _ = writeln!(text, "  {what}: {count}");
    }
    if tracked.frame_used {
        let _ = writeln!(text, "  view: corrected by the four marks on the frame");
        if tracked.shake_px > 0.25 {
            let _ = writeln!(text, "  the camera moved by {:.1} pixels; corrected", tracked.shake_px);
        }
    } else if tracked.tilt_deg > 4.0 {
        let _ = writeln!(text, "  view: oblique by {:.0}°, corrected by the marks' way", tracked.tilt_deg);
    }
    let is_rolling = tracked.readout_s.abs() > (5.0 * tracked.readout_sigma_s).max(2e-4);
    if is_rolling && !tracked.readout_given {
        let _ = writeln!(
            text,
            "  rolling shutter: {:.1} ms from first to last row, found and corrected",
            1e3 * tracked.readout_s
        );
    }
    if tracked.stretch > 3.0 && !knows_exposure {
        let _ = writeln!(
            text,
            "  marks are smeared to {:.0} times their width: a shorter exposure is sharper",
            tracked.stretch
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_colours_or_places() {
        assert_eq!(mark("Red"), Ok(Place(vec![40.0, 40.0, 210.0])));
        assert_eq!(mark("#102030"), Ok(Place(vec![48.0, 32.0, 16.0])));
        assert_eq!(mark("320, 140.5"), Ok(Place(vec![320.0, 140.5])));
        for wrong in ["", "reddish", "#12", "#12345g", "1,2,3", "1;2", "nan,1"] {
            assert!(mark(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn frames_are_rectangles() {
        assert_eq!(
            rectangle("120 mm x 8 cm"),
            Ok([120.0, 80.0].map(|mm: f64| mm * rectangle("1 mm x 1 mm").unwrap()[0]))
        );
        assert_eq!(rectangle("3 × 2"), Ok([3.0, 2.0]));
        for wrong in ["", "120 mm", "120 mm x", "1 s x 2 s", "0 mm x 3 mm", "-1 x 1", "1 x 1000"] {
            assert!(rectangle(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn slow_motion_is_a_factor() {
        assert_eq!(factor("8"), Ok(8.0));
        assert_eq!(factor("8x"), Ok(8.0));
        for wrong in ["", "0", "-1", "nan", "1e9"] {
            assert!(factor(wrong).is_err(), "{wrong}");
        }
    }
}
