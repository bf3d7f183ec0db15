//! What the device complains about while something is made of outside data (shaders, textures), so that it is an error
//! of this one thing: what reaches the device's own handler costs the frame that it is used in. Draw thread, and whichever
//! makes a device's surface.

/// Makes something, and returns what the device complained about meanwhile: wgpu's rules, what the driver refuses to
/// compile or link, memory. Of several complaints the one that the others follow from.
pub(crate) fn watched<T>(device: &wgpu::Device, make: impl FnOnce() -> T) -> (T, Option<wgpu::Error>) {
    let scopes = [wgpu::ErrorFilter::Validation, wgpu::ErrorFilter::Internal, wgpu::ErrorFilter::OutOfMemory]
        .map(|filter| device.push_error_scope(filter));
    let made = make();
    let [invalid, internal, memory] = scopes;
    // Known at once: wgpu's own backends do not wait for the adapter here.
    let errors = [memory, internal, invalid].map(|scope| pollster::block_on(scope.pop()));
    (made, errors.into_iter().flatten().next())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, GraphicsContext};

    #[test]
    fn complaints_are_of_what_was_made_and_of_nothing_else() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let mut ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let device = ctx.device().clone();
        let buffer = |usage| {
            let (label, size) = (Some("a buffer"), 16);
            device.create_buffer(&wgpu::BufferDescriptor { label, size, usage, mapped_at_creation: false })
        };
        let (_, error) = watched(&device, || buffer(wgpu::BufferUsages::VERTEX));
        assert!(error.is_none(), "{error:?}");
        // Scopes inside of others; what is made is handed over all the same.
        let ((made, inner), outer) = watched(&device, || watched(&device, || buffer(wgpu::BufferUsages::empty())));
        assert!(matches!(&inner, Some(wgpu::Error::Validation { .. })), "{inner:?}");
        assert!(outer.is_none() && made.size() == 16);
        assert!(ctx.take_device_errors().is_empty());
        // Afterwards the device's own handler hears of it.
        buffer(wgpu::BufferUsages::empty());
        assert_eq!(ctx.take_device_errors().len(), 1);
    }
}
