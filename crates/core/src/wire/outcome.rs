//! How what a frame asks for went, and why motors stopped: codes, and what comes with them.

macro_rules! codes {
    ($(#[$outer:meta])* $name:ident { $($(#[$inner:meta])* $variant:ident = $code:literal,)* }) => {
        $(#[$outer])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum $name { $($(#[$inner])* $variant = $code,)* }

        impl $name {
            /// All of them.
            pub const ALL: &'static [$name] = &[$($name::$variant),*];

            /// What `code` stands for.
            #[must_use]
            pub const fn from_code(code: u8) -> Option<$name> {
                match code {
                    $($code => Some($name::$variant),)*
                    _ => None,
                }
            }
        }
    };
}

codes! {
    /// Why a board refuses what a correct frame asks. `detail` is the number that comes with it, 0 where there is none.
    Reason {
        /// No such kind, or not for a board: `detail` is the kind.
        UnknownKind = 1,
        /// The body is not as long as its kind says, or a field is out of its range; `detail` is the kind.
        Malformed = 2,
        /// Another host has the board, and is alive.
        Taken = 3,
        /// There is no configuration yet.
        NotConfigured = 4,
        /// The motors are not armed: never were, or stopped since.
        NotArmed = 5,
        /// Motors are moving.
        Moving = 6,
        /// `detail` is the motor.
        NoSuchMotor = 7,
        /// The queue has no room: the host sent more than its credit. `detail` is the motor.
        Full = 8,
        /// More motors than the board drives; `detail` is how many it does.
        TooManyMotors = 9,
        /// A pin that is not there or cannot be this; `detail` is the pin.
        Pin = 10,
        /// A pin that is used twice; `detail` is the pin.
        PinTaken = 11,
        /// Pins that no stepgen of this board serves together; `detail` is the first pin that does not fit.
        PinMix = 12,
        /// Pulse, set-up or hold is out of the board's range; `detail` is the limit, ticks; or the time after which coils
        /// are released: `detail` is its limit, ms.
        Timing = 13,
        /// A rate that the line cannot do; `detail` is its code.
        Baud = 14,
        /// A period that is shorter than the motor's shortest, which is `detail`, ticks; or beyond 2^62.
        Period = 15,
        /// A move waits already behind the one that is under way, or four that are done were not reported yet; `detail` is the motor.
        Busy = 16,
        /// Motors have orders, until they are released or stopped: no plan is taken.
        Obeying = 17,
        /// A motion in the board's flash runs: only StopNow is taken.
        Baked = 18,
        /// Motors that share a DIR line take no orders on this board.
        SharedDir = 19,
    }
}

codes! {
    /// Why motors stopped, or what else the host should know. Sent once as an event; the last that stopped motors is in
    /// [`Info`](super::message::Info).
    Cause {
        /// Nothing yet.
        None = 0,
        /// Everything queued was done, and ended in rest.
        Finished = 1,
        /// The host asked for the immediate stop.
        StopNow = 2,
        /// The host was silent for too long; a plan goes on to the end of its lease.
        HostLost = 3,
        /// Steps were left, and the step generator did not keep up: the motors stopped at once.
        Starved = 4,
        /// Packed bytes that no packer makes; `detail` is the tick up to which all was well, modulo 2^32, on an Uno.
        BadItem = 5,
        /// Position or accumulator were not those that the host expected; `detail` as with `BadItem`.
        CheckFailed = 6,
        /// A step was asked for too late, or too soon after another: it and what follows in its epoch were not made.
        StepMissed = 7,
        /// A compare was missed and made late; `detail` is by how many ticks.
        EdgeLate = 9,
        /// Bytes from the host were lost before they were read.
        Overrun = 10,
        /// The new rate was not heard in time: back to 115 200 baud.
        BaudFellBack = 11,
        /// The chip's watchdog restarted the program.
        Watchdog = 12,
        /// The supply voltage fell below the chip's limit.
        BrownOut = 13,
        /// The reset line, as when a port is opened.
        ResetLine = 14,
        /// Power came on.
        PowerOn = 15,
        /// A motor has done a move that was ordered, its last period included; `detail` is how many since it was armed.
        MoveDone = 16,
        /// The lease was not put off while motors were in motion: all brake from the event's tick on.
        Lapsed = 17,
        /// The host asked for it: all motors brake from the event's tick on.
        Braked = 18,
        /// A motor had no more plan under its lease: all brake from the event's tick on.
        RanDry = 19,
    }
}

codes! {
    /// Why a frame was not taken.
    Missing {
        /// One before it did not arrive.
        Gap = 0,
        /// Nobody has taken the board: say Hello.
        NotTaken = 1,
        /// Its queue has no room.
        NoRoom = 2,
    }
}

/// Why a board does not do what a correct frame asks; a number that explains it, as [`Reason`] says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Why.
    pub reason: Reason,
    /// Pin, motor or limit.
    pub detail: u16,
}

impl Refusal {
    /// Without a number.
    #[must_use]
    pub const fn of(reason: Reason) -> Refusal {
        Refusal { reason, detail: 0 }
    }

    /// A body of this kind that is not as long as its kind says, or has a field out of its range.
    #[inline(never)]
    #[must_use]
    pub(super) fn malformed(kind: u8) -> Refusal {
        Refusal { reason: Reason::Malformed, detail: u16::from(kind) }
    }
}

/// How a switch went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Switched {
    /// It will be made.
    Accepted,
    /// A motor is committed beyond that tick.
    Late {
        /// The first tick at which a switch would be accepted now.
        horizon: u64,
    },
    /// The tick is too far ahead: ticks of 32 bits could not tell it from a past one.
    Early {
        /// First tick that is too far.
        limit: u64,
    },
    /// Another switch waits, for an earlier tick.
    Full,
}

/// How a trim went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trimmed {
    /// The bytes are dropped, and the lease has its new end.
    Accepted,
    /// A motor is committed beyond that end.
    Late {
        /// The first tick that would be accepted now.
        horizon: u64,
    },
    /// So many bytes do not wait in a motor's queue: some were read already.
    TooMany {
        /// Which motor's.
        motor: u8,
    },
    /// There is no lease, or it has lapsed.
    NoLease,
}

/// What [`Machine::brake`](super::Machine::brake) gives without a lease.
pub const NO_LEASE: u64 = u64::MAX;

/// An immediate stop, made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stopped {
    /// No step was begun after it.
    pub tick: u64,
    /// Bit by motor: faster than it can stop at once, so that it may stand elsewhere.
    pub uncertain: u8,
}

impl Switched {
    /// As the answer has it.
    pub(super) const fn to_parts(self) -> (u8, u64) {
        match self {
            Switched::Accepted => (0, 0),
            Switched::Late { horizon } => (1, horizon),
            Switched::Early { limit } => (2, limit),
            Switched::Full => (3, 0),
        }
    }
}

impl Trimmed {
    /// As the answer has it.
    pub(super) const fn to_parts(self) -> (u8, u64) {
        match self {
            Trimmed::Accepted => (0, 0),
            Trimmed::Late { horizon } => (1, horizon),
            Trimmed::TooMany { motor } => (2, motor as u64),
            Trimmed::NoLease => (3, 0),
        }
    }
}
