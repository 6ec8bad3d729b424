//! Trees in several surroundings: what `kiln bench trees` bakes.

use super::{
    builder::{Builder, Material, Mesh, Placement},
    lods::surfaces_of,
    surface::{Surface, lines},
};
use crate::{SceneError, SourceFiles, import};
use glam::{DVec3, dvec3};
use kiln_core::{BakeSettings, FoliageMode};
use serde_json::json;

/// From one plot to the next, in sizes of the largest model.
const PLOT: f64 = 6.0;

/// A level of trees. Each of the models has a name, the path of its level, and the files that this is in. In the level each model stands in four surroundings on a large ground: in the open, beside a wall, in a yard with walls
/// on all sides, and in a grove of its own kind. Nodes are named `MODEL_open`, `MODEL_wall`, `MODEL_yard` and `MODEL_grove`;
/// the others of a grove are `MODEL_other_0` and so on. All are of the class `tree`, by their extras.
///
/// # Errors
/// As [`import`].
pub fn planted<F: SourceFiles>(models: &[(&str, &str, &F)]) -> Result<Vec<u8>, SceneError> {
    let settings = BakeSettings { foliage: FoliageMode::Geometry, ..BakeSettings::default() };
    let mut builder = Builder::new();
    let leaves = builder.material("leaves", [0.2, 0.4, 0.1]);
    let both = builder.double_sided_material("leaves from both sides", [0.2, 0.4, 0.1]);
    let stone = builder.material("stone", [0.6, 0.6, 0.6]);
    let mut trees = Vec::new();
    for (name, level_name, files) in models {
        let source = import(level_name, *files, None, &settings)?;
        let surfaces = surfaces_of(&source);
        let parts: Vec<(&Surface, Material)> =
            surfaces.iter().zip([leaves, both]).filter(|(surface, _)| !surface.faces.is_empty()).collect();
        let points = surfaces.iter().flat_map(|surface| &surface.positions);
        let (low, high) = points.fold((DVec3::MAX, DVec3::MIN), |(low, high), p| (low.min(*p), high.max(*p)));
        if low.cmplt(high).all() {
            trees.push(Tree { name: (*name).to_owned(), mesh: builder.mesh(name, &parts), low, size: high - low });
        }
    }
    let largest = trees.iter().map(|tree| tree.size.max_element()).fold(1.0, f64::max);
    for (row, tree) in trees.iter().enumerate() {
        let plot = |column: usize| dvec3(column as f64, 0.0, row as f64) * PLOT * largest;
        tree.plant(&mut builder, stone, plot);
    }
    let reach = PLOT * largest * (trees.len().max(4) as f64 + 1.0);
    let steps = lines(-PLOT * largest, reach, largest);
    let ground = Surface::block(&steps, &[-1.0, 0.0], &steps);
    let ground = builder.mesh("ground", &[(&ground, stone)]);
    builder.node("ground", ground, Placement::ORIGIN);
    Ok(builder.finish("planted"))
}

struct Tree {
    name: String,
    mesh: Mesh,
    low: DVec3,
    size: DVec3,
}

impl Tree {
    fn plant(&self, builder: &mut Builder, stone: Material, plot: impl Fn(usize) -> DVec3) {
        let width = self.size.x.max(self.size.z);
        let wall_height = 0.8 * self.size.y;
        self.stand(builder, "open", plot(0), 0.0);

        self.stand(builder, "wall", plot(1), 0.0);
        self.wall(
            builder,
            stone,
            plot(1) + dvec3(-0.6 * width - 0.4, 0.0, -1.5 * width),
            dvec3(0.4, wall_height, 3.0 * width),
        );

        self.stand(builder, "yard", plot(2), 0.0);
        let half = 0.7 * width;
        for (corner, size) in [
            (dvec3(-half - 0.4, 0.0, -half), dvec3(0.4, wall_height, 2.0 * half)),
            (dvec3(half, 0.0, -half), dvec3(0.4, wall_height, 2.0 * half)),
            (dvec3(-half - 0.4, 0.0, -half - 0.4), dvec3(2.0 * half + 0.8, wall_height, 0.4)),
            (dvec3(-half - 0.4, 0.0, half), dvec3(2.0 * half + 0.8, wall_height, 0.4)),
        ] {
            self.wall(builder, stone, plot(2) + corner, size);
        }

        self.stand(builder, "grove", plot(3), 0.0);
        let around = [(1.0, 0.1), (-0.2, 0.9), (-0.9, -0.3), (0.3, -1.0)];
        for (other, (x, z)) in around.into_iter().enumerate() {
            let place = plot(3) + dvec3(x, 0.0, z) * 0.8 * width;
            self.stand(builder, &format!("other_{other}"), place, 70.0 * (other as f64 + 1.0));
        }
    }

    /// With its foot in the middle of its box, slightly in the ground.
    fn stand(&self, builder: &mut Builder, what: &str, place: DVec3, degrees: f64) {
        let middle = self.low + 0.5 * self.size;
        let turn = glam::DQuat::from_rotation_y(degrees.to_radians());
        let foot = turn * dvec3(middle.x, self.low.y, middle.z);
        let placement = Placement::at(place - foot).turned(degrees);
        let extras = json!({ "kiln": { "class": "tree" } });
        builder.node_with_extras(&format!("{}_{what}", self.name), self.mesh, placement, extras);
    }

    fn wall(&self, builder: &mut Builder, stone: Material, corner: DVec3, size: DVec3) {
        let side = |length: f64| lines(0.0, length, (length / 8.0).max(0.5).min(length));
        let wall = Surface::block(&side(size.x), &lines(-0.5, size.y, 0.5), &side(size.z));
        let mesh = builder.mesh("wall", &[(&wall, stone)]);
        builder.node(&format!("{}_wall_of_stone", self.name), mesh, Placement::at(corner));
    }
}
