//! OME-TIFF: one deflated page per slice. The OME-XML of the first page states sizes in
//! micrometres. The file is a BigTIFF if it might exceed 4 GiB.

use super::volume::{FILES, LabelReport};
use crate::export::Metadata;
use crate::tissue::Tissue;
use std::fmt::Write as _;
use std::io::{self, Seek, Write};
use tiff::TiffError;
use tiff::encoder::{Rational, TiffEncoder, TiffKind, TiffKindBig, TiffKindStandard};
use tiff::tags::Tag;

/// Maximum number of voxels of a classic TIFF, which leaves room for its directories.
const CLASSIC: u64 = 3 << 30;
/// Values of TIFF tags: Adobe deflate; 0 is black; centimetres.
const DEFLATE: u16 = 8;
const BLACK_IS_ZERO: u16 = 1;
const CENTIMETRE: u16 = 3;

/// A file under construction.
pub(super) struct OmeTiff<W: Write + Seek> {
    pages: Pages<W>,
    width: u32,
    height: u32,
    /// Pixels per centimetre.
    resolution: f64,
    /// The OME-XML and the software, which the first page takes.
    head: Option<[String; 2]>,
}

enum Pages<W: Write + Seek> {
    Classic(TiffEncoder<W, TiffKindStandard>),
    Big(TiffEncoder<W, TiffKindBig>),
}

impl<W: Write + Seek> OmeTiff<W> {
    pub(super) fn new(out: W, report: &LabelReport, meta: &Metadata) -> io::Result<Self> {
        let [width, height, slices] = report.size;
        let most = u64::from(width) * u64::from(height) * u64::from(slices);
        let pages = if most > CLASSIC {
            Pages::Big(TiffEncoder::new_big(out).map_err(failed)?)
        } else {
            Pages::Classic(TiffEncoder::new(out).map_err(failed)?)
        };
        let head = Some([xml(report, meta), format!("oviduct {}", meta.engine)]);
        Ok(Self { pages, width, height, resolution: 1e4 / report.voxel_um[0], head })
    }

    /// Writes the next page from labels compressed by zlib.
    pub(super) fn write(&mut self, deflated: &[u8]) -> io::Result<()> {
        let head = self.head.take();
        let (size, resolution) = ([self.width, self.height], self.resolution);
        match &mut self.pages {
            Pages::Classic(tiff) => write_page(tiff, size, resolution, head, deflated),
            Pages::Big(tiff) => write_page(tiff, size, resolution, head, deflated),
        }
        .map_err(failed)
    }
}

fn write_page<W: Write + Seek, K: TiffKind>(
    tiff: &mut TiffEncoder<W, K>,
    [width, height]: [u32; 2],
    resolution: f64,
    head: Option<[String; 2]>,
    deflated: &[u8],
) -> Result<(), TiffError> {
    let mut page = tiff.image_directory()?;
    let offset = K::convert_offset(page.write_data(deflated)?)?;
    let length = K::convert_offset(deflated.len() as u64)?;
    if let Some([xml, software]) = head {
        page.write_tag(Tag::ImageDescription, xml.as_str())?;
        page.write_tag(Tag::Software, software.as_str())?;
    }
    page.write_tag(Tag::ImageWidth, width)?;
    page.write_tag(Tag::ImageLength, height)?;
    page.write_tag(Tag::BitsPerSample, 8_u16)?;
    page.write_tag(Tag::SamplesPerPixel, 1_u16)?;
    page.write_tag(Tag::Compression, DEFLATE)?;
    page.write_tag(Tag::PhotometricInterpretation, BLACK_IS_ZERO)?;
    page.write_tag(Tag::RowsPerStrip, height)?;
    page.write_tag(Tag::StripOffsets, offset)?;
    page.write_tag(Tag::StripByteCounts, length)?;
    let resolution = || Rational { n: (resolution * 1000.0).round() as u32, d: 1000 };
    page.write_tag(Tag::XResolution, resolution())?;
    page.write_tag(Tag::YResolution, resolution())?;
    page.write_tag(Tag::ResolutionUnit, CENTIMETRE)?;
    page.finish()
}

/// OME-XML in ASCII, the encoding of the tag.
fn xml(report: &LabelReport, meta: &Metadata) -> String {
    let ([x, y, z], [dx, dy, dz]) = (report.size, report.voxel_um);
    let mut labels = String::new();
    for tissue in Tissue::ALL {
        let _ = write!(labels, "{}{} {}", if labels.is_empty() { "" } else { ", " }, tissue as u8, tissue.name());
    }
    let Metadata { preset, seed, digest, engine, .. } = meta;
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\
         <OME xmlns=\"http://www.openmicroscopy.org/Schemas/OME/2016-06\" \
         xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" \
         xsi:schemaLocation=\"http://www.openmicroscopy.org/Schemas/OME/2016-06 \
         http://www.openmicroscopy.org/Schemas/OME/2016-06/ome.xsd\" Creator=\"oviduct {engine}\">\
         <Image ID=\"Image:0\" Name=\"{name}\"><Description>{labels}; preset {preset}, seed {seed}, digest {digest}\
         </Description><Pixels ID=\"Pixels:0\" DimensionOrder=\"XYZCT\" Type=\"uint8\" SizeX=\"{x}\" SizeY=\"{y}\" \
         SizeZ=\"{z}\" SizeC=\"1\" SizeT=\"1\" PhysicalSizeX=\"{dx}\" PhysicalSizeXUnit=\"&#181;m\" \
         PhysicalSizeY=\"{dy}\" PhysicalSizeYUnit=\"&#181;m\" PhysicalSizeZ=\"{dz}\" PhysicalSizeZUnit=\"&#181;m\">\
         <Channel ID=\"Channel:0:0\" SamplesPerPixel=\"1\"/>\
         <TiffData IFD=\"0\" FirstC=\"0\" FirstT=\"0\" FirstZ=\"0\" PlaneCount=\"{z}\"/></Pixels></Image></OME>",
        name = FILES[0],
    )
}

fn failed(error: TiffError) -> io::Error {
    match error {
        TiffError::IoError(error) => error,
        other => io::Error::other(other.to_string()),
    }
}
