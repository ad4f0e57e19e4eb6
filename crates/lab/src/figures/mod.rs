//! `oviduct-lab figures`: reproduces figures of the paper with a new model and with measurements on
//! this machine.
//!
//! | file | subject |
//! |---|---|
//! | `grown` | the model of Figures 4 to 9, read back from its files |
//! | `figure4` | sections of isthmus and ampulla as lines |
//! | `figure7` | sections along the tube, and the same ones stained |
//! | `figure8` | triangulated end caps, wire frame |
//! | `figure9` | views of the model |
//! | `figure10` | time per step of each version of the simulation |
//! | `figure11` | their total times, as a table |
//! | `table` | tables as SVG |

mod args;
mod figure;
mod figure10;
mod figure11;
mod figure4;
mod figure7;
mod figure8;
mod figure9;
mod grown;
mod table;

pub(crate) use args::FiguresArgs;

use crate::bench::{machine, paper};
use anyhow::Context;
use args::FigureNumber;
use base64::Engine as _;
use figure::{Figure, today};
use grown::Grown;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use oviduct::cli::{Ended, Scratch, Signals, generate, model, term, units};
use oviduct::generate::{Output, Request};
use oviduct::report::STYLE;
use oviduct::sim::Plan;
use oviduct::spec::ModelSpec;
use serde_json::{Value, json};

/// Name of the file with the numbers.
const NUMBERS: &str = "figures.json";
/// Name of the index page.
const INDEX: &str = "figures.html";

/// Draws a figure of a grown model in pictures of this width.
type DrawFigure = fn(&Grown, u32) -> anyhow::Result<Figure>;
/// Figures of the model with the functions that draw them.
const MODEL_FIGURES: [(FigureNumber, DrawFigure); 4] = [
    (FigureNumber::Four, figure4::draw),
    (FigureNumber::Seven, figure7::draw),
    (FigureNumber::Eight, figure8::draw),
    (FigureNumber::Nine, figure9::draw),
];

pub(crate) async fn run(args: FiguresArgs) -> Ended {
    let (preset, spec) = model::resolve(&args.of)?;
    let seed = model::seed(&args.of);
    // Before the scratch directory is created, which a signal would leave behind.
    let mut signals = Signals::listen();
    let scratch = Scratch::new(&args.out).with_context(|| format!("--out {}", args.out.display()))?;
    let mut document = json!({
        "engine": oviduct::ENGINE_VERSION,
        "date": today(),
        "machine": machine::describe(),
        "preset": preset.name,
        "seed": seed,
        "digest": spec.digest(seed),
        "figures": {},
    });
    let mut figures = Vec::new();
    if MODEL_FIGURES.iter().any(|(number, _)| args.wants(*number)) {
        let request = Request {
            preset: preset.name.clone(),
            seed,
            spec: spec.clone(),
            backend: args.backend,
            outputs: vec![Output::Glb].into(),
            dir: scratch.dir().to_owned(),
            memory_limit_bytes: None,
        };
        let (outcome, fallback, request) = generate::grow(request, args.gpu.clone(), &mut signals).await?;
        generate::warn(&outcome);
        document["model"] = json!({
            "backend": outcome.used, "device": outcome.device, "fallback": fallback, "seconds": outcome.seconds,
            "summary": &outcome.findings.summary,
        });
        let (wanted, summary) = (args.clone(), outcome.findings.summary);
        figures = signals.run("drawing", move || draw(&Grown::read(&request, summary)?, &wanted)).await??;
    }
    if args.wants(FigureNumber::Ten) || args.wants(FigureNumber::Eleven) {
        let wanted = args.clone();
        figures.extend(signals.run("drawing", move || measure(&spec, seed, &wanted)).await??);
    }
    for made in &figures {
        document["figures"][made.number] = made.document();
    }
    publish(&scratch, &figures, &document)
}

fn draw(grown: &Grown, args: &FiguresArgs) -> anyhow::Result<Vec<Figure>> {
    let bar = term::Bar::on_stderr();
    let wanted: Vec<_> = MODEL_FIGURES.into_iter().filter(|(number, _)| args.wants(*number)).collect();
    let count = wanted.len() as f64;
    let drawn = wanted.into_iter().enumerate().map(|(i, (number, draw))| {
        bar.show("draw", i as f64 / count, format!("figure {}", figure::name(number)));
        draw(grown, args.size).with_context(|| format!("figure {}", figure::name(number)))
    });
    let drawn = drawn.collect();
    bar.clear();
    drawn
}

fn measure(spec: &ModelSpec, seed: u64, args: &FiguresArgs) -> anyhow::Result<Vec<Figure>> {
    let measured = paper::measure(&Plan::new(spec, seed), args.quick, &args.gpu)?;
    let mut made = Vec::new();
    if args.wants(FigureNumber::Ten) {
        made.push(figure10::draw(&measured, &args.gpu.gpu)?);
    }
    if args.wants(FigureNumber::Eleven) {
        made.push(figure11::draw(&measured, &args.gpu.gpu));
    }
    Ok(made)
}

/// Moves all files to their directory, the index last, and lists them.
fn publish(scratch: &Scratch, figures: &[Figure], document: &Value) -> Ended {
    let numbers = serde_json::to_string_pretty(document)? + "\n";
    let index = page(figures, document).into_string();
    let named = |(name, bytes): &(String, Vec<u8>)| (name.clone(), bytes.clone());
    let files: Vec<(String, Vec<u8>)> = figures
        .iter()
        .flat_map(|made| made.files.iter().map(named))
        .chain([(NUMBERS.to_owned(), numbers.into_bytes()), (INDEX.to_owned(), index.into_bytes())])
        .collect();
    for (name, bytes) in &files {
        std::fs::write(scratch.dir().join(name), bytes).with_context(|| name.clone())?;
    }
    for (name, bytes) in &files {
        let path = scratch.publish(name).with_context(|| name.clone())?;
        term::print(&format!("{}  {}", path.display(), units::show_bytes(bytes.len() as u64)))?;
    }
    Ok(())
}

/// Returns the index: all figures with their captions on one page that needs no other file.
fn page(figures: &[Figure], document: &Value) -> Markup {
    let text = |name: &str| document[name].as_str().unwrap_or_default().to_owned();
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { "The paper's figures · oviduct" }
                style { (PreEscaped(STYLE)) "svg { display: block; max-width: 100%; height: auto; }" }
            }
            body {
                h1 { "The paper's figures" }
                p.soft {
                    "Figures of Burkitt, Romano, Walker and Fazeli, 3D Modelling of Complex Biological Structures: The Oviduct, made again by oviduct "
                    (text("engine")) " on " (machine::line()) ", " (text("date")) ". Preset " (text("preset")) ", seed " (document["seed"])
                    ", digest " code { (text("digest")) } ". The numbers behind them are in figures.json."
                }
                @for made in figures {
                    h2 { "Figure " (made.number) ". " (made.title) }
                    figure {
                        @for (name, bytes) in &made.files { (picture(name, bytes, made.title)) }
                        figcaption { @for sentence in &made.caption { (sentence) " " } }
                    }
                }
            }
        }
    }
}

fn picture(name: &str, bytes: &[u8], title: &str) -> Markup {
    if name.ends_with(".svg") {
        return html! { (PreEscaped(String::from_utf8_lossy(bytes))) };
    }
    let data = format!("data:image/png;base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes));
    html! { img alt=(title) src=(data); }
}
