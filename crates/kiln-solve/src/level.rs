//! Values for instances of which no face has a valid sample: those of the nearest vertex of the rest of the level.

use crate::nearest::KdTree;
use glam::{DAffine3, DVec3};
use kiln_core::{Mesh, Solution};
use rayon::prelude::*;

/// One instance of a level with its solution.
#[derive(Debug)]
pub struct LevelInstance<'a> {
    /// The mesh.
    pub mesh: &'a Mesh,
    /// The instance's transform.
    pub world_from_object: DAffine3,
    /// The solution, which has as many values as the mesh has vertices times channels.
    pub solution: &'a mut Solution,
}

/// Gives the vertices of unsampled instances the values of the nearest vertex that a face of a sampled instance
/// uses (exact; of equals the first instance and vertex). Returns how many vertices got values.
///
/// Where the whole level has no sampled instance, or numbers of channels differ, values stay as they are. The
/// [`Solution::unsampled`] flags stay too: they say where the values come from. A level without unsampled
/// instances costs nothing.
pub fn fill_unsampled(instances: &mut [LevelInstance<'_>]) -> u64 {
    let Some(channels) = instances.iter().find(|i| i.solution.unsampled).map(|i| i.solution.channels as usize) else {
        return 0;
    };
    let (sources, values) = sampled_vertices(instances, channels);
    let tree = KdTree::new(sources);
    let mut filled = 0;
    for instance in instances.iter_mut().filter(|i| i.solution.unsampled && i.solution.channels as usize == channels) {
        let world = instance.world_from_object;
        let nearest: Vec<_> = instance.mesh.positions.par_iter().map(|p| tree.nearest(point(&world, *p))).collect();
        for (target, found) in instance.solution.values.chunks_exact_mut(channels).zip(nearest) {
            let Some(found) = found else { continue };
            target.copy_from_slice(&values[found.index as usize * channels..][..channels]);
            filled += 1;
        }
    }
    filled
}

/// Positions and values of every vertex that faces of sampled instances use. Instances whose transform is not
/// finite, and vertices beyond the range of a `u32` index, are left out.
fn sampled_vertices(instances: &[LevelInstance<'_>], channels: usize) -> (Vec<(DVec3, u32)>, Vec<f32>) {
    let (mut sources, mut values) = (Vec::new(), Vec::new());
    for instance in instances.iter().filter(|i| !i.solution.unsampled && i.solution.channels as usize == channels) {
        let mut used = vec![false; instance.mesh.positions.len()];
        instance.mesh.faces.iter().flatten().for_each(|v| used[*v as usize] = true);
        let vertices = instance.mesh.positions.iter().zip(instance.solution.values.chunks_exact(channels)).zip(used);
        for ((position, value), _) in vertices.filter(|(_, used)| *used) {
            let world = point(&instance.world_from_object, *position);
            let Ok(index) = u32::try_from(sources.len()) else { break };
            if world.is_finite() {
                sources.push((world, index));
                values.extend_from_slice(value);
            }
        }
    }
    (sources, values)
}

fn point(world_from_object: &DAffine3, position: [f32; 3]) -> DVec3 {
    world_from_object.transform_point3(DVec3::from(position.map(f64::from)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_core::SolveSummary;

    fn triangle() -> Mesh {
        // The last vertex belongs to no face, so its value is nobody's surroundings.
        let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [50.0, 0.0, 0.0]];
        Mesh { positions, normals: vec![[0.0; 3]; 4], faces: vec![[0, 1, 2]], ..Mesh::default() }
    }

    fn solution(values: [f32; 4], unsampled: bool) -> Solution {
        let summary = SolveSummary::default();
        Solution { channels: 1, values: values.to_vec(), residuals: vec![0.0; 4], unsampled, summary }
    }

    fn fill(solutions: &mut [Solution], xs: &[f64]) -> u64 {
        let mesh = triangle();
        let mut instances: Vec<_> = solutions
            .iter_mut()
            .zip(xs)
            .map(|(solution, x)| LevelInstance {
                mesh: &mesh,
                world_from_object: DAffine3::from_translation(DVec3::X * *x),
                solution,
            })
            .collect();
        fill_unsampled(&mut instances)
    }

    #[test]
    fn takes_the_nearest_vertex_of_a_sampled_instance() {
        let sampled = [0.1, 0.2, 0.3, 0.4];
        let other = [0.5, 0.6, 0.7, 0.8];
        let mut solutions = [solution(sampled, false), solution([1.0; 4], true), solution(other, false)];
        assert_eq!(fill(&mut solutions, &[0.0, 40.0, 100.0]), 4);
        // At x = 40 and 41 vertex 1 of the first is nearest; at x = 90 vertex 0 of the third.
        assert_eq!(solutions[1].values, [0.2, 0.2, 0.2, 0.5]);
        assert_eq!((&solutions[0].values[..], &solutions[2].values[..]), (&sampled[..], &other[..]));
    }

    #[test]
    fn of_equals_the_first_instance() {
        let mut solutions = [solution([0.1; 4], false), solution([0.2; 4], false), solution([1.0; 4], true)];
        fill(&mut solutions, &[0.0, 0.0, 0.0]);
        assert_eq!(solutions[2].values, [0.1; 4]);
    }

    #[test]
    fn nothing_to_do_and_nothing_to_take() {
        assert_eq!(fill(&mut [solution([0.1; 4], false)], &[0.0]), 0);
        let mut alone = [solution([1.0; 4], true)];
        assert_eq!(fill(&mut alone, &[0.0]), 0);
        assert_eq!(alone[0].values, [1.0; 4]);
    }
}
