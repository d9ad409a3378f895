//! A value and the hash of what it prints. Most of the real code has no `Hash`, but all of it has `Debug`: no field is forgotten.

use std::fmt::{self, Write};
use std::hash::{DefaultHasher, Hasher};
use std::ops::Deref;
use std::sync::Arc;

/// What prints all that matters for what comes.
pub(crate) trait Print {
    fn print(&self, out: &mut impl Write) -> fmt::Result;
}

/// Shared by all states in which it is the same. Printing takes longer than all else, so it is done once for each change.
#[derive(Clone, Debug)]
pub(crate) struct Printed<T> {
    value: Arc<T>,
    hash: u64,
}

impl<T: Print + Clone> Printed<T> {
    pub(crate) fn new(value: T) -> Printed<T> {
        let hash = hash_of(&value);
        Printed { value: Arc::new(value), hash }
    }

    pub(crate) fn change<R>(&mut self, change: impl FnOnce(&mut T) -> R) -> R {
        let value = Arc::make_mut(&mut self.value);
        let result = change(value);
        self.hash = hash_of(value);
        result
    }

    pub(crate) const fn hash(&self) -> u64 {
        self.hash
    }
}

impl<T> Deref for Printed<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

fn hash_of(value: &impl Print) -> u64 {
    // In one piece: a hasher takes hundreds of short ones at four times the cost.
    let mut text = String::with_capacity(4096);
    value.print(&mut text).expect("a string takes everything");
    let mut hasher = DefaultHasher::new();
    hasher.write(text.as_bytes());
    hasher.finish()
}
