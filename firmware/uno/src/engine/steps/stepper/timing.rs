//! How long pulses are, how far apart groups are, and when DIR turns: worked out from a configuration.

use crate::engine::steps::pins::Kind;
use crate::engine::steps::times::Times;
use crate::engine::tuning::stepper::{
    BATCH_STEPS, DIR_EARLY, END_DELAY, END_DELAY_COMPARE, END_DELAY_SHIELD_B, LATENCY, LATENCY_MERGED, MIN_INTERVAL,
    PULSE_SHIELD_B, SPACING as SPACING_SHORT, SPACING_SHIELD, SPACING_SHIELD_MERGE, SPACING_STRETCHED,
    SPACING_TWO_COMPARE, SPACING_TWO_RINGS,
};
use pulsetrain_core::Tick32;
use pulsetrain_core::wire::message::Configuration;

/// Pulses, and the spacing of groups.
#[derive(Clone, Copy)]
pub(super) struct PulseTiming {
    /// The interrupt makes the pulse of 1.9 µs.
    pub(super) stretched: bool,
    /// The pulse is longer than an interrupt makes: its end is a group of its own.
    pub(super) two_groups: bool,
    /// Between two groups, at least, ticks.
    pub(super) spacing: u8,
}

impl PulseTiming {
    pub(super) const NONE: PulseTiming = PulseTiming { stretched: false, two_groups: false, spacing: 0 };

    /// The pulse has as many ticks as the configuration asks for, or a little more if that is what an interrupt makes; a longer one takes two groups. Also
    /// gives the times that follow from that.
    pub(super) fn of(
        kind: Kind,
        configuration: &Configuration<'_>,
        merging: bool,
        shared: bool,
    ) -> (PulseTiming, Times) {
        let several = configuration.motors().len() > 1;
        // Pulse and spacing, short and stretched; and the delay of a group's second write.
        let ((short, spacing), (stretched, spacing_stretched), end_delay) = match kind {
            Kind::PortDTwoRings => ((16, SPACING_TWO_RINGS), (16, SPACING_TWO_RINGS), END_DELAY),
            Kind::PortD | Kind::PortB => ((16, SPACING_SHORT), (31, SPACING_STRETCHED), END_DELAY),
            Kind::Shield => ((17, SPACING_SHIELD[0]), (31, SPACING_SHIELD[1]), END_DELAY),
            Kind::ShieldTwoRings => {
                ((PULSE_SHIELD_B, SPACING_SHIELD_MERGE), (PULSE_SHIELD_B, SPACING_SHIELD_MERGE), END_DELAY_SHIELD_B)
            }
            Kind::Compare => {
                let spacing = if several { SPACING_TWO_COMPARE } else { SPACING_TWO_RINGS };
                ((35, spacing), (35, spacing), END_DELAY_COMPARE)
            }
        };
        let wanted = configuration.pulse_ticks;
        let latency = if merging || kind == Kind::PortDTwoRings { LATENCY_MERGED } else { LATENCY };
        let mut timing = PulseTiming { stretched: false, two_groups: false, spacing };
        let (mut pulse, mut made) = (0, short);
        if wanted > short {
            if wanted <= stretched {
                (timing.stretched, timing.spacing, made) = (true, spacing_stretched, stretched);
            } else {
                timing.two_groups = true;
                // The first edge of an interrupt's pulse may be late. If it is merged, the second may be early.
                let more = match kind {
                    Kind::Compare => 0,
                    _ if merging => latency + spacing,
                    _ => latency,
                };
                pulse = (wanted + u16::from(more)).max(u16::from(spacing));
                made = pulse;
            }
        }
        let spacing = u16::from(timing.spacing);
        // The merge moves an edge by half of the spacing either way; on the shield it puts off by 24 at most, and advances by 54 at most.
        let slack = if merging { spacing } else { 0 };
        let setup = configuration.setup_ticks + u16::from(end_delay + latency) + slack;
        // An expansion counts a long pulse in 8 bits, and cannot make that of the compare hardware.
        let singly = timing.two_groups && (kind == Kind::Compare || pulse > 255);
        let interval = if singly {
            u16::MAX
        } else if merging {
            spacing
        } else {
            if several { MIN_INTERVAL[1] } else { MIN_INTERVAL[0] }
        };
        let times = Times {
            limit: Tick32(0),
            step_gap: made + 1,
            dir_hold: (made + configuration.hold_ticks + u16::from(latency) + slack).max(spacing),
            dir_setup: setup.max(spacing),
            dir_early: setup.max(spacing) + DIR_EARLY.max(spacing),
            min_interval: interval.max(made.saturating_add(if timing.two_groups { spacing } else { 0 })),
            pulse,
            max_steps: if timing.two_groups { BATCH_STEPS / 2 } else { BATCH_STEPS },
            shared,
            only_steps: 0,
        };
        (timing, times)
    }
}
