//! Figure 10: time per step of each version of the simulation, by particles and by time steps.

use super::figure::{Figure, today};
use crate::bench::machine;
use crate::bench::paper::{Measured, Version};
use crate::plot::{self, Axes, Line, Scale, SeriesLabelPosition};
use oviduct::cli::GpuUse;
use serde_json::{Value, json};

/// Versions in the figure: those of oviduct, and the paper's method on this machine.
const VERSIONS: [&str; 5] = ["lists", "lists-multi", "gpu", "paper-single", "paper-multi"];
/// Steps between points of the curve by time steps.
const EVERY: usize = 10;

pub(super) fn draw(measured: &Measured, allowed: &GpuUse) -> anyhow::Result<Figure> {
    let found: Vec<(&str, Option<&Version>)> = VERSIONS.iter().map(|id| (*id, measured.version(id))).collect();
    let by_particles: Vec<Line> = found
        .iter()
        .map(|(id, version)| version.map_or_else(|| no_gpu(allowed), |version| version.line(&name(id, version))))
        .collect();
    let by_step: Vec<Line> = by_particles
        .iter()
        .zip(&found)
        .map(|(line, (_, version))| {
            let points = version.map(|version| steps(measured, version)).unwrap_or_default();
            Line { label: line.label.clone(), points }
        })
        .collect();
    let files = [
        (
            "figure-10a.svg",
            "(a) Time of a step against particles",
            Scale::Linear,
            &by_particles,
            "particles (both loops)",
        ),
        ("figure-10b.svg", "(b) The same, logarithmic", Scale::Logarithmic, &by_particles, "particles (both loops)"),
        (
            "figure-10c.svg",
            "(c) Time of a step against time steps, logarithmic",
            Scale::Logarithmic,
            &by_step,
            "time step",
        ),
    ];
    let files = files
        .into_iter()
        .map(|(file, title, scale, lines, x)| {
            let axes = Axes {
                title: format!("{title}: {}", machine::line()),
                x,
                y: "time of a step, ms",
                x_tick: plot::whole,
                names: if scale == Scale::Linear {
                    SeriesLabelPosition::UpperLeft
                } else {
                    SeriesLabelPosition::LowerRight
                },
            };
            Ok((file.to_owned(), plot::draw(&axes, lines, scale)?.into_bytes()))
        })
        .collect::<anyhow::Result<Vec<_>>>()?;
    let caption = vec![
        format!(
            "Time of a step of the simulation with growing numbers of particles: (a) linear, (b) logarithmic, (c) against time steps as in the paper; measured on {}, engine {}, {}.",
            machine::line(),
            oviduct::ENGINE_VERSION,
            today()
        ),
        "Lists: ours, with neighbour lists and vectors. All pairs: the paper's method, every particle against every edge, without vectors.".to_owned(),
        format!("How it was measured: {}; {}.", measured.method(), measured.accuracy()),
        gpu(measured, allowed),
    ];
    let versions: Vec<Value> =
        found.iter().filter_map(|(_, version)| serde_json::to_value(*version.as_ref()?).ok()).collect();
    let numbers = json!({
        "versions": versions, "method": measured.method(), "accuracy": measured.accuracy(), "gpu": measured.gpu(),
        "steps": measured.particles.len() as u64 - u64::from(measured.burn_in), "burn_in": measured.burn_in,
        "particles": [measured.particles.first(), measured.particles.last()],
    });
    Ok(Figure { number: "10", title: "Time of a step", files, caption, numbers })
}

/// Returns a sentence about the GPU.
pub(super) fn gpu(measured: &Measured, allowed: &GpuUse) -> String {
    let reason = measured.gpu()["reason"].as_str().unwrap_or_default();
    match (measured.version("gpu"), allowed) {
        (Some(version), _) => format!("GPU: {}.", version.label),
        (None, GpuUse::Auto) => format!("No GPU on this machine, so there is no time of one ({reason})."),
        (None, GpuUse::Off | GpuUse::One(_)) => format!("There is no time of a GPU: {reason}."),
    }
}

fn no_gpu(allowed: &GpuUse) -> Line {
    let label = match allowed {
        GpuUse::Auto => "GPU: none on this machine",
        GpuUse::Off | GpuUse::One(_) => "GPU: not used",
    };
    Line { label: label.to_owned(), points: Vec::new() }
}

fn name(id: &str, version: &Version) -> String {
    let threads = machine::threads();
    match id {
        "lists" => "lists, one core".to_owned(),
        "lists-multi" => format!("lists, {threads} threads"),
        "paper-single" => "all pairs, one core".to_owned(),
        "paper-multi" => format!("all pairs, {threads} threads"),
        _ => version.label.clone(),
    }
}

/// Returns the milliseconds per step by time step.
fn steps(measured: &Measured, version: &Version) -> Vec<(f64, f64)> {
    let grown = measured.particles.iter().skip(measured.burn_in as usize).enumerate().step_by(EVERY);
    grown.map(|(step, &particles)| (step as f64, 1e3 * version.seconds_at(particles))).collect()
}
