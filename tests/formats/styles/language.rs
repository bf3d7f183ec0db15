//! Expressions: the examples of the specification, operators, functions, and errors with their columns.

use serde_json::{Value, json};
use terrane::formats::{Style, StyleError};
use terrane::scene::{Feature, PropertyColumn, PropertyTable, PropertyValue};

/// The same value in each row.
struct Same(PropertyValue);

impl PropertyColumn for Same {
    fn value(&self, _row: usize) -> PropertyValue {
        self.0.clone()
    }

    fn size_bytes(&self) -> usize {
        0
    }
}

fn value_of(json: &Value) -> PropertyValue {
    match json {
        Value::Null => PropertyValue::Null,
        Value::Bool(value) => PropertyValue::Bool(*value),
        Value::Number(number) => PropertyValue::Float(number.as_f64().unwrap()),
        Value::String(text) => PropertyValue::Text(text.clone()),
        Value::Array(parts) => PropertyValue::List(parts.iter().map(value_of).collect()),
        Value::Object(members) => {
            PropertyValue::Object(members.iter().map(|(name, value)| (name.clone(), value_of(value))).collect())
        }
    }
}

/// The properties that the examples of the specification use.
fn table() -> PropertyTable {
    let properties = json!({
        "Height": 70, "Area": 3.5, "ZipCode": "19341", "County": "Chester", "YearBuilt": 1980, "Temperature": 95,
        "red": 255, "green": 128, "blue": 0, "volume": 128, "id": "2", "enabled": true, "description": null,
        "order": 1, "name": "Feature name", "feature": "building", "Name": "Building 1",
        "address": { "street": "Oak Street", "city": "Example city" }, "address.street": "Maple Street",
        "temperatures": { "scale": "fahrenheit", "values": [70, 80, 90, 95, 97] },
        "addr:street": "Elm", "RightVector": [1, 0, 0], "UpVector": [0, 1, 0], "größe": 7,
    });
    let columns = properties.as_object().unwrap().iter();
    let columns = columns.map(|(name, value)| (name.clone().into(), Box::new(Same(value_of(value))) as _)).collect();
    PropertyTable::new("t".into(), "c".into(), 1, columns)
}

fn parse(style: &Value) -> Result<Style, StyleError> {
    Style::from_json("style.json", style.to_string().as_bytes())
}

/// Returns the value of an expression for the feature with the properties of [`table`].
fn evaluate(expression: &str) -> String {
    let style = parse(&json!({ "meta": { "x": expression } })).unwrap_or_else(|error| panic!("{expression}: {error}"));
    let table = table();
    let feature = Feature { label: "", id: 0, table: Some(&table) };
    let [("x", value)] = &style.meta(&feature)[..] else { panic!("one value") };
    value.to_string()
}

#[test]
fn expressions_have_the_values_of_the_specification() {
    for (expression, expected) in [
        // Variables.
        ("${ZipCode} === '19341'", "true"),
        ("(regExp('^Chest').test(${County})) && (${YearBuilt} >= 1970)", "true"),
        ("(${Temperature} > 90) ? color('red') : color('white')", "[1, 0, 0, 1]"),
        ("rgba(${red}, ${green}, ${blue}, (${volume} > 100 ? 0.5 : 1.0)).a", "0.5"),
        ("${enabled} === true && ${description} === null && ${order} === 1", "true"),
        ("${missing} === undefined", "true"),
        ("${address.street} === `Oak Street`", "true"),
        ("${address['city']}", "Example city"),
        ("${feature.address.street} + ', ' + ${feature['address'].street}", "Oak Street, Oak Street"),
        ("${feature['address.street']}", "Maple Street"),
        ("${feature} === ${feature.feature}", "true"),
        ("${feature['addr:street']}", "Elm"),
        ("${größe}", "7"),
        ("`Name is ${name}, order is ${order}`", "Name is Feature name, order is 1"),
        ("'${addr:street}, ${missing}, ${temperatures.values[1]}, ${'", "Elm, , 80, ${"),
        ("${temperatures['scale']}", "fahrenheit"),
        ("${temperatures.values[0]} + ${temperatures['values'][1]}", "150"),
        ("${temperatures.values}[1 + 1]", "90"),
        ("${temperatures.values}.length", "5"),
        // Types and constants.
        ("[0, 1, 'a']", "[0, 1, a]"),
        ("null", "null"),
        ("undefined", "null"),
        ("NaN === NaN", "false"),
        ("Infinity === Number.POSITIVE_INFINITY", "true"),
        ("Math.PI > 3.14159 && Math.E < 2.71829", "true"),
        ("1e3 + .5 + 2.", "1002.5"),
        // Vectors and colours.
        ("vec4(1.0) === vec4(1.0)", "true"),
        ("vec3(1.0) === vec4(1.0)", "false"),
        ("vec2(vec4(1, 2, 3, 4))", "[1, 2]"),
        ("vec3(1, vec2(2, 3))", "[1, 2, 3]"),
        ("vec4(vec3(1, 2, 3), 4)", "[1, 2, 3, 4]"),
        ("vec4(1, 2)", "null"),
        ("vec3(1, 2, vec2(3, 4))", "null"),
        ("-vec2(1, 2) + 2 * vec2(3) / 2", "[2, 1]"),
        ("vec3(5, 6, 7) % vec3(3)", "[2, 0, 1]"),
        ("color('red').r + color('red').x + color('red')[0] + color('red')['r']", "4"),
        ("color('red').toString()", "(1, 0, 0, 1)"),
        ("color('red') * vec4(0.5)", "[0.5, 0, 0, 0.5]"),
        (
            "color() === color('#FFFFFF') && color('#00FFFF') === color('cyan') && color('#0FF') === color('CYAN')",
            "true",
        ),
        ("color('cyan', 0.5)", "[0, 1, 1, 0.5]"),
        ("color('no colour')", "null"),
        ("rgb(51, 255, 102)", "[0.2, 1, 0.4, 1]"),
        ("hsla(0.5, 1, 0.5, 0.75)", "[0, 1, 1, 0.75]"),
        // Regular expressions.
        ("regExp('a').test('abc')", "true"),
        ("regExp('a(.)', 'i').exec('Abc')", "b"),
        (r"regExp('Building\s(\d)').exec(${Name})", "1"),
        ("regExp('x').exec('abc')", "null"),
        ("regExp('a') =~ 'abc' && 'abc' =~ regExp('a')", "true"),
        ("regExp('a') !~ 'bcd' && 'bcd' !~ regExp('a')", "true"),
        ("regExp(${County}).toString() + regExp()", "/Chester//(?:)/"),
        // Operators.
        ("1 + 2 * 3 - 4 / 2 % 3", "5"),
        ("(1 + 2) * 3", "9"),
        ("-2 - -3", "1"),
        ("!true || !false && 1 < 2", "true"),
        ("1 < 2 === true", "true"),
        ("'name' + 10", "name10"),
        ("1 + 2 + 'a'", "3a"),
        ("false ? 1 : true ? 2 : 3", "2"),
        ("true ? false ? 1 : 2 : 3", "2"),
        ("'5' < 6", "false"),
        ("${missing} > 5", "false"),
        ("${missing} + 1", "null"),
        ("-'a'", "null"),
        // Conversions.
        ("Boolean(1) === true && Number('1') === 1 && String(1) === '1'", "true"),
        ("String(vec2(1, 2)) + String([0, 1]) + String(null) + String(undefined)", "(1, 2)[0, 1]nullundefined"),
        ("isNaN('a') && isNaN() && !isNaN(null) && isFinite('1') && !isFinite(1 / 0)", "true"),
        // Functions.
        ("abs(-1) + sqrt(4) + sign(-3) + floor(1.5) + ceil(1.5) + round(1.5)", "7"),
        ("sqrt(-1)", "NaN"),
        ("cos(0) + sin(0) + tan(0) + acos(1) + asin(0) + atan(0) + atan2(0, 1)", "1"),
        ("degrees(Math.PI) + round(radians(180))", "183"),
        ("exp(0) + log(1) + exp2(3) + log2(8) + fract(1.25) + pow(2, 3)", "20.25"),
        ("min(vec2(1, 4), 2) + max(vec2(1, 4), vec2(3))", "[4, 6]"),
        ("clamp(vec3(-1, 0.5, 2), 0, 1)", "[0, 0.5, 1]"),
        ("clamp(1, 3, 2)", "2"),
        ("mix(20, 40, 0.25) + mix(vec2(0), vec2(2), vec2(0.5, 1)).y", "27"),
        ("length(vec2(3, 4)) + length(-1) + distance(vec2(1, 1), vec2(1, 3)) + distance(1, 4)", "11"),
        ("normalize(vec2(0, 5)) + vec2(normalize(7))", "[1, 2]"),
        ("dot(${RightVector}, ${UpVector}) + dot(2, 3)", "6"),
        ("vec4(cross(${RightVector}, ${UpVector}), 1.0)", "[0, 0, 1, 1]"),
        ("abs('a')", "null"),
    ] {
        assert_eq!(evaluate(expression), expected, "{expression}");
    }
}

#[test]
fn logic_evaluates_only_what_it_needs() {
    // A regular expression that is made at run time and is invalid has no value.
    for (expression, expected) in [
        ("true || regExp('(' + '').test('')", "true"),
        ("false && regExp('(' + '').test('')", "false"),
        ("regExp('(' + '').test('')", "null"),
        ("true ? 1 : regExp('(' + '')", "1"),
    ] {
        assert_eq!(evaluate(expression), expected, "{expression}");
    }
}

#[test]
fn defines_are_variables_that_see_properties() {
    let style = json!({
        "defines": { "NewHeight": "clamp((${Height} - 0.5) / 2.0, 1.0, 255.0)", "Height": "${Height} / 2" },
        "meta": { "a": "${NewHeight}", "b": "${Height}", "c": "${feature.Height}", "d": "'${Height}'" },
    });
    let (style, table) = (parse(&style).unwrap(), table());
    let values = style.meta(&Feature { label: "", id: 0, table: Some(&table) });
    let values: Vec<String> = values.iter().map(|(name, value)| format!("{name} {value}")).collect();
    assert_eq!(values, ["a 34.75", "b 35", "c 70", "d 35"]);
}

#[test]
fn errors_name_member_and_column() {
    let error = |style: Value| parse(&style).unwrap_err().to_string();
    for (style, expected) in [
        (json!({ "show": "1 +" }), "style.json: show, column 4: found the end, expected a value"),
        (json!({ "show": "1 == 1" }), "style.json: show, column 3: found the operator ==, which the language lacks"),
        (json!({ "show": "1 & 2" }), "show, column 3: found the operator &"),
        (json!({ "show": "${a" }), "show, column 4: found the end, expected }"),
        (json!({ "show": "${a[b]}" }), "show, column 5: found 'b', expected a name in quotes or an index"),
        (json!({ "show": "'äöü' 'b'" }), "show, column 7: found '\\'', expected an operator or the end"),
        (json!({ "show": "'abc" }), "show, column 1: a string without an end"),
        (json!({ "show": "Height > 3" }), "show, column 1: Height is unknown; properties are written ${Height}"),
        (json!({ "show": "1px" }), "show, column 2: found 'p', expected the end of the number"),
        (json!({ "show": "Math.TAU" }), "show, column 1: a constant of Math"),
        (json!({ "color": "rgb(1, 2)" }), "color, column 1: rgb has 2 arguments, expected 3"),
        (json!({ "color": "color('a' 'b')" }), "color, column 11: found '\\'', expected , or )"),
        (json!({ "show": "true && regExp('(').test('')" }), "show, column 9: the regular expression is invalid"),
        (json!({ "show": "regExp('(?=a)b')" }), "look-around"),
        (json!({ "show": "regExp('a').test()" }), "show, column 13: test needs an argument"),
        (json!({ "color": { "conditions": [["true", "color("]] } }), "color.conditions[0][1], column 7"),
        (json!({ "color": { "conditions": [["true"]] } }), "color.conditions[0] is a list of another length or type"),
        (json!({ "color": { "conditions": "a" } }), "color.conditions is a string, expected a list"),
        (json!({ "pointSize": [1] }), "pointSize is a list"),
        (json!({ "defines": { "a": "(" } }), "defines.a, column 2"),
        (json!({ "meta": "a" }), "meta is a string, expected an object"),
        (json!([]), "style.json: the style is not a JSON object"),
    ] {
        let error = error(style.clone());
        assert!(error.contains(expected), "{style}: {error}");
    }
}

#[test]
fn unusual_members_do_not_refuse_a_style() {
    for style in [
        json!({}),
        json!({ "show": null, "color": null, "meta": null, "defines": null, "labelText": "${name}" }),
        json!({ "show": true, "pointSize": 5, "color": { "conditions": [[true, "color('red')"]] } }),
        json!({ "show": "isClass('door')", "color": { "expression": "color()" } }),
        json!({ "show": { "conditions": [] } }),
    ] {
        parse(&style).unwrap_or_else(|error| panic!("{style}: {error}"));
    }
    Style::from_json("s", b"\xef\xbb\xbf{}").unwrap();
}

#[test]
fn depth_and_length_are_bounded() {
    let around = |open: &str, middle: &str, close: &str, depth: usize| json!({ "show": format!("{}{middle}{}", open.repeat(depth), close.repeat(depth)) });
    for (open, middle, close) in [
        ("(", "1", ")"),
        ("[", "1", "]"),
        ("!", "1", ""),
        ("abs(", "1", ")"),
        ("true ? ", "1", " : 1"),
        ("[1][", "0", "]"),
    ] {
        parse(&around(open, middle, close, 60)).unwrap();
        let error = parse(&around(open, middle, close, 100_000)).unwrap_err().to_string();
        assert!(error.contains("deeper than 64 levels"), "{error}");
    }
    // Chains are not deep.
    for link in ["1 + ", "true || ", "false ? 1 : ", "${id} === 'a' || "] {
        let style = parse(&around(link, "1", "", 20_000)).unwrap();
        drop(style);
    }
    assert_eq!(evaluate(&["1 + ".repeat(20_000), "1".into()].concat()), "20001");
    assert_eq!(evaluate(&["vec2(1)".to_owned(), ".toString()".repeat(20_000)].concat()), "(1, 1)");
    let long = Style::from_json("style.json", &vec![b' '; 9 << 20]).unwrap_err();
    assert_eq!(long.to_string(), "style.json: the style has 9437184 bytes, at most 8388608 are read");
}
