//! How long the firmware keeps interrupts out, and how much stack it needs, on the emulated chip: what the table in
//! firmware/uno/src/engine/mod.rs says.

use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Port, PortError, Remote};
use pulsetrain_core::wire::Baud;
use pulsetrain_testkit::lab::{SYMBOLS, address};
use pulsetrain_testkit::segments::{Law, Stream};
use pulsetrain_testkit::{TICK_HZ, uno_setup};
use std::collections::BTreeMap;
use std::time::Duration;

/// Words of a vector (DS40002061B §12.4).
const REFILL: u16 = 2 * 16;
const STEPS: [u16; 2] = [2 * 11, 2 * 12];
const RECEIVE: u16 = 2 * 18;

/// A virtual Uno that is looked at once a microsecond.
struct Watched {
    uno: VirtualUno,
    /// The longest stretch with interrupts off that began there.
    longest: BTreeMap<u16, u64>,
}

impl Watched {
    /// Whether interrupts are off.
    fn are_off(&mut self) -> bool {
        self.uno.chip_mut().read_data(0x5f, &mut ()) & 0x80 == 0
    }
}

impl Port for Watched {
    fn now(&self) -> Duration {
        self.uno.now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        self.uno.send(bytes)
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        let had = into.len();
        while into.len() == had && self.uno.now() < until {
            self.uno.receive(until.min(self.uno.now() + Duration::from_micros(1)), into)?;
            // Not while interrupts are off, which would cut a stretch in two.
            while self.uno.zero().is_some() && self.are_off() {
                self.uno.receive(self.uno.now() + Duration::from_nanos(63), into)?;
            }
            let chip = self.uno.chip_mut();
            let masked = chip.longest_masked();
            chip.forget_masked();
            if self.uno.zero().is_some() {
                let longest = self.longest.entry(masked.from).or_default();
                *longest = masked.cycles.max(*longest);
            }
        }
        Ok(())
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.uno.set_baud(baud)
    }

    fn edges(&mut self, into: &mut Vec<Edge>) {
        self.uno.edges(into);
    }
}

/// The longest stretches while motors move at `rate`, and the bytes of stack that were never used.
fn moving(pins: &[(u8, u8)], rate: f64) -> (BTreeMap<u16, u64>, u16) {
    let port = Watched { uno: VirtualUno::new(), longest: BTreeMap::new() };
    let mut board = Remote::open(port, 7).expect("it answers");
    assert_eq!(board.set_baud(Baud::B1M), Ok(Baud::B1M));
    board.configure(&uno_setup(pins, 16)).expect("it takes it");
    let mut stream = Stream::new(&board, &vec![Law::changing(rate); pins.len()], 1.0, 5, TICK_HZ / 8);
    // Pins and rates are set at rest.
    board.port_mut().longest.clear();
    let done = stream
        .play(&mut board, &mut |_: Edge| {}, |_, board| board.error().map_or(Ok(()), |error| Err(error.to_string())));
    assert_eq!(done, Ok(()), "{pins:?}");
    board.status().expect("it answers");
    let longest = std::mem::take(&mut board.port_mut().longest);
    let now = board.now();
    board.stop_now(now, &mut |_: Edge| {});
    (longest, board.measures(false).expect("it answers").stack_left)
}

#[test]
fn interrupts_are_kept_out_as_long_as_the_table_says() {
    // Where ring B's interrupt closes again what it has opened for ring A's.
    let window = address(SYMBOLS, "timer1_compb_window");
    let [mut receive, mut not_nested, mut refill, mut steps, mut again, mut others] = [0; 6];
    let mut stack_left = u16::MAX;
    for (pins, rate) in [
        (&[(2, 5)][..], 20e3),
        (&[(9, 8), (10, 7)], 68e3),
        (&[(2, 5), (3, 6)], 6e3),
        (&[(8, 11), (9, 12), (10, 13)], 3e3),
        (&[(2, 5), (3, 6), (4, 7), (12, 13)], 2e3),
    ] {
        let (longest, left) = moving(pins, rate);
        println!("{pins:?}: {left} bytes of stack were never used");
        stack_left = stack_left.min(left);
        for (from, cycles) in longest {
            let place = match from {
                // It lets nobody in while the compare hardware makes plain steps.
                RECEIVE if pins[0].0 == 9 => &mut not_nested,
                RECEIVE => &mut receive,
                REFILL => &mut refill,
                from if STEPS.contains(&from) => &mut steps,
                // After `cli`.
                from if (window..window + 2).contains(&from) => &mut again,
                _ => &mut others,
            };
            if cycles > *place && !STEPS.contains(&from) {
                println!("{:#06x}: {cycles} cycles", 2 * from);
            }
            *place = cycles.max(*place);
        }
    }
    println!(
        "receive {receive} or {not_nested}, refill {refill}, steps {steps}, again {again}, others {others} cycles; {stack_left} bytes of stack"
    );
    // With the 4 cycles of the response, without the instruction that follows `sei`.
    assert!(refill <= 16 && steps <= 76);
    assert!(receive <= 16 && not_nested <= 48 && again <= 32 && others <= 16);
    assert!(stack_left >= 40);
}
