//! Calls the Pico's library on the emulated chip, through a mailbox in its RAM; the other end is `firmware/pico/examples/mailbox.rs`.

use super::pico::TICK_HZ;
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::{Edge, Port};
use pulsetrain_core::verbs::{Heading, Verb};
use pulsetrain_core::wire::message::Reason;
use std::time::Duration;

const IMAGE: &[u8] = include_bytes!("../../../testdata/mailbox.uf2");

/// The mailbox's first word, by which it is found in RAM.
const MAGIC: [u8; 4] = 0x6d61_696c_u32.to_le_bytes();
const COUNT: usize = 1;
const CALL: usize = 2;
const ANSWERED: usize = 3;
const WHAT: usize = 4;
const ARGUMENTS: usize = 5;
const REFUSED: usize = 33;
const GIVEN: usize = 34;
const DONES: usize = 38;
const DONE: usize = 39;
const KEPT: u32 = 64;
const FUTURES: usize = DONE + 3 * KEPT as usize;
const INTERRUPTS: usize = FUTURES + 2 * 6;

/// Ticks within which a call is answered, besides the time of the call itself: at the latest the timer's interrupt wakes the program.
const PATIENCE: u64 = TICK_HZ / 100;

/// A program that uses the library, and its motors.
#[derive(Clone)]
pub struct Mailbox {
    pub pico: VirtualPico,
    /// The mailbox's place in RAM.
    at: usize,
    calls: u32,
    /// The edges of the pins so far.
    pub edges: Vec<Edge>,
    /// The finished moves so far: motor, low half of the tick, number.
    pub dones: Vec<(u32, u32, u32)>,
}

/// The state of a future.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Waited {
    Waits,
    Done,
    Refused,
}

/// A refusal: its reason, and its detail.
pub type Refused = (Reason, u16);

impl Mailbox {
    /// The program with a number of step/dir drivers: STEP on pins 2, 4, 6, …, with pulses and DIR setups of 50 ticks.
    pub fn new(motors: u8) -> Mailbox {
        Mailbox::with(motors, false)
    }

    /// The program with up to five motors on coils, in half steps, on pins 2 to 5, 6 to 9, …
    pub fn on_coils(motors: u8) -> Mailbox {
        Mailbox::with(motors, true)
    }

    fn with(motors: u8, on_coils: bool) -> Mailbox {
        let mut image = IMAGE.to_vec();
        let at = place(&image);
        image[at + 4 * COUNT..][..2].copy_from_slice(&[motors, on_coils.into()]);
        let pico = VirtualPico::with_image(&image).expect("it runs");
        let mut mailbox = Mailbox { pico, at: 0, calls: 0, edges: Vec::new(), dones: Vec::new() };
        mailbox.at = place(mailbox.pico.chip().ram());
        assert_eq!(mailbox.word(COUNT), u32::from(motors) | u32::from(on_coils) << 8);
        mailbox
    }

    fn word(&self, word: usize) -> u32 {
        let at = self.at + 4 * word;
        let bytes = self.pico.chip().ram()[at..].first_chunk().expect("it lies in RAM");
        u32::from_le_bytes(*bytes)
    }

    fn set(&mut self, word: usize, value: u32) {
        let at = self.at + 4 * word;
        self.pico.chip_mut().ram_mut()[at..at + 4].copy_from_slice(&value.to_le_bytes());
    }

    /// The number of motors.
    pub fn motors(&self) -> u32 {
        self.word(COUNT) & 0xff
    }

    /// The board's time, ticks.
    pub fn now(&self) -> u64 {
        self.pico.chip().cycle() - self.pico.zero()
    }

    /// Lets time pass, and collects edges and finished moves.
    pub fn advance(&mut self, until: u64) {
        let until = Duration::from_nanos(8 * until);
        while self.pico.now() < until {
            self.pico.receive(until, &mut Vec::new()).expect("a virtual port");
        }
        self.look();
    }

    fn look(&mut self) {
        assert_eq!(self.pico.chip().fault(), None);
        self.pico.edges(&mut self.edges);
        let dones = self.word(DONES);
        let known = self.dones.len() as u32;
        assert!(dones - known <= KEPT, "some were overwritten: look more often");
        for number in known..dones {
            let at = DONE + 3 * (number % KEPT) as usize;
            self.dones.push((self.word(at), self.word(at + 1), self.word(at + 2)));
        }
    }

    /// Starts a call, and does not wait for its answer.
    pub fn ask(&mut self, what: u32, arguments: &[u32]) {
        for (word, argument) in (ARGUMENTS..).zip(arguments) {
            self.set(word, *argument);
        }
        self.set(WHAT, what);
        self.calls += 1;
        self.set(CALL, self.calls);
    }

    /// Makes a call, waits for its answer, and returns that.
    fn call(&mut self, what: u32, arguments: &[u32]) -> Result<[u32; 4], Refused> {
        self.ask(what, arguments);
        let end = self.now() + PATIENCE;
        while self.word(ANSWERED) != self.calls {
            assert!(self.now() < end, "call {what} was not answered");
            self.advance(self.now() + TICK_HZ / 20_000);
        }
        let refused = self.word(REFUSED);
        if refused != 0 {
            let reason = Reason::from_code(refused as u8).expect("a reason");
            return Err((reason, (refused >> 16) as u16));
        }
        Ok([0, 1, 2, 3].map(|word| self.word(GIVEN + word)))
    }

    /// Sends verbs to motors, and returns the tick from which they hold.
    pub fn tell(&mut self, verbs: &[(u32, Verb)]) -> Result<u64, Refused> {
        let mut arguments = vec![verbs.len() as u32];
        for (motor, verb) in verbs {
            let (kind, number) = match *verb {
                Verb::Move { steps } => (0, steps),
                Verb::Run => (1, 0),
                Verb::Speed { ticks } => (2, u32::try_from(ticks).expect("a short one")),
                Verb::Heading(Heading::Stationary) => (3, 0),
                Verb::Heading(Heading::Forward) => (3, 1),
                Verb::Heading(Heading::Backward) => (3, 2),
                Verb::Halt => (4, 0),
            };
            arguments.extend([*motor, kind, number]);
        }
        self.call(1, &arguments).map(|[low, high, ..]| u64::from(low) | u64::from(high) << 32)
    }

    pub fn arm(&mut self) -> Result<(), Refused> {
        self.call(2, &[]).map(drop)
    }

    /// Stops the motors at once, and returns the tick of the stop.
    pub fn stop(&mut self) -> u64 {
        let [low, high, ..] = self.call(3, &[]).expect("it is not refused");
        u64::from(low) | u64::from(high) << 32
    }

    pub fn release(&mut self) -> Result<(), Refused> {
        self.call(4, &[]).map(drop)
    }

    /// Lets the program disable all interrupts for a time, which begins at most 1.2 ms from now.
    pub fn keep_out(&mut self, ticks: u32) {
        self.ask(5, &[ticks]);
    }

    /// Sets how long the program's own interrupt takes, ticks, and its priority.
    pub fn own_interrupt(&mut self, ticks: u32, priority: u8) {
        self.call(6, &[ticks, priority.into()]).expect("it is not refused");
    }

    /// Triggers the program's own interrupt.
    pub fn interrupt(&mut self) {
        // The timer's alarm 2 (RP2040 datasheet, §4.6.5, INTF).
        const TIMER_INTF: u32 = 0x4005_403c;
        self.pico.chip_mut().write(TIMER_INTF, 1 << 2, &mut ());
    }

    /// How many times the program's own interrupt came.
    pub fn interrupts(&self) -> u32 {
        self.word(INTERRUPTS)
    }

    /// Sets how many ticks `on_done` takes, and with how many steps it lets the motor go on.
    pub fn on_done(&mut self, ticks: u32, steps: u32) {
        self.call(7, &[ticks, steps]).expect("it is not refused");
    }

    /// A motor's position, whether it rests, and whether the motors are armed.
    pub fn motor(&mut self, motor: u32) -> (i32, bool, bool) {
        let [position, rests, armed, _] = self.call(8, &[motor]).expect("it is not refused");
        (position.cast_signed(), rests != 0, armed != 0)
    }

    /// Whether an interrupt is not the program's.
    pub fn is_taken(&mut self, interrupt: u32) -> bool {
        self.call(9, &[interrupt]).expect("it is not refused")[0] != 0
    }

    /// Lets a future wait for a motor's rest.
    pub fn wait(&mut self, future: u32, motor: u32) {
        self.call(10, &[future, motor]).expect("it is not refused");
    }

    /// The state of a future, and how many times it was polled.
    pub fn waited(&self, future: usize) -> (Waited, u32) {
        let waited = [Waited::Waits, Waited::Done, Waited::Refused][self.word(FUTURES + 2 * future) as usize];
        (waited, self.word(FUTURES + 2 * future + 1))
    }

    /// The ticks of a motor's steps so far.
    pub fn steps(&self, motor: u8) -> Vec<u64> {
        self.edges.iter().filter(|edge| edge.line == 2 + 2 * motor && edge.level).map(|edge| edge.tick).collect()
    }
}

/// The mailbox's place in RAM.
fn place(bytes: &[u8]) -> usize {
    let mut places = bytes.windows(4).enumerate().filter(|(_, bytes)| *bytes == MAGIC).map(|(at, _)| at);
    let place = places.next().expect("a mailbox");
    assert_eq!(places.next(), None, "one mailbox");
    place
}
