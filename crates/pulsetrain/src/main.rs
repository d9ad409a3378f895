//! The command line: see `pulsetrain --help`.

use std::io::{IsTerminal, stderr, stdout};
use std::process::ExitCode;

use pulsetrain::{cli, console::Console};

fn main() -> ExitCode {
    let err_is_terminal = stderr().is_terminal();
    let (mut out, mut err) = (stdout(), stderr());
    let mut console = Console { says_progress: true, ..Console::new(&mut out, &mut err, err_is_terminal) };
    cli::run_process(&mut console).into()
}
