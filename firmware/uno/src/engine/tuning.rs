//! Numbers that were chosen, by module. Each has its unit, and says which measurement shows why it has that value. To change one: change it,
//! build (`cargo xtask firmware uno`), and run that measurement.
//!
//! | shown by | command | it shows |
//! |---|---|---|
//! | rates | `cargo xtask bench uno --rates` | the highest rates that hold, how late edges are, how far ahead the board is |
//! | load | `cargo xtask bench uno` | figure 5: how busy the processor is |
//! | masked | `cargo test -p pulsetrain-board --test it chips::uno_masked::` | how long interrupts are kept out, stack |
//! | compare | `cargo test -p pulsetrain-board --test it chips::uno_compare::` | whether the timer's pins keep their level as motors turn |
//! | native | `cargo test -p pulsetrain-board --test it chips::uno_native::` | whether every step comes where the native board has it |
//! | steps | `cargo test -p pulsetrain-board --test it chips::uno_steps::` | whether no step comes late under load |
//! | underrun | `cargo test -p pulsetrain-board --test it -- chips::uno_starved:: chips::uno_stop::` | what a ring that ran empty makes, and counts |
//! | verbs | `cargo test -p pulsetrain-board --test it chips::uno_verbs::` | how soon an order holds, the shortest periods |
//! | winch | `cargo test -p pulsetrain-board --test it -- chips::winch_uno:: chips::winch_line::` | four axes at full speed, lines at the full rate |
//!
//! Ticks are cycles of 16 MHz. A group is one entry of a ring: 64 of them, or 24 in the short ring of the shield's motor on PORTB. Constants in
//! groups (`…_BELOW`, `…_FROM`) count the groups that are queued behind the one in the compare register.

/// `host.rs`: the main loop.
pub(crate) mod host {
    use crate::ThisProgram;
    use crate::engine::program::Program;

    /// Bytes that the main loop takes from the line in one round, at most. Plans come in many frames one after the other (shown by rates); an order
    /// to motors is to be answered soon (shown by verbs).
    pub(crate) const BYTES_A_ROUND: u8 = if ThisProgram::PLANS { 64 } else { 32 };
    /// How often the main loop asks whether the USART takes the next byte of a reply before it goes on. A poll takes some 10 cycles, so all take
    /// 200: a byte at 1 Mbaud lasts 160. Shown by load.
    pub(crate) const POLLS: u8 = 20;
}

/// `steps/refill.rs`: when the refill interrupt comes, and how much it does at once.
pub(crate) mod refill {
    /// Time to the next refill interrupt, at least, counts of 64 cycles. (The most is 255 counts: a quarter of what Timer1 counts.) Shown by rates.
    pub(crate) const MIN_PERIOD: u8 = 4;
    /// What Timer0 is set to when the refill may not run yet: it overflows again in one to two counts. After a refill Timer0 is always set to less,
    /// so that [`run_now`](crate::engine::steps::refill::run_now) can tell. Shown by rates.
    pub(crate) const RETRY: u8 = 254;
    const _: () = assert!(MIN_PERIOD.wrapping_neg() < RETRY);
    /// While merged motors wait for a switch, the next refill comes after this part of the usual time, as a power of two: lists are to be full by
    /// then. Shown by `cargo test -p pulsetrain-session --test it fade::chips::changes_on_a_busy_uno`.
    pub(crate) const SOONER_BEFORE_SWITCH: u8 = 1;
    /// Ticks for which a ring is still filled when the next refill comes, if possible: what delays the refill, the load of records and an
    /// expansion take no longer, with bytes coming in. Two rings have no such time to spare. Shown by rates.
    pub(crate) const RESERVE: u16 = 24 << 8;
    /// The same of a merged ring.
    pub(crate) const RESERVE_MERGED: u16 = 21 << 8;
    /// A ring with so many groups queued counts as full. Shown by rates.
    pub(crate) const FULL_FROM: u8 = 44;
    /// A ring that is filled for so many ticks need not be full.
    pub(crate) const FAR_AHEAD: u16 = 128 << 8;
    /// Batches of steps that one refill makes for a ring, at most; an event that is no batch (a turn of DIR, a filler) counts twice. Shown by rates.
    pub(crate) const BATCHES: u8 = 8;
    /// The same for two rings, which get a batch at a time, always the one that is filled less far. Near the top of a sinusoid a batch is a step or
    /// two and takes some 1000 cycles, and a full ring at 75 000 steps/s lasts 13 000: it cannot wait for eight batches of the other. Shown by
    /// `cargo test -p pulsetrain --test it chips::uno_promises::two_motors_on_sinusoids_do_not_starve`.
    pub(crate) const TURNS: u8 = 12;
}

/// `steps/plan.rs`: what a motor may do next.
pub(crate) mod plan {
    /// The limit is checked for segments with intervals of so many times 256 ticks or more. Below, a ring is full long before the limit, and a list
    /// that is not yet in the ring reaches 1.5 ms beyond it at most. Shown by rates (`horizon`).
    pub(crate) const LIMIT_CHECK_FROM: u8 = 4;
    /// From a filler to a turn of DIR, at least, ticks: the widest spacing of groups where DIR is planned. Shown by compare.
    pub(crate) const DIR_CLEARANCE: u8 = 96;
}

/// `steps/expand.rs`: from registers to groups.
pub(crate) mod expand {
    /// Steps that are published at once while half of the ring or more is free. Publishing takes some 40 cycles; a ring that has run down needs
    /// steps soon. A fuller ring gets all that it has room for. Shown by rates.
    pub(crate) const PUBLISH_STEPS: u8 = 12;
    /// Steps that are published at once, at least. Shown by rates.
    pub(crate) const PUBLISH_MIN: u8 = 4;
    const _: () = assert!(PUBLISH_MIN < PUBLISH_STEPS);
    /// With fewer groups queued only [`PUBLISH_MIN`] steps are published at once: the ring has nearly run empty. Shown by rates.
    pub(crate) const RING_LOW_BELOW: u8 = 8;
}

/// `steps/one_motor.rs`: a ring of one motor.
pub(crate) mod one_motor {
    /// A ring with fewer groups queued is refilled: if it is the only one, and if it is one of two. One alone lasts so short that the next record must
    /// be loaded before it has run down; with two, longer batches are worth more. Shown by rates.
    pub(crate) const REFILL_BELOW: [u8; 2] = [52, 46];
    /// Long pulses (two groups each) that are expanded at once, at most. Shown by `cargo xtask bench uno`, figure 3.
    pub(crate) const LONG_PULSES: u8 = 8;
}

/// `steps/shared_dir.rs`: motors that share DIR lines.
pub(crate) mod shared_dir {
    /// The ring is refilled with fewer groups queued. Shown by native.
    pub(crate) const REFILL_BELOW: u8 = 56;
    /// Events (groups of steps, turns of DIR, fillers) that one refill makes, at most. Shown by native.
    pub(crate) const BATCH: u8 = 4;
}

/// `steps/merge.rs`: lists of several motors, and their ring.
pub(crate) mod merge {
    /// The ring is refilled with fewer groups queued. Shown by rates.
    pub(crate) const REFILL_BELOW: u8 = 56;
    /// Lists are topped up while so many groups are queued. Shown by rates.
    pub(crate) const TOP_UP_FROM: u8 = 41;
    /// A list with fewer ticks is topped up, as it would be used up before the ring has been played: of two motors, of more, and of those that are
    /// merged while another has ring B. Shown by rates.
    pub(crate) const LIST_LOW_OF_TWO: u8 = 16;
    pub(crate) const LIST_LOW_OF_MORE: u8 = 9;
    pub(crate) const LIST_LOW_OF_SHIELD: u8 = 6;
    /// The same in bytes, of a motor that waits for a switch: all lists end at its tick, and switching takes long. Shown by
    /// `cargo test -p pulsetrain --test it chips::uno_promises::four_motors_stay_fast_on_the_shield`, and by
    /// `cargo test -p pulsetrain-session --test it fade::chips::changes_on_a_busy_uno`.
    pub(crate) const LIST_LOW_BEFORE_SWITCH: u8 = 2 * 26 + 1;
    /// Such lists are topped up while so many groups are queued. Shown by the same tests.
    pub(crate) const TOP_UP_BEFORE_SWITCH_FROM: u8 = 32;
    /// The merge goes on after it has published if fewer groups are queued. Shown by rates.
    pub(crate) const RESUME_BELOW: u8 = 56;
    /// So many groups are merged before they are published when fewer than [`RING_LOW_BELOW`] are queued. Shown by rates.
    pub(crate) const PUBLISH_GROUPS: u8 = 12;
    pub(crate) const RING_LOW_BELOW: u8 = 32;
    /// Ring B of the shield, of 24 groups, is refilled first if it has fewer queued. Shown by rates.
    pub(crate) const SHIELD_B_LOW_BELOW: u8 = 12;
    /// With ring B in use a tick is put off by so much at most, ticks. Shown by rates (lateness).
    pub(crate) const MAX_DELAY_SHIELD: u8 = 24;
    /// How often one run of the merge publishes and goes on, at most. Shown by rates.
    pub(crate) const PASSES: u8 = 12;
    /// Lists that one run fills, at most; each takes about 1000 cycles. Shown by rates.
    pub(crate) const LISTS: u8 = 16;
}

/// `steps/shield_b.rs`: ring B of the shield, of 24 groups.
pub(crate) mod shield_b {
    /// It is refilled with fewer groups queued.
    pub(crate) const REFILL_BELOW: u8 = 18;
    /// The same at the end of a refill, after which nobody comes for some time. Shown by rates.
    pub(crate) const REFILL_LAST_BELOW: u8 = 16;
    /// With fewer groups queued it is about to run empty: only [`STEPS_WHEN_LOW`] steps are expanded, which are published the sooner. Shown by rates.
    pub(crate) const RING_LOW_BELOW: u8 = 2;
    pub(crate) const STEPS_WHEN_LOW: u8 = 16;
    /// How often one refill asks the plan for this motor, at most. Shown by rates.
    pub(crate) const BATCHES: u8 = 3;
}

/// `steps/stepper.rs`: the spacing of groups, the latency of edges, the look-ahead.
pub(crate) mod stepper {
    // The host plans with these: core has them, with what they mean. Latencies are shown by steps; `SPACING` by masked, and steps; the
    // shield's by masked; the two others by compare, and steps; `END_DELAY` by `cargo test -p pulsetrain-board --test it chips::uno_pins::pulses`.
    pub(crate) use pulsetrain_core::boards::uno::{
        END_DELAY, LATENCY, LATENCY_MERGED, SPACING, SPACING_SHIELD, SPACING_TWO_COMPARE, SPACING_TWO_RINGS,
    };
    const _: () = assert!(SPACING >= 38 + 4);
    /// [`SPACING`] where the interrupt makes pulses of 1.9 µs, which takes it longer.
    pub(crate) const SPACING_STRETCHED: u8 = 60;
    const _: () = assert!(SPACING_STRETCHED >= 55 + 4);
    const _: () = assert!(SPACING_SHIELD[0] >= 53 + 4 && SPACING_SHIELD[1] >= 65 + 4);
    const _: () = assert!(2 * 14 + 67 + 5 + 54 < SPACING_TWO_COMPARE);
    /// The merged ring on PORTD while ring B is in use. It waits for ring B's interrupt for up to 30 cycles, so that 60 would do; but the wider, the
    /// more steps share a group. Shown by rates.
    pub(crate) const SPACING_SHIELD_MERGE: u8 = 78;
    /// Ring B itself, which waits for the merged ring's interrupt, and lets it in during its own: 160 cycles from the match to the compare register
    /// at most. Shown by rates.
    pub(crate) const SPACING_SHIELD_B: u8 = 160;
    /// Ticks between two steps of a motor with a ring of its own, at least, if they are to be made in batches: with one ring, and with two. Shown by
    /// rates.
    pub(crate) const MIN_INTERVAL: [u16; 2] = [60, 130];
    /// [`END_DELAY`] with the compare hardware, where DIR is toggled on a longer path.
    pub(crate) const END_DELAY_COMPARE: u8 = 48;
    /// The same of ring B of the shield, and the pulse that its interrupt makes. The delay is 92 where the merged ring's interrupt is let in; the
    /// difference is within the slack for merged edges, which ring B does not need.
    pub(crate) const END_DELAY_SHIELD_B: u8 = 80;
    pub(crate) const PULSE_SHIELD_B: u16 = 25;
    /// DIR is turned so much earlier than it must be, ticks (or the spacing of groups if that is more): a filler in its way puts it off by that.
    /// Shown by native.
    pub(crate) const DIR_EARLY: u16 = 128;
    /// The look-ahead: so far ahead of now steps are planned, at most, ticks (3 ms). Only at rates at which a ring is full long before
    /// ([`LIMIT_CHECK_FROM`](super::plan::LIMIT_CHECK_FROM)) a list may reach 1.5 ms further. Shown by rates (`horizon`).
    pub(crate) const LOOK_AHEAD: u32 = 49_152;
    const _: () = assert!(LOOK_AHEAD < 1 << 16 && LOOK_AHEAD.is_multiple_of(256));
    /// Steps that are expanded at once into a list of the merge; half as many if each is two ticks. Shown by rates.
    pub(crate) const BATCH_STEPS: u8 = 32;
    /// When a compare match was missed, the next one is set so far ahead of now, ticks. Shown by underrun.
    pub(crate) const RETRY: u16 = 48;
    /// After an underrun the next group comes so long after now, ticks: time enough to fill some more in. Shown by underrun.
    pub(crate) const RESTART_DELAY: u16 = 800;
    /// An underrun that lasted longer stops the motors, ticks (100 µs). Shown by underrun.
    pub(crate) const MAX_UNDERRUN: u16 = 1600;
    const _: () =
        assert!(RESTART_DELAY < MAX_UNDERRUN && MAX_UNDERRUN as u32 * 10_000 == crate::engine::clock::TICK_HZ);
}

/// `bin/uno-verbs`.
pub(crate) mod verbs {
    /// Motions are settled so far ahead of now, ticks, when the tick `known` was moved; and so much more for each motor, whose steps take time to
    /// work out. Together 1.95 ms for one motor. Shown by verbs.
    pub(crate) const KNOWN_AHEAD: u16 = 27_200;
    pub(crate) const KNOWN_AHEAD_A_MOTOR: u16 = 4_000;
    const _: () = assert!(KNOWN_AHEAD + KNOWN_AHEAD_A_MOTOR == 31_200);
    /// `known` is moved again when half of that has passed, less this, ticks. Shown by verbs.
    pub(crate) const MARGIN: u16 = 3_000;
    /// From the limit to `known`, ticks, beside what a turn of DIR takes: two groups, and a filler's clearance. Shown by verbs.
    pub(crate) const CLEARANCE: u16 = 512;
    /// The shortest period, ticks, for each motor: with pulses up to [`SHORT_PULSE`] ticks, and with longer ones, which make the step interrupts
    /// longer. Shown by verbs (`the_shortest_periods_hold`).
    pub(crate) const SHORTEST_PERIOD: u16 = 368;
    pub(crate) const SHORTEST_PERIOD_STRETCHED: u16 = 413;
    pub(crate) const SHORT_PULSE: u16 = 16;
    /// The longest pulse, ticks: a longer one takes two groups a step, for which the refill has no time. Shown by verbs.
    pub(crate) const MAX_PULSE: u16 = pulsetrain_core::boards::uno::MAX_SHORT_PULSE;
}

/// `bin/uno-winch`.
pub(crate) mod winch {
    /// Time to the next refill interrupt, at most, counts of 64 cycles. Shown by winch.
    pub(crate) const MAX_PERIOD: u8 = 64;
    /// A slice is worked out when it begins so soon, ticks. Shown by winch.
    pub(crate) const LOOK_AHEAD: u32 = 36_864;
    /// Nothing is planned for so long before the next slice, ticks: as long as DIR is turned before a step, at most. Shown by winch.
    pub(crate) const CLEARANCE: u16 = 768;
    /// From the start of the rings to the first slice, ticks: the merge's first fillers come before. Shown by winch.
    pub(crate) const FIRST_SLICE: u32 = 44_000;
    /// A line with a reply waits while an earlier reply is unsent, as long as fewer bytes than this wait behind it. Shown by winch
    /// (`every_line_of_a_short_burst_is_told`).
    pub(crate) const BACKLOG: u8 = 64;
    /// Frames have been silent for so long if a line is answered that frames have the board, units of 1.024 ms. Shown by winch
    /// (`any_line_is_told_that_frames_have_the_board`).
    pub(crate) const FRAMES_SILENT: u16 = 100;
}
