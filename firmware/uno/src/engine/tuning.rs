//! Numbers that were chosen, by module: of each the unit, and what shows why it has that value. Change one, build (`cargo xtask firmware uno`), and
//! run that.
//!
//! | shown by | command | it shows |
//! |---|---|---|
//! | rates | `cargo xtask bench uno --rates` | the highest rates that hold, how late edges are, how far ahead the board is |
//! | load | `cargo xtask bench uno` | figure 5: how busy the processor is |
//! | masked | `cargo test -p pulsetrain-board --test it chips::uno_masked::` | how long interrupts are kept out, stack |
//! | compare | `cargo test -p pulsetrain-board --test it chips::uno_compare::` | whether the timer's pins stay upright as motors turn |
//! | native | `cargo test -p pulsetrain-board --test it chips::uno_native::` | whether every step comes where the native board has it |
//! | steps | `cargo test -p pulsetrain-board --test it chips::uno_steps::` | whether none comes late under load |
//! | starved | `cargo test -p pulsetrain-board --test it -- chips::uno_starved:: chips::uno_stop::` | what a ring that ran empty makes, and counts |
//! | line | `cargo test -p pulsetrain-board --test it -- chips::uno_link:: chips::uno_overrun:: chips::uno_remote::` | whether bytes are lost |
//! | verbs | `cargo test -p pulsetrain-board --test it chips::uno_verbs::` | how soon what is told holds, the shortest periods |
//! | winch | `cargo test -p pulsetrain-board --test it -- chips::winch_uno:: chips::winch_line::` | four axes at full speed, lines at the full rate |
//!
//! Ticks are cycles of 16 MHz; a group is one of a ring's 64.

/// `host.rs`: the main loop.
pub(crate) mod host {
    use crate::Uses;
    use crate::engine::program::Program;

    /// Bytes that frames take in one round of the main loop at most. Plans come in many frames one after the other (shown by rates); what motors are told
    /// directly is to be answered soon (shown by verbs).
    pub(crate) const BYTES_A_ROUND: u8 = if Uses::PLANS { 64 } else { 32 };
    /// How often the line is asked whether it takes a byte before the main loop goes on, looks of some 10 cycles: 200 in all, a byte at 1 Mbaud.
    /// Shown by load.
    pub(crate) const POLLS: u8 = 20;
}

/// `steps/task.rs`: when rings are filled, and how much at once.
pub(crate) mod task {
    /// Until the next call, at least, counts of 64 cycles. At most it is 255: a quarter of what Timer1 counts. Shown by rates.
    pub(crate) const SOONEST: u8 = 4;
    /// What Timer0 counts from where the task may not run yet. When it has run, that is less: there are [`SOONEST`] counts to the next call, at
    /// least. Shown by rates.
    pub(crate) const AGAIN: u8 = 254;
    const _: () = assert!(SOONEST.wrapping_neg() < AGAIN);
    /// Ticks that a ring is filled for when the task comes again, at least, if it can be: what keeps it waiting, loads of records and an
    /// expansion take no longer, with bytes coming in. Two rings have no such time to give away. Shown by rates.
    pub(crate) const RESERVE: u16 = 24 << 8;
    /// The same of a merge.
    pub(crate) const RESERVE_MERGED: u16 = 21 << 8;
    /// A ring is full when it has room for fewer groups. Shown by rates.
    pub(crate) const NEARLY: u8 = 20;
    /// A ring that is filled for so many ticks need not be full.
    pub(crate) const FAR: u16 = 128 << 8;
    /// Batches of steps that one call makes for a ring, at most; what Rust puts into the ring counts twice. Shown by rates.
    pub(crate) const BATCHES: u8 = 8;
    /// The same of two rings, a batch at a time for the one that is filled less far. Near the top of a sinusoid a batch is a step or two and takes some
    /// 1000 cycles, and a full ring of 75 000 steps/s lasts 13 000: it must not wait for eight of the other's. Shown by
    /// `cargo test -p pulsetrain --test it chips::uno_promises::two_motors_on_sinusoids_do_not_starve`.
    pub(crate) const TURNS: u8 = 12;
}

/// `steps/plan.rs`: what a motor may do next.
pub(crate) mod plan {
    /// Motors whose intervals are shorter than 256 times one less than this, ticks, are not held against the limit: a ring is full of them before
    /// it, and a list that is not yet in the ring reaches 1.5 ms beyond at most. Shown by rates (`horizon`).
    pub(crate) const SURE_OF_LIMIT: u8 = 4;
    /// So far after a filler DIR is turned at the soonest, ticks: what is between two groups at least. Shown by compare.
    pub(crate) const ROOM: u8 = 96;
}

/// `steps/expand.rs`: from registers to groups.
pub(crate) mod expand {
    /// So many steps are published at once where the ring has room for 32 or more, so that it soon has some; else as many as there is
    /// room for: publishing takes some 40 cycles. Shown by rates.
    pub(crate) const SOME: u8 = 12;
    /// And so many steps at least. Shown by rates.
    pub(crate) const LEAST: u8 = 4;
    /// As few where there is room for so many groups: the ring has nearly run down. Shown by rates.
    pub(crate) const HURRY: u8 = 56;
}

/// `steps/fill.rs`: a ring of one motor.
pub(crate) mod fill {
    /// A ring is filled when it has room for so many groups: alone, where it lasts for so short a time that the next record is to be
    /// loaded before it has run down; and beside another, where longer batches are worth more. Shown by rates.
    pub(crate) const ROOM: [u8; 2] = [12, 18];
    /// Long pulses that are expanded at once, at most. Shown by `cargo xtask bench uno`, figure 3.
    pub(crate) const FEW: u8 = 8;
}

/// `steps/merge.rs`: lists of several motors, and their ring.
pub(crate) mod merge {
    /// The ring is filled when it has room for so many groups. Shown by rates.
    pub(crate) const ROOM: u8 = 8;
    /// Lists are filled up while the ring has room for fewer groups. Shown by rates.
    pub(crate) const NEARLY: u8 = 24;
    /// A list is filled up when what is left of it does not last while the ring is played, ticks of the list: of two motors, of more, and of
    /// those that have one beside. Shown by rates.
    pub(crate) const FEW_OF_TWO: u8 = 16;
    pub(crate) const FEW_OF_MORE: u8 = 9;
    pub(crate) const FEW_OF_BESIDE: u8 = 6;
    /// And of a motor that waits for a switch, which takes long, bytes. Shown by
    /// `cargo test -p pulsetrain --test it chips::uno_promises::four_motors_stay_fast_on_the_shield`.
    pub(crate) const FEW_BEFORE_SWITCH: u8 = 2 * FEW_OF_TWO + 1;
    /// Groups that the ring must have room for to go on. Shown by rates.
    pub(crate) const ENOUGH: u8 = 8;
    /// So many groups are merged at once when the ring has room for [`LOW`] of them or more: they are published the sooner. Shown by rates.
    pub(crate) const FEW: u8 = 12;
    pub(crate) const LOW: u8 = 32;
    /// The ring beside comes first when it has room for so many groups of its 24. Shown by rates.
    pub(crate) const LOW_BESIDE: u8 = 12;
    /// With one, a tick is put off by so much at most, ticks. Shown by rates (lateness).
    pub(crate) const PUT_OFF_BESIDE: u8 = 24;
    /// How often one run of the merge goes on. Shown by rates.
    pub(crate) const LOOKS: u8 = 12;
    /// How many lists one run fills at most; each takes about 1000 cycles. Shown by rates.
    pub(crate) const FEEDS: u8 = 16;
}

/// `steps/beside.rs`: the ring beside a merge.
pub(crate) mod beside {
    /// It is filled when it has room for so many groups; at the end of a call, after which nobody comes for some time, for so many. Shown by
    /// rates.
    pub(crate) const ROOM: u8 = 6;
    pub(crate) const LAST: u8 = 8;
    /// If it has room for so many groups it is about to run dry: fewer steps are expanded, which are published the sooner. Shown by rates.
    pub(crate) const HURRY: u8 = 22;
    pub(crate) const SOME: u8 = 16;
    /// So many things are done for it at once that the plan is asked for, at most. Shown by rates.
    pub(crate) const BATCHES: u8 = 3;
}

/// `steps/stepper.rs`: how far apart groups are, how late edges may be, how far ahead things are planned.
pub(crate) mod stepper {
    /// So late an edge made by an interrupt may be, ticks. Shown by steps.
    pub(crate) const LATE: u8 = 24;
    /// The same where a merge moves it too, or another ring's interrupt comes first.
    pub(crate) const LATE_MOVED: u8 = 60;
    /// Ticks between two groups, at least: from a match until the interrupt has set the next, and the longest time that it can be
    /// kept waiting; and the length of the interrupt + 4, so that delays die out. Shown by masked, and steps.
    pub(crate) const APART: u8 = 48;
    /// The same where interrupts are longer: with pulses of 1.9 µs.
    pub(crate) const APART_LONG: u8 = 60;
    /// The shield's, and with pulses of 1.9 µs.
    pub(crate) const APART_SHIELD: [u8; 2] = [60, 76];
    /// With the compare hardware, or with two rings on PORTD, where the other's interrupt may come first. Shown by compare, and steps.
    pub(crate) const APART_BESIDE: u8 = 96;
    /// With two of the compare hardware's. Toggling is switched on and off behind the match, and must be before the next one, or the pin's level is
    /// the wrong way round from then on. Before that may come: two stretches with interrupts off (mod.rs), the other's longer way and the instruction
    /// behind it, and the way to the register. Shown by compare.
    pub(crate) const APART_TWO_COMPARE: u8 = 171;
    const _: () = assert!(2 * 14 + 67 + 5 + 54 < APART_TWO_COMPARE);
    /// With a merge on PORTD beside a ring on PORTB: the merge's, which waits for the other's interrupt for up to 30 cycles, so that 60 would do;
    /// but the wider, the more steps join another's group. And the other's, which waits for the merge's interrupt, and has it in its own: 160
    /// cycles from the match to the compare register at most. Shown by rates.
    pub(crate) const APART_BESIDE_MERGE: u8 = 78;
    pub(crate) const APART_OF_BESIDE: u8 = 160;
    /// Ticks between two steps of a motor with a ring of its own, at least, when they are not looked at: alone, and beside another. Shown by rates.
    pub(crate) const FASTEST: [u16; 2] = [60, 130];
    /// From a group's tick to its `fall`, ticks, when no interrupt was kept waiting. Shown by
    /// `cargo test -p pulsetrain-board --test it chips::uno_pins::pulses`.
    pub(crate) const FALL: u8 = 16;
    /// The same with the compare hardware, where DIR is toggled on a longer way.
    pub(crate) const FALL_COMPARE: u8 = 48;
    /// The same of a ring on PORTB beside a merge, and the pulse that its interrupt makes. It is 92 where the merge's interrupt is let in; what is
    /// missing is in the room that merged edges need, and these do not.
    pub(crate) const FALL_BESIDE: u8 = 80;
    pub(crate) const PULSE_BESIDE: u16 = 25;
    /// What a turn of DIR may be earlier than it must, ticks, or the distance of two groups if that is more: a filler in its way puts it off by
    /// that. Shown by native.
    pub(crate) const EARLY: u16 = 128;
    /// So far ahead things are planned at most, ticks (3 ms), but for steps at rates at which a ring is full long before
    /// ([`SURE_OF_LIMIT`](super::plan::SURE_OF_LIMIT)): a list of them may reach 1.5 ms further. Shown by rates (`horizon`).
    pub(crate) const AHEAD: u32 = 49_152;
    /// The ring of several motors is filled when it has room for so many groups. Shown by native.
    pub(crate) const ROOM: u8 = 8;
    /// Steps that are expanded at once into a list of the merge; half as many if each is two ticks. Shown by rates.
    pub(crate) const STEPS: u8 = 32;
    /// Things that one call does at most, beside batches of steps. Shown by native.
    pub(crate) const BATCH: u8 = 4;
    /// A compare that was missed is made so soon, ticks. Shown by starved.
    pub(crate) const AGAIN: u16 = 48;
    /// After the ring ran empty the next group comes so soon, ticks: time enough to fill some more in. Shown by starved.
    pub(crate) const LEAD: u16 = 800;
    /// Steps that come later than this after the ring ran empty are not made any more, ticks (100 µs): the motors stop. Shown by starved.
    pub(crate) const TOO_LATE: u16 = 1600;
}

/// `bin/uno-verbs`.
pub(crate) mod verbs {
    /// What is known ends so soon, ticks, when it has been put off: that and as much as the next for each motor, whose steps take the task so
    /// much longer. 1.95 ms for one. Shown by verbs.
    pub(crate) const FORESEE: u16 = 27_200;
    pub(crate) const FORESEE_MORE: u16 = 4_000;
    /// It is put off again when half of that has passed, but for so much, ticks. Shown by verbs.
    pub(crate) const SOONER: u16 = 3_000;
    /// From the limit to what is known, ticks, beside what a turn of DIR takes: two groups, and a filler's room. Shown by verbs.
    pub(crate) const CLEAR: u16 = 512;
    /// The shortest period, ticks, for each motor: with pulses up to [`SHORT_PULSE`] ticks, and with longer ones, after which a step interrupt
    /// waits. Shown by verbs (`the_shortest_periods_hold`).
    pub(crate) const SHORTEST: u16 = 368;
    pub(crate) const SHORTEST_OF_LONG: u16 = 413;
    pub(crate) const SHORT_PULSE: u16 = 16;
    /// The longest pulse, ticks: longer ones are two groups a step, which the task has no time for beside the next slices. Shown by verbs.
    pub(crate) const LONGEST_PULSE: u16 = 31;
}

/// `bin/uno-winch`.
pub(crate) mod winch {
    /// Until the task's next call, at most, counts of 64 cycles. Shown by winch.
    pub(crate) const SLICES: u8 = 64;
    /// Slices are worked out that begin this soon, ticks. Shown by winch.
    pub(crate) const AHEAD: u32 = 36_864;
    /// Before the next slice nothing is done for so long, ticks: as long as DIR is turned before a step, at most. Shown by winch.
    pub(crate) const CLEAR: u16 = 768;
    /// From the start of the rings to the first slice, ticks: the merge's first fillers are before. Shown by winch.
    pub(crate) const FIRST: u32 = 44_000;
    /// A line waits for what it would say as long as no more bytes than this wait behind it. Shown by winch (`every_line_of_a_short_burst_is_told`).
    pub(crate) const PATIENCE: u8 = 64;
    /// Frames have been silent for so long if a line is told that they have the board, 1.024 ms. Shown by winch
    /// (`any_line_is_told_that_frames_have_the_board`).
    pub(crate) const SILENCE: u16 = 100;
}
