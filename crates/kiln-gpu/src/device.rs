//! An open adapter: kernels are compiled and run here, one dispatch at a time.
//!
//! wgpu reports trouble in four ways, and each becomes a [`TraceError`]: errors of a call go to a handler (its default
//! would panic), the loss of the device to a callback, a failed mapping to the mapping's callback, and a loss that
//! is found while waiting to a panic inside wgpu, which is caught. A device that failed once is not used again.

use crate::{
    GpuError,
    adapter::{self, AdapterChoice, AdapterSummary},
    shader::{self, Entry, SceneShape},
};
use kiln_trace::TraceError;
use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc},
    time::{Duration, Instant},
};

/// Storage bindings that a kernel has for its input and its output.
pub(crate) const CALL_STORAGE_BUFFERS: u32 = 2;

/// A dispatch takes milliseconds; a driver that says nothing for so long does not answer at all.
const SILENCE: Duration = Duration::from_secs(120);

/// An adapter that has been opened. Tracers share it; calls may come from several threads at once and take turns.
#[derive(Debug)]
pub struct GpuDevice {
    adapter: AdapterSummary,
    limits: wgpu::Limits,
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    faults: Arc<Faults>,
    kernels: Mutex<BTreeMap<(Entry, SceneShape), Arc<CompiledKernel>>>,
    call: Mutex<CallBuffers>,
}

/// The first thing that went wrong with a device, for good.
#[derive(Debug, Default)]
struct Faults(Mutex<Option<String>>);

impl Faults {
    fn set(&self, reason: &str) {
        let one_line = reason.lines().map(str::trim).filter(|line| !line.is_empty()).collect::<Vec<_>>().join("; ");
        lock(&self.0).get_or_insert(one_line);
    }
}

/// A kernel with the layouts of its bind groups.
#[derive(Debug)]
pub(crate) struct CompiledKernel {
    pipeline: wgpu::ComputePipeline,
    call_layout: wgpu::BindGroupLayout,
}

/// One dispatch.
pub(crate) struct Call<'a> {
    pub(crate) kernel: &'a CompiledKernel,
    /// Group 1 of kernels that read a scene.
    pub(crate) scene: Option<&'a wgpu::BindGroup>,
    pub(crate) params: &'a [u8],
    pub(crate) input: &'a [u8],
    pub(crate) output_bytes: u64,
    pub(crate) workgroups: [u32; 2],
}

/// Buffers that grow with the calls and are used again.
#[derive(Debug, Default)]
struct CallBuffers {
    params: Option<wgpu::Buffer>,
    input: Option<wgpu::Buffer>,
    output: Option<wgpu::Buffer>,
    readback: Option<wgpu::Buffer>,
}

/// The data that these locks guard is right at every moment, so that a panic elsewhere does not matter.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl GpuDevice {
    /// Opens the adapter that is chosen. `None` where there is no such adapter, unless it was named.
    pub fn open(choice: &AdapterChoice) -> Result<Option<Arc<Self>>, GpuError> {
        let adapters = adapter::enumerate();
        let summaries: Vec<AdapterSummary> =
            adapters.iter().map(|adapter| AdapterSummary::of(&adapter.get_info())).collect();
        let Some(index) = choice.pick(&summaries) else {
            let AdapterChoice::Named(wanted) = choice else { return Ok(None) };
            let names: Vec<String> = summaries.iter().map(ToString::to_string).collect();
            let found = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
            return Err(GpuError::NotFound { wanted: wanted.clone(), found });
        };
        let adapter = &adapters[index];
        let summary = summaries[index].clone();
        // All that the adapter has: wgpu's defaults would cap a binding at 128 MiB.
        let limits = adapter.limits();
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("kiln"),
            required_features: wgpu::Features::empty(),
            required_limits: limits.clone(),
            memory_hints: wgpu::MemoryHints::MemoryUsage,
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| GpuError::Open { adapter: summary.name.clone(), reason: error.to_string() })?;
        let faults = Arc::new(Faults::default());
        let handler = Arc::clone(&faults);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| handler.set(&error.to_string())));
        let handler = Arc::clone(&faults);
        device.set_device_lost_callback(move |reason, message| handler.set(&format!("{reason:?}: {message}")));
        Ok(Some(Arc::new(Self {
            adapter: summary,
            limits,
            device,
            queue,
            faults,
            kernels: Mutex::default(),
            call: Mutex::default(),
        })))
    }

    /// The adapter.
    pub fn adapter(&self) -> &AdapterSummary {
        &self.adapter
    }

    /// The lane of its results; see [`AdapterSummary::lane`].
    pub fn lane(&self) -> String {
        self.adapter.lane()
    }

    /// Name, kind and driver in one line, for a person.
    pub fn describe(&self) -> String {
        self.adapter.to_string()
    }

    /// Gives up the device, as its loss would: every later call fails with [`TraceError::DeviceLost`].
    pub fn destroy(&self) {
        self.device.destroy();
        self.faults.set("it was destroyed");
    }

    pub(crate) fn limits(&self) -> &wgpu::Limits {
        &self.limits
    }

    pub(crate) fn lost(&self, reason: impl Into<String>) -> TraceError {
        TraceError::DeviceLost { adapter: self.adapter.name.clone(), reason: reason.into() }
    }

    pub(crate) fn too_large(&self, what: &'static str, needed: u64, available: u64) -> TraceError {
        TraceError::TooLarge { adapter: self.adapter.name.clone(), what, needed, available }
    }

    /// The fault that was found, if any.
    pub(crate) fn check(&self) -> Result<(), TraceError> {
        lock(&self.faults.0).clone().map_or(Ok(()), |reason| Err(self.lost(reason)))
    }

    /// Runs `make` and gives the error that it caused on this thread, if any.
    fn scoped<T>(&self, make: impl FnOnce() -> T) -> Result<T, wgpu::Error> {
        let scopes = [wgpu::ErrorFilter::OutOfMemory, wgpu::ErrorFilter::Validation, wgpu::ErrorFilter::Internal];
        let [memory, validation, internal] = scopes.map(|filter| self.device.push_error_scope(filter));
        let made = make();
        // The scopes end in reverse order.
        let errors = [internal, validation, memory].map(|scope| pollster::block_on(scope.pop()));
        errors.into_iter().flatten().next().map_or(Ok(made), Err)
    }

    /// A new buffer, or an error that says what was too large.
    pub(crate) fn create_buffer(
        &self,
        what: &'static str,
        size: u64,
        usage: wgpu::BufferUsages,
    ) -> Result<wgpu::Buffer, TraceError> {
        let most = if usage.contains(wgpu::BufferUsages::STORAGE) {
            self.limits.max_storage_buffer_binding_size.min(self.limits.max_buffer_size)
        } else {
            self.limits.max_buffer_size
        };
        if size > most {
            return Err(self.too_large(what, size, most));
        }
        let descriptor = wgpu::BufferDescriptor { label: Some(what), size, usage, mapped_at_creation: false };
        let buffer = self.scoped(|| self.device.create_buffer(&descriptor)).map_err(|error| match error {
            // How much there would have been is not known; less than was asked for.
            wgpu::Error::OutOfMemory { .. } => self.too_large(what, size, size - 1),
            other => self.lost(other.to_string()),
        })?;
        self.check()?;
        Ok(buffer)
    }

    /// The kernel for scenes of a shape; compiled once.
    pub(crate) fn kernel(&self, entry: Entry, shape: &SceneShape) -> Result<Arc<CompiledKernel>, GpuError> {
        let mut kernels = lock(&self.kernels);
        if let Some(kernel) = kernels.get(&(entry, *shape)) {
            return Ok(Arc::clone(kernel));
        }
        self.check()?;
        let kernel = self.scoped(|| self.compile(entry, shape)).map_err(|error| GpuError::Kernel {
            adapter: self.adapter.name.clone(),
            kernel: entry.name(),
            reason: error.to_string(),
        })?;
        self.check()?;
        let kernel = Arc::new(kernel);
        kernels.insert((entry, *shape), Arc::clone(&kernel));
        Ok(kernel)
    }

    fn compile(&self, entry: Entry, shape: &SceneShape) -> CompiledKernel {
        let device = &self.device;
        let label = Some(entry.name());
        let source = wgpu::ShaderSource::Wgsl(shader::source(entry, shape).into());
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor { label, source });
        let call_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label,
            entries: &[uniform_entry(0), storage_entry(1, true), storage_entry(2, false)],
        });
        let scene_layout = entry.is_traced().then(|| self.scene_layout(shape));
        let layouts = [Some(&call_layout), scene_layout.as_ref()];
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label,
            bind_group_layouts: if entry.is_traced() { &layouts } else { &layouts[..1] },
            immediate_size: 0,
        });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label,
            layout: Some(&layout),
            module: &module,
            entry_point: label,
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &[],
                zero_initialize_workgroup_memory: false,
            },
            cache: None,
        });
        CompiledKernel { pipeline, call_layout }
    }

    /// Group 1 of the kernels that read a scene; see [`shader`].
    pub(crate) fn scene_layout(&self, shape: &SceneShape) -> wgpu::BindGroupLayout {
        let geometry = (1..=shape.bindings).map(|binding| storage_entry(binding, true));
        let entries: Vec<_> = std::iter::once(uniform_entry(0)).chain(geometry).collect();
        let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some("scene"), entries: &entries };
        self.device.create_bind_group_layout(&descriptor)
    }

    /// Waits for everything that was submitted.
    pub(crate) fn wait(&self) -> Result<(), TraceError> {
        let wait = wgpu::PollType::Wait { submission_index: None, timeout: Some(SILENCE) };
        // wgpu 30 panics where the device is lost while it waits.
        match catch_unwind(AssertUnwindSafe(|| self.device.poll(wait))) {
            Ok(Ok(_)) => {}
            Ok(Err(error)) => self.faults.set(&error.to_string()),
            Err(_) => self.faults.set("the driver failed while its work was waited for"),
        }
        self.check()
    }

    /// Runs a kernel, gives its output to `read`, and returns the time that it took.
    pub(crate) fn run(&self, call: &Call, read: impl FnOnce(&[u8])) -> Result<Duration, TraceError> {
        let mut buffers = lock(&self.call);
        self.check()?;
        buffers.reserve(self, call)?;
        let (Some(params), Some(input), Some(output), Some(readback)) =
            (&buffers.params, &buffers.input, &buffers.output, &buffers.readback)
        else {
            return Err(self.lost("its buffers are missing"));
        };
        let start = Instant::now();
        self.queue.write_buffer(params, 0, call.params);
        self.queue.write_buffer(input, 0, call.input);
        let entries = [params, input, output].map(wgpu::Buffer::as_entire_binding);
        let entry = |(binding, resource)| wgpu::BindGroupEntry { binding, resource };
        let entries: Vec<_> = (0u32..).zip(entries).map(entry).collect();
        let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &call.kernel.call_layout,
            entries: &entries,
        });
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&call.kernel.pipeline);
            pass.set_bind_group(0, &group, &[]);
            if let Some(scene) = call.scene {
                pass.set_bind_group(1, scene, &[]);
            }
            pass.dispatch_workgroups(call.workgroups[0], call.workgroups[1], 1);
        }
        encoder.copy_buffer_to_buffer(output, 0, readback, 0, call.output_bytes);
        self.queue.submit([encoder.finish()]);
        self.read_back(readback, call.output_bytes, read)?;
        Ok(start.elapsed())
    }

    fn read_back(&self, buffer: &wgpu::Buffer, bytes: u64, read: impl FnOnce(&[u8])) -> Result<(), TraceError> {
        let (sender, receiver) = mpsc::channel();
        // Where nobody listens any more, nobody needs the answer.
        buffer.map_async(wgpu::MapMode::Read, ..bytes, move |result| drop(sender.send(result)));
        self.wait()?;
        let failed = |reason: String| {
            self.faults.set(&reason);
            self.lost(reason)
        };
        // Another thread that waits may have found the mapping done first; it then calls back in a moment.
        match receiver.recv_timeout(SILENCE) {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Err(failed(format!("results could not be mapped: {error}"))),
            Err(_) => return Err(failed("results were not mapped in time".to_owned())),
        }
        match buffer.get_mapped_range(..bytes) {
            Ok(view) => read(&view),
            Err(error) => return Err(failed(format!("results could not be read: {error}"))),
        }
        buffer.unmap();
        Ok(())
    }
}

impl CallBuffers {
    /// Makes room for a call.
    fn reserve(&mut self, gpu: &GpuDevice, call: &Call) -> Result<(), TraceError> {
        use wgpu::BufferUsages as Usage;
        let (params, input, output) = (call.params.len() as u64, call.input.len() as u64, call.output_bytes);
        grow(&mut self.params, gpu, "parameters", params, Usage::UNIFORM | Usage::COPY_DST)?;
        grow(&mut self.input, gpu, "the input of a dispatch", input, Usage::STORAGE | Usage::COPY_DST)?;
        grow(&mut self.output, gpu, "the output of a dispatch", output, Usage::STORAGE | Usage::COPY_SRC)?;
        grow(&mut self.readback, gpu, "the results of a dispatch", output, Usage::MAP_READ | Usage::COPY_DST)
    }
}

fn grow(
    buffer: &mut Option<wgpu::Buffer>,
    gpu: &GpuDevice,
    what: &'static str,
    bytes: u64,
    usage: wgpu::BufferUsages,
) -> Result<(), TraceError> {
    if buffer.as_ref().is_none_or(|buffer| buffer.size() < bytes) {
        *buffer = None;
        *buffer = Some(gpu.create_buffer(what, bytes.next_power_of_two().max(256), usage)?);
    }
    Ok(())
}

fn uniform_entry(binding: u32) -> wgpu::BindGroupLayoutEntry {
    layout_entry(binding, wgpu::BufferBindingType::Uniform)
}

fn storage_entry(binding: u32, read_only: bool) -> wgpu::BindGroupLayoutEntry {
    layout_entry(binding, wgpu::BufferBindingType::Storage { read_only })
}

fn layout_entry(binding: u32, ty: wgpu::BufferBindingType) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    }
}
