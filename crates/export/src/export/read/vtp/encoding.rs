//! Encodings of the arrays of a VTP file: base64, and zlib in blocks.

use super::super::text::BASE64;
use base64::Engine;
use flate2::bufread::ZlibDecoder;
use std::io::{self, Cursor, Read};

/// Decoder of base64 text. VTK encodes some parts of an array separately, so padding may occur
/// within.
pub(super) struct Base64<'a> {
    text: &'a [u8],
    decoded: Box<[u8; DECODED]>,
    /// Range of `decoded` that is still unread.
    begin: usize,
    end: usize,
}

/// Characters that are decoded at a time; four of them are three bytes.
const ENCODED: usize = 4096;
const DECODED: usize = ENCODED / 4 * 3;

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
        let decoded = BASE64.decode_slice(&run[..length], &mut self.decoded[..]);
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

/// Decoder of consecutive blocks of zlib.
pub(super) struct Zlib<'a> {
    encoded: Box<dyn Read + 'a>,
    /// Compressed sizes of the blocks that follow, bytes.
    sizes: std::vec::IntoIter<u64>,
    block: Option<ZlibDecoder<Cursor<Vec<u8>>>>,
}

impl<'a> Zlib<'a> {
    pub(super) fn new(encoded: Box<dyn Read + 'a>, sizes: Vec<u64>) -> Self {
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
