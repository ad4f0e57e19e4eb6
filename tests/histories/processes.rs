//! Processes of the program that are started again whenever they end, as by a supervisor.

use crate::cluster::free_port;
use rustix::process::{Pid, Signal, kill_process};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio_util::task::AbortOnDropHandle;

/// Pause of the supervisor before it starts a process again.
const RESTART_AFTER: Duration = Duration::from_millis(200);
/// Workers lose their leases soon, and a job is lost only by a fault of the program.
const OPTIONS: [&str; 14] = [
    "--lease",
    "2s",
    "--heartbeat",
    "500ms",
    "--max-attempts",
    "100000",
    "--cpu-workers",
    "1",
    "--cpu-threads",
    "1",
    "--gpu",
    "off",
    "--log",
    "warn",
];

/// A supervised process, killed when dropped.
pub struct Process {
    pub name: String,
    /// Address of its service, or of its probes.
    pub url: String,
    line: Vec<String>,
    log: PathBuf,
    running: Mutex<State>,
}

#[derive(Default)]
struct State {
    child: Option<Child>,
    starts: u32,
    /// Ends that no signal of the test caused.
    own_ends: Vec<ExitStatus>,
    was_killed: bool,
    is_stopped: bool,
    is_over: bool,
}

impl Process {
    /// `oviduct serve` or `oviduct worker` with a data directory of its own.
    pub fn new(folder: &Path, name: &str, command: &str, options: &[&str]) -> Arc<Self> {
        let address = format!("127.0.0.1:{}", free_port());
        let data = folder.join(name);
        std::fs::create_dir(&data).unwrap();
        let addr = if command == "serve" { "--addr" } else { "--metrics-addr" };
        let line = [command, addr, &address, "--data", data.to_str().unwrap()];
        let line = line.iter().chain(&OPTIONS).chain(options).map(|&text| text.to_owned()).collect();
        let (log, running) = (data.join("log"), Mutex::default());
        Arc::new(Self { name: name.to_owned(), url: format!("http://{address}"), line, log, running })
    }

    /// Starts the process, and again whenever it ends.
    pub fn supervise(self: &Arc<Self>) -> AbortOnDropHandle<()> {
        let process = Arc::clone(self);
        AbortOnDropHandle::new(tokio::spawn(async move {
            loop {
                process.start_if_ended();
                tokio::time::sleep(RESTART_AFTER).await;
            }
        }))
    }

    fn start_if_ended(&self) {
        let mut state = self.running.lock().unwrap();
        if let Some(child) = &mut state.child {
            let Some(status) = child.try_wait().unwrap() else { return };
            (state.child, state.is_stopped) = (None, false);
            if !std::mem::take(&mut state.was_killed) {
                state.own_ends.push(status);
            }
            return;
        }
        if state.is_over {
            return;
        }
        let log = std::fs::File::options().create(true).append(true).open(&self.log).unwrap();
        let program = std::env::var_os("OVIDUCT_TEST_PROGRAM").unwrap_or(env!("CARGO_BIN_EXE_oviduct").into());
        let mut command = Command::new(program);
        command.args(&self.line).stdin(Stdio::null()).stdout(Stdio::null()).stderr(log);
        state.child = Some(command.spawn().unwrap());
        state.starts += 1;
    }

    /// Sends a signal, unless the process has ended. The lock holds the process id: nothing else
    /// waits for the process.
    fn signal(state: &mut State, signal: Signal) -> bool {
        state.child.as_ref().is_some_and(|child| kill_process(Pid::from_child(child), signal).is_ok())
    }

    /// Kills the process, unless it is stopped: a stall is to be longer than a lease. Returns false
    /// if it has been killed already.
    pub fn kill(&self) -> bool {
        let mut state = self.running.lock().unwrap();
        let is_killed = !state.is_stopped && !state.was_killed && Self::signal(&mut state, Signal::KILL);
        state.was_killed |= is_killed;
        is_killed
    }

    /// Stops the process, unless it is stopped.
    pub fn stop(&self) -> bool {
        let mut state = self.running.lock().unwrap();
        let is_stopped_now = !state.is_stopped && !state.was_killed && Self::signal(&mut state, Signal::STOP);
        state.is_stopped |= is_stopped_now;
        is_stopped_now
    }

    pub fn resume(&self) {
        let mut state = self.running.lock().unwrap();
        state.is_stopped = false;
        Self::signal(&mut state, Signal::CONT);
    }

    /// Numbers of starts, and of ends by itself. A process that does not reach its database when it
    /// starts ends with 1.
    pub fn history(&self) -> (u32, usize) {
        let state = self.running.lock().unwrap();
        let is_expected = |status: &ExitStatus| status.code() == Some(1);
        assert!(state.own_ends.iter().all(is_expected), "{}: {:?}\n{}", self.name, state.own_ends, self.tail());
        (state.starts, state.own_ends.len())
    }

    /// The last lines of the log.
    pub fn tail(&self) -> String {
        let text = std::fs::read_to_string(&self.log).unwrap_or_default();
        let lines: Vec<&str> = text.lines().collect();
        lines[lines.len().saturating_sub(40)..].join("\n")
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let mut state = self.running.lock().unwrap();
        state.is_over = true;
        if let Some(mut child) = state.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}
