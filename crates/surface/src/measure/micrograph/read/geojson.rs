//! Reads the GeoJSON that QuPath exports: features with polygons and the names of their classes.

use super::super::error::MicrographError;
use super::pixels::{Image, Kind};
use super::raster::{Point, Polygon, Raster};
use super::stated::Stated;
use serde::Deserialize;
use serde::de::{Deserializer, IgnoredAny, SeqAccess, Visitor};
use serde_json::value::RawValue;
use std::collections::BTreeSet;

/// Maximum number of points of all polygons.
const MOST_POINTS: usize = 1 << 20;
/// Maximum distance of a point from the origin, pixels.
const FARTHEST: f64 = 1e7;
/// Maximum depth of collections of geometries within each other.
const DEEPEST: usize = 8;
/// Classes of features that are not tissue, in lower case.
const NOT_TISSUE: [&str; 4] = ["lumen", "hole", "background", "ignore*"];

#[derive(Deserialize)]
struct Collection<'a> {
    #[serde(rename = "type", default)]
    kind: String,
    #[serde(borrow, default)]
    features: Vec<Feature<'a>>,
    #[serde(borrow)]
    geometry: Option<Geometry<'a>>,
    properties: Option<Properties>,
}

#[derive(Deserialize)]
struct Feature<'a> {
    #[serde(borrow)]
    geometry: Option<Geometry<'a>>,
    properties: Option<Properties>,
}

#[derive(Deserialize)]
struct Geometry<'a> {
    #[serde(rename = "type")]
    kind: String,
    #[serde(borrow)]
    coordinates: Option<&'a RawValue>,
    /// Parts of a collection.
    #[serde(borrow)]
    geometries: Option<&'a RawValue>,
}

impl Geometry<'_> {
    /// True if it has polygons or is a collection, which may have some.
    fn may_have_polygons(&self) -> bool {
        matches!(self.kind.as_str(), "Polygon" | "MultiPolygon" | "GeometryCollection")
    }
}

#[derive(Default, Deserialize)]
struct Properties {
    #[serde(rename = "objectType", alias = "object_type")]
    object: Option<String>,
    classification: Option<Class>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Class {
    One { name: String },
    Parts { names: Vec<String> },
    Bare(String),
    Other(IgnoredAny),
}

impl Class {
    fn name(&self) -> Option<&str> {
        let name = match self {
            Self::One { name } | Self::Bare(name) => Some(name),
            Self::Parts { names } => names.last(),
            Self::Other(_) => None,
        };
        // A derived class, such as `Tissue: Lumen`, is named by its last part.
        name.map(|name| name.rsplit(": ").next().unwrap_or(name).trim())
    }
}

/// A position; further numbers than two are left out.
struct Position(Point);

impl<'de> Deserialize<'de> for Position {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Numbers;
        impl<'de> Visitor<'de> for Numbers {
            type Value = Position;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("two numbers")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Position, A::Error> {
                let mut next = || seq.next_element::<f64>()?.ok_or_else(|| serde::de::Error::invalid_length(0, &self));
                let point = [next()?, next()?];
                while seq.next_element::<IgnoredAny>()?.is_some() {}
                Ok(Position(point))
            }
        }
        deserializer.deserialize_seq(Numbers)
    }
}

pub(super) fn read(text: &[u8], side: u32) -> Result<Image, MicrographError> {
    let features = features(text)?;
    let is_annotation = |feature: &Feature<'_>| {
        feature.properties.as_ref().and_then(|own| own.object.as_deref()).is_some_and(|kind| kind == "annotation")
    };
    let annotated = features.iter().any(is_annotation);
    let (mut tissue, mut open, mut classes) = (Vec::new(), Vec::new(), BTreeSet::new());
    let (mut points, mut others, mut detections) = (0, 0_usize, 0_usize);
    for (index, feature) in features.iter().enumerate() {
        let geometry = feature.geometry.as_ref().filter(|geometry| geometry.may_have_polygons());
        if geometry.is_some() && annotated && !is_annotation(feature) {
            detections += 1;
            continue;
        }
        let Some(polygons) = geometry.map(|geometry| polygons(geometry, index, 0)).transpose()?.flatten() else {
            others += 1;
            continue;
        };
        points += polygons.iter().flatten().map(Vec::len).sum::<usize>();
        if points > MOST_POINTS {
            return Err(MicrographError::Rough);
        }
        let class = feature.properties.as_ref().and_then(|own| own.classification.as_ref()).and_then(Class::name);
        let is_open = class.is_some_and(|name| NOT_TISSUE.contains(&name.to_lowercase().as_str()));
        if !is_open {
            classes.insert(class.unwrap_or("(no class)").chars().take(40).collect::<String>());
        }
        if is_open { &mut open } else { &mut tissue }.extend(polygons);
    }
    if tissue.is_empty() {
        return Err(MicrographError::NoTissue);
    }
    let mut raster = Raster::around(tissue.iter(), side);
    for (polygons, value) in [(&tissue, 1), (&open, 0)] {
        for polygon in polygons {
            raster.paint(polygon, value)?;
        }
    }
    let mut notes = Vec::new();
    if classes.len() > 1 {
        let some: Vec<String> = classes.into_iter().take(8).collect();
        notes.push(format!("the classes {} are taken as tissue", some.join(", ")));
    }
    if others > 0 {
        let (features, were) = counted(others, "feature");
        notes.push(format!("{features} without polygons {were} passed over"));
    }
    if detections > 0 {
        let (detections, were) = counted(detections, "detection");
        notes.push(format!("{detections} {were} passed over, because the file has annotations"));
    }
    let Raster { width, values, step, .. } = raster;
    Ok(Image { width, values, kind: Kind::Polygons, step, stated: Stated::Nothing, notes })
}

/// A number of things, and the verb for them.
fn counted(count: usize, thing: &str) -> (String, &'static str) {
    if count == 1 { (format!("1 {thing}"), "was") } else { (format!("{count} {thing}s"), "were") }
}

/// Features of a collection, an array, a single feature or a bare geometry.
fn features(text: &[u8]) -> Result<Vec<Feature<'_>>, MicrographError> {
    let failed = |error: serde_json::Error| MicrographError::Damaged("GeoJSON", error.to_string());
    if text.starts_with(b"[") {
        return serde_json::from_slice(text).map_err(failed);
    }
    let whole: Collection<'_> = serde_json::from_slice(text).map_err(failed)?;
    match whole.kind.as_str() {
        "FeatureCollection" => Ok(whole.features),
        "Feature" => Ok(vec![Feature { geometry: whole.geometry, properties: whole.properties }]),
        "Polygon" | "MultiPolygon" | "GeometryCollection" => {
            let geometry = serde_json::from_slice(text).map_err(failed)?;
            Ok(vec![Feature { geometry: Some(geometry), properties: None }])
        }
        _ => Err(MicrographError::Format("the file is JSON, but no GeoJSON of polygons")),
    }
}

/// Polygons of a geometry within `depth` collections; `None` for points and lines.
fn polygons(geometry: &Geometry<'_>, index: usize, depth: usize) -> Result<Option<Vec<Polygon>>, MicrographError> {
    let place = |detail: String| MicrographError::Damaged("GeoJSON", format!("feature {index}: {detail}"));
    if geometry.kind == "GeometryCollection" {
        if depth == DEEPEST {
            return Err(place(format!("more than {DEEPEST} collections of geometries are within each other")));
        }
        let text = geometry.geometries.map_or("[]", RawValue::get);
        let parts: Vec<Geometry<'_>> = serde_json::from_str(text).map_err(|error| place(error.to_string()))?;
        let mut found: Option<Vec<Polygon>> = None;
        for part in &parts {
            if let Some(more) = polygons(part, index, depth + 1)? {
                found.get_or_insert_default().extend(more);
            }
        }
        return Ok(found);
    }
    let text = geometry.coordinates.map_or("[]", RawValue::get);
    let rings: Vec<Vec<Vec<Position>>> = match geometry.kind.as_str() {
        "Polygon" => vec![serde_json::from_str(text).map_err(|error| place(error.to_string()))?],
        "MultiPolygon" => serde_json::from_str(text).map_err(|error| place(error.to_string()))?,
        _ => return Ok(None),
    };
    let plain = |ring: Vec<Position>| ring.into_iter().map(|Position(point)| point).collect::<Vec<Point>>();
    let polygons: Vec<Polygon> = rings.into_iter().map(|rings| rings.into_iter().map(plain).collect()).collect();
    let far = polygons.iter().flatten().flatten().flatten().find(|place| place.is_nan() || place.abs() > FARTHEST);
    if let Some(far) = far {
        return Err(place(format!("the coordinate {far} is beyond {FARTHEST}")));
    }
    Ok(Some(polygons))
}
