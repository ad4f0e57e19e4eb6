//! Specs as SQLite stores them: compressed with Zstandard, so that several records share a page.
//! PostgreSQL compresses long texts by itself.
//!
//! The dictionary is a spec of the preset `pig`. Records refer to it: it must never change.

use std::borrow::Cow;
use std::cell::RefCell;
use std::io;
use std::sync::LazyLock;
use zstd::bulk::{Compressor, Decompressor};
use zstd::dict::{DecoderDictionary, EncoderDictionary};
use zstd::zstd_safe::{MAGICNUMBER, get_frame_content_size};

const DICTIONARY: &[u8] = include_bytes!("spec_dictionary.json");
/// The default level of Zstandard.
const LEVEL: i32 = 3;
/// Length of the longest value that SQLite stores.
const MAX_BYTES: usize = 1_000_000_000;

static ENCODER: LazyLock<EncoderDictionary<'static>> = LazyLock::new(|| EncoderDictionary::copy(DICTIONARY, LEVEL));
static DECODER: LazyLock<DecoderDictionary<'static>> = LazyLock::new(|| DecoderDictionary::copy(DICTIONARY));

thread_local! {
    // Preparing a context takes several times as long as its use for one spec.
    static COMPRESSOR: RefCell<Compressor<'static>> =
        RefCell::new(Compressor::with_prepared_dictionary(&ENCODER).expect("the dictionary is prepared"));
    static DECOMPRESSOR: RefCell<Decompressor<'static>> =
        RefCell::new(Decompressor::with_prepared_dictionary(&DECODER).expect("the dictionary is prepared"));
}

/// The stored form of a spec.
pub(in crate::jobs) fn pack(text: &str) -> Vec<u8> {
    // A text is a stored form, too; SQLite refuses one that is too long.
    if text.len() > MAX_BYTES {
        return text.into();
    }
    COMPRESSOR.with_borrow_mut(|compressor| compressor.compress(text.as_bytes())).unwrap_or_else(|_| text.into())
}

/// The spec of a stored form. Records from before the compression have the text.
pub(in crate::jobs) fn unpack(stored: &[u8]) -> io::Result<Cow<'_, str>> {
    if !stored.starts_with(&MAGICNUMBER.to_le_bytes()) {
        return str::from_utf8(stored).map(Cow::from).map_err(io::Error::other);
    }
    let length = get_frame_content_size(stored).ok().flatten().and_then(|length| usize::try_from(length).ok());
    let length = length.filter(|length| *length <= MAX_BYTES).ok_or(io::ErrorKind::InvalidData)?;
    let text = DECOMPRESSOR.with_borrow_mut(|decompressor| decompressor.decompress(stored, length))?;
    String::from_utf8(text).map(Cow::from).map_err(io::Error::other)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sha2::{Digest as _, Sha256};

    #[test]
    fn records_of_this_version_stay_readable() {
        let digest = hex::encode(Sha256::digest(DICTIONARY));
        assert_eq!(
            digest, "51feb07d271cef397615edcbe49cada153de1dcedbe8e554aeafe33e120ba7cb",
            "stored specs refer to the dictionary"
        );
    }

    #[test]
    fn a_spec_takes_a_fifth_of_its_text_or_less() {
        let spec = crate::spec::preset("paper").unwrap().spec.to_string();
        for text in [spec.as_str(), "{}", "\"not a spec: é\""] {
            assert_eq!(unpack(&pack(text)).unwrap(), text);
            assert_eq!(unpack(text.as_bytes()).unwrap(), text);
        }
        assert!(pack(&spec).len() < spec.len() / 5, "{} of {} bytes", pack(&spec).len(), spec.len());
    }

    #[test]
    fn damaged_records_are_refused() {
        let stored = pack("{\"length_mm\":60}");
        assert!(unpack(&stored[..stored.len() - 1]).is_err());
        assert!(unpack(&stored[..4]).is_err());
        assert!(unpack(b"\xff").is_err());
    }
}
