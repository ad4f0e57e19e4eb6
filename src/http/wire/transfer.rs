//! The `Transfer-Encoding` header of a request (RFC 9112, section 6.1).

use super::problem::{Kind, Problem};
use axum::http::{HeaderMap, header};

/// Refuses a request with a transfer coding other than `chunked`: its body would be read without
/// being decoded. The server itself refuses a request whose last coding is not `chunked` (400).
pub(in crate::http) fn check(headers: &HeaderMap) -> Result<(), Problem> {
    let values = headers.get_all(header::TRANSFER_ENCODING).iter();
    let mut codings = values.flat_map(|value| value.as_bytes().split(|byte| *byte == b',')).map(<[u8]>::trim_ascii);
    match codings.find(|coding| !coding.is_empty() && !coding.eq_ignore_ascii_case(b"chunked")) {
        None => Ok(()),
        Some(coding) => {
            let coding = String::from_utf8_lossy(coding).into_owned();
            let detail = format!("The transfer coding {coding} is not supported; use chunked alone.");
            Err(Problem::new(Kind::TransferCoding, detail))
        }
    }
}
