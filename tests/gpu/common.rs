//! The device that all tests share, plans that run on it, and a sink that stores all calls.

use oviduct::model::Section;
use oviduct::sim::gpu::{Adapter, AdapterKind, BatchSink, Checkpoint, GpuDevice, GpuOptions, adapters};
use oviduct::sim::{Plan, SimError, Statistics};
use oviduct::spec::{ModelSpec, preset};
use serde_json::{Value, json};
use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;

pub(crate) const OPTIONS: GpuOptions = GpuOptions { allow_software: true, ..GpuOptions::DEFAULT };

/// True if `OVIDUCT_TEST_NO_VULKAN` declares that this machine has no Vulkan loader.
pub(crate) fn no_vulkan() -> bool {
    std::env::var_os("OVIDUCT_TEST_NO_VULKAN").is_some_and(|v| v == "1")
}

/// The adapters of this machine, best first. Panics if there is none, or if
/// `OVIDUCT_TEST_GPU=hardware` demands a real GPU and there is none.
pub(crate) fn found() -> Vec<Adapter> {
    let found = adapters(&OPTIONS).unwrap_or_else(|e| {
        panic!("{e}\nThese tests need a Vulkan adapter: apt-get install mesa-vulkan-drivers libvulkan1")
    });
    if let Some(wanted) = std::env::var_os("OVIDUCT_TEST_GPU") {
        assert_eq!(wanted, "hardware", "the only value of OVIDUCT_TEST_GPU");
        assert_ne!(found[0].kind, AdapterKind::Software, "{} is not hardware", found[0].name);
    }
    found
}

/// True if the tests run on a real GPU, which is fast enough for models of paper size.
pub(crate) fn is_hardware() -> bool {
    found()[0].kind != AdapterKind::Software
}

pub(crate) fn open() -> GpuDevice {
    open_with(&OPTIONS)
}

pub(crate) fn open_with(options: &GpuOptions) -> GpuDevice {
    GpuDevice::open(&found()[0], options).unwrap()
}

/// Options that leave `bytes` for batches, in addition to the memory of an idle device.
pub(crate) fn leave(bytes: u64) -> GpuOptions {
    let idle = open().memory_in_use().expect("this backend tells what memory is in use");
    GpuOptions { memory_bytes: Some(idle + bytes), ..OPTIONS }
}

/// The device that the tests share.
pub(crate) fn device() -> &'static GpuDevice {
    static DEVICE: OnceLock<GpuDevice> = OnceLock::new();
    DEVICE.get_or_init(open)
}

/// A small model of the preset `paper` with growth at fold tips, thickness field, variety and sway:
/// 150 steps, 200 to 810 inner particles.
pub(crate) fn plan(patch: &Value, seed: u64) -> Plan {
    Plan::new(&small(patch), seed)
}

/// Specification of [`plan`].
pub(crate) fn small(patch: &Value) -> ModelSpec {
    let mut whole = json!({
        "steps": 150, "burn_in": 60, "bending": 0.2, "z": { "keys": [[0, 0], [0.2125, 0.35], [1, 1]] },
        "particles": {
            "total": { "keys": [[0, 260], [1, 900]] }, "outer": { "keys": [[0, 60], [1, 90]] },
            "tip_weight": { "keys": [[0, 0.5], [1, 0.5]], "fluctuation": { "amplitude": 0.3, "period": 400 } },
            "candidates": 6,
        },
        "containment": { "wall_um": { "keys": [[0, 900], [0.125, 900], [0.45, 680], [1, 680]], "ease": "smooth" } },
        "collision": {
            "gap_um": { "keys": [[0, 60], [0.125, 60], [0.45, 42], [1, 42]], "ease": "smooth" }, "barrier_um": 7,
        },
        "variation": { "amplitude": 0.35 },
        "variety": {
            "asymmetry": 0.15, "shift": 0.05,
            "height": { "keys": [[0, 0], [0.2125, 0], [0.45, 0.3], [1, 0.3]] },
            "thickness": { "keys": [[0, 0], [0.2125, 0], [0.45, 0.08], [1, 0.08]] },
        },
        "sway": { "strength": { "keys": [[0, 0], [0.1825, 0], [0.27, 2.5], [1, 2.5]], "ease": "smooth" } },
        "lean": { "strength_um": { "keys": [[0, 0], [0.1825, 0], [0.2425, 550], [1, 550]], "ease": "smooth" } },
    });
    json_patch::merge(&mut whole, patch);
    ModelSpec::resolve(preset("paper").unwrap(), &whole).unwrap()
}

/// A model of a few hundred particles and 60 steps.
pub(crate) fn short(seed: u64) -> Plan {
    let patch = json!({
        "steps": 60, "burn_in": 20,
        "particles": { "total": { "keys": [[0, 180], [1, 400]] }, "outer": { "keys": [[0, 50], [1, 60]] } },
    });
    plan(&patch, seed)
}

/// The command that grows a very small model into `dir` and prints JSON.
pub(crate) fn generate(dir: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_oviduct"));
    command.current_dir(dir).args(["generate", "--seed", "1", "--out", "model", "--json"]);
    command.args(["--set", "steps=40", "--set", "particles.total={\"keys\":[[0,180],[1,260]]}"]);
    command.args(["--set", "particles.outer=50", "--set", "burn_in=10"]);
    command
}

/// Stores the calls of a batch.
#[derive(Debug)]
pub(crate) struct Kept {
    pub(crate) sections: Vec<Vec<(Section, Checkpoint)>>,
    pub(crate) finished: Vec<Option<Statistics>>,
    pub(crate) failed: Vec<Option<SimError>>,
    pub(crate) reached: Vec<i64>,
    /// Member to cancel, and the step.
    pub(crate) cancel: Option<(usize, i64)>,
    /// Device to lose, and the step of member 0.
    pub(crate) lose: Option<(GpuDevice, i64)>,
    /// Device that is to hang, and the step of member 0.
    pub(crate) hang: Option<(GpuDevice, i64)>,
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
            hang: None,
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
        if member == 0 && self.hang.as_ref().is_some_and(|(_, at)| step >= *at) {
            self.hang.take().unwrap().0.hang();
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
