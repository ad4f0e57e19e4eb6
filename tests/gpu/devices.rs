//! Adapters: what is offered, and what is said where there is none.

use crate::common::{OPTIONS, found, no_vulkan, open};
use oviduct::sim::gpu::{AdapterKind, GpuDevice, GpuError, GpuOptions, adapters};

#[test]
fn a_missing_loader_is_told() {
    if !no_vulkan() {
        return;
    }
    let error = adapters(&OPTIONS).unwrap_err();
    assert_eq!(error, GpuError::NoLoader);
    assert!(error.to_string().contains("libvulkan1"));
}

#[test]
fn software_adapters_count_only_where_they_are_allowed() {
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
fn adapters_say_what_they_are() {
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
