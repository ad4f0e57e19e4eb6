//! Sources of options, highest precedence first: command line, `OVIDUCT_…` variables, the file of
//! `--config`, defaults.
//!
//! Every long option gets a variable. Values of the file become defaults of the options, so that
//! one parser checks the values of all sources.

use super::args::Cli;
use super::exit::Failure;
use clap::builder::Resettable;
use clap::{Arg, ArgAction, CommandFactory, FromArgMatches};
use std::ffi::OsString;
use toml::{Table, Value};

/// A parsed command line.
#[derive(Debug)]
pub(super) enum Parsed {
    /// A command to run.
    Run(Box<Cli>),
    /// Help, the version, or an error, to be printed by clap.
    Say(clap::Error),
}

/// Parses the command line (without the name of the program).
///
/// # Errors
/// [`Failure::Usage`] if the file of `--config` cannot be read or has an unknown option.
pub(super) fn parse(args: impl IntoIterator<Item = OsString>) -> Result<Parsed, Failure> {
    let mut args: Vec<OsString> = args.into_iter().collect();
    let command = with_variables(Cli::command());
    let command = match config_path(&args) {
        None => command,
        Some(path) => {
            let shown = path.display();
            let text = std::fs::read_to_string(&path).map_err(|e| Failure::usage(format!("--config {shown}: {e}")))?;
            with_file(command, &text)
                .map_err(|faults| Failure::Usage(faults.iter().map(|f| format!("{shown}: {f}")).collect()))?
        }
    };
    let command = without_rivals(command, &args, |long| std::env::var_os(variable(long)).is_some());
    insert_default_command(&mut args);
    let argv = std::iter::once(OsString::from("oviduct")).chain(args);
    Ok(match command.try_get_matches_from(argv).and_then(|mut m| Cli::from_arg_matches_mut(&mut m)) {
        Ok(cli) => Parsed::Run(Box::new(cli)),
        Err(error) => Parsed::Say(error),
    })
}

/// Global options that take a value; `insert_default_command` skips them.
const GLOBAL: [&str; 4] = ["--config", "--log", "--log-format", "--otlp-endpoint"];

/// Returns the file of `--config`, which is needed before the options can be parsed.
fn config_path(args: &[OsString]) -> Option<std::path::PathBuf> {
    let mut args = args.iter().map_while(|a| (a != "--").then_some(a));
    while let Some(arg) = args.next() {
        if arg == "--config" {
            return args.next().map(Into::into);
        }
        if let Some(path) = arg.to_str().and_then(|a| a.strip_prefix("--config=")) {
            return Some(path.into());
        }
    }
    std::env::var_os("OVIDUCT_CONFIG").filter(|path| !path.is_empty()).map(Into::into)
}

/// Inserts `serve` if no command is given.
fn insert_default_command(args: &mut Vec<OsString>) {
    let mut at = 0;
    while let Some(arg) = args.get(at).and_then(|a| a.to_str()) {
        if GLOBAL.contains(&arg) {
            at += 2;
        } else if GLOBAL.iter().any(|g| arg.strip_prefix(g).is_some_and(|rest| rest.starts_with('='))) {
            at += 1;
        } else {
            break;
        }
    }
    match args.get(at).and_then(|a| a.to_str()) {
        None if at >= args.len() => args.push("serve".into()),
        Some("-h" | "--help" | "-V" | "--version") => {}
        Some(option) if option.starts_with('-') => args.insert(at, "serve".into()),
        _ => {}
    }
}

/// Returns the variable of an option.
fn variable(long: &str) -> String {
    format!("OVIDUCT_{}", long.replace('-', "_").to_ascii_uppercase())
}

/// Gives every option of every command its `OVIDUCT_…` variable.
#[must_use]
pub fn with_variables(command: clap::Command) -> clap::Command {
    let name = |arg: Arg| match arg.get_long().map(variable) {
        Some(name) => arg.env(name).hide_env_values(true),
        None => arg,
    };
    command.mut_args(name).mut_subcommands(|sub| sub.mut_args(name))
}

/// Makes the values of a configuration file the defaults of the options.
fn with_file(mut command: clap::Command, text: &str) -> Result<clap::Command, Vec<String>> {
    let table: Table = text.parse().map_err(|e: toml::de::Error| vec![e.to_string().trim_end().to_owned()])?;
    let mut faults = Vec::new();
    for (key, value) in table {
        let is_command = command.find_subcommand(&key).is_some();
        match value {
            Value::Table(options) if is_command => {
                for (option, value) in options {
                    let place = format!("{key}.{option}");
                    command = command.mut_subcommand(&key, |sub| with_option(sub, &option, &place, value, &mut faults));
                }
            }
            value => command = with_option(command, &key, &key, value, &mut faults),
        }
    }
    if faults.is_empty() { Ok(command) } else { Err(faults) }
}

/// Makes `value` the default of one option. Adds a fault if there is no such option or the value
/// has the wrong type.
fn with_option(
    command: clap::Command,
    option: &str,
    place: &str,
    value: Value,
    faults: &mut Vec<String>,
) -> clap::Command {
    let Some(arg) = command.get_arguments().find(|a| a.get_long() == Some(option) && option != "config") else {
        faults.push(format!("{place}: there is no such option"));
        return command;
    };
    let (id, many) = (arg.get_id().to_string(), matches!(arg.get_action(), ArgAction::Append));
    let texts = match value {
        Value::Array(values) if many => values.into_iter().map(plain).collect(),
        value => plain(value).map(|text| vec![text]),
    };
    match texts {
        Some(texts) => command.mut_arg(id, |arg| arg.required(false).default_values(texts)),
        None => {
            let wanted = if many { "a value or a list of values" } else { "a single value" };
            faults.push(format!("{place}: must be {wanted}"));
            command
        }
    }
}

/// Options that exclude each other, each with its rivals.
const RIVALS: [(&str, &[&str]); 13] = [
    ("z", &["z-um", "origin", "origin-um", "normal"]),
    ("z-um", &["z", "origin", "origin-um", "normal"]),
    ("origin", &["origin-um", "z", "z-um"]),
    ("origin-um", &["origin", "z", "z-um"]),
    ("normal", &["z", "z-um"]),
    ("pixel", &["pixel-um"]),
    ("pixel-um", &["pixel"]),
    ("epithelium", &["epithelium-um"]),
    ("epithelium-um", &["epithelium"]),
    ("lamina", &["lamina-um"]),
    ("lamina-um", &["lamina"]),
    ("serosa", &["serosa-um"]),
    ("serosa-um", &["serosa"]),
];

/// Removes values of variables and of the file if the command line has a rival of their option, and
/// values of the file if a variable has one.
fn without_rivals(mut command: clap::Command, args: &[OsString], has_variable: impl Fn(&str) -> bool) -> clap::Command {
    let is_given = |long: &str| {
        let option = |arg: &OsString| {
            let rest = arg.to_str().and_then(|arg| arg.strip_prefix("--")?.strip_prefix(long));
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('='))
        };
        args.iter().take_while(|arg| *arg != "--").any(option)
    };
    for (long, rivals) in RIVALS {
        let (given, set) = (is_given(long), has_variable(long));
        if !given && !set {
            continue;
        }
        let is_rival = |arg: &Arg| arg.get_long().is_some_and(|long| rivals.contains(&long));
        let without = |arg: Arg| match is_rival(&arg) {
            true if given => arg.env(Resettable::Reset).default_values([""; 0]),
            true => arg.default_values([""; 0]),
            false => arg,
        };
        command = command.mut_subcommands(|sub| sub.mut_args(without));
    }
    command
}

/// Returns a TOML value as written on the command line; `None` for arrays, tables and dates.
fn plain(value: Value) -> Option<String> {
    match value {
        Value::String(text) => Some(text),
        Value::Integer(number) => Some(number.to_string()),
        Value::Float(number) => Some(number.to_string()),
        Value::Boolean(flag) => Some(flag.to_string()),
        Value::Datetime(_) | Value::Array(_) | Value::Table(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::args::{Command, LogFormat};
    use crate::generate::Output;

    fn run(file: &str, line: &str) -> Result<Cli, Vec<String>> {
        let command = with_file(with_variables(Cli::command()), file)?;
        let mut args: Vec<OsString> = line.split_whitespace().map(Into::into).collect();
        insert_default_command(&mut args);
        let matches = command.try_get_matches_from(std::iter::once("oviduct".into()).chain(args));
        matches.and_then(|mut m| Cli::from_arg_matches_mut(&mut m)).map_err(|e| vec![e.to_string()])
    }

    #[test]
    fn a_length_in_either_spelling_overrides_the_file() {
        let found = |file: &str, line: &str, variable: Option<&str>| {
            let command = with_file(with_variables(Cli::command()), file).expect("a file");
            let args: Vec<OsString> = line.split_whitespace().map(Into::into).collect();
            let command = without_rivals(command, &args, |long| variable == Some(long));
            let mut matches =
                command.try_get_matches_from(std::iter::once("oviduct".into()).chain(args)).expect("parses");
            Cli::from_arg_matches_mut(&mut matches).expect("parses").command
        };
        let pixel = |file: &str, line: &str, variable: Option<&str>| {
            let Command::Measure(args) = found(file, line, variable) else { panic!("measure") };
            args.pixel.or(args.pixel_um)
        };
        let file = "[measure]\npixel = '3um'\n";
        assert_eq!(pixel(file, "measure a.png", None), Some(3.0));
        assert_eq!(pixel(file, "measure a.png --pixel-um 2", None), Some(2.0));
        assert_eq!(pixel("[measure]\npixel-um = 3\n", "measure --pixel=2um a.png", None), Some(2.0));
        assert_eq!(pixel(file, "measure a.png", Some("pixel-um")), None);
        let file = "[cut]\nz = '30mm'\n";
        for (line, z) in
            [("cut a.glb --z-um 10000", Some(10_000.0)), ("cut a.glb --origin 0,0,1mm --normal 0,0,1", None)]
        {
            let Command::Cut(args) = found(file, line, None) else { panic!("cut") };
            assert_eq!(args.across_um(), z, "{line}");
        }
    }

    #[test]
    fn the_definition_passes_claps_checks() {
        with_variables(Cli::command()).debug_assert();
    }

    #[test]
    fn every_option_has_a_variable() {
        let command = with_variables(Cli::command());
        let all = command.get_subcommands().flat_map(clap::Command::get_arguments).chain(command.get_arguments());
        let mut seen = 0;
        for arg in all.filter(|arg| arg.get_long().is_some()) {
            let name = arg.get_env().and_then(|name| name.to_str()).expect("a variable");
            assert!(name.starts_with("OVIDUCT_") && !name.contains('-'), "{name}");
            seen += 1;
        }
        assert!(seen > 30, "{seen}");
        assert_eq!(variable("cpu-workers"), "OVIDUCT_CPU_WORKERS");
    }

    #[test]
    fn global_options_are_known_here() {
        let command = Cli::command();
        let global: Vec<_> = command.get_arguments().filter_map(|a| a.get_long().map(|l| format!("--{l}"))).collect();
        assert_eq!(global, GLOBAL);
    }

    #[test]
    fn the_default_command_is_serve() {
        for line in ["", "--addr 127.0.0.1:9", "--log debug", "--log=debug --addr 127.0.0.1:9"] {
            assert!(matches!(run("", line).expect("parses").command, Command::Serve(_)), "{line}");
        }
        assert!(matches!(run("", "--log debug schema").expect("parses").command, Command::Schema));
        assert!(run("", "nonsense").is_err());
        assert!(run("", "--nonsense").is_err());
    }

    #[test]
    fn the_file_sets_defaults_and_the_command_line_overrides_them() {
        let file = "log-format = 'json'\n[serve]\naddr = '127.0.0.1:9000'\ncpu-workers = 3\nlease = '20s'\n\
                    [generate]\nout = 'models'\noutputs = ['glb', 'obj']\njson = true\nset = ['steps=4']\n";
        let cli = run(file, "serve --cpu-workers 4").expect("parses");
        assert_eq!(cli.global.log_format, LogFormat::Json);
        let Command::Serve(serve) = cli.command else { panic!("serve") };
        assert_eq!(serve.addr.port(), 9000);
        assert_eq!(serve.process.cpu_workers, 4);
        assert_eq!(serve.process.lease.as_secs(), 20);
        let Command::Generate(generate) = run(file, "generate").expect("parses").command else { panic!("generate") };
        assert_eq!(generate.model.outputs().formats, [Output::Glb, Output::Obj]);
        assert!(generate.json);
        assert_eq!(generate.out.to_str(), Some("models"));
        let Command::Generate(generate) = run(file, "generate --outputs obj --set a=1 --set b=2").expect("ok").command
        else {
            panic!("generate")
        };
        assert_eq!(generate.model.outputs().formats, [Output::Obj]);
        assert_eq!(generate.model.of.set, ["a=1", "b=2"]);
    }

    #[test]
    fn all_faults_of_the_file_are_reported() {
        let file = "colour = 'red'\nconfig = 'x'\n[serve]\nport = 1\naddr = ['a']\n[generate]\noutputs = [['glb']]\n";
        let mut faults = run(file, "schema").expect_err("faults");
        faults.sort();
        assert_eq!(
            faults,
            [
                "colour: there is no such option",
                "config: there is no such option",
                "generate.outputs: must be a value or a list of values",
                "serve.addr: must be a single value",
                "serve.port: there is no such option",
            ]
        );
        assert!(run("addr =", "schema").is_err());
        assert!(run("[serve]\nlease = 'soon'", "serve").is_err());
    }

    #[test]
    fn options_are_validated() {
        assert!(run("", "generate").is_err(), "--out is required");
        assert!(run("", "generate --out x --seed 9007199254740992").is_err());
        assert!(run("", "generate --out x --seed -1").is_err());
        assert!(run("", "generate --out x --backend quantum").is_err());
        assert!(run("", "generate --out x --backend cpu-single --outputs glb,obj").is_ok());
        assert!(run("", "check a.glb b.obj --euler -4 --json").is_ok());
        assert!(run("", "check").is_err());
        assert!(run("", "worker --database postgres://h/d --cpu-workers 2").is_ok());
        assert!(run("", "worker --addr 127.0.0.1:9").is_err());
        // Only `serve` deletes models and files.
        assert!(run("", "worker --keep 30d").is_err());
    }

    #[test]
    fn durations_need_a_unit_on_the_line_and_in_the_file() {
        let durations = ["keep", "lease", "heartbeat", "grace", "drain-delay", "job-timeout", "checkpoint-every"];
        for option in durations.into_iter().chain(["write-timeout"]) {
            for (file, line) in [
                (String::new(), format!("serve --{option} 30")),
                (format!("[serve]\n{option} = 30"), "serve".to_owned()),
            ] {
                let message = run(&file, &line).expect_err(option).join("\n");
                assert!(message.contains(option) && message.contains("ms, s, m, h or d"), "{message}");
            }
            assert!(run("", &format!("serve --{option} 30s")).is_ok(), "{option}");
        }
    }

    #[test]
    fn zero_is_refused_unless_it_means_none() {
        for option in ["keep", "lease", "heartbeat", "job-timeout", "write-timeout"] {
            for zero in ["0", "0s", "0d"] {
                let message = run("", &format!("serve --{option} {zero}")).expect_err(option).join("\n");
                assert!(message.contains("more than 0"), "{message}");
            }
        }
        assert!(run("", "serve --checkpoint-every 0 --grace 0s --drain-delay 0s").is_ok());
        assert!(run("", "serve --grace 0").is_err());
        assert!(run("[serve]\ncheckpoint-every = 0", "serve").is_ok());
    }

    #[test]
    fn the_demo_grows_seed_7_unless_another_is_given() {
        let seed = |line| match run("", line).expect("parses").command {
            Command::Demo(demo) => demo.model.of.seed,
            _ => panic!("demo"),
        };
        assert_eq!((seed("demo"), seed("demo --seed 9")), (Some(7), Some(9)));
        let help = |name| {
            let mut command = Cli::command();
            command.build();
            command.find_subcommand_mut(name).expect("a command").render_help().to_string()
        };
        assert!(help("demo").contains("[default: 7]"), "{}", help("demo"));
        assert!(help("generate").contains("[default: random]"), "{}", help("generate"));
    }
}
