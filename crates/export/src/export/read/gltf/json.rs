//! Objects and arrays of a document whose members are parsed when they are used.
//!
//! A member that nothing uses may therefore hold anything. Errors name the path of the member, such
//! as `accessors[3].count`. A member that is `null` counts as absent, an integer may be written as
//! `3.0`, and of members with the same name the last counts.

use crate::export::read::error::ReadError;
use serde::de::{Deserialize, Deserializer, Error, MapAccess, Visitor};
use serde_json::value::RawValue;
use std::fmt;

/// Maximum number of members of an object. Objects with many parts have them in arrays.
const MEMBERS: usize = 10_000;

/// A JSON object with its path in the document.
pub(super) struct Object<'a> {
    pub(super) path: String,
    members: Members<'a>,
}

/// Members of an object by name: the last of each name, and none that is `null`.
#[derive(Default)]
pub(super) struct Members<'a>(Vec<(String, &'a RawValue)>);

impl<'a> Object<'a> {
    pub(super) fn new(path: impl Into<String>, members: Members<'a>) -> Self {
        Self { path: path.into(), members }
    }

    fn parse(path: String, json: &'a RawValue) -> Result<Self, ReadError> {
        match serde_json::from_str(json.get()) {
            Ok(members) => Ok(Self { path, members }),
            Err(error) if json.get().starts_with('{') => Err(ReadError::document(path, error.to_string())),
            Err(_) => Err(ReadError::document(path, format!("{} is not an object", shown(json.get())))),
        }
    }

    /// Error about the object.
    pub(super) fn fault(&self, detail: impl Into<String>) -> ReadError {
        ReadError::document(self.path.as_str(), detail)
    }

    /// Error about a member.
    pub(super) fn wrong(&self, name: &str, detail: impl Into<String>) -> ReadError {
        ReadError::document(self.path_of(name), detail)
    }

    /// Path of a member.
    pub(super) fn path_of(&self, name: &str) -> String {
        let name = shown(name);
        if self.path.is_empty() { name } else { format!("{}.{name}", self.path) }
    }

    fn get(&self, name: &str) -> Option<&'a RawValue> {
        let members = &self.members.0;
        let at = members.binary_search_by(|(own, _)| own.as_str().cmp(name)).ok()?;
        members.get(at).map(|(_, json)| *json)
    }

    /// True if the object has the member.
    pub(super) fn has(&self, name: &str) -> bool {
        self.get(name).is_some()
    }

    /// Names of all members, sorted.
    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.members.0.iter().map(|(name, _)| name.as_str())
    }

    /// A text; `None` also for any other value.
    pub(super) fn text(&self, name: &str) -> Option<String> {
        serde_json::from_str(self.get(name)?.get()).ok()
    }

    /// A list of texts; other values are left out.
    pub(super) fn texts(&self, name: &str) -> Vec<String> {
        let items = self.items(name).ok().flatten().unwrap_or_default();
        items.iter().filter_map(|json| serde_json::from_str(json.get()).ok()).collect()
    }

    /// A truth value, false if it is absent.
    pub(super) fn flag(&self, name: &str) -> Result<bool, ReadError> {
        match self.get(name).map(RawValue::get) {
            None | Some("false") => Ok(false),
            Some("true") => Ok(true),
            Some(other) => Err(self.wrong(name, format!("{} is neither true nor false", shown(other)))),
        }
    }

    /// A whole number from 0.
    pub(super) fn integer(&self, name: &str) -> Result<Option<usize>, ReadError> {
        self.get(name).map(|json| whole(json).map_err(|detail| self.wrong(name, detail))).transpose()
    }

    /// As [`Self::integer`]; the number must be there.
    pub(super) fn required(&self, name: &str) -> Result<usize, ReadError> {
        self.integer(name)?.ok_or_else(|| self.wrong(name, "it is missing"))
    }

    /// A list of any number of finite numbers.
    pub(super) fn numbers(&self, name: &str) -> Result<Option<Vec<f64>>, ReadError> {
        let Some(items) = self.items(name)? else { return Ok(None) };
        let number = |(i, json): (usize, &&RawValue)| {
            let number = json.get().parse().ok().filter(|number: &f64| number.is_finite());
            let detail = || format!("{} is not a finite number", shown(json.get()));
            number.ok_or_else(|| self.wrong(&format!("{name}[{i}]"), detail()))
        };
        items.iter().enumerate().map(number).collect::<Result<_, _>>().map(Some)
    }

    /// A list of exactly `N` finite numbers.
    pub(super) fn vector<const N: usize>(&self, name: &str) -> Result<Option<[f64; N]>, ReadError> {
        let wrong = |numbers: Vec<f64>| self.wrong(name, format!("it has {} numbers instead of {N}", numbers.len()));
        self.numbers(name)?.map(|numbers| numbers.try_into().map_err(wrong)).transpose()
    }

    /// An object.
    pub(super) fn object(&self, name: &str) -> Result<Option<Self>, ReadError> {
        self.get(name).map(|json| Self::parse(self.path_of(name), json)).transpose()
    }

    /// A list of objects.
    pub(super) fn array(&self, name: &str) -> Result<Array<'a>, ReadError> {
        Ok(Array { path: self.path_of(name), items: self.items(name)?.unwrap_or_default(), wrong: None })
    }

    /// A list of objects, of which an error is reported when one of them is used.
    pub(super) fn lazy_array(&self, name: &str) -> Array<'a> {
        let wrong =
            |error: ReadError| Array { path: self.path_of(name), items: vec![], wrong: Some(error.to_string()) };
        self.array(name).unwrap_or_else(wrong)
    }

    /// Number of an item of a list.
    pub(super) fn refer(&self, name: &str, to: &Array<'_>) -> Result<Option<usize>, ReadError> {
        let exists = |index: usize| to.check(index).map_err(|detail| self.wrong(name, detail));
        self.integer(name)?.map(exists).transpose()
    }

    /// Numbers of items of a list.
    pub(super) fn refer_all(&self, name: &str, to: &Array<'_>) -> Result<Vec<usize>, ReadError> {
        let exists = |(i, json): (usize, &RawValue)| {
            let index = whole(json).and_then(|index| to.check(index));
            index.map_err(|detail| self.wrong(&format!("{name}[{i}]"), detail))
        };
        self.items(name)?.unwrap_or_default().into_iter().enumerate().map(exists).collect()
    }

    /// Object of an extension.
    pub(super) fn extension(&self, name: &str) -> Result<Option<Self>, ReadError> {
        self.extensions().map_or(Ok(None), |extensions| extensions.object(name))
    }

    /// Objects of all extensions. Some programs write an empty list instead.
    pub(super) fn extensions(&self) -> Option<Self> {
        self.object("extensions").ok().flatten()
    }

    fn items(&self, name: &str) -> Result<Option<Vec<&'a RawValue>>, ReadError> {
        let Some(json) = self.get(name) else { return Ok(None) };
        let items = serde_json::from_str(json.get());
        items.map(Some).map_err(|_| self.wrong(name, format!("{} is not a list", shown(json.get()))))
    }
}

/// A list of objects with its path in the document.
pub(super) struct Array<'a> {
    path: String,
    items: Vec<&'a RawValue>,
    /// Error of a member that is not a list.
    wrong: Option<String>,
}

impl<'a> Array<'a> {
    pub(super) fn len(&self) -> usize {
        self.items.len()
    }

    /// An object of the list.
    pub(super) fn get(&self, index: usize) -> Result<Object<'a>, ReadError> {
        let path = || format!("{}[{index}]", self.path);
        match self.items.get(index) {
            Some(json) => Object::parse(path(), json),
            None => Err(ReadError::document(path(), "it does not exist")),
        }
    }

    /// Returns the index if there is such an item, else a description of the fault.
    fn check(&self, index: usize) -> Result<usize, String> {
        match &self.wrong {
            Some(wrong) => Err(wrong.clone()),
            None if index < self.len() => Ok(index),
            None => Err(format!("{}[{index}] does not exist, the document has {}", self.path, self.len())),
        }
    }
}

fn whole(json: &RawValue) -> Result<usize, String> {
    let text = json.get();
    let float = || text.parse().ok().filter(|x: &f64| x.fract() == 0.0 && (0.0..=9e15).contains(x)).map(|x| x as usize);
    text.parse().ok().or_else(float).ok_or_else(|| format!("{} is not a whole number from 0", shown(text)))
}

/// Text of the document for a message, cut to 40 characters.
pub(super) fn shown(text: &str) -> String {
    match text.char_indices().nth(40) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

impl<'de> Deserialize<'de> for Members<'de> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Collect;
        impl<'de> Visitor<'de> for Collect {
            type Value = Members<'de>;

            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("an object")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut members: Vec<(String, &'de RawValue)> = Vec::new();
                while let Some(member) = map.next_entry()? {
                    if members.len() == MEMBERS {
                        return Err(A::Error::custom(format!("it has more than {MEMBERS} members")));
                    }
                    members.push(member);
                }
                // The order of members with the same name is kept.
                members.sort_by(|(a, _), (b, _)| a.cmp(b));
                members.dedup_by(|later, kept| {
                    let is_same = later.0 == kept.0;
                    if is_same {
                        kept.1 = later.1;
                    }
                    is_same
                });
                members.retain(|(_, json)| json.get() != "null");
                Ok(Members(members))
            }
        }
        deserializer.deserialize_map(Collect)
    }
}
