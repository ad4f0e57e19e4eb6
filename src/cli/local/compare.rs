//! `oviduct compare`: compares models of several seeds with published anatomy, as Markdown tables
//! or JSON.

use super::checklist::{self, Tally, number, tally};
use crate::cli::args::CompareArgs;
use crate::cli::exit::{Ended, Failure};
use crate::cli::interrupt::Signals;
use crate::cli::scratch::Scratch;
use crate::cli::term;
use crate::generate::{Backend, CancelToken, Findings, Request, generate};
use crate::measure::checklist::Checklist;
use crate::measure::comparison::{Compared, Verdict};
use crate::measure::morphometry::{CHANGES, QUANTITIES};
use crate::spec::{ModelSpec, Preset, preset, presets};
use anyhow::{Context, anyhow};
use serde_json::{Value, json};
use std::fmt::Write as _;

/// Regions in the tables of quantities.
const REGIONS: [&str; 3] = ["isthmus", "junction", "ampulla"];

pub(in crate::cli) async fn run(args: CompareArgs) -> Ended {
    let unknown = args.presets.iter().find(|name| preset(name).is_none());
    if let Some(name) = unknown {
        let known: Vec<&str> = presets().iter().map(|preset| preset.name.as_str()).collect();
        return Err(Failure::usage(format!("--preset {name}: the presets are {}", known.join(", "))));
    }
    let cancel = CancelToken::default();
    let bar = term::Bar::on_stderr();
    let task = tokio::task::spawn_blocking({
        let (args, cancel, bar) = (args.clone(), cancel.clone(), bar.clone());
        move || {
            let of = args.presets.iter().filter_map(|name| preset(name));
            of.map(|preset| Ok((preset, grown(preset, &args, &bar, &cancel)?))).collect::<anyhow::Result<Vec<_>>>()
        }
    });
    let grown = Signals::listen().stoppable(task, &cancel, &bar).await?.context("growing panicked")??;
    let tallies = || grown.iter().map(|(preset, models)| tally(&preset.name, &checklists(models)));
    if args.json {
        let all = grown.iter().zip(tallies());
        let all: Vec<Value> = all.map(|((preset, models), tally)| document(preset, models, &tally)).collect();
        term::print_json(&all)?;
    } else if args.checklist {
        term::print(checklist::markdown(&tallies().collect::<Vec<_>>()).trim_end())?;
    } else {
        let tables: Vec<String> = grown.iter().map(|(preset, models)| markdown(preset, models)).collect();
        term::print(tables.join("\n").trim_end())?;
    }
    Ok(())
}

/// Seed and findings of a model.
type Model = (u64, Findings);

fn grown(preset: &Preset, args: &CompareArgs, bar: &term::Bar, cancel: &CancelToken) -> anyhow::Result<Vec<Model>> {
    let spec = ModelSpec::resolve(preset, &json!({})).map_err(|_| anyhow!("the preset {} is invalid", preset.name))?;
    let seeds = args.seeds.clone();
    let count = seeds.end() - seeds.start() + 1;
    let models = seeds.enumerate().map(|(i, seed)| {
        bar.show(&preset.name, i as f64 / count as f64, format!("seed {seed}"));
        // Only the findings of a model are kept.
        let scratch = Scratch::new(&std::env::temp_dir())?;
        let request = Request {
            preset: preset.name.clone(),
            spec: spec.clone(),
            seed,
            backend: Backend::Cpu,
            outputs: Vec::new().into(),
            dir: scratch.dir().to_owned(),
            memory_limit_bytes: None,
        };
        let outcome = generate(&request, &(), cancel).with_context(|| format!("{}, seed {seed}", preset.name))?;
        Ok((seed, outcome.findings))
    });
    models.collect()
}

/// Mean and standard deviation between models.
fn spread(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|x| (x - mean).powi(2)).sum();
    (mean, if values.len() > 1 { (squares / (n - 1.0)).sqrt() } else { 0.0 })
}

/// A published measure and the values of the models.
fn rows(models: &[Model]) -> Vec<(&Compared, Vec<f64>, usize)> {
    let compared = |model: &'_ Model| model.1.comparison.as_ref().map(|c| &c.compared).into_iter().flatten().count();
    let count = models.first().map_or(0, compared);
    let of = |k: usize| models.iter().filter_map(move |m| m.1.comparison.as_ref()?.compared.get(k));
    (0..count)
        .filter_map(|k| {
            let values = of(k).filter_map(|c| c.measured).collect();
            let inside = of(k).filter(|c| c.verdict == Verdict::Inside).count();
            Some((of(k).next()?, values, inside))
        })
        .collect()
}

/// Values of a quantity in a region, one per model: the mean along the region, or the median for
/// counts that are orders.
fn values(models: &[Model], quantity: &str, region: &str) -> Vec<f64> {
    let along = |model: &Model| Some(*model.1.morphometry.regions.get(region)?.quantities.get(quantity)?);
    let of = |along: crate::measure::morphometry::Along| {
        if quantity == "branching_order" { along.median } else { along.mean }
    };
    models.iter().filter_map(along).map(of).collect()
}

fn checklists(models: &[Model]) -> Vec<&Checklist> {
    models.iter().filter_map(|(_, findings)| findings.checklist.as_ref()).collect()
}

fn markdown(preset: &Preset, models: &[Model]) -> String {
    let mut text = format!("### Preset `{}`, {} seeds\n\n", preset.name, models.len());
    text += "| measure | region | published | range | models, mean ± SD | inside | source |\n|---|---|---|---|---|---|---|\n";
    for (published, values, inside) in rows(models) {
        let (mean, sd) = spread(&values);
        let optional = |x: Option<f64>| x.map_or_else(|| "–".into(), number);
        let sd_published = published.sd.map(|sd| format!(" ± {}", number(sd))).unwrap_or_default();
        let range = match (published.low, published.high) {
            (None, None) => "–".to_owned(),
            (low, high) => format!("{} to {}", optional(low), optional(high)),
        };
        let inside = if published.verdict == Verdict::Shortened {
            "shortened by choice".to_owned()
        } else if published.verdict == Verdict::MethodUnknown {
            "method unknown".to_owned()
        } else if published.low.is_none() && published.high.is_none() {
            "–".to_owned()
        } else {
            format!("{inside} of {}", models.len())
        };
        let _ = writeln!(
            text,
            "| `{}` | {} | {}{sd_published} | {range} | {} ± {} | {inside} | {} |",
            published.quantity,
            published.region,
            optional(published.value),
            number(mean),
            number(sd),
            published.source,
        );
    }
    text += "\n| quantity | isthmus | junction | ampulla |\n|---|---|---|---|\n";
    for name in QUANTITIES.iter().map(|quantity| quantity.name).chain(CHANGES.map(|(name, ..)| name)) {
        let _ = write!(text, "| `{name}` |");
        for region in REGIONS {
            let (mean, sd) = spread(&values(models, name, region));
            let cell = if mean.is_finite() { format!("{} ± {}", number(mean), number(sd)) } else { "–".into() };
            let _ = write!(text, " {cell} |");
        }
        text.push('\n');
    }
    text
}

fn document(preset: &Preset, models: &[Model], tally: &Tally) -> Value {
    let model = |(seed, findings): &Model| {
        json!({
            "seed": seed,
            "means": findings.morphometry.means(),
            "comparison": findings.comparison,
            "checklist": findings.checklist,
        })
    };
    let models: Vec<Value> = models.iter().map(model).collect();
    json!({ "preset": preset.name, "models": models, "checklist": tally })
}
