//! Reads files of several formats into the values of their pixels. The maximum side bounds the
//! memory, whatever a file declares.
//!
//! | file | subject |
//! |---|---|
//! | `pixels` | values of pixels, gathered row by row |
//! | `png`, `tiff`, `photo` | PNG; TIFF and OME-TIFF; BMP and JPEG |
//! | `geojson`, `raster` | polygons of QuPath, painted as pixels |
//! | `stated` | side of a pixel, as files state it |

mod geojson;
mod photo;
mod pixels;
mod png;
mod raster;
mod stated;
mod tiff;

pub(super) use pixels::{Image, Kind};
pub(super) use stated::Stated;

use super::error::MicrographError;

/// Beginnings of files of other formats, and their names.
const OTHERS: [(&[u8], &str); 12] = [
    (b"GIF8", "the file is a GIF"),
    (b"RIFF", "the file is a WebP or another RIFF file"),
    (b"%PDF", "the file is a PDF"),
    (b"\0\0\0\x0cjP  ", "the file is a JPEG 2000 image"),
    (b"\xff\x4f\xff\x51", "the file is a JPEG 2000 image"),
    (b"\x93NUMPY", "the file is a NumPy array; cellpose also saves its masks as PNG or TIFF"),
    (b"\x89HDF", "the file is HDF5"),
    (b"ZISRAWFILE", "the file is a CZI of Zeiss"),
    (b"\xda\xce\xbe\x0a", "the file is an ND2 of Nikon"),
    (b"PK\x03\x04", "the file is a ZIP archive"),
    (b"\x1f\x8b", "the file is compressed by gzip"),
    (b"<", "the file is XML, such as an SVG"),
];

/// Reads an image of at most `side` pixels a side.
pub(super) fn read(bytes: &[u8], side: u32) -> Result<Image, MicrographError> {
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start();
    match bytes {
        [0x89, b'P', b'N', b'G', b'\r', b'\n', 0x1a, b'\n', ..] => png::read(bytes, side),
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => tiff::read(bytes, side),
        [0xff, 0xd8, 0xff, ..] => photo::jpeg(bytes, side),
        [b'B', b'M', ..] => photo::bmp(bytes, side),
        _ if text.starts_with(b"{") || text.starts_with(b"[") => geojson::read(text, side),
        _ => {
            let known = OTHERS.iter().find(|(start, _)| text.starts_with(start));
            Err(MicrographError::Format(known.map_or("the file is no image that is read", |(_, name)| name)))
        }
    }
}
