//! The link to the firmware itself, on the virtual Uno.

use pulsetrain_board::{Board, Edge, Faults, Remote, Setup, virtual_uno::VirtualUno};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::MotorSetup;
use pulsetrain_core::{Direction, Entry, Epoch, Item, Moment, Segment};

const TICK_HZ: u64 = 16_000_000;

#[test]
fn the_firmware_finds_its_checks_right_at_every_rate() {
    for baud in Baud::ALL {
        let mut remote = Remote::open(VirtualUno::new(), 1).unwrap();
        assert_eq!(remote.set_baud(baud), Ok(baud));
        let motor =
            MotorSetup { step_pin: 8, dir_pin: 9, forward_high: true, pull_in_ticks: 16_000, ..MotorSetup::default() };
        let setup = Setup { pulse_ticks: 16, setup_ticks: 16, hold_ticks: 16, motors: vec![motor], ..Setup::default() };
        remote.configure(&setup).unwrap();
        let from = remote.horizon() + TICK_HZ / 4;
        let mut steps = 0;
        let push = |remote: &mut Remote<VirtualUno>, item| {
            remote.push(0, Entry { epoch: Epoch(1), item }).unwrap();
        };
        push(&mut remote, Item::Anchor { tick: Moment::of(from) });
        let mut ticks = 0;
        // Each one different from the one before: as many bytes as fit, and some checks among them.
        for k in 0_i64.. {
            if remote.room(0) < 60 {
                break;
            }
            let segment = Segment {
                count: 5 + (k % 3) as u32,
                interval: (4000 + 97 * (k * k % 31)) << 16,
                add: k << 16,
                add2: 0,
            };
            let direction = if k % 9 == 8 { Direction::Backward } else { Direction::Forward };
            push(&mut remote, Item::Run { segment, direction });
            steps += i64::from(direction.sign()) * i64::from(segment.count);
            ticks += (segment.span(segment.count) >> 16) as u64;
        }
        assert_eq!(remote.switch(Epoch(1), from), Ok(()), "{baud:?}");
        let mut rises = 0;
        let until = from + ticks + TICK_HZ / 5;
        remote.advance(until, &mut |edge: Edge| rises += i64::from(edge.line == 8 && edge.level));
        assert_eq!(remote.error(), None, "{baud:?}");
        assert!(remote.is_idle(), "{baud:?}");
        assert_eq!((remote.positions(), remote.faults(0)), (vec![steps], Faults::default()), "{baud:?}");
        assert!(rises > steps, "{baud:?}");
    }
}
