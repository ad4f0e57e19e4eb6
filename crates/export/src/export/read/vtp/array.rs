//! Arrays of a VTP file: decodes numbers one after another, and strings.

use super::super::error::ReadError;
use super::super::limits;
use super::super::scalar::Scalar;
use super::super::text::{not_a_number, number, quoted};
use super::encoding::{Base64, Zlib};
use std::borrow::Cow;
use std::cell::Cell;
use std::io::Read;
use std::str::SplitAsciiWhitespace;

/// An array as the document describes it.
pub(super) struct Array<'a> {
    /// Path for messages, such as `piece 0, Polys, offsets`.
    pub(super) path: String,
    pub(super) name: String,
    pub(super) kind: Kind,
    /// Number of components as the document states it; empty if it does not.
    pub(super) components: String,
    pub(super) data: ArrayData<'a>,
}

/// Location of the values of an array.
pub(super) enum ArrayData<'a> {
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
    Number(Scalar),
    String,
    Unknown,
}

impl Kind {
    pub(super) fn named(name: &str) -> Self {
        Self::Number(match name {
            "Int8" => Scalar::Signed(1),
            "UInt8" => Scalar::Unsigned(1),
            "Int16" => Scalar::Signed(2),
            "UInt16" => Scalar::Unsigned(2),
            "Int32" => Scalar::Signed(4),
            "UInt32" => Scalar::Unsigned(4),
            "Int64" => Scalar::Signed(8),
            "UInt64" => Scalar::Unsigned(8),
            "Float32" => Scalar::Float(4),
            "Float64" => Scalar::Float(8),
            "String" => return Self::String,
            _ => return Self::Unknown,
        })
    }
}

impl Array<'_> {
    pub(super) fn wrong(&self, detail: impl Into<String>) -> ReadError {
        ReadError::document(self.path.clone(), detail)
    }

    fn check_components(&self, expected: &[&str]) -> Result<(), ReadError> {
        if expected.contains(&self.components.as_str()) {
            return Ok(());
        }
        Err(self.wrong(format!("it has {} components instead of {}", quoted(&self.components), expected[0])))
    }
}

/// Encoding that all arrays share, and the appended data.
pub(super) struct File<'a> {
    pub(super) little_endian: bool,
    /// Type of the lengths before the data of an array.
    pub(super) header: Scalar,
    pub(super) zlib: bool,
    pub(super) appended: Option<Appended<'a>>,
    /// Bytes that may still be decoded. A small file can decode to much more: compressed data grow,
    /// and several arrays may name the same data.
    pub(super) room: Cell<u64>,
}

impl<'a> File<'a> {
    /// Coordinates of points.
    pub(super) fn floats<'f>(&'f self, array: &'f Array<'a>) -> Result<Values<'f, 'a>, ReadError> {
        array.check_components(&["3"])?;
        match array.kind {
            Kind::Number(scalar) => self.values(array, scalar),
            _ => Err(array.wrong("the coordinates are not numbers")),
        }
    }

    pub(super) fn integers<'f>(&'f self, array: &'f Array<'a>) -> Result<Values<'f, 'a>, ReadError> {
        array.check_components(&["1", ""])?;
        match array.kind {
            Kind::Number(scalar @ (Scalar::Signed(_) | Scalar::Unsigned(_))) => self.values(array, scalar),
            _ => Err(array.wrong("the values are not integers")),
        }
    }

    /// Numbers of cells, one per cell. `fractions` permits whole numbers that are stored as floats.
    /// `None` if the array has no such numbers, because it is one of another program.
    pub(super) fn cell_numbers<'f>(
        &'f self,
        array: &'f Array<'a>,
        cells: u64,
        fractions: bool,
    ) -> Option<Values<'f, 'a>> {
        let Kind::Number(scalar) = array.kind else { return None };
        array.check_components(&["1", ""]).ok()?;
        let is_float = matches!(scalar, Scalar::Float(_));
        let mut values = self.values(array, scalar).ok().filter(|_| fractions || !is_float)?;
        for _ in 0..cells {
            let is_whole = if is_float { values.float().ok()?.fract() == 0.0 } else { values.integer().is_ok() };
            is_whole.then_some(())?;
        }
        self.values(array, scalar).ok()
    }

    /// Strings of an array, each of which ends with a zero.
    pub(super) fn strings(&self, array: &Array<'a>) -> Result<Vec<String>, ReadError> {
        if array.kind != Kind::String {
            return Err(array.wrong("the values are not strings"));
        }
        let mut bytes = Vec::new();
        match self.values(array, Scalar::Unsigned(1))?.source {
            Source::Words(words) => {
                for word in words {
                    // VTK writes bytes as numbers, signed or unsigned.
                    let number: i16 = word.parse().map_err(|_| array.wrong(format!("{} is no byte", quoted(word))))?;
                    let byte = u8::try_from(number).or_else(|_| i8::try_from(number).map(|byte| byte as u8));
                    bytes.push(byte.map_err(|_| array.wrong(format!("{number} is no byte")))?);
                }
            }
            Source::Bytes(source) => {
                let read = source.take(limits::TEXT + 1).read_to_end(&mut bytes);
                read.map_err(|error| array.wrong(error.to_string()))?;
                self.spend(array, bytes.len())?;
            }
        }
        limits::limited(&array.path, bytes.len() as u64, "bytes of text", limits::TEXT)?;
        let text = String::from_utf8_lossy(bytes.strip_suffix(b"\0").unwrap_or(&bytes));
        Ok(if bytes.is_empty() { Vec::new() } else { text.split('\0').map(str::to_owned).collect() })
    }

    fn values<'f>(&'f self, array: &'f Array<'a>, scalar: Scalar) -> Result<Values<'f, 'a>, ReadError> {
        let source = match (&array.data, &self.appended) {
            (ArrayData::Inline { text, binary: false }, _) => Source::Words(text.split_ascii_whitespace()),
            (ArrayData::Inline { text, .. }, _) => self.decoder(array, Box::new(Base64::new(text.as_bytes())))?,
            (ArrayData::Appended(_), None) => return Err(array.wrong("the file has no appended data")),
            (ArrayData::Appended(offset), Some(appended)) => {
                let from = usize::try_from(*offset).ok().and_then(|offset| appended.data.get(offset..));
                let from = from.ok_or_else(|| array.wrong("its offset is beyond the appended data"))?;
                self.decoder(array, if appended.base64 { Box::new(Base64::new(from)) } else { Box::new(from) })?
            }
        };
        Ok(Values { file: self, array, scalar, source, chunk: Vec::new(), at: 0, read: 0 })
    }

    /// Bytes of an array, without the lengths before them.
    fn decoder<'f>(&self, array: &Array<'a>, mut encoded: Box<dyn Read + 'f>) -> Result<Source<'f>, ReadError> {
        let size = self.header.size();
        let mut length = || -> Result<u64, ReadError> {
            let mut bytes = [0; 8];
            let read = encoded.read_exact(&mut bytes[..size]);
            read.map_err(|error| array.wrong(format!("its header: {error}")))?;
            Ok(self.header.bits(&bytes, self.little_endian).unwrap_or_default())
        };
        if !self.zlib {
            let length = length()?;
            return Ok(Source::Bytes(Box::new(encoded.take(length))));
        }
        let (blocks, _, _) = (length()?, length()?, length()?);
        let mut sizes = Vec::new();
        for _ in 0..blocks {
            self.spend(array, size)?;
            sizes.push(length()?);
        }
        Ok(Source::Bytes(Box::new(Zlib::new(encoded, sizes))))
    }

    /// Counts bytes against the limit on what may be decoded.
    fn spend(&self, array: &Array<'_>, bytes: usize) -> Result<(), ReadError> {
        let Some(room) = self.room.get().checked_sub(bytes as u64) else {
            let what = "the arrays of the file, decoded, have more bytes".to_owned();
            return Err(ReadError::TooLarge { path: array.path.clone(), what, most: limits::BYTES });
        };
        self.room.set(room);
        Ok(())
    }
}

enum Source<'f> {
    Words(SplitAsciiWhitespace<'f>),
    Bytes(Box<dyn Read + 'f>),
}

/// Numbers of an array, read one after another.
pub(super) struct Values<'f, 'a> {
    file: &'f File<'a>,
    array: &'f Array<'a>,
    scalar: Scalar,
    source: Source<'f>,
    /// Decoded bytes, consumed up to `at`.
    chunk: Vec<u8>,
    at: usize,
    /// Number of values read so far.
    read: u64,
}

/// Bytes that are decoded at a time.
const CHUNK: usize = 1 << 14;

impl Values<'_, '_> {
    /// Next value of an array of [`File::floats`].
    pub(super) fn float(&mut self) -> Result<f64, ReadError> {
        match (&self.source, self.scalar) {
            (Source::Words(_), Scalar::Float(4)) => self.word(number::<f32>),
            (Source::Words(_), _) => self.word(number::<f64>),
            (Source::Bytes(_), scalar) => self.bits().map(|bits| scalar.float(bits)),
        }
    }

    /// Next value of an array of [`File::integers`] or [`File::cell_numbers`].
    pub(super) fn integer(&mut self) -> Result<i64, ReadError> {
        if let Scalar::Float(_) = self.scalar {
            return self.float().map(|value| value as i64);
        }
        if let Source::Words(_) = self.source {
            return self.word(|word| word.parse().ok());
        }
        let integer = self.scalar.integer(self.bits()?);
        integer.map_err(|value| self.array.wrong(format!("{value} is too large")))
    }

    /// Next value of an array of words.
    fn word<T>(&mut self, parse: impl Fn(&str) -> Option<T>) -> Result<T, ReadError> {
        let word = match &mut self.source {
            Source::Words(words) => words.next(),
            Source::Bytes(_) => None,
        };
        let word = word.ok_or_else(|| self.ended())?;
        self.read += 1;
        parse(word).ok_or_else(|| self.array.wrong(format!("value {}: {}", self.read, not_a_number(word))))
    }

    /// Bits of the next value of an array of bytes.
    #[inline]
    fn bits(&mut self) -> Result<u64, ReadError> {
        if self.at == self.chunk.len() {
            self.fill()?;
        }
        let bits = self.scalar.bits(&self.chunk[self.at..], self.file.little_endian).ok_or_else(|| self.ended())?;
        self.at += self.scalar.size();
        self.read += 1;
        Ok(bits)
    }

    fn fill(&mut self) -> Result<(), ReadError> {
        self.chunk.clear();
        self.at = 0;
        if let Source::Bytes(source) = &mut self.source {
            let read = source.take(CHUNK as u64).read_to_end(&mut self.chunk);
            read.map_err(|error| self.array.wrong(format!("after {} values: {error}", self.read)))?;
        }
        // An incomplete value at the end of the data does not count.
        self.chunk.truncate(self.chunk.len() - self.chunk.len() % self.scalar.size());
        self.file.spend(self.array, self.chunk.len())
    }

    fn ended(&self) -> ReadError {
        self.array.wrong(format!("it has only {} values", self.read))
    }
}
