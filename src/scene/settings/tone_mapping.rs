//! [`ToneMapping`]: where in a frame lit colours are mapped to what a display shows. Plain values.

/// The step of drawing that applies the exposure and compresses highlights, in views that draw into a window or into the
/// image of an offscreen context.
///
/// Cameras that draw into textures of floats get the light itself, without exposure and without tone mapping, whatever this
/// says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ToneMapping {
    /// Each fragment's shader maps its own colour. This costs nothing, but blending and the mean of samples then work on
    /// mapped colours. Where a light of 8 covers half of a pixel, the pixel shows half of white instead of a light of 4.
    #[default]
    InShaders,
    /// Fragments are light in half floats, 8 bytes for each sample. They are blended, and the mean of the samples is taken;
    /// a separate pass then maps each pixel.
    ///
    /// Unlit colours are divided by the exposure and come back from the pass, compressed like lit ones above 0.76 of
    /// white. The images of the eyes of stereo modes are mapped by shaders.
    InOwnPass,
}
