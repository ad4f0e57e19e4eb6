//! The state of an unfinished generation as bytes, from which it can be continued to the same files.
//!
//! Invariant: a model that was resumed, any number of times and on any number of threads, is the same, byte for byte,
//! as one that was grown without interruption. The simulation continues from its exact state. The surface is not stored but
//! lofted again from its sections, including those added to mend slabs: whether a section is accepted, and with which
//! diagonals, depends only on the surface so far.
//!
//! Format: magic, version (u32), length of the header (u32), header (JSON), state of the simulation, accepted sections,
//! sections since the last recorded one (each as `sections.bin`), SHA-256 of all before.

use super::types::Request;
use crate::ENGINE_VERSION;
use crate::export::Metadata;
use crate::export::sections_bin::{SectionsError, SectionsReader, write_sections};
use crate::model::Section;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::io::Cursor;

const MAGIC: &[u8; 8] = b"OVCHKPT\n";
const VERSION: u32 = 1;
const HASH: usize = 32;

/// Why a checkpoint cannot be used; the generation then starts from the beginning.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// It is not a checkpoint, has another version, or is incomplete.
    #[error("the checkpoint is damaged: {0}")]
    Damaged(&'static str),
    /// It belongs to another specification, seed or engine.
    #[error("the checkpoint is of another model or engine")]
    Foreign,
    /// Its sections cannot be read.
    #[error("the sections of the checkpoint cannot be read")]
    Sections(#[from] SectionsError),
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

/// A generation between two steps of its simulation.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// State of the simulation, as saved by it.
    pub(super) simulation: Vec<u8>,
    /// The sections of the surface.
    pub(super) accepted: Vec<Section>,
    /// The sections of the steps since the last recorded one.
    pub(super) history: Vec<Section>,
    /// Diagonals flipped so far.
    pub(super) flipped: usize,
    /// Sections recorded so far.
    pub(super) recorded: u32,
}

impl Checkpoint {
    /// Reads a checkpoint of the model of `request`.
    ///
    /// # Errors
    /// [`CheckpointError`].
    pub fn read(request: &Request, bytes: &[u8]) -> Result<Self, CheckpointError> {
        let damaged = CheckpointError::Damaged;
        let (body, hash) = bytes.split_last_chunk::<HASH>().ok_or(damaged("it is truncated"))?;
        if <[u8; HASH]>::from(Sha256::digest(body)) != *hash {
            return Err(damaged("its hash differs"));
        }
        let body = body.strip_prefix(MAGIC).ok_or(damaged("it is not a checkpoint"))?;
        let (version, body) = number(body).ok_or(damaged("it is truncated"))?;
        if version != VERSION {
            return Err(damaged("it is of another version"));
        }
        let (length, body) = number(body).ok_or(damaged("it is truncated"))?;
        let (header, body) = body.split_at_checked(length as usize).ok_or(damaged("it is truncated"))?;
        let header: Header = serde_json::from_slice(header).map_err(|_| damaged("its header is invalid"))?;
        if header.digest != request.spec.digest(request.seed) || header.engine != ENGINE_VERSION {
            return Err(CheckpointError::Foreign);
        }
        let part = |body: &'_ [u8], length: u64| -> Option<usize> {
            usize::try_from(length).ok().filter(|length| *length <= body.len())
        };
        let (simulation, body) =
            body.split_at(part(body, header.simulation).ok_or(damaged("its parts are inconsistent"))?);
        let (accepted, body) = body.split_at(part(body, header.accepted).ok_or(damaged("its parts are inconsistent"))?);
        let (history, rest) = body.split_at(part(body, header.history).ok_or(damaged("its parts are inconsistent"))?);
        let checkpoint = Self {
            simulation: simulation.to_vec(),
            accepted: sections(accepted)?,
            history: sections(history)?,
            flipped: usize::try_from(header.flipped).map_err(|_| damaged("its header is invalid"))?,
            recorded: header.recorded,
        };
        if !rest.is_empty() || checkpoint.accepted.is_empty() {
            return Err(damaged("its parts are inconsistent"));
        }
        Ok(checkpoint)
    }

    /// The bytes of a checkpoint, from borrowed parts.
    pub(super) fn write(
        request: &Request,
        simulation: &[u8],
        accepted: &[Section],
        history: &[Section],
        flipped: usize,
        recorded: u32,
    ) -> std::io::Result<Vec<u8>> {
        let meta = Metadata {
            preset: request.preset.clone(),
            seed: request.seed,
            digest: request.spec.digest(request.seed),
            engine: ENGINE_VERSION.into(),
            length_mm: request.spec.length_mm,
            sections: accepted.len(),
        };
        let (mut surface, mut since) = (Vec::new(), Vec::new());
        write_sections(accepted, &meta, &mut surface)?;
        write_sections(history, &meta, &mut since)?;
        let header = Header {
            digest: meta.digest,
            engine: meta.engine,
            flipped: flipped as u64,
            recorded,
            simulation: simulation.len() as u64,
            accepted: surface.len() as u64,
            history: since.len() as u64,
        };
        let header = serde_json::to_vec(&header)?;
        let mut bytes = Vec::with_capacity(16 + header.len() + simulation.len() + surface.len() + since.len() + HASH);
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&(header.len() as u32).to_le_bytes());
        for part in [header.as_slice(), simulation, &surface, &since] {
            bytes.extend_from_slice(part);
        }
        let hash = Sha256::digest(&bytes);
        bytes.extend_from_slice(&hash);
        Ok(bytes)
    }
}

fn number(bytes: &[u8]) -> Option<(u32, &[u8])> {
    bytes.split_first_chunk::<4>().map(|(head, rest)| (u32::from_le_bytes(*head), rest))
}

fn sections(bytes: &[u8]) -> Result<Vec<Section>, SectionsError> {
    let mut reader = SectionsReader::open(Cursor::new(bytes))?;
    (0..reader.len()).map(|k| reader.section(k)).collect()
}

#[cfg(test)]
mod tests;
