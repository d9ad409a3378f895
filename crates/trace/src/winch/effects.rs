//! Finds the millisecond in which each line took effect: those that agree best with the steps and with ENABLE.

use std::collections::HashSet;

use super::path::Board;
use super::{Differing, Drivers, Seen, SentLine, THRESHOLD, WinchOptions};

/// Number of candidates that are followed at once. Nine lines that may each act in any of eight milliseconds, before
/// any axis has stepped, have more combinations. Then those remain in which all lines took about equally long.
const WAYS: usize = 2048;

/// A candidate that is this much worse than the best is dropped, steps².
const HOPELESS: f64 = 4.0;

/// A candidate: one possible millisecond for each line so far.
#[derive(Clone, Debug)]
struct Way {
    board: Board,
    /// The millisecond of each line so far.
    effects: Vec<u64>,
    differing: Differing,
    /// Sum of squared distances of steps from the paths, steps².
    distance: f64,
}

/// The millisecond at whose beginning each line takes effect.
pub(super) fn find(sent: &[SentLine], seen: &Seen, ms_end: u64, options: &WinchOptions) -> Vec<u64> {
    let ms_of = |tick: u64| tick as f64 / options.tick_hz * 1e3;
    let windows: Vec<(u64, u64)> = sent
        .iter()
        .map(|sent| (ms_of(sent.tick).ceil() as u64, ms_of(sent.until).ceil() as u64 + options.effect_ms))
        .collect();
    let mut ways =
        vec![Way { board: Board::START, effects: Vec::new(), differing: Differing::default(), distance: 0.0 }];
    let mut drivers = Drivers::new(&seen.drives);
    let mut next = [0; 4];
    for ms in 0..ms_end {
        branch(&mut ways, sent, &windows, ms);
        for (axis, steps) in seen.steps.iter().enumerate() {
            let before = steps[..next[axis]].last().map_or(0, |step| step.position);
            let count = steps[next[axis]..].partition_point(|step| step.ms < (ms + 1) as f64);
            let now = &steps[next[axis]..next[axis] + count];
            next[axis] += count;
            let position = now.last().map_or(before, |step| step.position) as f64;
            for way in &mut ways {
                for step in now {
                    let behind = step.behind(&way.board, axis, ms);
                    way.distance += behind * behind;
                    step.show(&mut way.board, axis, ms, options);
                }
                let end = way.board.paths[axis].position + way.board.speed(axis) * 1e-3;
                let beyond = ((end - position).abs() - THRESHOLD).max(0.0);
                way.distance += beyond * beyond;
            }
        }
        let are_on = drivers.at_end_of(ms, options);
        for way in &mut ways {
            way.board.tick();
            if way.differing.go_on(are_on != way.board.drives, options) {
                // This counts as much as a step at its bound.
                way.distance += options.bound_steps * options.bound_steps;
            }
        }
        prune(&mut ways, &windows);
    }
    let best = ways.swap_remove(0);
    let left = windows[best.effects.len()..].iter().map(|window| window.0.max(ms_end));
    best.effects.iter().copied().chain(left).collect()
}

/// Extends each candidate by none, one or more of the lines that may take effect from now on.
fn branch(ways: &mut Vec<Way>, sent: &[SentLine], windows: &[(u64, u64)], ms: u64) {
    let due = |way: &Way| windows.get(way.effects.len()).filter(|window| window.0 <= ms).copied();
    if ways.iter().all(|way| due(way).is_none()) {
        return;
    }
    let mut open = std::mem::take(ways);
    while let Some(mut way) = open.pop() {
        let Some((_, last)) = due(&way) else {
            ways.push(way);
            continue;
        };
        if ms < last {
            ways.push(way.clone());
        }
        way.board.obey(&sent[way.effects.len()].command);
        way.effects.push(ms);
        open.push(way);
    }
}

/// Keeps the best candidates, the best first. Of two that are equal, the one with the earlier lines is kept.
fn prune(ways: &mut Vec<Way>, windows: &[(u64, u64)]) {
    if ways.len() == 1 {
        return;
    }
    sort(ways);
    let worst = ways[0].distance + HOPELESS;
    let mut known = HashSet::with_capacity(ways.len());
    ways.retain(|way| way.distance <= worst && known.insert((way.effects.len(), way.differing, way.board.bits())));
    if ways.len() > WAYS {
        ways.sort_by(|a, b| {
            a.distance.total_cmp(&b.distance).then_with(|| a.unevenness(windows).cmp(&b.unevenness(windows)))
        });
        ways.truncate(WAYS);
        sort(ways);
    }
}

fn sort(ways: &mut [Way]) {
    ways.sort_by(|a, b| a.distance.total_cmp(&b.distance).then_with(|| a.effects.cmp(&b.effects)));
}

impl Way {
    /// How unevenly long the lines took: the sum of the differences between successive lines, ms.
    fn unevenness(&self, windows: &[(u64, u64)]) -> u64 {
        let took = |line: usize| self.effects[line] - windows[line].0;
        (1..self.effects.len()).map(|line| took(line).abs_diff(took(line - 1))).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::winch::{AxisStep, Command, see};

    /// The steps of paths on which each line takes effect in a given millisecond.
    fn seen(lines: &[(u64, &str)], ms_end: u64, options: &WinchOptions) -> Seen {
        let mut board = Board::START;
        let mut seen = see(&[], options).unwrap();
        for ms in 0..ms_end {
            for (_, line) in lines.iter().filter(|(at, _)| *at == ms) {
                board.obey(&Command::parse(line).unwrap());
            }
            for (axis, steps) in seen.steps.iter_mut().enumerate() {
                let (from, moved) = (board.paths[axis].position, board.speed(axis) * 1e-3);
                loop {
                    let position = steps.last().map_or(0, |step| step.position);
                    let beyond = from + moved - position as f64;
                    if beyond.abs() < THRESHOLD {
                        break;
                    }
                    let forward = beyond > 0.0;
                    let position = if forward { position + 1 } else { position - 1 };
                    let mut step = AxisStep { ms: 0.0, position, forward };
                    step.ms = ms as f64 + (step.wanted_at() - from) / moved;
                    steps.push(step);
                }
            }
            board.tick();
            if seen.drives.last().is_some_and(|(_, on)| *on) != board.drives {
                seen.drives.push(((ms as f64 * 1e-3 * options.tick_hz) as u64, board.drives));
            }
        }
        seen
    }

    #[test]
    fn lines_are_found_where_they_acted() {
        let lines = [
            (3, "g xyza 2 1"),
            (5, "l xyza 8000 100000"),
            (8, "a xyza 3000 200 -100 0"),
            (402, "d x -500"),
            (406, "v y 900"),
            (700, "a x 0"),
            (702, "enable 0"),
        ];
        let options = WinchOptions::default();
        let seen = seen(&lines, 1500, &options);
        // Each line arrived within 6 ms before, with 2 ms of uncertainty.
        let sent: Vec<SentLine> = lines
            .iter()
            .zip([1, 0, 3, 4, 1, 0, 5])
            .map(|((ms, line), early)| {
                let tick = (ms - early) * 16_000;
                SentLine { tick, until: tick + 32_000, command: Command::parse(line).unwrap() }
            })
            .collect();
        let found = find(&sent, &seen, 1500, &options);
        // Lines that make no difference yet (gains and limits of axes at rest) take effect as soon as possible.
        assert_eq!(found, [2, 5, 8, 402, 406, 700, 702]);
    }

    /// Ten lines, a millisecond or two apart, are all over before any axis makes a step: there are far more ways than are followed, all as good
    /// as each other till then. Each line took six of its eight milliseconds.
    #[test]
    fn of_more_ways_than_are_followed_those_of_even_delays_are_kept() {
        const TOOK: u64 = 6;
        let lines = [
            (10, "a x 30"),
            (11, "a y -25"),
            (13, "d x 9"),
            (14, "a z 40"),
            (15, "d y -12"),
            (16, "a a 22"),
            (18, "d x 5"),
            (19, "d z -7"),
            (20, "d a 11"),
            (21, "d y 4"),
        ];
        let options = WinchOptions::default();
        let sent: Vec<SentLine> = lines
            .iter()
            .map(|(ms, line)| {
                let tick = (ms - TOOK) * 16_000;
                SentLine { tick, until: tick + 32_000, command: Command::parse(line).unwrap() }
            })
            .collect();
        let seen = seen(&lines, 600, &options);
        let first = seen.steps.iter().flatten().map(|step| step.ms).fold(f64::INFINITY, f64::min);
        assert!(first > 24.0, "a step at {first} ms already");
        assert_eq!(find(&sent, &seen, 600, &options), lines.map(|(ms, _)| ms));
    }
}
