//! The shaders without any adapter: all of them parse and are valid, and every structure, constant and workgroup size
//! that host and shaders share is the same on both sides.

#![expect(clippy::unwrap_used, reason = "a test fails by panic")]

use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{Expression, Literal, Module, TypeInner};
use oviduct::random::Stream;
use oviduct::sim::cpu::CONSTANTS;
use oviduct::sim::gpu::layout::{self, Batch, Member, Now, Status};
use oviduct::sim::gpu::shaders::{ALL, Shader};
use oviduct::sim::{LANES, StepRow};
use std::mem::{offset_of, size_of};

fn parse(shader: &Shader) -> Module {
    naga::front::wgsl::parse_str(shader.source)
        .unwrap_or_else(|e| panic!("{}: {}", shader.name, e.emit_to_string(shader.source)))
}

#[test]
fn all_shaders_are_valid() {
    for shader in &ALL {
        let module = parse(shader);
        let mut validator = Validator::new(ValidationFlags::all(), Capabilities::IMMEDIATES);
        if let Err(error) = validator.validate(&module) {
            panic!("{}: {}", shader.name, error.emit_to_string(shader.source));
        }
    }
}

#[test]
fn every_stage_has_its_file_and_its_entry_points() {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/shaders");
    let mut files: Vec<String> = std::fs::read_dir(root)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter_map(|name| name.strip_suffix(".wgsl").map(str::to_owned))
        .collect();
    files.sort();
    let mut stages: Vec<&str> = ALL.iter().map(|s| s.name).collect();
    stages.sort_unstable();
    assert_eq!(files, stages);
    for shader in &ALL {
        let module = parse(shader);
        let found: Vec<(&str, [u32; 3])> =
            module.entry_points.iter().map(|e| (e.name.as_str(), e.workgroup_size)).collect();
        let wanted: Vec<(&str, [u32; 3])> = shader.entries.iter().map(|&(name, x)| (name, [x, 1, 1])).collect();
        assert_eq!(found, wanted, "{}", shader.name);
        assert_eq!(found[0].0, shader.name, "the first entry point bears the name of the stage");
    }
}

/// Names, offsets and the size of a structure as the shader lays it out.
fn structure(module: &Module, name: &str) -> (Vec<(String, u32)>, u32) {
    let (_, found) =
        module.types.iter().find(|(_, t)| t.name.as_deref() == Some(name)).unwrap_or_else(|| panic!("no {name}"));
    let TypeInner::Struct { members, span } = &found.inner else { panic!("{name} is no structure") };
    (members.iter().map(|m| (m.name.clone().unwrap(), m.offset)).collect(), *span)
}

macro_rules! assert_same {
    ($module:expr, $type:ident { $($field:ident),* $(,)? }) => {
        let (members, span) = structure($module, stringify!($type));
        let host = vec![$((stringify!($field).to_owned(), offset_of!($type, $field) as u32)),*];
        assert_eq!(members, host, stringify!($type));
        assert_eq!(span as usize, size_of::<$type>(), stringify!($type));
    };
}

#[test]
fn structures_are_laid_out_alike() {
    for shader in &ALL {
        let module = &parse(shader);
        assert_same!(
            module,
            StepRow {
                stiffness,
                damping,
                relaxation,
                edge,
                friction,
                bending,
                containment,
                ramp,
                squash,
                r_in,
                r_wall,
                regulatory,
                softening,
                contortion,
                repulsion,
                range_mean,
                range_half,
                barrier,
                barrier_distance,
                variation,
                tip_weight,
                lobing,
                inner_target,
                outer_target,
            }
        );
        assert_same!(module, Batch { capacity, outer_capacity, rows, events, waves, lobes, tables, padding });
        assert_same!(module, Member { seed_low, seed_high, candidates, lobes, contorted, clearance });
        assert_same!(
            module,
            Status {
                inner,
                outer,
                next_id,
                deferred,
                builds,
                shortened,
                broken,
                halted,
                moved,
                reach,
                widest,
                built,
                built_next,
                grown_from,
                runs,
                first_id,
                padding,
            }
        );
        assert_same!(module, Now { row, copy, rest, event, extent, outer_extent });
    }
}

fn literal(module: &Module, name: &str) -> Option<Literal> {
    let (_, found) = module.constants.iter().find(|(_, c)| c.name.as_deref() == Some(name))?;
    match module.global_expressions[found.init] {
        Expression::Literal(literal) => Some(literal),
        ref other => panic!("{name} is {other:?}"),
    }
}

fn constant(module: &Module, name: &str) -> Literal {
    literal(module, name).unwrap_or_else(|| panic!("no constant {name}"))
}

#[test]
fn constants_are_the_same() {
    for shader in &ALL {
        let module = parse(shader);
        for (name, value) in [
            ("LANES", LANES as u32),
            ("BLOCK_THREADS", layout::BLOCK_THREADS),
            ("THREADS", layout::THREADS),
            ("LOOP_THREADS", layout::LOOP_THREADS),
            ("LIST", layout::LIST),
            ("NONE", layout::NONE),
            ("HEADER", layout::HEADER),
            ("RECORDED_INNER", layout::RECORDED_INNER),
            ("RECORDED_OUTER", layout::RECORDED_OUTER),
            ("COPIED", layout::COPIED),
            ("CLEARANCE", layout::CLEARANCE),
            ("FIELDS", layout::FIELDS),
            ("WALL_FIELDS", layout::WALL_FIELDS),
        ] {
            assert_eq!(constant(&module, name), Literal::U32(value), "{name} in {}", shader.name);
        }
    }
    assert_eq!(layout::BLOCK_THREADS as usize, LANES * LANES);
}

#[test]
fn constants_of_the_model_are_those_of_the_cpu() {
    let modules = ALL.map(|shader| parse(&shader));
    let streams = [("STREAM_CONTORTION", Stream::Contortion), ("STREAM_GROWTH", Stream::Growth)];
    let shared = CONSTANTS.into_iter().chain(streams.map(|(name, stream)| (name, stream as u32 as f32)));
    for (name, value) in shared {
        let found: Vec<f32> = modules
            .iter()
            .filter_map(|module| match literal(module, name)? {
                Literal::F32(x) => Some(x),
                Literal::U32(x) => Some(x as f32),
                other => panic!("{name} is {other:?}"),
            })
            .collect();
        assert!(!found.is_empty(), "no shader has {name}");
        assert!(found.iter().all(|&x| x == value), "{name} is {value} on the CPU, {found:?} in shaders");
    }
}
