//! Which jobs a CPU worker leaves to GPU workers.
//!
//! The rule: `auto` is left to GPU workers while one is alive, unless more jobs wait than they take with their next two
//! claims. A GPU worker is alive while its last sign of life is younger than [`ALIVE`] of this pool's heartbeats.

use super::attempt::Context;
use crate::generate::Backend;
use crate::jobs::StoreError;
use crate::metrics::Fallback;

/// Heartbeats without a sign of life after which a GPU worker counts as gone: twice what an idle one lets pass.
const ALIVE: u32 = 10;

/// What a CPU worker may take.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Share {
    /// What was asked of a CPU by name.
    ByName,
    /// `auto` too.
    Auto {
        /// Why, in words for the record.
        why: String,
        /// Why, for the counts.
        cause: Fallback,
    },
}

impl Share {
    /// What to claim as.
    pub(super) fn backend(&self) -> Backend {
        match self {
            Self::ByName => Backend::CpuSingle,
            Self::Auto { .. } => Backend::Cpu,
        }
    }
}

/// What a CPU worker may take now.
pub(super) async fn of_cpu(context: &Context) -> Result<Share, StoreError> {
    let options = &context.options;
    let alive = context.store.alive(Backend::Gpu, ALIVE * options.heartbeat).await?;
    if alive == 0 {
        let why = options.no_gpu.clone().unwrap_or_else(|| "no GPU worker is alive".to_owned());
        return Ok(Share::Auto { why, cause: Fallback::NoGpu });
    }
    let waiting = context.store.waiting(Backend::Gpu).await?;
    let taken = 2 * u64::from(options.batch) * alive;
    Ok(if waiting > taken {
        let why = format!("{waiting} jobs were waiting for {alive} GPU worker{}", if alive == 1 { "" } else { "s" });
        Share::Auto { why, cause: Fallback::Busy }
    } else {
        Share::ByName
    })
}
