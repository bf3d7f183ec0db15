//! Services that ask for a key: Cesium ion and Google's Photorealistic 3D Tiles. They say where a tile set is, which
//! credentials its requests carry, and whom to name beside it.

mod google;
mod ion;
mod token;

pub use google::{GOOGLE_SERVER, google_tiles};
#[cfg(feature = "testing")]
pub use ion::fuzz_ion_endpoint;
pub use ion::{ION_SERVER, IonAsset};
pub(in crate::fetch) use token::ExpiringToken;

use super::Credential;

/// What a service offers under an address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServiceKind {
    /// A tile set: 3D Tiles.
    Tiles,
    /// Terrain: the address of a layer.json.
    Terrain,
    /// Imagery: the folder of a tile map (TMS).
    Imagery,
}

/// Where the data of a service is and how it is asked for.
#[derive(Clone, Debug)]
pub struct ServiceSource {
    /// What it is.
    pub kind: ServiceKind,
    /// Its URL.
    pub uri: String,
    /// The credentials of its requests, for [`HttpConfig::credentials`](super::HttpConfig::credentials).
    pub credentials: Vec<Credential>,
    /// The names of its owners, as plain text, which the terms of services ask to be shown.
    pub attributions: Vec<String>,
}

/// Returns the text of a piece of HTML: without tags, with the common entities replaced, and at most 500 characters.
fn plain_text(html: &str) -> String {
    const MAX_CHARS: usize = 500;
    let mut text = String::new();
    let mut in_tag = false;
    for c in html.chars() {
        match c {
            '<' => in_tag = true,
            '>' => in_tag = false,
            _ if in_tag => {}
            c if c.is_whitespace() => {
                if !text.ends_with(' ') {
                    text.push(' ');
                }
            }
            c => text.push(c),
        }
    }
    for (entity, c) in
        [("&nbsp;", " "), ("&lt;", "<"), ("&gt;", ">"), ("&quot;", "\""), ("&copy;", "©"), ("&amp;", "&")]
    {
        text = text.replace(entity, c);
    }
    text.trim().chars().take(MAX_CHARS).collect()
}

#[cfg(test)]
mod tests {
    use super::plain_text;

    #[test]
    fn attributions_become_plain_text() {
        let html = "<a href=\"https://x\"><img src=\"logo.png\" alt=\"X\"></a>\n  &copy; 2026 <b>Survey &amp;</b> Sons";
        assert_eq!(plain_text(html), "© 2026 Survey & Sons");
        assert_eq!(plain_text("an < unclosed tag"), "an");
        assert_eq!(plain_text(&"ä".repeat(9_000)).chars().count(), 500);
    }
}
