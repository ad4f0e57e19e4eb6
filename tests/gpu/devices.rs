//! The list of adapters, and the errors if it is empty.

use crate::common::{OPTIONS, found, generate, no_vulkan, open};
use oviduct::sim::gpu::{AdapterKind, GpuDevice, GpuError, GpuOptions, adapters};

#[test]
fn a_missing_loader_is_reported() {
    if !no_vulkan() {
        return;
    }
    let error = adapters(&OPTIONS).unwrap_err();
    assert_eq!(error, GpuError::NoLoader);
    assert!(error.to_string().contains("libvulkan1"));
}

#[test]
fn software_adapters_count_only_if_they_are_allowed() {
    if no_vulkan() {
        return;
    }
    let all = found();
    let software: Vec<_> = all.iter().filter(|a| a.kind == AdapterKind::Software).collect();
    let strict = GpuOptions::default();
    match adapters(&strict) {
        Ok(real) => assert_eq!(real.len() + software.len(), all.len()),
        Err(error) => {
            assert_eq!(error, GpuError::NoAdapter { software: true });
            assert_eq!(software.len(), all.len());
        }
    }
    for adapter in software {
        assert_eq!(GpuDevice::open(adapter, &strict).unwrap_err(), GpuError::NoAdapter { software: true });
    }
}

#[test]
fn adapters_report_their_properties() {
    if no_vulkan() {
        return;
    }
    for adapter in found() {
        println!("{adapter:?}");
        assert!(!adapter.name.is_empty() && !adapter.driver.is_empty());
        assert!(["vulkan", "metal", "dx12"].contains(&adapter.backend.as_str()));
        assert!(adapter.max_binding_bytes >= 128 << 20);
    }
    assert!(!open().is_lost());
}

/// Works on any machine: an unloadable library replaces the loader, and a missing file replaces the
/// list of drivers.
#[cfg(target_os = "linux")]
#[test]
fn the_command_names_what_is_missing_and_grows_on_the_cpu() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("libvulkan.so.1"), "no library").unwrap();
    let nowhere = dir.path().join("nowhere");
    for (name, value) in [("LD_LIBRARY_PATH", dir.path()), ("VK_DRIVER_FILES", &nowhere)] {
        let run = |backend: &str| {
            let mut command = generate(dir.path());
            command.args(["--backend", backend, "--allow-software-adapter"]);
            command.env(name, value).env("VK_ICD_FILENAMES", &nowhere).output().unwrap()
        };
        let output = run("gpu");
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{name}: {told}");
        assert!(
            told.contains("no graphics interface could be loaded") && told.contains("libvulkan1"),
            "{name}: {told}"
        );
        assert!(!told.contains("panicked"), "{name}: {told}");
        let output = run("auto");
        assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
        let told: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(told["backend"]["used"], "cpu");
        assert!(told["backend"]["fallback"].as_str().unwrap().contains("libvulkan1"), "{name}: {told}");
    }
}
