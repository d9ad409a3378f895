//! Text on the Pico while the microseconds of its statuses wrap: 31 bits after 35.8 min, 32 after 71.6. Really waited for, in virtual
//! time, asleep nearly all the while: it takes a minute or two.

use pulsetrain_board::Port;
use pulsetrain_testkit::winch::{Pico, SentLine, follow};
use std::time::Duration;

/// Lets it be until a second before so many µs of its clock. Nobody asks for a status meanwhile.
fn wait(pico: &mut Pico, us: u64) {
    pico.say("srate 65535");
    let until = Duration::from_micros(us - 1_000_000);
    let mut bytes = Vec::new();
    while pico.port.now() < until {
        bytes.clear();
        pico.port.receive(until, &mut bytes).expect("it is virtual");
    }
    pico.port.edges(&mut Vec::new());
    pico.edges.clear();
    pico.lines.clear();
    pico.partial.clear();
}

/// Four axes set out before the wrap and are told otherwise after it; then they are let go.
fn across(pico: &mut Pico, us: u64) {
    wait(pico, us);
    let began = pico.now();
    let said: Vec<SentLine> = [
        (100, "srate 50"),
        (5, "l xyza 10000 100000"),
        (5, "g xyza 2 1"),
        (5, "v xyza 9000 -1234 450 -37"),
        (1200, "v xyz -300 3000 10"),
        (300, "a xyza 0 0 0 0"),
    ]
    .into_iter()
    .map(|(ms, line)| {
        pico.run_ms(ms);
        pico.say(line)
    })
    .collect();
    pico.run_ms(2500);
    let wrap = us * 125;
    assert!(began < wrap && said[3].tick < wrap - 50_000_000 && said[4].tick > wrap, "{said:?}");
    let (late, _) = follow(pico, &said[1..]).unwrap_or_else(|why| panic!("across {us} us: {why}"));
    assert!(late[0].len() > 5000 && late.iter().flatten().all(|late| *late == 0));
    let statuses = pico.statuses();
    assert!(statuses.len() > 60, "{}", statuses.len());
    for pair in statuses.windows(2) {
        let apart = pair[1].usec.wrapping_sub(pair[0].usec);
        assert!((47_000..53_000).contains(&apart), "across {us} us: {pair:?}");
    }
    // Negative from 2^31 on; small again from 2^32 on.
    let signs: Vec<_> = statuses.iter().map(|status| status.usec < 0).collect();
    let first = us == 1 << 32;
    assert!(signs[0] == first && signs[signs.len() - 1] != first, "{signs:?}");
    assert_eq!(signs.windows(2).filter(|pair| pair[0] != pair[1]).count(), 1);
    // Else it goes on looking after the motors, which is slow. After verbs text begins anew, with all axes at 0.
    for line in ["enable 0", "halt", "enable 0"] {
        pico.say(line);
        pico.run_ms(1000);
    }
    assert!(pico.lines.iter().any(|line| line.text == "awake"));
}

/// Two minutes: an hour and a quarter of the board's time.
mod long {
    use super::*;

    #[test]
    fn statuses_go_on_when_their_microseconds_wrap() {
        let mut pico = Pico::new();
        across(&mut pico, 1 << 31);
        across(&mut pico, 1 << 32);
    }
}
