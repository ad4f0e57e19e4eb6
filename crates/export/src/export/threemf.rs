//! 3MF for printing: a zip with one XML document. The format states its unit, shares vertices, and
//! requires closed objects.
//!
//! Patches are base materials with the colours of the glTF files, one for each triangle. `regions`
//! is not closed, so its two bodies become two objects, `tissue` and `lumen`, whose common wall is
//! written in both. The archive is written as a stream: memory holds a number for each vertex, and
//! one chunk of text.

use super::CITATION;
use super::chunks::{CHUNK, push_number, write_if_full};
use super::colours::{of_patch, srgb};
use super::shape::{AXES, Shape};
use crate::model::{BodyKind, LengthUnit, PatchKind};
use quick_xml::escape::escape;
use std::cell::Cell;
use std::io::{self, Write};
use zip::write::{SimpleFileOptions, StreamWriter};
use zip::{CompressionMethod, DateTime, ZipWriter};

/// Media type of the file.
pub const MEDIA_TYPE: &str = "model/3mf";

/// Level of the compression. Level 6 makes the file 1 % smaller and takes three times as long.
const LEVEL: i64 = 4;
/// Maximum text of a vertex and of a triangle, bytes, to decide whether the archive needs ZIP64.
const TEXT_BYTES: [u64; 2] = [180, 110];
/// Limit of the format for the number of vertices of an object.
const MAX_VERTICES: u64 = 1 << 31;
/// Number of the list of materials. The objects follow.
const MATERIALS: usize = 1;

const CONTENT_TYPES: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"#;
const RELATIONS: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Target="/3D/3dmodel.model" Id="rel0" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"#;

/// One object of the file: a name, and the patches that bound it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Solid<'a> {
    /// Name of the object.
    pub name: &'a str,
    /// Numbers of the patches, each with true if its triangles are reversed.
    parts: Vec<(usize, bool)>,
}

impl Solid<'_> {
    /// Triangles of the object, each with the number of its patch.
    pub fn triangles<'s>(&'s self, surface: &'s Shape<'_>) -> impl Iterator<Item = ([u32; 3], usize)> + 's {
        self.parts.iter().flat_map(move |&(patch, is_reversed)| {
            let turned = move |&[a, b, c]: &[u32; 3]| if is_reversed { [a, c, b] } else { [a, b, c] };
            surface
                .patches
                .get(patch)
                .into_iter()
                .flat_map(move |of| surface.triangles_of(of).iter().map(move |triangle| (turned(triangle), patch)))
        })
    }
}

/// Objects that represent a surface: the surface itself, or tissue and lumen if it is `regions`.
#[must_use]
pub fn solids<'a>(surface: &Shape<'a>) -> Vec<Solid<'a>> {
    let kinds: Option<Vec<PatchKind>> = surface.patches.iter().map(|patch| PatchKind::named(patch.name)).collect();
    let Some(kinds) = kinds.filter(|kinds| BodyKind::Regions.patches().iter().all(|kind| kinds.contains(kind))) else {
        return vec![Solid {
            name: surface.name,
            parts: (0..surface.patches.len()).map(|patch| (patch, false)).collect(),
        }];
    };
    let of = |body: BodyKind| {
        let part = |(patch, &kind): (usize, &PatchKind)| match kind {
            PatchKind::InnerWall => Some((patch, body == BodyKind::Lumen)),
            kind => body.patches().contains(&kind).then_some((patch, false)),
        };
        Solid { name: body.name(), parts: kinds.iter().enumerate().filter_map(part).collect() }
    };
    vec![of(BodyKind::Tissue), of(BodyKind::Lumen)]
}

/// Writes a surface as 3MF.
///
/// Positions are the shortest decimals that read back as the same 32-bit floats. Vertices that no
/// triangle of an object uses are omitted from the object.
///
/// # Errors
/// Returns any error of writing to `out`, and [`io::ErrorKind::InvalidInput`] if there are more
/// vertices than the format can number.
///
/// # Panics
/// If the triangles or patches of a shape are out of bounds.
pub fn write_3mf(surface: &Shape<'_>, out: &mut impl Write) -> io::Result<()> {
    let (vertices, triangles) = (surface.positions.len() as u64, surface.triangles.len() as u64);
    if vertices > MAX_VERTICES {
        let message = format!("a 3MF object holds at most {MAX_VERTICES} vertices, and the surface has {vertices}");
        return Err(io::Error::new(io::ErrorKind::InvalidInput, message));
    }
    let solids = solids(surface);
    let bytes = solids.len() as u64 * (TEXT_BYTES[0] * vertices + TEXT_BYTES[1] * triangles);
    let failure = Cell::new(None);
    let mut package = Package { zip: ZipWriter::new_stream(Unfailing { out, failure: &failure }), failure: &failure };
    package.part("[Content_Types].xml", false)?.write_all(CONTENT_TYPES.as_bytes())?;
    package.part("_rels/.rels", false)?.write_all(RELATIONS.as_bytes())?;
    let model = package.part("3D/3dmodel.model", bytes > u64::from(u32::MAX))?;
    let mut text = Vec::with_capacity(CHUNK + 1024);
    head(surface, &mut text)?;
    for (id, solid) in (MATERIALS + 1..).zip(&solids) {
        write_object(surface, solid, id, &mut text, model)?;
    }
    writeln!(text, "</resources>\n<build>")?;
    for (id, _) in (MATERIALS + 1..).zip(&solids) {
        writeln!(text, "<item objectid=\"{id}\"/>")?;
    }
    writeln!(text, "</build>\n</model>")?;
    model.write_all(&text)?;
    package.finish()
}

/// Beginning of the model: metadata and materials.
fn head(surface: &Shape<'_>, text: &mut Vec<u8>) -> io::Result<()> {
    let unit = match surface.unit {
        LengthUnit::Metre => "meter",
        LengthUnit::Millimetre => "millimeter",
        LengthUnit::Micrometre => "micron",
    };
    let description = match surface.meta {
        Some(meta) => format!(
            "Preset {}, seed {}, digest {}. Axes: {AXES}. Method: {CITATION}",
            meta.preset, meta.seed, meta.digest
        ),
        None => format!("Method: {CITATION}"),
    };
    writeln!(text, "<?xml version=\"1.0\" encoding=\"UTF-8\"?>")?;
    writeln!(
        text,
        "<model unit=\"{unit}\" xml:lang=\"en-US\" xmlns=\"http://schemas.microsoft.com/3dmanufacturing/core/2015/02\">"
    )?;
    for (name, value) in [("Title", surface.name), ("Application", &surface.generator()), ("Description", &description)]
    {
        writeln!(text, "<metadata name=\"{name}\">{}</metadata>", escaped(value))?;
    }
    writeln!(text, "<resources>")?;
    if surface.patches.is_empty() {
        return Ok(());
    }
    writeln!(text, "<basematerials id=\"{MATERIALS}\">")?;
    for patch in &surface.patches {
        let [r, g, b] = of_patch(patch.name).map(srgb);
        writeln!(text, "<base name=\"{}\" displaycolor=\"#{r:02X}{g:02X}{b:02X}\"/>", escaped(patch.name))?;
    }
    writeln!(text, "</basematerials>")
}

/// Writes an object. `text` holds what is not yet written.
fn write_object(
    surface: &Shape<'_>,
    solid: &Solid<'_>,
    id: usize,
    text: &mut Vec<u8>,
    out: &mut impl Write,
) -> io::Result<()> {
    let material =
        solid.parts.first().map_or(String::new(), |(patch, _)| format!(" pid=\"{MATERIALS}\" pindex=\"{patch}\""));
    let name = escaped(solid.name);
    writeln!(text, "<object id=\"{id}\" type=\"model\" name=\"{name}\"{material}>\n<mesh>\n<vertices>")?;
    let mut number = vec![u32::MAX; surface.positions.len()];
    solid.triangles(surface).for_each(|(triangle, _)| triangle.iter().for_each(|&v| number[v as usize] = 0));
    let used = number.iter_mut().zip(surface.positions).filter(|(number, _)| **number == 0);
    for (next, (number, [x, y, z])) in (0..).zip(used) {
        *number = next;
        writeln!(text, "<vertex x=\"{x}\" y=\"{y}\" z=\"{z}\"/>")?;
        write_if_full(text, out)?;
    }
    writeln!(text, "</vertices>\n<triangles>")?;
    for (triangle, patch) in solid.triangles(surface) {
        text.extend_from_slice(b"<triangle");
        for (name, vertex) in [b" v1=\"", b" v2=\"", b" v3=\""].into_iter().zip(triangle) {
            text.extend_from_slice(name);
            push_number(text, u64::from(number[vertex as usize]));
            text.push(b'"');
        }
        write!(text, " pid=\"{MATERIALS}\" p1=\"")?;
        push_number(text, patch as u64);
        text.extend_from_slice(b"\"/>\n");
        write_if_full(text, out)?;
    }
    writeln!(text, "</triangles>\n</mesh>\n</object>")
}

/// Text of an element or of an attribute in quotes.
fn escaped(text: &str) -> String {
    // XML forbids control characters, even escaped.
    escape(text.replace(|c: char| c.is_control(), " ")).into_owned()
}

/// The archive under construction. It writes to the part that was begun last.
struct Package<'a, W: Write> {
    zip: ZipWriter<StreamWriter<Unfailing<'a, W>>>,
    failure: &'a Cell<Option<io::Error>>,
}

impl<W: Write> Package<'_, W> {
    /// Begins a part. All times are the first that a zip can state.
    fn part(&mut self, name: &str, is_large: bool) -> io::Result<&mut Self> {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .compression_level(Some(LEVEL))
            .large_file(is_large)
            .last_modified_time(DateTime::default());
        self.zip.start_file(name, options)?;
        Ok(self)
    }

    fn finish(self) -> io::Result<()> {
        self.zip.finish()?;
        self.failure.take().map_or(Ok(()), Err)
    }
}

impl<W: Write> Write for Package<'_, W> {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        match self.failure.take() {
            Some(failure) => Err(failure),
            None => self.zip.write(data),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A writer that keeps its first error for the caller and then discards data. A dropped
/// [`ZipWriter`] ends its archive, and prints an error of that to stderr.
struct Unfailing<'a, W> {
    out: &'a mut W,
    failure: &'a Cell<Option<io::Error>>,
}

impl<W: Write> Write for Unfailing<'_, W> {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        if let Err(error) = self.out.write_all(data) {
            self.failure.set(Some(error));
        }
        Ok(data.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests;
