//! Tasks of visibility regions: what can be seen in them, and their models. A level without regions has none of these.

use crate::{PlanError, Planner, Reach};
use kiln_core::{DigestBuilder, ModelWork, Output, PlannedTask, Region, RegionsWork, SkipRule, TaskKind, Work};
use std::ops::Range;

/// Rays of one task of regions, about: those of one with all candidates, so that an edit of a region redoes no others.
const REGION_RAYS: u64 = 1 << 16;

/// Tasks of a level's regions, about, at most: where there are more regions than that, tasks have more of them.
const MOST_RUNS: u64 = 100_000;

impl Planner<'_> {
    /// Adds the tasks of the level's regions.
    pub(crate) fn add_regions(&mut self, reach: &Reach) -> Result<(), PlanError> {
        let regions = &self.level.regions;
        if regions.regions.is_empty() {
            return Ok(());
        }
        let runs = runs(&regions.regions, &|region| self.rays_of(region), reach);
        let samples = runs.into_iter().map(|run| self.add_region_run(run, reach)).collect::<Result<Vec<u32>, _>>()?;
        let work = ModelWork { region_count: regions.regions.len() as u32 };
        let mut family = DigestBuilder::new("kiln model family");
        family.integer(u64::from(TaskKind::Model.kernel_rev())).text(&self.lane.solve);
        for region in &regions.regions {
            family.value(&region.bounds);
        }
        family.value(&regions.edges).value(&regions.settings);
        family.integer(self.level.sampling.kernel.channel_count() as u64);
        let task = PlannedTask::new(Work::Model(work), family.finish(), work.points());
        self.graph.add(PlannedTask { output: Some(Output::Regions), ..task }, samples);
        Ok(())
    }

    fn rays_of(&self, region: &Region) -> u64 {
        self.level.regions.rays_of(region, !self.level.sampling.no_skip.contains(&SkipRule::Adaptive))
    }

    fn add_region_run(&mut self, run: Range<usize>, reach: &Reach) -> Result<u32, PlanError> {
        let (regions, s) = (&self.level.regions, &self.level.sampling);
        let rays = regions.settings.rays_per_point;
        let mut family = DigestBuilder::new("kiln regions family");
        family.integer(u64::from(TaskKind::Regions.kernel_rev())).text(&self.lane.trace);
        for region in &regions.regions[run.clone()] {
            family.value(&region.bounds).value(&region.valid);
        }
        family.integer(u64::from(rays)).value(&s.kernel).float(regions.settings.back_face_limit).integer(s.seed);
        family.value(&s.foliage).value(&s.no_skip);
        let surroundings = Some(self.surroundings_of(reach.group_of_region(run.start), run.start)?);
        let cost = regions.regions[run.clone()].iter().map(|region| self.rays_of(region)).sum();
        let work = RegionsWork { first: run.start as u32, count: run.len() as u32 };
        let task = PlannedTask::new(Work::Regions(work), family.finish(), cost);
        Ok(self.graph.add(PlannedTask { surroundings, ..task }, []))
    }
}

/// Regions that follow one another and have the same surroundings, as many together as make a task.
fn runs(regions: &[Region], rays_of: &dyn Fn(&Region) -> u64, reach: &Reach) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    let all = regions.iter().map(rays_of).sum::<u64>();
    let most = REGION_RAYS.max(all / MOST_RUNS);
    let mut rays = 0;
    for (index, region) in regions.iter().enumerate() {
        let more = rays_of(region);
        let group = reach.group_of_region(index);
        match runs.last_mut() {
            Some(run) if reach.group_of_region(run.start) == group && rays + more <= most => {
                run.end = index + 1;
                rays += more;
            }
            _ => {
                runs.push(index..index + 1);
                rays = more;
            }
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{graph, level};
    use glam::DVec3;
    use kiln_core::{Bounds, CandidateBits, Digest, Level, RegionEdge, Regions, TaskGraph};

    fn with_regions(xs: &[f64]) -> Level {
        let region = |x: &f64| {
            let min = DVec3::new(*x, 0.0, 0.0);
            Region { id: format!("at {x}"), bounds: Bounds { min, max: min + 1.0 }, valid: None }
        };
        Level { regions: Regions { regions: xs.iter().map(region).collect(), ..Regions::default() }, ..level() }
    }

    fn tasks(graph: &TaskGraph) -> Vec<(&PlannedTask, RegionsWork)> {
        let of = |task: &PlannedTask| if let Work::Regions(work) = task.work { Some(work) } else { None };
        graph.tasks.iter().filter_map(|task| Some((task, of(task)?))).collect()
    }

    #[test]
    fn a_level_has_tasks_for_its_regions_and_none_without() {
        let graph = graph(&with_regions(&[0.0, 1.0, 2.0]));
        graph.check(Digest::default()).unwrap();
        let found: Vec<RegionsWork> = tasks(&graph).into_iter().map(|(_, work)| work).collect();
        assert_eq!(found, [0, 1, 2].map(|first| RegionsWork { first, count: 1 }));
        let model = graph.tasks.last().unwrap();
        assert_eq!(model.work, Work::Model(ModelWork { region_count: 3 }));
        assert_eq!((model.output, graph.inputs_of(graph.tasks.len() as u32 - 1).len()), (Some(Output::Regions), 3));
        let without = crate::tests::graph(&level());
        assert_eq!(without.tasks.len() + 4, graph.tasks.len());
        assert_eq!(without.tasks[..], graph.tasks[..without.tasks.len()], "other tasks stay as they are");
    }

    #[test]
    fn small_regions_share_a_task() {
        let mut level = with_regions(&[0.0, 0.1, 0.2, 0.3]);
        let mut bits = CandidateBits::default();
        (0..30).for_each(|index| bits.insert(index));
        level.regions.regions.iter_mut().for_each(|region| region.valid = Some(bits));
        let graph = graph(&level);
        let found: Vec<RegionsWork> = tasks(&graph).into_iter().map(|(_, work)| work).collect();
        assert_eq!(found, [RegionsWork { first: 0, count: 2 }, RegionsWork { first: 2, count: 2 }]);
        assert_eq!(
            graph.tasks.iter().filter(|task| task.work.kind() == TaskKind::Regions).map(|t| t.cost).sum::<u64>(),
            4 * 30 * 1024
        );
    }

    #[test]
    fn keys_are_of_what_a_region_sees_and_of_nothing_else() {
        let base = with_regions(&[0.0, 1.0]);
        let keys = |level: &Level| {
            let graph = graph(level);
            let mut keys: Vec<_> = tasks(&graph).into_iter().map(|(task, _)| graph.key(task, &[])).collect();
            keys.push(graph.key(graph.tasks.last().unwrap(), &[]));
            keys
        };
        let same = |changed: &Level| keys(&base).iter().zip(keys(changed)).map(|(a, b)| *a == b).collect::<Vec<_>>();
        let change = |change: fn(&mut Level)| {
            let mut changed = base.clone();
            change(&mut changed);
            same(&changed)
        };
        assert_eq!(change(|level| level.regions.regions[0].id = "other".into()), [true, true, true]);
        assert_eq!(change(|level| level.regions.regions[0].bounds.max.x += 0.1), [false, true, false]);
        assert_eq!(change(|level| level.regions.settings.smoothing = 2.0), [true, true, false]);
        assert_eq!(change(|level| level.regions.settings.rays_per_point = 2048), [false, false, false]);
        assert_eq!(change(|level| level.sampling.seed = 9), [false, false, true]);
        assert_eq!(change(|level| level.instances[0].world_from_object.translation.x += 1e-9), [false, false, true]);
        let edge = RegionEdge { regions: [0, 1], area_m2: 1.0, center: DVec3::X };
        let mut joined = base.clone();
        joined.regions.edges.push(edge);
        assert_eq!(same(&joined), [true, true, false]);
    }

    #[test]
    fn what_only_regions_see_is_loaded() {
        let mut level = with_regions(&[500.0]);
        level.sampling.kernel = kiln_core::Kernel::Obscurance { half_distances_m: vec![2.0] };
        level.instances.iter_mut().for_each(|instance| instance.receives = false);
        level.instances[1].world_from_object.translation.x = 502.0;
        let seen: Vec<Bounds> = level.instances.iter().map(|i| crate::tests::seen(&level, i)).collect();
        assert_eq!(Reach::new(&level, &seen).is_reached(), [false, true, false]);
    }
}
