//! [`Element`]: an XML document as a small tree. Namespaces are left out. Any thread.

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

/// The maximum depth of nested elements.
const MAX_DEPTH: usize = 64;
/// The maximum number of elements; each costs a few hundred bytes of memory.
const MAX_ELEMENTS: usize = 200_000;

/// An element with what is inside it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Element {
    /// The name without its prefix.
    pub name: String,
    attributes: Vec<(String, String)>,
    text: String,
    children: Vec<Element>,
}

impl Element {
    /// Parses a document; returns its root.
    ///
    /// # Errors
    /// The reason if the document is not well-formed or too large.
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        let text = std::str::from_utf8(bytes).map_err(|_| "the XML is not UTF-8".to_owned())?;
        let mut reader = Reader::from_str(text.trim_start_matches('\u{feff}'));
        // Elements that are open, outermost first. The first stands for the document.
        let mut open = vec![Self::default()];
        let mut count = 0usize;
        loop {
            let event = reader.read_event().map_err(|error| format!("XML: {error}"))?;
            let innermost = open.last_mut().ok_or("XML: too many closing tags")?;
            match event {
                Event::Start(start) => {
                    let element = Self::of(&start)?;
                    count += 1;
                    if open.len() > MAX_DEPTH || count > MAX_ELEMENTS {
                        return Err("XML: too many elements".to_owned());
                    }
                    open.push(element);
                }
                Event::Empty(start) => {
                    count += 1;
                    if count > MAX_ELEMENTS {
                        return Err("XML: too many elements".to_owned());
                    }
                    innermost.children.push(Self::of(&start)?);
                }
                Event::End(_) => {
                    let closed = open.pop().ok_or("XML: too many closing tags")?;
                    open.last_mut().ok_or("XML: too many closing tags")?.children.push(closed);
                }
                Event::Text(text) => innermost.text.push_str(&text.decode().map_err(|error| format!("XML: {error}"))?),
                Event::CData(text) => innermost.text.push_str(&text.decode().map_err(|error| format!("XML: {error}"))?),
                Event::GeneralRef(name) => {
                    let name = name.decode().map_err(|error| format!("XML: {error}"))?;
                    let escaped = format!("&{name};");
                    let text = quick_xml::escape::unescape(&escaped).map_err(|error| format!("XML: {error}"))?;
                    innermost.text.push_str(&text);
                }
                Event::Eof => break,
                _ => {}
            }
        }
        let document = open.pop().filter(|_| open.is_empty()).ok_or("XML: an element is not closed")?;
        document.children.into_iter().next().ok_or_else(|| "XML without an element".to_owned())
    }

    fn of(start: &BytesStart<'_>) -> Result<Self, String> {
        let name = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        let mut element = Self { name: name(start.local_name().as_ref()), ..Self::default() };
        for attribute in start.attributes() {
            let attribute = attribute.map_err(|error| format!("XML: {error}"))?;
            let value = String::from_utf8_lossy(&attribute.value).into_owned();
            let value = quick_xml::escape::unescape(&value).map_err(|error| format!("XML: {error}"))?.into_owned();
            element.attributes.push((name(attribute.key.local_name().as_ref()), value));
        }
        Ok(element)
    }

    /// Returns the children of a name.
    pub fn all<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a Self> {
        self.children.iter().filter(move |child| child.name == name)
    }

    /// Returns the first child of a name.
    pub fn child<'a>(&'a self, name: &'a str) -> Option<&'a Self> {
        self.all(name).next()
    }

    /// Returns the first element on a path of names.
    pub fn at(&self, path: &[&str]) -> Option<&Self> {
        path.iter().try_fold(self, |element, name| element.children.iter().find(|child| child.name == *name))
    }

    /// Returns the text of the first child of a name, without spaces around it.
    pub fn text_of(&self, name: &str) -> Option<&str> {
        self.children.iter().find(|child| child.name == name).map(Self::text)
    }

    /// Returns the text without spaces around it.
    pub fn text(&self) -> &str {
        self.text.trim()
    }

    /// Returns an attribute.
    pub fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(known, _)| known == name).map(|(_, value)| &**value)
    }

    /// Returns an attribute as a finite number.
    pub fn number(&self, name: &str) -> Option<f64> {
        finite(self.attribute(name)?)
    }
}

/// Returns a text as a finite number.
pub(super) fn finite(text: &str) -> Option<f64> {
    text.trim().parse::<f64>().ok().filter(|number| number.is_finite())
}

/// Returns the numbers of a text that spaces separate, if there are as many as expected.
pub(super) fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let found: Option<Vec<f64>> = text.split_whitespace().map(finite).collect();
    found?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn documents_become_trees_without_namespaces() {
        let text = br#"<?xml version="1.0"?><!-- x --><a:Root xmlns:a="u"><a:B k="1 &amp; 2">x &lt; <![CDATA[<y>]]></a:B><a:B/></a:Root>"#;
        let root = Element::parse(text).unwrap();
        assert_eq!((&*root.name, root.all("B").count()), ("Root", 2));
        let first = root.child("B").unwrap();
        assert_eq!((first.attribute("k"), first.text()), (Some("1 & 2"), "x < <y>"));
    }

    #[test]
    fn broken_documents_are_errors() {
        for text in [&b"<a><b></a>"[..], b"<a>", b"", b"text", b"\xff", b"<a></a></b>", b"<a k=></a>", b"<a>&nope;</a>"]
        {
            assert!(Element::parse(text).is_err(), "{:?}", String::from_utf8_lossy(text));
        }
        let deep = "<a>".repeat(100) + &"</a>".repeat(100);
        assert_eq!(Element::parse(deep.as_bytes()), Err("XML: too many elements".to_owned()));
        assert_eq!(numbers::<2>("1 -2.5"), Some([1.0, -2.5]));
        assert_eq!((numbers::<2>("1"), numbers::<2>("1 nan"), numbers::<2>("1 2 3")), (None, None, None));
    }
}
