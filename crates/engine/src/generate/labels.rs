//! Writes the label volume of a model: both of its files in one pass.

use super::types::{CancelToken, FileOutput, GenerateError, Request};
use crate::export::Metadata;
use crate::export::hashing::{FileDigest, HashingWriter};
use crate::export::labels::{FILES, LabelReport, LabelVolume, MEDIA_TYPES, write_labels};
use crate::model::Mesh;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Writes `labels.ome.tif` and `labels.nii.gz`; returns them and what the report says of them.
pub(super) fn write(
    request: &Request,
    mesh: &Mesh,
    meta: &Metadata,
    cancel: &CancelToken,
) -> Result<(Vec<FileOutput>, LabelReport), GenerateError> {
    let spec = &request.spec;
    let volume = LabelVolume {
        voxel_um: spec.labels.voxel_um,
        slice_um: spec.labels.slice_um,
        from_um: spec.label_from_um(),
        slices: spec.label_slices(),
    };
    let [ome_path, nifti_path] = FILES.map(|name| request.dir.join(name));
    let write = || {
        let mut ome = buffered(&ome_path)?;
        let mut nifti = HashingWriter::new(buffered(&nifti_path)?);
        let cancelled = || cancel.is_cancelled();
        let report = write_labels(mesh, &spec.histology.layers(), &volume, meta, (&mut ome, &mut nifti), &cancelled)?;
        ome.flush()?;
        drop(ome);
        let (mut file, nifti) = nifti.finish();
        file.flush()?;
        Ok(([hash(&ome_path)?, nifti], report))
    };
    let (digests, report) = write().map_err(|source: io::Error| {
        if cancel.is_cancelled() {
            GenerateError::Cancelled
        } else {
            GenerateError::Io { name: FILES[0].into(), source }
        }
    })?;
    let file = |((name, media_type), digest): ((&str, &str), FileDigest)| FileOutput {
        name: name.into(),
        media_type: media_type.into(),
        bytes: digest.bytes,
        sha256: digest.sha256,
    };
    Ok((FILES.into_iter().zip(MEDIA_TYPES).zip(digests).map(file).collect(), report))
}

fn buffered(path: &Path) -> io::Result<BufWriter<File>> {
    Ok(BufWriter::with_capacity(1 << 18, File::create(path)?))
}

/// Hashes a file after it is complete: a TIFF is not written from its beginning to its end.
fn hash(path: &Path) -> io::Result<FileDigest> {
    let mut hashing = HashingWriter::new(io::sink());
    let mut file = io::BufReader::with_capacity(1 << 18, File::open(path)?);
    io::copy(&mut file, &mut hashing)?;
    Ok(hashing.finish().1)
}
