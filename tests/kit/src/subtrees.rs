//! Writes subtree files of implicit tiling.

/// How tiles are divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// Four children.
    Quadtree,
    /// Eight children.
    Octree,
}

impl Scheme {
    /// Returns the name in a tileset.
    pub fn name(self) -> &'static str {
        match self {
            Self::Quadtree => "QUADTREE",
            Self::Octree => "OCTREE",
        }
    }

    /// Returns the number of children of a tile.
    pub fn child_count(self) -> u32 {
        match self {
            Self::Quadtree => 4,
            Self::Octree => 8,
        }
    }

    /// Returns the number of tiles in a level.
    fn count(self, level: u32) -> usize {
        (self.child_count() as usize).pow(level)
    }

    fn morton(self, level: u32, at: [u32; 3]) -> usize {
        let axes = if self == Self::Quadtree { 2 } else { 3 };
        let bit = |bit: u32, axis: usize| (at[axis] as usize >> bit & 1) << (bit as usize * axes + axis);
        (0..level).flat_map(|level| (0..axes).map(move |axis| bit(level, axis))).sum()
    }
}

/// Which elements of a set are available.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Availability {
    /// All or none.
    Constant(bool),
    /// Each its own.
    Bits(Vec<bool>),
}

/// A subtree to be written.
#[derive(Clone, Debug)]
pub struct Subtree {
    scheme: Scheme,
    levels: u32,
    tiles: Vec<bool>,
    contents: Vec<Vec<bool>>,
    children: Availability,
}

impl Subtree {
    /// Creates a subtree without tiles.
    pub fn new(scheme: Scheme, levels: u32, contents: usize) -> Self {
        let count = (0..levels).map(|level| scheme.count(level)).sum();
        let children = Availability::Constant(false);
        Self { scheme, levels, tiles: vec![false; count], contents: vec![vec![false; count]; contents], children }
    }

    fn index(&self, level: u32, at: [u32; 3]) -> usize {
        (0..level).map(|level| self.scheme.count(level)).sum::<usize>() + self.scheme.morton(level, at)
    }

    /// Makes a tile available.
    pub fn add_tile(&mut self, level: u32, at: [u32; 3]) {
        let index = self.index(level, at);
        self.tiles[index] = true;
    }

    /// Makes a content of a tile available.
    pub fn add_content(&mut self, content: usize, level: u32, at: [u32; 3]) {
        let index = self.index(level, at);
        self.contents[content][index] = true;
    }

    /// Makes a child subtree available.
    pub fn add_child(&mut self, at: [u32; 3]) {
        let index = self.scheme.morton(self.levels, at);
        if let Availability::Constant(constant) = self.children {
            self.children = Availability::Bits(vec![constant; self.scheme.count(self.levels)]);
        }
        if let Availability::Bits(bits) = &mut self.children {
            bits[index] = true;
        }
    }

    /// Makes all tiles and contents available.
    pub fn fill(&mut self) {
        self.tiles.fill(true);
        self.contents.iter_mut().for_each(|contents| contents.fill(true));
    }

    /// Replaces the availability of child subtrees.
    pub fn set_children(&mut self, children: Availability) {
        self.children = children;
    }

    /// Returns all bits that are not constant, each set padded to eight bytes.
    pub fn buffer(&self) -> Vec<u8> {
        let children = if let Availability::Bits(bits) = &self.children { Some(bits) } else { None };
        let mut bytes = Vec::new();
        for bits in std::iter::once(&self.tiles).chain(&self.contents).chain(children) {
            bytes.extend(bits.chunks(8).map(|bits| bits.iter().rev().fold(0, |byte, bit| byte << 1 | u8::from(*bit))));
            bytes.resize(bytes.len().next_multiple_of(8), 0);
        }
        bytes
    }

    /// Returns the JSON; `buffer` is the URI of the buffer, empty for the binary chunk.
    pub fn json(&self, buffer: &str) -> String {
        self.json_with(buffer, "bitstream", false)
    }

    fn json_with(&self, buffer: &str, bitstream: &str, is_1_0: bool) -> String {
        let uri = if buffer.is_empty() { String::new() } else { format!(r#","uri":"{buffer}""#) };
        let (mut views, mut offset) = (Vec::new(), 0);
        let mut view = |count: usize| {
            let length = count.div_ceil(8);
            views.push(format!(r#"{{"buffer":0,"byteOffset":{offset},"byteLength":{length}}}"#));
            offset += length.next_multiple_of(8);
            format!(r#"{{"{bitstream}":{}}}"#, views.len() - 1)
        };
        let tiles = view(self.tiles.len());
        let contents: Vec<String> = self.contents.iter().map(|bits| view(bits.len())).collect();
        let children = match &self.children {
            Availability::Constant(constant) => format!(r#"{{"constant":{}}}"#, u32::from(*constant)),
            Availability::Bits(bits) => view(bits.len()),
        };
        let contents = match &contents[..] {
            [one] if is_1_0 => one.clone(),
            all => format!("[{}]", all.join(",")),
        };
        format!(
            r#"{{"buffers":[{{"byteLength":{offset}{uri}}}],"bufferViews":[{}],"tileAvailability":{tiles},"contentAvailability":{contents},"childSubtreeAvailability":{children}}}"#,
            views.join(",")
        )
    }

    /// Returns a binary subtree.
    pub fn binary(&self) -> Vec<u8> {
        with_header(self.json(""), &self.buffer())
    }

    /// Returns a binary subtree with the names of the extension of 3D Tiles 1.0.
    pub fn binary_of_1_0(&self) -> Vec<u8> {
        with_header(self.json_with("", "bufferView", true), &self.buffer())
    }
}

fn with_header(mut json: String, buffer: &[u8]) -> Vec<u8> {
    while !json.len().is_multiple_of(8) {
        json.push(' ');
    }
    let mut bytes = b"subt\x01\0\0\0".to_vec();
    bytes.extend((json.len() as u64).to_le_bytes());
    bytes.extend((buffer.len() as u64).to_le_bytes());
    bytes.extend(json.as_bytes());
    bytes.extend(buffer);
    bytes
}
