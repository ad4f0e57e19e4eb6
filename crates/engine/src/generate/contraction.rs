//! Contraction of a model: every frame is certified and written, one after the other.

use super::files::{HashedFile, failed, hashed, output};
use super::types::{ContractionReport, FileOutput, FrameReport, GenerateError, Request};
use crate::export::Metadata;
use crate::export::animation::{self, Frames, write_animation};
use crate::export::frames::{self, write_common, write_description, write_frame};
use crate::export::glb;
use crate::export::lod::{LEVEL_TRIANGLES, reduced};
use crate::measure::certify_body;
use crate::mesh::contract::{Contracting, Contraction, Rest, Station, lumen_mm3};
use crate::model::{LengthUnit, Mesh};
use crate::sim::Plan;
use crate::spec::Toward;
use serde_json::{Map, json};
use std::io::Write;

/// True if a file contains frames. Frames show the tissue in metres.
pub(super) fn is_frames(name: &str) -> bool {
    name == animation::FILE || frames::FILES.contains(&name)
}

/// Wave that a request asks for.
pub(super) fn contraction(request: &Request) -> Contraction {
    let (spec, of) = (&request.spec, &request.spec.contraction);
    let plan = Plan::new(spec, request.seed);
    let station = |step: u32| {
        let (row, u) = (plan.at(i64::from(step)), f64::from(step) / f64::from(spec.steps));
        let r_in = f64::from(row.r_in * plan.scale);
        Station {
            z_um: plan.z_um[step as usize],
            base_um2: plan.region(i64::from(step)).area() * r_in * r_in * f64::from(row.squash),
            closure: of.closure.at(u),
            shortening: of.shortening.at(u),
            wavelength_um: 1000.0 * of.wavelength_mm.at(u),
        }
    };
    Contraction {
        stations: spec.stations().map(station).collect(),
        phase: of.phase,
        to_uterus: of.toward == Toward::Uterus,
        ends_um: 1000.0 * of.ends_mm,
    }
}

/// Certifies and writes all frames of `rest`, whose finished surface and its volume are given.
/// `progress` receives the completed fraction, and fails if the generation is cancelled.
pub(super) fn write(
    request: &Request,
    rest: Rest<'_>,
    (tissue, tissue_mm3): (&Mesh, f64),
    progress: &dyn Fn(f64) -> Result<(), GenerateError>,
    stop: &dyn Fn() -> bool,
) -> Result<(Vec<FileOutput>, ContractionReport), GenerateError> {
    let [description_name, data_name] = frames::FILES;
    let [description_type, data_type] = frames::MEDIA_TYPES;
    let of = &request.spec.contraction;
    let count = of.frames;
    let time = |k: u32| f64::from(k) / f64::from(count);
    let (mut level, kept) = reduced(tissue, LEVEL_TRIANGLES[1]);
    let mut tube = Contracting::new(rest, &contraction(request));
    // Damping applies to all frames, so all are computed before the first is written.
    for k in 0..count {
        progress(0.5 * time(k))?;
        tube.frame(time(k), stop);
    }
    let mut data = hashed(&request.dir.join(data_name)).map_err(failed(data_name))?;
    write_common(tissue, &mut data).map_err(failed(data_name))?;
    let mut moved = Vec::with_capacity(count as usize);
    let mut report = ContractionReport {
        period_s: of.period_s,
        lumen_volume_mm3: lumen_mm3(tissue),
        tissue_deviation: 0.0,
        contracted: tube.done(),
        frames: Vec::new(),
    };
    for k in 0..count {
        progress(0.5 + 0.5 * time(k))?;
        let mut frame = tube.place(time(k));
        let mut certificate = certify_body(&frame.mesh, LengthUnit::Metre);
        if !certificate.passed {
            frame = tube.frame(time(k), stop);
            certificate = certify_body(&frame.mesh, LengthUnit::Metre);
        }
        if let Some(detail) = certificate.first_failure() {
            return Err(GenerateError::Certificate { detail: format!("frame {k} of the contraction: {detail}") });
        }
        write_frame(&frame.mesh, &mut data).map_err(failed(data_name))?;
        moved.push(kept.iter().map(|&v| frame.mesh.positions[v as usize]).collect::<Vec<_>>());
        report.tissue_deviation = report.tissue_deviation.max((certificate.volume_mm3 / tissue_mm3 - 1.0).abs());
        report.frames.push(FrameReport {
            time_s: of.period_s * time(k),
            length_mm: frame.length_um / 1000.0,
            tissue_volume_mm3: certificate.volume_mm3,
            lumen_volume_mm3: lumen_mm3(&frame.mesh),
            closed: frame.closed,
            narrowed: frame.narrowed,
            certificate,
        });
    }
    report.contracted = tube.done();
    progress(1.0)?;
    let mut files = vec![finished(data, data_name, data_type)?];
    let times: Vec<f64> = report.frames.iter().map(|frame| frame.time_s).collect();
    let mut out = hashed(&request.dir.join(description_name)).map_err(failed(description_name))?;
    write_description(tissue, &times, &mut out).map_err(failed(description_name))?;
    files.push(finished(out, description_name, description_type)?);

    let name = animation::FILE;
    level.positions = moved.remove(0);
    let frames = Frames { first: &level, others: &moved, period_s: of.period_s };
    let meta: Metadata = request.metadata(request.spec.stations().count());
    let more = Map::from_iter([(
        "contraction".to_owned(),
        json!({ "frames": count, "period_s": of.period_s, "phase": of.phase, "toward": of.toward.name() }),
    )]);
    let mut out = hashed(&request.dir.join(name)).map_err(failed(name))?;
    write_animation(&frames, &meta, more, &mut out).map_err(failed(name))?;
    files.push(finished(out, name, glb::MEDIA_TYPE)?);
    Ok((files, report))
}

fn finished(out: HashedFile, name: &'static str, media_type: &'static str) -> Result<FileOutput, GenerateError> {
    let (mut file, digest) = out.finish();
    file.flush().map_err(failed(name))?;
    Ok(output(name, media_type, digest))
}
