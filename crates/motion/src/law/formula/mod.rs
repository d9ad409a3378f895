//! θ(t) in text.

use super::{Bounds, Double, Jet, LawError, Piece};
use crate::Time;

/// Nothing of its kind can be made yet.
#[derive(Clone, Copy, Debug)]
pub enum Formula {}

/// Nothing of its kind can be made yet.
#[derive(Clone, Copy, Debug)]
pub enum Window {}

impl Formula {
    pub(super) fn pieces(&self) -> std::iter::Empty<Result<Piece, LawError>> {
        match *self {}
    }
    pub(super) fn duration(&self) -> Option<Time> {
        match *self {}
    }
}

impl Window {
    pub(super) fn value(&self, _: f64) -> f64 {
        match *self {}
    }
    pub(super) fn jet(&self, _: f64) -> Jet {
        match *self {}
    }
    pub(super) fn bounds_and_majorant(&self) -> (Bounds, Jet) {
        match *self {}
    }
    pub(super) fn raise(&mut self, _: f64) {
        match *self {}
    }
    pub(super) fn scale(&mut self, _: f64) {
        match *self {}
    }
    pub(super) fn rezero(&mut self, _: Double) {
        match *self {}
    }
}
