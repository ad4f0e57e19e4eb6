//! Numbers in binary files: integers and floats of 1 to 8 bytes in either byte order.

/// Type of a binary number, with its size in bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Scalar {
    Signed(usize),
    Unsigned(usize),
    Float(usize),
}

impl Scalar {
    /// Bytes of a number.
    pub(super) fn size(self) -> usize {
        let (Self::Signed(size) | Self::Unsigned(size) | Self::Float(size)) = self;
        size
    }

    /// Bits of the number at the beginning of `bytes`; `None` if it has fewer bytes than the
    /// number.
    #[inline]
    pub(super) fn bits(self, bytes: &[u8], little_endian: bool) -> Option<u64> {
        fn word<const N: usize>(bytes: &[u8], little_endian: bool) -> Option<u64> {
            let mut word = [0; 8];
            word[..N].copy_from_slice(bytes.first_chunk::<N>()?);
            if !little_endian {
                word[..N].reverse();
            }
            Some(u64::from_le_bytes(word))
        }
        match self.size() {
            1 => word::<1>(bytes, little_endian),
            2 => word::<2>(bytes, little_endian),
            4 => word::<4>(bytes, little_endian),
            _ => word::<8>(bytes, little_endian),
        }
    }

    /// Value of a number of any type; integers above 2⁵³ are rounded.
    #[inline]
    pub(super) fn float(self, bits: u64) -> f64 {
        match self {
            Self::Float(4) => f64::from(f32::from_bits(bits as u32)),
            Self::Float(_) => f64::from_bits(bits),
            Self::Signed(size) => sign_extended(bits, size) as f64,
            Self::Unsigned(_) => bits as f64,
        }
    }

    /// Value of an integer.
    ///
    /// # Errors
    /// Returns the value if it is above [`i64::MAX`].
    #[inline]
    pub(super) fn integer(self, bits: u64) -> Result<i64, u64> {
        match self {
            Self::Signed(size) => Ok(sign_extended(bits, size)),
            _ => i64::try_from(bits).map_err(|_| bits),
        }
    }
}

fn sign_extended(bits: u64, size: usize) -> i64 {
    let unused = 64 - 8 * size;
    (bits << unused).cast_signed() >> unused
}
