//! Checks of the shaders that need no adapter. All shaders parse and are valid, and every
//! structure, constant and workgroup size that host and shaders share is the same on both sides.

#![expect(clippy::unwrap_used, reason = "a test fails by panic")]

use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{Expression, Literal, Module, TypeInner};
use oviduct::geometry::star::DIRECTIONS;
use oviduct::random::Stream;
use oviduct::sim::cpu::CONSTANTS;
use oviduct::sim::gpu::layout::{self, Batch, Member, Now, Status};
use oviduct::sim::gpu::shaders::{ALL, Shader};
use oviduct::sim::{LANES, StepRow};
use std::collections::BTreeSet;
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

/// Member names, offsets and size of a structure in the shader's layout.
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
                wall_stiffness,
                wall_damping,
                wall_friction,
                sway,
                asymmetry,
                height,
                thickness,
                shift,
                outline,
                fold,
                fold_of_wall,
                fold_phase,
                margin,
                clefts,
                hold,
                cleft_width,
                spare,
                guide,
                reach,
                room,
                inner_target,
                outer_target,
            }
        );
        assert_same!(
            module,
            Batch {
                capacity,
                outer_capacity,
                rows,
                events,
                waves,
                lobes,
                tables,
                flows,
                modes,
                around,
                outline,
                clefts
            }
        );
        assert_same!(
            module,
            Member { seed_low, seed_high, candidates, lobes, contorted, clearance, modes, directions, clefts }
        );
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
                strayed,
                reach,
                widest,
                built,
                built_next,
                grown_from,
                runs,
                weight,
                first_id,
                full_searches,
            }
        );
        assert_same!(module, Now { row, copy, rest, event, extent, outer_extent, outer });
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

/// Constants of the outlines.
const OUTLINES: [(&str, f32); 2] = [("DIRECTIONS", DIRECTIONS as f32), ("QUADRANT", (DIRECTIONS / 4) as f32)];

/// Constants of the memory layout that the host shares.
const SHARED: [(&str, u32); 16] = [
    ("LANES", LANES as u32),
    ("SLICES", layout::SLICES),
    ("BLOCK_THREADS", layout::BLOCK_THREADS),
    ("THREADS", layout::THREADS),
    ("LOOP_THREADS", layout::LOOP_THREADS),
    ("LIST", layout::LIST),
    ("NONE", layout::NONE),
    ("HEADER", layout::HEADER),
    ("RECORDED_INNER", layout::RECORDED_INNER),
    ("RECORDED_OUTER", layout::RECORDED_OUTER),
    ("COPIED_SCALARS", layout::COPIED_SCALARS),
    ("CLEARANCE", layout::CLEARANCE),
    ("SCALARS", layout::SCALARS),
    ("COPIED_VECTORS", layout::COPIED_VECTORS),
    ("VECTORS", layout::VECTORS),
    ("WALL_FIELDS", layout::WALL_FIELDS),
];
/// Fields in the order in which the host writes and reads them.
const INNER_SCALARS: [&str; 5] = ["ID", "REST", "SIGN", "SCALE", "CLEFT"];
const INNER_VECTORS: [&str; 3] = ["POSITION", "VELOCITY", "ANCHOR"];
const OUTER_FIELDS: [&str; 5] = ["WALL_ID", "WALL_X", "WALL_Y", "WALL_VX", "WALL_VY"];
/// Fields that only shaders use, with their widths. They must not overlap.
const OWN_SCALARS: [&str; 5] = ["CLEARANCE", "COUNT", "WINNER", "BEFORE", "LIGHTER"];
const OWN_VECTORS: [(&str, u32); 6] =
    [("STAGE", 4), ("SUM", 1), ("FIRST", 1), ("MIDDLE", 1), ("BUILT", 1), ("SWAY", 1)];
const OWN_OUTER_FIELDS: [(&str, u32); 3] = [("WALL_PULL_X", 1), ("WALL_PULL_Y", 1), ("WALL_OLD", 5)];
/// Other constants that only shaders use: memory layout, a coordinate beyond all ranges, and the
/// division of work among threads.
const OWN: [&str; 5] = ["SPARE", "DISTANT", "WORDS", "SLICE_MASK", "APART"];

/// Random streams that shaders use.
const STREAMS: [(&str, Stream); 2] = [("STREAM_CONTORTION", Stream::Contortion), ("STREAM_GROWTH", Stream::Growth)];

#[test]
fn constants_are_the_same() {
    for shader in &ALL {
        let module = parse(shader);
        for (name, value) in SHARED {
            assert_eq!(constant(&module, name), Literal::U32(value), "{name} in {}", shader.name);
        }
    }
    assert_eq!(layout::BLOCK_THREADS, layout::SLICES * LANES as u32);
}

#[test]
fn constants_of_the_model_are_those_of_the_cpu() {
    let modules = ALL.map(|shader| parse(&shader));
    let shared =
        CONSTANTS.into_iter().chain(STREAMS.map(|(name, stream)| (name, stream as u32 as f32))).chain(OUTLINES);
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

#[test]
fn fields_follow_each_other() {
    for shader in &ALL {
        let module = parse(shader);
        let follow = |first: u32, fields: &[(&str, u32)], end: u32| {
            let mut next = first;
            for &(name, width) in fields {
                assert_eq!(constant(&module, name), Literal::U32(next), "{name} in {}", shader.name);
                next += width;
            }
            assert_eq!(next, end);
        };
        follow(0, &INNER_SCALARS.map(|name| (name, 1)), layout::COPIED_SCALARS);
        follow(2 * layout::COPIED_SCALARS, &OWN_SCALARS.map(|name| (name, 1)), layout::SCALARS);
        follow(0, &INNER_VECTORS.map(|name| (name, 1)), layout::COPIED_VECTORS);
        follow(2 * layout::COPIED_VECTORS, &OWN_VECTORS, layout::VECTORS);
        follow(0, &OUTER_FIELDS.map(|name| (name, 1)), layout::RECORDED_OUTER);
        follow(layout::RECORDED_OUTER, &OWN_OUTER_FIELDS, layout::WALL_FIELDS);
    }
    let copied = layout::COPIED_SCALARS + 2 * layout::COPIED_VECTORS;
    assert_eq!(layout::RECORDED_INNER, copied + 1, "and the clearance");
}

#[test]
fn no_constant_and_no_structure_is_left_out() {
    let compared: BTreeSet<&str> = (SHARED.map(|c| c.0).into_iter())
        .chain(INNER_SCALARS)
        .chain(INNER_VECTORS)
        .chain(OUTER_FIELDS)
        .chain(OWN_SCALARS)
        .chain(OWN_VECTORS.map(|f| f.0))
        .chain(OWN_OUTER_FIELDS.map(|f| f.0))
        .chain(OWN)
        .chain(STREAMS.map(|s| s.0))
        .chain(CONSTANTS.map(|c| c.0))
        .chain(OUTLINES.map(|c| c.0))
        .collect();
    for shader in &ALL {
        let module = parse(shader);
        for (_, constant) in module.constants.iter() {
            let name = constant.name.as_deref().unwrap_or_default();
            assert!(compared.contains(name), "{name} of {} is compared with nothing", shader.name);
        }
        // Structures that only shaders use: arguments and results of functions, and shared memory.
        let known = [
            "StepRow",
            "Batch",
            "Member",
            "Status",
            "Now",
            "Segment",
            "SegmentQuad",
            "PairTerms",
            "PairSum",
            "Reader",
            "Motion",
            "Own",
        ];
        for (_, found) in module.types.iter().filter(|(_, t)| matches!(t.inner, TypeInner::Struct { .. })) {
            let name = found.name.as_deref().unwrap_or_default();
            assert!(known.contains(&name), "{name} of {} is compared with nothing", shader.name);
        }
        // If no constant has the name that a pipeline sets, its default value would be used
        // silently.
        let set: &[&str] = match shader.name {
            "integrate" => &["EULER", "EVALUATION"],
            _ => &[],
        };
        let mut found: Vec<&str> =
            module.overrides.iter().map(|(_, o)| o.name.as_deref().unwrap_or_default()).collect();
        found.sort_unstable();
        assert_eq!(found, set, "{}", shader.name);
    }
}
