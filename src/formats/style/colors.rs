//! Colours of CSS by keyword or in hexadecimal digits, and from hue, saturation and lightness. Any thread.

/// The keywords of CSS Color Module Level 4, section 6.1, with their values 0xRRGGBB, in alphabetical order.
const KEYWORDS: [(&str, u32); 148] = [
    ("aliceblue", 0xf0f8ff),
    ("antiquewhite", 0xfaebd7),
    ("aqua", 0x00ffff),
    ("aquamarine", 0x7fffd4),
    ("azure", 0xf0ffff),
    ("beige", 0xf5f5dc),
    ("bisque", 0xffe4c4),
    ("black", 0x000000),
    ("blanchedalmond", 0xffebcd),
    ("blue", 0x0000ff),
    ("blueviolet", 0x8a2be2),
    ("brown", 0xa52a2a),
    ("burlywood", 0xdeb887),
    ("cadetblue", 0x5f9ea0),
    ("chartreuse", 0x7fff00),
    ("chocolate", 0xd2691e),
    ("coral", 0xff7f50),
    ("cornflowerblue", 0x6495ed),
    ("cornsilk", 0xfff8dc),
    ("crimson", 0xdc143c),
    ("cyan", 0x00ffff),
    ("darkblue", 0x00008b),
    ("darkcyan", 0x008b8b),
    ("darkgoldenrod", 0xb8860b),
    ("darkgray", 0xa9a9a9),
    ("darkgreen", 0x006400),
    ("darkgrey", 0xa9a9a9),
    ("darkkhaki", 0xbdb76b),
    ("darkmagenta", 0x8b008b),
    ("darkolivegreen", 0x556b2f),
    ("darkorange", 0xff8c00),
    ("darkorchid", 0x9932cc),
    ("darkred", 0x8b0000),
    ("darksalmon", 0xe9967a),
    ("darkseagreen", 0x8fbc8f),
    ("darkslateblue", 0x483d8b),
    ("darkslategray", 0x2f4f4f),
    ("darkslategrey", 0x2f4f4f),
    ("darkturquoise", 0x00ced1),
    ("darkviolet", 0x9400d3),
    ("deeppink", 0xff1493),
    ("deepskyblue", 0x00bfff),
    ("dimgray", 0x696969),
    ("dimgrey", 0x696969),
    ("dodgerblue", 0x1e90ff),
    ("firebrick", 0xb22222),
    ("floralwhite", 0xfffaf0),
    ("forestgreen", 0x228b22),
    ("fuchsia", 0xff00ff),
    ("gainsboro", 0xdcdcdc),
    ("ghostwhite", 0xf8f8ff),
    ("gold", 0xffd700),
    ("goldenrod", 0xdaa520),
    ("gray", 0x808080),
    ("green", 0x008000),
    ("greenyellow", 0xadff2f),
    ("grey", 0x808080),
    ("honeydew", 0xf0fff0),
    ("hotpink", 0xff69b4),
    ("indianred", 0xcd5c5c),
    ("indigo", 0x4b0082),
    ("ivory", 0xfffff0),
    ("khaki", 0xf0e68c),
    ("lavender", 0xe6e6fa),
    ("lavenderblush", 0xfff0f5),
    ("lawngreen", 0x7cfc00),
    ("lemonchiffon", 0xfffacd),
    ("lightblue", 0xadd8e6),
    ("lightcoral", 0xf08080),
    ("lightcyan", 0xe0ffff),
    ("lightgoldenrodyellow", 0xfafad2),
    ("lightgray", 0xd3d3d3),
    ("lightgreen", 0x90ee90),
    ("lightgrey", 0xd3d3d3),
    ("lightpink", 0xffb6c1),
    ("lightsalmon", 0xffa07a),
    ("lightseagreen", 0x20b2aa),
    ("lightskyblue", 0x87cefa),
    ("lightslategray", 0x778899),
    ("lightslategrey", 0x778899),
    ("lightsteelblue", 0xb0c4de),
    ("lightyellow", 0xffffe0),
    ("lime", 0x00ff00),
    ("limegreen", 0x32cd32),
    ("linen", 0xfaf0e6),
    ("magenta", 0xff00ff),
    ("maroon", 0x800000),
    ("mediumaquamarine", 0x66cdaa),
    ("mediumblue", 0x0000cd),
    ("mediumorchid", 0xba55d3),
    ("mediumpurple", 0x9370db),
    ("mediumseagreen", 0x3cb371),
    ("mediumslateblue", 0x7b68ee),
    ("mediumspringgreen", 0x00fa9a),
    ("mediumturquoise", 0x48d1cc),
    ("mediumvioletred", 0xc71585),
    ("midnightblue", 0x191970),
    ("mintcream", 0xf5fffa),
    ("mistyrose", 0xffe4e1),
    ("moccasin", 0xffe4b5),
    ("navajowhite", 0xffdead),
    ("navy", 0x000080),
    ("oldlace", 0xfdf5e6),
    ("olive", 0x808000),
    ("olivedrab", 0x6b8e23),
    ("orange", 0xffa500),
    ("orangered", 0xff4500),
    ("orchid", 0xda70d6),
    ("palegoldenrod", 0xeee8aa),
    ("palegreen", 0x98fb98),
    ("paleturquoise", 0xafeeee),
    ("palevioletred", 0xdb7093),
    ("papayawhip", 0xffefd5),
    ("peachpuff", 0xffdab9),
    ("peru", 0xcd853f),
    ("pink", 0xffc0cb),
    ("plum", 0xdda0dd),
    ("powderblue", 0xb0e0e6),
    ("purple", 0x800080),
    ("rebeccapurple", 0x663399),
    ("red", 0xff0000),
    ("rosybrown", 0xbc8f8f),
    ("royalblue", 0x4169e1),
    ("saddlebrown", 0x8b4513),
    ("salmon", 0xfa8072),
    ("sandybrown", 0xf4a460),
    ("seagreen", 0x2e8b57),
    ("seashell", 0xfff5ee),
    ("sienna", 0xa0522d),
    ("silver", 0xc0c0c0),
    ("skyblue", 0x87ceeb),
    ("slateblue", 0x6a5acd),
    ("slategray", 0x708090),
    ("slategrey", 0x708090),
    ("snow", 0xfffafa),
    ("springgreen", 0x00ff7f),
    ("steelblue", 0x4682b4),
    ("tan", 0xd2b48c),
    ("teal", 0x008080),
    ("thistle", 0xd8bfd8),
    ("tomato", 0xff6347),
    ("turquoise", 0x40e0d0),
    ("violet", 0xee82ee),
    ("wheat", 0xf5deb3),
    ("white", 0xffffff),
    ("whitesmoke", 0xf5f5f5),
    ("yellow", 0xffff00),
    ("yellowgreen", 0x9acd32),
];

/// Returns the colour with a keyword or with 3, 4, 6 or 8 hexadecimal digits after `#`; `None` for other text. Components
/// are sRGB from 0 to 1.
pub(super) fn named(text: &str) -> Option<[f64; 4]> {
    let text = text.trim().to_ascii_lowercase();
    if text == "transparent" {
        return Some([0.0; 4]);
    }
    let of_bytes = |bytes: [u32; 4]| Some(bytes.map(|byte| f64::from(byte) / 255.0));
    let Some(hex) = text.strip_prefix('#') else {
        let at = KEYWORDS.binary_search_by_key(&text.as_str(), |(name, _)| name).ok()?;
        let rgb = KEYWORDS[at].1;
        return of_bytes([rgb >> 16, rgb >> 8 & 255, rgb & 255, 255]);
    };
    let digits: Vec<u32> = hex.chars().map(|digit| digit.to_digit(16)).collect::<Option<_>>()?;
    match digits[..] {
        [r, g, b] => of_bytes([17 * r, 17 * g, 17 * b, 255]),
        [r, g, b, a] => of_bytes([17 * r, 17 * g, 17 * b, 17 * a]),
        [r0, r1, g0, g1, b0, b1] => of_bytes([16 * r0 + r1, 16 * g0 + g1, 16 * b0 + b1, 255]),
        [r0, r1, g0, g1, b0, b1, a0, a1] => of_bytes([16 * r0 + r1, 16 * g0 + g1, 16 * b0 + b1, 16 * a0 + a1]),
        _ => None,
    }
}

/// Converts hue, saturation and lightness from 0 to 1 to red, green and blue (CSS Color Module Level 3, section 4.2.4). Hues
/// beyond are turned back into the range.
pub(super) fn rgb_from_hsl(hue: f64, saturation: f64, lightness: f64) -> [f64; 3] {
    let most = match lightness <= 0.5 {
        true => lightness * (saturation + 1.0),
        false => lightness + saturation - lightness * saturation,
    };
    let least = 2.0 * lightness - most;
    let part = |hue: f64| {
        let hue = hue.rem_euclid(1.0);
        match 6.0 * hue {
            h if h < 1.0 => least + (most - least) * h,
            h if h < 3.0 => most,
            h if h < 4.0 => least + (most - least) * (4.0 - h),
            _ => least,
        }
    };
    [part(hue + 1.0 / 3.0), part(hue), part(hue - 1.0 / 3.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keywords_and_digits_are_colors() {
        assert!(KEYWORDS.windows(2).all(|pair| pair[0].0 < pair[1].0), "sorted");
        assert_eq!(named("Cyan"), Some([0.0, 1.0, 1.0, 1.0]));
        assert_eq!(named("#0FF"), named("cyan"));
        assert_eq!(named(" #00ffff "), named("aqua"));
        assert_eq!(named("#00ff0080"), Some([0.0, 1.0, 0.0, 128.0 / 255.0]));
        assert_eq!(named("#0f08"), Some([0.0, 1.0, 0.0, 136.0 / 255.0]));
        assert_eq!(named("transparent"), Some([0.0; 4]));
        for none in ["", "#", "#12", "#12345", "#1234567", "#gggggg", "blau", "rgb(1,2,3)", "#éé"] {
            assert_eq!(named(none), None, "{none}");
        }
    }

    #[test]
    fn hues_become_colors() {
        let bytes = |h, s, l| rgb_from_hsl(h, s, l).map(|part| (part * 255.0).round() as u8);
        assert_eq!(bytes(0.0, 1.0, 0.5), [255, 0, 0]);
        assert_eq!(bytes(1.0 / 3.0, 1.0, 0.25), [0, 128, 0]);
        assert_eq!(bytes(1.0, 0.6, 0.7), [224, 133, 133]);
        assert_eq!(bytes(0.3, 0.0, 0.2), [51, 51, 51]);
    }
}
