//! Figure 8: the triangulated end caps and a piece of the mesh as a wire frame.

use super::figure::{Figure, grouped};
use super::grown::Grown;
use oviduct::generate::Summary;
use oviduct::model::{Mesh, PatchKind, Section};
use oviduct::render::{
    Drawing, MAX_SIZE, OVERSAMPLING, Panel, RenderError, View, edge_count, line_height, page_png, piece, wire_drawing,
};
use serde_json::json;

/// The paper's mesh (section 3.1): vertices, triangles, sections.
const PAPER: [u64; 3] = [790_211, 1_514_538, 201];
/// Width of edges, as a fraction of the width of the page.
const PEN: f32 = 0.0004;
/// Length of the piece in the wire frame, in widths of the tube.
const LENGTH: f64 = 1.2;
/// Side of the detail of the ampulla's cap, as a fraction of its width.
const DETAIL: f32 = 0.3;
/// Fraction of a picture that its view fills.
const FRAMED: f64 = 0.93;

pub(super) fn draw(grown: &Grown, size: u32) -> anyhow::Result<Figure> {
    let mesh = &grown.mesh;
    let caps = [PatchKind::CapIsthmus, PatchKind::CapAmpulla].map(|kind| piece(mesh, |of, _| of == kind));
    let strip = line_height(size);
    let half = size / 2;
    let square = OVERSAMPLING * (half - strip);
    let pen = PEN * (size * OVERSAMPLING) as f32;
    let end_on = |azimuth_deg| View {
        width: square,
        height: square,
        azimuth_deg,
        elevation_deg: 0.0,
        axial_scale: 1.0,
        cut: Vec::new(),
    };
    let isthmus = wire_drawing(&caps[0], &end_on(180.0), pen)?;
    let detail = detail(&caps[1], (FRAMED * f64::from(square)) as u32, pen, &end_on(0.0))?;
    let opened = opened(mesh);
    let height = size * 11 / 20;
    let side = View {
        width: OVERSAMPLING * size,
        height: OVERSAMPLING * (height - strip),
        azimuth_deg: 230.0,
        elevation_deg: 24.0,
        ..end_on(0.0)
    };
    let wires = wire_drawing(&opened, &side, pen)?;
    let panel = |place, drawing, letter| Panel { place, drawing, letter, note: "", bar: true };
    let panels = [
        panel([0, 0, half, half], &isthmus, Some('a')),
        panel([half, 0, half, half], &detail, None),
        panel([0, half + strip / 2, size, height], &wires, Some('b')),
    ];
    let png = page_png([size, half + strip / 2 + height], &panels)?;

    let Summary { vertices, triangles, sections: recorded, .. } = grown.summary;
    let points: usize = grown.sections.iter().map(Section::particles).sum();
    let count = |cap: &Mesh| (grouped(cap.triangles.len() as u64), grouped(edge_count(cap) as u64));
    let [(isthmus, isthmus_edges), (ampulla, ampulla_edges)] = [count(&caps[0]), count(&caps[1])];
    let caption = vec![
        format!(
            "(a) The end caps: that of the isthmus, {isthmus} triangles and {isthmus_edges} edges, and a detail from the middle of that of the ampulla, {ampulla} and {ampulla_edges} in all. The paper triangulates by FIST, we by a constrained Delaunay triangulation."
        ),
        "(b) A piece of the walls at the isthmus end as a wire frame, without the triangles of a quarter.".to_owned(),
        format!(
            "The mesh has {} vertices, {} of them particles of its sections, and {} triangles in {recorded} recorded sections ({}); the paper's has {} and {} in {}.",
            grouped(vertices),
            grouped(points as u64),
            grouped(triangles),
            grown.name(),
            grouped(PAPER[0]),
            grouped(PAPER[1]),
            PAPER[2]
        ),
    ];
    let numbers = json!({
        "mesh": { "vertices": vertices, "triangles": triangles, "sections": recorded, "particles": points },
        "paper": { "vertices": PAPER[0], "triangles": PAPER[1], "sections": PAPER[2] },
        "caps": {
            "isthmus": { "triangles": caps[0].triangles.len(), "edges": edge_count(&caps[0]) },
            "ampulla": { "triangles": caps[1].triangles.len(), "edges": edge_count(&caps[1]) },
        },
        "wire_frame": { "triangles": opened.triangles.len(), "edges": edge_count(&opened) },
    });
    let files = vec![("figure-8.png".to_owned(), png)];
    Ok(Figure { number: "8", title: "End caps and wire frame", files, caption, numbers })
}

/// Returns the minimum and maximum coordinates of the visible part of a mesh.
fn bounds(mesh: &Mesh, axis: usize) -> [f32; 2] {
    let used = mesh.triangles.iter().flatten().map(|&v| mesh.positions[v as usize][axis]);
    used.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
}

/// Draws a square around the middle of a cap, `side` pixels wide.
fn detail(cap: &Mesh, side: u32, pen: f32, view: &View) -> Result<Drawing, RenderError> {
    let middle_of = |mesh: &Mesh| [0, 1].map(|axis| bounds(mesh, axis)).map(|[low, high]| (low + high) / 2.0);
    let (middle, [left, right]) = (middle_of(cap), bounds(cap, 0));
    let half = DETAIL * (right - left) / 2.0;
    let reaches = |p: [f32; 3]| (0..2).all(|axis| (p[axis] - middle[axis]).abs() <= half);
    let around = piece(cap, |_, corners| corners.into_iter().any(reaches));
    // Triangles extend beyond the square, so a larger picture is drawn and the square is cut out.
    let beyond = [0, 1].map(|axis| bounds(&around, axis)).map(|[low, high]| high - low);
    let larger = f64::from(beyond[0].max(beyond[1]) / (2.0 * half)).max(1.0);
    let wide = (larger * f64::from(side) / FRAMED).ceil().min(f64::from(MAX_SIZE)) as u32;
    let drawing = wire_drawing(&around, &View { width: wide, height: wide, ..view.clone() }, pen)?;
    let pixels = |metres: f32| f64::from(metres) * 1e6 / drawing.um_per_pixel();
    let [x, y] = middle_of(&around);
    let at = [pixels(middle[0] - x), pixels(y - middle[1])].map(|off| f64::from(wide) / 2.0 + off);
    let shown = pixels(2.0 * half).min(f64::from(side)) as u32;
    Ok(drawing.around(at, [shown, shown]))
}

/// Returns the walls at the isthmus end without a quarter of the tube.
fn opened(mesh: &Mesh) -> Mesh {
    let isthmus = piece(mesh, |kind, _| kind == PatchKind::CapIsthmus);
    let ([left, right], [bottom, top]) = (bounds(&isthmus, 0), bounds(&isthmus, 1));
    let (length, middle) = (LENGTH as f32 * (right - left), [(left + right) / 2.0, (bottom + top) / 2.0]);
    piece(mesh, |kind, corners| {
        let mean = |axis: usize| corners.iter().map(|p| p[axis]).sum::<f32>() / 3.0;
        kind.is_wall() && corners.iter().all(|p| p[2] <= length) && !(mean(0) < middle[0] && mean(1) > middle[1])
    })
}
