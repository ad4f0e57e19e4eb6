//! Starts the process again with a variable that Vulkan reads.
//!
//! Mesa's device-select layer asks the Wayland compositor for its default GPU whenever adapters are listed. Without
//! `XDG_RUNTIME_DIR`, as in containers and over ssh, libwayland prints several lines of errors to stderr. Only the variable
//! `NODEVICE_SELECT` switches the layer off, and a running process cannot set a variable safely.

/// Replaces this process by itself with `NODEVICE_SELECT=1`, if libwayland would complain. Returns otherwise. Call it before
/// anything is opened.
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
    // It returns only if it fails; then the lines are printed, and everything else works.
    let _ = command.args(args).env(SWITCH, "1").exec();
}

/// Does nothing: Mesa's layer exists only on Linux.
#[cfg(not(target_os = "linux"))]
pub fn without_device_select() {}
