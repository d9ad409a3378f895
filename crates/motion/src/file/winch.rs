//! The winch's command list: `"<time>: <command>"`, the commands as StepperWinch takes them.

use std::ops::Range;
use std::sync::Arc;

use super::context::{Loader, load};
use super::problem::Problem;
use super::reader::{Noted, Read, Reader, Section};
use super::source::Source;
use super::winches::Moved;
use crate::Time;
use crate::law::WinchCommand;
use crate::quantity::Quantity;

/// The axes of a winch, in its own order.
const AXES: &str = "xyza";

/// The axis that a motor is: `axis = "x"`, or the motor's own name if it is one.
pub(super) fn axis(p: &Section, motor: &str) -> Read<char> {
    let is_axis = |name: &str| name.chars().next().filter(|axis| name.len() == 1 && AXES.contains(*axis));
    if let (None, Some(axis)) = (p.get("axis"), is_axis(motor)) {
        return Ok(axis);
    }
    let node = p.need("axis", "axis = \"x\" (or name the motor x, y, z or a)")?;
    let name = node.text("axis = \"x\"")?;
    is_axis(name).ok_or_else(|| node.note("not an axis", "`axis` must be one of x, y, z, a", ""))
}

/// Notes axes that a list tells to move and that no motor with that list is: a plan would drop what text would send.
pub(super) fn refuse_strays(reader: &Reader) {
    for problem in reader.winches.take().strays() {
        reader.note_problem(problem);
    }
}

/// The orders of the commands, from the list or the file, for that axis, in order of time.
pub(super) fn commands(p: &Section, loader: Loader, axis: char) -> Read<Vec<(Time, WinchCommand)>> {
    let mut commands = Vec::new();
    let mut last = Time::ZERO;
    let (mut lines, mut moved) = (Vec::new(), Moved::new());
    let mut add = |line: &str, wrong: &dyn Fn(Range<usize>, String) -> Problem| {
        let note = |at, message| p.reader.note_problem(wrong(at, message));
        let command = parse(line, axis).map_err(|error| note(error.at, error.message))?;
        if command.at < last {
            return Err(note(0..line.len(), "commands must stand in order of their times".into()));
        }
        for (axis, at) in command.moved {
            if moved.iter().all(|(known, _)| *known != axis) {
                let message = format!(
                    "a line moves axis {axis}, but no motor with these lines is that axis: add one, or take the axis out"
                );
                moved.push((axis, wrong(at, message)));
            }
        }
        lines.push(line.to_owned());
        last = command.at;
        commands.extend(command.order.map(|order| (command.at, order)));
        Ok(())
    };
    match (p.get("file"), p.get("commands")) {
        (Some(file), None) => {
            let source = Arc::new(Source::new(file.as_text().unwrap_or_default(), load(&file, loader)?));
            for (start, text) in lines_of(source.text()) {
                add(text, &|at, message| {
                    let labels = vec![(start + at.start..start + at.end, "here".to_owned())];
                    Problem::new(&source, message, labels, None)
                })?;
            }
        }
        (None, Some(list)) => {
            const EXAMPLE: &str = "commands = [\"0 s: a x 100\", \"1 s: d x -50\"]";
            for node in list.list(EXAMPLE)? {
                let text = node.text(EXAMPLE)?;
                add(text, &|at, message| {
                    let labels = vec![(node.inside(at.start, at.len()), "here".to_owned())];
                    Problem::new(&node.reader.source, message, labels, None)
                })?;
            }
        }
        (Some(file), Some(_)) => {
            return Err(file.note(
                "one too many",
                "a winch has either `commands` or a `file`",
                "leave one of them out",
            ));
        }
        (None, None) => {
            p.need("commands", "commands = [\"0 s: a x 100\"]")?;
        }
    }
    p.reader.winches.borrow_mut().add(lines, axis, moved);
    Ok(commands)
}

/// A winch's command lines, as they are written: `"<time>: <command>"`, in order of time.
#[derive(Clone, Debug)]
pub struct WinchScript {
    /// Without blank lines and comments.
    pub lines: Vec<String>,
    /// Where each of them stands in `source`, bytes. With escapes in it that is longer than the line.
    pub places: Vec<Range<usize>>,
    /// The motion file, or the one that it names for its commands.
    pub source: Arc<Source>,
    /// How long the motion lasts, if it says so.
    pub duration: Option<Time>,
}

/// The lines of a file whose one motion is a winch's; they have been checked already, axis by axis.
pub(super) fn script(root: &Section, loader: Loader) -> Read<WinchScript> {
    const EXAMPLE: &str = "law.winch = { commands = [\"0 s: a x 100\"] }";
    let motions = root.need("motion", EXAMPLE)?;
    let motions = if motions.is_table() { vec![motions] } else { motions.list(EXAMPLE)? };
    if let Some(second) = motions.get(1) {
        return Err(second.note("one too many", "text is for one motion, a winch's", "keep the one with law.winch"));
    }
    // A file without a motion is none: `need` has said so, or the reader of all the file.
    let motion = motions.first().ok_or(Noted)?.any_section("the motion".to_owned(), EXAMPLE)?;
    for key in ["start", "repeat", "begin", "end"] {
        if let Some(node) = motion.get(key) {
            return Err(node.note("not here", format!("a line of text cannot say `{key}`"), "leave it out"));
        }
    }
    let law = motion.need("law", EXAMPLE)?.any_section("the law".to_owned(), EXAMPLE)?;
    let p = law.need("winch", EXAMPLE)?.any_section("the winch".to_owned(), EXAMPLE)?;
    let (mut lines, mut places) = (Vec::new(), Vec::new());
    let source = match p.get("file") {
        Some(file) => {
            let source = Arc::new(Source::new(file.text("file = \"lines.txt\"")?, load(&file, loader)?));
            for (start, line) in lines_of(source.text()) {
                lines.push(line.to_owned());
                places.push(start..start + line.len());
            }
            source
        }
        None => {
            for node in p.need("commands", EXAMPLE)?.list(EXAMPLE)? {
                let line = node.text(EXAMPLE)?;
                lines.push(line.to_owned());
                places.push(node.inside(0, line.len()));
            }
            Arc::clone(&p.reader.source)
        }
    };
    let duration = p.get("duration").map(|node| node.duration("5 s")).transpose()?;
    Ok(WinchScript { lines, places, source, duration })
}

/// The lines of a file, without what comes after a `#`, but for blank ones; and where each one begins.
fn lines_of(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let starts = text.split_inclusive('\n').scan(0, |next, line| {
        let start = *next;
        *next += line.len();
        Some((start, line.split('#').next().unwrap_or_default().trim_end()))
    });
    starts.filter(|(_, line)| !line.is_empty())
}

/// One line: when, what it says to the axis, if anything, and which axes it moves, each with its place.
#[derive(Debug)]
struct Command {
    at: Time,
    order: Option<WinchCommand>,
    moved: Vec<(char, Range<usize>)>,
}

/// What is wrong with a line, and where in it.
#[derive(Debug)]
struct WrongCommand {
    at: Range<usize>,
    message: String,
}

fn parse(line: &str, axis: char) -> Result<Command, WrongCommand> {
    let wrong = |at: Range<usize>, message: &str| WrongCommand { at, message: message.to_owned() };
    let whole = 0..line.len();
    let Some((when, rest)) = line.split_once(':') else {
        return Err(wrong(whole, "a timed command is \"<time>: <command>\", such as \"0 s: a x 100\""));
    };
    let at = Quantity::parse(when).ok().filter(|when| (0.0..1e10).contains(&when.value)).and_then(|when| when.time());
    let at = at.ok_or_else(|| wrong(0..when.len(), "not a time, such as \"1.5 s\""))?;
    let mut words = words(rest, when.len() + 1);
    let Some((name, name_at)) = words.next() else {
        return Err(wrong(whole, "no command after the time"));
    };
    if !["a", "d", "v", "r", "s", "g", "l"].contains(&name) {
        return Err(wrong(name_at, "unknown command; known: a, d, v, r, s, g, l"));
    }
    let Some((flags, flags_at)) = words.next() else {
        return Err(wrong(whole, "the axes are missing, such as x or xyza"));
    };
    if !flags.chars().all(|flag| AXES.contains(flag)) {
        return Err(wrong(flags_at, "unknown axis; known: x, y, z, a"));
    }
    let values: Vec<(&str, Range<usize>)> = words.collect();
    let wanted = if matches!(name, "g" | "l") { 2 } else { flags.len() };
    if values.len() != wanted {
        return Err(WrongCommand { at: whole, message: format!("{wanted} values wanted, but {} found", values.len()) });
    }
    let moves = matches!(name, "a" | "d" | "v" | "r");
    let places = flags_at.map(|at| at..at + 1);
    let moved = flags.chars().zip(places).filter(|_| moves).collect();
    // Every value is checked, also those of other axes.
    let order = if matches!(name, "g" | "l") {
        let number = |(text, at): &(&str, Range<usize>)| {
            let value = text.parse::<f64>().ok().filter(|value| value.is_finite() && *value >= 0.0);
            value.ok_or_else(|| wrong(at.clone(), "not a number of at least 0"))
        };
        let (first, second) = (number(&values[0])?, number(&values[1])?);
        let order = match name {
            "g" => WinchCommand::Gains { frequency_hz: first, damping_ratio: second },
            _ => WinchCommand::Limits { max_speed: first, max_acceleration: second },
        };
        flags.contains(axis).then_some(order)
    } else {
        let mut order = None;
        for (flag, (text, at)) in flags.chars().zip(&values) {
            let value = text.parse::<i32>().map_err(|_| wrong(at.clone(), "not a whole number of 32 bits"))?;
            if flag == axis {
                let value = f64::from(value);
                order = Some(match name {
                    "a" => WinchCommand::Target(value),
                    "d" => WinchCommand::Move(value),
                    "v" => WinchCommand::Drift(value),
                    "r" => WinchCommand::Impulse(value),
                    _ => WinchCommand::RampSpeed(value),
                });
            }
        }
        order
    };
    Ok(Command { at, order, moved })
}

/// The words of `text`, which begins `offset` bytes into its line, each with its place.
fn words(text: &str, offset: usize) -> impl Iterator<Item = (&str, Range<usize>)> {
    let mut next = offset;
    let words = text.split([' ', '\t']).map(move |word| {
        let start = next;
        // Each separator is one byte.
        next += word.len() + 1;
        (word, start..start + word.len())
    });
    words.filter(|(word, _)| !word.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(line: &str, axis: char, at_s: f64, order: Option<WinchCommand>) {
        let command = parse(line, axis).unwrap();
        assert_eq!((command.at.seconds(), command.order), (at_s, order), "{line}");
    }

    #[test]
    fn commands_reach_their_axis() {
        check("0 s: a ax 5 7", 'a', 0.0, Some(WinchCommand::Target(5.0)));
        check("0 s: a ax 5 7", 'x', 0.0, Some(WinchCommand::Target(7.0)));
        check("1.5 s: d x -50", 'x', 1.5, Some(WinchCommand::Move(-50.0)));
        check("100 ms:  v xy 10\t20", 'y', 0.1, Some(WinchCommand::Drift(20.0)));
        check("2 s: v x 10", 'z', 2.0, None);
        check("0s: r z 3", 'z', 0.0, Some(WinchCommand::Impulse(3.0)));
        check("0s: s z 400", 'z', 0.0, Some(WinchCommand::RampSpeed(400.0)));
        let gains = WinchCommand::Gains { frequency_hz: 2.0, damping_ratio: 1.0 };
        check("0 s: g xyza 2.0 1.0", 'a', 0.0, Some(gains));
        let limits = WinchCommand::Limits { max_speed: 4000.0, max_acceleration: 40_000.0 };
        check("0 s: l xyza 4000 40000", 'y', 0.0, Some(limits));
    }

    #[track_caller]
    fn refuse(line: &str, place: &str, message: &str) {
        let error = parse(line, 'x').unwrap_err();
        assert_eq!((&line[error.at], error.message.as_str()), (place, message));
    }

    #[test]
    fn refusals_point_at_the_word() {
        refuse("0 s: a x ten", "ten", "not a whole number of 32 bits");
        refuse("0 s: jump x 1", "jump", "unknown command; known: a, d, v, r, s, g, l");
        refuse("0 s: a xw 1 2", "xw", "unknown axis; known: x, y, z, a");
        refuse("0 s: a xy 1", "0 s: a xy 1", "2 values wanted, but 1 found");
        refuse("soon: a x 1", "soon", "not a time, such as \"1.5 s\"");
        refuse("0 s: g x nan 1", "nan", "not a number of at least 0");
        refuse("a x 1", "a x 1", "a timed command is \"<time>: <command>\", such as \"0 s: a x 100\"");
    }
}
