//! PLY, text or binary in either byte order: elements `vertex` (x, y, z), `face` (a list of vertex
//! indices) and `tristrips` (strips, each of which ends with −1). Other elements and properties are
//! skipped.
//!
//! A comment such as `comment patch 0 120 inner_wall` names a run of triangles by the first
//! triangle and their number.

mod body;
mod header;

use super::error::ReadError;
use super::polygons::Polygons;
use super::surface::{Group, Surface};
use super::text::without_mark;
use body::Body;
use header::{Element, Header, Property, header};

pub(super) fn parse(bytes: &[u8]) -> Result<Surface, ReadError> {
    let bytes = without_mark(bytes);
    let mut surface = Surface::default();
    let Header { encoding, elements, runs, body } = header(bytes, &mut surface)?;
    // Faces may come before the vertices that they name.
    let vertices = total(&elements, "vertex");
    let mut reader = BodyReader {
        body: Body::new(bytes, bytes.len() - body.len(), encoding),
        surface,
        polygons: Polygons::default(),
        vertices,
        faces: 0,
    };
    for element in &elements {
        match element.name.as_str() {
            "vertex" => reader.vertices(element)?,
            "face" => reader.faces(element)?,
            "tristrips" => reader.strips(element)?,
            // An element without properties has no data. Its count is not bounded by the file.
            _ if element.properties.is_empty() => {}
            _ => reader.skip(element)?,
        }
    }
    let BodyReader { body, mut surface, polygons, .. } = reader;
    polygons.split(&mut surface, |face| format!("face {face} (from 0)"))?;
    if body.rest() > 0 {
        surface.note(format!("{} bytes after the last element are passed over", body.rest()));
    }
    if total(&elements, "tristrips") == 0 && total(&elements, "face") == surface.triangles.len() {
        surface.groups = ordered_runs(runs, surface.triangles.len());
    }
    Ok(surface)
}

/// Number of elements of a name.
fn total(elements: &[Element], name: &str) -> usize {
    let of_name = elements.iter().filter(|element| element.name == name);
    of_name.fold(0, |sum, element| sum.saturating_add(element.count))
}

/// Checks that the runs of comments follow each other within the triangles, and returns those that
/// are not empty. Otherwise returns none, since the comments are not from oviduct.
fn ordered_runs(runs: Vec<Group>, triangles: usize) -> Vec<Group> {
    let mut end = 0;
    for run in &runs {
        if run.triangles.start < end || run.triangles.end > triangles {
            return Vec::new();
        }
        end = run.triangles.end;
    }
    runs.into_iter().filter(|run| !run.triangles.is_empty()).collect()
}

/// Marks the end of a strip.
const RESTART: u32 = u32::MAX;

struct BodyReader<'a> {
    body: Body<'a>,
    surface: Surface,
    polygons: Polygons,
    /// Number of vertices that the header states.
    vertices: usize,
    /// Number of faces so far.
    faces: u64,
}

impl BodyReader<'_> {
    fn vertices(&mut self, element: &Element) -> Result<(), ReadError> {
        if element.count == 0 {
            return Ok(());
        }
        let axis = |property: &Property| ["x", "y", "z"].iter().position(|name| property.name == *name);
        if (0..3).any(|wanted| !element.properties.iter().any(|p| axis(p) == Some(wanted))) {
            return Err(self.body.wrong("the vertices have no x, y or z"));
        }
        for _ in 0..element.count {
            let mut point = [0.0; 3];
            for property in &element.properties {
                let axis = axis(property);
                self.body.values(property, |value| {
                    if let Some(axis) = axis {
                        point[axis] = value;
                    }
                })?;
            }
            self.surface.add_vertex(point)?;
        }
        Ok(())
    }

    fn faces(&mut self, element: &Element) -> Result<(), ReadError> {
        let mut face = Vec::new();
        for _ in 0..element.count {
            self.corners(element, &mut face)?;
            self.corners_exist(&face)?;
            self.polygons.add(&mut self.surface, &face, self.faces)?;
            self.faces += 1;
        }
        Ok(())
    }

    fn strips(&mut self, element: &Element) -> Result<(), ReadError> {
        let mut corners = Vec::new();
        for _ in 0..element.count {
            self.corners(element, &mut corners)?;
            for strip in corners.split(|&corner| corner == RESTART) {
                self.corners_exist(strip)?;
                self.surface.add_strip(strip)?;
            }
        }
        Ok(())
    }

    fn skip(&mut self, element: &Element) -> Result<(), ReadError> {
        for _ in 0..element.count {
            for property in &element.properties {
                self.body.values(property, |_| {})?;
            }
        }
        Ok(())
    }

    /// Reads the list of vertices of one item. −1 becomes [`RESTART`].
    fn corners(&mut self, element: &Element, corners: &mut Vec<u32>) -> Result<(), ReadError> {
        let is_corners = |p: &Property| p.name == "vertex_indices" || p.name == "vertex_index";
        if !element.properties.iter().any(is_corners) {
            return Err(self.body.wrong(format!("an element {:?} has no list `vertex_indices`", element.name)));
        }
        corners.clear();
        let mut bad = None;
        for property in &element.properties {
            let is_corners = is_corners(property);
            self.body.values(property, |value| match value {
                _ if !is_corners => {}
                -1.0 => corners.push(RESTART),
                0.0..4_294_967_295.0 if value.fract() == 0.0 => corners.push(value as u32),
                _ => bad = Some(value),
            })?;
        }
        bad.map_or(Ok(()), |bad| Err(self.no_vertex(bad)))
    }

    fn corners_exist(&self, corners: &[u32]) -> Result<(), ReadError> {
        let bad = corners.iter().find(|&&corner| corner as usize >= self.vertices);
        let value = |corner: u32| if corner == RESTART { -1.0 } else { f64::from(corner) };
        bad.map_or(Ok(()), |&bad| Err(self.no_vertex(value(bad))))
    }

    fn no_vertex(&self, index: f64) -> ReadError {
        self.body.wrong(format!("there is no vertex {index}"))
    }
}
