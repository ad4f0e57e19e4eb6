//! `oviduct fit`: searches for parameters whose models have given measures.

use super::measure;
use crate::cli::args::{FitArgs, SpecArgs};
use crate::cli::exit::{Ended, Failure};
use crate::cli::interrupt::Signals;
use crate::cli::scratch::Scratch;
use crate::cli::{model, term};
use crate::clock::Stopwatch;
use crate::fit::{
    FitError, FitProgress, FitResult, FitSink, FitSpec, FitStage, IMAGE_TOLERANCE, SectionImage, Target, Why, fit,
    image_targets,
};
use crate::generate::CancelToken;
use crate::lock::Mutex;
use crate::measure::micrograph::Reading;
use anyhow::Context;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Time between two checkpoints.
const CHECKPOINT_EVERY: Duration = Duration::from_secs(10);
/// Maximum size of a file of targets, bytes.
const MOST_BYTES: u64 = 1 << 20;

pub(in crate::cli) async fn run(args: FitArgs) -> Ended {
    let spec = request(&args)?;
    let before = args.checkpoint.as_deref().map(read_checkpoint).transpose()?.flatten();
    let mut signals = Signals::listen();
    let scratch = Scratch::new(&std::env::temp_dir()).context("a directory for models")?;
    let (cancel, bar) = (CancelToken::default(), term::Bar::on_stderr());
    let task = tokio::task::spawn_blocking({
        let (cancel, dir) = (cancel.clone(), scratch.dir().to_owned());
        let sink = Shown { bar: bar.clone(), checkpoint: args.checkpoint.clone(), written: Mutex::default() };
        move || fit(&spec, before.as_deref(), &dir, args.memory_limit, &sink, &cancel)
    });
    let result = match signals.stoppable(task, &cancel, &bar).await?.context("the fit panicked")? {
        Ok(result) => result,
        Err(FitError::Cancelled) => return Err(Failure::Interrupted),
        Err(error) => return Err(anyhow::Error::from(error).into()),
    };
    if let Some(path) = &args.out {
        let text = serde_json::to_string_pretty(&result.spec).context("the spec")? + "\n";
        std::fs::write(path, text).with_context(|| format!("--out {}", path.display()))?;
    }
    if args.json {
        term::print_json(&result)?;
    } else {
        term::print(text(&result).trim_end())?;
        if let Some(path) = &args.out {
            term::print(&format!("\n{}", path.display()))?;
        }
    }
    Ok(())
}

/// Returns the request that the options describe. Faults name the option.
fn request(args: &FitArgs) -> Result<FitSpec, Failure> {
    let (preset, spec, set) = (args.preset.clone(), args.spec.clone(), args.set.clone());
    let spec = model::patch(&SpecArgs { preset, seed: None, spec, set })?;
    let mut targets = Vec::new();
    let mut csv = None;
    if let Some(path) = &args.targets {
        let text = read_targets(path)?;
        if text.trim_start().starts_with(['[', '{']) {
            let given: Value = serde_json::from_str(&text)
                .map_err(|error| Failure::usage(format!("--targets {}: {error}", path.display())))?;
            match given {
                Value::Array(list) => targets.extend(list),
                _ => return Err(Failure::usage(format!("--targets {}: must be a JSON array", path.display()))),
            }
        } else {
            csv = Some(text);
        }
    }
    let from_file = targets.len();
    for text in &args.target {
        targets.push(target(text).map_err(|detail| Failure::usage(format!("--target {text}: {detail}")))?);
    }
    let mut body = json!({
        "preset": args.preset, "spec": spec, "targets": targets, "evaluations": args.evaluations,
        "seeds": args.seeds, "models": args.models, "seed": args.seed,
    });
    if let Some(csv) = csv {
        body["targets_csv"] = csv.into();
    }
    if !args.vary.is_empty() {
        let vary = |text: &String| vary(text).map_err(|detail| Failure::usage(format!("--vary {text}: {detail}")));
        body["vary"] = args.vary.iter().map(vary).collect::<Result<Vec<Value>, Failure>>()?.into();
    }
    FitSpec::read(&body, images(args)?, &[]).map_err(|faults| {
        let line = |fault: &crate::spec::Fault| {
            let detail = &fault.detail;
            let mut parts = fault.pointer.split('/').skip(1);
            match (parts.next(), parts.next().and_then(|n| n.parse::<usize>().ok())) {
                (Some("targets"), Some(n)) if n >= from_file => {
                    format!("--target {}: {detail}", args.target.get(n - from_file).map_or("", String::as_str))
                }
                (Some("targets" | "targets_csv"), n) => {
                    let row = n.map_or_else(String::new, |n| format!("target {}: ", n + 1));
                    format!("--targets: {row}{detail}")
                }
                (Some("vary"), Some(n)) => {
                    format!("--vary {}: {detail}", args.vary.get(n).map_or("", String::as_str))
                }
                (Some("spec"), _) => format!("{}: {detail}", fault.pointer),
                (Some(name), _) => format!("--{name}: {detail}"),
                (None, _) => detail.clone(),
            }
        };
        Failure::Usage(faults.iter().map(line).collect())
    })
}

/// Returns the targets from the images.
fn images(args: &FitArgs) -> Result<Vec<Target>, Failure> {
    let mut images = Vec::new();
    for text in &args.image {
        let failed = |detail: String| Failure::usage(format!("--image {text}: {detail}"));
        let (region, path) = text.split_once('=').ok_or_else(|| failed("must be written as REGION=FILE".into()))?;
        let file = measure::read(Path::new(path)).map_err(|error| failed(format!("{error:#}")))?;
        let pixel_um = args.pixel.or(args.pixel_um);
        let reading = Reading { pixel_um, tissue: args.tissue.clone(), threshold: args.threshold };
        images.push(SectionImage {
            region: region.into(),
            file,
            member: "image",
            reading,
            quantities: None,
            tolerance: IMAGE_TOLERANCE,
        });
    }
    image_targets(&images).map_err(|faults| {
        let line = |(i, member, detail): &(usize, &str, String)| match *member {
            "pixel_um" => format!("--pixel-um: {}: {detail}", args.image[*i]),
            "tissue" => format!("--tissue: {}: {detail}", args.image[*i]),
            _ => format!("--image {}: {detail}", args.image[*i]),
        };
        Failure::Usage(faults.iter().map(line).collect())
    })
}

fn read_targets(path: &Path) -> Result<String, Failure> {
    use std::io::Read;
    let shown = path.display();
    let failed = |error: std::io::Error| Failure::usage(format!("--targets {shown}: {error}"));
    let mut text = String::new();
    if path.as_os_str() == "-" {
        std::io::stdin().take(MOST_BYTES + 1).read_to_string(&mut text).map_err(failed)?;
    } else {
        std::fs::File::open(path)
            .and_then(|file| file.take(MOST_BYTES + 1).read_to_string(&mut text))
            .map_err(failed)?;
    }
    if text.len() as u64 > MOST_BYTES {
        return Err(Failure::usage(format!("--targets {shown}: is larger than {MOST_BYTES} bytes")));
    }
    Ok(text)
}

/// Parses a target such as `region/quantity=value` or `region/quantity=low..high`.
fn target(text: &str) -> Result<Value, String> {
    let form = "must be written as REGION/QUANTITY=VALUE or REGION/QUANTITY=LOW..HIGH";
    let (name, value) = text.split_once('=').ok_or(form)?;
    let (region, quantity) = name.split_once('/').ok_or(form)?;
    let mut target = json!({ "region": region.trim(), "quantity": quantity.trim() });
    match value.split_once("..") {
        None => target["value"] = number(value)?.into(),
        Some((low, high)) => {
            target["low"] = number(low)?.into();
            target["high"] = number(high)?.into();
        }
    }
    Ok(target)
}

/// Parses a variable such as `a.b`, `a.b@end` or `a.b@end=from..to`.
fn vary(text: &str) -> Result<Value, String> {
    let (place, bounds) = text.split_once('=').map_or((text, None), |(place, bounds)| (place, Some(bounds)));
    let (name, end) = place.split_once('@').map_or((place, None), |(name, end)| (name, Some(end)));
    let mut variable = json!({ "parameter": format!("/{}", name.trim().replace('.', "/")), "end": end.map(str::trim) });
    if let Some(bounds) = bounds {
        let (from, to) = bounds.split_once("..").ok_or("bounds must be written as FROM..TO")?;
        variable["from"] = number(from)?.into();
        variable["to"] = number(to)?.into();
    }
    Ok(variable)
}

fn number(text: &str) -> Result<f64, String> {
    text.trim().parse().ok().filter(|x: &f64| x.is_finite()).ok_or_else(|| format!("`{text}` is no number"))
}

/// Returns the bytes of an earlier checkpoint; `None` if there is no such file.
fn read_checkpoint(path: &Path) -> Result<Option<Vec<u8>>, Failure> {
    match std::fs::read(path) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(Failure::usage(format!("--checkpoint {}: {error}", path.display()))),
    }
}

/// Shows progress on stderr and writes checkpoints.
struct Shown {
    bar: term::Bar,
    /// File of checkpoints.
    checkpoint: Option<PathBuf>,
    /// Time since the last checkpoint.
    written: Mutex<Option<Stopwatch>>,
}

impl FitSink for Shown {
    fn progress(&self, progress: &FitProgress) {
        let misfit = progress.misfit.map(|misfit| format!(", misfit {misfit:.3}")).unwrap_or_default();
        let (stage, message) = match progress.stage {
            FitStage::Search => {
                ("search", format!("{} of {} candidates{misfit}", progress.evaluations, progress.evaluations_most))
            }
            FitStage::Verify => ("verify", format!("{} models{misfit}", progress.models)),
        };
        self.bar.show(stage, progress.fraction, message);
    }

    fn wants_checkpoint(&self) -> bool {
        self.checkpoint.is_some() && self.written.lock().is_none_or(|since| since.elapsed() >= CHECKPOINT_EVERY)
    }

    fn checkpoint(&self, bytes: Vec<u8>) {
        let Some(path) = &self.checkpoint else { return };
        // Replaced atomically, so that it is never half written.
        let part = path.with_added_extension("part");
        if let Err(error) = std::fs::write(&part, bytes).and_then(|()| std::fs::rename(&part, path)) {
            term::note(&format!("warning: --checkpoint {}: {error}", path.display()));
        }
        *self.written.lock() = Some(Stopwatch::start());
    }
}

/// Formats a number with four significant digits.
fn shown(value: f64) -> String {
    let digits = if value == 0.0 { 0 } else { (3 - value.abs().log10().floor() as i32).clamp(0, 6) };
    format!("{value:.*}", digits as usize)
}

fn optional(value: Option<f64>) -> String {
    value.map_or_else(|| "–".into(), shown)
}

/// Returns the output without `--json`.
fn text(result: &FitResult) -> String {
    let mut text = String::new();
    let search = &result.search;
    let ended = serde_json::to_value(search.ended).ok().and_then(|v| v.as_str().map(|s| s.replace('_', " ")));
    let _ = writeln!(
        text,
        "{}: misfit {} (at the start {}) after {} candidates: {}",
        result.preset,
        shown(search.misfit),
        optional(search.start_misfit),
        search.evaluations,
        ended.unwrap_or_default(),
    );
    let certified = result.models.iter().filter(|model| model.certified).count();
    let _ = writeln!(text, "{certified} of {} models grown in full passed their certificates\n", result.models.len());
    let _ = writeln!(text, "{:<44} {:>10} {:>20} {:>10} {:>20}", "target", "value", "range", "fitted", "models");
    for target in &result.targets {
        let of = &target.target;
        let models = match (target.models_mean, target.models_sd) {
            (Some(mean), Some(sd)) => format!("{} ± {}", shown(mean), shown(sd)),
            (mean, _) => optional(mean),
        };
        let mark = if target.met { "" } else { "  not met" };
        let range = format!("{} to {}", shown(of.low), shown(of.high));
        let _ = writeln!(
            text,
            "{:<44} {:>10} {range:>20} {:>10} {models:>20}{mark}",
            of.name(),
            shown(of.value),
            optional(target.measured),
        );
    }
    let _ = writeln!(text, "\n{:<44} {:>10} {:>20} {:>10}", "parameter", "start", "bounds", "value");
    for fitted in &result.parameters {
        let end = fitted.end.map(end).unwrap_or_default();
        let range = format!("{} to {}", shown(fitted.from), shown(fitted.to));
        let _ = writeln!(
            text,
            "{:<44} {:>10} {range:>20} {:>10} {}",
            format!("{}{end}", fitted.parameter),
            shown(fitted.start),
            shown(fitted.value),
            fitted.unit,
        );
    }
    for unmet in &result.unmet {
        let name = format!("{}/{}", unmet.region, unmet.quantity);
        let nearest = optional(unmet.nearest);
        let _ = match unmet.why {
            Why::OutOfReach => writeln!(text, "\n{name} is out of reach; the nearest value was {nearest}"),
            Why::Insensitive => writeln!(text, "\n{name} does not depend on the parameters; it was {nearest} at best"),
            Why::Conflict => writeln!(text, "\n{name} cannot be met together with {}", unmet.conflicts.join(", ")),
        };
        for bound in &unmet.bounds {
            let end = bound.end.map(end).unwrap_or_default();
            let _ = writeln!(text, "  bound: {}{end}, {} {}", bound.parameter, bound.bound, shown(bound.value));
        }
    }
    text
}

fn end(end: crate::spec::End) -> String {
    let name = serde_json::to_value(end).ok().and_then(|v| v.as_str().map(str::to_owned));
    format!(" ({})", name.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_and_variables_are_read() {
        assert_eq!(
            target("ampulla/folds_on_ring=28.9..37.9").unwrap(),
            json!({ "region": "ampulla", "quantity": "folds_on_ring", "low": 28.9, "high": 37.9 })
        );
        assert_eq!(target("tube/length_mm=60").unwrap()["value"], 60.0);
        for wrong in ["folds=3", "ampulla/fill", "ampulla/fill=x", "ampulla/fill=1..", "ampulla/fill=inf"] {
            assert!(target(wrong).is_err(), "{wrong}");
        }
        assert_eq!(
            vary("collision.gap_um@ampulla=20..60").unwrap(),
            json!({ "parameter": "/collision/gap_um", "end": "ampulla", "from": 20.0, "to": 60.0 })
        );
        assert_eq!(vary("length_mm").unwrap(), json!({ "parameter": "/length_mm", "end": null }));
        for wrong in ["a=3", "a=3..x"] {
            assert!(vary(wrong).is_err(), "{wrong}");
        }
    }
}
