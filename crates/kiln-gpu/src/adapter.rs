//! Which adapters there are, and which one is taken.
//!
//! A real GPU is taken before the CPU tracer; a software driver only where it is asked for, since the CPU tracer is
//! faster than the same kernels on a software driver. A machine without a Vulkan loader has no adapters; that is no error.

use std::fmt;

/// Names the adapter to take: `software`, or part of an adapter's name.
pub const ADAPTER_VARIABLE: &str = "KILN_GPU";

/// What an adapter runs on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum AdapterKind {
    /// A GPU with memory of its own.
    Discrete,
    /// A GPU that shares the CPU's memory.
    Integrated,
    /// A GPU of the host of a virtual machine.
    Virtual,
    /// The driver does not say.
    Unknown,
    /// The CPU.
    Software,
}

impl AdapterKind {
    fn of(device_type: wgpu::DeviceType) -> Self {
        match device_type {
            wgpu::DeviceType::DiscreteGpu => Self::Discrete,
            wgpu::DeviceType::IntegratedGpu => Self::Integrated,
            wgpu::DeviceType::VirtualGpu => Self::Virtual,
            wgpu::DeviceType::Other => Self::Unknown,
            wgpu::DeviceType::Cpu => Self::Software,
        }
    }

    /// Whether it is taken without being asked for.
    pub fn is_real(self) -> bool {
        self <= Self::Virtual
    }
}

impl fmt::Display for AdapterKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Discrete => "discrete GPU",
            Self::Integrated => "integrated GPU",
            Self::Virtual => "virtual GPU",
            Self::Unknown => "unknown kind",
            Self::Software => "software",
        })
    }
}

/// An adapter, as its driver describes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdapterSummary {
    /// Name of the adapter.
    pub name: String,
    /// What it runs on.
    pub kind: AdapterKind,
    /// Name of the driver.
    pub driver: String,
    /// The driver's version, in its own words.
    pub driver_version: String,
}

impl AdapterSummary {
    pub(crate) fn of(info: &wgpu::AdapterInfo) -> Self {
        Self {
            name: info.name.trim().to_owned(),
            kind: AdapterKind::of(info.device_type),
            driver: info.driver.trim().to_owned(),
            driver_version: info.driver_info.trim().to_owned(),
        }
    }

    /// The lane of its results, `gpu:ADAPTER:DRIVER+VERSION`: they are the same bit for bit within it.
    pub fn lane(&self) -> String {
        let field = |text: &str| text.replace(':', "_");
        format!("gpu:{}:{}+{}", field(&self.name), field(&self.driver), field(&self.driver_version))
    }
}

impl fmt::Display for AdapterSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({}, driver {} {})", self.name, self.kind, self.driver, self.driver_version)
    }
}

/// Which adapter to open.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub enum AdapterChoice {
    /// The best real GPU: discrete, then integrated, then virtual.
    #[default]
    Real,
    /// A software driver.
    Software,
    /// The first adapter of any kind whose name contains this, in any case.
    Named(String),
}

impl AdapterChoice {
    /// From the words of a person: nothing, `software`, or part of a name.
    pub fn parse(text: &str) -> Self {
        match text.trim() {
            "" => Self::Real,
            "software" => Self::Software,
            name => Self::Named(name.to_owned()),
        }
    }

    /// From the environment variable [`ADAPTER_VARIABLE`].
    pub fn from_env() -> Self {
        std::env::var(ADAPTER_VARIABLE).map_or(Self::Real, |text| Self::parse(&text))
    }

    fn allows(&self, adapter: &AdapterSummary) -> bool {
        match self {
            Self::Real => adapter.kind.is_real(),
            Self::Software => adapter.kind == AdapterKind::Software,
            Self::Named(name) => adapter.name.to_lowercase().contains(&name.to_lowercase()),
        }
    }

    /// Index of the adapter to take: the best kind, and of these the first.
    pub(crate) fn pick(&self, adapters: &[AdapterSummary]) -> Option<usize> {
        let allowed = adapters.iter().enumerate().filter(|(_, adapter)| self.allows(adapter));
        allowed.min_by_key(|(_, adapter)| adapter.kind).map(|(index, _)| index)
    }
}

/// The adapters of this machine that can run the kernels, in the driver's order. Empty without a Vulkan driver.
pub fn adapters() -> Vec<AdapterSummary> {
    enumerate().iter().map(|adapter| AdapterSummary::of(&adapter.get_info())).collect()
}

pub(crate) fn enumerate() -> Vec<wgpu::Adapter> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends: wgpu::Backends::PRIMARY,
        flags: wgpu::InstanceFlags::empty(),
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    });
    let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY));
    adapters.retain(|adapter| {
        let limits = adapter.limits();
        let compute = wgpu::DownlevelFlags::COMPUTE_SHADERS;
        adapter.get_downlevel_capabilities().flags.contains(compute)
            && limits.max_compute_invocations_per_workgroup >= crate::gather::LANES
            && limits.max_storage_buffers_per_shader_stage > crate::device::CALL_STORAGE_BUFFERS
    });
    adapters
}

#[cfg(test)]
mod tests {
    use super::*;

    fn summary(name: &str, kind: AdapterKind) -> AdapterSummary {
        AdapterSummary { name: name.to_owned(), kind, driver: "d:x".to_owned(), driver_version: "1.2".to_owned() }
    }

    #[test]
    fn real_ones_come_first_and_software_only_when_asked_for() {
        use AdapterKind::{Discrete, Integrated, Software, Unknown, Virtual};
        let adapters = [
            summary("llvmpipe", Software),
            summary("odd", Unknown),
            summary("Host", Virtual),
            summary("Chip", Integrated),
            summary("Card A", Discrete),
            summary("Card B", Discrete),
        ];
        let pick = |text: &str, adapters: &[AdapterSummary]| AdapterChoice::parse(text).pick(adapters);
        assert_eq!(pick("", &adapters), Some(4));
        assert_eq!(pick("", &adapters[..4]), Some(3));
        assert_eq!(pick(" ", &adapters[..3]), Some(2));
        assert_eq!(pick("", &adapters[..2]), None);
        assert_eq!(pick("software", &adapters), Some(0));
        assert_eq!(pick("software", &adapters[1..]), None);
        assert_eq!(pick("card b", &adapters), Some(5));
        assert_eq!(pick("LLVM", &adapters), Some(0));
        assert_eq!(pick("none such", &adapters), None);
    }

    #[test]
    fn a_lane_has_three_fields() {
        assert_eq!(summary("Card: A", AdapterKind::Discrete).lane(), "gpu:Card_ A:d_x+1.2");
    }
}
