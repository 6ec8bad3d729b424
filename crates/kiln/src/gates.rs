//! Quality gates of the sidecar, for CI: checked against the result, written as JUnit.

use kiln_core::BakeSummary;
use kiln_scene::Gates;
use std::fmt::Write;

/// One gate and whether it was met.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Verdict {
    pub(crate) name: &'static str,
    pub(crate) limit: f64,
    pub(crate) found: f64,
}

impl Verdict {
    /// Whether the gate was met; a number that is not finite never meets one.
    pub(crate) fn is_met(&self) -> bool {
        self.found <= self.limit
    }

    fn message(&self) -> String {
        format!("{} is {:.6}, the limit is {:.6}", self.name, self.found, self.limit)
    }
}

/// Checks each gate that the sidecar sets.
pub(crate) fn check(gates: &Gates, summary: &BakeSummary, seconds: f64) -> Vec<Verdict> {
    let rmse = summary.error.iter().map(|e| e.rmse).fold(0.0, f64::max);
    let invalid = summary.trace.invalid as f64 / (summary.trace.samples.max(1)) as f64;
    let all = [
        ("max_rmse", gates.max_rmse, rmse),
        ("max_invalid_fraction", gates.max_invalid_fraction, invalid),
        ("max_bake_secs", gates.max_bake_secs, seconds),
    ];
    all.into_iter().filter_map(|(name, limit, found)| Some(Verdict { name, limit: limit?, found })).collect()
}

/// The gates that were missed, in one sentence; `None` if all were met.
pub(crate) fn missed(verdicts: &[Verdict]) -> Option<String> {
    let missed: Vec<String> = verdicts.iter().filter(|v| !v.is_met()).map(Verdict::message).collect();
    (!missed.is_empty()).then(|| format!("quality gates missed: {}", missed.join("; ")))
}

/// JUnit: the bake itself is the first test case, each gate a further one. `failure` is what went wrong with the bake.
pub(crate) fn junit(level: &str, seconds: f64, failure: Option<&str>, verdicts: &[Verdict]) -> String {
    let failures = usize::from(failure.is_some()) + verdicts.iter().filter(|v| !v.is_met()).count();
    let mut xml = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuite name=\"kiln bake\" tests=\"{}\" failures=\"{failures}\" time=\"{seconds:.3}\">\n",
        verdicts.len() + 1
    );
    let mut case = |name: &str, message: Option<&str>| {
        let _ = write!(xml, "  <testcase classname=\"{}\" name=\"{}\"", escape(level), escape(name));
        let _ = match message {
            Some(message) => writeln!(xml, "><failure message=\"{}\"/></testcase>", escape(message)),
            None => writeln!(xml, "/>"),
        };
    };
    case("bake", failure);
    for verdict in verdicts {
        let message = verdict.message();
        case(verdict.name, (!verdict.is_met()).then_some(message.as_str()));
    }
    xml + "</testsuite>\n"
}

fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\n' => escaped.push_str("&#10;"),
            c if c.is_control() => escaped.push('\u{fffd}'),
            c => escaped.push(c),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gates_are_met_or_named() {
        let met = Verdict { name: "max_rmse", limit: 0.01, found: 0.009 };
        let over = Verdict { found: 0.011, ..met.clone() };
        let unknown = Verdict { found: f64::NAN, ..met.clone() };
        assert_eq!(missed(std::slice::from_ref(&met)), None);
        assert!(missed(&[met, over.clone()]).unwrap().contains("max_rmse is 0.011"));
        assert!(missed(&[unknown]).is_some());
        let xml = junit("a<b>&\"c\".glb", 1.5, None, &[over]);
        assert!(xml.contains("tests=\"2\" failures=\"1\"") && xml.contains("a&lt;b&gt;&amp;&quot;c&quot;.glb"));
        assert!(junit("x", 0.0, Some("refused"), &[]).contains("failures=\"1\""));
    }
}
