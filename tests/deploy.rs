//! The files of `deploy/`: that they are YAML, that what they refer to is there, that every option they use exists.
#![allow(clippy::unwrap_used, reason = "a test fails by it")]

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy")
}

/// All documents of a file, with merge keys (`<<`) applied.
fn documents(path: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut documents: Vec<Value> = text
        .split("\n---\n")
        .map(|part| yaml_serde::from_str(part).unwrap_or_else(|error| panic!("{}: {error}", path.display())))
        .collect();
    documents.iter_mut().for_each(merge);
    documents
}

fn merge(value: &mut Value) {
    match value {
        Value::Object(members) => {
            members.values_mut().for_each(merge);
            if let Some(Value::Object(base)) = members.remove("<<") {
                for (name, value) in base {
                    members.entry(name).or_insert(value);
                }
            }
        }
        Value::Array(items) => items.iter_mut().for_each(merge),
        _ => {}
    }
}

fn kubernetes() -> Vec<Value> {
    let kustomization = documents(&root().join("kubernetes/kustomization.yaml")).remove(0);
    let named = kustomization["resources"].as_array().unwrap();
    let files = std::fs::read_dir(root().join("kubernetes")).unwrap().count();
    assert_eq!(files, named.len() + 1, "every file is named by the kustomization");
    named.iter().flat_map(|file| documents(&root().join("kubernetes").join(file.as_str().unwrap()))).collect()
}

/// The options of a command.
fn options(command: &str) -> BTreeSet<String> {
    let output = Command::new(env!("CARGO_BIN_EXE_oviduct")).args([command, "--help"]).output().unwrap();
    assert!(output.status.success(), "there is no command {command}");
    let help = String::from_utf8(output.stdout).unwrap();
    let words = help.split(|c: char| !(c.is_ascii_alphanumeric() || c == '-'));
    words.filter(|word| word.starts_with("--")).map(str::to_owned).collect()
}

/// Checks a command line and variables of our program; gives the command.
fn check_call(place: &str, args: &[String], variables: impl Iterator<Item = String>) -> String {
    let command = args.first().unwrap_or_else(|| panic!("{place} names no command")).clone();
    let known = options(&command);
    for flag in args.iter().filter(|arg| arg.starts_with("--")) {
        assert!(known.contains(flag), "{place}: {command} has no {flag}");
    }
    for name in variables {
        if let Some(option) = name.strip_prefix("OVIDUCT_") {
            let flag = format!("--{}", option.to_ascii_lowercase().replace('_', "-"));
            assert!(known.contains(&flag), "{place}: {command} has no {flag}");
        }
    }
    let whole = Command::new(env!("CARGO_BIN_EXE_oviduct")).args(args).arg("--help").output().unwrap();
    assert!(whole.status.success(), "{place}: {}", String::from_utf8_lossy(&whole.stderr));
    command
}

fn strings(value: &Value) -> Vec<String> {
    value.as_array().unwrap().iter().map(|v| v.as_str().unwrap().to_owned()).collect()
}

#[test]
fn compose_is_sound() {
    let compose = documents(&root().join("compose.yaml")).remove(0);
    let services = compose["services"].as_object().unwrap();
    let volumes = compose["volumes"].as_object().unwrap();
    let mut commands = Vec::new();
    for (name, service) in services {
        let needs = service["depends_on"].as_object().into_iter().flat_map(|needs| needs.keys());
        for need in needs {
            assert!(services.contains_key(need), "{name} depends on {need}");
        }
        for volume in service["volumes"].as_array().into_iter().flatten() {
            let volume = volume.as_str().unwrap().split(':').next().unwrap();
            assert!(volumes.contains_key(volume), "{name} mounts {volume}");
        }
        let image = service["image"].as_str().unwrap();
        assert!(image.contains(':'), "{name}: {image} has no version");
        if image.starts_with("oviduct:") {
            let variables = service["environment"].as_object().unwrap().keys().cloned();
            commands.push(check_call(name, &strings(&service["command"]), variables));
        } else {
            assert!(!image.ends_with(":latest"), "{name}: {image}");
        }
        for port in service["ports"].as_array().into_iter().flatten() {
            assert!(port.as_str().unwrap().starts_with("127.0.0.1:"), "{name} is open to the world");
        }
    }
    assert_eq!(commands, ["serve", "worker"]);
    assert!(services.contains_key("postgres") && services.contains_key("s3"));
}

#[test]
fn the_manifests_are_sound() {
    let documents = kubernetes();
    let name = |d: &Value| d["metadata"]["name"].as_str().unwrap().to_owned();
    let of = |kind: &str| -> Vec<&Value> { documents.iter().filter(|d| d["kind"] == kind).collect() };
    let config: BTreeMap<String, BTreeSet<String>> = [("ConfigMap", "data"), ("Secret", "stringData")]
        .into_iter()
        .flat_map(|(kind, data)| of(kind).into_iter().map(move |d| (kind, data, d)))
        .map(|(kind, data, d)| (format!("{kind} {}", name(d)), d[data].as_object().unwrap().keys().cloned().collect()))
        .collect();
    let mut commands = Vec::new();
    let deployments = of("Deployment");
    for deployment in &deployments {
        let spec = &deployment["spec"];
        assert_eq!(spec["selector"]["matchLabels"], spec["template"]["metadata"]["labels"], "{}", name(deployment));
        let pod = &spec["template"]["spec"];
        let volumes: BTreeSet<_> = pod["volumes"].as_array().unwrap().iter().map(|v| v["name"].as_str()).collect();
        for container in pod["containers"].as_array().unwrap() {
            let mut variables = BTreeSet::new();
            for source in container["envFrom"].as_array().unwrap() {
                for (member, kind) in [("configMapRef", "ConfigMap"), ("secretRef", "Secret")] {
                    if let Some(target) = source[member]["name"].as_str() {
                        variables.extend(config[&format!("{kind} {target}")].iter().cloned());
                    }
                }
            }
            let args = strings(&container["args"]);
            commands.push(check_call(&name(deployment), &args, variables.into_iter()));
            for mount in container["volumeMounts"].as_array().unwrap() {
                assert!(volumes.contains(&mount["name"].as_str()), "{}", name(deployment));
            }
            let ports: BTreeSet<_> =
                container["ports"].as_array().into_iter().flatten().map(|p| p["name"].as_str()).collect();
            for probe in ["startupProbe", "livenessProbe", "readinessProbe"] {
                if let Some(get) = container[probe]["httpGet"].as_object() {
                    assert!(ports.contains(&get["port"].as_str()), "{}: {probe}", name(deployment));
                    assert!(["/healthz", "/readyz"].contains(&get["path"].as_str().unwrap()));
                }
            }
            let seconds = |text: &str| text.trim_end_matches('s').parse::<u64>().unwrap();
            let grace = args.iter().position(|a| a == "--grace").map_or(30, |at| seconds(&args[at + 1]));
            let kill = pod["terminationGracePeriodSeconds"].as_u64().unwrap();
            assert!(kill >= grace + 20, "{}: killed {kill} s after SIGTERM, --grace {grace}", name(deployment));
        }
    }
    assert_eq!(commands, ["serve", "worker", "worker"]);
    let names: BTreeSet<String> = deployments.iter().map(|d| name(d)).collect();
    let budgets = of("PodDisruptionBudget");
    for selector in budgets
        .iter()
        .map(|d| &d["spec"]["selector"]["matchLabels"])
        .chain(of("Service").iter().map(|d| &d["spec"]["selector"]))
    {
        let found = deployments.iter().any(|d| d["spec"]["selector"]["matchLabels"] == *selector);
        assert!(found, "{selector} selects nothing");
    }
    assert_eq!(budgets.len(), deployments.len());
    for scaled in of("ScaledObject") {
        assert!(names.contains(scaled["spec"]["scaleTargetRef"]["name"].as_str().unwrap()));
        let query = scaled["spec"]["triggers"][0]["metadata"]["query"].as_str().unwrap();
        assert!(query.contains("oviduct_jobs{status=\"queued\"}"), "{query}");
    }
    assert!(documents.iter().all(|d| d["kind"] == "Namespace" || d["metadata"]["namespace"] == "oviduct"));
}

#[test]
fn the_guide_names_every_option() {
    let guide = std::fs::read_to_string(root().join("../docs/operations.md")).unwrap();
    for command in ["serve", "worker"] {
        for option in options(command).iter().filter(|o| !["--help", "--version", "--"].contains(&o.as_str())) {
            assert!(guide.contains(&format!("`{option}")), "docs/operations.md does not name {option} of {command}");
        }
    }
}
