//! Textures of a glTF file: texture coordinates of all vertices, and pictures with materials.
//!
//! Both walls have tiles that repeat along their coordinates, one for the colour and one for the
//! normals. Each end has the stained picture of its section. All pictures are PNG within the binary
//! data, before the arrays of the patches.

use super::scene::Layout;
use super::tiles::{TILES, Tile};
use crate::model::PatchKind;
use crate::tissue::Grid;
use gltf_json as json;
use json::texture::{MagFilter, MinFilter, WrappingMode};
use json::validation::Checked;
use std::io::{self, Write};

/// Textures of a lofted tissue.
#[derive(Clone, Debug)]
pub struct Skin<'a> {
    /// Distance around the ring of the section, and place along the tube, of each vertex of a wall,
    /// µm.
    walls: Vec<[f32; 2]>,
    /// Positions of all vertices before bending, metres.
    straight: &'a [[f32; 3]],
    ends: [EndPicture; 2],
    /// Colour and normals of each tile, as PNG.
    tiles: Vec<[Vec<u8>; 2]>,
}

/// Stained picture of the section at an end of the tube.
#[derive(Clone, Debug)]
pub struct EndPicture {
    /// Pixels over the section.
    pub grid: Grid,
    /// The picture as PNG.
    pub png: Vec<u8>,
}

const CAPS: [PatchKind; 2] = [PatchKind::CapIsthmus, PatchKind::CapAmpulla];

impl<'a> Skin<'a> {
    /// Creates the textures of a tissue. `walls` are the distance around the ring of the section
    /// and the place along the tube of each vertex, µm. `straight` are the positions before bending,
    /// metres. `ends` are the pictures at the isthmus and at the ampulla end.
    ///
    /// # Errors
    /// Any error of encoding the pictures.
    pub fn new(walls: Vec<[f32; 2]>, straight: &'a [[f32; 3]], ends: [EndPicture; 2]) -> io::Result<Self> {
        let tiles = TILES.iter().map(Tile::pngs).collect::<io::Result<_>>()?;
        Ok(Self { walls, straight, ends, tiles })
    }

    /// Number of vertices that have texture coordinates.
    pub(super) fn len(&self) -> usize {
        self.walls.len().min(self.straight.len())
    }

    /// Texture coordinates of a vertex of a patch.
    pub(super) fn coordinates(&self, patch: &str, vertex: u32) -> [f32; 2] {
        let kind = PatchKind::named(patch);
        if let Some(k) = CAPS.iter().position(|cap| Some(*cap) == kind) {
            let grid = &self.ends[k].grid;
            let [x, y] = [0, 1].map(|axis| f64::from(self.straight[vertex as usize][axis]) * 1e6);
            let side = |count: u32| f64::from(count) * grid.um_per_pixel;
            return [((x - grid.left_um) / side(grid.width)) as f32, ((grid.top_um - y) / side(grid.height)) as f32];
        }
        let side_um = tile(kind).map_or(1.0, |k| TILES[k].side_um);
        self.walls[vertex as usize].map(|um| um / side_um)
    }

    /// All pictures, in the order of the file.
    fn pictures(&self) -> impl Iterator<Item = &[u8]> {
        self.tiles.iter().flatten().chain(self.ends.iter().map(|end| &end.png)).map(Vec::as_slice)
    }

    /// Adds pictures and textures to a document.
    pub(super) fn describe(&self, layout: &mut Layout, root: &mut json::Root) {
        let sampler = |wrap: WrappingMode| json::texture::Sampler {
            mag_filter: Some(Checked::Valid(MagFilter::Linear)),
            min_filter: Some(Checked::Valid(MinFilter::LinearMipmapLinear)),
            wrap_s: Checked::Valid(wrap),
            wrap_t: Checked::Valid(wrap),
            ..Default::default()
        };
        let [repeat, clamp] = [WrappingMode::Repeat, WrappingMode::ClampToEdge].map(|wrap| root.push(sampler(wrap)));
        let names = TILES.iter().flat_map(|tile| [tile.name.to_owned(), format!("{}_normals", tile.name)]);
        let names = names.chain(CAPS.iter().map(|cap| cap.name().to_owned()));
        for (k, (name, picture)) in names.zip(self.pictures()).enumerate() {
            let view = layout.append_bytes(root, picture.len());
            let source = root.push(json::Image {
                buffer_view: Some(view),
                mime_type: Some(json::image::MimeType("image/png".into())),
                name: Some(name.clone()),
                uri: None,
                extensions: None,
                extras: None,
            });
            let sampler = if k < 2 * TILES.len() { repeat } else { clamp };
            root.push(json::Texture {
                name: Some(name),
                sampler: Some(sampler),
                source,
                extensions: None,
                extras: None,
            });
        }
    }

    /// Replaces the colour of a patch's material by textures.
    pub(super) fn dress(&self, patch: &str, material: &mut json::Material) {
        let kind = PatchKind::named(patch);
        let colour = |texture: usize| json::texture::Info {
            index: json::Index::new(texture as u32),
            tex_coord: 0,
            extensions: None,
            extras: None,
        };
        let pbr = &mut material.pbr_metallic_roughness;
        if let Some(k) = CAPS.iter().position(|cap| Some(*cap) == kind) {
            pbr.base_color_texture = Some(colour(2 * TILES.len() + k));
            pbr.roughness_factor = json::material::StrengthFactor(0.8);
        } else if let Some(k) = tile(kind) {
            pbr.base_color_texture = Some(colour(2 * k));
            pbr.roughness_factor = json::material::StrengthFactor(TILES[k].roughness);
            material.normal_texture = Some(json::material::NormalTexture {
                index: json::Index::new(2 * k as u32 + 1),
                scale: 1.0,
                tex_coord: 0,
                extensions: None,
                extras: None,
            });
        } else {
            return;
        }
        material.pbr_metallic_roughness.base_color_factor = json::material::PbrBaseColorFactor([1.0; 4]);
    }

    /// Writes the pictures, each padded to a multiple of four bytes.
    pub(super) fn write(&self, out: &mut impl Write) -> io::Result<()> {
        for picture in self.pictures() {
            out.write_all(picture)?;
            out.write_all(&[0; 4][..picture.len().next_multiple_of(4) - picture.len()])?;
        }
        Ok(())
    }
}

/// Index of the tile of a patch.
fn tile(kind: Option<PatchKind>) -> Option<usize> {
    TILES.iter().position(|tile| Some(tile.patch) == kind)
}
