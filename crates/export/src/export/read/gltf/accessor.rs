//! Numbers of accessors, with their sparse items.

use super::document::Document;
use super::json::Object;
use super::views::{Items, Views};
use crate::export::read::error::ReadError;
use crate::export::read::limits;
use std::cell::{Cell, OnceCell};

/// Type of the numbers of an accessor.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn of(object: &Object<'_>) -> Result<Self, ReadError> {
        Ok(match object.required("componentType")? {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            other => return Err(object.wrong("componentType", format!("{other} is not a type of numbers of glTF"))),
        })
    }

    fn name(self) -> &'static str {
        match self {
            Self::I8 => "BYTE",
            Self::U8 => "UNSIGNED_BYTE",
            Self::I16 => "SHORT",
            Self::U16 => "UNSIGNED_SHORT",
            Self::U32 => "UNSIGNED_INT",
            Self::F32 => "FLOAT",
        }
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }
}

/// Types of items with the number of their components.
const TYPES: [(&str, usize); 7] =
    [("SCALAR", 1), ("VEC2", 2), ("VEC3", 3), ("VEC4", 4), ("MAT2", 4), ("MAT3", 9), ("MAT4", 16)];

/// An accessor all of whose data exist.
pub(super) struct Accessor<'a> {
    path: String,
    /// Number of items.
    pub(super) count: usize,
    pub(super) component: Component,
    kind: &'static str,
    pub(super) normalized: bool,
    /// Bytes of an item.
    size: usize,
    /// None if all items are zeros, apart from sparse ones.
    items: Option<Items<'a>>,
    sparse: Option<Sparse<'a>>,
    /// True if the accessor states `min` and `max`.
    pub(super) has_bounds: bool,
}

/// Items that replace others.
struct Sparse<'a> {
    component: Component,
    indices: Items<'a>,
    values: Items<'a>,
}

impl<'a> Accessor<'a> {
    fn new(document: &Document<'_>, views: &'a Views<'_>, index: usize) -> Result<Self, ReadError> {
        let object = document.accessors.get(index)?;
        document.check(&object, &[])?;
        let (count, component) = (object.required("count")?, Component::of(&object)?);
        let stated = object.text("type").unwrap_or_default();
        let unknown = || object.wrong("type", "it is not a type of items of glTF");
        let (kind, width) = TYPES.into_iter().find(|(kind, _)| *kind == stated).ok_or_else(unknown)?;
        let size = width * component.size();
        Ok(Self {
            count,
            component,
            kind,
            normalized: object.flag("normalized")?,
            size,
            items: views.items(&object, count, size)?,
            sparse: object.object("sparse")?.map(|sparse| Sparse::new(&sparse, views, count, size)).transpose()?,
            has_bounds: object.has("min") && object.has("max"),
            path: object.path,
        })
    }

    /// Path in the document.
    pub(super) fn path(&self) -> &str {
        &self.path
    }

    /// True if the accessor has a view or sparse items; all its items are zeros otherwise.
    pub(super) fn has_data(&self) -> bool {
        self.items.is_some() || self.sparse.is_some()
    }

    /// Error about the accessor.
    pub(super) fn fault(&self, detail: impl Into<String>) -> ReadError {
        ReadError::document(self.path.as_str(), detail)
    }

    /// Checks the type of the items, which are `what`.
    pub(super) fn expect(&self, what: &str, kind: &str, components: &[Component]) -> Result<(), ReadError> {
        if self.kind != kind {
            return Err(self.fault(format!("its type is {}, and {what} are {kind}", self.kind)));
        }
        if !components.contains(&self.component) {
            let allowed: Vec<_> = components.iter().map(|component| component.name()).collect();
            let (own, allowed) = (self.component.name(), allowed.join(" or "));
            return Err(self.fault(format!("its numbers are {own}, and {what} are {allowed}")));
        }
        Ok(())
    }

    /// Appends all items, of `N` numbers each, which the type of the accessor has.
    pub(super) fn read<const N: usize>(&self, out: &mut Vec<[f64; N]>) -> Result<(), ReadError> {
        match (self.component, self.normalized) {
            (Component::F32, _) => self.each(out, vector(|b| f64::from(f32::from_le_bytes(b)))),
            (Component::U32, _) => self.each(out, vector(|b| f64::from(u32::from_le_bytes(b)))),
            (Component::I8, false) => self.each(out, vector(|b| f64::from(i8::from_le_bytes(b)))),
            (Component::U8, false) => self.each(out, vector(|b| f64::from(u8::from_le_bytes(b)))),
            (Component::I16, false) => self.each(out, vector(|b| f64::from(i16::from_le_bytes(b)))),
            (Component::U16, false) => self.each(out, vector(|b| f64::from(u16::from_le_bytes(b)))),
            (Component::I8, true) => self.each(out, vector(|b| (f64::from(i8::from_le_bytes(b)) / 127.0).max(-1.0))),
            (Component::U8, true) => self.each(out, vector(|b| f64::from(u8::from_le_bytes(b)) / 255.0)),
            (Component::I16, true) => {
                self.each(out, vector(|b| (f64::from(i16::from_le_bytes(b)) / 32_767.0).max(-1.0)))
            }
            (Component::U16, true) => self.each(out, vector(|b| f64::from(u16::from_le_bytes(b)) / 65_535.0)),
        }
    }

    /// All items of an accessor of scalars as indices.
    pub(super) fn indices(&self) -> Result<Vec<u32>, ReadError> {
        let mut list = Vec::new();
        match self.component {
            Component::U8 => self.each(&mut list, |item| u32::from(item[0]))?,
            Component::U16 => self.each(&mut list, |item| u32::from(u16::from_le_bytes([item[0], item[1]])))?,
            _ => self.each(&mut list, |item| item.first_chunk().map_or(0, |word| u32::from_le_bytes(*word)))?,
        }
        Ok(list)
    }

    /// Appends all items, each read from its bytes.
    fn each<T: Clone>(&self, out: &mut Vec<T>, read: impl Fn(&[u8]) -> T) -> Result<(), ReadError> {
        let (first, size) = (out.len(), self.size);
        match &self.items {
            Some(items) => out.extend(items.data.chunks(items.stride).take(self.count).map(|item| read(&item[..size]))),
            None => out.resize(first + self.count, read(&[0; 64][..size])),
        }
        let Some(Sparse { component, indices, values }) = &self.sparse else { return Ok(()) };
        let values = values.data.chunks(values.stride);
        for (index, value) in indices.data.chunks(indices.stride).zip(values) {
            let at = (0..component.size()).rev().fold(0, |at, byte| at << 8 | usize::from(index[byte]));
            let place = out[first..].get_mut(at);
            *place.ok_or_else(|| self.fault(format!("its sparse item {at} does not exist")))? = read(&value[..size]);
        }
        Ok(())
    }
}

impl<'a> Sparse<'a> {
    fn new(object: &Object<'_>, views: &'a Views<'_>, most: usize, size: usize) -> Result<Self, ReadError> {
        let missing = |name: &str| object.wrong(name, "it is missing");
        let count = object.required("count")?;
        if count > most {
            return Err(object.wrong("count", format!("{count} is more than the {most} items of the accessor")));
        }
        let indices = object.object("indices")?.ok_or_else(|| missing("indices"))?;
        let values = object.object("values")?.ok_or_else(|| missing("values"))?;
        let component = Component::of(&indices)?;
        if !matches!(component, Component::U8 | Component::U16 | Component::U32) {
            return Err(indices.wrong("componentType", "indices are not unsigned integers"));
        }
        let view =
            |items: Option<Items<'a>>, of: &Object<'_>| items.ok_or_else(|| of.wrong("bufferView", "it is missing"));
        Ok(Self {
            component,
            indices: view(views.items(&indices, count, component.size())?, &indices)?,
            values: view(views.items(&values, count, size)?, &values)?,
        })
    }
}

/// Reads `N` numbers of `S` bytes.
fn vector<const N: usize, const S: usize>(number: impl Fn([u8; S]) -> f64) -> impl Fn(&[u8]) -> [f64; N] {
    move |item| {
        let (numbers, _) = item.as_chunks::<S>();
        std::array::from_fn(|k| number(numbers[k]))
    }
}

/// Accessors of a document, each read once.
pub(super) struct Accessors<'a> {
    document: &'a Document<'a>,
    views: &'a Views<'a>,
    known: Vec<OnceCell<Box<Accessor<'a>>>>,
    /// Items of zeros that have no data.
    zeros: Cell<u64>,
}

impl<'a> Accessors<'a> {
    pub(super) fn new(document: &'a Document<'a>, views: &'a Views<'a>) -> Self {
        let known = (0..document.accessors.len()).map(|_| OnceCell::new()).collect();
        Self { document, views, known, zeros: Cell::new(0) }
    }

    /// An accessor that exists.
    pub(super) fn get(&self, index: usize) -> Result<&Accessor<'a>, ReadError> {
        let cell = &self.known[index];
        if let Some(known) = cell.get() {
            return Ok(known);
        }
        let accessor = Box::new(Accessor::new(self.document, self.views, index)?);
        Ok(cell.get_or_init(|| accessor))
    }

    /// The accessor that a member names; `None` if there is no such member.
    pub(super) fn named(&self, object: &Object<'_>, name: &str) -> Result<Option<&Accessor<'a>>, ReadError> {
        object.refer(name, &self.document.accessors)?.map(|index| self.get(index)).transpose()
    }

    /// As [`Self::named`], for an accessor whose items need memory even if they have no data.
    pub(super) fn owned(&self, object: &Object<'_>, name: &str) -> Result<Option<&Accessor<'a>>, ReadError> {
        let found = self.named(object, name)?;
        if let Some(accessor) = found.filter(|accessor| accessor.items.is_none()) {
            self.zeros.set(self.zeros.get().saturating_add(accessor.count as u64));
            limits::limited(&accessor.path, self.zeros.get(), "items without data", limits::ZEROS)?;
        }
        Ok(found)
    }
}
