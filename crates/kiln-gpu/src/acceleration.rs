//! Acceleration structures of boxes, as the driver builds them: one for each mesh, and one over the instances.

use crate::{
    GpuDevice,
    boxes::{BoxCorners, Boxes},
    upload::Upload,
};
use bytemuck::cast_slice;
use kiln_trace::TraceError;

/// Instances that a structure can tell apart: the index that comes back has 24 bits.
const MOST_INSTANCES: u32 = 1 << 24;

const FLAGS: wgpu::AccelerationStructureFlags = wgpu::AccelerationStructureFlags::PREFER_FAST_TRACE;
const MODE: wgpu::AccelerationStructureUpdateMode = wgpu::AccelerationStructureUpdateMode::Build;

/// Builds everything and waits for it. What the result names it keeps alive.
pub(crate) fn build(gpu: &GpuDevice, boxes: &Boxes<'_>) -> Result<wgpu::Tlas, TraceError> {
    let limits = gpu.limits();
    check(gpu, "instances of ray queries", boxes.placed.len(), limits.max_tlas_instance_count)?;
    let greatest = boxes.placed.iter().map(|placed| placed.index as usize + 1).max().unwrap_or(0);
    check(gpu, "indices of instances of ray queries", greatest, MOST_INSTANCES)?;
    let bottoms = (0..boxes.mesh_count()).map(|mesh| {
        let of_mesh = boxes.of_mesh(mesh);
        if of_mesh.is_empty() { Ok(None) } else { bottom(gpu, &of_mesh).map(Some) }
    });
    let bottoms: Vec<Option<wgpu::Blas>> = bottoms.collect::<Result<_, _>>()?;
    top(gpu, boxes, &bottoms)
}

/// Says what is too large before the driver is asked.
fn check(gpu: &GpuDevice, what: &'static str, needed: usize, most: u32) -> Result<(), TraceError> {
    if needed as u64 > u64::from(most) {
        return Err(gpu.too_many(what, needed as u64, u64::from(most)));
    }
    Ok(())
}

/// The structure of a mesh.
#[expect(clippy::cast_possible_truncation, reason = "below the limit of primitives, which has 32 bits")]
fn bottom(gpu: &GpuDevice, corners: &[BoxCorners]) -> Result<wgpu::Blas, TraceError> {
    check(gpu, "boxes of a mesh for ray queries", corners.len(), gpu.limits().max_blas_primitive_count)?;
    let size = wgpu::BlasAABBGeometrySizeDescriptor {
        primitive_count: corners.len() as u32,
        flags: wgpu::AccelerationStructureGeometryFlags::empty(),
    };
    let bytes = size_of_val(corners) as u64;
    let usage = wgpu::BufferUsages::BLAS_INPUT | wgpu::BufferUsages::COPY_DST;
    let buffer = gpu.create_buffer("the boxes of a mesh", bytes, usage)?;
    let buffers = [buffer];
    let mut upload = Upload::new(gpu, &buffers, bytes);
    upload.write(cast_slice(corners))?;
    upload.finish()?;
    let blas = gpu.create("the structure of a mesh", bytes, || {
        let sizes = wgpu::BlasGeometrySizeDescriptors::AABBs { descriptors: vec![size.clone()] };
        let descriptor = wgpu::CreateBlasDescriptor { label: Some("mesh"), flags: FLAGS, update_mode: MODE };
        gpu.device.create_blas(&descriptor, sizes)
    })?;
    let geometry = wgpu::BlasAabbGeometry {
        size: &size,
        stride: size_of::<BoxCorners>() as u64,
        aabb_buffer: &buffers[0],
        primitive_offset: 0,
    };
    let geometry = wgpu::BlasGeometries::AabbGeometries(vec![geometry]);
    let entry = wgpu::BlasBuildEntry { blas: &blas, geometry };
    submit(gpu, bytes, |encoder| encoder.build_acceleration_structures([&entry], []))?;
    Ok(blas)
}

/// The structure over the instances.
#[expect(clippy::cast_possible_truncation, reason = "below the limit of instances, which has 32 bits")]
fn top(gpu: &GpuDevice, boxes: &Boxes<'_>, bottoms: &[Option<wgpu::Blas>]) -> Result<wgpu::Tlas, TraceError> {
    let count = boxes.placed.len().max(1) as u32;
    let bytes = u64::from(count) * 64;
    let mut tlas = gpu.create("the structure of instances", bytes, || {
        gpu.device.create_tlas(&wgpu::CreateTlasDescriptor {
            label: Some("instances"),
            max_instances: count,
            flags: FLAGS,
            update_mode: MODE,
        })
    })?;
    for (at, placed) in boxes.placed.iter().enumerate() {
        let blas = bottoms[placed.mesh].as_ref();
        tlas[at] = blas.map(|blas| wgpu::TlasInstance::new(blas, placed.world_from_object, placed.index, 0xff));
    }
    submit(gpu, bytes, |encoder| encoder.build_acceleration_structures([], [&tlas]))?;
    Ok(tlas)
}

/// Has the device do something, and waits for it.
fn submit(gpu: &GpuDevice, bytes: u64, encode: impl FnOnce(&mut wgpu::CommandEncoder)) -> Result<(), TraceError> {
    gpu.create("building a structure", bytes, || {
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encode(&mut encoder);
        gpu.queue.submit([encoder.finish()]);
    })?;
    gpu.wait(None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AdapterChoice;

    #[test]
    fn what_exceeds_a_limit_is_said_with_numbers() {
        let gpu = GpuDevice::open(&AdapterChoice::Software).unwrap();
        let gpu = gpu.expect("this test needs a software Vulkan driver, such as mesa-vulkan-drivers");
        assert!(check(&gpu, "boxes", 7, 7).is_ok());
        let error = check(&gpu, "boxes", 8, 7).unwrap_err();
        assert!(matches!(error, TraceError::TooMany { what: "boxes", needed: 8, available: 7, .. }), "{error}");
        let said = error.to_string();
        assert!(said.contains(&gpu.adapter().name) && said.contains("leave --ray-queries away"), "{said}");
    }
}
