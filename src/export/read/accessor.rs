//! The numbers behind glTF accessors, every length checked against the data that is there.

use super::ReadError;
use super::gltf::fault;
use ::gltf::Accessor;
use ::gltf::accessor::{DataType, Dimensions};
use std::borrow::Cow;

/// Positions: three f32 each.
pub(super) fn positions(accessor: &Accessor<'_>, buffers: &[Cow<'_, [u8]>]) -> Result<Vec<[f64; 3]>, ReadError> {
    if (accessor.data_type(), accessor.dimensions()) != (DataType::F32, Dimensions::Vec3) {
        return Err(fault(name(accessor), "positions are not three f32 each"));
    }
    let rows = rows::<12>(accessor, buffers)?;
    Ok(rows
        .map(|row| {
            let (floats, _) = row.as_chunks::<4>();
            [floats[0], floats[1], floats[2]].map(|b| f64::from(f32::from_le_bytes(b)))
        })
        .collect())
}

/// Indices: u8, u16 or u32.
pub(super) fn indices(accessor: &Accessor<'_>, buffers: &[Cow<'_, [u8]>]) -> Result<Vec<u32>, ReadError> {
    if accessor.dimensions() != Dimensions::Scalar {
        return Err(fault(name(accessor), "indices are not scalars"));
    }
    Ok(match accessor.data_type() {
        DataType::U8 => rows::<1>(accessor, buffers)?.map(|b| u32::from(b[0])).collect(),
        DataType::U16 => rows::<2>(accessor, buffers)?.map(|b| u32::from(u16::from_le_bytes(*b))).collect(),
        DataType::U32 => rows::<4>(accessor, buffers)?.map(|b| u32::from_le_bytes(*b)).collect(),
        _ => return Err(fault(name(accessor), "indices are not unsigned integers")),
    })
}

fn name(accessor: &Accessor<'_>) -> String {
    format!("accessors[{}]", accessor.index())
}

/// The items of an accessor, `N` bytes each.
fn rows<'b, const N: usize>(
    accessor: &Accessor<'_>,
    buffers: &'b [Cow<'_, [u8]>],
) -> Result<impl Iterator<Item = &'b [u8; N]>, ReadError> {
    let wrong = |detail: &str| fault(name(accessor), detail);
    if accessor.sparse().is_some() {
        return Err(wrong("sparse accessors are not read"));
    }
    let view = accessor.view().ok_or_else(|| wrong("it has no buffer view"))?;
    let data: &'b [u8] = buffers.get(view.buffer().index()).ok_or_else(|| wrong("its buffer is not there"))?;
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
    Ok(data.chunks(stride).take(count).filter_map(|row| row.first_chunk::<N>()))
}
