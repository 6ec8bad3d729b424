//! Calls in flight: while the device runs one, the next is written, sent and waits behind it.
//!
//! A device has [`FLIGHTS`] sets of buffers. A thread that has no call in flight waits for a set; one that has lands its
//! oldest call instead, so that threads never wait for each other in a circle. With two sets the device goes from
//! one call to the next without the host, whether the two are of one thread or of two; more would only queue.

use crate::{
    GpuDevice,
    device::{CompiledKernel, lock},
};
use kiln_trace::TraceError;
use std::{
    collections::VecDeque,
    sync::{Condvar, Mutex, PoisonError, mpsc},
    time::{Duration, Instant},
};

/// Sets of buffers of a device.
const FLIGHTS: usize = 2;

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

/// The sets of buffers of a device.
#[derive(Debug)]
pub(crate) struct Flights {
    idle: Mutex<Vec<CallBuffers>>,
    returned: Condvar,
    /// When the device was last seen to finish a call.
    last_end: Mutex<Option<Instant>>,
}

impl Flights {
    pub(crate) fn new() -> Self {
        let idle = std::iter::repeat_with(CallBuffers::default).take(FLIGHTS).collect();
        Self { idle: Mutex::new(idle), returned: Condvar::new(), last_end: Mutex::default() }
    }

    fn try_take(&self) -> Option<CallBuffers> {
        lock(&self.idle).pop()
    }

    fn take(&self) -> CallBuffers {
        let mut idle = lock(&self.idle);
        loop {
            if let Some(buffers) = idle.pop() {
                return buffers;
            }
            idle = self.returned.wait(idle).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn give_back(&self, buffers: CallBuffers) {
        lock(&self.idle).push(buffers);
        self.returned.notify_one();
    }

    /// How long the device had a call that was sent at `sent` and that ends now: not while others were before it.
    fn device_time(&self, sent: Instant) -> Duration {
        let mut last_end = lock(&self.last_end);
        let now = Instant::now();
        let start = last_end.replace(now).map_or(sent, |last| last.max(sent));
        now.duration_since(start)
    }
}

/// A set of buffers on loan. One that the device may still use is not used again: it is dropped, and the device lets go
/// of it when it is done.
struct Loan<'a> {
    gpu: &'a GpuDevice,
    buffers: CallBuffers,
    is_idle: bool,
}

impl Drop for Loan<'_> {
    fn drop(&mut self) {
        let buffers = std::mem::take(&mut self.buffers);
        self.gpu.flights().give_back(if self.is_idle { buffers } else { CallBuffers::default() });
    }
}

/// A call that was sent.
struct Flight<'a, T> {
    loan: Loan<'a>,
    readback: wgpu::Buffer,
    output_bytes: u64,
    submission: wgpu::SubmissionIndex,
    mapped: mpsc::Receiver<Result<(), wgpu::BufferAsyncError>>,
    sent: Instant,
    tag: T,
}

/// The calls of one thread, whose output is read in the order in which they were launched.
pub(crate) struct Pipeline<'a, T, R: FnMut(T, &[u8], Duration)> {
    gpu: &'a GpuDevice,
    pending: VecDeque<Flight<'a, T>>,
    read: R,
}

impl<'a, T, R: FnMut(T, &[u8], Duration)> Pipeline<'a, T, R> {
    /// `read` gets each call's tag, its output and the time that the device took for it.
    pub(crate) fn new(gpu: &'a GpuDevice, read: R) -> Self {
        Self { gpu, pending: VecDeque::new(), read }
    }

    /// Sends a call, if need be after waiting for others.
    pub(crate) fn launch(&mut self, call: &Call<'_>, tag: T) -> Result<(), TraceError> {
        self.gpu.check()?;
        let buffers = loop {
            if let Some(buffers) = self.gpu.flights().try_take() {
                break buffers;
            }
            match self.pending.pop_front() {
                Some(flight) => self.land(flight)?,
                None => break self.gpu.flights().take(),
            }
        };
        let loan = Loan { gpu: self.gpu, buffers, is_idle: true };
        self.pending.push_back(send(self.gpu, loan, call, tag)?);
        Ok(())
    }

    /// Waits for all calls.
    pub(crate) fn finish(mut self) -> Result<(), TraceError> {
        while let Some(flight) = self.pending.pop_front() {
            self.land(flight)?;
        }
        Ok(())
    }

    fn land(&mut self, mut flight: Flight<'a, T>) -> Result<(), TraceError> {
        self.gpu.wait(Some(flight.submission.clone()))?;
        // Another thread that waits may have found the mapping done first; it then calls back in a moment.
        match flight.mapped.recv_timeout(crate::device::SILENCE) {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Err(self.gpu.fail(format!("results could not be mapped: {error}"))),
            Err(_) => return Err(self.gpu.fail("results were not mapped in time".to_owned())),
        }
        let elapsed = self.gpu.flights().device_time(flight.sent);
        match flight.readback.get_mapped_range(..flight.output_bytes) {
            Ok(view) => (self.read)(flight.tag, &view, elapsed),
            Err(error) => return Err(self.gpu.fail(format!("results could not be read: {error}"))),
        }
        flight.readback.unmap();
        flight.loan.is_idle = true;
        Ok(())
    }
}

/// Writes, encodes and submits a call.
fn send<'a, T>(gpu: &'a GpuDevice, mut loan: Loan<'a>, call: &Call<'_>, tag: T) -> Result<Flight<'a, T>, TraceError> {
    let [params, input, output, readback] = loan.buffers.reserve(gpu, call)?;
    loan.is_idle = false;
    let sent = Instant::now();
    gpu.queue.write_buffer(&params, 0, call.params);
    gpu.queue.write_buffer(&input, 0, call.input);
    let entries = [&params, &input, &output].map(wgpu::Buffer::as_entire_binding);
    let entry = |(binding, resource)| wgpu::BindGroupEntry { binding, resource };
    let entries: Vec<_> = (0u32..).zip(entries).map(entry).collect();
    let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &call.kernel.call_layout,
        entries: &entries,
    });
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&call.kernel.pipeline);
        pass.set_bind_group(0, &group, &[]);
        if let Some(scene) = call.scene {
            pass.set_bind_group(1, scene, &[]);
        }
        pass.dispatch_workgroups(call.workgroups[0], call.workgroups[1], 1);
    }
    encoder.copy_buffer_to_buffer(&output, 0, &readback, 0, call.output_bytes);
    let submission = gpu.queue.submit([encoder.finish()]);
    let (sender, mapped) = mpsc::channel();
    // Where nobody listens any more, nobody needs the answer.
    readback.map_async(wgpu::MapMode::Read, ..call.output_bytes, move |result| drop(sender.send(result)));
    Ok(Flight { loan, readback, output_bytes: call.output_bytes, submission, mapped, sent, tag })
}

impl CallBuffers {
    /// Parameters, input, output and readback with room for a call.
    fn reserve(&mut self, gpu: &GpuDevice, call: &Call<'_>) -> Result<[wgpu::Buffer; 4], TraceError> {
        use wgpu::BufferUsages as Usage;
        let (params, input, output) = (call.params.len() as u64, call.input.len() as u64, call.output_bytes);
        Ok([
            grown(&mut self.params, gpu, "parameters", params, Usage::UNIFORM | Usage::COPY_DST)?,
            grown(&mut self.input, gpu, "the input of a dispatch", input, Usage::STORAGE | Usage::COPY_DST)?,
            grown(&mut self.output, gpu, "the output of a dispatch", output, Usage::STORAGE | Usage::COPY_SRC)?,
            grown(&mut self.readback, gpu, "the results of a dispatch", output, Usage::MAP_READ | Usage::COPY_DST)?,
        ])
    }
}

fn grown(
    buffer: &mut Option<wgpu::Buffer>,
    gpu: &GpuDevice,
    what: &'static str,
    bytes: u64,
    usage: wgpu::BufferUsages,
) -> Result<wgpu::Buffer, TraceError> {
    if let Some(buffer) = buffer.as_ref().filter(|buffer| buffer.size() >= bytes) {
        return Ok(buffer.clone());
    }
    *buffer = None;
    let new = gpu.create_buffer(what, bytes.next_power_of_two().max(256), usage)?;
    Ok(buffer.insert(new).clone())
}
