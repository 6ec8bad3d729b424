//! Runs cases on a software Vulkan driver.

use std::sync::mpsc;
use wgpu::util::{BufferInitDescriptor, DeviceExt};

/// Words of a case's arguments and results; `cases.wgsl` has the same.
const ARGUMENTS: usize = 95;
const RESULTS: usize = 16;

/// Arguments of a case: which function, then floats and whole numbers as their bits.
pub(crate) struct Case(Vec<u32>);

impl Case {
    pub(crate) fn new(function: u32) -> Self {
        Self(vec![function])
    }

    pub(crate) fn words(mut self, words: &[u32]) -> Self {
        self.0.extend(words);
        self
    }

    pub(crate) fn floats(mut self, floats: &[f32]) -> Self {
        self.0.extend(floats.iter().map(|float| float.to_bits()));
        self
    }
}

/// Results of cases, as bits.
pub(crate) fn evaluate(cases: Vec<Case>) -> Vec<[u32; RESULTS]> {
    let count = cases.len();
    let pad = |case: Case| {
        assert!(case.0.len() <= 1 + ARGUMENTS, "a case has more arguments than there is room for");
        let mut words = case.0;
        words.resize(1 + ARGUMENTS, 0);
        words
    };
    let words: Vec<u32> = cases.into_iter().flat_map(pad).collect();
    let bytes = run(bytemuck::cast_slice(&words), count);
    let results: Vec<u32> = bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    results.chunks_exact(RESULTS).map(|chunk| chunk.try_into().expect("a chunk is that long")).collect()
}

fn software_device() -> (wgpu::Device, wgpu::Queue) {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends: wgpu::Backends::VULKAN,
        flags: wgpu::InstanceFlags::empty(),
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    });
    let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::VULKAN));
    let software = adapters.into_iter().find(|adapter| adapter.get_info().device_type == wgpu::DeviceType::Cpu);
    let adapter =
        software.expect("this test needs a software Vulkan driver; on Debian: apt-get install -y mesa-vulkan-drivers");
    pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor::default())).expect("the software driver opens")
}

fn run(arguments: &[u8], count: usize) -> Vec<u8> {
    let (device, queue) = software_device();
    let source = format!("{}{}", kiln_runtime::shaders::WGSL, include_str!("cases.wgsl"));
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("cases"),
        source: wgpu::ShaderSource::Wgsl(source.into()),
    });
    let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some("cases"),
        layout: None,
        module: &module,
        entry_point: Some("evaluate"),
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    });
    let usage = wgpu::BufferUsages::STORAGE;
    let input = device.create_buffer_init(&BufferInitDescriptor { label: None, contents: arguments, usage });
    let size = (count * RESULTS * 4) as u64;
    let buffer =
        |usage| device.create_buffer(&wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false });
    let output = buffer(wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC);
    let readback = buffer(wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
    let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &pipeline.get_bind_group_layout(0),
        entries: &[
            wgpu::BindGroupEntry { binding: 0, resource: input.as_entire_binding() },
            wgpu::BindGroupEntry { binding: 1, resource: output.as_entire_binding() },
        ],
    });
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(count.div_ceil(64) as u32, 1, 1);
    }
    encoder.copy_buffer_to_buffer(&output, 0, &readback, 0, size);
    queue.submit([encoder.finish()]);
    let (sender, mapped) = mpsc::channel();
    readback.map_async(wgpu::MapMode::Read, .., move |result| drop(sender.send(result)));
    device.poll(wgpu::PollType::Wait { submission_index: None, timeout: None }).expect("the device works");
    mapped.recv().expect("it is mapped").expect("it can be mapped");
    readback.get_mapped_range(..).expect("it is mapped").to_vec()
}
