//! A contraction as one animated binary glTF file. The first frame is the surface. Every other
//! frame is a morph target (displacements of positions and normals). The animation runs through all
//! frames and returns to the first one.

use super::Metadata;
use super::chunks::{vec3, write_items};
use super::glb::scene::{Layout, Scene, buffer, primitive, write_head};
use crate::geometry::patch::{PatchGeometry, patch_geometry};
use crate::model::Mesh;
use gltf_json as json;
use json::accessor::{ComponentType, Type};
use json::animation::{Channel, Interpolation, Property, Sampler, Target};
use json::buffer::Target as BufferTarget;
use json::validation::Checked;
use serde_json::{Map, Value, json};
use std::io::{self, Write};

/// File name.
pub const FILE: &str = "animation.glb";

/// Two or more frames of one period, which differ only in positions.
pub struct Frames<'a> {
    /// First frame.
    pub first: &'a Mesh,
    /// Positions of the other frames, metres.
    pub others: &'a [Vec<[f32; 3]>],
    /// Period, seconds.
    pub period_s: f64,
}

/// A patch with its morph targets.
struct MorphPatch {
    geometry: PatchGeometry,
    name: &'static str,
    /// Displacements of positions and normals, by frame.
    targets: Vec<[Vec<[f32; 3]>; 2]>,
    positions: Vec<[f32; 3]>,
}

impl MorphPatch {
    /// All patches that have triangles.
    fn all(frames: &Frames<'_>) -> Vec<Self> {
        let patches = frames.first.patches.iter().filter(|patch| !patch.triangles.is_empty());
        let of = |patch| {
            let geometry = patch_geometry(frames.first, patch);
            let at = |positions: &[[f32; 3]]| geometry.vertices.iter().map(|&v| positions[v as usize]).collect();
            let positions: Vec<[f32; 3]> = at(&frames.first.positions);
            let target = |moved: &Vec<[f32; 3]>| {
                let mesh = Mesh { positions: moved.clone(), ..frames.first.clone() };
                let normals = patch_geometry(&mesh, patch).normals;
                [differences(&at(moved), &positions), differences(&normals, &geometry.normals)]
            };
            let targets = frames.others.iter().map(target).collect();
            Self { name: patch.kind.name(), targets, positions, geometry }
        };
        patches.map(of).collect()
    }
}

/// Writes the frames. `meta` and `more` become members of the asset's extras.
///
/// # Errors
/// Returns any error of writing to `out`, and [`io::ErrorKind::InvalidInput`] if the file would
/// exceed 4 GiB.
pub fn write_animation(
    frames: &Frames<'_>,
    meta: &Metadata,
    more: Map<String, Value>,
    out: &mut impl Write,
) -> io::Result<()> {
    let parts = MorphPatch::all(frames);
    let mut scene = Scene::new(frames.first.body.name(), format!("oviduct {}", meta.engine), Some(meta), more)?;
    let mut layout = Layout::new(&mut scene.root);
    for part in &parts {
        let root = &mut scene.root;
        let positions = push_vectors(&mut layout, root, &part.positions, true);
        let normals = push_vectors(&mut layout, root, &part.geometry.normals, false);
        let (count, target) = (3 * part.geometry.triangles.len(), BufferTarget::ElementArrayBuffer);
        let indices = layout.append(root, Type::Scalar, ComponentType::U32, count, Some(target));
        let indices = root.push(indices);
        let target = |[positions, normals]: &[Vec<[f32; 3]>; 2]| json::mesh::MorphTarget {
            positions: Some(push_vectors(&mut layout, root, positions, true)),
            normals: Some(push_vectors(&mut layout, root, normals, false)),
            tangents: None,
        };
        let targets = part.targets.iter().map(target).collect();
        let primitive = json::mesh::Primitive {
            targets: Some(targets),
            ..primitive(json::mesh::Mode::Triangles, positions, normals, indices)
        };
        scene.add_patch(part.name, primitive)?;
    }
    let Mesh { positions, triangles, .. } = frames.first;
    let mut root = scene.finish(positions.len(), triangles.len(), json::Node::default())?;

    let steps = frames.others.len() + 1;
    let times: Vec<f32> = (0..=steps).map(|k| (frames.period_s * k as f64 / steps as f64) as f32).collect();
    let mut input = layout.append(&mut root, Type::Scalar, ComponentType::F32, times.len(), None);
    (input.min, input.max) = (Some(json!([times[0]])), Some(json!([times[steps]])));
    let input = root.push(input);
    // At its time, a frame has weight 1 and all others 0. The first frame is no target, so all
    // weights are 0.
    let weights: Vec<f32> =
        (0..=steps).flat_map(|k| (1..steps).map(move |target| if k == target { 1.0 } else { 0.0 })).collect();
    let output = layout.append(&mut root, Type::Scalar, ComponentType::F32, weights.len(), None);
    let output = root.push(output);
    let sampler =
        Sampler { input, output, interpolation: Checked::Valid(Interpolation::Linear), extensions: None, extras: None };
    let moving = (0u32..).zip(&root.nodes).filter(|(_, node)| node.mesh.is_some());
    let channel = |(node, _): (u32, &json::Node)| Channel {
        sampler: json::Index::new(0),
        target: Target {
            node: json::Index::new(node),
            path: Checked::Valid(Property::MorphTargetWeights),
            extensions: None,
            extras: None,
        },
        extensions: None,
        extras: None,
    };
    let channels = moving.map(channel).collect();
    root.animations.push(json::Animation {
        channels,
        samplers: vec![sampler],
        name: Some("contraction".into()),
        extensions: None,
        extras: None,
    });
    root.buffers[0] = buffer(layout.length);

    write_head(&root, layout.length, out)?;
    for part in &parts {
        write_items(&part.positions, out, |p| vec3(*p))?;
        write_items(&part.geometry.normals, out, |p| vec3(*p))?;
        write_items(part.geometry.triangles.as_flattened(), out, |v| v.to_le_bytes())?;
        for target in part.targets.iter().flatten() {
            write_items(target, out, |p| vec3(*p))?;
        }
    }
    write_items(times.iter().chain(&weights), out, |x| x.to_le_bytes())
}

/// Adds an accessor for one vector per vertex. `bounded` states their minimum and maximum, which
/// the format requires of positions.
fn push_vectors(
    layout: &mut Layout,
    root: &mut json::Root,
    vectors: &[[f32; 3]],
    bounded: bool,
) -> json::Index<json::Accessor> {
    let target = Some(BufferTarget::ArrayBuffer);
    let mut accessor = layout.append(root, Type::Vec3, ComponentType::F32, vectors.len(), target);
    if bounded {
        let fold = |from: f32, pick: fn(f32, f32) -> f32| {
            [0, 1, 2].map(|axis| vectors.iter().map(|v| v[axis]).fold(from, pick))
        };
        accessor.min = Some(json!(fold(f32::INFINITY, f32::min)));
        accessor.max = Some(json!(fold(f32::NEG_INFINITY, f32::max)));
    }
    root.push(accessor)
}

fn differences(a: &[[f32; 3]], b: &[[f32; 3]]) -> Vec<[f32; 3]> {
    a.iter().zip(b).map(|(a, b)| [0, 1, 2].map(|axis| a[axis] - b[axis])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sample;

    #[test]
    fn each_frame_is_a_target_that_alone_has_weight_at_its_time() {
        let first = sample::tube(12, 2, 0.2);
        let other = |by: f32| first.positions.iter().map(|p| [p[0], p[1], p[2] * by]).collect();
        let others = [other(0.9), other(0.8)];
        let frames = Frames { first: &first, others: &others, period_s: 3.0 };
        let meta = Metadata {
            preset: "pig".into(),
            seed: 1,
            digest: "d".into(),
            engine: "e".into(),
            length_mm: 4.0,
            sections: 3,
        };
        let mut file = Vec::new();
        write_animation(&frames, &meta, Map::new(), &mut file).unwrap();
        let gltf = gltf::Gltf::from_slice(&file).unwrap();
        let data = gltf.blob.as_deref().unwrap();
        let animation = gltf.animations().next().unwrap();
        assert_eq!(animation.channels().count(), 4);
        for channel in animation.channels() {
            let reader = channel.reader(|_| Some(data));
            let times: Vec<f32> = reader.read_inputs().unwrap().collect();
            assert_eq!(times, [0.0, 1.0, 2.0, 3.0]);
            let Some(gltf::animation::util::ReadOutputs::MorphTargetWeights(weights)) = reader.read_outputs() else {
                panic!("no weights")
            };
            assert_eq!(weights.into_f32().collect::<Vec<_>>(), [0., 0., 1., 0., 0., 1., 0., 0.]);
            let mesh = channel.target().node().mesh().unwrap();
            let primitive = mesh.primitives().next().unwrap();
            assert_eq!(primitive.material().pbr_metallic_roughness().metallic_factor(), 0.0);
            let reader = primitive.reader(|_| Some(data));
            let base: Vec<[f32; 3]> = reader.read_positions().unwrap().collect();
            let targets: Vec<_> = reader.read_morph_targets().collect();
            assert_eq!(targets.len(), 2);
            for (target, by) in targets.into_iter().zip([0.9, 0.8]) {
                let moved = target.0.unwrap().zip(&base).map(|(d, p)| (d[2] + p[2], p[2] * by));
                moved.for_each(|(a, b)| assert!((a - b).abs() < 1e-9));
                assert_eq!(target.1.unwrap().count(), base.len());
            }
        }
    }
}
