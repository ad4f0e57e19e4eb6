//! Contents of a certificate.

use crate::geometry::bvh::WIDTH as LANES;
use serde::Serialize;

/// Micrometres in a metre.
pub(super) const METRE_UM: f64 = 1e6;

/// Maximum number of places per kind of failure.
pub(super) const PLACES: usize = 16;

/// Maximum number of components in a certificate.
pub(super) const BODIES: usize = 256;

/// Certificate of a surface. For the tissue of a generated model, it also covers the sections.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Certificate {
    /// True if there are no failures.
    pub passed: bool,
    /// True if there are no open edges: each edge belongs to at least two triangles.
    pub closed: bool,
    /// True if each edge belongs to exactly two triangles, and the triangles at each vertex form
    /// one closed fan.
    pub manifold: bool,
    /// True if the two triangles at each edge run along it in opposite directions.
    pub oriented: bool,
    /// Euler number of all components together: vertices − edges + triangles.
    pub euler: i64,
    /// Number of components: parts that are connected by vertices.
    pub components: u64,
    /// The first 256 components, in the order of their first vertices.
    pub bodies: Vec<Component>,
    /// Number of vertices that belong to triangles.
    pub vertices: u64,
    /// Number of triangles.
    pub triangles: u64,
    /// Number of edges that belong to only one triangle.
    pub open_edges: u64,
    /// Number of edges that belong to more than two triangles.
    pub non_manifold_edges: u64,
    /// Number of vertices whose triangles form more than one fan.
    pub non_manifold_vertices: u64,
    /// Number of edges along which two triangles run in the same direction.
    pub disoriented_edges: u64,
    /// Number of triangles whose area is exactly zero.
    pub degenerate_triangles: u64,
    /// Number of pairs of triangles with the same three vertices.
    pub duplicate_triangles: u64,
    /// Number of pairs of edges of one section that touch or cross other than as neighbours, plus
    /// the number of inner contours that are not inside the outer contour.
    pub section_crossings: u64,
    /// Number of pairs of triangles that intersect outside their shared vertices and edges. The
    /// search stops after 100,000 pairs that are found one by one. The number is then a lower
    /// bound, and the failure says so.
    pub triangle_intersections: u64,
    /// Minimum distance between a vertex and an edge of the same section that does not end at this
    /// vertex, over both contours, micrometres; null without sections.
    pub min_gap_um: Option<f64>,
    /// Value of `min_gap_um` for each section.
    #[serde(skip)]
    pub section_gaps_um: Vec<Option<f64>>,
    /// Length of the shortest edge, micrometres.
    pub min_edge_um: f64,
    /// Smallest angle of a triangle, degrees.
    pub min_angle_deg: f64,
    /// Histograms of the shapes of the triangles.
    pub quality: TriangleQuality,
    /// Enclosed volume. Components that are inside out, such as cavities, count as negative.
    pub volume_mm3: f64,
    /// Area of the surface.
    pub area_mm2: f64,
    /// Minimum and maximum of each coordinate, micrometres.
    pub bounds_um: [[f64; 3]; 2],
    /// The failures, at most one entry per kind.
    pub failures: Vec<Failure>,
}

impl Certificate {
    /// The first failure in one line, with its place.
    #[must_use]
    pub fn first_failure(&self) -> Option<String> {
        self.failures.first().map(ToString::to_string)
    }

    pub(super) fn conclude(mut self, failures: Failures) -> Self {
        self.failures = failures.0;
        self.passed = self.failures.is_empty();
        self
    }
}

/// Shapes of the triangles of a surface, which affect solvers.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct TriangleQuality {
    /// Number of triangles by smallest angle: 0 to 5 degrees, 5 to 10, and so on to 55 to 60.
    pub least_angles: [u64; 12],
    /// Number of triangles by the ratio of the longest edge to the shortest: 1 to 1.5, 1.5 to 2,
    /// and so on to 5.5 to 6, then 6 and above.
    pub edge_ratios: [u64; 11],
    /// Fraction of the triangles whose smallest angle is at least 20 degrees.
    pub least_angles_from_20: f64,
    /// Fraction of the triangles whose longest edge is less than 4 times as long as the shortest.
    pub edge_ratios_to_4: f64,
}

impl TriangleQuality {
    /// Counts the triangles of the first `count` lanes, given the squared tangents of their
    /// smallest angles and the squared ratios of their edges.
    #[inline(always)]
    pub(super) fn count(&mut self, tan_squared: &[f64; LANES], ratio_squared: &[f64; LANES], count: usize) {
        let (angles, ratios) = (passed(&TAN_SQUARED, tan_squared), passed(&RATIO_SQUARED, ratio_squared));
        for lane in 0..count {
            self.least_angles[angles[lane] as usize] += 1;
            self.edge_ratios[ratios[lane] as usize] += 1;
        }
    }

    /// Adds the counts of other triangles.
    pub(super) fn add(&mut self, other: &Self) {
        self.least_angles.iter_mut().zip(other.least_angles).for_each(|(sum, count)| *sum += count);
        self.edge_ratios.iter_mut().zip(other.edge_ratios).for_each(|(sum, count)| *sum += count);
    }

    /// Computes the shares from the counts.
    pub(super) fn shared(mut self) -> Self {
        let all = self.least_angles.iter().sum::<u64>().max(1) as f64;
        self.least_angles_from_20 = self.least_angles[4..].iter().sum::<u64>() as f64 / all;
        self.edge_ratios_to_4 = self.edge_ratios[..6].iter().sum::<u64>() as f64 / all;
        self
    }
}

/// Squares of the tangents of 5, 10, up to 55 degrees.
const TAN_SQUARED: [f64; 11] = [
    0.007_654_266_246,
    0.031_091_204_126,
    0.071_796_769_724,
    0.132_474_331_432,
    0.217_442_832_054,
    0.333_333_333_333,
    0.490_290_596_566,
    0.704_088_191_042,
    1.0,
    1.420_276_625_461,
    2.039_606_729_161,
];
/// Squares of 1.5, 2, up to 6.
const RATIO_SQUARED: [f64; 10] = [2.25, 4.0, 6.25, 9.0, 12.25, 16.0, 20.25, 25.0, 30.25, 36.0];

/// Number of limits that each value has reached.
#[inline(always)]
fn passed(limits: &[f64], values: &[f64; LANES]) -> [u64; LANES] {
    let mut passed = [0; LANES];
    for limit in limits {
        for lane in 0..LANES {
            passed[lane] += u64::from(*limit <= values[lane]);
        }
    }
    passed
}

/// Component: a connected part of a surface.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Component {
    /// Number of vertices.
    pub vertices: u64,
    /// Number of triangles.
    pub triangles: u64,
    /// Euler number (vertices − edges + triangles): 2 for a ball, 0 for a ring.
    pub euler: i64,
    /// Enclosed volume; negative if the component is inside out.
    pub volume_mm3: f64,
}

/// Kinds of failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum FailureKind {
    /// No triangles.
    Empty,
    /// A triangle names a vertex that does not exist.
    Indices,
    /// A coordinate is not finite or outside the range of the exact tests.
    Coordinates,
    /// A ring of a section has fewer than three points.
    SectionRing,
    /// A ring of a section crosses or touches itself or the other ring.
    SectionCrossing,
    /// The inner ring of a section is not inside the outer one.
    SectionNesting,
    /// Number of edges that belong to only one triangle.
    OpenEdges,
    /// Number of edges that belong to more than two triangles.
    NonManifoldEdges,
    /// Vertices at which several fans of triangles touch.
    NonManifoldVertices,
    /// Neighbouring triangles of opposite orientation.
    Orientation,
    /// A body that is inside out.
    Volume,
    /// A body within the material of another.
    Overlap,
    /// Triangles without area.
    DegenerateTriangles,
    /// Triangles with the same vertices.
    DuplicateTriangles,
    /// Triangles that intersect.
    TriangleIntersections,
    /// More components than the body may have.
    Components,
    /// An Euler number other than the required one.
    Euler,
    /// Tissue and lumen that do not share their wall, vertex for vertex, or together do not fill
    /// the outside.
    Conformity,
}

/// A failed test of a certificate.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Failure {
    /// Kind of the failure.
    pub kind: FailureKind,
    /// Number of occurrences.
    pub count: u64,
    /// Description of the failure.
    pub detail: String,
    /// Places of the first 16 occurrences.
    pub places: Vec<Place>,
}

impl std::fmt::Display for Failure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.detail)?;
        let Some(place) = self.places.first() else { return Ok(()) };
        let [x, y, z] = place.position_um;
        write!(f, ", first at ({x:.3}, {y:.3}, {z:.3}) µm")?;
        if let Some(section) = place.section {
            write!(f, " in section {section}")?;
        }
        match place.triangles.as_slice() {
            [] => Ok(()),
            [one] => write!(f, ", triangle {one}"),
            [one, two, ..] => write!(f, ", triangles {one} and {two}"),
        }
    }
}

/// Place of a failure.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Place {
    /// Position; `z` is the place along the tube.
    pub position_um: [f64; 3],
    /// Indices of the triangles concerned.
    pub triangles: Vec<u32>,
    /// Index of the section concerned.
    pub section: Option<u32>,
}

impl Place {
    pub(super) fn at(position_um: [f64; 3]) -> Self {
        Self { position_um, ..Self::default() }
    }
}

/// Requirements and units of [`check_surface`](super::check_surface).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CheckOptions {
    /// Euler number that each component must have; `None` for any.
    pub euler: Option<i64>,
    /// Metres per unit of the positions. Affects measures only, not decisions.
    pub unit_metres: f64,
}

impl Default for CheckOptions {
    fn default() -> Self {
        Self { euler: None, unit_metres: 1.0 }
    }
}

/// Failures found so far, at most one per kind.
#[derive(Default)]
pub(super) struct Failures(pub(super) Vec<Failure>);

impl Failures {
    /// Adds a failure unless `count` is zero.
    pub(super) fn add(&mut self, kind: FailureKind, count: u64, detail: String, places: Vec<Place>) {
        if count > 0 {
            self.0.push(Failure { kind, count, detail, places });
        }
    }
}
