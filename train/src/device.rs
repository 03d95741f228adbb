//! Where a training runs.
use crate::error::TrainError;
use burn::tensor::Device;
use std::{fmt, str::FromStr};

/// A place to compute, by its name.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Accelerator {
    /// The processor, with burn's Flex backend.
    #[default]
    Cpu,
    /// A graphics card through WebGPU (feature `wgpu`).
    Wgpu,
    /// An NVIDIA card (feature `cuda`).
    Cuda,
}

impl Accelerator {
    /// burn's device. Call [`Self::check`] first.
    #[must_use]
    pub fn device(self) -> Device {
        match self {
            #[cfg(feature = "wgpu")]
            Self::Wgpu => Device::wgpu(burn::tensor::DeviceKind::DefaultDevice),
            #[cfg(feature = "cuda")]
            Self::Cuda => Device::cuda(0),
            _ => Device::flex(),
        }
    }

    /// Checks that this build knows the device and that this machine has one.
    ///
    /// # Errors
    /// If it was built without the feature, or no driver offers such a device.
    pub fn check(self) -> Result<(), TrainError> {
        let built = match self {
            Self::Cpu => true,
            Self::Wgpu => cfg!(feature = "wgpu"),
            Self::Cuda => cfg!(feature = "cuda"),
        };
        let message = match (built, self.found()) {
            (true, true) => return Ok(()),
            (false, _) => format!("this program was built without it; build with `--features {self}`"),
            (true, false) => "no driver on this machine offers one".into(),
        };
        Err(TrainError::Device { device: self.to_string(), message })
    }

    /// Whether the system shows such a device.
    fn found(self) -> bool {
        match self {
            #[cfg(feature = "wgpu")]
            Self::Wgpu => !Device::enumerate(burn::tensor::DeviceType::Wgpu).is_empty(),
            #[cfg(feature = "cuda")]
            Self::Cuda => !Device::enumerate(burn::tensor::DeviceType::Cuda).is_empty(),
            _ => true,
        }
    }
}

impl fmt::Display for Accelerator {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::Cpu => "cpu",
            Self::Wgpu => "wgpu",
            Self::Cuda => "cuda",
        })
    }
}

impl FromStr for Accelerator {
    type Err = TrainError;
    fn from_str(name: &str) -> Result<Self, TrainError> {
        match name {
            "cpu" => Ok(Self::Cpu),
            "wgpu" => Ok(Self::Wgpu),
            "cuda" => Ok(Self::Cuda),
            _ => Err(TrainError::Device { device: name.into(), message: "expected cpu, wgpu or cuda".into() }),
        }
    }
}
