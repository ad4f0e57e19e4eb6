//! GeoJSON of QuPath.

use super::files::{SIDE, ring};
use super::*;
use serde_json::{Value, json};

fn at(geojson: &Value, pixel_um: f64) -> Result<Micrograph, MicrographError> {
    read(geojson.to_string().as_bytes(), pixel_um)
}

/// A closed circle; a point per degree.
fn circle(x: f64, y: f64, radius: f64) -> Vec<[f64; 2]> {
    let point = |i: i32| {
        let (sin, cos) = f64::from(i % 360).to_radians().sin_cos();
        [x + radius * cos, y + radius * sin]
    };
    (0..=360).map(point).collect()
}

fn feature(class: &str, coordinates: impl Into<Value>) -> Value {
    let coordinates: Value = coordinates.into();
    json!({
        "type": "Feature", "id": "PathAnnotationObject",
        "geometry": { "type": "Polygon", "coordinates": coordinates },
        "properties": { "objectType": "annotation", "classification": { "name": class, "color": [200, 0, 0] } },
    })
}

/// Asserts the areas of tissue between two radii of 300 and 200 pixels of 2 µm.
#[track_caller]
fn annulus(found: &Micrograph) {
    let measures = found.measure();
    let area = |radius: f64| std::f64::consts::PI * (radius * 2e-3).powi(2);
    let (lumen, tissue) = (measures.lumen_area_mm2, measures.tissue_area_mm2);
    assert!((lumen / area(200.0) - 1.0).abs() < 0.001, "{lumen}");
    assert!((tissue / (area(300.0) - area(200.0)) - 1.0).abs() < 0.002, "{tissue}");
    assert_eq!(found.pixel_um(), 2.0);
}

#[test]
fn annotations_of_tissue_and_lumen_are_a_section() {
    let (outer, inner) = (circle(5000.0, 7000.0, 300.0), circle(5010.0, 7000.0, 200.0));
    let hole = feature("Tissue", json!([outer, inner]));
    let parts = [feature("Tissue", json!([outer])), feature("Lumen", json!([inner]))];
    let point = json!({ "type": "Feature", "geometry": { "type": "Point", "coordinates": [1, 2] }, "properties": {} });
    let detection = json!({
        "type": "Feature", "geometry": { "type": "Polygon", "coordinates": [circle(100.0, 100.0, 900.0)] },
        "properties": { "objectType": "detection" },
    });
    let multi = json!({ "type": "MultiPolygon", "coordinates": [[outer, inner]] });
    let line = json!({ "type": "LineString", "coordinates": [[1, 2], [3, 4]] });
    let collection = json!({
        "type": "GeometryCollection",
        "geometries": [line, { "type": "GeometryCollection", "geometries": [multi] }],
    });
    for document in [
        json!({ "type": "FeatureCollection", "features": [hole] }),
        json!([hole]),
        hole.clone(),
        json!({ "type": "FeatureCollection", "features": parts }),
        json!([parts[1], parts[0], point, detection]),
        multi.clone(),
        collection.clone(),
        json!({ "type": "Feature", "geometry": collection, "properties": null }),
        json!({ "type": "Feature", "geometry": multi, "properties": null }),
        json!([{ "type": "Feature", "geometry": multi, "properties": { "classification": { "names": ["Tissue"] } } }]),
    ] {
        annulus(&at(&document, 2.0).unwrap());
    }
    let notes = at(&json!([hole, detection, detection, point, point]), 2.0).unwrap();
    assert_eq!(
        notes.notes(),
        [
            "2 features without polygons were passed over",
            "2 detections were passed over, because the file has annotations"
        ]
    );
    // A byte order mark, and heights.
    let text = json!([feature("Stroma", json!([outer.iter().map(|[x, y]| [*x, *y, 0.0]).collect::<Vec<_>>(), inner]))]);
    annulus(&read(&[b"\xef\xbb\xbf\n", text.to_string().as_bytes()].concat(), 2.0).unwrap());
    let notes = at(&json!([hole, feature("Muscle", json!([circle(5000.0, 7260.0, 20.0)])), point]), 2.0).unwrap();
    assert_eq!(
        notes.notes(),
        ["the classes Muscle, Tissue are taken as tissue", "1 feature without polygons was passed over"]
    );
}

#[test]
fn polygons_along_the_sides_of_pixels_are_the_mask() {
    // One polygon per row of tissue: a thresholded image, with pixels of 4 image pixels.
    let pixels = ring(1);
    let mut polygons = Vec::new();
    for (y, row) in pixels.chunks(SIDE).enumerate() {
        let mut from = None;
        for x in 0..=SIDE {
            let tissue = row.get(x) == Some(&1);
            match (from, tissue) {
                (None, true) => from = Some(x),
                (Some(start), false) => {
                    let [left, right, top, bottom] = [start, x, y, y + 1].map(|place| 4 * place + 100);
                    polygons.push([[[left, top], [right, top], [right, bottom], [left, bottom], [left, top]]]);
                    from = None;
                }
                _ => {}
            }
        }
    }
    let document = json!([{ "type": "Feature", "geometry": { "type": "MultiPolygon", "coordinates": polygons } }]);
    let (found, mask) = (at(&document, 2.5).unwrap().measure(), read(&grey(SIDE, &pixels), 10.0).unwrap().measure());
    for name in ["lumen_area_mm2", "tissue_area_mm2", "lumen_perimeter_mm"] {
        let of = |measures| crate::measure::morphometry::Quantity::named(name).unwrap().of(measures).unwrap();
        assert!((of(&found) / of(&mask) - 1.0).abs() < 1e-4, "{name}: {} {}", of(&found), of(&mask));
    }
}

#[test]
fn what_is_no_section_is_refused() {
    let tissue = json!([feature("Tissue", json!([circle(0.0, 0.0, 300.0), circle(0.0, 0.0, 200.0)]))]);
    let text = tissue.to_string();
    let unstated = Micrograph::read(text.as_bytes(), &Reading::default());
    assert_eq!(unstated, Err(MicrographError::NoPixelSize("the file does not state it".into())));
    let chosen = Reading { pixel_um: Some(2.0), tissue: Some(Tissue::Nonzero), threshold: None };
    assert_eq!(Micrograph::read(text.as_bytes(), &chosen), Err(MicrographError::Polygons));
    assert_eq!(at(&json!([]), 2.0), Err(MicrographError::NoTissue));
    assert_eq!(at(&json!([feature("Lumen", json!([circle(0.0, 0.0, 9.0)]))]), 2.0), Err(MicrographError::NoTissue));
    assert_eq!(at(&json!([feature("Tissue", json!([circle(0.0, 0.0, 300.0)]))]), 2.0), Err(MicrographError::NoLumen));
    assert!(matches!(at(&json!({ "spec": {} }), 2.0), Err(MicrographError::Format(_))));
    for wrong in ["[", "{\"type\": \"Feature\"", "[{\"geometry\": {\"type\": \"Polygon\", \"coordinates\": [[1]]}}]"] {
        assert!(matches!(read(wrong.as_bytes(), 2.0), Err(MicrographError::Damaged("GeoJSON", _))), "{wrong}");
    }
    let far = at(&json!([feature("Tissue", json!([[[0, 0], [1e9, 0], [0, 1]]]))]), 2.0).unwrap_err();
    assert!(far.to_string().contains("feature 0: the coordinate 1000000000"), "{far}");
    let mut deep = json!({ "type": "Polygon", "coordinates": [circle(0.0, 0.0, 300.0)] });
    for _ in 0..9 {
        deep = json!({ "type": "GeometryCollection", "geometries": [deep] });
    }
    let deep = at(&deep, 2.0).unwrap_err().to_string();
    assert!(deep.contains("more than 8 collections of geometries"), "{deep}");
    // Edges that pass all rows, again and again.
    let zigzag: Vec<[f64; 2]> = (0..10_000).map(|i| [f64::from(i) * 0.01, f64::from(i % 2) * 4000.0]).collect();
    assert_eq!(at(&json!([feature("Tissue", json!([zigzag]))]), 2.0), Err(MicrographError::Rough));
}
