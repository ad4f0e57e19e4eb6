//! Source of the shaders. The source of a stage consists of the shared files that it needs,
//! followed by its own file; there is no preprocessor.

/// The shader of a stage.
#[derive(Clone, Copy, Debug)]
pub struct Shader {
    /// Name of the stage and of its file.
    pub name: &'static str,
    /// Complete source.
    pub source: &'static str,
    /// Entry points, each with the number of threads of its workgroups.
    pub entries: &'static [(&'static str, u32)],
}

macro_rules! shared {
    ($name:literal) => {
        include_str!(concat!("../../../../../shaders/shared/", $name, ".wgsl"))
    };
}

macro_rules! stage {
    ($name:literal) => {
        include_str!(concat!("../../../../../shaders/", $name, ".wgsl"))
    };
}

use super::layout::{BLOCK_THREADS, LOOP_THREADS, THREADS};

/// Time integration with all forces and the guard; neighbour lists before the forces, the outer
/// loop beside them.
pub const INTEGRATE: Shader = Shader {
    name: "integrate",
    source: concat!(
        shared!("layout"),
        shared!("lists"),
        shared!("neighbours"),
        shared!("pairs"),
        shared!("local"),
        shared!("finite"),
        shared!("maths"),
        shared!("region"),
        shared!("outer"),
        shared!("sway"),
        shared!("gather"),
        stage!("integrate")
    ),
    entries: &[("integrate", BLOCK_THREADS), ("guard", BLOCK_THREADS)],
};

/// Growth of both loops, and the thickness field.
pub const GROWTH: Shader = Shader {
    name: "growth",
    source: concat!(
        shared!("layout"),
        shared!("random"),
        shared!("maths"),
        shared!("region"),
        shared!("variety"),
        shared!("clefts"),
        shared!("thickness"),
        stage!("growth")
    ),
    entries: &[("growth", LOOP_THREADS), ("split", THREADS)],
};

/// Recording.
pub const RECORD: Shader =
    Shader { name: "record", source: concat!(shared!("layout"), stage!("record")), entries: &[("record", THREADS)] };

/// All stages.
pub const ALL: [Shader; 3] = [INTEGRATE, GROWTH, RECORD];
