//! [`survey`]: walks all tiles of a set, depth first, and measures their contents if they are read. [`verify`] reads and
//! decodes them as the pager would, for `terrane info --verify`. One file at a time; blocking. Runs on the caller's thread.

use std::collections::HashSet;
use std::rc::Rc;
use std::sync::Arc;

use glam::DAffine3;

use super::is_on_body;
use super::measure::{Declared, MapFrame, Measuring};
use super::overlay::verify_overlay;
use super::report::too_many;
use super::tree::{load, read_companions};
use super::verified::{SurveyEvent, Verified};
#[cfg(feature = "http")]
use crate::fetch::HttpConfig;
use crate::fetch::{IoError, Limits, Loaded, Source, guarded, is_remote, root_uri_within};
use crate::formats::image::ImageFiles;
use crate::formats::options::{Content, ReadOptions};
use crate::formats::osg;
use crate::formats::overlay;
use crate::formats::read::{self, Decoded, companions, decode_node, decode_whole};
use crate::formats::terrain::{self, TerrainPage};
use crate::formats::tile::ALWAYS_REFINED_M;
use crate::formats::tileset::{self, may_be_tileset};
use crate::math::{BoundingSphere, BoundingVolume, max_scale};
use crate::scene::{Node, NodeKind, Page, PagedLod, PagingOptions, RangeMode, ReaderData, Refine};

/// How a set is surveyed.
#[derive(Clone, Debug)]
pub struct SurveyOptions {
    /// Reads and decodes contents, as [`verify`] does. On by default. Otherwise only files with tiles are
    /// read, and the sizes of local contents.
    pub reads_contents: bool,
    /// Measures the contents that are read, which takes most of the time. On by default.
    pub measures: bool,
    /// Upper limits on the data.
    pub limits: Limits,
    /// The configuration for sources on servers.
    #[cfg(feature = "http")]
    pub http: HttpConfig,
}

impl Default for SurveyOptions {
    fn default() -> Self {
        Self {
            reads_contents: true,
            measures: true,
            limits: Limits::default(),
            #[cfg(feature = "http")]
            http: HttpConfig::default(),
        }
    }
}

/// Walks all tiles of a set, or of an OSG database, and calls `watch` with each file and each tile. Tiles follow those below
/// them. Fails only if the root cannot be read.
pub fn survey(
    source: &str,
    options: &SurveyOptions,
    watch: &mut dyn FnMut(SurveyEvent<'_>),
) -> Result<Verified, IoError> {
    let limits = &options.limits;
    let root = root_uri_within(source, limits.file_timeout)?;
    let from = Source::new(*limits, &root);
    #[cfg(feature = "http")]
    let from = from.with_http(options.http.clone());
    let Loaded { bytes, location, .. } = from.load(&root)?;
    if let Some(document) = overlay::describe(&bytes) {
        let progress = &mut |verified: &Verified| watch(SurveyEvent::Read(verified));
        return verify_overlay(&root, &bytes, document, (&from, limits), progress);
    }
    // Metadata that is invalid is named too.
    let of_root = ReadOptions { keep_features: true, base: location, ..ReadOptions::for_root(&root, *limits) };
    let ignored = of_root.ignored.clone();
    let mut walk = Walk {
        from: &from,
        verified: Verified::default(),
        measuring: None,
        reads_contents: options.reads_contents,
        measures: options.measures,
        has_own_errors: !terrain::is_layer(&root, &bytes, limits),
        steps: Vec::new(),
        known: HashSet::new(),
        nodes: 0,
    };
    walk.root(&root, bytes, of_root)?;
    walk.run(&root, limits.max_elements as u64, watch);
    let Walk { mut verified, measuring, .. } = walk;
    if let Some(measuring) = measuring {
        verified.edges_left_out = measuring.edges_left_out();
        (verified.levels, verified.problems) = measuring.finish();
    }
    if !options.reads_contents {
        verified.levels.clear();
    }
    let ignored = ignored.snapshot();
    verified.ignored = ignored.iter().map(|(kind, count)| (kind.to_owned(), count)).collect();
    Ok(verified)
}

/// Reads, decodes and measures every content of a tile set, and calls `progress` after each. Fails only if the root cannot be
/// read.
pub fn verify(source: &str, limits: &Limits, progress: &mut dyn FnMut(&Verified)) -> Result<Verified, IoError> {
    verify_by(source, &SurveyOptions { limits: *limits, ..SurveyOptions::default() }, progress)
}

/// Like [`verify`], with a configuration for servers.
#[cfg(feature = "http")]
pub fn verify_with(
    source: &str,
    limits: &Limits,
    http: HttpConfig,
    progress: &mut dyn FnMut(&Verified),
) -> Result<Verified, IoError> {
    verify_by(source, &SurveyOptions { limits: *limits, http, ..SurveyOptions::default() }, progress)
}

fn verify_by(source: &str, options: &SurveyOptions, progress: &mut dyn FnMut(&Verified)) -> Result<Verified, IoError> {
    survey(source, options, &mut |event| {
        if let SurveyEvent::Read(verified) = event {
            progress(verified);
        }
    })
}

/// A node that must still be visited.
struct Visit {
    node: Node,
    place: Place,
    options: Rc<ReadOptions>,
    /// True if a file of OpenSceneGraph refers to it: it is read once, however many files do.
    is_read_once: bool,
}

/// The frame and the level of a node.
#[derive(Clone, Copy)]
struct Place {
    set_from_node: DAffine3,
    level: u32,
    /// True for a further content of a tile.
    is_further: bool,
}

enum Step {
    Visit(Box<Visit>),
    /// All tiles below the current one were visited.
    Close,
}

/// A file that is read.
struct File<'a> {
    uri: &'a Arc<str>,
    reader_data: Option<&'a ReaderData>,
    is_tileset: bool,
    is_read_once: bool,
    options: &'a ReadOptions,
    place: Place,
}

struct Walk<'a> {
    from: &'a Source,
    verified: Verified,
    /// `None` until the first volume tells the frame.
    measuring: Option<Measuring>,
    reads_contents: bool,
    measures: bool,
    has_own_errors: bool,
    /// Last in, first out.
    steps: Vec<Step>,
    /// The files of OpenSceneGraph that were read.
    known: HashSet<Arc<str>>,
    nodes: u64,
}

impl Walk<'_> {
    /// Reads the root file.
    fn root(&mut self, root: &Arc<str>, bytes: Vec<u8>, options: ReadOptions) -> Result<(), IoError> {
        let place = Place { set_from_node: DAffine3::IDENTITY, level: 0, is_further: false };
        if tileset::is_tileset(root, &bytes, &options.limits) || terrain::is_layer(root, &bytes, &options.limits) {
            let mut options = options;
            self.verified.bytes += bytes.len() as u64;
            let companions = read_companions(self.from, root, &bytes, None, &mut options, &mut self.verified.bytes);
            self.verified.fail_each(&companions);
            let content = Content { uri: root.clone(), bytes, reader_data: None, companions };
            let Decoded { node, body, .. } = decode_whole(content, &options)?;
            options.ellipsoid = body.map_or(options.ellipsoid, |body| body.ellipsoid());
            self.push(node, place, &Rc::new(options.below(root)), false);
        } else {
            // A model, or the first file of an OSG database, whose tiles are in contents.
            self.reads_contents = true;
            let file = PagedLod {
                bounds: BoundingVolume::Sphere(BoundingSphere::EVERYTHING),
                range_mode: RangeMode::ScreenSpaceError { geometric_error_m: ALWAYS_REFINED_M },
                refine: Refine::Replace,
                content: Some(root.clone()),
                content_transform: DAffine3::IDENTITY,
                reader_data: None,
                request_volume: None,
                paging: PagingOptions::default(),
            };
            self.push(Node::new(NodeKind::PagedLod(Box::new(file))), place, &Rc::new(options), false);
        }
        Ok(())
    }

    fn push(&mut self, node: Node, place: Place, options: &Rc<ReadOptions>, is_read_once: bool) {
        let visit = Visit { node, place, options: options.clone(), is_read_once };
        self.steps.push(Step::Visit(Box::new(visit)));
    }

    /// Adds the children of a node, to be visited in their order.
    fn push_all(&mut self, children: Vec<Node>, place: Place, options: &Rc<ReadOptions>, is_read_once: bool) {
        children.into_iter().rev().for_each(|child| self.push(child, place, options, is_read_once));
    }

    fn run(&mut self, root: &str, limit: u64, watch: &mut dyn FnMut(SurveyEvent<'_>)) {
        while let Some(step) = self.steps.pop() {
            let Step::Visit(visit) = step else {
                if let Some(tile) = self.measuring.as_mut().and_then(Measuring::close) {
                    watch(SurveyEvent::Tile(&tile));
                }
                continue;
            };
            self.nodes += 1;
            if self.nodes > limit {
                self.verified.fail(&too_many(root, limit));
                return;
            }
            self.visit(*visit, watch);
        }
    }

    fn visit(&mut self, visit: Visit, watch: &mut dyn FnMut(SurveyEvent<'_>)) {
        let Visit { node, mut place, options, is_read_once } = visit;
        match node.kind {
            NodeKind::PagedLod(tile) => {
                self.tile(*tile, node.children, Visited { place, options, is_read_once }, watch)
            }
            NodeKind::ProxyNode(proxy) => {
                let set_from_node = place.set_from_node * proxy.content_transform;
                let file = File {
                    uri: &proxy.uri,
                    reader_data: None,
                    is_tileset: true,
                    is_read_once,
                    options: &options,
                    place: Place { set_from_node, ..place },
                };
                self.file(&file);
                watch(SurveyEvent::Read(&self.verified));
                self.push_all(node.children, place, &options, is_read_once);
            }
            NodeKind::MultiContentTile(_) => {
                let mut children = node.children.into_iter();
                let first = children.next();
                place.is_further = true;
                self.push_all(children.collect(), place, &options, is_read_once);
                place.is_further = false;
                first.into_iter().for_each(|first| self.push(first, place, &options, is_read_once));
            }
            NodeKind::Transform(map) => {
                place.set_from_node *= map;
                self.push_all(node.children, place, &options, is_read_once);
            }
            _ => self.push_all(node.children, place, &options, is_read_once),
        }
    }

    /// Reads the content of a tile, and adds the tiles below it.
    fn tile(&mut self, tile: PagedLod, children: Vec<Node>, at: Visited, watch: &mut dyn FnMut(SurveyEvent<'_>)) {
        let Visited { place, options, is_read_once } = at;
        let PagedLod { bounds, range_mode, refine, content, content_transform, reader_data, .. } = tile;
        let page = reader_data.as_ref().and_then(ReaderData::value::<TerrainPage>);
        // The ellipsoid has no files, and its levels continue to a very fine one.
        let is_ellipsoid = page.is_some_and(TerrainPage::is_ellipsoid);
        let content = content.filter(|_| !is_ellipsoid);
        let in_memory = Place { set_from_node: place.set_from_node * content_transform, ..place };
        let file = |uri, is_tileset| File {
            uri,
            reader_data: reader_data.as_ref(),
            is_tileset,
            is_read_once,
            options: &options,
            place: in_memory,
        };
        if reader_data.as_ref().is_some_and(ReaderData::continues_tileset) {
            // The tile stands for those in its content.
            self.push_all(children, place, &options, is_read_once);
            if let Some(uri) = &content {
                self.file(&file(uri, false));
                watch(SurveyEvent::Read(&self.verified));
            }
            return;
        }
        let volume = is_bounded(&bounds).then(|| transformed(&bounds, &place.set_from_node));
        if self.measuring.is_none()
            && let Some(volume) = &volume
        {
            let on_body = is_on_body(volume, &DAffine3::IDENTITY, &options.ellipsoid);
            let frame = if on_body { MapFrame::Globe(options.ellipsoid) } else { MapFrame::Local };
            self.measuring = Some(Measuring::new(frame, self.has_own_errors));
        }
        let error_m = match range_mode {
            RangeMode::ScreenSpaceError { geometric_error_m } if geometric_error_m < ALWAYS_REFINED_M => {
                Some(geometric_error_m * max_scale(&place.set_from_node.matrix3))
            }
            _ => None,
        };
        let name = || options.chain.last().cloned().unwrap_or_default();
        let declared = Declared {
            uri: content.clone().unwrap_or_else(name),
            level: place.level,
            volume,
            error_m,
            refine,
            has_children: !children.is_empty(),
            is_further: place.is_further,
        };
        if let Some(measuring) = &mut self.measuring {
            measuring.open(declared);
            self.steps.push(Step::Close);
        }
        let below = Place { level: place.level + 1, is_further: false, ..place };
        self.push_all(children, below, &options, is_read_once);
        if let Some(uri) = &content {
            self.file(&file(uri, false));
            watch(SurveyEvent::Read(&self.verified));
        }
    }

    /// Reads a file, and lists the failure if there is one.
    fn file(&mut self, file: &File<'_>) {
        // A file that contains itself is read once more, and fails.
        if file.is_read_once && !file.options.chain.contains(file.uri) && !self.known.insert(file.uri.clone()) {
            return;
        }
        let read = if self.reads_contents || self.has_tiles(file) { self.read(file) } else { self.size(file) };
        read.unwrap_or_else(|error| self.verified.fail(&error));
    }

    /// Returns true if a file has tiles, or may have.
    fn has_tiles(&self, file: &File<'_>) -> bool {
        let continues = file.reader_data.is_some_and(ReaderData::continues_tileset);
        file.is_tileset || continues || (!is_remote(file.uri) && may_be_tileset(file.uri))
    }

    /// Counts the bytes of a content that is not read.
    fn size(&mut self, file: &File<'_>) -> Result<(), IoError> {
        self.verified.contents += 1;
        let mut bytes = 0;
        if !file.reader_data.is_some_and(ReaderData::is_whole_content) {
            for uri in companions(file.uri, file.reader_data).iter().chain([file.uri]).filter(|uri| !is_remote(uri)) {
                bytes += self.from.size(uri)?;
            }
        }
        self.measuring.iter_mut().for_each(|measuring| measuring.add_bytes(bytes));
        Ok(())
    }

    fn read(&mut self, file: &File<'_>) -> Result<(), IoError> {
        let File { uri, reader_data: data, options, place, .. } = *file;
        let (is_in_memory, continues) =
            (data.is_some_and(ReaderData::is_whole_content), data.is_some_and(ReaderData::continues_tileset));
        let loaded = if is_in_memory { Ok(Loaded::default()) } else { load(self.from, uri, data) };
        // The name of a tileset may have any file extension.
        let is_one = |loaded: &Loaded| tileset::is_tileset(uri, &loaded.bytes, &options.limits);
        let is_osg = |loaded: &Loaded| osg::is_native(&loaded.bytes) || osg::is_metadata(&loaded.bytes);
        let is_osg = loaded.as_ref().is_ok_and(is_osg);
        let is_tileset = (file.is_tileset && !is_osg) || loaded.as_ref().is_ok_and(is_one);
        let is_file = data.and_then(ReaderData::value::<osg::InlinePart>).is_some_and(osg::InlinePart::is_file);
        self.verified.contents += u64::from(!is_tileset && (!continues || is_file));
        let Loaded { bytes, location, is_no_content, .. } = loaded?;
        let before = self.verified.bytes;
        self.verified.bytes += bytes.len() as u64;
        // Other contents of the same tile are read without it.
        let is_joined = data.is_some_and(|data| data.text().is_none()) && !read::companions(uri, data).is_empty();
        if is_no_content && !is_joined && !data.is_some_and(ReaderData::needs_content) {
            return Ok(());
        }
        let files = ImageFiles::default();
        let mut options = ReadOptions {
            base: location,
            set_from_content: place.set_from_node,
            image_files: Some(files.clone()),
            ..options.clone()
        };
        let companions = read_companions(self.from, uri, &bytes, data, &mut options, &mut self.verified.bytes);
        if is_tileset {
            self.verified.fail_each(&companions);
        }
        let content = Content { bytes, uri: uri.clone(), reader_data: data.cloned(), companions };
        let node = guarded(uri, || decode_node(content, &options))?;
        if continues || is_tileset {
            let options = if continues { options } else { options.below(uri) };
            self.push(node, place, &Rc::new(options), false);
            return Ok(());
        }
        if let Some(measuring) = &mut self.measuring {
            let bytes = self.verified.bytes - before;
            match self.measures {
                true => measuring.add_content(&node, &place.set_from_node, data, &files, bytes),
                false => measuring.add_bytes(bytes),
            }
        }
        if is_osg {
            let below = Place { level: place.level + 1, ..place };
            self.push(node, below, &Rc::new(options.below(uri)), true);
            return Ok(());
        }
        // Pages have further checks.
        guarded(uri, || Page::from_node(node).map(drop).map_err(|error| IoError::invalid(uri, error.to_string())))
    }
}

/// The frame and level of a tile, and the options for its content.
struct Visited {
    place: Place,
    options: Rc<ReadOptions>,
    is_read_once: bool,
}

fn is_bounded(volume: &BoundingVolume) -> bool {
    let sphere = volume.bounding_sphere();
    sphere.center.is_finite() && sphere.radius_m.is_finite() && sphere.radius_m < 1e15
}

/// Returns a volume in the frame of the set. Regions are in that frame.
fn transformed(volume: &BoundingVolume, set_from_node: &DAffine3) -> BoundingVolume {
    match volume {
        BoundingVolume::Sphere(sphere) => BoundingVolume::Sphere(sphere.transformed(set_from_node)),
        BoundingVolume::Box(b) => BoundingVolume::Box(b.transformed(set_from_node)),
        BoundingVolume::Region(region) => BoundingVolume::Region(*region),
    }
}
