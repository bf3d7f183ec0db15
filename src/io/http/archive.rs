//! Archives on servers: the directory and each member by range requests.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use lru::LruCache;
use reqwest::header::{ACCEPT_ENCODING, CONTENT_RANGE, ETAG, HeaderMap, HeaderValue, RANGE};

use super::cached::{hit, keep_validators};
use super::doubts::Doubts;
use super::once::Once;
use super::tiles::RemoteTiles;
use super::{DECODED_HERE_BYTES, HttpBody, HttpClient, blocking, exchange};
use crate::io::archive::{
    self, DAMAGED, Directory, End, Index, KEPT_ARCHIVES, KEPT_BYTES, Member, SLACK_BYTES, Span, TAIL_BYTES, is_pmtiles,
};
use crate::io::cache::{Entry, Freshness};
use crate::io::read::refuse_markup;
use crate::io::{DiskCache, IoError, Limits, file, shown};

/// For so long after an answer with an archive's validator all of its files hold that were kept with it.
const VOUCHES_FOR: Duration = Duration::from_secs(60);

/// Directories by URL. Whoever needs one first reads it, the others wait for that.
#[derive(Debug)]
pub(super) struct Archives {
    read: Mutex<LruCache<String, Arc<Once<Arc<RemoteArchive>>>>>,
    doubts: Doubts,
}

#[derive(Debug)]
pub(super) struct RemoteArchive {
    pub length: u64,
    pub etag: Option<String>,
    /// When it was last seen to be this one.
    seen: Mutex<Instant>,
    pub inside: Inside,
}

impl RemoteArchive {
    /// The archive that a part came from.
    pub fn of(part: &Part, inside: Inside) -> Self {
        Self { length: part.length, etag: part.etag(), seen: Mutex::new(part.asked), inside }
    }

    fn seen(&self) -> MutexGuard<'_, Instant> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Says of a file that was kept with a validator that it still holds.
    fn vouches_for(&self, kept: &Entry, now: Instant) -> bool {
        let strong = self.etag.as_ref().filter(|tag| !tag.starts_with("W/"));
        strong.is_some() && kept.etag.as_ref() == strong && now.saturating_duration_since(*self.seen()) < VOUCHES_FOR
    }

    /// Of what is kept of it in memory.
    fn bytes(&self) -> usize {
        match &self.inside {
            Inside::Zip(zip) => {
                let directory = zip.directory.get().map_or(0, Directory::bytes);
                directory + zip.index.as_ref().map_or(0, Index::bytes)
            }
            Inside::Tiles(tiles) => tiles.bytes(),
        }
    }
}

/// An archive of either kind.
#[derive(Debug)]
pub(super) enum Inside {
    Zip(Box<RemoteZip>),
    Tiles(RemoteTiles),
}

#[derive(Debug)]
pub(super) struct RemoteZip {
    /// Where the directory is. Members lie before it.
    place: Span,
    index: Option<Index>,
    /// Read when there is no index, or when what it says is not enough.
    directory: Once<Directory>,
    /// Done once the directory came twice the same.
    confirmed: Once<()>,
}

impl Archives {
    pub fn new() -> Self {
        Self { read: Mutex::new(LruCache::new(KEPT_ARCHIVES)), doubts: Doubts::new() }
    }

    fn read(&self) -> MutexGuard<'_, LruCache<String, Arc<Once<Arc<RemoteArchive>>>>> {
        self.read.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn cell(&self, url: &str) -> Arc<Once<Arc<RemoteArchive>>> {
        self.read().get_or_insert(url.to_owned(), Arc::default).clone()
    }

    /// Lets those go that were not used for longest, until all have no more bytes than are kept.
    fn trim(&self) {
        let mut archives = self.read();
        archive::trim(&mut archives, KEPT_BYTES, |cell| cell.get().map_or(0, |archive| archive.bytes()));
    }

    /// Lets an archive go that turned out to be another one by now; what was read of that meanwhile stays.
    fn forget(&self, url: &str, archive: &RemoteArchive) {
        let mut archives = self.read();
        let read = archives.peek(url).and_then(|cell| cell.get());
        if read.is_some_and(|read| std::ptr::eq(&**read, archive)) {
            archives.pop(url);
        }
    }

    /// A file of an archive turned out to be no content: its directory may be wrong, and is read anew now and then.
    fn doubt(&self, url: &str, archive: &RemoteArchive) {
        if self.doubts.count(url, Instant::now()) {
            self.forget(url, archive);
        }
    }

    /// The same, found out by whoever read the file.
    pub fn doubt_any(&self, url: &str) {
        let read = self.read().peek(url).and_then(|cell| cell.get()).cloned();
        if let Some(archive) = read {
            self.doubt(url, &archive);
        }
    }
}

/// A part of an archive, as it came.
pub(super) struct Part {
    pub bytes: Vec<u8>,
    pub offset: u64,
    /// Bytes of the whole archive.
    pub length: u64,
    /// Before it was asked for.
    asked: Instant,
    headers: HeaderMap,
    freshness: Freshness,
}

impl Part {
    pub fn etag(&self) -> Option<String> {
        self.headers.get(ETAG).and_then(|v| v.to_str().ok()).map(str::to_owned)
    }
}

impl HttpClient {
    /// A file inside an archive. The cache keeps files, not archives: one that holds costs no request.
    pub(super) async fn get_member(
        &self,
        uri: &str,
        (url, name): (&str, String),
        limits: &Limits,
    ) -> Result<HttpBody, IoError> {
        let cache = self.inner.cache.as_ref();
        let mut kept = None;
        if let Some(cache) = cache {
            kept = match self.load(cache, uri, limits).await? {
                Some((entry, bytes)) if self.takes(cache, &entry) => {
                    return Ok(hit(cache, &entry, bytes, false));
                }
                None if cache.is_offline() => {
                    cache.count_miss();
                    return Err(IoError::Offline { uri: uri.to_owned() });
                }
                kept => kept,
            };
        }
        let network_bytes = AtomicU64::new(0);
        let cell = self.inner.archives.cell(url);
        let archive = cell.get_or_read(async || self.open_archive(url, limits, &network_bytes).await).await?;
        self.inner.archives.trim();
        if let (Some(cache), Some((entry, bytes))) = (cache, kept)
            && archive.vouches_for(&entry, Instant::now())
        {
            let network_bytes = network_bytes.into_inner();
            let hit = hit(cache, &entry, bytes, true);
            return Ok(HttpBody { network_bytes, asked: network_bytes > 0, ..hit });
        }
        let got = match &archive.inside {
            Inside::Zip(zip) => self.get_zipped(uri, (url, &name), (archive, zip), limits, &network_bytes).await,
            Inside::Tiles(tiles) => self.get_tile(uri, (url, &name), (archive, tiles), limits, &network_bytes).await,
        };
        if got.as_ref().is_err_and(IoError::is_no_content) {
            self.inner.archives.doubt(url, archive);
        }
        let (bytes, part) = got?;
        if let Some(cache) = cache {
            self.keep_member(cache, uri, &part, &bytes).await;
        }
        let network_bytes = network_bytes.into_inner();
        Ok(HttpBody { bytes, network_bytes, asked: network_bytes > 0 })
    }

    /// A file of a zip archive, decompressed, and the part that it came in.
    async fn get_zipped(
        &self,
        uri: &str,
        (url, name): (&str, &str),
        of_zip: (&RemoteArchive, &RemoteZip),
        limits: &Limits,
        network_bytes: &AtomicU64,
    ) -> Result<(Vec<u8>, Part), IoError> {
        let (member, part) = match self.by_index(uri, (url, name), of_zip, limits, network_bytes).await? {
            Some(found) => found,
            None => self.by_directory(uri, (url, name), of_zip, limits, network_bytes).await?,
        };
        let data = archive::data_of(uri, &member, &part.bytes)?;
        let packed = part.bytes.get(data.start as usize..data.end as usize).map(<[u8]>::to_vec);
        let packed = packed.ok_or_else(|| IoError::invalid(uri, "the archive ends early"))?;
        let (of, limits_of) = (uri.to_owned(), *limits);
        let unpack = move || {
            let bytes = archive::unpack(&of, &member, packed, &limits_of)?;
            file::gunzip(&of, bytes, &limits_of)
        };
        let bytes = if member.size < DECODED_HERE_BYTES as u64 { unpack() } else { blocking(uri, unpack).await? }?;
        Ok((bytes, part))
    }

    /// Header and content of a file; `None` where the directory has to be asked.
    async fn by_index(
        &self,
        uri: &str,
        (url, name): (&str, &str),
        (archive, zip): (&RemoteArchive, &RemoteZip),
        limits: &Limits,
        network_bytes: &AtomicU64,
    ) -> Result<Option<(Member, Part)>, IoError> {
        let index = zip.index.as_ref().filter(|_| !zip.directory.is_read());
        let span = index.and_then(|index| index.find(name));
        let Some(span) = span.filter(|s| s.size <= limits.max_file_bytes.saturating_add((1 << 18) + SLACK_BYTES))
        else {
            return Ok(None);
        };
        let part = self.member_part(url, archive, span, limits, network_bytes).await?;
        let Some(member) = archive::own_header(&part.bytes, span.offset, name) else { return Ok(None) };
        archive::check(uri, &member, limits)?;
        Ok(Some((member, part)))
    }

    async fn by_directory(
        &self,
        uri: &str,
        (url, name): (&str, &str),
        (archive, zip): (&RemoteArchive, &RemoteZip),
        limits: &Limits,
        network_bytes: &AtomicU64,
    ) -> Result<(Member, Part), IoError> {
        let read = async || {
            check_directory(url, zip.place, limits)?;
            let part = self.member_part(url, archive, zip.place, limits, network_bytes).await?;
            read_directory(url, part.bytes, zip.place, limits).await
        };
        let directory = zip.directory.get_or_read(read).await?;
        let Some(member) = directory.find(name) else {
            self.confirm(directory, (url, name), (archive, zip), limits, network_bytes).await?;
            return Err(IoError::NotFound { uri: uri.to_owned() });
        };
        let span = archive::piece_of(uri, &member, zip.place.offset, limits)?;
        let mut part = self.member_part(url, archive, span, limits, network_bytes).await?;
        let data = archive::data_of(uri, &member, &part.bytes)?;
        if data.end > part.bytes.len() as u64 {
            let size = data.end.min(zip.place.offset - span.offset);
            part = self.member_part(url, archive, Span { size, ..span }, limits, network_bytes).await?;
        }
        Ok((member, part))
    }

    /// Makes sure that a file is missing, and that its name was not changed on the way here: a directory has no checksum.
    /// The index, which has one, says so; without one the directory is believed that came twice the same.
    async fn confirm(
        &self,
        directory: &Directory,
        (url, name): (&str, &str),
        (archive, zip): (&RemoteArchive, &RemoteZip),
        limits: &Limits,
        network_bytes: &AtomicU64,
    ) -> Result<(), IoError> {
        let is_same = match &zip.index {
            Some(index) => !index.has(name),
            None if zip.place.size == 0 => true,
            None => {
                let read = async || {
                    let part = self.member_part(url, archive, zip.place, limits, network_bytes).await?;
                    if directory.is_of(&part.bytes) { Ok(()) } else { Err(IoError::invalid(url, DAMAGED)) }
                };
                match zip.confirmed.get_or_read(read).await {
                    Err(IoError::Invalid { .. }) => false,
                    other => other.map(|()| true)?,
                }
            }
        };
        if is_same {
            return Ok(());
        }
        // The next one reads it anew.
        self.inner.archives.forget(url, archive);
        Err(IoError::invalid(url, DAMAGED))
    }

    async fn keep_member(&self, cache: &Arc<DiskCache>, uri: &str, part: &Part, bytes: &[u8]) {
        cache.count_miss();
        let freshness = part.freshness;
        if !freshness.store {
            return self.leave_out(cache, uri).await;
        }
        let mut entry = Entry { uri: shown(uri).into_owned(), ..Entry::default() };
        entry.checked(SystemTime::now(), freshness.fresh_for);
        keep_validators(&mut entry, &part.headers);
        let (of, bytes, asked) = (uri.to_owned(), bytes.to_vec(), part.asked);
        self.write_behind(cache, move |cache| cache.store(&of, entry, &bytes, asked)).await;
    }

    /// Reads the directory or the index: by one request where the archive is small, else by two or three.
    async fn open_archive(
        &self,
        url: &str,
        limits: &Limits,
        network_bytes: &AtomicU64,
    ) -> Result<Arc<RemoteArchive>, IoError> {
        if is_pmtiles(url.split('?').next().unwrap_or(url)) {
            return self.open_tiles(url, limits, network_bytes).await;
        }
        let end = |length: u64| {
            let size = length.min(TAIL_BYTES);
            Span { offset: length - size, size }
        };
        let tail = match self.part(url, &format!("bytes=-{TAIL_BYTES}"), limits, network_bytes).await {
            // Some servers (Azure's) know no range that counts from the end: the length comes with any other.
            Err(IoError::Unsupported { .. } | IoError::Status { status: 400 | 416, .. }) => {
                let length = self.part(url, "bytes=0-0", limits, network_bytes).await?.length;
                self.part(url, &range(end(length)), limits, network_bytes).await?
            }
            // Others take it for one from the beginning.
            Ok(part) if part.offset + part.bytes.len() as u64 != part.length => {
                self.part(url, &range(end(part.length)), limits, network_bytes).await?
            }
            other => other?,
        };
        let (length, etag) = (tail.length, tail.etag());
        let at = async |span: Span| match span.of(&tail.bytes, tail.offset) {
            Some(bytes) => Ok(bytes.to_vec()),
            None => {
                let part = self.part(url, &range(span), limits, network_bytes).await?;
                same(url, &part, span, length, &etag)?;
                Ok(part.bytes)
            }
        };
        let (place, files) = match End::find(url, &tail.bytes, tail.offset)? {
            End::Directory(place, files) => (place, files),
            End::Record(span) => match End::of_record(url, &at(span).await?, span.offset)? {
                End::Directory(place, files) => (place, files),
                End::Record(_) => return Err(IoError::invalid(url, "zip archive: its end points to itself")),
            },
        };
        let is_here = place.of(&tail.bytes, tail.offset).is_some();
        let mut index = None;
        // Beside a directory that is here it costs no request.
        if let Some(own) = Index::place(&tail.bytes, tail.offset, place)
            && let Some(piece) = Index::piece(&own, place)
            && (!is_here || piece.of(&tail.bytes, tail.offset).is_some())
            && piece.size <= limits.max_file_bytes
            && files <= limits.max_elements as u64
        {
            let piece = at(piece).await?;
            index = blocking(url, move || Index::read(&own, &piece, place, files)).await?;
        }
        let directory = Once::default();
        if index.is_none() || is_here {
            check_directory(url, place, limits)?;
            let bytes = if place.size == 0 { Vec::new() } else { at(place).await? };
            // Nobody else has it yet.
            directory.get_or_read(async || read_directory(url, bytes, place, limits).await).await?;
        }
        let zip = RemoteZip { place, index, directory, confirmed: Once::default() };
        Ok(Arc::new(RemoteArchive::of(&tail, Inside::Zip(Box::new(zip)))))
    }

    /// A part of an archive that has to be the one whose beginning or end was read.
    pub(super) async fn member_part(
        &self,
        url: &str,
        archive: &RemoteArchive,
        span: Span,
        limits: &Limits,
        network_bytes: &AtomicU64,
    ) -> Result<Part, IoError> {
        // The headers before a content of the largest size come with it.
        let limits =
            Limits { max_file_bytes: limits.max_file_bytes.saturating_add((1 << 18) + SLACK_BYTES), ..*limits };
        let mut part = match self.part(url, &range(span), &limits, network_bytes).await {
            // Shorter than it was, or something else in its place: parts of it could be had.
            Err(IoError::Status { status: 416, .. } | IoError::Unsupported { .. }) => {
                self.inner.archives.forget(url, archive);
                return Err(changed(url));
            }
            other => other?,
        };
        if part.offset == 0 && part.bytes.len() as u64 == part.length {
            // From a server without range requests: all of it.
            let end = span.offset.saturating_add(span.size);
            let piece = part.bytes.get(span.offset as usize..end as usize).map(<[u8]>::to_vec);
            part = Part { bytes: piece.unwrap_or_default(), offset: span.offset, ..part };
        }
        if let Err(error) = same(url, &part, span, archive.length, &archive.etag) {
            // The next one reads the directory anew.
            self.inner.archives.forget(url, archive);
            return Err(error);
        }
        if archive.etag.is_some() && part.etag() == archive.etag {
            *archive.seen() = part.asked;
        }
        Ok(part)
    }

    pub(super) async fn part(
        &self,
        url: &str,
        range: &str,
        limits: &Limits,
        network_bytes: &AtomicU64,
    ) -> Result<Part, IoError> {
        let mut headers = HeaderMap::new();
        let value = HeaderValue::from_str(range).map_err(|_| IoError::invalid(url, "a range of the archive"))?;
        headers.insert(RANGE, value);
        // A part of something compressed on its way is no use.
        headers.insert(ACCEPT_ENCODING, HeaderValue::from_static("identity"));
        let asked = Instant::now();
        let answer = self.exchange(url, &headers, None, limits).await?;
        network_bytes.fetch_add(answer.body.len() as u64, Ordering::Relaxed);
        let (offset, length) = match answer.status {
            206 => {
                let text = answer.headers.get(CONTENT_RANGE).and_then(|v| v.to_str().ok());
                let told = text.and_then(content_range).filter(|(first, last, length)| {
                    last < length && last.checked_sub(*first) == Some((answer.body.len() as u64).wrapping_sub(1))
                });
                let broken = || IoError::invalid(url, "an answer to a range request without its range");
                let (first, _, length) = told.ok_or_else(broken)?;
                (first, length)
            }
            _ if answer.is_whole() => {
                // A page for people in its place passes.
                refuse_markup(url, &answer.body)?;
                (0, answer.body.len() as u64)
            }
            _ => return Err(answer.error(url)),
        };
        let exchange::Answer { body: bytes, headers, freshness, .. } = answer;
        Ok(Part { bytes, offset, length, asked, headers, freshness })
    }
}

fn check_directory(url: &str, place: Span, limits: &Limits) -> Result<(), IoError> {
    if place.size > limits.max_file_bytes {
        let (got, limit) = (place.size, limits.max_file_bytes);
        return Err(IoError::TooLarge { uri: url.to_owned(), what: "directory of an archive", got, limit });
    }
    Ok(())
}

async fn read_directory(url: &str, bytes: Vec<u8>, place: Span, limits: &Limits) -> Result<Directory, IoError> {
    let (of, limits) = (url.to_owned(), *limits);
    blocking(url, move || Directory::read(&of, bytes, place.offset, &limits)).await?
}

pub(super) fn range(Span { offset, size }: Span) -> String {
    format!("bytes={offset}-{}", offset.saturating_add(size).saturating_sub(1))
}

/// First and last byte and length of the whole.
pub(super) fn content_range(text: &str) -> Option<(u64, u64, u64)> {
    let (span, length) = text.trim().strip_prefix("bytes ")?.split_once('/')?;
    let (first, last) = span.split_once('-')?;
    Some((first.trim().parse().ok()?, last.trim().parse().ok()?, length.trim().parse().ok()?))
}

/// Passes: the next request reads the new directory.
fn changed(url: &str) -> IoError {
    IoError::Network { uri: url.to_owned(), reason: "the archive has changed".to_owned() }
}

/// The part that was asked for, of the archive whose end was read.
fn same(url: &str, part: &Part, span: Span, length: u64, etag: &Option<String>) -> Result<(), IoError> {
    let etags_differ = matches!((part.etag(), etag), (Some(a), Some(b)) if a != *b);
    if part.length != length || etags_differ {
        return Err(changed(url));
    }
    if part.offset != span.offset || part.bytes.len() as u64 != span.size {
        return Err(IoError::invalid(url, "another part of the archive than was asked for"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_archive_vouches_for_what_came_with_it_for_a_while() {
        let now = Instant::now();
        let archive = |etag: &str| {
            let zip = RemoteZip {
                place: Span { offset: 0, size: 0 },
                index: None,
                directory: Once::default(),
                confirmed: Once::default(),
            };
            let (etag, seen) = (Some(etag.to_owned()), Mutex::new(now));
            RemoteArchive { length: 9, etag, seen, inside: Inside::Zip(Box::new(zip)) }
        };
        let kept = |etag: &str| Entry { etag: Some(etag.to_owned()), ..Entry::default() };
        let strong = archive("\"1\"");
        assert!(strong.vouches_for(&kept("\"1\""), now) && strong.vouches_for(&kept("\"1\""), now + VOUCHES_FOR / 2));
        // It may be another one by now: its directory was read long ago.
        assert!(!strong.vouches_for(&kept("\"1\""), now + VOUCHES_FOR));
        *strong.seen() = now + VOUCHES_FOR;
        assert!(strong.vouches_for(&kept("\"1\""), now + VOUCHES_FOR));
        assert!(!strong.vouches_for(&kept("\"2\""), now) && !strong.vouches_for(&Entry::default(), now));
        assert!(!archive("W/\"1\"").vouches_for(&kept("W/\"1\""), now), "weak ones say little");
    }

    #[test]
    fn ranges() {
        assert_eq!(range(Span { offset: 10, size: 5 }), "bytes=10-14");
        assert_eq!(content_range("bytes 10-14/100"), Some((10, 14, 100)));
        for odd in ["", "bytes */100", "bytes 10-14/*", "items 1-2/3", "bytes -5/10"] {
            assert_eq!(content_range(odd), None, "{odd}");
        }
    }
}
