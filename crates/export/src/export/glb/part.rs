//! A patch of a glTF file. Its triangles are traversed once to count vertices and once for each
//! array, so that only the vertices in use have to be kept in memory.

use super::scene::index_type;
use super::skin::Skin;
use crate::export::chunks::{join, vec3, write_items};
use crate::export::shape::{NamedPatch, Shape, TriangleRun};
use crate::geometry::patch::{Numbering, add, doubled_area_normal, unit};
use crate::geometry::strips::{join_strips, strips};
use gltf_json::accessor::ComponentType;
use std::io::{self, Write};

/// A patch and the numbers that the document states about it. Vertices are numbered in the order of
/// their first use. As in [`patch_geometry`](crate::geometry::patch::patch_geometry), their normals
/// depend only on the triangles of the patch.
pub(super) struct PatchWriter<'a> {
    pub(super) name: &'a str,
    positions: &'a [[f32; 3]],
    runs: Vec<TriangleRun<'a>>,
    pub(super) vertices: usize,
    triangles: usize,
    /// Exact minimum and maximum of the coordinates.
    pub(super) bounds: ([f32; 3], [f32; 3]),
    /// One strip for the whole patch, if strips are requested.
    pub(super) strip: Option<Vec<u32>>,
    skin: Option<&'a Skin<'a>>,
}

impl<'a> PatchWriter<'a> {
    pub(super) fn new(
        surface: &'a Shape<'_>,
        patch: &NamedPatch<'a>,
        as_strip: bool,
        skin: Option<&'a Skin<'a>>,
    ) -> Self {
        let mut part = Self {
            name: patch.name,
            positions: surface.positions,
            runs: surface.runs(patch),
            vertices: 0,
            triangles: patch.triangles.len(),
            bounds: ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]),
            strip: None,
            skin,
        };
        let (min, max) = &mut part.bounds;
        let mut numbering = Numbering::default();
        let mut kept = Vec::new();
        for run in &part.runs {
            numbering.advance(run.vertices.start, run.vertices.len());
            for triangle in run.triangles {
                let local = triangle.map(|vertex| {
                    let (local, is_new) = numbering.number(vertex);
                    if is_new {
                        for (axis, x) in surface.positions[vertex as usize].into_iter().enumerate() {
                            min[axis] = min[axis].min(x);
                            max[axis] = max[axis].max(x);
                        }
                    }
                    local
                });
                if as_strip {
                    kept.push(local);
                }
            }
        }
        part.vertices = numbering.count() as usize;
        part.strip = as_strip.then(|| join_strips(&strips(&kept)));
        part
    }

    pub(super) fn index_count(&self) -> usize {
        self.strip.as_ref().map_or(self.triangles * 3, Vec::len)
    }

    pub(super) fn index_type(&self) -> ComponentType {
        index_type(self.vertices)
    }

    /// Writes positions, normals, texture coordinates if there are any, and indices, with the
    /// lengths that the document states.
    pub(super) fn write(&self, out: &mut impl Write) -> io::Result<()> {
        self.walk(|run, numbering| {
            let vertices = run.triangles.as_flattened().iter();
            write_items(vertices.filter(|&&v| numbering.number(v).1), out, |&v| vec3(self.positions[v as usize]))
        })?;
        self.write_normals(out)?;
        if let Some(skin) = self.skin {
            self.walk(|run, numbering| {
                let vertices = run.triangles.as_flattened().iter();
                write_items(vertices.filter(|&&v| numbering.number(v).1), out, |&v| {
                    join::<8>(skin.coordinates(self.name, v).map(f32::to_le_bytes))
                })
            })?;
        }
        self.write_indices(out)
    }

    /// Writes the normals. A sum is written as soon as no later triangle can add to it.
    fn write_normals(&self, out: &mut impl Write) -> io::Result<()> {
        // Vertices from the local number `written` on, with the sums of the normals around them.
        let (mut written, mut sums) = (0, Vec::<(u32, [f64; 3])>::new());
        let bytes = |(_, sum)| vec3(unit(sum));
        self.walk(|run, numbering| {
            let done = sums.iter().take_while(|(vertex, _)| *vertex < run.vertices.start).count();
            write_items(sums.drain(..done), out, bytes)?;
            written += done;
            for &triangle in run.triangles {
                let normal = doubled_area_normal(triangle.map(|v| self.positions[v as usize]));
                for vertex in triangle {
                    let (local, is_new) = numbering.number(vertex);
                    if is_new {
                        sums.push((vertex, [0.0; 3]));
                    }
                    add(&mut sums[local as usize - written].1, normal);
                }
            }
            Ok(())
        })?;
        write_items(sums, out, bytes)
    }

    fn write_indices(&self, out: &mut impl Write) -> io::Result<()> {
        let is_short = self.index_type() == ComponentType::U16;
        let short = |index: u32| (index as u16).to_le_bytes();
        match &self.strip {
            Some(strip) if is_short => write_items(strip, out, |&index| short(index)),
            Some(strip) => write_items(strip, out, |&index| index.to_le_bytes()),
            None => self.walk(|run, numbering| {
                let triangles = run.triangles.iter().map(|t| t.map(|vertex| numbering.number(vertex).0));
                if is_short {
                    write_items(triangles, out, |t| join::<6>(t.map(short)))
                } else {
                    write_items(triangles, out, |t| join::<12>(t.map(u32::to_le_bytes)))
                }
            }),
        }?;
        let bytes = self.index_count() * self.index_type().size();
        out.write_all(&[0; 4][..bytes.next_multiple_of(4) - bytes])
    }

    /// Calls `each` for all runs of the patch, with the numbers of their vertices.
    fn walk(&self, mut each: impl FnMut(&TriangleRun<'_>, &mut Numbering) -> io::Result<()>) -> io::Result<()> {
        let mut numbering = Numbering::default();
        for run in &self.runs {
            numbering.advance(run.vertices.start, run.vertices.len());
            each(run, &mut numbering)?;
        }
        Ok(())
    }
}
