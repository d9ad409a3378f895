//! What an OSC address and its arguments ask for.
//!
//! The names that begin with a small letter and have a capital within are those of the STEP400. Source: its OSC command reference, "Motor control",
//! "Position management" and "System settings".

use std::time::Duration;

use rosc::{OscMessage, OscType};

use super::OscInfo;
use crate::live::{KnobInfo, KnobValue, RunCommand};

/// What a message asks for.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum OscCommand {
    /// Nothing: a button was released, or it is an answer.
    Nothing,
    /// Something of the motion.
    Run(RunCommand),
    /// To go on by so many steps.
    Move(f64),
    /// The positions of motors, in a message each.
    Positions(Vec<usize>),
    /// The positions of all motors, in one message.
    PositionList,
    /// Whether motors are busy.
    Busy(Vec<usize>),
    /// To hear of what happens, at another port of the same computer if there is one.
    Listen(Option<u16>),
    /// To hear, or not, when motors begin and end to be busy.
    ReportBusy(Vec<usize>, bool),
    /// To hear the positions of motors again and again; `None`: no longer.
    ReportPositions(Vec<usize>, Option<Duration>),
    /// The same of all motors in one message.
    ReportPositionList(Option<Duration>),
    /// To hear of errors, or not.
    ReportErrors(bool),
}

/// Why a message asks for nothing that can be done.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Misunderstood {
    pub(super) why: String,
    /// The number of the motor in the message; 0 if there is none.
    pub(super) motor: i32,
}

impl From<String> for Misunderstood {
    fn from(why: String) -> Misunderstood {
        Misunderstood { why, motor: 0 }
    }
}

/// All motors. Source: STEP400.
const ALL: f64 = 255.0;
/// The longest text of an argument, bytes.
const LONGEST_TEXT: usize = 256;
/// Letters of a client's text that an error repeats.
const MOST_REPEATED: usize = 60;
/// The parameter of a law that turns at a constant speed.
const SPEED: &str = "speed";

/// What `message` asks for.
pub(super) fn read(message: &OscMessage, info: &OscInfo) -> Result<OscCommand, Misunderstood> {
    let message = Message { address: &message.addr, arguments: &message.args, info };
    if message.address.contains(['*', '?', '[', ']', '{', '}']) {
        return Err(message.wrong("patterns are not understood: send a message for each motor or knob"));
    }
    let names: Vec<&str> = message.address.split('/').skip(1).collect();
    match names.as_slice() {
        // Answers of another server: two that answered each other's would never end.
        ["error", ..] | ["destIp" | "position" | "positionList" | "busy"] => Ok(OscCommand::Nothing),
        ["pulsetrain", names @ ..] if !names.is_empty() => match message.command(names)? {
            Some(asked) => Ok(asked),
            None => message.parameter(names),
        },
        names => match message.command(names)? {
            Some(asked) => Ok(asked),
            None => match message.step400(names)? {
                Some(asked) => Ok(asked),
                None => match names {
                    [name] => message.knob(name),
                    _ => Err(message.unknown()),
                },
            },
        },
    }
}

/// `name` as part of an OSC address: what may not be there is `_`.
pub(super) fn osc_name(name: &str) -> String {
    let allowed = |letter: char| letter.is_ascii_graphic() && !"#*,/?[]{}".contains(letter);
    name.chars().map(|letter| if allowed(letter) { letter } else { '_' }).collect()
}

/// The address of a knob.
pub(super) fn knob_address(knob: &str, info: &OscInfo) -> String {
    match info.motors.iter().find_map(|motor| Some((motor, knob.strip_prefix(&motor.name)?.strip_prefix('.')?))) {
        Some((motor, parameter)) => {
            let parameters: Vec<String> = parameter.split('.').map(osc_name).collect();
            format!("/pulsetrain/{}/{}", osc_name(&motor.name), parameters.join("/"))
        }
        None => format!("/pulsetrain/knob/{}", osc_name(knob)),
    }
}

/// The first letters of a client's text.
fn shortened(text: &str) -> String {
    text.chars().take(MOST_REPEATED).collect()
}

struct Message<'a> {
    address: &'a str,
    arguments: &'a [OscType],
    info: &'a OscInfo,
}

impl Message<'_> {
    fn wrong(&self, why: &str) -> Misunderstood {
        format!("{}: {why}", shortened(self.address)).into()
    }

    fn unknown(&self) -> Misunderstood {
        let knobs: Vec<String> =
            self.info.knobs.iter().take(4).map(|knob| knob_address(&knob.name, self.info)).collect();
        let some = if knobs.is_empty() { String::new() } else { format!("; there are {}", knobs.join(", ")) };
        self.wrong(&format!("this address is unknown{some}, /tempo, /pause, /resume, /stop, /go, /back, /cue"))
    }

    /// The commands of Pulsetrain.
    fn command(&self, names: &[&str]) -> Result<Option<OscCommand>, Misunderstood> {
        let pressed = |request: RunCommand| {
            Ok(Some(if self.is_pressed()? { OscCommand::Run(request) } else { OscCommand::Nothing }))
        };
        match *names {
            ["pause"] => pressed(RunCommand::Pause),
            ["resume"] => pressed(RunCommand::Resume),
            ["stop"] => Ok(Some(self.stop(RunCommand::Stop))),
            ["stop_now"] => Ok(Some(self.stop(RunCommand::StopNow))),
            ["go"] => pressed(RunCommand::Go),
            ["back"] => pressed(RunCommand::Back),
            ["tempo"] => {
                let rate = self.only_number("the tempo: 1 is that of the file")?;
                Ok(Some(OscCommand::Run(RunCommand::Tempo { rate })))
            }
            // Phones send numbers alone: there the name is in the address.
            ["cue", name] => pressed(RunCommand::Cue { name: name.to_owned() }),
            ["cue"] => {
                let name = self.text_or_number("the cue's name")?;
                Ok(Some(OscCommand::Run(RunCommand::Cue { name })))
            }
            ["goto"] => {
                let position = self.text_or_number("a position such as \"90 deg\", or 0, where the motion begins")?;
                Ok(Some(OscCommand::Run(RunCommand::Goto { position })))
            }
            ["begin"] => pressed(RunCommand::Begin),
            ["here"] => self.here().map(Some),
            _ => Ok(None),
        }
    }

    /// Where motors stand: a position of all of them, or a motor's name or number and its position.
    fn here(&self) -> Result<OscCommand, Misunderstood> {
        let (motor, position) = match self.arguments {
            [OscType::String(motor), position] => (Some(self.bounded(motor)?), position),
            [_, position] => match self.motors()?.as_slice() {
                [motor] => (Some(self.info.motors[*motor].name.clone()), position),
                _ => (None, position),
            },
            [position] => (None, position),
            _ => {
                let what = "it needs a position such as \"90 deg\"; for one motor its name or number before that";
                return Err(self.wrong(what));
            }
        };
        let position = match position {
            OscType::String(text) => self.bounded(text)?,
            number => self.number(number, "a position")?.to_string(),
        };
        Ok(OscCommand::Run(RunCommand::Here { motor, position }))
    }

    /// A knob or a parameter, below `/pulsetrain`.
    fn parameter(&self, names: &[&str]) -> Result<OscCommand, Misunderstood> {
        match names {
            ["knob", name] => self.knob(name),
            [name] => self.knob(name),
            [motor, parameter @ ..] if parameter.iter().all(|name| !name.is_empty()) => {
                let motor =
                    self.info.motors.iter().find(|known| known.name == *motor || osc_name(&known.name) == *motor);
                let Some(motor) = motor else { return Err(self.unknown()) };
                let name = format!("{}.{}", motor.name, parameter.join("."));
                let known =
                    self.info.knobs.iter().find(|knob| knob.name == name || osc_name(&knob.name) == osc_name(&name));
                self.set(known.map_or(name, |knob| knob.name.clone()))
            }
            _ => Err(self.unknown()),
        }
    }

    fn knob(&self, name: &str) -> Result<OscCommand, Misunderstood> {
        let knob = self.info.knobs.iter().find(|knob| knob.name == name || osc_name(&knob.name) == name);
        self.set(knob.ok_or_else(|| self.unknown())?.name.clone())
    }

    fn set(&self, knob: String) -> Result<OscCommand, Misunderstood> {
        let value = match self.arguments {
            [OscType::String(text)] => KnobValue::Text(self.bounded(text)?),
            [number, OscType::String(unit)] => {
                KnobValue::Text(self.bounded(&format!("{} {unit}", self.number(number, "a value")?))?)
            }
            [number] => KnobValue::Number(self.number(number, "a value")?),
            _ => return Err(self.wrong("it needs one value: a number, or text with a unit such as \"0.9 Hz\"")),
        };
        Ok(OscCommand::Run(RunCommand::Set { knob, value }))
    }

    /// The commands of a STEP400 that can be done here.
    fn step400(&self, names: &[&str]) -> Result<Option<OscCommand>, Misunderstood> {
        let [name] = *names else { return Ok(None) };
        let count = self.info.motors.len();
        let asked = match name {
            "getPosition" => OscCommand::Positions(self.motors()?),
            "getPositionList" => OscCommand::PositionList,
            "getBusy" => OscCommand::Busy(self.motors()?),
            "enableBusyReport" => OscCommand::ReportBusy(self.motors()?, self.second("1 or 0")? >= 1.0),
            "setPositionReportInterval" => {
                OscCommand::ReportPositions(self.motors()?, interval(self.second("an interval, ms")?))
            }
            "setPositionListReportInterval" => {
                OscCommand::ReportPositionList(interval(self.only_number("an interval, ms")?))
            }
            "reportError" => OscCommand::ReportErrors(self.is_pressed()?),
            "setDestIp" => match self.arguments {
                [port] => match self.number(port, "a port")? {
                    port if (1.0..=65_535.0).contains(&port) => OscCommand::Listen(Some(port as u16)),
                    port => return Err(self.wrong(&format!("{port} is no port: it must be 1 to 65535"))),
                },
                _ => OscCommand::Listen(None),
            },
            // A stop is never refused: one that is meant for a motor alone stops the others too, if it cannot be stopped alone.
            "hardStop" => OscCommand::Run(RunCommand::StopNow),
            "softStop" => OscCommand::Run(match self.motors().ok().and_then(|motors| self.alone(&motors)) {
                Some(knob) => speed(knob, 0.0),
                None => RunCommand::Pause,
            }),
            "run" => {
                let motors = self.motors()?;
                let steps_per_s = self.second("a speed, steps/s")?;
                let knob = motors.iter().map(|motor| self.speed_knob(*motor)).collect::<Option<Vec<_>>>();
                match (knob.as_deref(), motors.as_slice()) {
                    (Some([knob]), _) => OscCommand::Run(speed(knob.name.clone(), steps_per_s)),
                    (_, [motor]) => {
                        let (name, number) = (&self.info.motors[*motor].name, self.first_number());
                        let why = format!(
                            "CommandIgnored: the law of motor {name} has no parameter `{SPEED}` that can be changed"
                        );
                        return Err(Misunderstood { why, motor: number });
                    }
                    _ => {
                        let why =
                            "CommandIgnored: motors run one by one here: send a bundle with a /run for each".to_owned();
                        return Err(Misunderstood { why, motor: self.first_number() });
                    }
                }
            }
            "goTo" | "move" => {
                let motors = self.motors()?;
                let steps = self.second("a number of steps")?.trunc();
                if motors.len() != count || (name == "move" && count != 1) {
                    let why = "CommandIgnored: a live motion has one path for all its motors: only /goTo 255 brings them to a position".to_owned();
                    return Err(Misunderstood { why, motor: self.first_number() });
                }
                if name == "move" {
                    OscCommand::Move(steps)
                } else {
                    OscCommand::Run(RunCommand::Goto { position: format!("{steps} steps") })
                }
            }
            _ => return Ok(None),
        };
        Ok(Some(asked))
    }

    /// What stops the only motor in `motors` by its speed, if the motion has others.
    fn alone(&self, motors: &[usize]) -> Option<String> {
        let [motor] = motors else { return None };
        let knob = self.speed_knob(*motor).filter(|_| self.info.motors.len() > 1)?;
        // A knob that does not reach 0 would leave the motor running.
        let has_rest =
            knob.least.is_none_or(|least| least <= 0.0) && knob.greatest.is_none_or(|greatest| greatest >= 0.0);
        Some(if has_rest { &knob.name } else { &knob.target }.clone())
    }

    /// The knob that sets the speed of a motor, whatever `[live.knobs]` calls it.
    fn speed_knob(&self, motor: usize) -> Option<&KnobInfo> {
        let target = format!("{}.{SPEED}", self.info.motors.get(motor)?.name);
        self.info.knobs.iter().find(|knob| knob.target == target)
    }

    /// The motors of the first argument, by their index.
    fn motors(&self) -> Result<Vec<usize>, Misunderstood> {
        let count = self.info.motors.len();
        let first =
            self.arguments.first().ok_or_else(|| self.wrong("it needs the number of a motor, or 255 for all"))?;
        let number = self.number(first, "the number of a motor")?.trunc();
        if number == ALL {
            return Ok((0..count).collect());
        }
        if number >= 1.0 && number <= count as f64 {
            return Ok(vec![number as usize - 1]);
        }
        let why = format!("MotorIdNotMatch: {number} is no motor; there are 1 to {count}, and 255 is all");
        Err(Misunderstood { why, motor: self.first_number() })
    }

    /// The first argument as the number of a motor, for errors.
    fn first_number(&self) -> i32 {
        self.arguments.first().and_then(|first| self.number(first, "").ok()).map_or(0, |number| number as i32)
    }

    fn second(&self, what: &str) -> Result<f64, Misunderstood> {
        match self.arguments {
            [_, second] => self.number(second, what),
            _ => Err(self.wrong(&format!("it needs two values: the number of a motor, and {what}"))),
        }
    }

    fn only_number(&self, what: &str) -> Result<f64, Misunderstood> {
        match self.arguments {
            [number] => self.number(number, what),
            _ => Err(self.wrong(&format!("it needs one number: {what}"))),
        }
    }

    fn text_or_number(&self, what: &str) -> Result<String, Misunderstood> {
        match self.arguments {
            [OscType::String(text)] => self.bounded(text),
            [number] => self.number(number, what).map(|number| number.to_string()),
            _ => Err(self.wrong(&format!("it needs one value: {what}"))),
        }
    }

    /// A stop is never refused, whatever comes with it. Only a button that is released does not stop.
    fn stop(&self, command: RunCommand) -> OscCommand {
        if self.is_pressed().unwrap_or(true) { OscCommand::Run(command) } else { OscCommand::Nothing }
    }

    /// A command acts without a value, and with one that is not 0: buttons send 1 when they are pressed, and 0 when they are released.
    fn is_pressed(&self) -> Result<bool, Misunderstood> {
        match self.arguments {
            [] | [OscType::Inf | OscType::Nil] => Ok(true),
            [OscType::Bool(is_pressed)] => Ok(*is_pressed),
            [number] => Ok(self.number(number, "no value, or 1")? != 0.0),
            _ => Err(self.wrong("it needs no value")),
        }
    }

    fn number(&self, argument: &OscType, what: &str) -> Result<f64, Misunderstood> {
        let number = match argument {
            OscType::Int(number) => f64::from(*number),
            OscType::Long(number) => *number as f64,
            // The shortest decimals of an f32 are what its sender meant: 0.1, not 0.10000000149.
            OscType::Float(number) => number.to_string().parse().unwrap_or(f64::NAN),
            OscType::Double(number) => *number,
            OscType::Bool(is_on) => f64::from(u8::from(*is_on)),
            _ => return Err(self.wrong(&format!("WrongDataType: it needs {what}, as a number"))),
        };
        if number.is_finite() { Ok(number) } else { Err(self.wrong(&format!("{number} is no number"))) }
    }

    fn bounded(&self, text: &str) -> Result<String, Misunderstood> {
        if text.len() > LONGEST_TEXT {
            return Err(self.wrong(&format!("the text has {} bytes; {LONGEST_TEXT} are the most", text.len())));
        }
        Ok(text.trim().to_owned())
    }
}

fn speed(knob: String, steps_per_s: f64) -> RunCommand {
    RunCommand::Set { knob, value: KnobValue::Text(format!("{steps_per_s} steps/s")) }
}

/// An interval in ms; `None` for 0. Positions come with each status of the motion: a shorter interval gives no more.
fn interval(ms: f64) -> Option<Duration> {
    (ms >= 1.0).then(|| Duration::from_millis(ms.min(3_600_000.0) as u64))
}
