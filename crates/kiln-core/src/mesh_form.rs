//! How meshes are encoded: what has no cutouts has no byte for them, so that its digest is what it was before there were any.

use crate::{Class, Cutouts, FaceGroup, Foliage, Mesh};
use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{Error, SeqAccess, Visitor},
    ser::SerializeTuple,
};
use std::fmt;

/// A [`FaceGroup`] as it is encoded.
#[derive(Serialize, Deserialize)]
pub(crate) struct GroupForm {
    class: Class,
    double_sided: bool,
    occludes: bool,
    foliage: FoliageForm,
    receives: bool,
    max_samples_per_face: Option<u32>,
}

/// The first two are encoded as the two of an `Option`.
#[derive(Serialize, Deserialize)]
enum FoliageForm {
    None,
    Some(Foliage),
    Cutout(u16, Option<Foliage>),
}

impl From<FaceGroup> for GroupForm {
    fn from(group: FaceGroup) -> Self {
        let foliage = match (group.cutout, group.foliage) {
            (Some(mask), foliage) => FoliageForm::Cutout(mask, foliage),
            (None, Some(foliage)) => FoliageForm::Some(foliage),
            (None, None) => FoliageForm::None,
        };
        let FaceGroup { class, double_sided, occludes, receives, max_samples_per_face, .. } = group;
        Self { class, double_sided, occludes, foliage, receives, max_samples_per_face }
    }
}

impl From<GroupForm> for FaceGroup {
    fn from(form: GroupForm) -> Self {
        let (cutout, foliage) = match form.foliage {
            FoliageForm::None => (None, None),
            FoliageForm::Some(foliage) => (None, Some(foliage)),
            FoliageForm::Cutout(mask, foliage) => (Some(mask), foliage),
        };
        let GroupForm { class, double_sided, occludes, receives, max_samples_per_face, .. } = form;
        Self { class, double_sided, occludes, foliage, cutout, receives, max_samples_per_face }
    }
}

/// Lists of a mesh without cutouts.
const LISTS: usize = 5;

fn has_cutouts(groups: &[FaceGroup]) -> bool {
    groups.iter().any(|group| group.cutout.is_some())
}

impl Serialize for Mesh {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let has_cutouts = has_cutouts(&self.groups);
        let mut lists = serializer.serialize_tuple(LISTS + usize::from(has_cutouts))?;
        lists.serialize_element(&self.positions)?;
        lists.serialize_element(&self.normals)?;
        lists.serialize_element(&self.faces)?;
        lists.serialize_element(&self.face_group)?;
        lists.serialize_element(&self.groups)?;
        if has_cutouts {
            lists.serialize_element(&self.cutouts)?;
        }
        lists.end()
    }
}

impl<'de> Deserialize<'de> for Mesh {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_tuple(LISTS + 1, MeshVisitor)
    }
}

struct MeshVisitor;

impl<'de> Visitor<'de> for MeshVisitor {
    type Value = Mesh;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the lists of a mesh")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut lists: A) -> Result<Mesh, A::Error> {
        let mut mesh = Mesh {
            positions: next(&mut lists)?,
            normals: next(&mut lists)?,
            faces: next(&mut lists)?,
            face_group: next(&mut lists)?,
            groups: next(&mut lists)?,
            cutouts: Cutouts::default(),
        };
        if has_cutouts(&mesh.groups) {
            mesh.cutouts = next(&mut lists)?;
        }
        Ok(mesh)
    }
}

fn next<'de, A: SeqAccess<'de>, T: Deserialize<'de>>(lists: &mut A) -> Result<T, A::Error> {
    lists.next_element()?.ok_or_else(|| A::Error::custom("a list of the mesh is missing"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Density, Mask, OpticalDepth, codec};

    #[derive(Serialize)]
    struct PlainGroup {
        class: Class,
        double_sided: bool,
        occludes: bool,
        foliage: Option<Foliage>,
        receives: bool,
        max_samples_per_face: Option<u32>,
    }

    #[derive(Serialize)]
    struct PlainMesh {
        positions: Vec<[f32; 3]>,
        normals: Vec<[f32; 3]>,
        faces: Vec<[u32; 3]>,
        face_group: Vec<u16>,
        groups: Vec<PlainGroup>,
    }

    fn mesh(foliage: Option<Foliage>, cutout: Option<u16>) -> Mesh {
        let group = FaceGroup { foliage, cutout, max_samples_per_face: Some(3), ..FaceGroup::PLAIN };
        let masks = vec![Mask::uniform(true).into()];
        let cutouts = Cutouts { masks, corners: vec![[[0.25; 2], [1.0, 0.0], [f32::INFINITY, 3.0]]] };
        Mesh {
            positions: vec![[1.0, 2.0, 3.0]; 3],
            normals: vec![[0.0, 1.0, 0.0]; 3],
            faces: vec![[0, 1, 2]],
            face_group: vec![0],
            groups: vec![group],
            cutouts: if cutout.is_some() { cutouts } else { Cutouts::default() },
        }
    }

    const FOLIAGE: [Option<Foliage>; 3] =
        [None, Some(Foliage::Crossing(OpticalDepth(77))), Some(Foliage::Fog(Some(Density { per_m: 0.5 })))];

    #[test]
    fn without_cutouts_the_bytes_are_those_of_plain_lists() {
        for foliage in FOLIAGE {
            let Mesh { positions, normals, faces, face_group, groups, .. } = mesh(foliage, None);
            let plain = |group: &FaceGroup| PlainGroup {
                class: group.class,
                double_sided: group.double_sided,
                occludes: group.occludes,
                foliage: group.foliage,
                receives: group.receives,
                max_samples_per_face: group.max_samples_per_face,
            };
            let groups = groups.iter().map(plain).collect();
            let plain = PlainMesh { positions, normals, faces, face_group, groups };
            assert_eq!(codec::encode(&mesh(foliage, None)), codec::encode(&plain));
        }
    }

    #[test]
    fn bytes_and_back() {
        for (foliage, cutout) in FOLIAGE.into_iter().flat_map(|foliage| [(foliage, None), (foliage, Some(0))]) {
            let mesh = mesh(foliage, cutout);
            let bytes = codec::encode(&mesh);
            assert_eq!(codec::decode::<Mesh>("a mesh", &bytes).unwrap(), mesh);
            assert!(codec::decode::<Mesh>("a mesh", &bytes[..bytes.len() - 1]).is_err());
            let longer: Vec<u8> = bytes.iter().copied().chain([0]).collect();
            assert!(codec::decode::<Mesh>("a mesh", &longer).is_err());
        }
    }
}
