//! Results of commands, reasons of refusals, and causes of stops: their codes, and the numbers that come with them.

use crate::lease::LapseCause;

macro_rules! codes {
    ($(#[$outer:meta])* $name:ident { $($(#[$inner:meta])* $variant:ident = $code:literal,)* }) => {
        $(#[$outer])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum $name { $($(#[$inner])* $variant = $code,)* }

        impl $name {
            /// All of them.
            pub const ALL: &'static [$name] = &[$($name::$variant),*];

            /// The variant with this code.
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
    /// Why a board refuses a command in a correct frame. `detail` is the number that comes with it, 0 if there is none.
    Reason {
        /// There is no such command, or this board does not take it. `detail` is the kind.
        UnknownKind = 1,
        /// The body is not as long as its kind says, or a field is out of its range; `detail` is the kind.
        Malformed = 2,
        /// Another host has the board, and is alive.
        Taken = 3,
        /// There is no configuration yet.
        NotConfigured = 4,
        /// The motors are not armed: they never were, or they were stopped since.
        NotArmed = 5,
        /// Motors are moving.
        Moving = 6,
        /// `detail` is the motor.
        NoSuchMotor = 7,
        /// The queue has no room: the host sent more than its credit. `detail` is the motor.
        Full = 8,
        /// More motors than the board drives; `detail` is how many it does.
        TooManyMotors = 9,
        /// The board has no such pin, or the pin cannot do this; `detail` is the pin.
        Pin = 10,
        /// A pin is used twice; `detail` is the pin.
        PinTaken = 11,
        /// No step generator of this board drives these pins together; `detail` is the first pin that does not fit.
        PinMix = 12,
        /// Pulse, set-up or hold is out of the board's range: `detail` is the limit, ticks. Or the time after which coils are
        /// released is: `detail` is the limit, ms.
        Timing = 13,
        /// A rate that the line cannot do; `detail` is its code.
        Baud = 14,
        /// A period that is shorter than the motor's shortest, which is `detail`, ticks; or beyond 2^62.
        Period = 15,
        /// One move is under way and another waits already, or four finished moves are not reported yet; `detail` is the motor.
        Busy = 16,
        /// Motors obey verbs, until they are released or stopped. Until then the board takes no plan.
        Obeying = 17,
        /// A motion in the board's flash runs. The board takes only StopNow.
        Baked = 18,
        /// Motors that share a DIR line take no orders on this board.
        SharedDir = 19,
    }
}

codes! {
    /// Why motors stopped, or something else that the host should know. It is sent once, as an event. The cause of the last stop is
    /// also in [`Info`](super::message::Info).
    Cause {
        /// Nothing yet.
        None = 0,
        /// All that was queued has been made, and the motors came to rest as planned.
        Finished = 1,
        /// The host ordered the immediate stop.
        StopNow = 2,
        /// The host was silent for too long. A plan is still followed to the end of its lease.
        HostLost = 3,
        /// Steps were left, and the step generator did not keep up: the motors stopped at once.
        Starved = 4,
        /// Packed bytes were no item; on an Uno `detail` is the tick up to which all was well, modulo 2^32.
        BadItem = 5,
        /// Position or accumulator were not those that the host expected; `detail` as with `BadItem`.
        CheckFailed = 6,
        /// A step came too late, or too soon after another. It was not made, nor what followed in its epoch.
        StepMissed = 7,
        /// An edge was made late, because its compare match was missed; `detail` is how late, ticks.
        EdgeLate = 9,
        /// Bytes from the host were lost before they were read.
        Overrun = 10,
        /// Nothing was heard at the new rate in time, so the line went back to 115 200 baud.
        BaudFellBack = 11,
        /// The chip's watchdog restarted the program.
        Watchdog = 12,
        /// The supply voltage fell below the chip's limit.
        BrownOut = 13,
        /// The reset line, as when a port is opened.
        ResetLine = 14,
        /// Power came on.
        PowerOn = 15,
        /// A motor has finished a move of a verb, its last period included; `detail` is the number of its moves since it was armed.
        MoveDone = 16,
        /// The lease was not extended in time, while motors were in motion. All brake from the event's tick on.
        Lapsed = 17,
        /// The host ordered motors to brake. All brake from the event's tick on.
        Braked = 18,
        /// A motor had no more plan before the lease ended. All brake from the event's tick on.
        RanDry = 19,
    }
}

codes! {
    /// Why a frame was not taken.
    Missing {
        /// One before it did not arrive.
        Gap = 0,
        /// No host has taken the board. The host must send Hello first.
        NotTaken = 1,
        /// Its queue has no room.
        NoRoom = 2,
    }
}

impl Cause {
    /// Why motors brake, if this is the cause of that.
    #[must_use]
    pub const fn lapse(self) -> Option<LapseCause> {
        match self {
            Cause::Lapsed => Some(LapseCause::NotExtended),
            Cause::Braked => Some(LapseCause::Ordered),
            Cause::RanDry => Some(LapseCause::Underrun),
            Cause::BadItem | Cause::CheckFailed => Some(LapseCause::BadItem),
            Cause::StepMissed => Some(LapseCause::StepMissed),
            _ => None,
        }
    }
}

impl From<LapseCause> for Cause {
    fn from(cause: LapseCause) -> Cause {
        match cause {
            LapseCause::NotExtended => Cause::Lapsed,
            LapseCause::Ordered => Cause::Braked,
            LapseCause::Underrun => Cause::RanDry,
            LapseCause::BadItem => Cause::BadItem,
            LapseCause::StepMissed => Cause::StepMissed,
        }
    }
}

/// Why a board refuses a command, with a number that explains it: see [`Reason`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Why.
    pub reason: Reason,
    /// The number: a pin, a motor, a limit.
    pub detail: u16,
}

impl Refusal {
    /// A refusal without a number.
    #[must_use]
    pub const fn of(reason: Reason) -> Refusal {
        Refusal { reason, detail: 0 }
    }

    /// A body of this kind has the wrong length, or a field out of its range.
    #[inline(never)]
    #[must_use]
    pub(super) fn malformed(kind: u8) -> Refusal {
        Refusal { reason: Reason::Malformed, detail: u16::from(kind) }
    }
}

/// The result of a switch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Switched {
    /// The switch will be made.
    Accepted,
    /// A motor is committed beyond that tick.
    Late {
        /// The first tick at which a switch would be accepted now.
        horizon: u64,
    },
    /// The tick is too far ahead: ticks of 32 bits could not tell it from a past one.
    Early {
        /// The first tick that is too far ahead.
        limit: u64,
    },
    /// Another switch waits, for an earlier tick.
    Full,
}

/// The result of a trim.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trimmed {
    /// The bytes are dropped, and the lease has its new end.
    Accepted,
    /// A motor is committed beyond that end.
    Late {
        /// The first tick that would be accepted now.
        horizon: u64,
    },
    /// A motor's queue has fewer bytes than that: the board has read some already.
    TooMany {
        /// The motor.
        motor: u8,
    },
    /// There is no lease, or it has lapsed.
    NoLease,
}

/// The result of [`BoardSide::brake`](super::BoardSide::brake) without a lease.
pub const NO_LEASE: u64 = u64::MAX;

/// The report of an immediate stop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stopped {
    /// No step began after this tick.
    pub tick: u64,
    /// A bit for each motor: it was faster than it can stop at once, so that it may stand elsewhere than the count says.
    pub uncertain: u8,
}

impl Switched {
    /// Code and tick of the answer.
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
    /// Code and tick of the answer.
    pub(super) const fn to_parts(self) -> (u8, u64) {
        match self {
            Trimmed::Accepted => (0, 0),
            Trimmed::Late { horizon } => (1, horizon),
            Trimmed::TooMany { motor } => (2, motor as u64),
            Trimmed::NoLease => (3, 0),
        }
    }
}
