//! Arrays of a VTP file: numbers and strings, taken from where they are one after another.

use super::super::error::ReadError;
use super::super::limits;
use super::super::text::quoted;
use super::encoding::{Base64, Encoded, Zlib};
use std::borrow::Cow;
use std::cell::Cell;
use std::io::{self, Read};
use std::str::SplitAsciiWhitespace;

/// An array as the document describes it.
pub(super) struct Array<'a> {
    /// For messages, such as `piece 0, Polys, offsets`.
    pub(super) path: String,
    pub(super) name: String,
    pub(super) kind: Kind,
    /// Number of components as it is stated, if it is.
    pub(super) components: String,
    pub(super) place: Place<'a>,
}

/// Where the values are.
pub(super) enum Place<'a> {
    /// In the document, as numbers or (`binary`) in base64.
    Inline { text: Cow<'a, str>, binary: bool },
    /// At an offset into the appended data.
    Appended(u64),
}

pub(super) struct Appended<'a> {
    pub(super) data: &'a [u8],
    pub(super) base64: bool,
}

/// Type of the values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
    String,
    Unknown,
}

impl Kind {
    pub(super) fn of(name: &str) -> Self {
        match name {
            "Int8" => Self::I8,
            "UInt8" => Self::U8,
            "Int16" => Self::I16,
            "UInt16" => Self::U16,
            "Int32" => Self::I32,
            "UInt32" => Self::U32,
            "Int64" => Self::I64,
            "UInt64" => Self::U64,
            "Float32" => Self::F32,
            "Float64" => Self::F64,
            "String" => Self::String,
            _ => Self::Unknown,
        }
    }

    /// Bytes of a value.
    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 | Self::String | Self::Unknown => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }
}

impl<'a> Array<'a> {
    pub(super) fn wrong(&self, detail: impl Into<String>) -> ReadError {
        ReadError::document(self.path.clone(), detail)
    }

    fn components(&self, expected: &[&str]) -> Result<(), ReadError> {
        if expected.contains(&self.components.as_str()) {
            return Ok(());
        }
        Err(self.wrong(format!("it has {} components instead of {}", quoted(&self.components), expected[0])))
    }
}

/// What arrays have in common, and the data that are appended.
pub(super) struct File<'a> {
    pub(super) little: bool,
    /// Lengths have 64 bits, not 32.
    pub(super) wide: bool,
    pub(super) zlib: bool,
    pub(super) appended: Option<Appended<'a>>,
    /// Bytes that may still be decoded: many arrays may lie in the same place, and compressed data grow.
    pub(super) room: Cell<u64>,
}

impl<'a> File<'a> {
    /// The coordinates of points.
    pub(super) fn floats<'f>(&'f self, array: &'f Array<'a>) -> Result<Floats<'f, 'a>, ReadError> {
        array.components(&["3"])?;
        if !matches!(array.kind, Kind::F32 | Kind::F64) {
            return Err(array.wrong("the coordinates are neither Float32 nor Float64"));
        }
        Ok(Floats(self.values(array)?))
    }

    pub(super) fn integers<'f>(&'f self, array: &'f Array<'a>) -> Result<Integers<'f, 'a>, ReadError> {
        array.components(&["1", ""])?;
        if matches!(array.kind, Kind::F32 | Kind::F64 | Kind::String | Kind::Unknown) {
            return Err(array.wrong("the values are not integers"));
        }
        Ok(Integers(self.values(array)?))
    }

    /// The strings of an array, each of which a zero ends.
    pub(super) fn strings(&self, array: &Array<'a>) -> Result<Vec<String>, ReadError> {
        if array.kind != Kind::String {
            return Err(array.wrong("the values are not strings"));
        }
        let mut bytes = Vec::new();
        let mut values = self.values(array)?;
        match &mut values.source {
            Source::Words(words) => {
                for word in words {
                    // VTK writes the bytes as numbers, of either sign.
                    let number: i16 = word.parse().map_err(|_| array.wrong(format!("{} is no byte", quoted(word))))?;
                    let byte = u8::try_from(number).or_else(|_| i8::try_from(number).map(|byte| byte as u8));
                    bytes.push(byte.map_err(|_| array.wrong(format!("{number} is no byte")))?);
                }
            }
            Source::Bytes(source) => {
                let read = source.take(limits::TEXT + 1).read_to_end(&mut bytes);
                read.map_err(|error| array.wrong(error.to_string()))?;
                values.spend(bytes.len())?;
            }
        }
        limits::limited(&array.path, bytes.len() as u64, "bytes of text", limits::TEXT)?;
        let text = String::from_utf8_lossy(bytes.strip_suffix(b"\0").unwrap_or(&bytes));
        Ok(if bytes.is_empty() { Vec::new() } else { text.split('\0').map(str::to_owned).collect() })
    }

    fn values<'f>(&'f self, array: &'f Array<'a>) -> Result<Values<'f, 'a>, ReadError> {
        let values = |source| Ok(Values { file: self, array, source, chunk: Vec::new(), at: 0, read: 0 });
        let encoded = match (&array.place, &self.appended) {
            (Place::Inline { text, binary: false }, _) => return values(Source::Words(text.split_ascii_whitespace())),
            (Place::Inline { text, .. }, _) => Encoded::Base64(Base64::new(text.as_bytes())),
            (Place::Appended(_), None) => return Err(array.wrong("the file has no appended data")),
            (Place::Appended(offset), Some(appended)) => {
                let from = usize::try_from(*offset).ok().and_then(|offset| appended.data.get(offset..));
                let from = from.ok_or_else(|| array.wrong("its offset is beyond the appended data"))?;
                if appended.base64 { Encoded::Base64(Base64::new(from)) } else { Encoded::Raw(from) }
            }
        };
        values(Source::Bytes(self.decoder(array, encoded)?))
    }

    /// The bytes of an array, without the lengths before them.
    fn decoder<'f>(&self, array: &Array<'a>, mut encoded: Encoded<'f>) -> Result<Box<dyn Read + 'f>, ReadError> {
        let failed = |error: io::Error| array.wrong(format!("its header: {error}"));
        let mut length = || {
            let read = if self.wide { self.word::<8>(&mut encoded) } else { self.word::<4>(&mut encoded) };
            read.map_err(failed)
        };
        if !self.zlib {
            let length = length()?;
            return Ok(Box::new(encoded.take(length)));
        }
        let (blocks, _, _) = (length()?, length()?, length()?);
        let mut sizes = Vec::new();
        for _ in 0..blocks {
            self.spend(array, if self.wide { 8 } else { 4 })?;
            sizes.push(length()?);
        }
        Ok(Box::new(Zlib::new(encoded, sizes)))
    }

    /// A number of `N` bytes.
    fn word<const N: usize>(&self, source: &mut impl Read) -> io::Result<u64> {
        let mut bytes = [0; N];
        source.read_exact(&mut bytes)?;
        if self.little {
            bytes.reverse();
        }
        Ok(bytes.iter().fold(0, |value, &byte| value << 8 | u64::from(byte)))
    }

    /// Counts bytes against what may be decoded.
    fn spend(&self, array: &Array<'_>, bytes: usize) -> Result<(), ReadError> {
        let Some(room) = self.room.get().checked_sub(bytes as u64) else {
            let what = "the arrays of the file, decoded, have more bytes".to_owned();
            return Err(ReadError::TooLarge { path: array.path.clone(), what, most: limits::BYTES });
        };
        self.room.set(room);
        Ok(())
    }
}

/// Coordinates, one after another.
pub(super) struct Floats<'f, 'a>(Values<'f, 'a>);

impl Floats<'_, '_> {
    pub(super) fn next(&mut self) -> Result<f64, ReadError> {
        let single = self.0.array.kind == Kind::F32;
        if let Source::Words(_) = self.0.source {
            return if single { self.0.word::<f32>().map(f64::from) } else { self.0.word() };
        }
        if single {
            self.0.take().map(|bytes| f64::from(f32::from_le_bytes(bytes)))
        } else {
            self.0.take().map(f64::from_le_bytes)
        }
    }
}

/// Integers, one after another.
pub(super) struct Integers<'f, 'a>(Values<'f, 'a>);

impl Integers<'_, '_> {
    pub(super) fn next(&mut self) -> Result<i64, ReadError> {
        if let Source::Words(_) = self.0.source {
            return self.0.word();
        }
        Ok(match self.0.array.kind {
            Kind::I8 => i64::from(i8::from_le_bytes(self.0.take()?)),
            Kind::U8 => i64::from(u8::from_le_bytes(self.0.take()?)),
            Kind::I16 => i64::from(i16::from_le_bytes(self.0.take()?)),
            Kind::U16 => i64::from(u16::from_le_bytes(self.0.take()?)),
            Kind::I32 => i64::from(i32::from_le_bytes(self.0.take()?)),
            Kind::U32 => i64::from(u32::from_le_bytes(self.0.take()?)),
            Kind::I64 => i64::from_le_bytes(self.0.take()?),
            Kind::U64 => {
                let value = u64::from_le_bytes(self.0.take()?);
                i64::try_from(value).map_err(|_| self.0.array.wrong(format!("{value} is too large")))?
            }
            Kind::F32 | Kind::F64 | Kind::String | Kind::Unknown => {
                return Err(self.0.array.wrong("it has no integers"));
            }
        })
    }
}

enum Source<'f> {
    Words(SplitAsciiWhitespace<'f>),
    Bytes(Box<dyn Read + 'f>),
}

/// The values of an array, on their way.
struct Values<'f, 'a> {
    file: &'f File<'a>,
    array: &'f Array<'a>,
    source: Source<'f>,
    /// Bytes of values that come next, from `at` on.
    chunk: Vec<u8>,
    at: usize,
    /// Values so far.
    read: u64,
}

/// Bytes that are decoded at once.
const CHUNK: usize = 1 << 14;

impl Values<'_, '_> {
    /// The next value of an array of words.
    fn word<T: std::str::FromStr>(&mut self) -> Result<T, ReadError> {
        let word = match &mut self.source {
            Source::Words(words) => words.next(),
            Source::Bytes(_) => None,
        };
        let word = word.ok_or_else(|| self.ended())?;
        self.read += 1;
        word.parse().map_err(|_| self.array.wrong(format!("value {}: {} is not a number", self.read, quoted(word))))
    }

    /// The bytes of the next value, in little-endian order.
    #[inline]
    fn take<const N: usize>(&mut self) -> Result<[u8; N], ReadError> {
        if self.at == self.chunk.len() {
            self.fill()?;
        }
        let bytes = self.chunk.get(self.at..).and_then(|rest| rest.first_chunk::<N>()).copied();
        let mut bytes = bytes.ok_or_else(|| self.ended())?;
        self.at += N;
        self.read += 1;
        if !self.file.little {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn fill(&mut self) -> Result<(), ReadError> {
        self.chunk.clear();
        self.at = 0;
        if let Source::Bytes(source) = &mut self.source {
            let read = source.take(CHUNK as u64).read_to_end(&mut self.chunk);
            read.map_err(|error| self.array.wrong(format!("after {} values: {error}", self.read)))?;
        }
        // A value that the end of the data cuts is none.
        self.chunk.truncate(self.chunk.len() - self.chunk.len() % self.array.kind.size());
        self.spend(self.chunk.len())
    }

    fn spend(&self, bytes: usize) -> Result<(), ReadError> {
        self.file.spend(self.array, bytes)
    }

    fn ended(&self) -> ReadError {
        self.array.wrong(format!("it has only {} values", self.read))
    }
}
