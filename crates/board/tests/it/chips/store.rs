//! Settings that boards keep without power, on the emulated chips: in an Uno's EEPROM, and in the last sectors of a Pico's flash.

use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Port, PortError, Remote, RemoteError, Setup};
use pulsetrain_core::baked;
use pulsetrain_core::wire::frame::check;
use pulsetrain_core::wire::settings::SETTINGS_LEN;
use pulsetrain_core::wire::{Baud, Reason, Settings, Stored};
use pulsetrain_testkit::winch::{WinchLab, Wired};
use std::time::Duration;

const SETTINGS: Settings = Settings { deadman_ms: 400, idle_ms: 250, silence_ms: 600, vmax: 500_000, amax: 4_000_000 };

/// Other ones, of which each byte is another.
const OTHERS: Settings =
    Settings { deadman_ms: 0x1234, idle_ms: 0x5678, silence_ms: 0x9abc, vmax: 0x0012_3456, amax: 0x0102_0304 };

/// A board that keeps settings.
trait Keeps: Wired {
    /// Bytes of settings, with their CRC, and where they are first.
    const KEPT: std::ops::Range<usize>;
    /// A motor's setup.
    fn setup() -> Setup;
    fn memory(&self) -> &[u8];
    fn memory_mut(&mut self) -> &mut [u8];
    /// Another one, with that memory and no power until now; it takes plans.
    fn with_memory(memory: &[u8]) -> Self;
    /// The same that takes text.
    fn with_text(memory: &[u8]) -> Self {
        Self::with_memory(memory)
    }
}

impl Keeps for VirtualUno {
    const KEPT: std::ops::Range<usize> = 0..SETTINGS_LEN + 2;

    fn setup() -> Setup {
        pulsetrain_testkit::uno_setup(&[(8, 9)], 16)
    }

    fn memory(&self) -> &[u8] {
        self.chip().eeprom()
    }

    fn memory_mut(&mut self) -> &mut [u8] {
        self.chip_mut().eeprom_mut()
    }

    fn with_memory(memory: &[u8]) -> VirtualUno {
        let mut uno = VirtualUno::new();
        uno.memory_mut().copy_from_slice(memory);
        uno
    }

    fn with_text(memory: &[u8]) -> VirtualUno {
        let mut uno = VirtualUno::with_winch();
        uno.memory_mut().copy_from_slice(memory);
        uno
    }
}

/// Where the Pico keeps them: in two sectors, from here on.
const PROGRAM_FLASH_BYTES: usize = baked::PROGRAM_FLASH_BYTES as usize;

impl Keeps for VirtualPico {
    // And their number.
    const KEPT: std::ops::Range<usize> = PROGRAM_FLASH_BYTES..PROGRAM_FLASH_BYTES + 1 + SETTINGS_LEN + 2;

    fn setup() -> Setup {
        Setup {
            pulse_ticks: 250,
            setup_ticks: 125,
            motors: vec![pulsetrain_testkit::pico::step_dir(2)],
            ..Setup::default()
        }
    }

    fn memory(&self) -> &[u8] {
        self.chip().flash()
    }

    fn memory_mut(&mut self) -> &mut [u8] {
        self.chip_mut().flash_mut()
    }

    fn with_memory(memory: &[u8]) -> VirtualPico {
        VirtualPico::with_flash(memory).expect("it runs")
    }
}

/// What a board keeps.
fn stored<B: Keeps>(remote: &mut Remote<B>) -> Stored {
    remote.stored().expect("it says what it keeps")
}

const fn whole(settings: Option<Settings>) -> Stored {
    Stored { settings, is_damaged: false }
}

/// What another board keeps that has this memory from its start on.
fn kept_by<B: Keeps>(memory: &[u8]) -> Stored {
    stored(&mut Remote::open(B::with_memory(memory), 2).expect("a board"))
}

/// The memory of a board that was told to keep them, one after the other.
fn memory_with<B: Keeps>(settings: &[Settings]) -> Vec<u8> {
    let mut remote = Remote::open(B::start(), 1).expect("a board");
    settings.iter().for_each(|settings| remote.store(settings).expect("it keeps them"));
    remote.close().memory().to_vec()
}

/// How long it takes to store `settings`.
fn takes<B: Keeps>(remote: &mut Remote<B>, settings: Settings) -> Duration {
    let began = remote.port().now();
    remote.store(&settings).expect("it keeps them");
    remote.port().now() - began
}

fn keeps_without_power<B: Keeps>(least: Duration) {
    let mut remote = Remote::open(B::start(), 1).expect("a board");
    let before = remote.port().memory().to_vec();
    assert_eq!(stored(&mut remote), whole(None), "nothing was stored");
    let took = takes(&mut remote, SETTINGS);
    println!("{took:?}");
    assert!(took > least, "{took:?}");
    assert_eq!(stored(&mut remote), whole(Some(SETTINGS)));
    // What is there already is not written again.
    let took = takes(&mut remote, SETTINGS);
    assert!(took < Duration::from_millis(10), "{took:?}");
    // All the rest of the memory is somebody else's.
    let board = remote.close();
    let mut after = board.memory().to_vec();
    assert_ne!(after, before);
    after[B::KEPT].copy_from_slice(&before[B::KEPT]);
    assert!(after == before, "what is not theirs");

    let mut remote = Remote::open(B::with_memory(board.memory()), 2).expect("a board");
    assert_eq!(stored(&mut remote), whole(Some(SETTINGS)));
    remote.store(&Settings::default()).expect("it keeps them");
    assert_eq!(stored(&mut remote), whole(Some(Settings::default())));
}

#[test]
fn settings_are_kept_without_power() {
    keeps_without_power::<VirtualUno>(Duration::from_millis(16 * 3));
    keeps_without_power::<VirtualPico>(Duration::from_millis(45));
}

#[test]
fn an_uno_that_is_reset_keeps_them() {
    let mut uno = VirtualUno::with_memory(&memory_with::<VirtualUno>(&[SETTINGS]));
    uno.reset();
    assert_eq!(stored(&mut Remote::open(uno, 2).expect("a board")), whole(Some(SETTINGS)));
}

#[test]
fn one_wrong_bit_is_as_if_nothing_were_kept() {
    let mut remote = Remote::open(VirtualUno::new(), 1).expect("a board");
    remote.store(&SETTINGS).expect("it keeps them");
    for bit in 0..8 * VirtualUno::KEPT.len() {
        let mut flip = || remote.port_mut().memory_mut()[bit / 8] ^= 1 << (bit % 8);
        flip();
        assert_eq!(stored(&mut remote), whole(None), "bit {bit}");
        let mut flip = || remote.port_mut().memory_mut()[bit / 8] ^= 1 << (bit % 8);
        flip();
    }
    assert_eq!(stored(&mut remote), whole(Some(SETTINGS)));
    // Nor is a memory of nothing but zeros.
    remote.port_mut().memory_mut().fill(0);
    assert_eq!(stored(&mut remote), whole(None));
}

#[test]
fn a_pico_that_finds_one_wrong_bit_says_so() {
    let memory = memory_with::<VirtualPico>(&[SETTINGS]);
    // A Pico's start takes a while: not all bits, but some of each byte.
    for (bit, at) in VirtualPico::KEPT.enumerate().map(|(place, at)| (place % 8, at)) {
        let mut damaged = memory.clone();
        damaged[at] ^= 1 << bit;
        let is = kept_by::<VirtualPico>(&damaged);
        assert_eq!(is, Stored { settings: None, is_damaged: true }, "bit {bit} of {at:#x}");
    }
}

/// A port that is gone at a moment.
#[derive(Clone)]
struct Until<P>(P, Duration);

impl<P: Port> Port for Until<P> {
    fn now(&self) -> Duration {
        self.0.now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        self.0.send(bytes)
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        if self.now() >= self.1 {
            return Err(PortError::Gone { name: "the port".to_owned(), why: "no supply".to_owned() });
        }
        self.0.receive(until.min(self.1), into)
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.0.set_baud(baud)
    }
}

#[test]
fn a_supply_that_fails_while_a_pico_writes_leaves_what_was_before_or_what_is_new() {
    let memory = memory_with::<VirtualPico>(&[OTHERS, SETTINGS]);
    let new = Settings { deadman_ms: 1, ..OTHERS };
    let taken = Remote::open(Until(VirtualPico::with_memory(&memory), Duration::MAX), 1).expect("a board");
    let [mut old_ones, mut new_ones, mut damaged] = [0; 3];
    // It takes 45 ms to erase, and 0.4 ms to write.
    for us in (0..45_000).step_by(3000).chain((45_000..54_000).step_by(130)) {
        let mut remote = taken.clone();
        remote.port_mut().1 = remote.port().now() + Duration::from_micros(us);
        let told = remote.store(&new);
        let is = kept_by::<VirtualPico>(remote.port().0.memory());
        damaged += u32::from(is.is_damaged);
        if is.settings == Some(new) {
            assert!(!is.is_damaged);
            new_ones += 1;
        } else {
            assert_eq!(is.settings, Some(SETTINGS), "{us} us");
            assert!(told.is_err(), "{us} us: it said that it keeps them");
            old_ones += 1;
        }
    }
    println!("{old_ones} {new_ones} {damaged}");
    assert!(old_ones > 15 && new_ones > 5 && damaged > 0, "{old_ones} {new_ones} {damaged}");
}

#[test]
fn a_damaged_copy_goes_with_the_next_store() {
    let mut memory = memory_with::<VirtualPico>(&[OTHERS, SETTINGS]);
    for place in [PROGRAM_FLASH_BYTES, PROGRAM_FLASH_BYTES + 4096] {
        memory[place + 3] ^= 1;
    }
    let mut remote = Remote::open(VirtualPico::with_memory(&memory), 1).expect("a board");
    assert_eq!(stored(&mut remote), Stored { settings: None, is_damaged: true });
    remote.store(&SETTINGS).expect("it keeps them");
    assert_eq!(stored(&mut remote), whole(Some(SETTINGS)));
    assert_eq!(kept_by::<VirtualPico>(remote.close().memory()), whole(Some(SETTINGS)));
}

#[test]
fn the_newer_copy_holds_past_the_end_of_its_number() {
    let mut memory = memory_with::<VirtualPico>(&[SETTINGS]);
    let copy = &mut memory[VirtualPico::KEPT];
    copy[0] = 0xfe;
    let sum = check(&copy[..1 + SETTINGS_LEN]);
    copy[1 + SETTINGS_LEN..].copy_from_slice(&sum);
    let mut remote = Remote::open(VirtualPico::with_memory(&memory), 1).expect("a board");
    assert_eq!(stored(&mut remote), whole(Some(SETTINGS)));
    for number in 0..4 {
        let settings = Settings { deadman_ms: number, ..SETTINGS };
        remote.store(&settings).expect("it keeps them");
        assert_eq!(kept_by::<VirtualPico>(remote.port().memory()), whole(Some(settings)), "{number}");
    }
}

#[test]
fn the_slowest_flash_is_waited_for() {
    let mut remote = Remote::open(VirtualPico::on_usb(), 1).expect("a board");
    remote.port_mut().chip_mut().slow_flash();
    let took = takes(&mut remote, SETTINGS);
    assert!((403..500).contains(&took.as_millis()), "{took:?}");
    assert_eq!(stored(&mut remote), whole(Some(SETTINGS)));
    // The watchdog, of half a second, has not bitten: the session goes on.
    remote.configure(&VirtualPico::setup()).expect("it can");
}

fn writes_nothing_while_powered<B: Keeps>() {
    let mut remote = Remote::open(B::with_memory(B::start().memory()), 1).expect("a board");
    remote.configure(&B::setup()).expect("it can");
    let is_moving =
        |error: Option<RemoteError>| matches!(error, Some(RemoteError::Refused { reason: Reason::Moving, .. }));
    assert!(is_moving(remote.store(&SETTINGS).err()));
    assert!(is_moving(remote.stored().err()));
    remote.release().expect("they rest");
    remote.store(&SETTINGS).expect("it keeps them");
}

#[test]
fn nothing_is_written_while_motors_are_powered() {
    writes_nothing_while_powered::<VirtualUno>();
    writes_nothing_while_powered::<VirtualPico>();
}

/// Levels of ENABLE, and when, ticks.
fn enables<B: Wired>(lab: &WinchLab<B>) -> Vec<(u64, bool)> {
    lab.edges.iter().filter(|edge| edge.line == B::ENABLE).map(|edge| (edge.tick, edge.level)).collect()
}

fn text_begins_with_settings<B: Keeps>() {
    let mut lab = WinchLab::around(B::with_text(&memory_with::<B>(&[SETTINGS])));
    let ticks_a_ms = B::CYCLES_PER_S / 1000;
    lab.run_ms(80);
    assert_eq!(lab.lines[0].text, "awake");
    lab.say("g x 5 1");
    lab.say("v x 3000");
    lab.run_ms(300);
    let steps = lab.steps(0);
    let shortest = steps.windows(2).map(|pair| pair[1].tick - pair[0].tick).min().expect("it moves");
    let per_s = B::CYCLES_PER_S as f64 / shortest as f64;
    assert!((498.5..501.6).contains(&per_s), "500 steps/s: {per_s}");
    // 125 ms to get there; without limits it is half of that speed sooner.
    let ramp = steps[31].tick - steps[0].tick;
    assert!((100..140).contains(&(ramp / ticks_a_ms)), "{ramp} ticks for 31 steps");
    // Deadman: 400 ms after the last line all axes stop; 250 ms after that the drivers are off.
    lab.run_ms(1000);
    let steps = lab.steps(0);
    let last = steps.last().expect("it moved").tick;
    let off = enables(&lab);
    let levels: Vec<bool> = off.iter().map(|(_, level)| *level).collect();
    assert_eq!(levels, [true, false, true], "an output, on, off");
    let idle_ms = (off[2].0 - last) / ticks_a_ms;
    assert!((250..300).contains(&idle_ms), "{off:?}, the last step at {last}");
    // The next command that moves switches them on.
    lab.say("d x 10");
    lab.run_ms(60);
    assert_eq!(enables(&lab).len(), 4);
    lab.check_positions();
}

#[test]
fn text_begins_with_their_limits_deadman_and_idle() {
    text_begins_with_settings::<VirtualUno>();
    text_begins_with_settings::<VirtualPico>();
}

/// How long it takes until another host has the board, which it asks for every now and then, when the first says nothing any more, ms.
fn taken_after<B: Keeps>(settings: Settings) -> u128 {
    let board = B::with_memory(&memory_with::<B>(&[settings]));
    let mut remote = Remote::open(board, 1).expect("a board");
    remote.configure(&B::setup()).expect("it can");
    let port = remote.port().clone();
    let began = port.now();
    let next = Remote::open(port, 2).expect("the first is lost by then");
    (next.port().now() - began).as_millis()
}

fn a_host_is_lost_as_they_say<B: Keeps>() {
    let (stored, without) = (taken_after::<B>(SETTINGS), taken_after::<B>(Settings { silence_ms: 0, ..SETTINGS }));
    assert!((590..900).contains(&stored), "{stored} ms");
    assert!((1990..2300).contains(&without), "{without} ms");
}

#[test]
fn a_host_is_lost_after_their_silence() {
    a_host_is_lost_as_they_say::<VirtualUno>();
    a_host_is_lost_as_they_say::<VirtualPico>();
}
