//! Canonical JSON: equal values have equal texts, with sorted keys, without spaces, each number in
//! one form.

use serde_json::{Number, Value};

/// 2^53. Larger integers are not exact in a double.
const EXACT: f64 = 9_007_199_254_740_992.0;

/// A number in canonical form: an integer without `.0` (`-0` is `0`), otherwise the shortest
/// decimal that reads back as the same number. `null` if the number is not finite; no parameter is.
#[must_use]
pub(super) fn number(value: f64) -> Value {
    if value.fract() == 0.0 && value.abs() <= EXACT {
        return Value::from(value as i64);
    }
    Number::from_f64(value).map_or(Value::Null, Value::Number)
}

/// Canonical text of a JSON value. Equal values, such as `62` and `62.0`, have equal texts: the
/// text of `{"b": 62.0, "a": [1, 0.5]}` is `{"a":[1,0.5],"b":62}`.
#[must_use]
pub fn canonical_json(value: &Value) -> String {
    let mut text = String::new();
    write(value, &mut text);
    text
}

fn write(value: &Value, text: &mut String) {
    match value {
        Value::Number(n) if n.is_f64() => text.push_str(&number(n.as_f64().unwrap_or_default()).to_string()),
        Value::Array(items) => {
            text.push('[');
            for (i, item) in items.iter().enumerate() {
                text.push_str(if i > 0 { "," } else { "" });
                write(item, text);
            }
            text.push(']');
        }
        Value::Object(members) => {
            let mut members: Vec<_> = members.iter().collect();
            members.sort_unstable_by_key(|(name, _)| *name);
            text.push('{');
            for (i, (name, member)) in members.into_iter().enumerate() {
                text.push_str(if i > 0 { "," } else { "" });
                text.push_str(&Value::from(name.as_str()).to_string());
                text.push(':');
                write(member, text);
            }
            text.push('}');
        }
        other => text.push_str(&other.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde_json::json;

    #[test]
    fn one_text_for_equal_values() {
        assert_eq!(canonical_json(&json!({"b": {"d": -0.0, "c": 1e3}, "a": "x"})), r#"{"a":"x","b":{"c":1000,"d":0}}"#);
        assert_eq!(canonical_json(&json!({"b": 62.0, "a": [1, 0.5]})), r#"{"a":[1,0.5],"b":62}"#);
        assert_eq!(canonical_json(&json!([0.1, 1e300, true, null])), "[0.1,1e+300,true,null]");
        assert_eq!(canonical_json(&json!(u64::MAX)), u64::MAX.to_string());
        assert_ne!(canonical_json(&json!({"a": 1})), canonical_json(&json!({"a": "1"})));
    }

    proptest! {
        #[test]
        fn the_text_keeps_the_value(
            n in -9_000_000_000_000_000i64..9_000_000_000_000_000,
            s in ".*",
            f in -1e300..1e300f64,
        ) {
            let value = json!({"n": n, s: [f, true]});
            let back: Value = serde_json::from_str(&canonical_json(&value)).unwrap();
            prop_assert_eq!(canonical_json(&back), canonical_json(&value));
            prop_assert_eq!(&back["n"], &value["n"]);
        }
    }
}
