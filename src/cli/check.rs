//! `oviduct check`: the certificate of the surface in any file, whether oviduct wrote it or not.

use super::args::CheckArgs;
use super::exit::{Ended, Failure};
use super::{interrupt, term};
use crate::export::read::{ReadError, read_surface};
use crate::measure::{Certificate, CheckOptions, check_surface};
use anyhow::Context;
use serde_json::{Value, json};
use std::path::Path;

pub(super) async fn run(args: CheckArgs) -> Ended {
    let (files, json) = (args.files.clone(), args.json);
    // Nothing is written, so an interrupt need not wait for the threads that read and certify.
    let task = tokio::task::spawn_blocking(move || {
        args.files.iter().map(|file| certificate(file, args.euler)).collect::<Vec<_>>()
    });
    let certificates = tokio::select! {
        done = task => done.context("the check panicked")?,
        () = interrupt::asked_to_stop() => return Err(Failure::Interrupted),
    };
    if json {
        let all: Vec<Value> = files.iter().zip(&certificates).map(|(file, found)| as_json(file, found)).collect();
        term::print_json(&all)?;
    } else {
        for (file, found) in files.iter().zip(&certificates) {
            for line in as_text(file, found) {
                term::print(&line)?;
            }
        }
    }
    let all_good = certificates.iter().all(|found| found.as_ref().is_ok_and(|certificate| certificate.passed));
    if all_good { Ok(()) } else { Err(Failure::Negative) }
}

fn certificate(file: &Path, euler: Option<i64>) -> anyhow::Result<Certificate> {
    let surface = read_surface(file)?;
    let options = CheckOptions { euler, unit_metres: surface.unit.metres() };
    Ok(check_surface(&surface.positions, &surface.triangles, &options))
}

fn as_json(file: &Path, found: &anyhow::Result<Certificate>) -> Value {
    match found {
        Ok(certificate) => json!({ "file": file, "certificate": certificate, "error": null }),
        Err(error) => json!({ "file": file, "certificate": null, "error": format!("{error:#}") }),
    }
}

fn as_text(file: &Path, found: &anyhow::Result<Certificate>) -> Vec<String> {
    let certificate = match found {
        Ok(certificate) => certificate,
        Err(error) => {
            let why = match error.downcast_ref() {
                Some(ReadError::Io { path, source }) if path == file => source.to_string(),
                _ => format!("{error:#}"),
            };
            return vec![format!("{}: cannot be read: {why}", file.display())];
        }
    };
    let file = file.display();
    let verdict = if certificate.passed { "passed" } else { "FAILED" };
    let (v, t, c) = (certificate.vertices, certificate.triangles, certificate.components);
    let noun = if c == 1 { "component" } else { "components" };
    let euler: Vec<String> = certificate.bodies.iter().map(|body| body.euler.to_string()).collect();
    let mut lines =
        vec![format!("{file}: {verdict}: {v} vertices, {t} triangles, {c} {noun}, Euler number {}", euler.join(", "))];
    lines.extend(certificate.failures.iter().map(|failure| format!("  {failure}")));
    lines
}
