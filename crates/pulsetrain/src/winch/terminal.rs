//! A person at a terminal. The board's lines scroll; the last two rows hold the axes' positions and the line being
//! typed.

use std::io::{self, Write};
use std::time::Duration;

use crossterm::cursor::{MoveToColumn, MoveUp};
use crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use crossterm::style::Print;
use crossterm::terminal::{self, Clear, ClearType};
use crossterm::{QueueableCommand, queue};
use pulsetrain_trace::winch::{AXES, Status};

use crate::clean::clean;

use super::console::{ConsoleInput, Person};
use super::talk::{BoardLine, explain};

/// A terminal in raw mode until this is dropped.
pub(crate) struct Terminal<'a> {
    screen: Screen<&'a mut dyn Write>,
    editor: Editor,
    /// Whether Ctrl-C has come once. The next one ends the console.
    has_stopped: bool,
    /// The last line that was typed: a refusal is about it.
    told: String,
    /// The line that Ctrl-C stands for.
    stop: &'static str,
}

impl<'a> Terminal<'a> {
    /// Sets the terminal to raw mode. `stop` is the line that Ctrl-C stands for.
    ///
    /// # Errors
    /// If it is no terminal.
    pub(crate) fn new(out: &'a mut dyn Write, stop: &'static str) -> io::Result<Terminal<'a>> {
        terminal::enable_raw_mode()?;
        let (screen, editor) = (Screen::new(out), Editor::default());
        let mut terminal = Terminal { screen, editor, has_stopped: false, told: String::new(), stop };
        terminal.screen.begin(&terminal.editor)?;
        Ok(terminal)
    }
}

impl Drop for Terminal<'_> {
    fn drop(&mut self) {
        // An error here cannot be shown: the terminal is what failed.
        let _ = self.screen.end();
        let _ = terminal::disable_raw_mode();
    }
}

impl Person for Terminal<'_> {
    fn inputs(&mut self) -> io::Result<Vec<ConsoleInput>> {
        let (mut inputs, mut is_touched) = (Vec::new(), false);
        if let Ok((width, _)) = terminal::size() {
            self.screen.width = width.into();
        }
        while event::poll(Duration::ZERO)? {
            is_touched = true;
            let Event::Key(key) = event::read()? else { continue };
            if key.kind == KeyEventKind::Release {
                continue;
            }
            match self.editor.press(key) {
                Pressed::Nothing => {}
                Pressed::Strange(letter) => {
                    let what = format!("{letter:?} was not taken: a line is printable ASCII");
                    self.screen.print(&what, &self.editor)?;
                }
                Pressed::Line(line) => {
                    self.has_stopped = false;
                    self.screen.print(&format!("> {line}"), &self.editor)?;
                    self.told.clone_from(&line);
                    inputs.push(ConsoleInput::Line(line));
                }
                Pressed::Interrupt if self.has_stopped => inputs.push(ConsoleInput::End),
                Pressed::Interrupt => {
                    self.has_stopped = true;
                    let line = format!("> {}      (Ctrl-C again, or quit, ends)", self.stop);
                    self.screen.print(&line, &self.editor)?;
                    inputs.push(ConsoleInput::Stop);
                }
                Pressed::End => inputs.push(ConsoleInput::End),
            }
        }
        if is_touched {
            self.screen.draw(&self.editor)?;
        }
        Ok(inputs)
    }

    fn show(&mut self, said: &BoardLine) -> io::Result<()> {
        match said {
            BoardLine::Status(status) => {
                self.screen.see(*status);
                self.screen.draw(&self.editor)
            }
            BoardLine::Line(line) => match explain(line, &self.told) {
                Some(meaning) => self.screen.print(&format!("{line}   ({meaning})"), &self.editor),
                None => self.screen.print(line, &self.editor),
            },
        }
    }

    fn tell(&mut self, text: &str) -> io::Result<()> {
        text.lines().try_for_each(|line| self.screen.print(line, &self.editor))
    }

    fn waits_for_rest(&self) -> bool {
        false
    }

    fn shows_positions(&self) -> bool {
        true
    }
}

/// The last two rows and the scrolling part above them. The cursor is in the last row.
struct Screen<W> {
    out: W,
    width: usize,
    last: Option<Status>,
    speeds: [f64; 4],
}

const PROMPT: &str = "> ";

impl<W: Write> Screen<W> {
    fn new(out: W) -> Screen<W> {
        Screen { out, width: 80, last: None, speeds: [0.0; 4] }
    }

    /// Makes room for the two rows.
    fn begin(&mut self, editor: &Editor) -> io::Result<()> {
        self.out.queue(Print("\r\n"))?;
        self.draw(editor)
    }

    fn end(&mut self) -> io::Result<()> {
        queue!(self.out, Print("\r\n"))?;
        self.out.flush()
    }

    fn see(&mut self, status: Status) {
        if let Some(last) = self.last {
            let seconds = status.usec.saturating_sub(last.usec) as f64 * 1e-6;
            for (speed, (now, before)) in self.speeds.iter_mut().zip(status.positions.iter().zip(last.positions)) {
                *speed = f64::from(now.wrapping_sub(before)) / seconds.max(1e-6);
            }
        }
        self.last = Some(status);
    }

    fn positions(&self) -> String {
        let Some(status) = self.last else { return "no status yet".to_owned() };
        let axes = AXES.iter().zip(status.positions).zip(self.speeds);
        let axes = axes.map(|((axis, position), speed)| format!("{axis} {position:>8} {speed:>+7.0}/s"));
        format!("{}   {:.1} s", axes.collect::<Vec<_>>().join("   "), status.usec as f64 * 1e-6)
    }

    fn draw(&mut self, editor: &Editor) -> io::Result<()> {
        self.out.queue(MoveUp(1))?;
        self.rows(editor)
    }

    /// Writes a line above the two rows.
    fn print(&mut self, line: &str, editor: &Editor) -> io::Result<()> {
        queue!(
            self.out,
            MoveUp(1),
            MoveToColumn(0),
            Clear(ClearType::FromCursorDown),
            Print(clean(line)),
            Print("\r\n")
        )?;
        self.rows(editor)
    }

    /// Writes both rows, from the upper one on.
    fn rows(&mut self, editor: &Editor) -> io::Result<()> {
        // A wider text would wrap into more rows.
        let most = self.width.saturating_sub(1);
        let positions: String = self.positions().chars().take(most).collect();
        let room = most.saturating_sub(PROMPT.len());
        let (typed, cursor) = editor.shown(room);
        queue!(self.out, MoveToColumn(0), Clear(ClearType::FromCursorDown), Print(positions), Print("\r\n"))?;
        queue!(self.out, Print(PROMPT), Print(clean(typed)), MoveToColumn((PROMPT.len() + cursor) as u16))?;
        self.out.flush()
    }
}

/// The line being typed, and earlier lines. Lines are printable ASCII.
#[derive(Clone, Debug, Default)]
struct Editor {
    text: String,
    cursor: usize,
    history: Vec<String>,
    /// Which line of the history is shown, and the text that was typed before.
    recalled: Option<(usize, String)>,
}

/// What a key does.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Pressed {
    Nothing,
    /// The key is a letter that no line may contain.
    Strange(char),
    Line(String),
    Interrupt,
    End,
}

impl Editor {
    fn press(&mut self, key: KeyEvent) -> Pressed {
        if key.modifiers.contains(KeyModifiers::CONTROL) {
            match key.code {
                KeyCode::Char('c') => return Pressed::Interrupt,
                KeyCode::Char('d') if self.text.is_empty() => return Pressed::End,
                KeyCode::Char('a') => self.cursor = 0,
                KeyCode::Char('e') => self.cursor = self.text.len(),
                KeyCode::Char('k') => self.text.truncate(self.cursor),
                KeyCode::Char('u') => {
                    self.text.drain(..self.cursor);
                    self.cursor = 0;
                }
                _ => {}
            }
            return Pressed::Nothing;
        }
        match key.code {
            KeyCode::Enter => return self.enter(),
            KeyCode::Char(letter @ ' '..='~') => {
                self.text.insert(self.cursor, letter);
                self.cursor += 1;
            }
            KeyCode::Char(letter) => return Pressed::Strange(letter),
            KeyCode::Backspace if self.cursor > 0 => {
                self.cursor -= 1;
                self.text.remove(self.cursor);
            }
            KeyCode::Delete if self.cursor < self.text.len() => {
                self.text.remove(self.cursor);
            }
            KeyCode::Left => self.cursor = self.cursor.saturating_sub(1),
            KeyCode::Right => self.cursor = (self.cursor + 1).min(self.text.len()),
            KeyCode::Home => self.cursor = 0,
            KeyCode::End => self.cursor = self.text.len(),
            KeyCode::Up => self.recall(true),
            KeyCode::Down => self.recall(false),
            _ => {}
        }
        Pressed::Nothing
    }

    fn enter(&mut self) -> Pressed {
        let line = std::mem::take(&mut self.text);
        (self.cursor, self.recalled) = (0, None);
        if !line.trim().is_empty() && self.history.last() != Some(&line) {
            self.history.push(line.clone());
        }
        Pressed::Line(line)
    }

    /// Shows the earlier or the later line of the history.
    fn recall(&mut self, before: bool) {
        let (at, typed) = match &self.recalled {
            Some((at, typed)) => (*at, typed.clone()),
            None => (self.history.len(), self.text.clone()),
        };
        let to = if before { at.checked_sub(1) } else { Some(at + 1).filter(|to| *to <= self.history.len()) };
        let Some(to) = to else { return };
        self.text = self.history.get(to).unwrap_or(&typed).clone();
        self.recalled = (to < self.history.len()).then_some((to, typed));
        self.cursor = self.text.len();
    }

    /// The part of the line around the cursor that fits, and the cursor's column in it.
    fn shown(&self, room: usize) -> (&str, usize) {
        let from = self.cursor.saturating_sub(room);
        (&self.text[from..self.text.len().min(from + room)], self.cursor - from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(editor: &mut Editor, keys: impl IntoIterator<Item = KeyCode>) {
        for key in keys {
            assert_eq!(editor.press(KeyEvent::new(key, KeyModifiers::NONE)), Pressed::Nothing);
        }
    }

    fn typed(editor: &mut Editor, text: &str) {
        keys(editor, text.chars().map(KeyCode::Char));
    }

    fn enter(editor: &mut Editor) -> Pressed {
        editor.press(KeyEvent::new(KeyCode::Enter, KeyModifiers::NONE))
    }

    fn control(editor: &mut Editor, letter: char) -> Pressed {
        editor.press(KeyEvent::new(KeyCode::Char(letter), KeyModifiers::CONTROL))
    }

    #[test]
    fn lines_are_edited() {
        let mut editor = Editor::default();
        typed(&mut editor, "a x ");
        assert_eq!(editor.press(KeyEvent::new(KeyCode::Char('é'), KeyModifiers::NONE)), Pressed::Strange('é'));
        typed(&mut editor, "100");
        keys(&mut editor, [KeyCode::Home, KeyCode::Delete, KeyCode::Char('d'), KeyCode::End, KeyCode::Backspace]);
        keys(&mut editor, [KeyCode::Left, KeyCode::Char('5'), KeyCode::Right, KeyCode::Right]);
        assert_eq!(editor.shown(80), ("d x 150", 7));
        assert_eq!(editor.shown(3), ("150", 3));
        assert_eq!(enter(&mut editor), Pressed::Line("d x 150".to_owned()));
        typed(&mut editor, "ping pong");
        keys(&mut editor, [KeyCode::Left; 5]);
        assert_eq!(control(&mut editor, 'k'), Pressed::Nothing);
        assert_eq!(editor.text, "ping");
        assert_eq!(control(&mut editor, 'd'), Pressed::Nothing, "there is a line");
        control(&mut editor, 'u');
        assert_eq!((control(&mut editor, 'd'), control(&mut editor, 'c')), (Pressed::End, Pressed::Interrupt));
    }

    #[test]
    fn lines_come_back() {
        let mut editor = Editor::default();
        for line in ["a x 1", "a x 2", "a x 2"] {
            typed(&mut editor, line);
            enter(&mut editor);
        }
        typed(&mut editor, "v");
        let mut shown = Vec::new();
        for key in [KeyCode::Up, KeyCode::Up, KeyCode::Up, KeyCode::Down, KeyCode::Down, KeyCode::Down] {
            keys(&mut editor, [key]);
            shown.push(editor.text.clone());
        }
        assert_eq!(shown, ["a x 2", "a x 1", "a x 1", "a x 2", "v", "v"]);
    }

    #[test]
    fn the_screen_shows_positions_and_keeps_to_its_width() {
        let (mut screen, mut editor) = (Screen::new(Vec::new()), Editor::default());
        screen.see(Status { usec: 1_000_000, positions: [0, 5, 0, 0] });
        screen.see(Status { usec: 1_200_000, positions: [100, 5, 0, -20] });
        typed(&mut editor, "a x 1");
        screen.draw(&editor).unwrap();
        let text = String::from_utf8(std::mem::take(&mut screen.out)).unwrap();
        assert!(text.contains("x      100    +500/s   y        5      +0/s"), "{text:?}");
        assert!(text.ends_with("> a x 1\u{1b}[8G"), "{text:?}");
        screen.width = 20;
        screen.print("err number 3", &editor).unwrap();
        let text = String::from_utf8(screen.out).unwrap();
        assert!(text.contains("err number 3\r\n"), "{text:?}");
        assert!(text.contains("x      100    +500/\r\n"), "{text:?}");
    }
}
