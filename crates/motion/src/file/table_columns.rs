//! How the columns of CSV files were read: `plan` prints it, so that a wrong column is seen.

use std::fmt;

use crate::Time;
use crate::human;

/// How the columns of a CSV file were read.
#[derive(Clone, Debug, PartialEq)]
pub struct TableColumns {
    /// As the motion file calls it.
    pub file: String,
    /// Time first.
    pub columns: Vec<ColumnUse>,
    /// The columns that are not used.
    pub unused: Vec<String>,
    /// Rows that were left out, since they have no position.
    pub rows_left_out: usize,
    /// Rows that have the time of the row before: their mean is taken.
    pub rows_averaged: usize,
    /// After how much the positions start again, if the motion file says so.
    pub wraps: Option<Wraps>,
    /// How it was smoothed, if it was.
    pub smoothing: Option<Smoothing>,
}

/// Positions that start again, as those of a magnetic encoder do after each turn.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wraps {
    /// After how much, as the motion file writes it.
    pub after: String,
    /// How often they did.
    pub times: usize,
}

/// How a recording was smoothed, and how far the motion is from it.
#[derive(Clone, Debug, PartialEq)]
pub struct Smoothing {
    /// The smoothing time of the motion file.
    pub over: Time,
    /// The frequency at which the gain is −3 dB, Hz.
    pub cut_off_hz: f64,
    /// Of each column of positions.
    pub distances: Vec<ColumnDistance>,
}

/// How far a motion is from the rows of a column.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnDistance {
    /// As in [`ColumnUse::what`].
    pub what: String,
    /// The largest, in the column's unit.
    pub largest: f64,
    /// When that is, s from the first row on.
    pub at_s: f64,
    /// The root of the mean square, in the column's unit.
    pub rms: f64,
    /// As motion files write it.
    pub unit: String,
}

/// `at most 0.81 deg at 1.2 s, RMS 0.12 deg`
impl fmt::Display for ColumnDistance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ColumnDistance { largest, at_s, rms, unit, .. } = self;
        let [largest, rms] = [largest, rms].map(|distance| human::significant(*distance, 3));
        write!(f, "at most {largest} {unit} at {}, RMS {rms} {unit}", human::seconds_to(*at_s, 4))
    }
}

/// `smoothed over 50 ms (−3 dB at 10 Hz); from the recording at most 0.81 deg at 1.2 s, RMS 0.12 deg`
impl fmt::Display for Smoothing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let cut_off = human::scaled(self.cut_off_hz, "Hz");
        write!(f, "smoothed over {} (−3 dB at {cut_off}); from the recording ", human::seconds(self.over.seconds()))?;
        for (k, distance) in self.distances.iter().enumerate() {
            let what = if self.distances.len() > 1 { format!("{} ", distance.what) } else { String::new() };
            write!(f, "{}{what}{distance}", if k > 0 { "; " } else { "" })?;
        }
        Ok(())
    }
}

/// How one column was read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColumnUse {
    /// "time", "angle", "position", "x".
    pub what: String,
    /// "column 2 `t`"
    pub column: String,
    /// As motion files write it.
    pub unit: String,
}

/// `path.csv: time = column 2 `t`, s; angle = column 3 `a`, deg; column 1 `i` is not used`
impl fmt::Display for TableColumns {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: ", self.file)?;
        for (k, ColumnUse { what, column, unit }) in self.columns.iter().enumerate() {
            let comma = if k > 0 { "; " } else { "" };
            write!(f, "{comma}{what} = {column}, {unit}")?;
        }
        match self.unused.as_slice() {
            [] => Ok(()),
            [one] => write!(f, "; {one} is not used"),
            several => write!(f, "; {} are not used", several.join(", ")),
        }?;
        match self.rows_left_out {
            0 => Ok(()),
            1 => write!(f, "; 1 row without a position is left out"),
            several => write!(f, "; {several} rows without a position are left out"),
        }?;
        match self.rows_averaged {
            0 => Ok(()),
            1 => write!(f, "; 1 row has the time of the row before: their mean is taken"),
            several => write!(f, "; {several} rows have the time of the row before: their mean is taken"),
        }?;
        if let Some(Wraps { after, times }) = &self.wraps {
            match times {
                1 => write!(f, "; starts again after {after}, once"),
                times => write!(f, "; starts again after {after}, {times} times"),
            }?;
        }
        self.smoothing.as_ref().map_or(Ok(()), |smoothing| write!(f, "; {smoothing}"))
    }
}
