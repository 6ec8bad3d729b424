//! The events of a bake, kept for a while, so that a watcher can go on where it was.
//!
//! The dispatcher appends and never waits: a watcher that is too slow, or comes back too late, finds a gap and
//! asks for a snapshot in place of what it missed.

use kiln_proto::v1::{self, watch_bake_response::Event};
use std::{
    collections::VecDeque,
    sync::{Mutex, MutexGuard, PoisonError},
};
use tokio::sync::watch;

/// What a watcher finds.
#[derive(Debug)]
pub(crate) enum Found {
    /// Events after the one asked for; may be none.
    Events(Vec<v1::WatchBakeResponse>),
    /// Events are missing in between: a snapshot is needed.
    Gap,
}

#[derive(Debug)]
struct Kept {
    /// Number of the event before the first that is kept.
    before: u64,
    events: VecDeque<v1::WatchBakeResponse>,
}

/// The events of one bake. Numbers rise by one and begin anew, higher, when the coordinator is started again.
#[derive(Debug)]
pub(crate) struct EventLog {
    kept: Mutex<Kept>,
    most: usize,
    last: watch::Sender<u64>,
}

impl EventLog {
    /// An empty log that keeps `most` events; the first gets the number after `before`.
    pub(crate) fn new(before: u64, most: usize) -> Self {
        let kept = Mutex::new(Kept { before, events: VecDeque::new() });
        Self { kept, most, last: watch::Sender::new(before) }
    }

    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of the last event.
    pub(crate) fn last(&self) -> u64 {
        *self.last.borrow()
    }

    /// Appends an event made for its number.
    pub(crate) fn append(&self, event: impl FnOnce(u64) -> Event) {
        let number = self.last() + 1;
        let mut kept = self.kept();
        kept.events.push_back(v1::WatchBakeResponse { number, event: Some(event(number)) });
        if kept.events.len() > self.most {
            kept.events.pop_front();
            kept.before += 1;
        }
        drop(kept);
        self.last.send_replace(number);
    }

    /// What happened after the event of the given number.
    pub(crate) fn after(&self, number: u64) -> Found {
        let kept = self.kept();
        let last = kept.before + kept.events.len() as u64;
        if number < kept.before || number > last {
            return Found::Gap;
        }
        Found::Events(kept.events.iter().skip((number - kept.before) as usize).cloned().collect())
    }

    /// Tells of each new last event.
    pub(crate) fn subscribe(&self) -> watch::Receiver<u64> {
        self.last.subscribe()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(found: Found) -> Option<Vec<u64>> {
        match found {
            Found::Events(events) => Some(events.iter().map(|event| event.number).collect()),
            Found::Gap => None,
        }
    }

    #[test]
    fn goes_on_where_the_watcher_was_or_says_that_it_cannot() {
        let log = EventLog::new(100, 3);
        assert_eq!(numbers(log.after(100)), Some(vec![]));
        for _ in 0..5 {
            log.append(|_| Event::Warning(v1::Warning::default()));
        }
        assert_eq!(log.last(), 105);
        assert_eq!(numbers(log.after(103)), Some(vec![104, 105]));
        assert_eq!(numbers(log.after(102)), Some(vec![103, 104, 105]));
        assert_eq!(numbers(log.after(101)), None, "102 is gone");
        assert_eq!(numbers(log.after(0)), None);
        assert_eq!(numbers(log.after(106)), None, "a number of another life");
    }
}
