//! Display settings of the configuration reach the cameras of views and the targets of contexts. The noop adapter suffices.

use terrane::gpu::{AdapterChoice, GpuError};
use terrane::viewer::{CompositeViewer, FieldOfView, Viewer, ViewerConfig, ViewerError};

fn config() -> ViewerConfig {
    ViewerConfig { size_px: [32, 16], adapter: AdapterChoice::Noop, validation: false, ..ViewerConfig::default() }
}

#[test]
fn cameras_of_views_have_the_field_of_view_of_the_configuration() {
    let field_of_view = FieldOfView::Vertical(0.5);
    let mut viewer = Viewer::new_offscreen(&ViewerConfig { field_of_view, ..config() }).unwrap();
    let clip_from_eye = |viewer: &Viewer| viewer.view().camera.clip_from_eye([32, 16], 1.0);
    assert_eq!(viewer.view().camera.field_of_view, field_of_view);
    let narrow = clip_from_eye(&viewer);
    assert!((narrow.y_axis.y - 1.0 / 0.25f64.tan()).abs() < 1e-6, "{narrow}");
    // A view that is added later too.
    let (scene, context) = (viewer.scene_id(), viewer.context());
    let composite: &mut CompositeViewer = viewer.composite_mut();
    let other = composite.add_view(scene, context, [0, 0, 16, 16]).unwrap();
    assert_eq!(composite.view(other).unwrap().camera.field_of_view, field_of_view);
    let usual = Viewer::new_offscreen(&config()).unwrap();
    assert!(clip_from_eye(&usual) != narrow);
}

#[test]
fn bits_that_the_adapter_lacks_are_an_error() {
    let open = |min_alpha_bits, min_stencil_bits| {
        Viewer::new_offscreen(&ViewerConfig { min_alpha_bits, min_stencil_bits, ..config() }).map(|_| ())
    };
    open(8, 8).unwrap();
    let alpha = open(9, 0).unwrap_err();
    assert!(matches!(alpha, ViewerError::Gpu(GpuError::AlphaBits { wanted: 9, found: 8 })), "{alpha:?}");
    let stencil = open(0, 9).unwrap_err();
    assert!(matches!(&stencil, ViewerError::Setting(text) if text.contains("9 bits of stencil")), "{stencil:?}");
}
