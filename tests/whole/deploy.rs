//! The files in `deploy/`: they parse, their references and options exist, and their numbers are
//! consistent.
#![allow(clippy::unwrap_used, reason = "a test fails by it")]

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy")
}

/// All YAML documents in a file, with merge keys (`<<`) applied.
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
    assert_eq!(files, named.len() + 1, "the kustomization must name every file");
    named.iter().flat_map(|file| documents(&root().join("kubernetes").join(file.as_str().unwrap()))).collect()
}

/// The options of a command, from its help.
fn options(command: &str) -> BTreeSet<String> {
    let output = Command::new(env!("CARGO_BIN_EXE_oviduct")).args([command, "--help"]).output().unwrap();
    assert!(output.status.success(), "there is no command {command}");
    let help = String::from_utf8(output.stdout).unwrap();
    let words = help.split(|c: char| !(c.is_ascii_alphanumeric() || c == '-'));
    words.filter(|word| word.starts_with("--")).map(str::to_owned).collect()
}

/// Checks a command line and environment variables of `oviduct`; returns the command.
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
fn compose_references_exist() {
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
            assert!(port.as_str().unwrap().starts_with("127.0.0.1:"), "{name} listens on all addresses");
        }
    }
    assert_eq!(commands, ["serve", "worker"]);
    assert!(services.contains_key("postgres") && services.contains_key("s3"));
}

/// Value of an option in a command line.
fn option<'a>(args: &'a [String], name: &str) -> Option<&'a str> {
    args.iter().position(|arg| arg == name).map(|at| args[at + 1].as_str())
}

/// A duration in seconds, in the format of the manifests.
fn seconds(text: &str) -> u64 {
    text.strip_suffix('s').unwrap_or_else(|| panic!("{text} is not in seconds")).parse().unwrap()
}

/// The objects in `deploy/kubernetes`.
struct Manifests(Vec<Value>);

impl Manifests {
    fn of(&self, kind: &str) -> Vec<&Value> {
        self.0.iter().filter(|d| d["kind"] == kind).collect()
    }

    /// Each deployment with its only container and the container's arguments.
    fn containers(&self) -> Vec<(&Value, &Value, Vec<String>)> {
        let only = |d: &'_ Value| -> usize { d["spec"]["template"]["spec"]["containers"].as_array().unwrap().len() };
        self.of("Deployment")
            .into_iter()
            .map(|deployment| {
                assert_eq!(only(deployment), 1, "{}", name(deployment));
                let container = &deployment["spec"]["template"]["spec"]["containers"][0];
                (deployment, container, strings(&container["args"]))
            })
            .collect()
    }
}

fn name(document: &Value) -> String {
    document["metadata"]["name"].as_str().unwrap().to_owned()
}

#[test]
fn manifest_references_exist() {
    let manifests = Manifests(kubernetes());
    let config: BTreeMap<String, BTreeSet<String>> = [("ConfigMap", "data"), ("Secret", "stringData")]
        .into_iter()
        .flat_map(|(kind, data)| manifests.of(kind).into_iter().map(move |d| (kind, data, d)))
        .map(|(kind, data, d)| (format!("{kind} {}", name(d)), d[data].as_object().unwrap().keys().cloned().collect()))
        .collect();
    let mut commands = Vec::new();
    for (deployment, container, args) in manifests.containers() {
        let spec = &deployment["spec"];
        assert_eq!(spec["selector"]["matchLabels"], spec["template"]["metadata"]["labels"], "{}", name(deployment));
        let mut variables = BTreeSet::new();
        for source in container["envFrom"].as_array().unwrap() {
            for (member, kind) in [("configMapRef", "ConfigMap"), ("secretRef", "Secret")] {
                if let Some(target) = source[member]["name"].as_str() {
                    variables.extend(config[&format!("{kind} {target}")].iter().cloned());
                }
            }
        }
        commands.push(check_call(&name(deployment), &args, variables.into_iter()));
        let volumes = spec["template"]["spec"]["volumes"].as_array().unwrap();
        for mount in container["volumeMounts"].as_array().unwrap() {
            assert!(volumes.iter().any(|volume| volume["name"] == mount["name"]), "{}", name(deployment));
        }
        let ports = container["ports"].as_array().unwrap();
        for probe in ["startupProbe", "livenessProbe", "readinessProbe"] {
            if let Some(get) = container[probe]["httpGet"].as_object() {
                assert!(ports.iter().any(|port| port["name"] == get["port"]), "{}: {probe}", name(deployment));
                assert!(["/healthz", "/readyz"].contains(&get["path"].as_str().unwrap()));
            }
        }
        let scraped = &spec["template"]["metadata"]["annotations"]["prometheus.io/port"];
        let scraped: u64 = scraped.as_str().unwrap().parse().unwrap();
        assert!(ports.iter().any(|port| port["containerPort"] == scraped), "{}", name(deployment));
    }
    assert_eq!(commands, ["serve", "worker", "worker"]);
    let deployments = manifests.of("Deployment");
    let budgets = manifests.of("PodDisruptionBudget");
    for selector in budgets
        .iter()
        .map(|d| &d["spec"]["selector"]["matchLabels"])
        .chain(manifests.of("Service").iter().map(|d| &d["spec"]["selector"]))
    {
        let found = deployments.iter().any(|d| d["spec"]["selector"]["matchLabels"] == *selector);
        assert!(found, "{selector} selects nothing");
    }
    assert_eq!(budgets.len(), deployments.len());
    assert!(manifests.0.iter().all(|d| d["kind"] == "Namespace" || d["metadata"]["namespace"] == "oviduct"));
}

/// The time until SIGKILL covers the whole shutdown, and readiness fails while connections are
/// still accepted.
#[test]
fn pods_have_the_time_to_shut_down() {
    for (deployment, container, args) in Manifests(kubernetes()).containers() {
        let place = name(deployment);
        let pre_stop = container["lifecycle"]["preStop"]["sleep"]["seconds"].as_u64().unwrap_or_default();
        let drain = option(&args, "--drain-delay").map_or(0, seconds);
        let grace = option(&args, "--grace").map_or(30, seconds);
        let kill = deployment["spec"]["template"]["spec"]["terminationGracePeriodSeconds"].as_u64().unwrap();
        assert!(kill >= pre_stop + drain + grace + 20, "{place}: SIGKILL after {kill} s");
        if args[0] == "serve" {
            let probe = &container["readinessProbe"];
            assert_eq!(probe["httpGet"]["path"], "/readyz", "{place}");
            let notices = probe["periodSeconds"].as_u64().unwrap() * probe["failureThreshold"].as_u64().unwrap_or(3);
            assert!(pre_stop > 0 && drain > 0 && notices <= drain, "{place}: readiness fails after {notices} s");
            // A download of a default model at 2 MB/s takes up to 60 s.
            assert!(grace >= 60, "{place}: --grace {grace}");
        }
    }
}

/// Each autoscaler counts the jobs that its kind of worker can run.
#[test]
fn workers_are_scaled_by_the_jobs_that_they_can_run() {
    let manifests = Manifests(kubernetes());
    let query = |deployment: &str| {
        let scaled = manifests.of("ScaledObject");
        let scaled = scaled.iter().find(|d| d["spec"]["scaleTargetRef"]["name"] == deployment).unwrap();
        scaled["spec"]["triggers"][0]["metadata"]["query"].as_str().unwrap().to_owned()
    };
    assert!(query("oviduct-worker-gpu").contains("oviduct_queued_jobs{backend=\"gpu\"}"));
    assert!(query("oviduct-worker-cpu").contains("oviduct_queued_jobs{backend=~\"auto|cpu|cpu-single\"}"));
    let names: BTreeSet<String> = manifests.of("Deployment").iter().map(|d| name(d)).collect();
    for scaled in manifests.of("ScaledObject") {
        assert!(names.contains(scaled["spec"]["scaleTargetRef"]["name"].as_str().unwrap()));
    }
    // Without a GPU worker, the API must queue the jobs that make the autoscaler start one.
    let from_zero = manifests.of("ScaledObject").iter().any(|d| d["spec"]["minReplicaCount"] == 0);
    let serve = manifests.containers().into_iter().map(|(_, _, args)| args).find(|args| args[0] == "serve").unwrap();
    assert!(from_zero && serve.iter().any(|arg| arg == "--expect-gpu-workers"));
}

/// More threads than CPUs of the pod would only compete for them.
#[test]
fn cpu_threads_equal_the_cpus_that_a_pod_requests() {
    let manifests = Manifests(kubernetes());
    let workers: Vec<_> = manifests.containers().into_iter().filter(|(_, _, args)| args[0] == "worker").collect();
    assert_eq!(workers.len(), 2);
    for (deployment, container, args) in workers {
        let cpus: u32 = container["resources"]["requests"]["cpu"].as_str().unwrap().parse().unwrap();
        let number =
            |name| option(&args, name).map_or_else(|| panic!("no {name}"), |text| text.parse::<u32>().unwrap());
        assert_eq!(number("--cpu-workers") * number("--cpu-threads"), cpus, "{}", name(deployment));
    }
}

/// Connections for clients with PostgreSQL's default `max_connections`, minus
/// `superuser_reserved_connections`.
const POSTGRES_CONNECTIONS: u64 = 100 - 3;

#[test]
fn all_replicas_together_fit_into_the_connections_of_postgresql() {
    let manifests = Manifests(kubernetes());
    let scaled = manifests.of("ScaledObject");
    let mut sum = 0;
    for (deployment, _, args) in manifests.containers() {
        let pool: u64 =
            option(&args, "--database-connections").unwrap_or_else(|| panic!("{}", name(deployment))).parse().unwrap();
        let scaler = scaled.iter().find(|d| d["spec"]["scaleTargetRef"]["name"] == deployment["metadata"]["name"]);
        let replicas = match scaler {
            Some(scaler) => scaler["spec"]["maxReplicaCount"].as_u64().unwrap(),
            None => deployment["spec"]["replicas"].as_u64().unwrap(),
        };
        let surge = deployment["spec"]["strategy"]["rollingUpdate"]["maxSurge"].as_u64().unwrap();
        // Each process uses one more connection, for notifications.
        sum += (replicas + surge) * (pool + 1);
    }
    assert!(sum <= POSTGRES_CONNECTIONS, "{sum} connections of {POSTGRES_CONNECTIONS}");
    let config = std::fs::read_to_string(root().join("kubernetes/config.yaml")).unwrap();
    assert!(config.contains(&format!("up to {sum} connections")), "config.yaml must name {sum} connections");
}

/// Settings of a systemd unit. A setting that occurs several times keeps all its values.
fn unit(path: &str) -> BTreeMap<String, Vec<String>> {
    let mut settings: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for line in std::fs::read_to_string(root().join(path)).unwrap().lines() {
        if line.is_empty() || line.starts_with(['#', '[']) {
            continue;
        }
        let (name, value) = line.split_once('=').unwrap_or_else(|| panic!("{path}: {line}"));
        settings.entry(name.to_owned()).or_default().push(value.to_owned());
    }
    settings
}

#[test]
fn the_systemd_unit_suits_its_options() {
    let unit = unit("systemd/oviduct.service");
    let only = |name: &str| match unit[name].as_slice() {
        [value] => value.clone(),
        values => panic!("{name}: {values:?}"),
    };
    let line: Vec<String> = only("ExecStart").split(' ').skip(1).map(str::to_owned).collect();
    assert_eq!(check_call("oviduct.service", &line, std::iter::empty()), "serve");
    // Without TLS and API keys, the service listens on the loopback interface.
    for address in ["--addr", "--metrics-addr"] {
        assert!(option(&line, address).unwrap().starts_with("127.0.0.1:"), "{address}");
    }
    assert_eq!(option(&line, "--data").unwrap(), format!("/var/lib/{}", only("StateDirectory")));
    let drain = option(&line, "--drain-delay").map_or(0, seconds);
    let stop: u64 = only("TimeoutStopSec").parse().unwrap();
    assert!(stop >= drain + seconds(option(&line, "--grace").unwrap()) + 20, "SIGKILL after {stop} s");
    // Exit code 2 means invalid usage, which a restart cannot fix. systemd gives up after several
    // restarts.
    assert_eq!((only("Restart").as_str(), only("NoNewPrivileges").as_str()), ("on-failure", "yes"));
    assert_eq!((only("ProtectSystem").as_str(), only("DynamicUser").as_str()), ("strict", "yes"));
    assert!(only("EnvironmentFile").starts_with('-'), "the file is optional");
    assert!(only("LimitNOFILE").parse::<u32>().unwrap() >= 65_536);
}

/// Runs systemd's own check, if it is installed: names of settings, values, and exposure of the
/// service.
#[test]
fn systemd_accepts_its_unit() {
    let path = tempfile::tempdir().unwrap();
    let file = path.path().join("oviduct.service");
    let text = std::fs::read_to_string(root().join("systemd/oviduct.service")).unwrap();
    let drop_in = std::fs::read_to_string(root().join("systemd/oviduct.service.d/gpu.conf")).unwrap();
    let program = text.replace("/usr/local/bin/oviduct", env!("CARGO_BIN_EXE_oviduct"));
    let analyze = |arguments: &[&str]| Command::new("systemd-analyze").args(arguments).arg(&file).output();
    for (variant, exposure) in [(program.clone(), "20"), (format!("{program}\n{drop_in}"), "30")] {
        std::fs::write(&file, variant).unwrap();
        let Ok(verified) = analyze(&["verify"]) else {
            eprintln!("systemd-analyze is not installed");
            return;
        };
        let said = String::from_utf8_lossy(&verified.stderr).into_owned();
        assert!(verified.status.success() && said.is_empty(), "{said}");
        let exposed = analyze(&["security", "--offline=true", &format!("--threshold={exposure}")]).unwrap();
        assert!(exposed.status.success(), "{}", String::from_utf8_lossy(&exposed.stdout));
    }
}

/// The address, body size and timeouts of both proxies suit the defaults of the service.
/// `tests/outside/proxy.py` runs nginx.
#[test]
fn proxies_leave_limits_to_the_service() {
    let read = |path: &str| std::fs::read_to_string(root().join(path)).unwrap();
    let (caddy, nginx) = (read("caddy/Caddyfile"), read("nginx/oviduct.conf"));
    let unit = unit("systemd/oviduct.service").remove("ExecStart").unwrap().remove(0);
    let address = option(&unit.split(' ').map(str::to_owned).collect::<Vec<_>>(), "--addr").unwrap().to_owned();
    for (text, proxy) in [(&caddy, format!("reverse_proxy {address}")), (&nginx, format!("server {address};"))] {
        assert!(text.contains(&proxy), "{proxy}");
    }
    // Images of `POST /fits` may have 8 MiB (`Limits::large_body_bytes`); responses are held for up
    // to 60 s.
    for setting in ["client_max_body_size 9m;", "proxy_read_timeout 90s;", "proxy_buffering off;", "gzip off;"] {
        assert!(nginx.contains(setting), "{setting}");
    }
    let sites = caddy.matches("reverse_proxy").count();
    for setting in ["max_size 9MB", "flush_interval -1", "response_header_timeout 90s", "respond /metrics 404"] {
        assert_eq!(caddy.matches(setting).count(), sites, "{setting}");
    }
    assert!(!caddy.contains("\tencode"), "event streams must not be compressed");
}

/// Paths that `.dockerignore` admits: the entries after the `*` that excludes everything.
fn let_through() -> Vec<PathBuf> {
    let text = std::fs::read_to_string(root().join("../.dockerignore")).unwrap();
    let mut lines = text.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    assert_eq!(lines.next(), Some("*"));
    let path = |line: &str| {
        let path = line.strip_prefix('!').unwrap_or_else(|| panic!(".dockerignore: {line} is no exception"));
        assert!(!path.contains(['*', '?', '[']), ".dockerignore: {line} is a pattern");
        PathBuf::from(path)
    };
    lines.map(path).collect()
}

/// Sources of the program, without those of tests, as paths from the package's folder.
fn sources(dir: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
        if path.is_dir() && !["tests", "benches", "target"].contains(&name.as_str()) {
            sources(&path, found);
        } else if path.extension().is_some_and(|ending| ending == "rs") && name != "tests" {
            found.push(path);
        }
    }
}

/// Resolves `..` in a path.
fn plain(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in path.components() {
        if part == Component::ParentDir {
            assert!(plain.pop(), "{}", path.display());
        } else {
            plain.push(part);
        }
    }
    plain
}

/// Files and folders that a source file includes. If a macro inserts a part of the path, only the
/// beginning is returned.
fn included(source: &Path) -> Vec<PathBuf> {
    let text = std::fs::read_to_string(source).unwrap();
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let literal = |after: &str| after.split('"').nth(1).unwrap_or_else(|| panic!("{}", source.display())).to_owned();
    let beside = ["include_str!(", "include_bytes!("]
        .into_iter()
        .flat_map(|mark| text.split(mark).skip(1))
        .map(literal)
        // Other included paths stay inside the source folders, whichever file calls the macro
        // around them.
        .filter(|path| path.starts_with(".."))
        .map(|path| plain(&source.parent().unwrap().join(path)));
    let folders = text.split("#[folder = ").skip(1).map(|after| plain(&package.join(literal(after))));
    beside.chain(folders).collect()
}

/// The image's build fails if `.dockerignore` hides a file that the program includes.
#[test]
fn docker_builds_from_all_that_the_program_includes() {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let manifest: toml::Table = std::fs::read_to_string(package.join("Cargo.toml")).unwrap().parse().unwrap();
    let mut needed = ["Cargo.toml", "Cargo.lock", ".cargo/config.toml"].map(|name| package.join(name)).to_vec();
    let benches = manifest.get("bench").and_then(toml::Value::as_array).into_iter().flatten();
    needed.extend(benches.map(|bench| package.join(format!("benches/{}.rs", bench["name"].as_str().unwrap()))));
    let members = std::fs::read_dir(package.join("crates")).into_iter().flatten();
    needed.extend(members.map(|member| member.unwrap().path().join("Cargo.toml")));

    let mut files = Vec::new();
    for folder in ["src", "crates"].map(|name| package.join(name)).into_iter().filter(|folder| folder.exists()) {
        sources(&folder, &mut files);
    }
    needed.extend(files.iter().flat_map(|file| included(file)));
    needed.extend(files);
    for known in ["src/main.rs", "presets/pig.json", "references/morphometry.csv", "shaders/shared", "web/dist"] {
        assert!(needed.contains(&package.join(known)), "{known} is not found");
    }
    let entries: Vec<PathBuf> = let_through().iter().map(|entry| package.join(entry)).collect();
    for path in &needed {
        assert!(path.exists(), "{} is missing", path.display());
        assert!(entries.iter().any(|entry| path.starts_with(entry)), ".dockerignore hides {}", path.display());
    }
    for entry in &entries {
        assert!(needed.iter().any(|path| path.starts_with(entry)), ".dockerignore: {} is not needed", entry.display());
    }
}

#[test]
fn the_guide_describes_every_option_as_its_help_does() {
    let guide = std::fs::read_to_string(root().join("../docs/operations.md")).unwrap();
    let rows: Vec<[&str; 3]> = guide
        .lines()
        .filter_map(|line| {
            let mut cells = line.strip_prefix("| `--")?.strip_suffix(" |")?.split(" | ");
            Some([cells.next()?.trim_end_matches('`'), cells.next()?, cells.next()?])
        })
        .collect();
    for command in ["serve", "worker"] {
        let output = Command::new(env!("CARGO_BIN_EXE_oviduct")).args([command, "--help"]).output().unwrap();
        let help = String::from_utf8(output.stdout).unwrap().split_whitespace().collect::<Vec<_>>().join(" ");
        let of_command: Vec<_> = rows.iter().filter(|[_, of, _]| of.split(", ").any(|name| name == command)).collect();
        let mut known = options(command);
        known.retain(|option| !["--help", "--version", "--"].contains(&option.as_str()));
        for option in &known {
            let option = option.trim_start_matches('-');
            let row = of_command.iter().find(|[call, ..]| call.split(' ').next() == Some(option));
            let [call, _, meaning] = row.unwrap_or_else(|| panic!("docs/operations.md lacks --{option} of {command}"));
            // `--help` lays out values and defaults differently, so compare the text before them.
            let meaning = meaning.split(" [default").next().unwrap().split(": `").next().unwrap();
            assert!(help.contains(meaning), "docs/operations.md on --{call} of {command}: {meaning}");
        }
        assert_eq!(of_command.len(), known.len(), "docs/operations.md on {command}");
    }
}
