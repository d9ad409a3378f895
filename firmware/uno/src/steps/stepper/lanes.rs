//! Several motors in one ring, each with a DIR line of its own: the merge takes its ticks from here.
//!
//! Each motor is fed on its own, so that nobody has to look at all of them for every step: steps that need no looking at by
//! the list, expanded in assembly; everything else, a step, a change of direction, the end of a long pulse, one by one.
//!
//! The merge may move each edge by half the distance of groups, W/2, either way. Where two edges of a motor must keep a
//! distance (setup, hold), W is added to it: [`Times`] has it in them.

use super::super::expand;
use super::super::merge::{Dry, Feeder, LANES, Merge, feed};
use super::super::ring::Group;
use super::{Axis, FILLER, Times, Track, Wish, done, later, plan};
use crate::clock::low_half;
use crate::memory::Queues;
use pulsetrain_core::Moment;

/// So far ahead motors are fed at most, ticks (3 ms): the pending group moves on by less than 2^16 ticks in a call.
const AHEAD: u32 = 49_152;
/// The ring is looked after when it has room for so many groups.
const ROOM: u8 = 8;
/// Lanes are fed so often in a call at most; each takes about 1000 cycles.
const FEEDS: u8 = 6;
/// Steps in a list at most: a shorter list is ready sooner, and the ring does not run dry while four are made.
const STEPS: u8 = 24;

/// What feeds the merge.
struct Motors<'a> {
    axes: &'a mut [Axis],
    /// Lines that are high when all that was fed has been played.
    levels: &'a mut u8,
    /// Tick of the last that each lane was fed.
    last: &'a mut [Moment; LANES],
    times: &'a Times,
    queues: &'a Queues,
    /// Nothing is fed beyond this.
    limit: Moment,
    /// How often lanes may be fed yet: the line waits meanwhile.
    feeds: u8,
}

/// What the assembly calls when a list is used up.
///
/// # Safety
/// Only for the assembly: `feeder` and `merge` are those that [`Merge::run`] gave it.
#[unsafe(no_mangle)]
unsafe extern "C" fn steps_feed(feeder: *mut u8, lane: u8, merge: *mut Merge) -> bool {
    // SAFETY: `Merge::run` is called in this file alone, with `Motors`; the borrows in it are alive as long as it runs.
    unsafe { feed::<Motors<'_>>(feeder, lane, merge) }
}

impl Axis {
    /// Feeds `lane` with steps that need no looking at, if there are any; gives the last one's tick.
    fn steps(&mut self, merge: &mut Merge, lane: u8, times: &Times, limit: Moment, until: Moment) -> Option<Moment> {
        // After a wait the next step may be too far away.
        if until.is_before(self.motor.registers().next_tick()) {
            return None;
        }
        let steps = self.grant(u16::from(times.apart), limit, times).min(STEPS);
        if steps == 0 {
            return None;
        }
        let step = self.lines.step;
        let list = merge.list(lane, steps, Group { rise: step, fall: step });
        // SAFETY: what is granted is what `expand` asks for; a list has room for `STEPS` ticks.
        unsafe { expand::into_list(self.motor.registers_mut(), list, steps) };
        Some(self.took(steps, times))
    }
}

impl Feeder for Motors<'_> {
    fn feed(&mut self, merge: &mut Merge, lane: u8) -> Result<(), Dry> {
        let Motors { axes, levels, last, times, queues, limit, feeds } = self;
        if *feeds == 0 {
            return Err(Dry);
        }
        *feeds -= 1;
        let index = usize::from(lane) % LANES;
        let last = &mut last[index];
        let until = last.after(FILLER);
        while let Some(axis) = axes.get_mut(index) {
            let fresh = axis.motor.registers().left == 0;
            let mut end = if fresh { None } else { axis.steps(merge, lane, times, *limit, until) };
            if end.is_none() && axis.wish == Wish::Nothing {
                axis.look(queues, until, times);
                if fresh {
                    end = axis.steps(merge, lane, times, *limit, until);
                }
            }
            if let Some(end) = end {
                *last = end;
                return Ok(());
            }
            if axis.wish == Wish::Nothing {
                break;
            }
            if let Some((due, _, group)) = plan(axes, index, **levels, times) {
                if until.is_before(due) {
                    break;
                }
                if limit.is_before(due) {
                    return Err(Dry);
                }
                done(axes, index, due, times);
                **levels ^= group.rise ^ group.fall;
                *last = due;
                merge.put(lane, low_half(due.0), group);
                return Ok(());
            }
        }
        if limit.is_before(until) {
            return Err(Dry);
        }
        if let Some(axis) = axes.get_mut(index) {
            // What is long past must not come back as the future.
            axis.free = later(axis.free, *last);
            axis.ready = later(axis.ready, *last);
            axis.motor.pass(until);
        }
        *last = until;
        merge.put(lane, low_half(until.0), Group::NOTHING);
        Ok(())
    }
}

/// Fills the ring as far as time allows.
pub(super) fn fill(
    merge: &mut Merge,
    last: &mut [Moment; LANES],
    track: &mut Track,
    axes: &mut [Axis],
    now: Moment,
    queues: &Queues,
    times: &Times,
) {
    if track.ring.free() < ROOM {
        return;
    }
    let at = low_half(track.at.0);
    let levels = &mut track.levels;
    let limit = now.after(AHEAD);
    let end = merge.run(&mut track.ring, at, &mut Motors { axes, levels, last, times, queues, limit, feeds: FEEDS });
    track.at = track.at.after(u32::from(end.wrapping_sub(at)));
}
