//! Fuzz targets: patches of specifications, and checkpoints.

use super::Cost;
use super::checkpoint::{Checkpoint, CheckpointParts};
use super::outputs::{Output, Outputs};
use super::types::{Backend, Request};
use super::walls::Walls;
use crate::ENGINE_VERSION;
use crate::export::sections_bin::fuzzing::seal;
use crate::export::sections_bin::{SectionsError, write_sections};
use crate::spec::{self, ModelSpec, preset};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::io::{Cursor, Read, Seek};
use std::sync::LazyLock;

/// Maximum number of particles of a checkpoint whose surface is lofted again.
const LOFTED: usize = 2000;

static REQUEST: LazyLock<Request> = LazyLock::new(|| {
    let patch = json!({
        "steps": 60, "burn_in": 20, "particles": {
            "total": { "keys": [[0, 70], [1, 140]] }, "outer": { "keys": [[0, 20], [1, 30]] } },
    });
    let spec = preset("pig").map(|pig| ModelSpec::resolve(pig, &patch));
    Request {
        preset: "pig".into(),
        spec: spec.expect("the preset exists").expect("the patch is valid"),
        seed: 7,
        backend: Backend::CpuSingle,
        outputs: Outputs::none(),
        dir: ".".into(),
        memory_limit_bytes: None,
    }
});

/// Asserts the properties of [`spec::fuzzing::patch`], and that each specification has a finite
/// cost.
pub fn patch(bytes: &[u8]) {
    spec::fuzzing::patch(bytes, |spec| {
        let cost = serde_json::to_string(&Cost::new(spec, &vec![Output::Glb, Output::Obj].into()));
        assert!(cost.is_ok_and(|text| !text.contains("null")), "the cost is not a finite number");
    });
}

/// Asserts that an accepted checkpoint is written and read again as the same checkpoint, and that
/// its surface is lofted or refused. The bytes are read unchanged and with corrected checksums, so
/// that the target also finds damage behind them.
pub fn checkpoint(bytes: &[u8]) {
    read(bytes);
    if let Some(sealed) = sealed(bytes) {
        read(&sealed);
    }
}

fn read(bytes: &[u8]) {
    let Ok(mut checkpoint) = Checkpoint::read(&REQUEST, Cursor::new(bytes)) else { return };
    let Ok(written) = write(&mut checkpoint) else { return };
    let mut again = Checkpoint::read(&REQUEST, Cursor::new(&written)).expect("what was written can be read");
    let twice = write(&mut again).expect("what was read whole can be read again");
    assert!(twice == written, "another checkpoint was read than was written");
    let Ok(accepted) = checkpoint.accepted().collect::<Result<Vec<_>, _>>() else { return };
    let particles: usize = accepted.iter().map(crate::model::Section::particles).sum();
    if particles > LOFTED {
        return;
    }
    drop(Walls::restored(&REQUEST, accepted.into_iter().map(Ok), checkpoint.flipped, || false));
}

/// Writes a checkpoint again. Fails if one of its sections cannot be read.
fn write<R: Read + Seek>(c: &mut Checkpoint<R>) -> Result<Vec<u8>, SectionsError> {
    let accepted = c.accepted().collect::<Result<Vec<_>, _>>()?;
    let meta = REQUEST.metadata(accepted.len());
    let parts = CheckpointParts {
        simulation: &c.simulation,
        accepted: &mut |mut out| write_sections(&accepted, &meta, &mut out),
        history: &c.history,
        flipped: c.flipped,
        recorded: c.recorded,
    };
    Ok(parts.write(&REQUEST, Vec::new())?)
}

/// The checkpoint with the header of [`REQUEST`] and correct checksums; `None` if it lacks these
/// parts.
fn sealed(bytes: &[u8]) -> Option<Vec<u8>> {
    let (start, rest) = bytes.split_at_checked(12)?;
    let (rest, _) = rest.split_last_chunk::<32>()?;
    let (rest, length) = rest.split_last_chunk::<4>()?;
    let parts = rest.len().checked_sub(u32::from_le_bytes(*length) as usize)?;
    let (parts, header) = rest.split_at(parts);
    let mut header: Value = serde_json::from_slice(header).ok()?;
    let members = header.as_object_mut()?;
    members.insert("digest".to_owned(), REQUEST.spec.digest(REQUEST.seed).into());
    members.insert("engine".to_owned(), ENGINE_VERSION.into());
    let mut parts = parts.to_vec();
    let length = |name: &str| header.get(name).and_then(Value::as_u64).and_then(|n| usize::try_from(n).ok());
    let accepted = length("simulation")?;
    let history = accepted.checked_add(length("accepted")?)?;
    let end = history.checked_add(length("history")?)?;
    seal(parts.get_mut(accepted..history)?);
    seal(parts.get_mut(history..end)?);
    let header = serde_json::to_vec(&header).ok()?;
    let length = u32::try_from(header.len()).ok()?.to_le_bytes();
    let mut sealed = [start, &parts, &header, &length].concat();
    let hash = Sha256::digest(&sealed);
    sealed.extend_from_slice(&hash);
    Some(sealed)
}
