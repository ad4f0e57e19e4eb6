//! Draws the pictures of the README: `cargo run --release --example pictures -- SEED OUT [PATCH]`.
//!
//! Grows the `pig` model of a seed, optionally changed by a JSON patch. Writes `sections.png` (the
//! sections at `STEPS`) and `model.png` to the folder OUT.

use oviduct::mesh::Lofter;
use oviduct::model::Section;
use oviduct::render::{Finish, NamedView, mesh_png, sheet_png};
use oviduct::sim::Plan;
use oviduct::sim::cpu::CpuSimulation;
use oviduct::spec::{ModelSpec, preset};
use std::error::Error;
use std::path::Path;

/// Steps of the sections in `sections.png`.
const STEPS: [f64; 7] = [0.0, 200.0, 425.0, 800.0, 1200.0, 1600.0, 2000.0];

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let seed: u64 = args.next().ok_or("a seed is missing")?.parse()?;
    let out = args.next().ok_or("a folder is missing")?;
    let patch: serde_json::Value = args.next().map_or(Ok(serde_json::json!({})), |text| serde_json::from_str(&text))?;
    let pig = preset("pig").ok_or("the preset is missing")?;
    let spec = ModelSpec::resolve(pig, &patch).map_err(|faults| format!("{faults:?}"))?;
    let mut simulation = CpuSimulation::new(Plan::new(&spec, seed), rayon::current_num_threads());
    while simulation.time() < 0 {
        simulation.step()?;
    }
    let mut sections = vec![simulation.section()];
    let mut lofter = Lofter::new(simulation.section())?;
    let mut history = Vec::new();
    while simulation.time() < i64::from(spec.steps) {
        simulation.step()?;
        history.push(simulation.section());
        if simulation.time() % 5 == 0 {
            sections.push(simulation.section());
            lofter.advance(&history)?;
            history.clear();
        }
    }
    let mesh = lofter.finish()?;
    let out = Path::new(&out);
    std::fs::create_dir_all(out)?;
    let chosen: Vec<_> = sections.iter().filter(|s| STEPS.contains(&s.step)).map(Section::borders).collect();
    std::fs::write(out.join("sections.png"), sheet_png(&chosen, 4, 480)?)?;
    let finish = Finish { spec: &spec, seed };
    std::fs::write(out.join("model.png"), mesh_png(&mesh, &NamedView::Opened.of(&mesh, 1200), Some(&finish))?)?;
    Ok(())
}
