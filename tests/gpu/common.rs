//! The device that all tests share, plans to run on it, and a sink that keeps what it is told.

use oviduct::model::Section;
use oviduct::sim::gpu::{Adapter, BatchSink, Checkpoint, GpuDevice, GpuOptions, adapters};
use oviduct::sim::{Plan, SimError, Statistics};
use oviduct::spec::{ModelSpec, preset};
use serde_json::{Value, json};
use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;

pub(crate) const OPTIONS: GpuOptions = GpuOptions { allow_software: true, memory_bytes: None };

/// Whether this machine is said to have no Vulkan loader, so that nothing but its absence can be tested.
pub(crate) fn no_vulkan() -> bool {
    std::env::var_os("OVIDUCT_TEST_NO_VULKAN").is_some_and(|v| v == "1")
}

/// The adapters of this machine; without any the test fails.
pub(crate) fn found() -> Vec<Adapter> {
    adapters(&OPTIONS).unwrap_or_else(|e| {
        panic!("{e}\nThese tests need a Vulkan adapter: apt-get install mesa-vulkan-drivers libvulkan1")
    })
}

/// A device of its own.
pub(crate) fn open() -> GpuDevice {
    open_with(&OPTIONS)
}

/// A device of its own with other options.
pub(crate) fn open_with(options: &GpuOptions) -> GpuDevice {
    GpuDevice::open(&found()[0], options).unwrap()
}

/// Options that leave so many bytes for batches, on top of what an idle device takes.
pub(crate) fn leave(bytes: u64) -> GpuOptions {
    let idle = open().memory_in_use().expect("this backend tells what memory is in use");
    GpuOptions { memory_bytes: Some(idle + bytes), ..OPTIONS }
}

/// The device that tests share.
pub(crate) fn device() -> &'static GpuDevice {
    static DEVICE: OnceLock<GpuDevice> = OnceLock::new();
    DEVICE.get_or_init(open)
}

/// A small model: 150 steps, 200 to 810 inner particles.
pub(crate) fn plan(patch: &Value, seed: u64) -> Plan {
    let mut whole = json!({
        "steps": 150, "burn_in": 60,
        "particles": { "total": { "keys": [[0, 260], [1, 900]] }, "outer": { "keys": [[0, 60], [1, 90]] } },
    });
    json_patch::merge(&mut whole, patch);
    Plan::new(&ModelSpec::resolve(preset("pig").unwrap(), &whole).unwrap(), seed)
}

/// A model of a few hundred particles and 60 steps.
pub(crate) fn short(seed: u64) -> Plan {
    let patch = json!({
        "steps": 60, "burn_in": 20,
        "particles": { "total": { "keys": [[0, 180], [1, 400]] }, "outer": { "keys": [[0, 50], [1, 60]] } },
    });
    plan(&patch, seed)
}

/// The command that grows a very small model into `dir`, and prints JSON.
pub(crate) fn generate(dir: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_oviduct"));
    command.current_dir(dir).args(["generate", "--seed", "1", "--out", "model", "--json"]);
    command.args(["--set", "steps=40", "--set", "particles.total={\"keys\":[[0,180],[1,260]]}"]);
    command.args(["--set", "particles.outer=50", "--set", "burn_in=10"]);
    command
}

/// Keeps what a batch tells.
#[derive(Debug)]
pub(crate) struct Kept {
    pub(crate) sections: Vec<Vec<(Section, Checkpoint)>>,
    pub(crate) finished: Vec<Option<Statistics>>,
    pub(crate) failed: Vec<Option<SimError>>,
    pub(crate) reached: Vec<i64>,
    /// A member that is cancelled once it has reached a step.
    pub(crate) cancel: Option<(usize, i64)>,
    /// A device that is given up once member 0 has reached a step.
    pub(crate) lose: Option<(GpuDevice, i64)>,
}

impl Kept {
    pub(crate) fn new(members: usize) -> Self {
        Self {
            sections: vec![Vec::new(); members],
            finished: vec![None; members],
            failed: vec![None; members],
            reached: vec![i64::MIN; members],
            cancel: None,
            lose: None,
        }
    }
}

impl BatchSink for Kept {
    fn section(&mut self, member: usize, section: Section, checkpoint: Checkpoint) {
        assert_eq!(section.step, checkpoint.time as f64);
        self.sections[member].push((section, checkpoint));
    }
    fn progress(&mut self, member: usize, step: i64, particles: u32) {
        assert!(step >= self.reached[member] && particles > 0);
        self.reached[member] = step;
        if member == 0 && self.lose.as_ref().is_some_and(|(_, at)| step >= *at) {
            self.lose.take().unwrap().0.lose();
        }
    }
    fn cancelled(&mut self, member: usize) -> bool {
        self.cancel.is_some_and(|(m, step)| m == member && self.reached[m] >= step)
    }
    fn failed(&mut self, member: usize, error: SimError) {
        self.failed[member] = Some(error);
    }
    fn finished(&mut self, member: usize, statistics: Statistics) {
        self.finished[member] = Some(statistics);
    }
}
