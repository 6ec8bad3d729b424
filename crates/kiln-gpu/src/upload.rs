//! Sends much data through little memory.

use crate::GpuDevice;
use kiln_trace::TraceError;

/// Bytes that are sent before the device is waited for. The driver holds them, and those that were sent last, until then.
const PART_BYTES: u64 = 16 << 20;

/// Writes one after another into several buffers of equal size; the last may be shorter.
pub(crate) struct Upload<'a> {
    gpu: &'a GpuDevice,
    buffers: &'a [wgpu::Buffer],
    binding_bytes: u64,
    at: u64,
    /// Bytes since the last part.
    unsent: u64,
    /// The last part, which the device may still be copying.
    last: Option<wgpu::SubmissionIndex>,
}

impl<'a> Upload<'a> {
    pub(crate) fn new(gpu: &'a GpuDevice, buffers: &'a [wgpu::Buffer], binding_bytes: u64) -> Self {
        Self { gpu, buffers, binding_bytes, at: 0, unsent: 0, last: None }
    }

    pub(crate) fn write(&mut self, mut bytes: &[u8]) -> Result<(), TraceError> {
        while !bytes.is_empty() {
            let (buffer, offset) = (self.at / self.binding_bytes, self.at % self.binding_bytes);
            let room = (self.binding_bytes - offset).min(PART_BYTES - self.unsent);
            let (now, later) = bytes.split_at(bytes.len().min(usize::try_from(room).unwrap_or(usize::MAX)));
            self.gpu.queue.write_buffer(&self.buffers[buffer as usize], offset, now);
            self.at += now.len() as u64;
            self.unsent += now.len() as u64;
            if self.unsent == PART_BYTES {
                self.send()?;
            }
            bytes = later;
        }
        Ok(())
    }

    /// Sends a part, and waits for the one before it, so that the device copies one while the next is written.
    fn send(&mut self) -> Result<(), TraceError> {
        self.unsent = 0;
        let sent = self.gpu.queue.submit([]);
        self.last.replace(sent).map_or(Ok(()), |last| self.gpu.wait(Some(last)))
    }

    /// Sends the rest and waits for all.
    pub(crate) fn finish(mut self) -> Result<(), TraceError> {
        self.send()?;
        self.gpu.wait(None)
    }
}
