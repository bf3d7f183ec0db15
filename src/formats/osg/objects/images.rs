//! Images of textures, inside of a file or beside it. Decode threads.

/// An image.
#[derive(Debug)]
pub(in crate::formats::osg) struct ImageObject {
    pub file_name: String,
    pub data: ImageData,
}

/// The pixels of an image.
#[derive(Debug)]
pub(in crate::formats::osg) enum ImageData {
    /// In the file of its name.
    External,
    /// Here, as the bytes of an image file.
    File(Vec<u8>),
    /// Here, uncompressed or in blocks.
    Raw(RawImage),
}

/// Pixels as OpenGL takes them.
#[derive(Debug)]
pub(in crate::formats::osg) struct RawImage {
    /// Width, height and depth.
    pub size: [i32; 3],
    pub pixel_format: u32,
    pub data_type: u32,
    /// The alignment of rows in bytes.
    pub packing: u32,
    /// All levels.
    pub bytes: Vec<u8>,
}
