//! The centre line: for each section the centre of the tube, the length along the line, areas and radii.
//!
//! A point is the centroid of the area within the outer contour. The lumen of a folded tube has no centre of its own: its
//! centroid often lies in the tissue of a fold.

use super::Metadata;
use super::vtp::write_polyline_vtp;
use crate::geometry::course::Course;
use crate::model::{LengthUnit, Ring, Section};
use std::io::{self, Write};

/// Names of the files: VTK XML and CSV.
pub const FILES: [&str; 2] = ["centreline.vtp", "centreline.csv"];
/// Media types of the files.
pub const MEDIA_TYPES: [&str; 2] = [super::vtp::MEDIA_TYPE, "text/csv"];

/// Names of the values at each point, in the order of [`Centreline::values`]; lengths and areas are in the unit of the file.
const NAMES: [&str; 7] =
    ["step", "arc_length", "lumen_radius", "outer_radius", "hydraulic_radius", "lumen_area", "lumen_perimeter"];

/// The centre line of a tube, micrometres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Centreline {
    /// A point for each section.
    pub points: Vec<[f64; 3]>,
    /// Time steps of the sections.
    step: Vec<f64>,
    /// Distance from the first point along the line.
    arc_length: Vec<f64>,
    /// Radius of the circle with the area of the lumen.
    lumen_radius: Vec<f64>,
    /// Radius of the circle with the area within the outer contour.
    outer_radius: Vec<f64>,
    /// Twice the area of the lumen over its perimeter: the radius of a round tube.
    hydraulic_radius: Vec<f64>,
    lumen_area: Vec<f64>,
    lumen_perimeter: Vec<f64>,
}

impl Centreline {
    /// The centre line through sections, of a tube that follows a course, µm, if there is one.
    #[must_use]
    pub fn of(sections: &[Section], course: Option<&Course>) -> Self {
        let mut line = Self::default();
        for section in sections {
            let (inner, outer) = (Extent::of(&section.inner), Extent::of(&section.outer));
            let straight = [outer.centroid[0], outer.centroid[1], section.z_um];
            let point = course.map_or(straight, |course| course.place(straight).into());
            let on = |last: &[f64; 3]| (0..3).map(|axis| (point[axis] - last[axis]).powi(2)).sum::<f64>().sqrt();
            let so_far = line.arc_length.last().copied().unwrap_or(0.0);
            line.arc_length.push(so_far + line.points.last().map_or(0.0, on));
            line.points.push(point);
            line.step.push(section.step);
            line.lumen_radius.push((inner.area / std::f64::consts::PI).sqrt());
            line.outer_radius.push((outer.area / std::f64::consts::PI).sqrt());
            line.hydraulic_radius.push(2.0 * inner.area / inner.perimeter);
            line.lumen_area.push(inner.area);
            line.lumen_perimeter.push(inner.perimeter);
        }
        line
    }

    /// The values at the points, in a unit.
    fn values(&self, unit: LengthUnit) -> [Vec<f64>; 7] {
        let scaled = |values: &[f64], power: i32| values.iter().map(|x| x * scale(unit).powi(power)).collect();
        [
            self.step.clone(),
            scaled(&self.arc_length, 1),
            scaled(&self.lumen_radius, 1),
            scaled(&self.outer_radius, 1),
            scaled(&self.hydraulic_radius, 1),
            scaled(&self.lumen_area, 2),
            scaled(&self.lumen_perimeter, 1),
        ]
    }

    fn scaled_points(&self, unit: LengthUnit) -> Vec<[f64; 3]> {
        self.points.iter().map(|p| p.map(|x| x * scale(unit))).collect()
    }

    /// Writes it as a polyline in VTK XML.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write_vtp(&self, unit: LengthUnit, meta: &Metadata, out: &mut impl Write) -> io::Result<()> {
        let values = self.values(unit);
        let arrays: Vec<(&str, &[f64])> = NAMES.into_iter().zip(values.iter().map(Vec::as_slice)).collect();
        write_polyline_vtp(&self.scaled_points(unit), &arrays, unit, Some(meta), out)
    }

    /// Writes it as CSV with a header; the unit is in the names of the columns.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write_csv(&self, unit: LengthUnit, out: &mut impl Write) -> io::Result<()> {
        let unit_name = unit.name();
        let mut names = vec![format!("x_{unit_name}"), format!("y_{unit_name}"), format!("z_{unit_name}")];
        names.extend(NAMES.iter().map(|name| match *name {
            "step" => (*name).to_owned(),
            "lumen_area" => format!("{name}_{unit_name}2"),
            _ => format!("{name}_{unit_name}"),
        }));
        writeln!(out, "{}", names.join(","))?;
        let values = self.values(unit);
        for (i, [x, y, z]) in self.scaled_points(unit).into_iter().enumerate() {
            write!(out, "{x},{y},{z}")?;
            for column in &values {
                write!(out, ",{}", column[i])?;
            }
            writeln!(out)?;
        }
        Ok(())
    }
}

/// Units in a micrometre.
fn scale(unit: LengthUnit) -> f64 {
    unit.per_metre() * 1e-6
}

/// Area, perimeter and centroid of a simple contour.
struct Extent {
    area: f64,
    perimeter: f64,
    centroid: [f64; 2],
}

impl Extent {
    fn of(ring: &Ring) -> Self {
        let points: Vec<[f64; 2]> = ring.points.iter().map(|p| p.map(f64::from)).collect();
        // Relative to a vertex, small contours far from the origin lose no digits.
        let origin = points.first().copied().unwrap_or_default();
        let (mut area, mut perimeter, mut moment) = (0.0, 0.0, [0.0; 2]);
        for (a, b) in points.iter().zip(points.iter().cycle().skip(1)) {
            // `hypot` rounds otherwise in other C libraries.
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
        let line = Centreline::of(&tube(), None);
        for (k, p) in line.points.iter().enumerate() {
            let k = k as f64;
            assert!((p[0] - 30.0 * k).abs() < 1e-3 && (p[1] - 40.0 * k).abs() < 1e-3 && p[2] == 120.0 * k, "{p:?}");
            assert!((line.arc_length[k as usize] - 130.0 * k).abs() < 1e-2);
            assert!((line.lumen_radius[k as usize] - 200.0).abs() < 0.01);
            assert!((line.outer_radius[k as usize] - 500.0).abs() < 0.02);
            assert!((line.hydraulic_radius[k as usize] - 200.0).abs() < 0.01);
        }
    }

    #[test]
    fn the_table_states_its_unit() {
        let mut csv = Vec::new();
        Centreline::of(&tube(), None).write_csv(LengthUnit::Millimetre, &mut csv).unwrap();
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
        Centreline::of(&tube(), None).write_vtp(LengthUnit::Micrometre, &meta(), &mut file).unwrap();
        let head = String::from_utf8_lossy(&file);
        assert!(NAMES.iter().all(|name| head.contains(&format!("Name=\"{name}\""))));
    }
}
