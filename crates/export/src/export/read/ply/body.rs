//! Data of a PLY file, read one number after another.

use super::super::error::ReadError;
use super::super::scalar::Scalar;
use super::super::text::{first_line, line_ends, not_a_number, number, wrong};
use super::header::{Encoding, Property};

/// Data after the header, read up to `at`.
pub(super) struct Body<'a> {
    /// The whole file.
    bytes: &'a [u8],
    at: usize,
    encoding: Encoding,
}

impl<'a> Body<'a> {
    /// Data that begin at byte `at` of the file.
    pub(super) fn new(bytes: &'a [u8], at: usize, encoding: Encoding) -> Self {
        Self { bytes, at, encoding }
    }

    pub(super) fn wrong(&self, detail: impl Into<String>) -> ReadError {
        let detail = detail.into();
        match self.encoding {
            Encoding::Text => wrong(1 + line_ends(&self.bytes[..self.at.min(self.bytes.len())]), detail),
            _ => ReadError::Byte { byte: self.at, detail },
        }
    }

    /// Number of bytes that were not read, without white space.
    pub(super) fn rest(&self) -> usize {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        match self.encoding {
            Encoding::Text => rest.trim_ascii().len(),
            _ => rest.len(),
        }
    }

    fn value(&mut self, scalar: Scalar) -> Result<f64, ReadError> {
        if self.encoding == Encoding::Text {
            return self.word();
        }
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let Some(bits) = scalar.bits(rest, self.encoding == Encoding::Little) else {
            return Err(self.wrong("the file ends before its elements do"));
        };
        self.at += scalar.size();
        Ok(scalar.float(bits))
    }

    fn word(&mut self) -> Result<f64, ReadError> {
        loop {
            let rest = self.bytes.get(self.at..).unwrap_or_default();
            let Some(skip) = rest.iter().position(|b| !b.is_ascii_whitespace()) else {
                self.at = self.bytes.len();
                return Err(self.wrong("the file ends before its elements do"));
            };
            let rest = &rest[skip..];
            let word = &rest[..rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len())];
            self.at += skip;
            let value = std::str::from_utf8(word).ok().and_then(number::<f64>);
            if let Some(value) = value {
                self.at += word.len();
                return Ok(value);
            }
            if word != b"comment" {
                return Err(self.wrong(not_a_number(&String::from_utf8_lossy(word))));
            }
            self.at += first_line(rest).0.len();
        }
    }

    /// Reads a property and passes its value or the items of its list to `visit`.
    pub(super) fn values(&mut self, property: &Property, mut visit: impl FnMut(f64)) -> Result<(), ReadError> {
        let count = property.count.map_or(Ok(1.0), |count| self.value(count))?;
        if !(count >= 0.0 && count.fract() == 0.0 && count <= f64::from(u32::MAX)) {
            return Err(self.wrong(format!("{count} is not the length of a list")));
        }
        for _ in 0..count as u32 {
            visit(self.value(property.item)?);
        }
        Ok(())
    }
}
