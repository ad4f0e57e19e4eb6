//! A time series of surfaces with the same triangles, for `ParaView` and VTK: a binary file with
//! the positions of all frames, and an XDMF file (version 3) that describes it.
//!
//! The binary file is little-endian. It contains, in this order:
//!
//! 1. the triangles, three 32-bit indices each;
//! 2. the patch of each triangle, one byte: its index among the patches of the body;
//! 3. for each frame, the certified positions in metres, single precision.

use super::chunks::{join, vec3, write_items};
use crate::model::Mesh;
use std::io::{self, Write};

/// Names of the XDMF file and of the binary file.
pub const FILES: [&str; 2] = ["frames.xdmf", "frames.bin"];
/// Media types of [`FILES`].
pub const MEDIA_TYPES: [&str; 2] = ["application/xml", "application/octet-stream"];

/// Writes the triangles and patches, which all frames share.
///
/// # Errors
/// Returns any error of writing to `out`.
pub fn write_common(mesh: &Mesh, out: &mut dyn Write) -> io::Result<()> {
    write_items(&mesh.triangles, out, |t| join::<12>(t.map(u32::to_le_bytes)))?;
    for (number, patch) in mesh.patches.iter().enumerate() {
        out.write_all(&vec![number as u8; patch.triangles.len()])?;
    }
    Ok(())
}

/// Writes the positions of a frame.
///
/// # Errors
/// Returns any error of writing to `out`.
pub fn write_frame(mesh: &Mesh, out: &mut dyn Write) -> io::Result<()> {
    write_items(&mesh.positions, out, |p| vec3(*p))
}

/// Writes the XDMF file. `times` are the times of the frames, seconds.
///
/// # Errors
/// Returns any error of writing to `out`.
pub fn write_description(mesh: &Mesh, times: &[f64], out: &mut dyn Write) -> io::Result<()> {
    let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
    let names: Vec<String> =
        mesh.patches.iter().enumerate().map(|(number, patch)| format!("{number} {}", patch.kind.name())).collect();
    writeln!(out, r#"<?xml version="1.0"?>"#)?;
    writeln!(out, r#"<Xdmf Version="3.0">"#)?;
    writeln!(out, "  <!-- Metres. Patches: {}. -->", names.join(", "))?;
    writeln!(out, "  <Domain>")?;
    writeln!(out, r#"    <Grid Name="contraction" GridType="Collection" CollectionType="Temporal">"#)?;
    for (frame, time) in times.iter().enumerate() {
        let seek = 13 * triangles + 12 * vertices * frame;
        // VTK reuses the positions of the previous time step if the path is the same, so each frame
        // has its own.
        let own = "./".repeat(frame) + FILES[1];
        let item = |kind: &str, precision: u32, seek: usize, size: &str, data: &str| {
            format!(
                r#"<DataItem Format="Binary" NumberType="{kind}" Precision="{precision}" Endian="Little" Seek="{seek}" Dimensions="{size}">{data}</DataItem>"#
            )
        };
        writeln!(out, r#"      <Grid Name="frame {frame}" GridType="Uniform">"#)?;
        writeln!(out, r#"        <Time Value="{time}"/>"#)?;
        writeln!(out, r#"        <Topology TopologyType="Triangle" NumberOfElements="{triangles}">"#)?;
        writeln!(out, "          {}", item("Int", 4, 0, &format!("{triangles} 3"), FILES[1]))?;
        writeln!(out, "        </Topology>")?;
        writeln!(out, r#"        <Geometry GeometryType="XYZ">"#)?;
        writeln!(out, "          {}", item("Float", 4, seek, &format!("{vertices} 3"), &own))?;
        writeln!(out, "        </Geometry>")?;
        writeln!(out, r#"        <Attribute Name="patch" AttributeType="Scalar" Center="Cell">"#)?;
        writeln!(out, "          {}", item("UChar", 1, 12 * triangles, &triangles.to_string(), FILES[1]))?;
        writeln!(out, "        </Attribute>")?;
        writeln!(out, "      </Grid>")?;
    }
    writeln!(out, "    </Grid>")?;
    writeln!(out, "  </Domain>")?;
    writeln!(out, "</Xdmf>")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sample;

    #[test]
    fn the_description_says_where_the_data_are() {
        let mesh = sample::tube(12, 2, 0.2);
        let mut data = Vec::new();
        write_common(&mesh, &mut data).unwrap();
        write_frame(&mesh, &mut data).unwrap();
        write_frame(&mesh, &mut data).unwrap();
        let mut text = Vec::new();
        write_description(&mesh, &[0.0, 0.5], &mut text).unwrap();
        let text = String::from_utf8(text).unwrap();
        let seeks: Vec<usize> =
            text.split(r#"Seek=""#).skip(1).map(|rest| rest.split('"').next().unwrap().parse().unwrap()).collect();
        let (triangles, vertices) = (mesh.triangles.len(), mesh.positions.len());
        let first = 13 * triangles;
        assert_eq!(seeks, [0, first, 12 * triangles, 0, first + 12 * vertices, 12 * triangles]);
        assert_eq!(data.len(), first + 24 * vertices);
        let x = f32::from_le_bytes(data[seeks[4]..seeks[4] + 4].try_into().unwrap());
        assert_eq!(x, mesh.positions[0][0]);
        let corner = u32::from_le_bytes(data[4..8].try_into().unwrap());
        assert_eq!(corner, mesh.triangles[0][1]);
        assert_eq!(data[seeks[2]..first].iter().filter(|&&patch| patch == 1).count(), mesh.patches[1].triangles.len());
        assert_eq!(text.matches("<Grid").count(), text.matches("</Grid>").count());
        assert_eq!(text.matches("<Time").count(), 2);
        let positions: Vec<&str> =
            text.split(r#"NumberType="Float""#).skip(1).map(|rest| rest.split(['>', '<']).nth(1).unwrap()).collect();
        assert_eq!(positions, ["frames.bin", "./frames.bin"]);
    }
}
