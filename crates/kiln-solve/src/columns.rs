//! Code that is compiled for each number of right-hand sides, so that loops over them are vector operations.

use crate::system::MAX_COLUMNS;

/// Work on `K` right-hand sides at once.
pub(crate) trait ForColumns {
    type Output;
    fn run<const K: usize>(self) -> Self::Output;
}

/// Runs the work for a number of columns, 1 to [`MAX_COLUMNS`]; nothing for other numbers.
pub(crate) fn for_columns<W: ForColumns>(columns: usize, work: W) -> Option<W::Output> {
    const { assert!(MAX_COLUMNS == 8) };
    Some(match columns {
        1 => work.run::<1>(),
        2 => work.run::<2>(),
        3 => work.run::<3>(),
        4 => work.run::<4>(),
        5 => work.run::<5>(),
        6 => work.run::<6>(),
        7 => work.run::<7>(),
        8 => work.run::<8>(),
        _ => return None,
    })
}
