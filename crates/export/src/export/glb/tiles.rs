//! Tiles of the walls: small pictures of colour and normals that repeat without a seam.

use crate::export::colours::{of_patch, srgb};
use crate::model::PatchKind;
use crate::tissue::{Relief, Sampling, WallTexture};
use glam::Vec3;
use std::io;

/// Width and height of a tile, pixels.
pub(super) const SIDE_PIXELS: u32 = 256;

/// A tile and its wall.
pub(super) struct Tile {
    pub(super) name: &'static str,
    pub(super) patch: PatchKind,
    texture: WallTexture,
    /// Width and height, µm.
    pub(super) side_um: f32,
    /// Roughness of the surface that the relief does not show.
    pub(super) roughness: f32,
}

/// All tiles.
pub(super) const TILES: [Tile; 2] = [
    Tile { name: "mucosa", patch: PatchKind::InnerWall, texture: WallTexture::Mucosa, side_um: 256.0, roughness: 0.45 },
    Tile { name: "serosa", patch: PatchKind::OuterWall, texture: WallTexture::Serosa, side_um: 1024.0, roughness: 0.5 },
];

impl Tile {
    /// Colour and normals as PNG. Columns run around the tube, rows along it.
    pub(super) fn pngs(&self) -> io::Result<[Vec<u8>; 2]> {
        let pixel_um = self.side_um / SIDE_PIXELS as f32;
        let sampling = Sampling { pixel_um: Vec3::splat(pixel_um), repeat_um: Some(self.side_um), is_straight: true };
        let plain = Vec3::from(of_patch(self.patch.name()));
        let (mut colours, mut normals) = (Vec::new(), Vec::new());
        for row in 0..SIDE_PIXELS {
            for column in 0..SIDE_PIXELS {
                let [x, z] = [column, row].map(|k| (k as f32 + 0.5) * pixel_um);
                let Relief { slope, tint } = Relief::of(self.texture, Vec3::new(x, HEIGHT_UM, z), &sampling);
                colours.extend((plain * tint).to_array().map(|light| srgb(light.clamp(0.0, 1.0))));
                // Green points up in the picture, against the direction of the second coordinate.
                let normal = Vec3::new(-slope.x, slope.z, 1.0).normalize();
                normals.extend(normal.to_array().map(|c| ((c * 0.5 + 0.5) * 255.0).round() as u8));
            }
        }
        Ok([encode(&colours)?, encode(&normals)?])
    }
}

/// Height of the plane through the texture that a tile shows, µm.
const HEIGHT_UM: f32 = 1234.5;

fn encode(rgb: &[u8]) -> io::Result<Vec<u8>> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, SIDE_PIXELS, SIDE_PIXELS);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(rgb)?;
    writer.finish()?;
    Ok(file)
}
