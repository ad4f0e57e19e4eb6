//! State of an unfinished generation in a file, from which the generation continues to the same
//! files.
//!
//! Invariant: a model that was resumed, any number of times and on any number of threads, is
//! identical, byte for byte, to a model that was grown without interruption. The simulation
//! continues from its exact state. The surface is not stored. It is lofted again from its sections,
//! including those added to mend slabs: whether a section is accepted, and with which diagonals,
//! depends only on the surface so far.
//!
//! Format: magic, version (u32), state of the simulation, accepted sections, sections since the
//! last recorded one (each as `sections.bin`), header (JSON), length of the header (u32), SHA-256
//! of everything before. Only the state of the simulation is in memory at once.

use super::types::Request;
use crate::ENGINE_VERSION;
use crate::export::hashing::HashingWriter;
use crate::export::sections_bin::{SectionsError, SectionsReader, write_sections};
use crate::model::Section;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;
use tempfile::{NamedTempFile, TempPath};

const MAGIC: &[u8; 8] = b"OVCHKPT\n";
const VERSION: u32 = 2;
const HASH: u64 = 32;
/// Size of magic and version, bytes.
const START: u64 = 12;
/// Size of the length of the header and of the hash, bytes.
const END: u64 = 4 + HASH;
/// Maximum size of a header, bytes.
const MAX_HEADER: u64 = 1 << 16;

/// Reason why a checkpoint cannot be used. The generation then starts from the beginning.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The file is not a checkpoint, has another version, or is incomplete.
    #[error("the checkpoint is damaged: {0}")]
    Damaged(&'static str),
    /// The checkpoint belongs to another specification, seed or engine version.
    #[error("the checkpoint is of another model or engine")]
    Foreign,
    /// The sections cannot be read.
    #[error("the sections of the checkpoint cannot be read")]
    Sections(#[from] SectionsError),
    /// The file cannot be read.
    #[error("the checkpoint cannot be read")]
    Io(#[from] io::Error),
}

#[derive(Debug, Serialize, Deserialize)]
struct Header {
    digest: String,
    engine: String,
    flipped: u64,
    recorded: u32,
    simulation: u64,
    accepted: u64,
    history: u64,
}

/// A generation between two steps of its simulation. The sections of the surface stay in the file
/// until they are read.
pub struct Checkpoint<R = BufReader<File>> {
    /// State of the simulation, as [`CpuSimulation::save`](crate::sim::cpu::CpuSimulation::save)
    /// wrote it.
    pub(super) simulation: Vec<u8>,
    /// Sections of the surface.
    pub(super) accepted: SectionsReader<FileWindow<R>>,
    /// Sections of the steps since the last recorded one.
    pub(super) history: Vec<Section>,
    /// Number of diagonals flipped so far.
    pub(super) flipped: usize,
    /// Number of sections recorded so far.
    pub(super) recorded: u32,
}

impl Checkpoint {
    /// Opens a checkpoint of the model of `request`.
    ///
    /// # Errors
    /// [`CheckpointError`].
    pub fn open(request: &Request, path: &Path) -> Result<Self, CheckpointError> {
        Self::read(request, BufReader::with_capacity(1 << 18, File::open(path)?))
    }
}

impl<R: Read + Seek> Checkpoint<R> {
    /// Reads a checkpoint of the model of `request`.
    ///
    /// # Errors
    /// [`CheckpointError`].
    pub fn read(request: &Request, mut input: R) -> Result<Self, CheckpointError> {
        let damaged = CheckpointError::Damaged;
        let length = input.seek(SeekFrom::End(0))?;
        let body = length.checked_sub(HASH).filter(|body| *body >= START + 4).ok_or(damaged("it is truncated"))?;
        input.seek(SeekFrom::Start(0))?;
        let mut hashing = HashingWriter::new(io::sink());
        io::copy(&mut input.by_ref().take(body), &mut hashing)?;
        if array::<32>(&mut input)? != hashing.sha256() {
            return Err(damaged("its hash differs"));
        }
        input.seek(SeekFrom::Start(0))?;
        if array::<8>(&mut input)? != *MAGIC {
            return Err(damaged("it is not a checkpoint"));
        }
        if u32::from_le_bytes(array(&mut input)?) != VERSION {
            return Err(damaged("it is of another version"));
        }
        input.seek(SeekFrom::Start(length - END))?;
        let header_len = u64::from(u32::from_le_bytes(array(&mut input)?));
        let parts = (length - END).checked_sub(header_len).filter(|end| *end >= START && header_len <= MAX_HEADER);
        let parts = parts.ok_or(damaged("its header is invalid"))?;
        let mut header = vec![0; header_len as usize];
        input.seek(SeekFrom::Start(parts))?;
        input.read_exact(&mut header)?;
        let header: Header = serde_json::from_slice(&header).map_err(|_| damaged("its header is invalid"))?;
        if header.digest != request.spec.digest(request.seed) || header.engine != ENGINE_VERSION {
            return Err(CheckpointError::Foreign);
        }
        let lengths = [header.simulation, header.accepted, header.history];
        let end = lengths.into_iter().try_fold(START, u64::checked_add);
        if end != Some(parts) {
            return Err(damaged("its parts are inconsistent"));
        }
        // The lengths agree with the size of the file, so this allocates no more than the file
        // contains.
        let mut simulation = vec![0; header.simulation as usize];
        input.seek(SeekFrom::Start(START))?;
        input.read_exact(&mut simulation)?;
        let begin = START + header.simulation + header.accepted;
        let mut history = SectionsReader::open(FileWindow { input: &mut input, begin, length: header.history, at: 0 })?;
        let history = (0..history.len()).map(|k| history.section(k)).collect::<Result<_, _>>()?;
        let begin = START + header.simulation;
        let accepted = SectionsReader::open(FileWindow { input, begin, length: header.accepted, at: 0 })?;
        if accepted.is_empty() {
            return Err(damaged("its parts are inconsistent"));
        }
        let flipped = usize::try_from(header.flipped).map_err(|_| damaged("its header is invalid"))?;
        Ok(Self { simulation, accepted, history, flipped, recorded: header.recorded })
    }

    /// Reads the sections of the surface one by one.
    pub(super) fn accepted(&mut self) -> impl Iterator<Item = Result<Section, SectionsError>> + '_ {
        (0..self.accepted.len()).map(|k| self.accepted.section(k))
    }
}

/// Contents of a checkpoint to write.
pub(super) struct CheckpointParts<'a> {
    /// State of the simulation.
    pub(super) simulation: &'a [u8],
    /// Writes the sections of the surface as a sections file.
    pub(super) accepted: &'a mut dyn FnMut(&mut dyn Write) -> io::Result<()>,
    pub(super) history: &'a [Section],
    pub(super) flipped: usize,
    pub(super) recorded: u32,
}

impl CheckpointParts<'_> {
    /// Writes a checkpoint to a file in the directory of the request. Dropping the path deletes the
    /// file.
    pub(super) fn save(self, request: &Request) -> io::Result<TempPath> {
        let (file, path) = NamedTempFile::with_suffix_in(".checkpoint", &request.dir)?.into_parts();
        self.write(request, BufWriter::with_capacity(1 << 18, file))?.flush()?;
        Ok(path)
    }

    /// Writes a checkpoint. Returns the output.
    pub(super) fn write<W: Write>(self, request: &Request, out: W) -> io::Result<W> {
        let meta = request.metadata(0);
        let mut out = HashingWriter::new(out);
        out.write_all(MAGIC)?;
        out.write_all(&VERSION.to_le_bytes())?;
        let mut last = out.bytes();
        let mut length = |out: &HashingWriter<W>| out.bytes() - std::mem::replace(&mut last, out.bytes());
        out.write_all(self.simulation)?;
        let simulation = length(&out);
        (self.accepted)(&mut out)?;
        let accepted = length(&out);
        write_sections(self.history, &meta, &mut out)?;
        let history = length(&out);
        let header = Header {
            digest: meta.digest,
            engine: meta.engine,
            flipped: self.flipped as u64,
            recorded: self.recorded,
            simulation,
            accepted,
            history,
        };
        let header = serde_json::to_vec(&header)?;
        out.write_all(&header)?;
        out.write_all(&(header.len() as u32).to_le_bytes())?;
        let hash = out.sha256();
        let (mut out, _) = out.finish();
        out.write_all(&hash)?;
        Ok(out)
    }
}

fn array<const N: usize>(input: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    input.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// A section of a file, readable as a separate file.
pub(super) struct FileWindow<R> {
    input: R,
    begin: u64,
    length: u64,
    at: u64,
}

impl<R: Read + Seek> Read for FileWindow<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let left = usize::try_from(self.length.saturating_sub(self.at)).unwrap_or(usize::MAX);
        let wanted = buffer.len().min(left);
        let read = self.input.read(&mut buffer[..wanted])?;
        self.at += read as u64;
        Ok(read)
    }
}

impl<R: Read + Seek> Seek for FileWindow<R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::End(by) => self.length.checked_add_signed(by),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
        };
        self.at = at.ok_or(io::ErrorKind::InvalidInput)?;
        self.input.seek(SeekFrom::Start(self.begin.saturating_add(self.at)))?;
        Ok(self.at)
    }
}

#[cfg(test)]
mod tests;
