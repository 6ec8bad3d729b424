//! The lane of a bake: decided once, when a worker is there that can trace it.

use kiln_core::{Lane, MIXED_LANE};
use kiln_proto::v1::Backend;

/// What a worker offers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Offer<'a> {
    /// Lanes that it traces in, the preferred first; empty if it does not trace.
    pub(crate) trace: &'a [String],
    /// The lane of its solves, if it does any but trace tasks.
    pub(crate) solve: Option<&'a str>,
}

/// Whether a trace lane is a GPU's.
fn is_gpu(lane: &str) -> bool {
    lane.starts_with("gpu:")
}

/// The lane for a bake, given what workers offer, in the order in which they came; `None` if none fits yet.
///
/// The lane that most workers offer wins, so that most can help, and among equals the first. `auto` takes a GPU
/// only where a worker prefers it: a software driver is offered, but not preferred.
pub(crate) fn choose(backend: Backend, offers: &[Offer<'_>]) -> Option<Lane> {
    let lanes =
        |fits: fn(&str) -> bool| offers.iter().flat_map(|o| o.trace).map(String::as_str).filter(move |l| fits(l));
    let preferred = offers.iter().filter_map(|offer| offer.trace.first()).map(String::as_str);
    let trace = match backend {
        Backend::Cpu => most(lanes(|lane| lane == "cpu")),
        Backend::Gpu => most(lanes(is_gpu)),
        // Any will do, but there must be one.
        Backend::Mixed => most(preferred),
        Backend::Auto | Backend::Unspecified => {
            most(preferred.clone().filter(|lane| is_gpu(lane))).or_else(|| most(preferred))
        }
    };
    let trace = if backend == Backend::Mixed { trace.and(Some(MIXED_LANE)) } else { trace };
    let solve = most(offers.iter().filter_map(|offer| offer.solve));
    Some(Lane { trace: trace?.to_owned(), solve: solve?.to_owned() })
}

/// Why no worker fits, in a sentence.
pub(crate) fn why_none(backend: Backend, offers: &[Offer<'_>]) -> String {
    if offers.is_empty() {
        return "no worker is connected; start one with `kiln worker`".to_owned();
    }
    if offers.iter().all(|offer| offer.solve.is_none()) {
        return "no connected worker has the role `reduce`".to_owned();
    }
    let wanted = match backend {
        Backend::Cpu => "traces on the CPU",
        Backend::Gpu => "has a GPU",
        Backend::Auto | Backend::Mixed | Backend::Unspecified => "has the role `trace`",
    };
    format!("none of the {} connected workers {wanted}", offers.len())
}

/// The item that comes most often; among equals the one that comes first.
fn most<'a>(items: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let mut counts: Vec<(&str, usize)> = Vec::new();
    for item in items {
        match counts.iter_mut().find(|(known, _)| *known == item) {
            Some((_, count)) => *count += 1,
            None => counts.push((item, 1)),
        }
    }
    // `max_by_key` gives the last of equals.
    counts.into_iter().rev().max_by_key(|&(_, count)| count).map(|(item, _)| item)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lane(backend: Backend, workers: &[(&[&str], &str)]) -> Option<(String, String)> {
        let traces: Vec<Vec<String>> =
            workers.iter().map(|(trace, _)| trace.iter().map(ToString::to_string).collect()).collect();
        let offers: Vec<Offer<'_>> = traces
            .iter()
            .zip(workers)
            .map(|(trace, (_, solve))| Offer { trace, solve: (!solve.is_empty()).then_some(solve) })
            .collect();
        choose(backend, &offers).map(|lane| (lane.trace, lane.solve))
    }

    #[test]
    fn auto_prefers_a_gpu_that_a_worker_prefers() {
        let found = lane(Backend::Auto, &[(&["cpu"], "a"), (&["cpu"], "a"), (&["gpu:x:1", "cpu"], "a")]);
        assert_eq!(found, Some(("gpu:x:1".into(), "a".into())));
        let software = lane(Backend::Auto, &[(&["cpu", "gpu:lavapipe:1"], "a")]);
        assert_eq!(software, Some(("cpu".into(), "a".into())));
        let asked = lane(Backend::Gpu, &[(&["cpu", "gpu:lavapipe:1"], "a")]);
        assert_eq!(asked, Some(("gpu:lavapipe:1".into(), "a".into())));
    }

    #[test]
    fn most_workers_can_help_and_roles_may_be_apart() {
        let found = lane(Backend::Cpu, &[(&["cpu"], ""), (&[], "a"), (&[], "b"), (&[], "b")]);
        assert_eq!(found, Some(("cpu".into(), "b".into())));
        assert_eq!(lane(Backend::Cpu, &[(&["cpu"], "")]), None);
        assert_eq!(lane(Backend::Gpu, &[(&["cpu"], "a")]), None);
        let tie = lane(Backend::Cpu, &[(&["cpu"], "b"), (&["cpu"], "a")]);
        assert_eq!(tie, Some(("cpu".into(), "b".into())));
    }

    #[test]
    fn mixed_is_a_lane_of_its_own_once_somebody_traces() {
        let mixed = Some((MIXED_LANE.to_owned(), "a".to_owned()));
        assert_eq!(lane(Backend::Mixed, &[(&["cpu"], "a")]), mixed);
        assert_eq!(lane(Backend::Mixed, &[(&["gpu:x:1"], ""), (&[], "a")]), mixed);
        assert_eq!(lane(Backend::Mixed, &[(&[], "a")]), None);
        assert!(why_none(Backend::Mixed, &[Offer { trace: &[], solve: Some("a") }]).contains("`trace`"));
    }
}
