//! The host's side of an Uno's bootloader, with a model bootloader that can do things wrong. `uno_bootloader.rs` has real ones.

use pulsetrain_board::stk500::{Bootloader, FlashError, Progress, RATES, room};
use pulsetrain_board::{Port, PortError};
use pulsetrain_core::wire::Baud;
use std::time::Duration;

/// Answers as Optiboot does, after so many questions that it does not hear.
#[derive(Debug)]
struct Model {
    now: Duration,
    deaf: u32,
    signature: [u8; 3],
    flash: Vec<u8>,
    address: usize,
    said: Vec<u8>,
    /// A byte of flash that reads otherwise than it was written.
    broken: Option<usize>,
    /// Silent from this address on.
    dies_at: usize,
    /// A command that is heard, and gets no answer.
    mute: Option<u8>,
    started: bool,
}

impl Model {
    fn new() -> Model {
        Model {
            now: Duration::from_secs(3),
            deaf: 0,
            signature: [0x1e, 0x95, 0x0f],
            flash: vec![0x55; 32 * 1024],
            address: 0,
            said: b"awake\n".to_vec(),
            broken: None,
            dies_at: usize::MAX,
            mute: None,
            started: false,
        }
    }

    fn answer(&mut self, command: &[u8]) {
        let (last, command) = command.split_last().expect("it is not empty");
        assert_eq!(*last, 0x20, "every command ends so");
        let mut answer = Vec::new();
        match command {
            [0x30] if self.deaf > 0 => {
                self.deaf -= 1;
                return;
            }
            [0x30 | 0x50] => {}
            [0x51] => self.started = true,
            [0x75] => answer.extend(self.signature),
            [0x55, low, high] => self.address = 2 * usize::from(u16::from_le_bytes([*low, *high])),
            [0x64, 0, 128, b'F', page @ ..] => {
                if self.address >= self.dies_at {
                    return;
                }
                assert_eq!(page.len(), 128);
                self.flash[self.address..self.address + 128].copy_from_slice(page);
            }
            [0x74, 0, 128, b'F'] => {
                answer.extend(&self.flash[self.address..self.address + 128]);
                if let Some(broken) = self.broken.filter(|broken| broken / 128 == self.address / 128) {
                    answer[broken % 128] ^= 0x10;
                }
            }
            other => panic!("{other:x?} is no command"),
        }
        if self.mute == Some(command[0]) {
            return;
        }
        self.said.push(0x14);
        self.said.extend(answer);
        self.said.push(0x10);
    }
}

impl Port for &mut Model {
    fn now(&self) -> Duration {
        self.now
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        self.answer(bytes);
        Ok(())
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        // A byte at a time, as a slow line brings them.
        if self.said.is_empty() {
            self.now = until;
        } else {
            self.now += Duration::from_micros(87);
            into.push(self.said.remove(0));
        }
        Ok(())
    }

    fn set_baud(&mut self, _: Baud) -> Result<(), PortError> {
        Ok(())
    }
}

fn program(model: &mut Model, image: &[u8]) -> Result<Vec<Progress>, FlashError> {
    let mut steps = Vec::new();
    Bootloader::find(model, RATES[0])?.program(image, |step| steps.push(step))?;
    Ok(steps)
}

fn image(bytes: usize) -> Vec<u8> {
    (0..bytes).map(|at| (at * 7 + at / 256) as u8).collect()
}

#[test]
fn a_program_is_written_and_read_back_and_started() {
    for deaf in 0..4 {
        let mut model = Model { deaf, ..Model::new() };
        let image = image(1000);
        let steps = program(&mut model, &image).expect("nothing is wrong");
        assert_eq!(steps.len(), 16);
        assert_eq!((steps[7], steps[15]), (Progress::Written(1000), Progress::Verified(1000)));
        assert_eq!(model.flash[..1000], image);
        assert!(model.flash[1000..1024].iter().all(|byte| *byte == 0xff), "the rest of the last page");
        assert!(model.flash[1024..].iter().all(|byte| *byte == 0x55), "no other page");
        assert!(model.started);
    }
}

#[test]
fn what_goes_wrong_is_said_with_its_address() {
    let mut model = Model { deaf: u32::MAX, ..Model::new() };
    assert_eq!(program(&mut model, &image(10)), Err(FlashError::NoBootloader { rate: 115_200 }));

    let mut model = Model { signature: [0x1e, 0x98, 0x01], ..Model::new() };
    let error = program(&mut model, &image(10)).unwrap_err();
    assert_eq!(error, FlashError::OtherChip { signature: [0x1e, 0x98, 0x01] });
    assert!(error.to_string().contains("1e 98 01"), "{error}");

    let mut model = Model { dies_at: 256, ..Model::new() };
    assert_eq!(program(&mut model, &image(1000)), Err(FlashError::LostSync { address: 256, doing: "writing" }));
    assert!(!model.started);

    let mut model = Model { broken: Some(300), ..Model::new() };
    let written = image(1000)[300];
    let mismatch = FlashError::Mismatch { address: 300, written, read: written ^ 0x10 };
    assert_eq!(program(&mut model, &image(1000)), Err(mismatch));
    assert!(!model.started, "it is not started");

    // In what is left of the last page nothing was asked for.
    let mut model = Model { broken: Some(1010), ..Model::new() };
    assert!(program(&mut model, &image(1000)).is_ok());
}

#[test]
fn no_answer_at_either_end_is_no_half_program() {
    let mut model = Model { mute: Some(0x50), ..Model::new() };
    assert_eq!(program(&mut model, &image(1000)), Err(FlashError::NotBegun));
    assert!(model.flash.iter().all(|byte| *byte == 0x55), "nothing was written");

    // The chip is reset as it answers: all was read back before.
    let mut model = Model { mute: Some(0x51), ..Model::new() };
    assert!(program(&mut model, &image(1000)).is_ok());
    assert!(model.started && model.flash[..1000] == image(1000));
}

#[test]
fn what_does_not_fit_is_not_begun() {
    let mut model = Model::new();
    assert_eq!(program(&mut model, &[]), Err(FlashError::Empty));
    let bytes = room(115_200) + 1;
    let error = program(&mut model, &image(bytes)).unwrap_err();
    assert_eq!(error, FlashError::TooLarge { bytes, limit: 32_256, rate: 115_200 });
    assert!(model.flash.iter().all(|byte| *byte == 0x55));
    assert!(program(&mut model, &image(bytes - 1)).is_ok());

    let old = Bootloader::find(&mut model, RATES[1]).expect("it is there");
    let error = old.program(&image(30_721), |_| {}).unwrap_err();
    assert_eq!(error, FlashError::TooLarge { bytes: 30_721, limit: 30_720, rate: 57_600 });
}
