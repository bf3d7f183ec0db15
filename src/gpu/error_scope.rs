//! Error scopes: an error of one shader or texture made from outside data is reported for that object alone. Errors that
//! reach the device's own handler fail the whole frame.
//!
//! Runs on the draw thread, and on the thread that opens a device while it creates surfaces.

/// Runs `create` and returns its result with the error that the device reported meanwhile: a validation error, a shader that
/// the driver cannot compile or link, or lack of memory. Of several errors the one that causes the others is returned.
pub(crate) fn catch_errors<T>(device: &wgpu::Device, create: impl FnOnce() -> T) -> (T, Option<wgpu::Error>) {
    let scopes = [wgpu::ErrorFilter::Validation, wgpu::ErrorFilter::Internal, wgpu::ErrorFilter::OutOfMemory]
        .map(|filter| device.push_error_scope(filter));
    let created = create();
    let [invalid, internal, memory] = scopes;
    // The future is ready at once: wgpu's own backends do not wait for the adapter here.
    let errors = [memory, internal, invalid].map(|scope| pollster::block_on(scope.pop()));
    (created, errors.into_iter().flatten().next())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, GraphicsContext};

    #[test]
    fn errors_are_returned_by_the_innermost_scope_only() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let mut ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let device = ctx.device().clone();
        let buffer = |usage| {
            let (label, size) = (Some("a buffer"), 16);
            device.create_buffer(&wgpu::BufferDescriptor { label, size, usage, mapped_at_creation: false })
        };
        let (_, error) = catch_errors(&device, || buffer(wgpu::BufferUsages::VERTEX));
        assert!(error.is_none(), "{error:?}");
        // The result is returned with an error too.
        let ((created, inner), outer) =
            catch_errors(&device, || catch_errors(&device, || buffer(wgpu::BufferUsages::empty())));
        assert!(matches!(&inner, Some(wgpu::Error::Validation { .. })), "{inner:?}");
        assert!(outer.is_none() && created.size() == 16);
        assert!(ctx.take_device_errors().is_empty());
        // Outside of scopes the device's own handler receives the error.
        buffer(wgpu::BufferUsages::empty());
        assert_eq!(ctx.take_device_errors().len(), 1);
    }
}
