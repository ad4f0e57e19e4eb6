//! Encodings of the arrays of a VTP file: raw, base64, zlib in blocks.

use base64::Engine;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use flate2::bufread::ZlibDecoder;
use std::io::{self, Cursor, Read};

/// An array as it is in the file.
pub(super) enum Encoded<'a> {
    Raw(&'a [u8]),
    Base64(Base64<'a>),
}

impl Read for Encoded<'_> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Raw(bytes) => bytes.read(out),
            Self::Base64(base64) => base64.read(out),
        }
    }
}

/// Text in base64. VTK encodes some parts of an array by themselves, so that padding may occur within.
pub(super) struct Base64<'a> {
    text: &'a [u8],
    decoded: Box<[u8; DECODED]>,
    /// What of `decoded` is still to be read.
    begin: usize,
    end: usize,
}

/// Characters that are decoded at once; each four are three bytes.
const ENCODED: usize = 4096;
const DECODED: usize = ENCODED / 4 * 3;
const ENGINE: GeneralPurpose = GeneralPurpose::new(
    &base64::alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_allow_trailing_bits(true)
        .with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

impl<'a> Base64<'a> {
    pub(super) fn new(text: &'a [u8]) -> Self {
        Self { text, decoded: Box::new([0; DECODED]), begin: 0, end: 0 }
    }

    fn fill(&mut self) -> io::Result<()> {
        let (mut run, mut length) = ([0; ENCODED], 0);
        while let Some((&character, rest)) = self.text.split_first() {
            self.text = rest;
            if character.is_ascii_whitespace() {
                continue;
            }
            run[length] = character;
            length += 1;
            if length == ENCODED || length % 4 == 0 && character == b'=' {
                break;
            }
        }
        let decoded = ENGINE.decode_slice(&run[..length], &mut self.decoded[..]);
        self.end = decoded.map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "this is not base64"))?;
        self.begin = 0;
        Ok(())
    }
}

impl Read for Base64<'_> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        while self.begin == self.end && !self.text.is_empty() {
            self.fill()?;
        }
        let read = (&self.decoded[self.begin..self.end]).read(out)?;
        self.begin += read;
        Ok(read)
    }
}

/// Blocks of zlib, one after another.
pub(super) struct Zlib<'a> {
    encoded: Encoded<'a>,
    /// Bytes of the blocks that come next.
    sizes: std::vec::IntoIter<u64>,
    block: Option<ZlibDecoder<Cursor<Vec<u8>>>>,
}

impl<'a> Zlib<'a> {
    pub(super) fn new(encoded: Encoded<'a>, sizes: Vec<u64>) -> Self {
        Self { encoded, sizes: sizes.into_iter(), block: None }
    }
}

impl Read for Zlib<'_> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        loop {
            if let Some(block) = &mut self.block {
                let read = block.read(out)?;
                if read > 0 || out.is_empty() {
                    return Ok(read);
                }
            }
            let Some(size) = self.sizes.next() else { return Ok(0) };
            let mut bytes = Vec::new();
            (&mut self.encoded).take(size).read_to_end(&mut bytes)?;
            match &mut self.block {
                Some(block) => drop(block.reset(Cursor::new(bytes))),
                None => self.block = Some(ZlibDecoder::new(Cursor::new(bytes))),
            }
        }
    }
}
