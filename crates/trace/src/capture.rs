//! Any file that can be judged: what it is shows in its content.

use crate::camera::{self, Track};
use crate::steps::{self, StepTrace};
use crate::table::Table;
use crate::{ReadError, Trace, saleae, vcd_file};

/// A capture.
#[derive(Clone, Debug, PartialEq)]
pub enum Capture {
    /// Edges: VCD, Saleae CSV.
    Edges(Trace),
    /// steps.csv.
    Steps(StepTrace),
    /// A camera's track.
    Film(Track),
}

/// Reads a capture of any kind.
///
/// # Errors
/// What the reader of that kind says; a file that begins like none of them is taken for a camera's track.
pub fn read(bytes: &[u8]) -> Result<Capture, ReadError> {
    if bytes.trim_ascii_start().starts_with(b"$") {
        return vcd_file::read(bytes).map(Capture::Edges);
    }
    match Table::new(bytes).next()? {
        // A camera's `Time [s]` may begin a file as well.
        Some(header) if saleae::is_time_column(header.get(0)) && !camera::has_angle(&header) => {
            saleae::read(bytes).map(Capture::Edges)
        }
        Some(header) if header.get(0).eq_ignore_ascii_case(b"motor") => steps::read(bytes).map(Capture::Steps),
        _ => camera::read(bytes).map(Capture::Film),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_content_tells_the_kind() {
        let check = |file: &str, expected: &str| {
            let kind = match read(file.as_bytes()) {
                Ok(Capture::Edges(_)) => "edges".to_owned(),
                Ok(Capture::Steps(_)) => "steps".to_owned(),
                Ok(Capture::Film(_)) => "film".to_owned(),
                Err(error) => error.to_string(),
            };
            assert_eq!(kind, expected, "{file}");
        };
        check("\n$timescale 1 ns $end $enddefinitions $end\n", "edges");
        check("Time [s],Channel 0\n0,1\n", "edges");
        check("# pulsetrain steps, tick_hz = 5\nmotor,tick,dir,position\n", "steps");
        check("Time [s],theta [deg]\n0,1\n", "film");
        check("t,angle [rev]\n0,1\n", "film");
        check("Time [s],Channel 0\n0,7\n", "line 2, column 3: expected a level 0, 1 or X, found `7`");
        check("hello\n", "line 1, column 1: expected a column `time [s]`, found `hello`");
    }
}
