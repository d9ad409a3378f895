//! `pulsetrain flash`: to a Pico's drive (a folder), and to an Uno's real bootloader at a pseudo-terminal.

use std::fs;
use std::io::Read;
use std::thread::JoinHandle;

use pulsetrain::cli;
use pulsetrain::console::Exit;
use pulsetrain_board::virtual_pico;
use pulsetrain_testkit::folder::Folder;

/// The drive of a board with a given name.
fn drive(name: &str, board: &str) -> Folder {
    let folder = Folder::new(name);
    let info = format!("UF2 Bootloader v3.0\r\nModel: Raspberry Pi RP2\r\nBoard-ID: {board}\r\n");
    fs::write(folder.0.join(INFO), info).unwrap();
    folder
}

/// The file by which a Pico's drive is recognised.
const INFO: &str = "INFO_UF2.TXT";

/// The chip behind a drive: it starts the image as soon as it is complete, and its drive disappears.
fn chip(drive: &Folder, image: &'static [u8]) -> JoinHandle<()> {
    let (file, info) = (drive.path("pulsetrain.uf2"), drive.path(INFO));
    std::thread::spawn(move || {
        while !fs::read(&file).is_ok_and(|read| read == image) {
            std::thread::yield_now();
        }
        fs::remove_file(info).unwrap();
    })
}

fn pulsetrain(args: &[&str]) -> (Exit, String, String) {
    let (mut out, mut err) = (Vec::new(), Vec::new());
    let exit = cli::run(std::iter::once("pulsetrain").chain(args.iter().copied()), &mut out, &mut err);
    // Long lines of an error are broken.
    let words = |bytes: Vec<u8>| {
        String::from_utf8(bytes).unwrap().replace('│', " ").split_whitespace().collect::<Vec<_>>().join(" ")
    };
    (exit, words(out), words(err))
}

#[test]
fn a_pico_gets_the_image_by_copying() {
    let drive = drive("copy", "RPI-RP2");
    let began = chip(&drive, virtual_pico::IMAGE);
    let (exit, out, err) = pulsetrain(&["flash", "pico", "--port", &drive.name()]);
    began.join().unwrap();
    assert_eq!((exit, err.as_str()), (Exit::Success, ""));
    assert!(out.contains("the Pico took them and has restarted") && !out.contains("read back"), "{out}");
    assert_eq!(fs::read(drive.path("pulsetrain.uf2")).unwrap(), virtual_pico::IMAGE);

    fs::remove_file(drive.path("pulsetrain.uf2")).unwrap();
    fs::write(drive.path(INFO), "Board-ID: RPI-RP2\n").unwrap();
    let began = chip(&drive, virtual_pico::IMAGE);
    let (exit, out, _) = pulsetrain(&["flash", "pico", "--json", "--port", &drive.name()]);
    began.join().unwrap();
    let json: serde_json::Value = serde_json::from_str(&out).unwrap();
    crate::json::conforms("flash", &json);
    assert_eq!((exit, json["bytes"].as_u64()), (Exit::Success, Some(virtual_pico::IMAGE.len() as u64)));
    assert_eq!(json["verified"], false, "nothing was read back");
}

/// A computer that keeps the written file to itself, so that the chip sees nothing.
#[test]
fn a_drive_that_stays_has_not_taken_it() {
    let drive = drive("stays", "RPI-RP2");
    let (exit, out, err) = pulsetrain(&["flash", "pico", "--port", &drive.name()]);
    assert_eq!((exit, out.as_str()), (Exit::Refused, ""));
    assert!(err.contains("is still there") && err.contains("did not take it"), "{err}");
}

/// The chip starts before the file is closed: writing the last piece then fails, as on most computers.
#[cfg(target_os = "linux")]
#[test]
fn a_drive_that_goes_while_it_is_written_is_no_error() {
    let drive = drive("goes", "RPI-RP2");
    // A pipe cannot be synchronised: EINVAL, after all bytes were written.
    let pipe = drive.path("pulsetrain.uf2");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let info = drive.path(INFO);
    let chip = std::thread::spawn(move || {
        let (mut file, mut bytes) = (fs::File::open(pipe).unwrap(), vec![0; virtual_pico::IMAGE.len()]);
        file.read_exact(&mut bytes).unwrap();
        fs::remove_file(info).unwrap();
        bytes
    });
    let (exit, out, err) = pulsetrain(&["flash", "pico", "--port", &drive.name()]);
    assert_eq!((exit, err.as_str()), (Exit::Success, ""), "{out}");
    assert_eq!(chip.join().unwrap(), virtual_pico::IMAGE);
}

#[test]
fn a_folder_that_is_no_picos_drive_is_left_alone() {
    let plain = Folder::new("plain");
    for (folder, why) in [(plain.name(), "there is no INFO_UF2.TXT in it"), (plain.path("none"), "is no folder")] {
        let (exit, _, err) = pulsetrain(&["flash", "pico", "--port", &folder]);
        assert_eq!(exit, Exit::Refused);
        assert!(err.contains(why) && err.contains("BOOTSEL"), "{err}");
    }
    assert_eq!(fs::read_dir(&plain.0).unwrap().count(), 0);

    let other = drive("pico2", "RP2350");
    let (exit, _, err) = pulsetrain(&["flash", "pico", "--port", &other.name()]);
    assert_eq!(exit, Exit::Refused);
    assert!(err.contains("\"RP2350\""), "{err}");
    assert_eq!(fs::read_dir(&other.0).unwrap().count(), 1, "nothing was written");
}

#[test]
fn an_image_of_another_kind_is_refused() {
    let drive = drive("image", "RPI-RP2");
    fs::write(drive.path("image.uf2"), b"no UF2").unwrap();
    let (exit, _, err) = pulsetrain(&["flash", "pico", "--port", &drive.name(), "--image", &drive.path("image.uf2")]);
    assert_eq!(exit, Exit::Refused);
    assert!(err.contains("whole number of UF2 blocks"), "{err}");
    fs::write(drive.path("image.hex"), b":no hex").unwrap();
    let (exit, _, err) = pulsetrain(&["flash", "uno", "--port", "/none", "--image", &drive.path("image.hex")]);
    assert_eq!(exit, Exit::Refused);
    assert!(err.contains("image.hex") && err.contains("Intel HEX"), "{err}");
}

/// The image is checked first, whatever is at the port.
#[test]
fn what_is_no_image_is_answered_with_what_is() {
    for port in [&[][..], &["--port", "/none"]] {
        let args = |image| [&["flash", "uno", "--image", image], port].concat();
        let (exit, _, err) = pulsetrain(&args("wnch"));
        let said = err.replace('│', " ").split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!(exit, Exit::Refused);
        assert!(said.contains("cannot read wnch") && said.contains("did you mean `winch`?"), "{said}");
        for known in ["`uno`", "`winch`", "`verbs`", ".hex file that `pulsetrain bake` wrote"] {
            assert!(said.contains(known), "{said}");
        }
        let (_, _, err) = pulsetrain(&args("winch"));
        assert!(!err.contains("cannot read") && err.contains("port"), "{err}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_told() {
    let drive = drive("full", "RPI-RP2");
    std::os::unix::fs::symlink("/dev/full", drive.path("pulsetrain.uf2")).unwrap();
    let (exit, _, err) = pulsetrain(&["flash", "pico", "--port", &drive.name()]);
    assert_eq!(exit, Exit::Refused);
    assert!(err.contains("cannot write") && err.contains("the disk is full"), "{err}");
}

#[test]
fn an_uno_needs_a_port_that_is_there() {
    let (exit, _, err) = pulsetrain(&["flash", "uno"]);
    assert_eq!(exit, Exit::Refused);
    assert!(err.contains("--port"), "{err}");
    let (exit, _, err) = pulsetrain(&["flash", "uno", "--port", "/dev/pulsetrain-none"]);
    assert_eq!(exit, Exit::Refused);
    assert!(err.contains("there is no port /dev/pulsetrain-none"), "{err}");
}

/// The ports depend on the computer. The tests beside the command check what is made of them.
#[test]
fn ports_are_listed() {
    let (exit, out, _) = pulsetrain(&["ports", "--json"]);
    assert_eq!(exit, Exit::Success);
    let json: serde_json::Value = serde_json::from_str(&out).unwrap();
    crate::json::conforms("ports", &json);
    let names: Vec<&str> = json.as_array().unwrap().iter().map(|found| found["port"].as_str().unwrap()).collect();
    let (exit, out, _) = pulsetrain(&["ports"]);
    assert_eq!(exit, Exit::Success);
    assert_eq!(out.contains("no serial port was found"), names.is_empty(), "{out}");
    assert!(names.iter().all(|name| out.contains(name)), "{names:?}: {out}");
}

/// Optiboot on the virtual Uno, in real time. Each try may take as long as it likes, and there are several, since a
/// busy computer may miss the bootloader's second.
#[cfg(target_os = "linux")]
mod chips {
    use super::pulsetrain;
    use pulsetrain::console::Exit;
    use pulsetrain_testkit::folder::Folder;
    use std::io::{BufRead, BufReader};
    use std::process::{Child, Command, Stdio};

    /// The image that `cargo xtask test` builds from Debian's source.
    fn optiboot() -> String {
        std::env::var("PULSETRAIN_OPTIBOOT").expect("run `cargo xtask test`: it builds Optiboot, and says where")
    }

    const IMAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../board/images/uno.hex");
    const TRIES: usize = 3;

    /// `pulsetrain board uno`, which ends when this is dropped.
    struct Served(Child);

    impl Served {
        fn new(link: &str, options: &[&str]) -> Served {
            let mut board = Command::new(env!("CARGO_BIN_EXE_pulsetrain"));
            let mut board =
                board.args(["board", "uno", "--pty", link]).args(options).stdout(Stdio::piped()).spawn().unwrap();
            let mut line = String::new();
            BufReader::new(board.stdout.take().unwrap()).read_line(&mut line).unwrap();
            assert!(line.starts_with("a virtual Uno is at"), "{line}");
            Served(board)
        }
    }

    impl Drop for Served {
        fn drop(&mut self) {
            let _ = self.0.kill();
            let _ = self.0.wait();
        }
    }

    /// Whether something works within several tries.
    fn tried(mut once: impl FnMut() -> Result<(), String>) {
        let mut errors = Vec::new();
        for _ in 0..TRIES {
            match once() {
                Ok(()) => return,
                Err(error) => errors.push(error),
            }
        }
        panic!("{}", errors.join("\n"));
    }

    fn says(args: &[&str], part: &str) -> Result<(), String> {
        let (exit, out, err) = pulsetrain(args);
        if exit == Exit::Success && out.contains(part) { Ok(()) } else { Err(format!("{args:?}: {out}\n{err}")) }
    }

    #[test]
    fn flash_writes_the_firmware_and_info_finds_it() {
        let folder = Folder::new("optiboot");
        let link = folder.path("uno");
        let _board = Served::new(&link, &["--bootloader", &optiboot()]);
        tried(|| says(&["flash", "uno", "--port", &link], "were read back"));
        tried(|| says(&["info", "--port", &link], "board Arduino Uno"));
    }

    #[test]
    fn avrdude_writes_the_firmware_and_info_finds_it() {
        let folder = Folder::new("avrdude");
        let link = folder.path("uno");
        let _board = Served::new(&link, &["--bootloader", &optiboot()]);
        tried(|| {
            let memory = format!("flash:w:{IMAGE}:i");
            let words = ["-c", "arduino", "-p", "m328p", "-b", "115200", "-P", &link, "-D", "-U", &memory];
            let run = Command::new("avrdude").args(words).output().expect("avrdude is installed");
            let text = String::from_utf8_lossy(&run.stderr).into_owned();
            if run.status.success() && text.contains("bytes of flash verified") { Ok(()) } else { Err(text) }
        });
        tried(|| says(&["info", "--port", &link], "board Arduino Uno"));
    }

    /// A program of so many bytes, as Intel HEX.
    fn program(bytes: u16) -> String {
        let row = |at: u16| {
            let fields = [16, at.to_be_bytes()[0], at.to_be_bytes()[1], 0];
            let sum = fields.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte));
            format!(":10{at:04X}00{}{:02X}\n", "00".repeat(16), sum.wrapping_neg())
        };
        (0..bytes).step_by(16).map(row).chain([":00000001FF\n".to_owned()]).collect()
    }

    /// The older bootloader with its own rate: the firmware fits. An image that is too large for it is refused, with advice.
    #[test]
    fn flash_falls_back_to_the_older_bootloaders_rate() {
        const OLD: &str = "/usr/share/arduino/hardware/arduino/avr/bootloaders/atmega/ATmegaBOOT_168_atmega328.hex";
        let folder = Folder::new("old");
        let link = folder.path("uno");
        let _board = Served::new(&link, &["--bootloader", OLD]);
        let motion = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/tutorial.toml");
        let image = folder.path("small.hex");
        assert_eq!(pulsetrain(&["bake", motion, "--output", &image]).0, Exit::Success);
        tried(|| says(&["flash", "uno", "--json", "--port", &link, "--image", &image], "\"baud\": 57600"));
        tried(|| says(&["flash", "uno", "--json", "--port", &link], "\"baud\": 57600"));
        std::fs::write(&image, program(30_736)).unwrap();
        tried(|| {
            let (exit, _, err) = pulsetrain(&["flash", "uno", "--port", &link, "--image", &image]);
            let told = err.contains("of 57600 baud there is room for 30720") && err.contains("burn Optiboot");
            if exit == Exit::Refused && told { Ok(()) } else { Err(err) }
        });
    }

    /// If an Uno's image cannot do a command, the error names the image that can. Settings stay with every image.
    #[test]
    fn a_command_that_needs_another_image_says_how_it_gets_there() {
        let folder = Folder::new("image");
        let motion = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/tutorial.toml");
        let script = folder.path("script.txt");
        std::fs::write(&script, "0 s: move x 1\n").unwrap();
        let winch = folder.path("winch.txt");
        std::fs::write(&winch, "0.1 s: a x 1\n").unwrap();
        let [run, bench] = [&["run", motion, "--no-rehearsal"][..], &["bench", "--disconnected"]];
        let [verbs, text] = [&["verbs", &script][..], &["winch", &winch]];
        for (image, refused, wanted) in [
            ("winch", &[run, bench, verbs][..], ["", "", " --image verbs"]),
            ("verbs", &[run, text], ["", " --image winch", ""]),
            ("uno", &[verbs, text], [" --image verbs", " --image winch", ""]),
        ] {
            let link = folder.path(image);
            let options = if image == "uno" { vec![] } else { vec!["--image", image] };
            let _board = Served::new(&link, &options);
            for (command, wanted) in refused.iter().zip(wanted) {
                let args = [command, &["--port", &link][..]].concat();
                tried(|| {
                    let (exit, _, err) = pulsetrain(&args);
                    let told = err.contains(&format!("the board has the image `{image}`"))
                        && err.contains(&format!("`pulsetrain flash uno --port PORT{wanted}`"));
                    if exit == Exit::Refused && told { Ok(()) } else { Err(format!("{args:?}: {exit:?} {err}")) }
                });
            }
            tried(|| says(&["store", "--silence", "700 ms", "--port", &link], "a host is lost after 700 ms"));
        }
    }

    #[test]
    fn without_a_bootloader_it_is_said_and_nothing_is_written() {
        let folder = Folder::new("without");
        let link = folder.path("uno");
        let _board = Served::new(&link, &[]);
        let (exit, _, err) = pulsetrain(&["flash", "uno", "--port", &link]);
        assert_eq!(exit, Exit::Refused);
        assert!(
            err.contains("no Uno's bootloader answers") && err.contains("neither at 115200 nor at 57600 baud"),
            "{err}"
        );
        tried(|| says(&["info", "--port", &link], "board Arduino Uno"));
    }
}
