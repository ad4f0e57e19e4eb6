//! Decompression of views by meshoptimizer. Its decoder checks the data and nothing else: kind,
//! stride and count are checked here.

use super::json::{Object, shown};
use crate::export::read::error::ReadError;

/// Contents of a compressed view.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Mode {
    Attributes,
    Triangles,
    Indices,
}

/// Transformation of attributes after decompression.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Filter {
    Octahedral,
    Quaternion,
    Exponential,
    Colour,
}

/// A compressed view whose kind, stride and count fit together.
pub(super) struct Stream<'a> {
    pub(super) data: &'a [u8],
    count: usize,
    stride: usize,
    mode: Mode,
    filter: Option<Filter>,
}

/// Maximum number of bytes that one byte of compressed attributes can become: blocks of at most
/// 8,192 bytes, of which every four bytes take a bit or more.
const MOST_PER_BYTE: usize = 1024;

impl<'a> Stream<'a> {
    /// Reads the object of the extension in a view.
    pub(super) fn new(object: &Object<'_>, data: &'a [u8]) -> Result<Self, ReadError> {
        let (count, stride) = (object.required("count")?, object.required("byteStride")?);
        let mode = match object.text("mode").as_deref() {
            Some("ATTRIBUTES") => Mode::Attributes,
            Some("TRIANGLES") => Mode::Triangles,
            Some("INDICES") => Mode::Indices,
            _ => return Err(object.wrong("mode", "it is not ATTRIBUTES, TRIANGLES or INDICES")),
        };
        let filter = match object.text("filter").as_deref() {
            None | Some("NONE") => None,
            Some("OCTAHEDRAL") => Some(Filter::Octahedral),
            Some("QUATERNION") => Some(Filter::Quaternion),
            Some("EXPONENTIAL") => Some(Filter::Exponential),
            Some("COLOR") => Some(Filter::Colour),
            Some(other) => return Err(object.wrong("filter", format!("{} is not known", shown(other)))),
        };
        let strides: &[usize] = match (mode, filter) {
            (Mode::Attributes, Some(Filter::Quaternion)) => &[8],
            (Mode::Attributes, Some(Filter::Octahedral | Filter::Colour)) => &[4, 8],
            (Mode::Attributes, _) => &[],
            _ => &[2, 4],
        };
        let is_stride =
            if strides.is_empty() { stride % 4 == 0 && (4..=256).contains(&stride) } else { strides.contains(&stride) };
        if !is_stride {
            return Err(object.wrong("byteStride", format!("{stride} is no stride of this mode and filter")));
        }
        let fits = match mode {
            Mode::Attributes => count.saturating_mul(stride) / MOST_PER_BYTE <= data.len(),
            Mode::Triangles => count % 3 == 0 && count / 3 <= data.len(),
            Mode::Indices => count <= data.len(),
        };
        if !fits {
            let detail = format!("{count} items cannot come from {} bytes of this mode", data.len());
            return Err(object.wrong("count", detail));
        }
        Ok(Self { data, count, stride, mode, filter: filter.filter(|_| mode == Mode::Attributes) })
    }

    /// Bytes after decompression.
    pub(super) fn decoded_bytes(&self) -> usize {
        self.count.saturating_mul(self.stride)
    }
}

/// Decompresses a view.
///
/// # Errors
/// Describes what is wrong with its data.
pub(super) fn decode(stream: &Stream<'_>) -> Result<Vec<u8>, String> {
    let Stream { data, count, stride, mode, filter } = *stream;
    let decoded = match (mode, stride) {
        (Mode::Attributes, _) => attributes(data, count, stride),
        (Mode::Triangles, 2) => meshopt::decode_index_buffer::<u16>(data, count).map(|list| bytes(&list)),
        (Mode::Triangles, _) => meshopt::decode_index_buffer::<u32>(data, count).map(|list| bytes(&list)),
        (Mode::Indices, 2) => meshopt::decode_index_sequence::<u16>(data, count).map(|list| bytes(&list)),
        (Mode::Indices, _) => meshopt::decode_index_sequence::<u32>(data, count).map(|list| bytes(&list)),
    };
    let mut decoded = decoded.map_err(|_| {
        let first = data.first().map_or_else(|| "none".to_owned(), |byte| format!("{byte:#04x}"));
        format!("its {} bytes (the first is {first}) are not compressed data of this mode, or damaged", data.len())
    })?;
    match (filter, stride) {
        (None, _) => {}
        (Some(Filter::Octahedral), 4) => filtered::<[i8; 4]>(&mut decoded, meshopt::decode_filter_oct),
        (Some(Filter::Octahedral), _) => filtered::<[i16; 4]>(&mut decoded, meshopt::decode_filter_oct),
        (Some(Filter::Colour), 4) => filtered::<[u8; 4]>(&mut decoded, meshopt::decode_filter_color),
        (Some(Filter::Colour), _) => filtered::<[u16; 4]>(&mut decoded, meshopt::decode_filter_color),
        (Some(Filter::Quaternion), _) => filtered::<[i16; 4]>(&mut decoded, meshopt::decode_filter_quat),
        (Some(Filter::Exponential), _) => filtered::<[u32; 1]>(&mut decoded, meshopt::decode_filter_exp),
    }
    Ok(decoded)
}

fn bytes<T: bytemuck::NoUninit>(list: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(list).to_vec()
}

/// Applies a filter to items of type `T`, whose size divides that of the data.
fn filtered<T: bytemuck::Pod>(data: &mut [u8], filter: impl Fn(&mut [T])) {
    let mut items = vec![T::zeroed(); data.len() / size_of::<T>()];
    bytemuck::cast_slice_mut(&mut items).copy_from_slice(data);
    filter(&mut items);
    data.copy_from_slice(bytemuck::cast_slice(&items));
}

/// An item of `N` words. The decoder takes the stride from its type.
#[derive(Clone, Copy)]
struct Words<const N: usize>([u32; N]);

impl<const N: usize> Default for Words<N> {
    fn default() -> Self {
        Self([0; N])
    }
}

fn words<const N: usize>(data: &[u8], count: usize) -> meshopt::Result<Vec<u8>> {
    let items: Vec<Words<N>> = meshopt::decode_vertex_buffer(data, count)?;
    let mut bytes = Vec::with_capacity(count * 4 * N);
    items.iter().for_each(|item| bytes.extend_from_slice(bytemuck::cast_slice(&item.0)));
    Ok(bytes)
}

/// Decompresses attributes of any stride.
fn attributes(data: &[u8], count: usize, stride: usize) -> meshopt::Result<Vec<u8>> {
    macro_rules! of_words {
        ($($n:literal)*) => {
            match stride / 4 {
                $($n => words::<$n>(data, count),)*
                _ => words::<64>(data, count),
            }
        };
    }
    of_words!(1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31 32 33 34 35 36 37 38
        39 40 41 42 43 44 45 46 47 48 49 50 51 52 53 54 55 56 57 58 59 60 61 62 63)
}
