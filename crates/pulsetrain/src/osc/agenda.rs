//! Groups of requests that wait for their time.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::Instant;

use super::Group;
use crate::live::RunCommand;

/// The most groups that wait.
pub const MOST_PLANNED: usize = 1024;

/// Groups of requests in order of their time; those of the same time in the order in which they came.
///
/// ```
/// use pulsetrain::live::RunCommand;
/// use pulsetrain::osc::{Agenda, Group};
/// use std::time::{Duration, Instant};
/// let begin = Instant::now();
/// let group = |ms| Group { requests: vec![RunCommand::Go], due: begin + Duration::from_millis(ms), sender: None };
/// let mut agenda = Agenda::default();
/// agenda.push(group(20)).unwrap();
/// agenda.push(group(10)).unwrap();
/// assert_eq!(agenda.next_due(), Some(begin + Duration::from_millis(10)));
/// assert_eq!(agenda.take_due(begin), None);
/// assert_eq!(agenda.take_due(begin + Duration::from_millis(15)), Some(group(10)));
/// assert_eq!(agenda.take_due(begin + Duration::from_millis(15)), None);
/// ```
#[derive(Debug, Default)]
pub struct Agenda {
    groups: BTreeMap<(Instant, u64), (Vec<RunCommand>, Option<SocketAddr>)>,
    pushed: u64,
}

impl Agenda {
    /// Adds a group.
    ///
    /// # Errors
    /// The group itself if [`MOST_PLANNED`] wait already.
    pub fn push(&mut self, group: Group) -> Result<(), Group> {
        if self.groups.len() == MOST_PLANNED {
            return Err(group);
        }
        self.groups.insert((group.due, self.pushed), (group.requests, group.sender));
        self.pushed += 1;
        Ok(())
    }

    /// When the next group is due; `None` if none waits.
    #[must_use]
    pub fn next_due(&self) -> Option<Instant> {
        self.groups.keys().next().map(|(due, _)| *due)
    }

    /// The next group that is due by `now`.
    pub fn take_due(&mut self, now: Instant) -> Option<Group> {
        let entry = self.groups.first_entry().filter(|entry| entry.key().0 <= now)?;
        let ((due, _), (requests, sender)) = entry.remove_entry();
        Some(Group { requests, due, sender })
    }

    /// Forgets all groups: after a stop nothing may begin by itself.
    pub fn clear(&mut self) {
        self.groups.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::RunCommand;
    use std::time::Duration;

    #[test]
    fn equal_times_keep_their_order_and_a_full_agenda_gives_the_group_back() {
        let begin = Instant::now();
        let group = |name: usize| Group {
            requests: vec![RunCommand::Cue { name: name.to_string() }],
            due: begin,
            sender: None,
        };
        let mut agenda = Agenda::default();
        for name in 0..MOST_PLANNED {
            agenda.push(group(name)).unwrap();
        }
        assert_eq!(agenda.push(group(7)), Err(group(7)));
        for name in 0..10 {
            assert_eq!(agenda.take_due(begin), Some(group(name)));
        }
        agenda.push(group(7)).unwrap();
        agenda.clear();
        assert_eq!((agenda.next_due(), agenda.take_due(begin + Duration::from_secs(99))), (None, None));
    }
}
