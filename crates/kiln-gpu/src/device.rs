//! An open adapter: kernels are compiled here; [`crate::flight`] runs them.
//!
//! wgpu reports trouble in four ways, and each becomes a [`TraceError`]: errors of a call go to a handler (its default
//! would panic), the loss of the device to a callback, a failed mapping to the mapping's callback, and a loss that
//! is found while waiting to a panic inside wgpu, which is caught. A device that failed once is not used again.

use crate::{
    DeviceOptions, GpuError,
    adapter::{self, AdapterChoice, AdapterSummary},
    experimental,
    flight::{Call, Flights, Pipeline},
    ray_query,
    shader::{self, Entry, SceneShape},
};
use kiln_trace::TraceError;
use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

/// Storage bindings that a kernel has for its input and its output.
pub(crate) const CALL_STORAGE_BUFFERS: u32 = 2;

/// A dispatch takes milliseconds; a driver that says nothing for so long does not answer at all.
pub(crate) const SILENCE: Duration = Duration::from_secs(120);

/// An adapter that has been opened. Tracers share it; calls may come from several threads at once.
#[derive(Debug)]
pub struct GpuDevice {
    adapter: AdapterSummary,
    limits: wgpu::Limits,
    has_subgroups: bool,
    has_ray_queries: bool,
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    faults: Arc<Faults>,
    kernels: Mutex<BTreeMap<(Entry, SceneShape), Arc<CompiledKernel>>>,
    flights: Flights,
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
    pub(crate) pipeline: wgpu::ComputePipeline,
    pub(crate) call_layout: wgpu::BindGroupLayout,
}

/// The data that these locks guard is right at every moment, so that a panic elsewhere does not matter.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl GpuDevice {
    /// Opens the adapter that is chosen. `None` where there is no such adapter, unless it was named.
    pub fn open(choice: &AdapterChoice) -> Result<Option<Arc<Self>>, GpuError> {
        Self::open_with(choice, DeviceOptions::default())
    }

    /// As [`GpuDevice::open`], with options. A device that ends loops too soon is refused; with ray queries a small scene is traced both ways,
    /// and one on which the results differ is refused, too.
    pub fn open_with(choice: &AdapterChoice, options: DeviceOptions) -> Result<Option<Arc<Self>>, GpuError> {
        let adapters = adapter::enumerate();
        let summaries: Vec<AdapterSummary> =
            adapters.iter().map(|adapter| AdapterSummary::of(&adapter.get_info())).collect();
        let Some(index) = choice.pick(&summaries) else {
            let AdapterChoice::Named(wanted) = choice else { return Ok(None) };
            let names: Vec<String> = summaries.iter().map(ToString::to_string).collect();
            let found = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
            return Err(GpuError::NotFound { wanted: wanted.clone(), found });
        };
        let device = Self::open_adapter(&adapters[index], &summaries[index], options)?;
        device.check_loops()?;
        if options.ray_queries {
            ray_query::check(&device)?;
        }
        Ok(Some(device))
    }

    fn open_adapter(
        adapter: &wgpu::Adapter,
        summary: &AdapterSummary,
        options: DeviceOptions,
    ) -> Result<Arc<Self>, GpuError> {
        let mut wanted = wgpu::Features::empty();
        wanted.set(wgpu::Features::SUBGROUP, options.subgroups);
        wanted.set(wgpu::Features::EXPERIMENTAL_RAY_QUERY, options.ray_queries);
        let features = wanted & adapter.features();
        // All that the adapter has: wgpu's defaults would cap a binding at 128 MiB.
        let limits = adapter.limits();
        let missing = options.ray_queries.then(|| ray_query::missing(features, &limits)).flatten();
        if let Some(missing) = missing {
            return Err(GpuError::NoRayQueries { adapter: summary.to_string(), missing });
        }
        let disabled = wgpu::ExperimentalFeatures::disabled;
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("kiln"),
            required_features: features,
            required_limits: limits.clone(),
            memory_hints: wgpu::MemoryHints::MemoryUsage,
            experimental_features: if options.ray_queries { experimental::consent() } else { disabled() },
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| GpuError::Open { adapter: summary.name.clone(), reason: error.to_string() })?;
        let faults = Arc::new(Faults::default());
        let handler = Arc::clone(&faults);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| handler.set(&error.to_string())));
        let handler = Arc::clone(&faults);
        device.set_device_lost_callback(move |reason, message| handler.set(&format!("{reason:?}: {message}")));
        Ok(Arc::new(Self {
            adapter: summary.clone(),
            limits,
            has_subgroups: features.contains(wgpu::Features::SUBGROUP),
            has_ray_queries: options.ray_queries,
            device,
            queue,
            faults,
            kernels: Mutex::default(),
            flights: Flights::new(),
        }))
    }

    /// The adapter.
    pub fn adapter(&self) -> &AdapterSummary {
        &self.adapter
    }

    /// The lane of its results; see [`AdapterSummary::lane`].
    pub fn lane(&self) -> String {
        self.adapter.lane()
    }

    /// Whether kernels use subgroup operations.
    pub fn has_subgroups(&self) -> bool {
        self.has_subgroups
    }

    /// Whether tracers use hardware ray queries.
    pub fn has_ray_queries(&self) -> bool {
        self.has_ray_queries
    }

    /// Name, kind and driver in one line, for a person, and whether ray queries are used.
    pub fn describe(&self) -> String {
        format!("{}{}", self.adapter, if self.has_ray_queries { " with ray queries" } else { "" })
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

    pub(crate) fn too_many(&self, what: &'static str, needed: u64, available: u64) -> TraceError {
        TraceError::TooMany { adapter: self.adapter.name.clone(), what, needed, available }
    }

    /// The fault that was found, if any.
    pub(crate) fn check(&self) -> Result<(), TraceError> {
        lock(&self.faults.0).clone().map_or(Ok(()), |reason| Err(self.lost(reason)))
    }

    /// Takes note of a fault and makes an error of it.
    pub(crate) fn fail(&self, reason: String) -> TraceError {
        self.faults.set(&reason);
        self.lost(reason)
    }

    pub(crate) fn flights(&self) -> &Flights {
        &self.flights
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
        self.create(what, size, || self.device.create_buffer(&descriptor))
    }

    /// Something of about `size` bytes that `make` creates, or an error that says that it was too large.
    pub(crate) fn create<T>(&self, what: &'static str, size: u64, make: impl FnOnce() -> T) -> Result<T, TraceError> {
        let made = self.scoped(make).map_err(|error| match error {
            // How much there would have been is not known; less than was asked for.
            wgpu::Error::OutOfMemory { .. } => self.too_large(what, size, size.saturating_sub(1)),
            other => self.lost(other.to_string()),
        })?;
        self.check()?;
        Ok(made)
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
        let source = wgpu::ShaderSource::Wgsl(shader::source(entry, shape, self.has_subgroups).into());
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
        let structure = shape.ray_queries.then(|| structure_entry(shape.structure_binding()));
        let entries: Vec<_> = std::iter::once(uniform_entry(0)).chain(geometry).chain(structure).collect();
        let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some("scene"), entries: &entries };
        self.device.create_bind_group_layout(&descriptor)
    }

    /// Waits for a submission, or for everything that was submitted.
    pub(crate) fn wait(&self, submission_index: Option<wgpu::SubmissionIndex>) -> Result<(), TraceError> {
        let wait = wgpu::PollType::Wait { submission_index, timeout: Some(SILENCE) };
        // wgpu 30 panics where the device is lost while it waits.
        match catch_unwind(AssertUnwindSafe(|| self.device.poll(wait))) {
            Ok(Ok(_)) => {}
            Ok(Err(error)) => self.faults.set(&error.to_string()),
            Err(_) => self.faults.set("the driver failed while its work was waited for"),
        }
        self.check()
    }

    /// Runs a kernel and gives its output to `read`.
    pub(crate) fn run(&self, call: &Call<'_>, mut read: impl FnMut(&[u8])) -> Result<(), TraceError> {
        let mut pipeline = Pipeline::new(self, |(), bytes, _| read(bytes));
        pipeline.launch(call, ())?;
        pipeline.finish()
    }
}

fn structure_entry(binding: u32) -> wgpu::BindGroupLayoutEntry {
    layout_entry(binding, wgpu::BindingType::AccelerationStructure { vertex_return: false })
}

fn uniform_entry(binding: u32) -> wgpu::BindGroupLayoutEntry {
    buffer_entry(binding, wgpu::BufferBindingType::Uniform)
}

fn storage_entry(binding: u32, read_only: bool) -> wgpu::BindGroupLayoutEntry {
    buffer_entry(binding, wgpu::BufferBindingType::Storage { read_only })
}

fn buffer_entry(binding: u32, ty: wgpu::BufferBindingType) -> wgpu::BindGroupLayoutEntry {
    layout_entry(binding, wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None })
}

fn layout_entry(binding: u32, ty: wgpu::BindingType) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry { binding, visibility: wgpu::ShaderStages::COMPUTE, ty, count: None }
}
