//! The numbers behind glTF accessors. Every length is checked against the data that exist before it is used.

use super::buffers::Buffers;
use super::error::ReadError;
use ::gltf::Accessor;
use ::gltf::accessor::{DataType, Dimensions};

type Row<'b, const N: usize> = &'b [u8; N];

/// Positions: three f32 each.
pub(super) fn positions<'b>(
    accessor: &Accessor<'_>,
    buffers: &'b Buffers<'_>,
) -> Result<impl ExactSizeIterator<Item = [f64; 3]> + use<'b>, ReadError> {
    if (accessor.data_type(), accessor.dimensions()) != (DataType::F32, Dimensions::Vec3) {
        return Err(ReadError::document(name(accessor), "positions are not three f32 each"));
    }
    let point = |row: Row<'_, 12>| {
        let (floats, _) = row.as_chunks::<4>();
        [floats[0], floats[1], floats[2]].map(|b| f64::from(f32::from_le_bytes(b)))
    };
    Ok(rows::<12>(accessor, buffers)?.map(point))
}

/// Indices: u8, u16 or u32.
pub(super) fn indices(accessor: &Accessor<'_>, buffers: &Buffers<'_>) -> Result<Vec<u32>, ReadError> {
    if accessor.dimensions() != Dimensions::Scalar {
        return Err(ReadError::document(name(accessor), "indices are not scalars"));
    }
    Ok(match accessor.data_type() {
        DataType::U8 => rows::<1>(accessor, buffers)?.map(|b| u32::from(b[0])).collect(),
        DataType::U16 => rows::<2>(accessor, buffers)?.map(|b| u32::from(u16::from_le_bytes(*b))).collect(),
        DataType::U32 => rows::<4>(accessor, buffers)?.map(|b| u32::from_le_bytes(*b)).collect(),
        _ => return Err(ReadError::document(name(accessor), "indices are not unsigned integers")),
    })
}

/// The number of items of an accessor.
///
/// # Errors
/// [`ReadError::Document`] unless the data of all items exist.
pub(super) fn count(accessor: &Accessor<'_>, buffers: &Buffers<'_>) -> Result<u64, ReadError> {
    Ok(match accessor.size() {
        1 => rows::<1>(accessor, buffers)?.len(),
        2 => rows::<2>(accessor, buffers)?.len(),
        4 => rows::<4>(accessor, buffers)?.len(),
        12 => rows::<12>(accessor, buffers)?.len(),
        _ => return Err(ReadError::document(name(accessor), "it holds neither positions nor indices")),
    } as u64)
}

fn name(accessor: &Accessor<'_>) -> String {
    format!("accessors[{}]", accessor.index())
}

/// The items of an accessor, `N` bytes each.
fn rows<'b, const N: usize>(
    accessor: &Accessor<'_>,
    buffers: &'b Buffers<'_>,
) -> Result<impl ExactSizeIterator<Item = Row<'b, N>> + use<'b, N>, ReadError> {
    let wrong = |detail: &str| ReadError::document(name(accessor), detail);
    if accessor.sparse().is_some() {
        return Err(wrong("sparse accessors are not read"));
    }
    let view = accessor.view().ok_or_else(|| wrong("it has no buffer view"))?;
    let data: &'b [u8] = buffers.get(view.buffer().index()).ok_or_else(|| wrong("its buffer does not exist"))?;
    let data = view.offset().checked_add(view.length()).and_then(|end| data.get(view.offset()..end));
    let data = data.ok_or_else(|| wrong("its buffer view reaches beyond the data"))?;
    let (count, stride) = (accessor.count(), view.stride().unwrap_or(N));
    if stride < N {
        return Err(wrong("its items overlap"));
    }
    let last = count.saturating_sub(1).checked_mul(stride).and_then(|last| last.checked_add(N));
    let end = last.and_then(|last| last.checked_add(accessor.offset()));
    let data = end.and_then(|end| data.get(accessor.offset()..end));
    let data = data.ok_or_else(|| wrong("it reaches beyond its buffer view"))?;
    let row = |row: &'b [u8]| row.first_chunk::<N>().expect("each row has its bytes, the last one included");
    Ok(data.chunks(stride).take(count).map(row))
}
