//! JSON bodies of requests, read within limits and parsed strictly.
//!
//! A body is UTF-8 and contains one document of at most 128 levels, without duplicate members.
//! Every error names line and column.

use super::problem::{Kind, Problem};
use crate::http::AppState;
use axum::body::{Body, HttpBody};
use axum::extract::{FromRequest, Request};
use axum::http::{HeaderMap, header};
use http_body_util::BodyExt;
use serde::de::{self, Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_json::{Map, Value};
use std::time::Duration;

/// Number of bytes that are read of a body above the limit, and discarded.
///
/// Closing a connection before the body was read resets it, and a client or proxy that is still
/// sending may then lose the response.
const READ_MAX: usize = 8 << 20;

/// The JSON body of a request.
pub(in crate::http) struct JsonBody(pub(in crate::http) Value);

impl FromRequest<AppState> for JsonBody {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &AppState) -> Result<Self, Problem> {
        body(request, state, state.limits.body_bytes).await.map(Self)
    }
}

/// The JSON body of a request that may contain images.
pub(in crate::http) struct LargeJsonBody(pub(in crate::http) Value);

impl FromRequest<AppState> for LargeJsonBody {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &AppState) -> Result<Self, Problem> {
        body(request, state, state.limits.large_body_bytes).await.map(Self)
    }
}

async fn body(request: Request, state: &AppState, limit: usize) -> Result<Value, Problem> {
    check_media_type(request.headers())?;
    let expects_continue = request.headers().contains_key(header::EXPECT);
    let bytes = read(request.into_body(), expects_continue, limit, state.limits.body_time).await?;
    parse(&bytes)
}

fn check_media_type(headers: &HeaderMap) -> Result<(), Problem> {
    let refuse = |detail: String| Err(Problem::new(Kind::UnsupportedMediaType, detail));
    let Some(value) = headers.get(header::CONTENT_TYPE) else {
        return refuse("The body must be declared as Content-Type: application/json.".into());
    };
    let text = String::from_utf8_lossy(value.as_bytes());
    let Ok(media) = text.parse::<mime::Mime>() else {
        return refuse(format!("`{text}` is not a media type; send application/json."));
    };
    if media.essence_str() != "application/json" {
        return refuse(format!("`{}` is not supported; send application/json.", media.essence_str()));
    }
    match media.get_param(mime::CHARSET) {
        Some(charset) if charset != mime::UTF_8 => refuse(format!("JSON is UTF-8, not {charset}.")),
        _ => Ok(()),
    }
}

/// Reads the bytes of a body. `expects_continue` is true if the client sends the body only after
/// the service starts to read it (`Expect: 100-continue`).
async fn read(mut body: Body, expects_continue: bool, limit: usize, time: Duration) -> Result<Vec<u8>, Problem> {
    let too_large =
        || Problem::new(Kind::PayloadTooLarge, format!("A body may have at most {limit} bytes.")).with("limit", limit);
    let stated = body.size_hint().lower();
    if stated > limit as u64 && (expects_continue || stated > READ_MAX as u64) {
        return Err(too_large());
    }
    let all = async {
        let (mut bytes, mut length) = (Vec::new(), 0);
        while length <= READ_MAX
            && let Some(frame) = body.frame().await
        {
            let data = frame?.into_data().unwrap_or_default();
            length += data.len();
            if length <= limit {
                bytes.extend_from_slice(&data);
            }
        }
        Ok::<_, axum::Error>((bytes, length))
    };
    match tokio::time::timeout(time, all).await {
        Ok(Ok((_, length))) if length > limit => Err(too_large()),
        Ok(Ok((bytes, _))) => Ok(bytes),
        Ok(Err(_)) => Err(Problem::new(Kind::BadRequest, "The connection ended within the body.")),
        Err(_) => Err(Problem::new(Kind::RequestTimeout, "The body did not arrive in time.")),
    }
}

/// Parses one JSON document.
pub(in crate::http) fn parse(bytes: &[u8]) -> Result<Value, Problem> {
    let at = |line: usize, column: usize, detail: String| {
        Problem::new(Kind::InvalidJson, detail).with("line", line).with("column", column)
    };
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let before = &bytes[..error.valid_up_to()];
        let line = before.iter().filter(|&&b| b == b'\n').count() + 1;
        let column = before.iter().rev().take_while(|&&b| b != b'\n').count() + 1;
        at(line, column, format!("invalid UTF-8 at line {line} column {column}"))
    })?;
    serde_json::from_str::<Strict>(text).map(|s| s.0).map_err(|e| at(e.line(), e.column(), e.to_string()))
}

/// A JSON value without duplicate members.
struct Strict(Value);

impl<'de> Deserialize<'de> for Strict {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(StrictVisitor).map(Self)
    }
}

struct StrictVisitor;

impl<'de> Visitor<'de> for StrictVisitor {
    type Value = Value;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a JSON value")
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_u64<E>(self, value: u64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_i64<E>(self, value: i64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<Value, E> {
        serde_json::Number::from_f64(value).map(Value::Number).ok_or_else(|| E::custom("a number is not finite"))
    }

    fn visit_str<E>(self, value: &str) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Value, A::Error> {
        let mut items = Vec::new();
        while let Some(Strict(item)) = seq.next_element()? {
            items.push(item);
        }
        Ok(Value::Array(items))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Value, A::Error> {
        let mut map = Map::new();
        while let Some(key) = entries.next_key::<String>()? {
            if map.contains_key(&key) {
                let name: String = key.chars().take(100).collect();
                return Err(de::Error::custom(format_args!("the member {} is given twice", Value::from(name))));
            }
            let Strict(value) = entries.next_value()?;
            map.insert(key, value);
        }
        Ok(Value::Object(map))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn place(bytes: &[u8]) -> (u64, u64) {
        let problem = parse(bytes).unwrap_err();
        assert_eq!(problem.kind(), Kind::InvalidJson);
        let body = serde_json::to_value(problem.body("", "")).unwrap();
        (body["line"].as_u64().unwrap(), body["column"].as_u64().unwrap())
    }

    #[test]
    fn faults_name_line_and_column() {
        assert_eq!(place(b"{\n  \"a\": x\n}"), (2, 8));
        assert_eq!(place(b"").0, 1);
        assert_eq!(place(b"{} x"), (1, 4));
        assert_eq!(place(b"{\n\"a\xff\": 1}"), (2, 3));
        assert_eq!(place(b"{\"a\": 1,\n \"a\": 2}").0, 2);
        assert_eq!(place(b"[NaN]").0, 1);
        assert_eq!(place(b"[1e999]").0, 1);
        assert_eq!(place(b"[\"\\ud800\"]").0, 1);
    }

    #[test]
    fn a_long_name_given_twice_is_not_repeated_in_full() {
        let name = "n".repeat(100_000);
        let body = parse(format!("{{\"{name}\":1,\"{name}\":2}}").as_bytes()).unwrap_err().body("", "");
        assert!(body.detail.len() < 200, "{}", body.detail);
    }

    #[test]
    fn deep_nesting_is_refused_and_moderate_nesting_is_not() {
        let deep = |n: usize| [vec![b'['; n], vec![b']'; n]].concat();
        assert!(parse(&deep(100)).is_ok());
        place(&deep(129));
        place(&vec![b'['; 500_000]);
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_value_or_a_problem(bytes in prop::collection::vec(any::<u8>(), 0..64)) {
            let ours = parse(&bytes).is_ok();
            let theirs = serde_json::from_slice::<Value>(&bytes).is_ok();
            prop_assert!(!ours || theirs);
        }
    }
}
