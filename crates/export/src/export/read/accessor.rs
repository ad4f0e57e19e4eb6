//! Numbers of glTF accessors. Every length is checked against the data that exist before use.

use super::buffers::Buffers;
use super::error::ReadError;
use super::scalar::Scalar;
use ::gltf::Accessor;
use ::gltf::accessor::{DataType, Dimensions};

/// Reads positions: three f32 each.
pub(super) fn positions<'b>(
    accessor: &Accessor<'_>,
    buffers: &'b Buffers<'_>,
) -> Result<impl ExactSizeIterator<Item = [f64; 3]> + use<'b>, ReadError> {
    if (accessor.data_type(), accessor.dimensions()) != (DataType::F32, Dimensions::Vec3) {
        return Err(ReadError::document(name(accessor), "positions are not three f32 each"));
    }
    let point = |item: &[u8]| {
        let (floats, _) = item.as_chunks::<4>();
        [floats[0], floats[1], floats[2]].map(|b| f64::from(f32::from_le_bytes(b)))
    };
    Ok(items(accessor, buffers)?.map(point))
}

/// Reads indices: u8, u16 or u32.
pub(super) fn indices(accessor: &Accessor<'_>, buffers: &Buffers<'_>) -> Result<Vec<u32>, ReadError> {
    if accessor.dimensions() != Dimensions::Scalar {
        return Err(ReadError::document(name(accessor), "indices are not scalars"));
    }
    if !matches!(accessor.data_type(), DataType::U8 | DataType::U16 | DataType::U32) {
        return Err(ReadError::document(name(accessor), "indices are not unsigned integers"));
    }
    let scalar = Scalar::Unsigned(accessor.size());
    let index = |item| scalar.bits(item, true).unwrap_or_default() as u32;
    Ok(items(accessor, buffers)?.map(index).collect())
}

/// Number of items of an accessor of positions or indices.
///
/// # Errors
/// [`ReadError::Document`] unless the data of all items exist.
pub(super) fn count(accessor: &Accessor<'_>, buffers: &Buffers<'_>) -> Result<u64, ReadError> {
    if !matches!(accessor.size(), 1 | 2 | 4 | 12) {
        return Err(ReadError::document(name(accessor), "it holds neither positions nor indices"));
    }
    Ok(items(accessor, buffers)?.len() as u64)
}

fn name(accessor: &Accessor<'_>) -> String {
    format!("accessors[{}]", accessor.index())
}

/// Bytes of each item of an accessor.
fn items<'b>(
    accessor: &Accessor<'_>,
    buffers: &'b Buffers<'_>,
) -> Result<impl ExactSizeIterator<Item = &'b [u8]> + use<'b>, ReadError> {
    let wrong = |detail: &str| ReadError::document(name(accessor), detail);
    if accessor.sparse().is_some() {
        return Err(wrong("sparse accessors are not read"));
    }
    let view = accessor.view().ok_or_else(|| wrong("it has no buffer view"))?;
    let data: &'b [u8] = buffers.get(view.buffer().index()).ok_or_else(|| wrong("its buffer does not exist"))?;
    let data = view.offset().checked_add(view.length()).and_then(|end| data.get(view.offset()..end));
    let data = data.ok_or_else(|| wrong("its buffer view reaches beyond the data"))?;
    let (count, size) = (accessor.count(), accessor.size());
    let stride = view.stride().unwrap_or(size);
    if stride < size {
        return Err(wrong("its items overlap"));
    }
    let last = count.saturating_sub(1).checked_mul(stride).and_then(|last| last.checked_add(size));
    let end = last.and_then(|last| last.checked_add(accessor.offset()));
    let data = end.and_then(|end| data.get(accessor.offset()..end));
    let data = data.ok_or_else(|| wrong("it reaches beyond its buffer view"))?;
    Ok(data.chunks(stride).take(count).map(move |item| &item[..size]))
}
