//! [`ReadAhead`]: the objects of a file that was parsed for the names of its images, until it is decoded. Any thread.

use std::sync::{Arc, Mutex, PoisonError};

use twox_hash::XxHash3_128;

use super::build::size_bytes;
use super::classes::{ReadFile, read_file};
use super::error::Result;
use super::{dot_osg, ive};
use crate::fetch::Limits;

/// The largest file whose objects are kept, bytes. Larger ones are parsed again.
const MAX_KEPT_BYTES: usize = 16 << 20;

/// Keeps what a loader has parsed of one content for its decoder. A loader asks for the files that a content refers to, once
/// or several times, and then decodes it: a file of OpenSceneGraph is parsed once for both. Clones share it, so
/// that each content that is loaded at the same time as others has a new one.
#[derive(Clone, Debug, Default)]
pub struct ReadAhead(Arc<Mutex<Option<Kept>>>);

/// A file that was parsed.
#[derive(Debug)]
struct Kept {
    /// Stands for the bytes: a server may answer a second request with others.
    hash: u128,
    file: Arc<ReadFile>,
    /// About the memory that the objects take.
    size_bytes: u64,
}

/// Parses a file of any of the formats.
fn parse(bytes: &[u8], limits: &Limits) -> Result<ReadFile> {
    match () {
        () if ive::is_ive(bytes) => ive::read(bytes, limits),
        () if dot_osg::is_dot_osg(bytes) => dot_osg::read(bytes, limits),
        () => read_file(bytes, limits),
    }
}

impl ReadAhead {
    /// Returns the objects of a file, and keeps them.
    pub(super) fn file(&self, bytes: &[u8], limits: &Limits) -> Result<Arc<ReadFile>> {
        let hash = XxHash3_128::oneshot(bytes);
        if let Some(file) = self.kept().as_ref().filter(|kept| kept.hash == hash).map(|kept| kept.file.clone()) {
            return Ok(file);
        }
        let file = Arc::new(parse(bytes, limits)?);
        if bytes.len() <= MAX_KEPT_BYTES {
            *self.kept() = Some(Kept { hash, file: file.clone(), size_bytes: size_bytes(&file.root) });
        }
        Ok(file)
    }

    /// Returns the objects of a file, and keeps nothing any longer.
    pub(super) fn take(&self, bytes: &[u8], limits: &Limits) -> Result<Arc<ReadFile>> {
        match self.kept().take() {
            Some(Kept { hash, file, .. }) if hash == XxHash3_128::oneshot(bytes) => Ok(file),
            _ => parse(bytes, limits).map(Arc::new),
        }
    }

    /// Returns about the bytes of the objects that are kept.
    pub(crate) fn size_bytes(&self) -> u64 {
        self.kept().as_ref().map_or(0, |kept| kept.size_bytes)
    }

    /// Drops what is kept: the content is loaded again later.
    #[cfg(any(feature = "http", test))]
    pub(crate) fn forget(&self) {
        *self.kept() = None;
    }

    fn kept(&self) -> std::sync::MutexGuard<'_, Option<Kept>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::options::{Content, ReadOptions};
    use crate::formats::osg::classes::PARSED;
    use crate::formats::{decode_noting, dependencies};

    const FILE: &str = "#Ascii Scene \n#Version 161 \n#Generator OpenSceneGraph 3.6.5 \n\n
        osg::Group { UniqueID 1 StateSet TRUE { osg::StateSet { UniqueID 2
            TextureAttributeList 1 { Data 1 { osg::Texture2D { UniqueID 3
                Image TRUE { ClassName osg::Image UniqueID 4 FileName \"a.png\" WriteHint 2 2 } } Value OFF } } } }
        Children 2 { osg::Geode { UniqueID 5 } osgParticle::ModularEmitter { UniqueID 6 } } }";

    /// Returns how often files are parsed on this thread.
    fn parsed(work: impl FnOnce()) -> u32 {
        let before = PARSED.get();
        work();
        PARSED.get() - before
    }

    /// Regression: files were parsed once for their content and once for each round of their dependencies.
    #[test]
    fn file_is_parsed_once_for_its_images_and_its_content() {
        let options = ReadOptions::for_root("/set/a.osgt", Limits::default());
        let bytes = FILE.as_bytes();
        let count = parsed(|| {
            let images = dependencies("/set/a.osgt", bytes, None, &[], &options);
            assert_eq!(images, [Arc::from("/set/a.png")]);
            let missing = crate::fetch::IoError::NotFound { uri: "/set/a.png".into() };
            let companions = vec![(images[0].clone(), Err(missing))];
            assert!(dependencies("/set/a.osgt", bytes, None, &companions, &options).is_empty());
            let content = Content { uri: "/set/a.osgt".into(), bytes: bytes.into(), reader_data: None, companions };
            let (_, ignored) = decode_noting(content, &options).unwrap();
            assert_eq!(ignored.count("OpenSceneGraph class osgParticle::ModularEmitter"), 1, "{ignored:?}");
        });
        assert_eq!(count, 1);
        assert!(options.read_ahead.kept().is_none(), "the decoder has taken it");
    }

    #[test]
    fn kept_objects_have_a_size_until_they_are_taken() {
        let geometry = format!(
            "osg::Geode {{ UniqueID 5 Drawables 1 {{ osg::Geometry {{ UniqueID 8 VertexArray TRUE {{
                osg::Vec3Array {{ UniqueID 9 vector 1000 {{ {} }} }} }} }} }} }}",
            "0 ".repeat(3000)
        );
        let group = FILE.replace("osg::Geode { UniqueID 5 }", &geometry);
        let ahead = ReadAhead::default();
        assert_eq!(ahead.size_bytes(), 0);
        ahead.file(group.as_bytes(), &Limits::default()).unwrap();
        assert!((12_000..14_000).contains(&ahead.size_bytes()), "{}", ahead.size_bytes());
        ahead.take(group.as_bytes(), &Limits::default()).unwrap();
        assert_eq!(ahead.size_bytes(), 0);
        ahead.file(group.as_bytes(), &Limits::default()).unwrap();
        ahead.forget();
        assert_eq!(ahead.size_bytes(), 0);
    }

    #[test]
    fn other_bytes_are_parsed_anew() {
        let ahead = ReadAhead::default();
        let limits = Limits::default();
        let other = FILE.replace("161", "150");
        let count = parsed(|| {
            assert_eq!(ahead.file(FILE.as_bytes(), &limits).unwrap().version, 161);
            assert_eq!(ahead.file(other.as_bytes(), &limits).unwrap().version, 150);
            assert_eq!(ahead.take(FILE.as_bytes(), &limits).unwrap().version, 161);
            assert!(ahead.take(b"#Ascii", &limits).is_err());
        });
        assert_eq!(count, 4);
    }
}
