//! What must not harm the solve, each against the clean mesh's answer: the same cases small in the tests of this
//! crate and whole in `kiln bench solve --stress`.

mod crowds;
mod faces;
mod holes;
mod scales;
mod shapes;

use crate::BenchError;
use kiln_solve::SolveError;

/// How large the meshes of the cases are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    /// Seconds for all together.
    Small,
    /// A million components, a vertex of 10⁵ faces, meshes of 90,000 vertices.
    Whole,
}

impl Size {
    /// Vertices along a side of the clean mesh.
    fn side(self) -> u32 {
        self.pick(24, 300)
    }

    fn pick<T>(self, small: T, whole: T) -> T {
        match self {
            Self::Small => small,
            Self::Whole => whole,
        }
    }
}

/// One figure and the bound that it must keep.
#[derive(Clone, Debug, PartialEq)]
pub struct Check {
    /// What it is, with its unit if it has one.
    pub what: String,
    /// What was found.
    pub value: f64,
    /// The most it may be.
    pub limit: f64,
}

impl Check {
    fn new(what: impl Into<String>, value: f64, limit: f64) -> Self {
        Self { what: what.into(), value, limit }
    }

    /// Whether the bound is kept; not by what is not a number.
    pub fn holds(&self) -> bool {
        self.value <= self.limit
    }
}

/// One kind of harm.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// What is wrong with the mesh.
    pub name: &'static str,
    run: fn(Size) -> Result<Vec<Check>, SolveError>,
}

impl Case {
    /// Solves the harmed mesh and the clean one and compares.
    ///
    /// # Errors
    /// [`SolveError`] if the solve refuses a mesh of the case, which it must not.
    pub fn checks(&self, size: Size) -> Result<Vec<Check>, SolveError> {
        (self.run)(size)
    }
}

/// All cases, without exclusions.
pub const CASES: [Case; 20] = [
    Case { name: "faces without area", run: faces::without_area },
    Case { name: "faces twice", run: faces::twice },
    Case { name: "vertices of no face", run: faces::unused_vertices },
    Case { name: "faces without samples", run: holes::faces_without_samples },
    Case { name: "patches of two triangles, one sample each", run: crowds::pairs_with_one_sample },
    Case { name: "a column of slivers", run: scales::sliver_column },
    Case { name: "nothing but slivers", run: scales::all_slivers },
    Case { name: "scale 1e-3 and 1e4", run: scales::other_scale },
    Case { name: "two scales in one mesh", run: scales::two_scales },
    Case { name: "sizes from 1 mm to 1 km in one component", run: scales::graded },
    Case { name: "a huge face over a tiny mesh", run: scales::huge_next_to_tiny },
    Case { name: "1e7 m from the origin", run: scales::far_away },
    Case { name: "one sample in ten is not valid", run: holes::dropped_samples },
    Case { name: "a hole of 8 × 8 m", run: holes::hole },
    Case { name: "holes of all sizes", run: holes::iterations },
    Case { name: "fans on an edge", run: faces::fans },
    Case { name: "inverted windings", run: faces::inverted },
    Case { name: "a Möbius strip", run: faces::moebius },
    Case { name: "very many tiny components", run: crowds::tiny_components },
    Case { name: "one vertex of very many faces", run: crowds::one_vertex },
];

/// Runs all cases and prints a line for each.
///
/// # Errors
/// [`BenchError::Failed`] naming the cases that do not hold, after all have run.
pub fn run(size: Size, print: &mut dyn FnMut(&str)) -> Result<(), BenchError> {
    let mut broken = Vec::new();
    for case in &CASES {
        let start = std::time::Instant::now();
        let checks = case.checks(size);
        let holds = checks.as_ref().is_ok_and(|checks| checks.iter().all(Check::holds));
        let figures = match &checks {
            Ok(checks) => checks.iter().map(figure).collect::<Vec<_>>().join("; "),
            Err(error) => error.to_string(),
        };
        let verdict = if holds { "holds" } else { "BROKEN" };
        print(&format!("{verdict}  {} ({:.1} s): {figures}", case.name, start.elapsed().as_secs_f64()));
        if !holds {
            broken.push(case.name);
        }
    }
    if broken.is_empty() {
        return Ok(());
    }
    Err(BenchError::Failed { step: "stress suite", reason: format!("these do not hold: {}", broken.join(", ")) })
}

fn figure(check: &Check) -> String {
    format!("{} {:.3e} (at most {:.3e})", check.what, check.value, check.limit)
}
