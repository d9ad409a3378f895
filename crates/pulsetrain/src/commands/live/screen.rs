//! A live motion at a terminal: a few rows that are drawn again and again, news that scroll above them, keys.

use std::io::{self, Write};
use std::time::Duration;

use crossterm::QueueableCommand;
use crossterm::cursor::{MoveToColumn, MoveUp};
use crossterm::event::{self, Event as TerminalEvent, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use crossterm::style::Print;
use crossterm::terminal::{self, Clear, ClearType};
use pulsetrain_motion::human;
use pulsetrain_session::control::Status;

use crate::clean::clean;
use crate::live::{RunCommand, RunEvent, RunInfo};

/// What a key asks for.
pub(super) enum Key {
    Command(RunCommand),
    Line(String),
}

/// How much faster or slower a key makes the motion.
const FASTER: f64 = 1.1;

/// A terminal in raw mode until this is dropped.
pub(super) struct LiveScreen<'a> {
    out: &'a mut dyn Write,
    rows: ScreenRows,
    /// Rows that are drawn now.
    drawn: u16,
}

/// What the rows show.
struct ScreenRows {
    info: RunInfo,
    status: Option<Status>,
    tempo: f64,
    is_paused: bool,
    /// A stop was obeyed.
    is_braking: bool,
    cue: Option<String>,
    rejoined: u32,
    /// A line that is being typed.
    typed: Option<String>,
    has_stopped: bool,
}

impl<'a> LiveScreen<'a> {
    /// Sets the terminal to raw mode.
    ///
    /// # Errors
    /// If it is no terminal.
    pub(super) fn new(out: &'a mut dyn Write, info: &RunInfo) -> io::Result<LiveScreen<'a>> {
        terminal::enable_raw_mode()?;
        let mut screen = LiveScreen { out, rows: ScreenRows::new(info), drawn: 0 };
        screen.draw()?;
        Ok(screen)
    }

    /// Shows what happened; `text` scrolls.
    ///
    /// # Errors
    /// If the terminal cannot be written.
    pub(super) fn hear(&mut self, happened: &RunEvent, text: Option<String>) -> io::Result<()> {
        self.rows.hear(happened);
        match text {
            Some(text) => self.print(&text),
            None => self.draw(),
        }
    }

    /// The board counts from these positions now, steps.
    pub(super) fn count_from(&mut self, starts: &[f64]) {
        let motors = self.rows.info.motors.iter_mut();
        motors.zip(starts).for_each(|(motor, start)| motor.start_steps = *start);
    }

    /// Prints a text above the rows.
    ///
    /// # Errors
    /// If the terminal cannot be written.
    pub(super) fn print(&mut self, text: &str) -> io::Result<()> {
        self.erase()?;
        for line in text.lines() {
            self.out.queue(Print(clean(line)))?.queue(Print("\r\n"))?;
        }
        self.draw()
    }

    /// What was pressed since the last call.
    ///
    /// # Errors
    /// If the terminal cannot be read.
    pub(super) fn keys(&mut self) -> io::Result<Vec<Key>> {
        let mut keys = Vec::new();
        let mut is_touched = false;
        while event::poll(Duration::ZERO)? {
            is_touched = true;
            if let TerminalEvent::Key(key) = event::read()?
                && key.kind != KeyEventKind::Release
            {
                keys.extend(self.rows.press(key));
            }
        }
        if is_touched {
            self.draw()?;
        }
        Ok(keys)
    }

    fn erase(&mut self) -> io::Result<()> {
        if self.drawn > 1 {
            self.out.queue(MoveUp(self.drawn - 1))?;
        }
        self.drawn = 0;
        self.out.queue(MoveToColumn(0))?.queue(Clear(ClearType::FromCursorDown)).map(drop)
    }

    fn draw(&mut self) -> io::Result<()> {
        self.draw_within(terminal::size().unwrap_or((80, 24)))
    }

    /// Draws the rows at a terminal of so many columns and rows.
    fn draw_within(&mut self, (width, height): (u16, u16)) -> io::Result<()> {
        self.erase()?;
        // A wider row would wrap, and too many would scroll.
        let rows = self.rows.text(usize::from(height).saturating_sub(1).max(2));
        let most = usize::from(width).saturating_sub(1);
        for (index, row) in rows.iter().enumerate() {
            if index > 0 {
                self.out.queue(Print("\r\n"))?;
            }
            self.out.queue(Print(clean(&row.chars().take(most).collect::<String>())))?;
        }
        self.drawn = rows.len() as u16;
        self.out.flush()
    }
}

/// The longest name of a motor that is shown whole: more would push the rest of its row off a terminal of 80 columns.
const LONGEST_NAME: usize = 20;

/// A name that fits its row.
fn shortened(name: &str) -> String {
    if name.chars().count() <= LONGEST_NAME {
        return name.to_owned();
    }
    name.chars().take(LONGEST_NAME - 1).chain(['…']).collect()
}

impl Drop for LiveScreen<'_> {
    fn drop(&mut self) {
        // An error here cannot be shown: the terminal is what failed.
        let _ = self.erase().and_then(|()| self.out.flush());
        let _ = terminal::disable_raw_mode();
    }
}

impl ScreenRows {
    fn new(info: &RunInfo) -> ScreenRows {
        ScreenRows {
            info: info.clone(),
            status: None,
            tempo: 1.0,
            is_paused: false,
            is_braking: false,
            cue: None,
            rejoined: 0,
            typed: None,
            has_stopped: false,
        }
    }

    fn hear(&mut self, happened: &RunEvent) {
        match happened {
            RunEvent::Status(status) => self.status = Some(status.clone()),
            RunEvent::Tempo { rate, .. } => self.tempo = *rate,
            RunEvent::Pausing { .. } => self.is_paused = true,
            RunEvent::Resuming { .. } => self.is_paused = false,
            RunEvent::Stopping { .. } => self.is_braking = true,
            RunEvent::Cue { name, .. } => self.cue = Some(name.clone()),
            RunEvent::Rejoined { times, .. } => self.rejoined = *times,
            _ => {}
        }
    }

    fn press(&mut self, key: KeyEvent) -> Option<Key> {
        let command = |command| Some(Key::Command(command));
        let is_control = key.modifiers.contains(KeyModifiers::CONTROL);
        if is_control && matches!(key.code, KeyCode::Char('c' | 'd')) {
            return self.stop();
        }
        if let Some(typed) = &mut self.typed {
            match key.code {
                KeyCode::Enter => {
                    let line = self.typed.take()?;
                    return Some(Key::Line(line));
                }
                KeyCode::Esc => self.typed = None,
                KeyCode::Backspace if typed.is_empty() => self.typed = None,
                KeyCode::Backspace => drop(typed.pop()),
                KeyCode::Char(letter) if !is_control && !letter.is_control() => typed.push(letter),
                _ => {}
            }
            return None;
        }
        match key.code {
            KeyCode::Char(' ' | 'p') if self.is_paused => command(RunCommand::Resume),
            KeyCode::Char(' ' | 'p') => command(RunCommand::Pause),
            KeyCode::Char('+' | '=') => command(RunCommand::Tempo { rate: self.tempo * FASTER }),
            KeyCode::Char('-') => command(RunCommand::Tempo { rate: self.tempo / FASTER }),
            KeyCode::Char('s' | 'q') => self.stop(),
            KeyCode::Char(':') | KeyCode::Enter => {
                self.typed = Some(String::new());
                None
            }
            _ => None,
        }
    }

    /// The first stop brakes, the next one stops at once.
    fn stop(&mut self) -> Option<Key> {
        let command =
            if std::mem::replace(&mut self.has_stopped, true) { RunCommand::StopNow } else { RunCommand::Stop };
        Some(Key::Command(command))
    }

    /// The rows, the last of which is for keys and typing.
    fn text(&self, most: usize) -> Vec<String> {
        let mut rows = Vec::new();
        let names = self.info.motors.iter().map(|motor| motor.name.chars().count());
        let width = names.max().unwrap_or_default().min(LONGEST_NAME);
        if let Some(status) = &self.status {
            for (index, motor) in self.info.motors.iter().enumerate() {
                let Some(at) = status.motors.get(index) else { continue };
                let position = self.info.position(index, at.position).unwrap_or_default();
                let speed = at.speed.map_or_else(String::new, |speed| {
                    let share = motor.max_speed.map_or_else(String::new, |max| {
                        format!("  {:>3.0} % of max", 100.0 * speed.abs() / max.max(f64::MIN_POSITIVE))
                    });
                    format!("{:>10.3} {}/s{share}", speed / motor.steps_per_unit, human::unit(&motor.unit))
                });
                let name = shortened(&motor.name);
                // A position in steps is a whole number.
                let digits = if motor.steps_per_unit == 1.0 { 0 } else { 3 };
                rows.push(format!("{name:<width$} {position:>10.digits$} {:<4} {speed}", human::unit(&motor.unit)));
            }
            let what = match (self.is_braking, self.is_paused) {
                (true, _) => "brakes",
                (false, true) => "paused",
                (false, false) => "runs",
            };
            let lease = status.lease_s.map_or_else(|| "to the end".to_owned(), |s| format!("{:.0} ms ahead", 1e3 * s));
            let late = status.lateness.as_ref().map_or_else(String::new, |late| {
                let worst = late.max_ticks - i64::try_from(late.constant_ticks).unwrap_or(0);
                format!("  worst edge {worst} ticks late")
            });
            let cue = self.cue.as_ref().map_or_else(String::new, |cue| format!("  cue {cue}"));
            let rejoined = if self.rejoined > 0 { format!("  rejoined {}", self.rejoined) } else { String::new() };
            rows.push(format!("{:.1} s  {what}  tempo {:.2}  {lease}{late}{cue}{rejoined}", status.at_s, self.tempo));
        }
        // The last of them tells how the motion goes: motors that have no room are left out before it.
        if rows.len() >= most
            && let Some(last) = rows.pop()
        {
            rows.truncate(most.saturating_sub(2));
            rows.push(last);
        }
        rows.push(match &self.typed {
            Some(typed) => format!(": {typed}"),
            None => "space pauses, + - tempo, s stops, : types a line (help)".to_owned(),
        });
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::MotorInfo;
    use pulsetrain_session::control::MotorStatus;
    use std::num::NonZeroU16;

    /// What a terminal of 80 columns shows of a motion of eight motors, after some news.
    fn shown(height: u16, news: usize) -> Vec<String> {
        let mut info = RunInfo::nothing();
        let name = |number: usize| match number {
            7 => "the upper arm of the second figure".to_owned(),
            number => format!("motor {number}"),
        };
        let motor = |number| MotorInfo {
            name: name(number),
            unit: "deg".to_owned(),
            steps_per_unit: 8.889,
            start_steps: 0.0,
            max_speed: Some(8000.0),
        };
        info.motors = (0..8).map(motor).collect();
        let motor = MotorStatus { position: -123_456, target: None, speed: Some(-4000.0), queue: (0, 0) };
        let status = Status { at_s: 86_400.0, lease_s: Some(0.42), motors: vec![motor; 8], lateness: None };
        let mut out = Vec::new();
        let mut screen = LiveScreen { out: &mut out, rows: ScreenRows::new(&info), drawn: 0 };
        screen.rows.hear(&RunEvent::Status(status));
        screen.rows.hear(&RunEvent::Cue { name: "dusk".to_owned(), from_s: 0.0, until_s: 0.0 });
        for number in 0..news {
            screen.draw_within((80, height)).unwrap();
            screen.erase().unwrap();
            screen.out.queue(Print(format!("news {number}\r\n"))).unwrap();
        }
        screen.draw_within((80, height)).unwrap();
        // A terminal in another test does not need to be in raw mode.
        std::mem::forget(screen);
        let size = |number| NonZeroU16::new(number).expect("a terminal has rows and columns");
        let mut terminal = vt100::Parser::new(size(height), size(80), 0);
        terminal.process(&out);
        terminal.screen().rows(0, 80).map(|row| row.trim_end().to_owned()).collect()
    }

    #[test]
    fn eight_motors_fit_a_usual_terminal() {
        let rows = shown(24, 3);
        let expected =
            ["news 0", "news 1", "news 2", "motor 0              -13888.626 deg    -449.994 deg/s   50 % of max"];
        assert_eq!(rows[..4], expected);
        assert_eq!(rows[10], "the upper arm of th… -13888.626 deg    -449.994 deg/s   50 % of max");
        assert_eq!(rows[11], "86400.0 s  runs  tempo 1.00  420 ms ahead  cue dusk");
        assert_eq!(rows[12], "space pauses, + - tempo, s stops, : types a line (help)");
        assert!(rows[13..].iter().all(String::is_empty), "{rows:?}");
    }

    #[test]
    fn motors_that_brake_do_not_run() {
        let mut rows = ScreenRows::new(&RunInfo::nothing());
        let status = Status { at_s: 1.0, lease_s: None, motors: Vec::new(), lateness: None };
        rows.hear(&RunEvent::Status(status));
        assert!(rows.text(9)[0].starts_with("1.0 s  runs"));
        rows.hear(&RunEvent::Stopping { at_s: 1.1 });
        assert!(rows.text(9)[0].starts_with("1.0 s  brakes"));
    }

    #[test]
    fn a_small_terminal_keeps_the_last_rows() {
        let rows = shown(6, 40);
        assert!(rows[1].starts_with("motor 0") && rows[2].starts_with("motor 1"), "{rows:?}");
        assert_eq!(
            rows[4..],
            [
                "86400.0 s  runs  tempo 1.00  420 ms ahead  cue dusk",
                "space pauses, + - tempo, s stops, : types a line (help)"
            ]
        );
    }
}
