//! Connected components of the surface, and the linear system of each.

use crate::{assemble::Assembly, matrix::LowerCsc, surface::Surface, system::ComponentSystem, weld::DisjointSets};
use std::borrow::Cow;

/// The unknowns that faces use, by component.
#[derive(Clone, Debug)]
pub struct Components {
    /// Unknowns, those of one component together and rising; components in the order of their lowest unknown.
    unknown: Vec<u32>,
    /// Start of each component in `unknown`, and the end.
    start: Vec<u32>,
    /// Place of each unknown within its component; meaningless for unknowns that no face uses.
    local: Vec<u32>,
}

impl Components {
    /// Finds the components of a surface: faces that share a corner belong together.
    pub fn new(surface: &Surface) -> Self {
        let n = surface.unknown_count();
        let mut sets = DisjointSets::new(n);
        let mut used = vec![false; n];
        for &[a, b, c] in &surface.corners {
            sets.unite(a, b);
            sets.unite(b, c);
            [a, b, c].iter().for_each(|u| used[*u as usize] = true);
        }
        Self::of_sets(sets, &used)
    }

    /// Finds the components of a matrix whose unknowns are all used: those of the surface that it was made for.
    pub fn of_matrix(matrix: &LowerCsc) -> Self {
        let mut sets = DisjointSets::new(matrix.len());
        for column in 0..matrix.len() {
            let (rows, _) = matrix.column(column);
            rows[1..].iter().for_each(|row| sets.unite(column as u32, *row));
        }
        Self::of_sets(sets, &vec![true; matrix.len()])
    }

    fn of_sets(mut sets: DisjointSets, used: &[bool]) -> Self {
        // Roots are lowest members, so numbering roots in order numbers components by their lowest unknown.
        let n = used.len();
        let mut component = vec![u32::MAX; n];
        let mut start = vec![0u32];
        for unknown in (0..n).filter(|u| used[*u]) {
            let root = sets.root(unknown as u32) as usize;
            if root == unknown {
                component[unknown] = start.len() as u32 - 1;
                start.push(0);
            }
            component[unknown] = component[root];
            start[component[unknown] as usize + 1] += 1;
        }
        Self::from_sizes(component, start)
    }

    fn from_sizes(component: Vec<u32>, mut start: Vec<u32>) -> Self {
        for i in 1..start.len() {
            start[i] += start[i - 1];
        }
        let mut unknown = vec![0; start.last().map_or(0, |end| *end as usize)];
        let mut size = vec![0u32; start.len() - 1];
        // The component number is not needed after its unknown's place is known.
        let mut local = component;
        for (u, slot) in local.iter_mut().enumerate().filter(|(_, component)| **component != u32::MAX) {
            let component = *slot as usize;
            *slot = size[component];
            unknown[(start[component] + *slot) as usize] = u as u32;
            size[component] += 1;
        }
        Self { unknown, start, local }
    }

    /// Number of components.
    pub fn count(&self) -> usize {
        self.start.len() - 1
    }

    /// The unknowns of a component, rising.
    pub fn unknowns(&self, component: usize) -> &[u32] {
        &self.unknown[self.start[component] as usize..self.start[component + 1] as usize]
    }

    /// Number of unknowns in all components.
    pub fn unknown_count(&self) -> usize {
        self.unknown.len()
    }

    /// The system of one component, out of that of all; all of it is borrowed if there is no more.
    pub fn part<'a>(&self, component: usize, whole: &'a ComponentSystem<'_>) -> ComponentSystem<'a> {
        if self.unknowns(component).len() == whole.len() {
            return whole.borrowed();
        }
        let mut part = ComponentSystem::default();
        self.part_into(component, whole, &mut part);
        part
    }

    /// The system of one component, out of that of all, put into the room of another.
    pub(crate) fn part_into(&self, component: usize, whole: &ComponentSystem<'_>, part: &mut ComponentSystem<'_>) {
        let unknowns = self.unknowns(component);
        let columns = whole.columns;
        let LowerCsc { column_start, row, value } = part.matrix.to_mut();
        let rhs = part.rhs.to_mut();
        column_start.clear();
        row.clear();
        value.clear();
        rhs.clear();
        column_start.push(0);
        for unknown in unknowns.iter().map(|u| *u as usize) {
            let (rows, values) = whole.matrix.column(unknown);
            // Places rise with unknowns, so rows stay in order.
            row.extend(rows.iter().map(|row| self.local[*row as usize]));
            value.extend_from_slice(values);
            column_start.push(row.len() as u32);
            rhs.extend_from_slice(&whole.rhs[unknown * columns..(unknown + 1) * columns]);
        }
        let (anchor, hole_ring) = (part.anchor.to_mut(), part.hole_ring.to_mut());
        anchor.clear();
        anchor.extend(unknowns.iter().map(|u| whole.anchor[*u as usize]));
        hole_ring.clear();
        hole_ring.extend(unknowns.iter().map(|u| whole.hole_ring[*u as usize]));
        part.columns = columns;
    }
}

/// The system of all of an instance's unknowns.
pub fn assembly_system(assembly: &Assembly) -> ComponentSystem<'_> {
    ComponentSystem {
        matrix: Cow::Borrowed(&assembly.matrix),
        anchor: Cow::Borrowed(&assembly.anchor),
        rhs: Cow::Borrowed(&assembly.rhs),
        columns: assembly.columns(),
        hole_ring: Cow::Borrowed(&assembly.hole_ring),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_that_share_a_corner_are_together() {
        let corners = vec![[5, 6, 7], [1, 2, 3], [3, 8, 9]];
        let surface =
            Surface { points: vec![Default::default(); 11], areas: vec![1.0; 3], mesh_face: vec![0, 1, 2], corners };
        let components = Components::new(&surface);
        assert_eq!(components.count(), 2);
        assert_eq!(components.unknowns(0), [1, 2, 3, 8, 9]);
        assert_eq!(components.unknowns(1), [5, 6, 7]);
        assert_eq!(components.unknown_count(), 8);
        assert_eq!([1, 2, 3, 8, 9].map(|u: usize| components.local[u]), [0, 1, 2, 3, 4]);
    }
}
