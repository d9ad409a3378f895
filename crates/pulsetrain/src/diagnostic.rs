//! Library errors as the command line prints them: with the advice that belongs to them.

use std::error::Error;
use std::fmt;

use miette::{Diagnostic, Report};
use pulsetrain_session::drive::DriveError;
use pulsetrain_session::prepare::Refusal;

/// A library error that may know what to do about it.
pub trait Advice: Error + Send + Sync + 'static {
    /// What to do, where that is known.
    fn advice(&self) -> Option<&str>;
}

impl Advice for Refusal {
    fn advice(&self) -> Option<&str> {
        Refusal::advice(self)
    }
}

impl Advice for DriveError {
    fn advice(&self) -> Option<&str> {
        DriveError::advice(self)
    }
}

/// An error with its advice as the help below it.
pub fn advised(error: impl Advice) -> Report {
    Report::new(Advised(error))
}

#[derive(Debug)]
struct Advised<E>(E);

impl<E: fmt::Display> fmt::Display for Advised<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl<E: Error> Error for Advised<E> {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        self.0.source()
    }
}

impl<E: Advice> Diagnostic for Advised<E> {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        self.0.advice().map(|advice| Box::new(advice) as Box<dyn fmt::Display>)
    }
}
