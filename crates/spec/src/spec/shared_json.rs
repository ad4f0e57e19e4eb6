//! A JSON value that is shared, with its text.

use serde::{Serialize, Serializer};
use serde_json::Value;
use serde_json::value::{RawValue, to_raw_value};
use std::ops::Deref;
use std::str::FromStr;
use std::sync::{Arc, OnceLock};

/// A JSON value whose text is written once, and is read once, however often it is stored or sent.
/// Clones share it.
#[derive(Clone, Debug)]
pub struct SharedJson(Arc<Shared>);

/// At least one of them is set.
#[derive(Debug)]
struct Shared {
    value: OnceLock<Value>,
    text: OnceLock<Box<RawValue>>,
}

impl SharedJson {
    /// The value.
    #[must_use]
    pub fn value(&self) -> &Value {
        self.0.value.get_or_init(|| serde_json::from_str(self.text()).expect("the text was checked"))
    }

    /// The value as JSON text without line breaks.
    #[must_use]
    pub fn text(&self) -> &str {
        self.raw().get()
    }

    fn raw(&self) -> &RawValue {
        self.0.text.get_or_init(|| to_raw_value(self.value()).expect("a value is JSON"))
    }
}

impl From<Value> for SharedJson {
    fn from(value: Value) -> Self {
        Self(Arc::new(Shared { value: value.into(), text: OnceLock::new() }))
    }
}

impl FromStr for SharedJson {
    type Err = serde_json::Error;

    fn from_str(text: &str) -> Result<Self, serde_json::Error> {
        let text: Box<RawValue> = serde_json::from_str(text)?;
        Ok(Self(Arc::new(Shared { value: OnceLock::new(), text: text.into() })))
    }
}

impl Deref for SharedJson {
    type Target = Value;

    fn deref(&self) -> &Value {
        self.value()
    }
}

impl PartialEq for SharedJson {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0) || self.value() == other.value()
    }
}

impl Serialize for SharedJson {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.raw().serialize(serializer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn text_and_value_are_equal_however_they_are_written() {
        let value = json!({ "a": [1, 2.5, -0.0, "\u{e9}\n"], "b": null });
        let shared = SharedJson::from(value.clone());
        let read: SharedJson = shared.text().parse().unwrap();
        assert_eq!((read.text(), read.value(), &read), (shared.text(), &value, &shared));
        assert!("{\"a\": [1, }".parse::<SharedJson>().is_err());
        assert_eq!(serde_json::to_string(&json!({ "spec": shared })).unwrap(), format!("{{\"spec\":{value}}}"));
        assert_eq!(serde_json::to_string(&shared).unwrap(), value.to_string());
        assert_eq!(serde_json::to_value(&shared).unwrap(), value);
        assert_eq!((shared.text(), shared.value()), (value.to_string().as_str(), &value));
        assert_eq!(shared, SharedJson::from(value));
    }
}
