//! [`DeviceStatus`]: whether the device is lost, and the errors that it reported.

use std::sync::{Arc, Mutex};

use crate::gpu::GpuError;

/// The maximum number of device errors that are kept until they are taken.
const MAX_ERRORS: usize = 16;

/// The loss and the errors of a device. The default has no callbacks: those of an application's device stay the
/// application's.
#[derive(Default)]
pub(super) struct DeviceStatus {
    /// The first reason of a loss. Written by wgpu's device-lost callback on any thread, read by the draw thread.
    lost: Arc<Mutex<Option<String>>>,
    /// Written by wgpu's error callback on the draw thread, emptied by [`Self::take_errors`].
    errors: Arc<Mutex<Vec<String>>>,
}

fn push(errors: &Mutex<Vec<String>>, error: String) {
    if let Ok(mut errors) = errors.lock()
        && errors.len() < MAX_ERRORS
    {
        errors.push(error);
    }
}

impl DeviceStatus {
    /// Installs the callbacks of a device. Without an error callback wgpu panics, even if the adapter runs out of memory.
    pub(super) fn watch(device: &wgpu::Device) -> Self {
        let lost = Arc::new(Mutex::new(None));
        let on_lost = lost.clone();
        device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed
                && let Ok(mut lost) = on_lost.lock()
            {
                lost.get_or_insert(message);
            }
        });
        let errors = Arc::new(Mutex::new(Vec::new()));
        let on_error = errors.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            log::error!("graphics device: {error}");
            push(&on_error, error.to_string());
        }));
        Self { lost, errors }
    }

    /// Returns an error once the device is lost.
    pub(super) fn check_lost(&self) -> Result<(), GpuError> {
        let reason = self.lost.lock().ok().and_then(|lost| lost.clone());
        reason.map_or(Ok(()), |reason| Err(GpuError::DeviceLost { reason }))
    }

    /// Marks the device as lost.
    #[cfg(feature = "testing")]
    pub(super) fn lose(&self) {
        if let Ok(mut lost) = self.lost.lock() {
            lost.get_or_insert_with(|| "destroyed".to_owned());
        }
    }

    /// Adds an error to those of the device.
    pub(super) fn add_error(&self, error: String) {
        push(&self.errors, error);
    }

    /// Takes the errors since the last call, at most the first [`MAX_ERRORS`].
    pub(super) fn take_errors(&self) -> Vec<String> {
        self.errors.lock().map(|mut errors| std::mem::take(&mut *errors)).unwrap_or_default()
    }
}
