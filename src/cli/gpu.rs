//! GPUs of this machine, selected by `--gpu` and `--allow-software-adapter`.

use super::args::{GpuArgs, GpuUse};
use crate::generate::{
    Backend, Calls, CancelToken, GenerateError, Member, Outcome, Request, Sink, generate, generate_batch,
};
use crate::lock::Mutex;
use crate::sim::gpu::{GpuDevice, GpuError, GpuOptions, adapters, choose};
use crate::worker::{BatchGenerator, GpuGenerator};
use std::sync::Arc;

/// Reason that is reported with `--gpu off`.
const OFF: &str = "GPUs are switched off (--gpu off)";

fn options(args: &GpuArgs) -> GpuOptions {
    GpuOptions { allow_software: args.allow_software_adapter, ..GpuOptions::default() }
}

/// Keeps the chosen one of all GPUs; without a choice, keeps all.
fn chosen<T>(mut all: Vec<T>, name: impl Fn(&T) -> String, gpu: &GpuUse) -> Result<Vec<T>, GpuError> {
    if let GpuUse::One(choice) = gpu {
        let names: Vec<String> = all.iter().map(name).collect();
        all = vec![all.swap_remove(choose(&names, choice)?)];
    }
    Ok(all)
}

/// Returns a generator for each GPU, or the reason why there is none.
pub(super) async fn generators(args: &GpuArgs) -> Result<Vec<Arc<dyn BatchGenerator>>, String> {
    let (options, gpu) = (options(args), args.gpu.clone());
    let found = if gpu == GpuUse::Off {
        Err(OFF.to_owned())
    } else {
        let list = move || chosen(GpuGenerator::all(options)?, BatchGenerator::device, &gpu);
        match tokio::task::spawn_blocking(list).await {
            Ok(found) => found.map_err(|error| error.to_string()),
            Err(panic) => Err(format!("the graphics driver failed: {panic}")),
        }
    };
    if let (Err(reason), GpuUse::Auto | GpuUse::Off) = (&found, &args.gpu) {
        tracing::info!(reason, "no GPU worker; models are grown on the CPU");
    }
    Ok(found?.into_iter().map(|gpu| Arc::new(gpu) as Arc<dyn BatchGenerator>).collect())
}

/// Opens the chosen GPU or else the best one, or returns the reason why there is none.
pub fn best(args: &GpuArgs) -> Result<GpuDevice, String> {
    if args.gpu == GpuUse::Off {
        return Err(OFF.to_owned());
    }
    let found = adapters(&options(args)).and_then(|all| chosen(all, |adapter| adapter.name.clone(), &args.gpu));
    let mut last = GpuError::NoAdapter { software: false };
    for adapter in found.map_err(|error| error.to_string())? {
        match GpuDevice::open(&adapter, &options(args)) {
            Ok(device) => return Ok(device),
            Err(error) => last = error,
        }
    }
    Err(last.to_string())
}

/// Grows one model on the backend of the request. For `auto`, this is the best GPU if it can grow
/// the model, otherwise the CPU; the reason for the CPU is returned as well.
///
/// # Errors
/// [`GenerateError`].
pub(super) fn grow(
    request: &Request,
    args: &GpuArgs,
    sink: &dyn Sink,
    cancel: &CancelToken,
) -> Result<(Outcome, Option<String>), GenerateError> {
    let auto = match request.backend {
        Backend::Cpu | Backend::CpuSingle => return Ok((generate(request, sink, cancel)?, None)),
        Backend::Auto => true,
        Backend::Gpu => false,
    };
    let reason = match best(args) {
        Ok(device) => match alone(&device, request, sink, cancel) {
            Err(GenerateError::Gpu(error)) if auto => error.to_string(),
            other => return other.map(|outcome| (outcome, None)),
        },
        // The absence of a GPU that was chosen is an error of the command line.
        Err(reason) if auto && !matches!(args.gpu, GpuUse::One(_)) => reason,
        Err(detail) => return Err(GenerateError::Backend { detail }),
    };
    tracing::info!(reason, "the model is grown on the CPU");
    let request = Request { backend: Backend::Cpu, ..request.clone() };
    Ok((generate(&request, sink, cancel)?, Some(reason)))
}

/// Grows one model on a GPU as a batch of one.
fn alone(
    device: &GpuDevice,
    request: &Request,
    sink: &dyn Sink,
    cancel: &CancelToken,
) -> Result<Outcome, GenerateError> {
    let end = Mutex::new(None);
    let ended = |_, result| *end.lock() = Some(result);
    generate_batch(
        device,
        None,
        &[Member { request, plan: None, sink, cancel }],
        Calls { simulated: &|| (), ended: &ended },
    );
    let end = end.lock().take();
    end.expect("every member of a batch ends")
}

/// Restarts this process with `NODEVICE_SELECT=1`, so that listing adapters prints no errors.
/// Returns if that is not necessary or fails. Call it before anything is opened.
///
/// Mesa's device-select layer asks the Wayland compositor for its default GPU whenever adapters are
/// listed. Without `XDG_RUNTIME_DIR`, as in containers and over ssh, libwayland prints several
/// lines of errors to stderr. Only this variable switches the layer off, and a running process
/// cannot set a variable safely.
#[cfg(target_os = "linux")]
pub fn without_device_select() {
    use std::os::unix::process::CommandExt;
    use std::path::Path;

    const SWITCH: &str = "NODEVICE_SELECT";
    let has_runtime_dir = std::env::var_os("XDG_RUNTIME_DIR").is_some_and(|dir| Path::new(&dir).is_absolute());
    if has_runtime_dir || std::env::var_os(SWITCH).is_some() {
        return;
    }
    let Ok(program) = std::env::current_exe() else { return };
    let mut args = std::env::args_os();
    let mut command = std::process::Command::new(program);
    if let Some(name) = args.next() {
        command.arg0(name);
    }
    // If it fails, the errors are printed, and everything else works.
    let _ = command.args(args).env(SWITCH, "1").exec();
}

/// Does nothing: Mesa's layer exists only on Linux.
#[cfg(not(target_os = "linux"))]
pub fn without_device_select() {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::{Output, UsedBackend};
    use crate::spec::{ModelSpec, preset};
    use serde_json::json;

    #[test]
    fn without_a_gpu_auto_falls_back_and_says_so_and_gpu_fails() {
        let dir = tempfile::tempdir().unwrap();
        let patch = json!({ "steps": 40, "burn_in": 10, "particles": { "total": 260, "outer": 60 } });
        let request = |backend| Request {
            preset: "pig".into(),
            spec: ModelSpec::resolve(preset("pig").unwrap(), &patch).unwrap(),
            seed: 1,
            backend,
            outputs: vec![Output::Glb].into(),
            dir: dir.path().into(),
            memory_limit_bytes: None,
        };
        let off = GpuArgs { gpu: GpuUse::Off, allow_software_adapter: false };
        let run = |backend| grow(&request(backend), &off, &(), &CancelToken::default());
        let (outcome, fallback) = run(Backend::Auto).unwrap();
        assert_eq!((outcome.used, fallback.as_deref()), (UsedBackend::Cpu, Some(OFF)));
        assert_eq!(run(Backend::CpuSingle).unwrap().1, None);
        let error = run(Backend::Gpu).unwrap_err().to_string();
        assert!(error.contains(OFF), "{error}");
        let absent = GpuArgs { gpu: GpuUse::One("no such card".into()), ..off };
        for backend in [Backend::Auto, Backend::Gpu] {
            let error = grow(&request(backend), &absent, &(), &CancelToken::default()).unwrap_err();
            assert!(matches!(error, GenerateError::Backend { .. }), "{error}");
        }
    }
}
