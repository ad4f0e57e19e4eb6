//! Range requests (RFC 9110, section 14) for one range of bytes.
//!
//! A header with several ranges, another unit or a malformed value is ignored, as the RFC permits.
//! The response is then the whole file.

use std::ops::Range;

/// Bytes of a file that a `Range` header selects.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::http) enum Selection {
    /// The whole file.
    Whole,
    /// A range of bytes that is not empty and lies within the file.
    Part(Range<u64>),
    /// No byte of the file; the response is 416.
    Outside,
}

/// Bytes that the header selects of a file of `len` bytes.
pub(in crate::http) fn select(header: Option<&str>, len: u64) -> Selection {
    header.and_then(|text| parse(text, len)).unwrap_or(Selection::Whole)
}

fn parse(text: &str, len: u64) -> Option<Selection> {
    let (unit, set) = text.split_once('=')?;
    if !unit.trim().eq_ignore_ascii_case("bytes") || set.contains(',') {
        return None;
    }
    let (first, last) = set.trim().split_once('-')?;
    let range = match (first, last) {
        ("", suffix) => len.saturating_sub(number(suffix)?)..len,
        (first, "") => number(first)?..len,
        (first, last) => {
            let (first, last) = (number(first)?, number(last)?);
            if last < first {
                return None;
            }
            first..last.saturating_add(1).min(len)
        }
    };
    Some(if range.start < range.end { Selection::Part(range) } else { Selection::Outside })
}

/// A number of digits only. Numbers of more than 64 bits become `u64::MAX`.
fn number(text: &str) -> Option<u64> {
    (!text.is_empty() && text.bytes().all(|b| b.is_ascii_digit())).then(|| text.parse().unwrap_or(u64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_examples_of_the_rfc() {
        assert_eq!(select(Some("bytes=0-499"), 10_000), Selection::Part(0..500));
        assert_eq!(select(Some("bytes=500-999"), 10_000), Selection::Part(500..1000));
        assert_eq!(select(Some("bytes=-500"), 10_000), Selection::Part(9500..10_000));
        assert_eq!(select(Some("bytes=9500-"), 10_000), Selection::Part(9500..10_000));
    }

    #[test]
    fn nonsense_means_the_whole_file() {
        let all =
            ["", "bytes", "bytes=", "bytes=-", "bytes=a-b", "bytes=5-4", "lines=1-2", "bytes=0-1,3-4", "bytes=+1-2"];
        for text in all {
            assert_eq!(select(Some(text), 10), Selection::Whole, "{text}");
        }
        assert_eq!(select(None, 10), Selection::Whole);
    }

    #[test]
    fn outside_is_outside() {
        for text in ["bytes=10-", "bytes=10-20", "bytes=-0", "bytes=99999999999999999999-"] {
            assert_eq!(select(Some(text), 10), Selection::Outside, "{text}");
        }
        assert_eq!(select(Some("bytes=0-"), 0), Selection::Outside);
    }

    proptest! {
        #[test]
        fn a_part_is_what_a_slice_gives(len in 0usize..300, a in 0usize..400, b in 0usize..400) {
            let file: Vec<usize> = (0..len).collect();
            let cut = |s: Selection| match s {
                Selection::Part(r) => Some(file[r.start as usize..r.end as usize].to_vec()),
                Selection::Outside => None,
                Selection::Whole => Some(file.clone()),
            };
            let got = cut(select(Some(&format!("bytes={a}-{b}")), len as u64));
            let want: Vec<usize> = file.iter().copied().filter(|i| (a..=b).contains(i)).collect();
            if b < a { prop_assert_eq!(got, Some(file.clone())) }
            else { prop_assert_eq!(got, Some(want).filter(|w| !w.is_empty())) }
            let tail = cut(select(Some(&format!("bytes=-{a}")), len as u64));
            let want: Vec<usize> = file[len.saturating_sub(a)..].to_vec();
            prop_assert_eq!(tail, Some(want).filter(|w| !w.is_empty()));
        }

        #[test]
        fn any_header_is_safe(text in ".{0,40}", len in any::<u64>()) {
            if let Selection::Part(r) = select(Some(&text), len) {
                prop_assert!(r.start < r.end && r.end <= len);
            }
        }
    }
}
