//! Regions of small levels made by code.

use super::{
    cut::Demands,
    faces::connect,
    grid::Grid,
    links::links,
    merge::merge,
    profile::Span,
    split::split,
    touch::{CellBits, touched},
    voxels::{FREE, OPEN, Voxels},
    *,
};
use glam::{DMat3, DQuat};
use kiln_core::FaceGroup;
use kiln_trace::{CpuTracer, MeshBvh, Scene, SceneObject};
use proptest::prelude::*;
use std::{collections::BTreeMap, sync::Arc};

/// Quads, whose fronts are where their corners turn left; those of the second group have two.
#[derive(Default)]
struct Builder(Mesh);

impl Builder {
    fn quad(&mut self, corners: [[f32; 3]; 4], group: u16) -> &mut Self {
        let mesh = &mut self.0;
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(corners);
        mesh.normals.extend([[0.0, 1.0, 0.0]; 4]);
        mesh.faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        mesh.face_group.extend([group; 2]);
        self
    }

    /// A box that is seen from inside, or from outside.
    fn cuboid(&mut self, [x0, y0, z0]: [f32; 3], [x1, y1, z1]: [f32; 3], inside: bool) -> &mut Self {
        let quads = [
            [[x0, y0, z0], [x0, y0, z1], [x1, y0, z1], [x1, y0, z0]],
            [[x0, y1, z0], [x1, y1, z0], [x1, y1, z1], [x0, y1, z1]],
            [[x0, y0, z0], [x0, y1, z0], [x0, y1, z1], [x0, y0, z1]],
            [[x1, y0, z0], [x1, y0, z1], [x1, y1, z1], [x1, y1, z0]],
            [[x0, y0, z0], [x1, y0, z0], [x1, y1, z0], [x0, y1, z0]],
            [[x0, y0, z1], [x0, y1, z1], [x1, y1, z1], [x1, y0, z1]],
        ];
        for mut quad in quads {
            if !inside {
                quad.reverse();
            }
            self.quad(quad, 0);
        }
        self
    }

    /// A wall without thickness across x, with two sides.
    fn wall(&mut self, x: f32, [y0, y1]: [f32; 2], [z0, z1]: [f32; 2]) -> &mut Self {
        self.quad([[x, y0, z0], [x, y1, z0], [x, y1, z1], [x, y0, z1]], 1)
    }

    fn mesh(&mut self) -> Mesh {
        self.0.groups = vec![FaceGroup::PLAIN, FaceGroup { double_sided: true, ..FaceGroup::PLAIN }];
        std::mem::take(&mut self.0)
    }
}

/// Two rooms of 4 × 3 × 5 m beside each other, with a wall between them that may have a door of 1 × 2 m.
fn rooms(door: bool) -> Mesh {
    let mut builder = Builder::default();
    builder.cuboid([0.0, 0.0, 0.0], [8.0, 3.0, 5.0], true);
    if door {
        builder.wall(4.0, [0.0, 3.0], [0.0, 2.0]).wall(4.0, [0.0, 3.0], [3.0, 5.0]).wall(4.0, [2.0, 3.0], [2.0, 3.0]);
    } else {
        builder.wall(4.0, [0.0, 3.0], [0.0, 5.0]);
    }
    builder.mesh()
}

fn tracer(mesh: &Mesh, world_from_object: DAffine3) -> CpuTracer {
    let object = SceneObject { mesh: 0, world_from_object };
    CpuTracer::new(Arc::new(Scene::build(vec![Arc::new(MeshBvh::build(mesh))], &[object])))
}

fn make_at(mesh: &Mesh, world_from_object: DAffine3, settings: &MakeSettings) -> Result<MadeRegions, MakeError> {
    make_regions(&[SolidObject { mesh, world_from_object }], &tracer(mesh, world_from_object), settings)
}

fn make(mesh: &Mesh, settings: &MakeSettings) -> Result<MadeRegions, MakeError> {
    make_at(mesh, DAffine3::IDENTITY, settings)
}

fn quarter() -> MakeSettings {
    MakeSettings { cell_m: Some(0.25), max_edge_m: Some(8.0), ..MakeSettings::default() }
}

fn bounds_of(made: &MadeRegions) -> Vec<[[f64; 3]; 2]> {
    made.regions.iter().map(|region| [region.bounds.min.to_array(), region.bounds.max.to_array()]).collect()
}

const LEFT: [[f64; 3]; 2] = [[0.0, 0.0, 0.0], [4.0, 3.0, 5.0]];
const RIGHT: [[f64; 3]; 2] = [[4.0, 0.0, 0.0], [8.0, 3.0, 5.0]];

#[test]
fn two_rooms_meet_at_their_door() {
    let made = make(&rooms(true), &quarter()).unwrap();
    assert_eq!(bounds_of(&made), [LEFT, RIGHT]);
    assert_eq!(made.edges, [RegionEdge { regions: [0, 1], area_m2: 2.0, center: DVec3::new(4.0, 1.0, 2.5) }]);
    assert_eq!((made.regions[0].id.as_str(), made.summary.spaces, made.summary.unfinished), ("region_1", 1, 0));
    assert_eq!((made.summary.free_cells, made.summary.box_cells), (32 * 12 * 20, 32 * 12 * 20));
}

#[test]
fn a_wall_without_thickness_separates() {
    let made = make(&rooms(false), &quarter()).unwrap();
    assert_eq!(bounds_of(&made), [LEFT, RIGHT]);
    assert_eq!((made.edges.len(), made.summary.spaces), (0, 2));
    // Cells of half the wall's distance from another still do not see through it.
    let coarse = make(&rooms(false), &MakeSettings { cell_m: Some(0.7), ..quarter() }).unwrap();
    assert_eq!((coarse.regions.len(), coarse.edges.len()), (2, 0));
}

#[test]
fn a_closed_box_is_one_region() {
    let room = Builder::default().cuboid([-2.0, -1.0, 0.0], [2.0, 2.0, 6.0], true).mesh();
    let made = make(&room, &quarter()).unwrap();
    assert_eq!(bounds_of(&made), [[[-2.0, -1.0, 0.0], [2.0, 2.0, 6.0]]]);
    assert!(made.edges.is_empty());
    // And one that is solid is none, but for the air over it.
    let solid = Builder::default().cuboid([-2.0, -1.0, 0.0], [2.0, 2.0, 6.0], false).mesh();
    let made = make(&solid, &quarter()).unwrap();
    assert_eq!(bounds_of(&made), [[[-2.0, 2.0, 0.0], [2.0, 3.25, 6.0]]]);
    // Longer ones are parted evenly.
    let made = make(&room, &MakeSettings { max_edge_m: Some(3.0), ..quarter() }).unwrap();
    assert_eq!(made.regions.len(), 4);
    assert!(made.edges.iter().all(|edge| edge.area_m2 == 6.0 || edge.area_m2 == 9.0));
}

#[test]
fn the_outside_of_a_shell_is_left_out() {
    let mut shell = Builder::default().cuboid([-2.0, -1.0, 0.0], [2.0, 2.0, 6.0], true).mesh();
    shell.face_group.fill(1);
    let made = make(&shell, &quarter()).unwrap();
    assert_eq!(bounds_of(&made), [[[-2.0, -1.0, 0.0], [2.0, 2.0, 6.0]]]);
    assert_eq!((made.summary.shells, made.summary.back_facing), (1, [0, 0]));
}

#[test]
fn rooms_end_at_narrow_places() {
    // Two chambers of 8 × 8 × 8 cells, and a way between them.
    let rooms = |width: usize| {
        let grid = Grid { origin: DVec3::ZERO, cell_m: 1.0, size: [20, 10, 10] };
        let is_free = |[x, y, z]: [usize; 3]| {
            let within = |n: usize, from: usize, to: usize| (from..to).contains(&n);
            let is_way = within(y, 1, 1 + width) && within(z, 1, 1 + width);
            within(y, 1, 9) && within(z, 1, 9) && (within(x, 1, 9) || within(x, 11, 19) || within(x, 9, 11) && is_way)
        };
        let cell = |index: usize| {
            let place = grid.coordinates(index);
            let joins = |axis: &usize| {
                let mut next = place;
                next[*axis] += 1;
                next[*axis] < grid.size[*axis] && is_free(place) && is_free(next)
            };
            (0..3).filter(joins).fold(u8::from(is_free(place)) * FREE, |bits, axis| bits | OPEN[axis])
        };
        let mut voxels = Voxels::new(grid, (0..grid.len()).map(cell).collect());
        rooms::find_rooms(&mut voxels);
        voxels.rooms.sizes
    };
    assert_eq!(rooms(4).len(), 2);
    assert_eq!(rooms(4).iter().sum::<usize>(), 2 * 512 + 2 * 16);
    assert_eq!(rooms(6).len(), 1);
}

#[test]
fn furniture_leaves_a_room_whole() {
    let mut builder = Builder::default();
    builder.cuboid([0.0, 0.0, 0.0], [6.0, 3.0, 6.0], true);
    builder.cuboid([1.0, 0.0, 1.0], [3.0, 0.75, 2.0], false).cuboid([4.0, 0.0, 4.5], [5.0, 2.0, 6.0], false);
    let made = make(&builder.mesh(), &quarter()).unwrap();
    assert_eq!(bounds_of(&made), [[[0.0; 3], [6.0, 3.0, 6.0]]]);
    assert!(made.summary.free_cells < made.summary.box_cells);
}

#[test]
fn a_room_in_the_open_is_a_region_of_its_own() {
    let mut builder = Builder::default();
    builder.quad([[0.0, 0.0, 0.0], [0.0, 0.0, 20.0], [20.0, 0.0, 20.0], [20.0, 0.0, 0.0]], 0);
    // Four walls and a roof that are seen from both sides, and a door.
    builder.wall(6.0, [0.0, 3.0], [6.0, 11.0]);
    builder.wall(10.0, [0.0, 3.0], [6.0, 8.0]).wall(10.0, [0.0, 3.0], [9.0, 11.0]).wall(10.0, [2.0, 3.0], [8.0, 9.0]);
    for z in [6.0, 11.0] {
        builder.quad([[6.0, 0.0, z], [10.0, 0.0, z], [10.0, 3.0, z], [6.0, 3.0, z]], 1);
    }
    builder.quad([[6.0, 3.0, 6.0], [6.0, 3.0, 11.0], [10.0, 3.0, 11.0], [10.0, 3.0, 6.0]], 1);
    let settings = MakeSettings { height_m: Some(8.0), max_edge_m: Some(20.0), ..quarter() };
    let made = make(&builder.mesh(), &settings).unwrap();
    let bounds = bounds_of(&made);
    let room = bounds.iter().position(|bounds| *bounds == [[6.0, 0.0, 6.0], [10.0, 3.0, 11.0]]);
    let room = room.unwrap_or_else(|| panic!("{bounds:?}")) as u32;
    let doors: Vec<&RegionEdge> = made.edges.iter().filter(|edge| edge.regions.contains(&room)).collect();
    assert_eq!(doors.len(), 1, "{bounds:?}");
    assert_eq!((doors[0].area_m2, doors[0].center), (2.0, DVec3::new(10.0, 1.0, 8.5)));
    assert!(made.regions.len() < 12, "{bounds:?}");
}

#[test]
fn open_ground_has_air_up_to_a_height_and_nothing_under_it() {
    let mut builder = Builder::default();
    builder.quad([[0.0, 0.0, 0.0], [0.0, 0.0, 20.0], [20.0, 0.0, 20.0], [20.0, 0.0, 0.0]], 0);
    builder.cuboid([8.0, -1.0, 8.0], [12.0, 3.0, 12.0], false);
    let settings = MakeSettings { cell_m: Some(0.5), height_m: Some(4.0), max_edge_m: Some(10.0), ..quarter() };
    let made = make(&builder.mesh(), &settings).unwrap();
    let volume = made.summary.free_cells as f64 * 0.125;
    assert_eq!(volume, 400.0 * 4.0 - 16.0 * 3.0 + 16.0 * 3.0);
    assert!(made.regions.iter().all(|region| region.bounds.min.y >= 0.0 && region.bounds.max.y <= 7.0));
}

#[test]
fn tilted_levels_have_their_spaces() {
    let tilt = DQuat::from_euler(glam::EulerRot::YXZ, 0.5, 0.15, 0.1);
    let place = DAffine3::from_mat3_translation(DMat3::from_quat(tilt), DVec3::new(3.3, -1.7, 40.2));
    let volume = |made: &MadeRegions| made.summary.free_cells as f64 * 0.25f64.powi(3);
    let with_door = make_at(&rooms(true), place, &quarter()).unwrap();
    assert_eq!(with_door.summary.spaces, 1);
    assert!((volume(&with_door) - 120.0).abs() < 4.0, "{}", volume(&with_door));
    assert!(with_door.regions.len() < 60, "{}", with_door.regions.len());
    let without = make_at(&rooms(false), place, &quarter()).unwrap();
    assert_eq!(without.summary.spaces, 2);
    assert!((volume(&without) - 120.0).abs() < 4.0);
}

#[test]
fn seeds_choose_spaces() {
    let seeded = |seeds: &[[f64; 3]]| {
        let seeds = seeds.iter().map(|seed| DVec3::from(*seed)).collect();
        make(&rooms(false), &MakeSettings { seeds, ..quarter() })
    };
    assert_eq!(bounds_of(&seeded(&[[6.0, 1.0, 2.0]]).unwrap()), [RIGHT]);
    assert_eq!(seeded(&[[6.0, 0.0, 2.0], [1.0, 1.0, 1.0]]).unwrap().regions.len(), 2);
    assert!(matches!(seeded(&[[6.0, 1.0, 2.0], [9.0, 9.0, 9.0]]), Err(MakeError::SeedOutside { index: 1 })));
    assert!(matches!(seeded(&[[6.0, 3.4, 2.0]]), Err(MakeError::SeedBlocked { index: 0 })));
}

#[test]
fn what_cannot_be_is_refused() {
    let none = make_regions(&[], &tracer(&rooms(true), DAffine3::IDENTITY), &quarter());
    assert!(matches!(none, Err(MakeError::NothingSolid)));
    let fine = make(&rooms(true), &MakeSettings { cell_m: Some(1e-4), ..quarter() }).unwrap_err();
    assert!(fine.to_string().contains("use --cell 0.01"), "{fine}");
    // A floor that is seen from below only.
    let floor = Builder::default().quad([[0.0; 3], [9.0, 0.0, 0.0], [9.0, 0.0, 9.0], [0.0, 0.0, 9.0]], 0).mesh();
    let nothing = make(&floor, &quarter()).unwrap_err();
    assert!(nothing.to_string().contains("--seed-point"), "{nothing}");
    let one = make(&rooms(true), &MakeSettings { max_regions: 1, ..quarter() }).unwrap();
    assert_eq!((one.regions.len(), one.summary.unfinished), (1, 1));
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let place = DAffine3::from_rotation_y(0.3);
        pool.install(|| make_at(&rooms(true), place, &MakeSettings { cell_m: Some(0.1), ..quarter() }).unwrap())
    };
    assert_eq!(on(1), on(3));
}

/// Cells by random bits, of which none joins what is beyond the lattice.
fn voxels(size: [usize; 3], bits: &[u8]) -> Voxels {
    let grid = Grid { origin: DVec3::new(-1.0, 2.0, 0.5), cell_m: 0.5, size };
    let cell = |index: usize| {
        let place = grid.coordinates(index);
        let ends = (0..3).filter(|axis| place[*axis] + 1 == size[*axis]).fold(0, |ends, axis| ends | OPEN[axis]);
        // Mostly free, and mostly open.
        let bits = bits[index % bits.len()].rotate_left((index % 7) as u32);
        let free = if bits.is_multiple_of(5) { 0 } else { FREE };
        let open = (0..3).filter(|axis| bits >> (2 * axis) & 3 != 3).fold(0, |open, axis| open | OPEN[axis]);
        (free | open) & !ends
    };
    let mut voxels = Voxels::new(grid, (0..grid.len()).map(cell).collect());
    rooms::find_rooms(&mut voxels);
    voxels
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn boxes_part_all_free_cells(
        size in prop::array::uniform3(2usize..14),
        bits in proptest::collection::vec(any::<u8>(), 200..400),
        edge in 2usize..10,
        most in 1usize..400,
    ) {
        let voxels = voxels(size, &bits);
        let parts = split(&voxels, edge, most);
        prop_assert!(parts.boxes.len() <= most);
        let before = parts.boxes.len();
        let boxes = merge(&voxels, parts.boxes, edge);
        prop_assert!(boxes.len() <= before);
        for (index, a) in boxes.iter().enumerate() {
            prop_assert!(parts.unfinished > 0 || (0..3).all(|axis| a.extent(axis) <= edge));
            prop_assert!(boxes[..index].iter().all(|b| !a.overlaps(b)));
        }
        let holders = |cell: [usize; 3]| {
            let holds = |span: &&Span| (0..3).all(|axis| (span.min[axis]..span.max[axis]).contains(&cell[axis]));
            boxes.iter().filter(holds).count()
        };
        for index in (0..voxels.cells.len()).filter(|index| voxels.is_free(*index)) {
            prop_assert_eq!(holders(voxels.grid.coordinates(index)), 1);
        }
        check_links(&voxels, &boxes)?;
    }

    /// Where no surface is near, rays find nothing: all faces give the same.
    #[test]
    fn faces_without_a_surface_are_open(
        corners in proptest::collection::vec(prop::array::uniform3(0.0f32..4.0), 3..18),
    ) {
        let mut mesh = Mesh { positions: corners.clone(), normals: vec![[0.0, 1.0, 0.0]; corners.len()], ..Mesh::default() };
        mesh.faces = (0..corners.len() as u32 / 3).map(|face| [3 * face, 3 * face + 1, 3 * face + 2]).collect();
        mesh.face_group = vec![0; mesh.faces.len()];
        mesh.groups = vec![FaceGroup::PLAIN];
        let objects = [SolidObject { mesh: &mesh, world_from_object: DAffine3::IDENTITY }];
        let grid = Grid { origin: DVec3::splat(-0.51), cell_m: 0.37, size: [13, 14, 13] };
        let tracer = tracer(&mesh, DAffine3::IDENTITY);
        let some = connect(grid, &touched(&grid, &objects), &tracer).unwrap();
        let all = connect(grid, &CellBits::all(grid.len()), &tracer).unwrap();
        prop_assert_eq!(some.cells, all.cells);
    }
}

/// Links are those of all pairs of neighbours, and edges what they say.
fn check_links(voxels: &Voxels, boxes: &[Span]) -> Result<(), TestCaseError> {
    let grid = &voxels.grid;
    let box_of = |cell: [usize; 3]| {
        let holds = |span: &Span| (0..3).all(|axis| (span.min[axis]..span.max[axis]).contains(&cell[axis]));
        boxes.iter().position(holds).unwrap() as u32
    };
    let mut expected: BTreeMap<[u32; 2], (u64, DVec3)> = BTreeMap::new();
    for index in (0..voxels.cells.len()).filter(|index| voxels.is_free(*index)) {
        voxels.for_neighbours(index, |other| {
            let cells = [index, other].map(|index| grid.coordinates(index));
            let [a, b] = cells.map(box_of);
            // Each face is found from both sides: what is symmetrical is counted once.
            if a < b {
                let entry = expected.entry([a, b]).or_default();
                entry.0 += 1;
                entry.1 += 0.5 * (grid.center(cells[0]) + grid.center(cells[1]));
            }
        });
    }
    let found = links(voxels, boxes);
    prop_assert_eq!(found.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>());
    for (edge, (faces, sum)) in links::edges(voxels, boxes).iter().zip(expected.values()) {
        prop_assert_eq!(edge.area_m2, *faces as f64 * grid.cell_m.powi(2));
        prop_assert!((edge.center - *sum / *faces as f64).length() < 1e-9);
    }
    Ok(())
}

#[test]
fn small_boxes_may_waste_more() {
    let demands = Demands::usual(32);
    let cube = |edge: usize| Span { min: [0; 3], max: [edge; 3] };
    assert!(demands.fill(&cube(4)) < demands.fill(&cube(16)));
    assert_eq!(demands.fill(&cube(32)), demands.fill(&cube(64)));
}
