//! How the columns of CSV files were read: `plan` prints it, so that a wrong column is seen.

use std::fmt;

/// How the columns of a CSV file were read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TableColumns {
    /// As the motion file calls it.
    pub file: String,
    /// Time first.
    pub columns: Vec<ColumnUse>,
    /// The columns that are not used.
    pub unused: Vec<String>,
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
        }
    }
}
