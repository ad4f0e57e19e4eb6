//! Views of buffers, decompressed where they are compressed. Every length is checked against the
//! data that exist.

use super::buffers::Buffers;
use super::document::Document;
use super::extensions::MESHOPT;
use super::json::Object;
use super::meshopt::{Stream, decode};
use crate::export::read::error::ReadError;
use std::cell::{Cell, OnceCell};

/// Bytes that views may have after decompression: a multiple of the compressed bytes, and these.
/// Real meshes are compressed about ten times.
const MOST_RATIO: usize = 64;
const MOST_MORE: usize = 64 << 20;

/// Views of a document.
pub(super) struct Views<'a> {
    document: &'a Document<'a>,
    buffers: &'a Buffers<'a>,
    decoded: Vec<OnceCell<Vec<u8>>>,
    /// Bytes that all decoded views may still have.
    room: Cell<usize>,
}

/// Items of a view, a stride apart; the last one may be shorter than the stride.
pub(super) struct Items<'a> {
    pub(super) data: &'a [u8],
    pub(super) stride: usize,
}

impl<'a> Views<'a> {
    pub(super) fn new(document: &'a Document<'a>, buffers: &'a Buffers<'a>) -> Self {
        let decoded = (0..document.views.len()).map(|_| OnceCell::new()).collect();
        Self { document, buffers, decoded, room: Cell::new(MOST_MORE) }
    }

    /// The `count` items of `size` bytes that `user` has in its view `bufferView` from
    /// `byteOffset`; `None` if it has no view.
    pub(super) fn items(&self, user: &Object<'_>, count: usize, size: usize) -> Result<Option<Items<'_>>, ReadError> {
        let Some(index) = user.refer("bufferView", &self.document.views)? else { return Ok(None) };
        let offset = user.integer("byteOffset")?.unwrap_or(0);
        let (data, stride) = self.get(index)?;
        let stride = stride.unwrap_or(size);
        if stride < size {
            let detail = format!("its items of {size} bytes overlap in bufferViews[{index}] of stride {stride}");
            return Err(user.fault(detail));
        }
        let last = count.checked_sub(1).map_or(0, |last| last.saturating_mul(stride).saturating_add(size));
        let end = last.saturating_add(offset);
        let items = data.get(offset..end).map(|data| Some(Items { data, stride }));
        items.ok_or_else(|| {
            let length = data.len();
            user.fault(format!("its {count} items reach to byte {end} of bufferViews[{index}], which has {length}"))
        })
    }

    /// Data and stride of a view.
    fn get(&self, index: usize) -> Result<(&[u8], Option<usize>), ReadError> {
        let view = self.document.views.get(index)?;
        self.document.check(&view, &MESHOPT)?;
        // Some programs write 0 for items that follow each other.
        let stride = view.integer("byteStride")?.filter(|&stride| stride > 0);
        for name in MESHOPT {
            if let Some(compressed) = view.extension(name)? {
                let own = compressed.required("byteStride")?;
                if stride.is_some_and(|stride| stride != own) {
                    return Err(compressed.wrong("byteStride", format!("{own} is not the stride of the view")));
                }
                return Ok((self.decoded(index, &compressed)?, Some(own)));
            }
        }
        Ok((self.slice(&view)?, stride))
    }

    /// Bytes that a view, or its compressed form, has in its buffer.
    fn slice(&self, view: &Object<'_>) -> Result<&[u8], ReadError> {
        let missing = || view.wrong("buffer", "it is missing");
        let index = view.refer("buffer", &self.document.buffers)?.ok_or_else(missing)?;
        let (offset, length) = (view.integer("byteOffset")?.unwrap_or(0), view.required("byteLength")?);
        let (data, end) = (self.buffers.get(index)?, offset.saturating_add(length));
        let beyond = || view.fault(format!("it reaches to byte {end} of buffers[{index}], which has {}", data.len()));
        data.get(offset..end).ok_or_else(beyond)
    }

    fn decoded(&self, index: usize, compressed: &Object<'_>) -> Result<&[u8], ReadError> {
        let cell = &self.decoded[index];
        if let Some(data) = cell.get() {
            return Ok(data);
        }
        let stream = Stream::new(compressed, self.slice(compressed)?)?;
        let room = self.room.get().saturating_add(stream.data.len().saturating_mul(MOST_RATIO));
        let room = room.checked_sub(stream.decoded_bytes()).ok_or_else(|| {
            compressed.wrong("count", "so many items from so few bytes, with those of other views, are not read")
        })?;
        self.room.set(room);
        let data = decode(&stream).map_err(|detail| compressed.fault(detail))?;
        Ok(cell.get_or_init(|| data))
    }
}
