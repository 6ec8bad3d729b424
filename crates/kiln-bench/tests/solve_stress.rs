//! The stress suite of the solver in its small form.

use kiln_bench::{
    BenchError,
    solve::stress::{self, CASES, Check, Size},
};

#[test]
fn every_case_holds() -> Result<(), BenchError> {
    let mut lines = Vec::new();
    let result = stress::run(Size::Small, &mut |line| lines.push(line.to_owned()));
    assert_eq!(lines.len(), CASES.len(), "{lines:#?}");
    result.inspect_err(|_| assert!(lines.iter().any(|line| line.starts_with("BROKEN")), "{lines:#?}"))
}

#[test]
fn bounds_can_be_broken() {
    for (value, holds) in [(0.5, true), (1.0, true), (1.5, false), (f64::NAN, false), (f64::INFINITY, false)] {
        let check = Check { what: "figure".to_owned(), value, limit: 1.0 };
        assert_eq!(check.holds(), holds, "{value}");
    }
}
