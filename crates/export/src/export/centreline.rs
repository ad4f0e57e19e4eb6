//! Centre line of a tube: for each section the centre, the length along the line, areas and radii.
//!
//! A point is the centroid of the area within the outer contour. The centroid of a folded lumen is
//! not a useful centre, because it often lies in the tissue of a fold.

use super::Metadata;
use super::vtp::write_polyline_vtp;
use crate::geometry::course::Course;
use crate::model::{LengthUnit, Ring, Section};
use std::io::{self, Write};

/// File names: VTK XML and CSV.
pub const FILES: [&str; 2] = ["centreline.vtp", "centreline.csv"];
/// Media types of the files.
pub const MEDIA_TYPES: [&str; 2] = [super::vtp::MEDIA_TYPE, "text/csv"];

/// Values at each point: name, and power of the length unit.
///
/// - `step`: time step of the section.
/// - `arc_length`: distance from the first point along the line.
/// - `lumen_radius`, `outer_radius`: radius of the circle with the area of the lumen, or with the
///   area within the outer contour.
/// - `hydraulic_radius`: twice the area of the lumen divided by its perimeter; the radius of a
///   round tube.
const VALUES: [(&str, i32); 7] = [
    ("step", 0),
    ("arc_length", 1),
    ("lumen_radius", 1),
    ("outer_radius", 1),
    ("hydraulic_radius", 1),
    ("lumen_area", 2),
    ("lumen_perimeter", 1),
];

/// The centre line of a tube, micrometres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Centreline {
    /// One point per section.
    pub points: Vec<[f64; 3]>,
    /// The values of [`VALUES`] at each point.
    values: Vec<[f64; 7]>,
}

impl Centreline {
    /// Computes the centre line of sections. `course` is the course of a bent tube, µm.
    #[must_use]
    pub fn new(sections: &[Section], course: Option<&Course>) -> Self {
        let mut line = Self::default();
        for section in sections {
            let (inner, outer) = (ContourMoments::new(&section.inner), ContourMoments::new(&section.outer));
            let straight = [outer.centroid[0], outer.centroid[1], section.z_um];
            let point = course.map_or(straight, |course| course.place(straight).into());
            let on = |last: &[f64; 3]| (0..3).map(|axis| (point[axis] - last[axis]).powi(2)).sum::<f64>().sqrt();
            let so_far = line.values.last().map_or(0.0, |values| values[1]);
            line.values.push([
                section.step,
                so_far + line.points.last().map_or(0.0, on),
                (inner.area / std::f64::consts::PI).sqrt(),
                (outer.area / std::f64::consts::PI).sqrt(),
                2.0 * inner.area / inner.perimeter,
                inner.area,
                inner.perimeter,
            ]);
            line.points.push(point);
        }
        line
    }

    /// Each column of [`VALUES`] in a unit.
    fn columns(&self, unit: LengthUnit) -> [Vec<f64>; 7] {
        std::array::from_fn(|column| {
            let factor = scale(unit).powi(VALUES[column].1);
            self.values.iter().map(|values| values[column] * factor).collect()
        })
    }

    fn scaled_points(&self, unit: LengthUnit) -> Vec<[f64; 3]> {
        self.points.iter().map(|p| p.map(|x| x * scale(unit))).collect()
    }

    /// Writes a polyline in VTK XML.
    ///
    /// # Errors
    /// Returns any error of writing to `out`.
    pub fn write_vtp(&self, unit: LengthUnit, meta: &Metadata, out: &mut impl Write) -> io::Result<()> {
        let columns = self.columns(unit);
        let arrays: Vec<(&str, &[f64])> = VALUES.iter().zip(&columns).map(|(value, c)| (value.0, &c[..])).collect();
        write_polyline_vtp(&self.scaled_points(unit), &arrays, unit, meta, out)
    }

    /// Writes CSV with a header. The names of the columns contain the unit.
    ///
    /// # Errors
    /// Returns any error of writing to `out`.
    pub fn write_csv(&self, unit: LengthUnit, out: &mut impl Write) -> io::Result<()> {
        let unit_name = unit.name();
        let mut names = vec![format!("x_{unit_name}"), format!("y_{unit_name}"), format!("z_{unit_name}")];
        names.extend(VALUES.iter().map(|(name, power)| match power {
            0 => (*name).to_owned(),
            1 => format!("{name}_{unit_name}"),
            _ => format!("{name}_{unit_name}{power}"),
        }));
        writeln!(out, "{}", names.join(","))?;
        let columns = self.columns(unit);
        for (i, [x, y, z]) in self.scaled_points(unit).into_iter().enumerate() {
            write!(out, "{x},{y},{z}")?;
            for column in &columns {
                write!(out, ",{}", column[i])?;
            }
            writeln!(out)?;
        }
        Ok(())
    }
}

/// Factor from micrometres to a unit.
fn scale(unit: LengthUnit) -> f64 {
    unit.per_metre() * 1e-6
}

/// Area, perimeter and centroid of a simple contour.
struct ContourMoments {
    area: f64,
    perimeter: f64,
    centroid: [f64; 2],
}

impl ContourMoments {
    fn new(ring: &Ring) -> Self {
        let points: Vec<[f64; 2]> = ring.points.iter().map(|p| p.map(f64::from)).collect();
        // Coordinates relative to a vertex keep the precision of small contours far from the
        // origin.
        let origin = points.first().copied().unwrap_or_default();
        let (mut area, mut perimeter, mut moment) = (0.0, 0.0, [0.0; 2]);
        for (a, b) in points.iter().zip(points.iter().cycle().skip(1)) {
            // The result of `hypot` depends on the C library.
            perimeter += ((b[0] - a[0]).powi(2) + (b[1] - a[1]).powi(2)).sqrt();
            let (a, b) = ([a[0] - origin[0], a[1] - origin[1]], [b[0] - origin[0], b[1] - origin[1]]);
            let cross = a[0] * b[1] - a[1] * b[0];
            area += cross / 2.0;
            for axis in 0..2 {
                moment[axis] += cross * (a[axis] + b[axis]) / 6.0;
            }
        }
        Self { area, perimeter, centroid: [0, 1].map(|axis| origin[axis] + moment[axis] / area) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::tests::meta;
    use std::f64::consts::TAU;

    fn circle(n: u32, radius: f64, centre: [f64; 2]) -> Ring {
        let point = |i: u32| {
            let angle = TAU * f64::from(i) / f64::from(n);
            [(centre[0] + radius * angle.cos()) as f32, (centre[1] + radius * angle.sin()) as f32]
        };
        Ring { ids: (0..n).collect(), points: (0..n).map(point).collect() }
    }

    fn tube() -> Vec<Section> {
        let section = |k: u32| {
            let centre = [30.0 * f64::from(k), 40.0 * f64::from(k)];
            Section {
                step: f64::from(k),
                z_um: 120.0 * f64::from(k),
                inner: circle(720, 200.0, centre),
                outer: circle(720, 500.0, centre),
                ..Section::default()
            }
        };
        (0..4).map(section).collect()
    }

    #[test]
    fn a_leaning_round_tube_has_its_axis_and_radii() {
        let line = Centreline::new(&tube(), None);
        for (k, p) in line.points.iter().enumerate() {
            let k = k as f64;
            assert!((p[0] - 30.0 * k).abs() < 1e-3 && (p[1] - 40.0 * k).abs() < 1e-3 && p[2] == 120.0 * k, "{p:?}");
            assert!((line.values[k as usize][1] - 130.0 * k).abs() < 1e-2);
            assert!((line.values[k as usize][2] - 200.0).abs() < 0.01);
            assert!((line.values[k as usize][3] - 500.0).abs() < 0.02);
            assert!((line.values[k as usize][4] - 200.0).abs() < 0.01);
        }
    }

    #[test]
    fn the_table_states_its_unit() {
        let mut csv = Vec::new();
        Centreline::new(&tube(), None).write_csv(LengthUnit::Millimetre, &mut csv).unwrap();
        let csv = String::from_utf8(csv).unwrap();
        let mut lines = csv.lines();
        assert_eq!(
            lines.next(),
            Some(
                "x_mm,y_mm,z_mm,step,arc_length_mm,lumen_radius_mm,outer_radius_mm,hydraulic_radius_mm,lumen_area_mm2,lumen_perimeter_mm"
            )
        );
        let last: Vec<f64> = lines.last().unwrap().split(',').map(|x| x.parse().unwrap()).collect();
        assert!((last[2] - 0.36).abs() < 1e-12 && last[3] == 3.0 && (last[4] - 0.39).abs() < 1e-5);
        assert!((last[8] - std::f64::consts::PI * 0.04).abs() < 1e-4, "{last:?}");
    }

    #[test]
    fn the_polyline_is_written() {
        let mut file = Vec::new();
        Centreline::new(&tube(), None).write_vtp(LengthUnit::Micrometre, &meta(), &mut file).unwrap();
        let head = String::from_utf8_lossy(&file);
        assert!(VALUES.iter().all(|(name, _)| head.contains(&format!("Name=\"{name}\""))));
    }
}
