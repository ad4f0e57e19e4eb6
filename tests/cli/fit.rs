//! `oviduct fit`: from targets to a spec, and invalid requests.

use super::{TINY, code, folder, json, run, said};
use serde_json::Value;

/// A fit of a tiny model with few candidates.
fn quick() -> Vec<&'static str> {
    [&["fit", "--evaluations", "12", "--seeds", "1", "--models", "1"][..], &TINY[..]].concat()
}

#[test]
fn a_fit_gives_a_spec_that_can_be_generated() {
    let at = folder();
    std::fs::write(at.path().join("targets.csv"), "region,quantity,value,low,high\nampulla,lumen_gap_p50_um,40,,\n")
        .expect("written");
    let more = ["--targets", "targets.csv", "--target", "whole/tissue_area_mm2=0.5..9"];
    let files = ["--out", "fitted.json", "--checkpoint", "candidates.json"];
    let vary = ["--vary", "collision.gap_um@ampulla=20..60", "--vary", "containment.wall_um"];
    let args = [&quick()[..], &more, &files, &vary].concat();
    let result = json(&run(at.path(), &[&args[..], &["--json"]].concat()));
    assert_eq!(result["targets"].as_array().map(Vec::len), Some(2), "{result}");
    let parameters = result["parameters"].as_array().expect("a list");
    assert_eq!((&parameters[0]["parameter"], &parameters[0]["end"]), (&"/collision/gap_um".into(), &"ampulla".into()));
    let [from, to, value] = ["from", "to", "value"].map(|name| parameters[0][name].as_f64().expect("a number"));
    assert!(from == 20.0 && to == 60.0 && (from..=to).contains(&value), "{value}");
    assert_eq!(result["models"][0]["certified"], true, "{result}");
    let spec: Value =
        serde_json::from_slice(&std::fs::read(at.path().join("fitted.json")).expect("a spec")).expect("JSON");
    assert_eq!(spec, result["spec"]);
    let generated = run(
        at.path(),
        &["generate", "--spec", "fitted.json", "--seed", "1", "--gpu", "off", "--out", "model", "--json"],
    );
    json(&generated);
    // The second call resumes from the checkpoint and prints the same result as a table.
    let table = run(at.path(), &args);
    assert_eq!(code(&table), 0, "{}", said(&table));
    let table = String::from_utf8_lossy(&table.stdout).into_owned();
    assert!(table.contains("1 of 1 models grown in full passed their certificates"), "{table}");
    assert!(table.contains("ampulla/lumen_gap_p50_um") && table.contains("/containment/wall_um"), "{table}");
    assert!(table.trim_end().ends_with("fitted.json"), "{table}");
}

#[test]
fn sections_in_images_are_targets() {
    let at = folder();
    json(&run(
        at.path(),
        &[&["generate", "--seed", "3", "--gpu", "off", "--json", "--out", "model"], &TINY[..]].concat(),
    ));
    let section =
        ["section", "model/sections.bin", "--index", "4", "--labels", "--size", "1500", "--out", "labels.png"];
    let printed = String::from_utf8_lossy(&run(at.path(), &section).stdout).into_owned();
    let pixel_um = printed.split_whitespace().nth(1).expect("the size of a pixel");
    let image = ["--image", "isthmus=labels.png", "--pixel-um", pixel_um, "--tissue", "2,3,4,5,6,7,8,9", "--json"];
    let result = json(&run(at.path(), &[&quick()[..], &image].concat()));
    let targets = result["targets"].as_array().expect("a list");
    assert!(targets.len() >= 5 && targets.iter().all(|target| target["region"] == "isthmus"), "{result}");
    assert!(targets[0]["source"].as_str().is_some_and(|source| source.starts_with("SHA-256")), "{result}");
}

#[test]
fn wrong_options_are_refused_by_name() {
    let at = folder();
    std::fs::write(at.path().join("bad.csv"), "region,value\nampulla,1\n").expect("written");
    std::fs::write(at.path().join("bad.png"), "GIF89a").expect("written");
    for (options, hint) in [
        (&[][..], "at least one target"),
        (&["--target", "ampulla/fill"], "--target ampulla/fill: must be written as"),
        (&["--target", "ampulla/fil=1"], "--target ampulla/fil=1: `fil` is unknown"),
        (&["--target", "ampulla/fill=0.7", "--vary", "collision.gap_mm"], "--vary collision.gap_mm: is no parameter"),
        (&["--target", "ampulla/fill=0.7", "--vary", "friction=1"], "--vary friction=1: bounds must be"),
        (&["--target", "ampulla/fill=0.7", "--preset", "dog"], "--preset: is unknown"),
        (&["--target", "ampulla/fill=0.7", "--seeds", "99"], "--seeds: must be an integer from 1 to 16"),
        (&["--target", "ampulla/fill=0.7", "--set", "steps=0"], "/spec/steps: is 0"),
        (&["--targets", "none.csv"], "--targets none.csv"),
        (&["--targets", "bad.csv"], "--targets: column `quantity` is missing"),
        (&["--image", "isthmus=bad.png", "--pixel-um", "2"], "--image isthmus=bad.png: the file is a GIF"),
        (&["--image", "bad.png", "--pixel-um", "2"], "must be written as REGION=FILE"),
        (&["--image", "isthmus=none.png", "--pixel-um", "2"], "--image isthmus=none.png"),
    ] {
        let output = run(at.path(), &[&["fit"][..], options].concat());
        assert_eq!(code(&output), 2, "{options:?}: {}", said(&output));
        assert!(said(&output).contains(hint), "{options:?}: {}", said(&output));
    }
}
