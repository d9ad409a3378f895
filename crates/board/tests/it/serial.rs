//! A serial port as the system gives it: errors on opening, and a pseudo-terminal as a line.
#![cfg(all(unix, feature = "serial"))]

use pulsetrain_board::{Port, PortError, Serial};
use pulsetrain_core::wire::Baud;
use serialport::{SerialPort, TTYPort};
use std::io::{Read, Write};
use std::time::Duration;

/// Far longer than anything here takes: time passes only if something is broken.
const PATIENCE: Duration = Duration::from_secs(60);

fn line() -> (TTYPort, String) {
    let (mut master, slave) = TTYPort::pair().expect("a pseudo-terminal");
    let name = slave.name().expect("a name");
    master.set_timeout(PATIENCE).expect("a time-out");
    (master, name)
}

#[test]
fn bytes_go_both_ways() {
    let (mut master, name) = line();
    let mut port = Serial::open(&name, true).unwrap();
    port.send(&[1, 2, 0, 255]).unwrap();
    let mut out = [9; 4];
    master.read_exact(&mut out).unwrap();
    assert_eq!(out, [1, 2, 0, 255]);

    let sent: Vec<u8> = (0..=255).collect();
    master.write_all(&sent).unwrap();
    let mut came = Vec::new();
    while came.len() < sent.len() {
        let until = port.now() + PATIENCE;
        port.receive(until, &mut came).unwrap();
        assert!(port.now() < until, "{} bytes came", came.len());
    }
    assert_eq!(came, sent);

    for baud in Baud::ALL {
        port.set_baud(baud).unwrap();
    }
    let now = port.now();
    port.receive(now, &mut came).unwrap();
    assert_eq!(came.len(), sent.len());
}

#[test]
fn a_port_in_use_says_so() {
    let (_master, name) = line();
    let _first = Serial::open(&name, false).unwrap();
    let refused = Serial::open(&name, false).unwrap_err();
    assert_eq!(refused, PortError::Busy { name: name.clone() });
    let said = format!("{name} is in use: close the program that has it open (an IDE's serial monitor, say)");
    assert_eq!(refused.to_string(), said);
}

#[test]
fn a_port_that_is_not_there_says_which_are() {
    let refused = Serial::open("/dev/ttyNOT-THERE", false).unwrap_err();
    assert!(matches!(&refused, PortError::NotThere { name, .. } if name == "/dev/ttyNOT-THERE"), "{refused:?}");
    let error = PortError::NotThere { name: "COM9".into(), there_are: vec!["COM1".into(), "COM3".into()] };
    assert_eq!(error.to_string(), "there is no port COM9; there are COM1, COM3");
    let error = PortError::NotThere { name: "COM9".into(), there_are: vec![] };
    assert_eq!(error.to_string(), "there is no port COM9; no serial port was found: is the board plugged in?");
}

#[test]
fn a_port_that_is_pulled_out_is_gone() {
    let (master, name) = line();
    let mut port = Serial::open(&name, false).unwrap();
    drop(master);
    let mut came = Vec::new();
    let until = port.now() + PATIENCE;
    let gone = loop {
        assert!(port.now() < until, "nobody noticed");
        if let Err(gone) = port.receive(until, &mut came) {
            break gone;
        }
    };
    assert!(matches!(&gone, PortError::Gone { name: whose, .. } if *whose == name), "{gone:?}");
}
