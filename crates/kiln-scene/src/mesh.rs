//! From a mesh of the document to Kiln's mesh: triangles of all primitives, one block of vertices for each
//! POSITION accessor, cleaned and in Morton order.

use crate::{
    SceneError,
    accessor::{Accessor, Component},
    clean::{Coordinates, Face, clean},
    cutout::PrimitiveMask,
    document::Document,
    extensions,
    json::Item,
    limits,
};
use glam::DVec3;
use kiln_core::{BakeSettings, Bounds, FaceGroup, Mask, Mesh, SkipRule, VertexBlock};
use std::sync::Arc;

const DROP: &str = "repair the mesh, or drop such faces with --drop-bad-faces";

/// How a primitive's corners make triangles (glTF 2.0, section 3.7.2.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Topology {
    List,
    Strip,
    Fan,
}

impl Topology {
    /// The topology of a primitive; nothing for points and lines.
    pub(crate) fn of(primitive: &Item<'_>) -> Result<Option<Self>, SceneError> {
        let Some(mode) = primitive.get("mode") else { return Ok(Some(Self::List)) };
        match mode.integer()? {
            0..=3 => Ok(None),
            4 => Ok(Some(Self::List)),
            5 => Ok(Some(Self::Strip)),
            6 => Ok(Some(Self::Fan)),
            other => Err(mode.invalid(format!("there is no primitive mode {other}"))),
        }
    }

    /// Number of triangles that a number of corners makes.
    pub(crate) const fn face_count(self, corners: usize) -> usize {
        match self {
            Self::List => corners / 3,
            Self::Strip | Self::Fan => corners.saturating_sub(2),
        }
    }

    /// Corners beyond the last whole triangle.
    const fn left_over(self, corners: usize) -> usize {
        match self {
            Self::List => corners % 3,
            Self::Strip | Self::Fan if corners < 3 => corners,
            Self::Strip | Self::Fan => 0,
        }
    }

    /// The corners of a triangle, counter-clockwise from the front.
    const fn corners(self, face: usize) -> [usize; 3] {
        match self {
            Self::List => [3 * face, 3 * face + 1, 3 * face + 2],
            Self::Strip => [face, face + 1 + face % 2, face + 2 - face % 2],
            Self::Fan => [face + 1, face + 2, 0],
        }
    }
}

/// A primitive with triangles, opened but not yet read.
pub(crate) struct Primitive<'d> {
    /// Index in the mesh.
    pub(crate) index: u32,
    topology: Topology,
    pub(crate) position: Accessor<'d>,
    normal: Option<Accessor<'d>>,
    indices: Option<Accessor<'d>>,
    /// What its faces are to the bake.
    pub(crate) group: FaceGroup,
    /// Where its faces are, if the group has a mask.
    pub(crate) mask: Option<PrimitiveMask<'d>>,
}

impl<'d> Primitive<'d> {
    /// Opens the accessors of a primitive that has triangles and positions.
    pub(crate) fn open(
        document: &'d Document<'_>,
        item: &Item<'d>,
        index: u32,
        topology: Topology,
        group: FaceGroup,
    ) -> Result<Self, SceneError> {
        extensions::check_primitive(item)?;
        let attributes = item.require("attributes")?;
        let open = |reference: Option<Item<'d>>| reference.map(|r| Accessor::open(document, &r)).transpose();
        let position = Accessor::open(document, &attributes.require("POSITION")?)?;
        position.expect_width(&[3])?;
        let normal = open(attributes.get("NORMAL"))?;
        if let Some(normal) = &normal {
            normal.expect_count(position.count, "POSITION")?;
        }
        Ok(Self { index, topology, position, normal, indices: open(item.get("indices"))?, group, mask: None })
    }

    /// Number of triangles, before cleaning.
    pub(crate) fn face_count(&self) -> usize {
        self.topology.face_count(self.corner_count())
    }

    fn corner_count(&self) -> usize {
        self.indices.as_ref().map_or(self.position.count, |indices| indices.count)
    }

    /// Whether a vertex is there. The greatest value of the indices' type never is: graphics interfaces take it as
    /// a restart of the primitive, and glTF forbids it.
    pub(crate) fn has_vertex(&self, vertex: u32) -> bool {
        (vertex as usize) < self.position.count && Some(vertex) != self.restart()
    }

    fn restart(&self) -> Option<u32> {
        match self.indices.as_ref()?.component {
            Component::U8 => Some(u32::from(u8::MAX)),
            Component::U16 => Some(u32::from(u16::MAX)),
            _ => Some(u32::MAX),
        }
    }

    /// All triangles, as vertices of the primitive's own POSITION accessor, not yet checked against its count.
    pub(crate) fn triangles(&self) -> Result<Vec<[u32; 3]>, SceneError> {
        let indices = self.indices.as_ref().map(Accessor::indices).transpose()?;
        let vertex = |corner: usize| indices.as_ref().map_or(corner as u32, |indices| indices[corner]);
        Ok((0..self.face_count()).map(|face| self.topology.corners(face).map(vertex)).collect())
    }

    /// The refusal of a triangle that refers to a vertex that isn't there.
    pub(crate) fn out_of_range(&self, vertex: u32) -> SceneError {
        let accessor = self.indices.as_ref().unwrap_or(&self.position);
        let problem = if Some(vertex) == self.restart() {
            format!("index {vertex} is the primitive restart value, which glTF doesn't permit")
        } else {
            format!("index {vertex} is out of range: there are {} vertices", self.position.count)
        };
        accessor.reference.invalid_with(problem, DROP)
    }
}

/// What was found in a mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Tally {
    pub(crate) non_finite: u64,
    pub(crate) out_of_range: u64,
    pub(crate) degenerate: u64,
    pub(crate) duplicate: u64,
    pub(crate) invalid_normals: u64,
    pub(crate) unreferenced: u64,
    pub(crate) left_over: u64,
}

/// A mesh that was read and cleaned.
pub(crate) struct Built {
    pub(crate) mesh: Mesh,
    pub(crate) blocks: Vec<VertexBlock>,
    /// Bounds of the faces; empty if there are none.
    pub(crate) bounds: Bounds,
    pub(crate) tally: Tally,
}

/// Reads and cleans a mesh from its opened primitives, none of which is ignored.
pub(crate) fn build(primitives: &[Primitive<'_>], settings: &BakeSettings) -> Result<Built, SceneError> {
    let mut builder = Builder {
        drop_bad_faces: settings.drop_bad_faces,
        keep_duplicates: settings.no_skip.contains(&SkipRule::Duplicates),
        ..Builder::default()
    };
    for primitive in primitives {
        builder.add(primitive)?;
    }
    Ok(builder.finish())
}

#[derive(Default)]
struct Builder {
    drop_bad_faces: bool,
    keep_duplicates: bool,
    mesh: Mesh,
    /// Index of the POSITION accessor of each block.
    accessors: Vec<usize>,
    blocks: Vec<VertexBlock>,
    faces: Vec<Face>,
    coordinates: Coordinates,
    /// Which vertices some face of the source uses.
    referenced: Vec<bool>,
    tally: Tally,
}

impl Builder {
    fn add(&mut self, primitive: &Primitive<'_>) -> Result<(), SceneError> {
        let block = match self.accessors.iter().position(|&index| index == primitive.position.index) {
            Some(block) => block,
            None => self.add_block(&primitive.position)?,
        };
        if primitive.group.receives {
            self.blocks[block].primitives.push(primitive.index);
        }
        let first = self.blocks[block].first_vertex as usize;
        let group = self.group(primitive);
        let coordinates = self.coordinates(primitive, first)?;
        self.tally.left_over += primitive.topology.left_over(primitive.corner_count()) as u64;
        let vertices = first..first + primitive.position.count;
        let before = primitive.normal.is_some().then(|| self.referenced[vertices.clone()].to_vec());
        for triangle in primitive.triangles()? {
            self.add_face(primitive, triangle, first, group, coordinates)?;
        }
        if let (Some(normal), Some(before)) = (&primitive.normal, before) {
            self.set_normals(normal, first, &before)?;
        }
        Ok(())
    }

    fn add_block(&mut self, position: &Accessor<'_>) -> Result<usize, SceneError> {
        let first_vertex = self.mesh.positions.len() as u32;
        let positions = position.vectors::<3>()?;
        // Adding zero makes -0.0 to 0.0, so that equal positions have equal bits.
        self.mesh.positions.extend(positions.iter().map(|p| p.map(|coordinate| coordinate + 0.0)));
        self.mesh.normals.resize(self.mesh.positions.len(), [0.0; 3]);
        self.referenced.resize(self.mesh.positions.len(), false);
        self.accessors.push(position.index);
        self.blocks.push(VertexBlock { first_vertex, vertex_count: position.count as u32, primitives: Vec::new() });
        Ok(self.blocks.len() - 1)
    }

    fn group(&mut self, primitive: &Primitive<'_>) -> u16 {
        let cutout = primitive.mask.as_ref().map(|mask| self.mask(&mask.mask));
        let group = FaceGroup { cutout, ..primitive.group.clone() };
        let known = self.mesh.groups.iter().position(|known| *known == group);
        known.unwrap_or_else(|| {
            self.mesh.groups.push(group);
            self.mesh.groups.len() - 1
        }) as u16
    }

    /// The index of a mask among those of the mesh.
    fn mask(&mut self, mask: &Arc<Mask>) -> u16 {
        let masks = &mut self.mesh.cutouts.masks;
        let known = masks.iter().position(|known| Arc::ptr_eq(known, mask) || known == mask);
        known.unwrap_or_else(|| {
            masks.push(Arc::clone(mask));
            masks.len() - 1
        }) as u16
    }

    /// The texture coordinates of a primitive's vertices, where they have a say.
    fn coordinates(&mut self, primitive: &Primitive<'_>, first_vertex: usize) -> Result<u16, SceneError> {
        let Some((accessor, transform)) = primitive.mask.as_ref().and_then(|mask| mask.coordinates.as_ref()) else {
            return Ok(Coordinates::NONE);
        };
        let values = accessor.vectors::<2>()?.into_iter().map(|uv| transform.apply(uv)).collect();
        self.coordinates.add(first_vertex as u32, values).map_err(|found| {
            let what = "texture coordinates of masked primitives of one mesh";
            accessor.reference.too_big(
                what,
                found,
                limits::VERTICES,
                "split the mesh, or join primitives of one material",
            )
        })
    }

    fn add_face(
        &mut self,
        primitive: &Primitive<'_>,
        triangle: [u32; 3],
        first: usize,
        group: u16,
        coordinates: u16,
    ) -> Result<(), SceneError> {
        if let Some(&vertex) = triangle.iter().find(|&&vertex| !primitive.has_vertex(vertex)) {
            self.tally.out_of_range += 1;
            return if self.drop_bad_faces { Ok(()) } else { Err(primitive.out_of_range(vertex)) };
        }
        let vertices = triangle.map(|vertex| vertex + first as u32);
        let is_bad = |vertex: &&u32| !self.mesh.positions[**vertex as usize].iter().all(|c| c.is_finite());
        if let Some(&vertex) = vertices.iter().find(is_bad) {
            self.tally.non_finite += 1;
            let at = self.mesh.positions[vertex as usize];
            let problem = format!("vertex {} is at {at:?}, which is not finite", vertex as usize - first);
            return if self.drop_bad_faces {
                Ok(())
            } else {
                Err(primitive.position.reference.invalid_with(problem, DROP))
            };
        }
        vertices.iter().for_each(|&vertex| self.referenced[vertex as usize] = true);
        self.faces.push(Face { vertices, group, coordinates });
        Ok(())
    }

    /// Sets the normals of the vertices that this primitive is the first to use.
    fn set_normals(&mut self, normal: &Accessor<'_>, first: usize, before: &[bool]) -> Result<(), SceneError> {
        let normals = normal.vectors::<3>()?;
        for (offset, source) in normals.into_iter().enumerate().filter(|(offset, _)| !before[*offset]) {
            if !self.referenced[first + offset] {
                continue;
            }
            match DVec3::from(source.map(f64::from)).try_normalize() {
                Some(unit) => self.mesh.normals[first + offset] = unit.as_vec3().to_array(),
                None => self.tally.invalid_normals += 1,
            }
        }
        Ok(())
    }

    fn finish(mut self) -> Built {
        self.tally.unreferenced = self.referenced.iter().filter(|referenced| !**referenced).count() as u64;
        for (position, _) in self.mesh.positions.iter_mut().zip(&self.referenced).filter(|(_, used)| !**used) {
            if !position.iter().all(|coordinate| coordinate.is_finite()) {
                *position = [0.0; 3];
            }
        }
        let cleaned = clean(&self.mesh.positions, &self.coordinates, self.faces, self.keep_duplicates);
        let has_mask = |face: &&Face| self.mesh.groups[usize::from(face.group)].cutout.is_some();
        let masked = cleaned.faces.iter().filter(has_mask);
        self.mesh.cutouts.corners = masked.map(|face| self.coordinates.of(face)).collect();
        self.tally.degenerate = cleaned.degenerate;
        self.tally.duplicate = cleaned.duplicate;
        self.mesh.face_group = cleaned.faces.iter().map(|face| face.group).collect();
        self.mesh.faces = cleaned.faces.into_iter().map(|face| face.vertices).collect();
        let bounds = cleaned.bounds.unwrap_or(Bounds::EMPTY);
        Built { mesh: self.mesh, blocks: self.blocks, bounds, tally: self.tally }
    }
}
