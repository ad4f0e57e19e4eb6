//! `oviduct cut --solid`: writes the part of a surface on one side of a plane, or between two
//! planes, as a closed surface.

use super::target::Target;
use super::{folder, surface};
use crate::cli::args::{CutArgs, Side};
use crate::cli::{term, units};
use crate::export::convert::Converted;
use crate::export::read::Surface;
use crate::geometry::cut::{HalfError, HalfSpace};
use crate::measure::{Certificate, CheckOptions, check_surface};
use crate::model::{LengthUnit, Plane};
use anyhow::{Context, anyhow, bail};

/// Distances by which the plane moves if the half at its place is unsound, in steps.
const STEPS: [f64; 5] = [0.0, 1.0, -1.0, 3.0, -3.0];
/// Length of a step, divided by the largest coordinate: a few last places of single precision.
const STEP: f64 = 1e-6;

/// Writes the solid. Returns the lines about it.
pub(super) fn make(args: &CutArgs, plane: &Plane, target: &Target) -> anyhow::Result<Vec<String>> {
    let shown = args.file.display();
    folder::verify(&args.file)?;
    let surface = surface::read_aloud(&args.file, args.unit).with_context(|| shown.to_string())?;
    let whole = Converted::new(&surface, target.unit, &target.stem);
    let (found, certificate, moved) = solid(&whole, &surface, args, plane, target.unit)?;
    if moved != 0.0 {
        let um = moved * target.unit.metres() * 1e6;
        term::note(&format!("the plane was moved by {um:.1e} µm, because the cut at its place is not a sound surface"));
    }
    if args.thick.is_some() && new_patches(&found, &whole) < 2 {
        term::note("the surface ends before the second plane (--thick), so the solid has no patch cut_back");
    }
    let mut lines = target.write(&found.shape())?;
    let (count, volume) = (certificate.components, certificate.volume_mm3);
    let noun = if count == 1 { "component" } else { "components" };
    lines.push(format!("passed: closed, {count} {noun}, volume {}", units::show_volume(volume)));
    Ok(lines)
}

/// Cuts and certifies, if need be with the plane a little beside its place. Returns the solid, its
/// certificate and the distance by which the plane was moved.
fn solid(
    whole: &Converted,
    surface: &Surface,
    args: &CutArgs,
    plane: &Plane,
    unit: LengthUnit,
) -> anyhow::Result<(Converted, Certificate, f64)> {
    let shown = args.file.display();
    let per_um = 1e-6 / unit.metres();
    let largest = whole.shape().positions.as_flattened().iter().fold(0.0_f32, |most, x| most.max(x.abs()));
    let mut first_failure = None;
    for step in STEPS {
        let moved = step * STEP * f64::from(largest);
        let front = HalfSpace { normal: plane.normal, offset: plane.height_um() * per_um + moved };
        let near = match args.side {
            Side::Front => front,
            Side::Back => turned(front),
        };
        let far = args.thick.map(|um| {
            let far = turned(near);
            HalfSpace { offset: far.offset - um * per_um, ..far }
        });
        let found = whole.half(&near, "cut").and_then(|half| match &far {
            Some(far) => half.half(far, "cut_back"),
            None => Ok(half),
        });
        let failure = match found {
            Ok(found) if new_patches(&found, whole) == 0 => return Err(missed(surface, args, plane, "everything")),
            Ok(found) => {
                let certificate = certified(&found, unit);
                if certificate.passed {
                    return Ok((found, certificate, moved));
                }
                certificate.first_failure().unwrap_or_default()
            }
            Err(HalfError::Nothing) if step == 0.0 => return Err(missed(surface, args, plane, "nothing")),
            Err(error) => error.to_string(),
        };
        first_failure.get_or_insert(failure);
    }
    let before = certified(whole, unit);
    if let Some(failure) = before.first_failure() {
        bail!("{shown}: the surface is not closed and sound, so no closed part can be cut from it: {failure}");
    }
    let failure = first_failure.unwrap_or_default();
    bail!("{shown}: the part is not a sound closed surface: {failure}; move the plane a little");
}

/// Number of patches of the solid that are faces of a cut.
fn new_patches(solid: &Converted, whole: &Converted) -> usize {
    let is_new = |name: &str| whole.shape().patches.iter().all(|patch| patch.name != name);
    solid.shape().patches.iter().filter(|patch| is_new(patch.name)).count()
}

/// The half-space on the other side of its plane.
fn turned(space: HalfSpace) -> HalfSpace {
    HalfSpace { normal: space.normal.map(|x| -x), offset: -space.offset }
}

fn certified(solid: &Converted, unit: LengthUnit) -> Certificate {
    let shape = solid.shape();
    let positions: Vec<[f64; 3]> = shape.positions.iter().map(|p| p.map(f64::from)).collect();
    check_surface(&positions, shape.triangles, &CheckOptions { euler: None, unit_metres: unit.metres() })
}

/// Error for a plane that leaves nothing or everything.
fn missed(surface: &Surface, args: &CutArgs, plane: &Plane, what: &str) -> anyhow::Error {
    let [low, high] = Converted::in_its_unit(surface).into_body().extent_um(plane);
    let (at, side) = (plane.height_um(), args.side.name());
    anyhow!(
        "{}: the plane at {at:.1} µm has {what} {side} it: along its normal the surface reaches from \
         {low:.1} to {high:.1} µm",
        args.file.display()
    )
}
