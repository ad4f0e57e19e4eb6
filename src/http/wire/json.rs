//! JSON bodies of requests, read within limits and parsed strictly.
//!
//! A body is UTF-8 and contains one document of at most 128 levels and of a limited number of
//! values, without duplicate members. Every error names line and column.
//!
//! All bodies together have a budget of memory, of which one owner can use half. A body takes from
//! it what has arrived of its text, and then what its values need. A small text can need much: a
//! list of objects needs a hundred times the memory of its text.

use super::blocking::blocking;
use super::problem::{Kind, Problem};
#[cfg(any(test, feature = "fuzzing"))]
use super::shares::Shares;
use super::shares::{Exhausted, Share};
use crate::http::AppState;
use crate::http::access::Caller;
use axum::body::{Body, HttpBody};
use axum::extract::{FromRequest, Request};
use axum::http::{HeaderMap, header};
use http_body_util::BodyExt;
use serde::de::{self, DeserializeSeed, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_json::{Map, Value};
use std::ops::Deref;
use std::time::Duration;

/// Number of bytes that are read of a body above a limit, and discarded.
///
/// Closing a connection before the body was read resets it, and a client or proxy that is still
/// sending may then lose the response.
const READ_MAX: usize = 8 << 20;
/// Maximum size of a body that is parsed on a thread of the async runtime, in bytes. Parsing it
/// takes less than a millisecond, so another thread would only delay it.
const INLINE_MAX: usize = 32 << 10;
/// Amount in which the memory of text is taken from the budget, in bytes: a page.
const TEXT_STEP: usize = 4 << 10;
/// Size of a piece of text, in bytes.
const PIECE: usize = 64 << 10;
/// Amount in which the memory of values is taken from the budget, in bytes.
const VALUE_STEP: usize = 64 << 10;

/// Memory of a value in a list or object, in bytes. Lists double when they grow.
const VALUE_BYTES: usize = 2 * size_of::<Value>();
/// Memory of a list of one value: lists start with room for four.
const LIST_BYTES: usize = 2 * VALUE_BYTES;
/// Memory of an object of one member: a node of its tree has room for eleven.
const OBJECT_BYTES: usize = 640;
/// Memory of a member, besides its name and value: half of the nodes can be empty.
const MEMBER_BYTES: usize = 64;

/// The JSON body of a request.
pub(in crate::http) struct JsonBody {
    value: Value,
    memory: Share,
}

impl JsonBody {
    /// The value, and its memory in the budget of all bodies, which must be held as long as the
    /// value.
    pub(in crate::http) fn into_parts(self) -> (Value, Share) {
        (self.value, self.memory)
    }
}

impl Deref for JsonBody {
    type Target = Value;

    fn deref(&self) -> &Value {
        &self.value
    }
}

impl FromRequest<AppState> for JsonBody {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &AppState) -> Result<Self, Problem> {
        body(request, state, state.limits.body_bytes).await
    }
}

/// The JSON body of a request that may contain images.
pub(in crate::http) struct LargeJsonBody(pub(in crate::http) JsonBody);

impl FromRequest<AppState> for LargeJsonBody {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &AppState) -> Result<Self, Problem> {
        body(request, state, state.limits.large_body_bytes).await.map(Self)
    }
}

async fn body(request: Request, state: &AppState, limit: usize) -> Result<JsonBody, Problem> {
    check_media_type(request.headers())?;
    let expects_continue = request.headers().contains_key(header::EXPECT);
    let owner = request.extensions().get::<Caller>().and_then(Caller::owner).map(str::to_owned);
    let memory = state.bodies.take(owner.as_deref(), 0).map_err(crowded)?;
    let text = BodyText::new(memory);
    let text = read(request.into_body(), text, expects_continue, limit, state.limits.body_time).await?;
    let max_values = state.limits.body_values();
    if text.length <= INLINE_MAX {
        return parse_text(text, max_values);
    }
    let turn = state.parsing.turn(owner.as_deref(), state.limits.picture_wait).await.ok_or_else(|| {
        let problem = Problem::new(Kind::TooManyBodies, "Many large bodies are being parsed. Try again later.");
        problem.with_header(header::RETRY_AFTER, 5)
    })?;
    blocking("Parsing the body", turn, move || parse_text(text, max_values)).await?
}

fn parse_text(text: BodyText, max_values: usize) -> Result<JsonBody, Problem> {
    let (bytes, memory) = text.join();
    let of_text = memory.amount();
    let mut meter = ValueMeter::new(max_values, memory);
    let value = parse_metered(&bytes, &mut meter)?;
    drop(bytes);
    let mut memory = meter.memory;
    memory.shrink(of_text);
    Ok(JsonBody { value, memory })
}

/// 503 for a body without memory.
fn crowded(exhausted: Exhausted) -> Problem {
    let detail = format!(
        "Request bodies {} may take {} MiB of memory at a time. Try again later.",
        exhausted.callers(),
        exhausted.limit() >> 20
    );
    Problem::new(Kind::TooManyBodies, detail).with_header(header::RETRY_AFTER, 5)
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

/// The text of a body as far as it has arrived, and its memory.
struct BodyText {
    /// Pieces of [`PIECE`] bytes, except the last one. Bodies of any size use the same pieces, so
    /// what a body leaves to the allocator is soon a part of another.
    pieces: Vec<Vec<u8>>,
    length: usize,
    memory: Share,
}

impl BodyText {
    fn new(memory: Share) -> Self {
        Self { pieces: Vec::new(), length: 0, memory }
    }

    /// Adds bytes of a body that has at most `most`.
    fn push(&mut self, mut data: &[u8], most: usize) -> Result<(), Exhausted> {
        let length = self.length + data.len();
        if length > self.memory.amount() {
            self.memory.grow(length.next_multiple_of(TEXT_STEP) - self.memory.amount())?;
        }
        while !data.is_empty() {
            if self.length.is_multiple_of(PIECE) {
                self.pieces.push(Vec::with_capacity(PIECE.min(most.saturating_sub(self.length))));
            }
            let (now, later) = data.split_at(data.len().min(PIECE - self.length % PIECE));
            self.pieces.last_mut().expect("the last piece has room").extend_from_slice(now);
            self.length += now.len();
            data = later;
        }
        Ok(())
    }

    /// The whole text, and its memory.
    fn join(mut self) -> (Vec<u8>, Share) {
        let text = if self.pieces.len() > 1 { self.pieces.concat() } else { self.pieces.pop().unwrap_or_default() };
        (text, self.memory)
    }
}

/// Reads a body into `text`. `expects_continue` is true if the client sends the body only after the
/// service starts to read it (`Expect: 100-continue`).
async fn read(
    mut body: Body,
    text: BodyText,
    expects_continue: bool,
    limit: usize,
    time: Duration,
) -> Result<BodyText, Problem> {
    let too_large =
        || Problem::new(Kind::PayloadTooLarge, format!("A body may have at most {limit} bytes.")).with("limit", limit);
    let stated = body.size_hint().lower();
    if stated > limit as u64 && (expects_continue || stated > READ_MAX as u64) {
        return Err(too_large());
    }
    // A body of known length needs no more room.
    let most = body.size_hint().exact().and_then(|exact| usize::try_from(exact).ok()).map_or(limit, |n| n.min(limit));
    let all = async {
        let (mut text, mut length) = (Ok(text), 0);
        while length <= READ_MAX.max(limit)
            && let Some(frame) = body.frame().await
        {
            let data = frame?.into_data().unwrap_or_default();
            length += data.len();
            // A refused body has no text, so it takes no memory while the rest arrives.
            if length > limit {
                text = Err(too_large());
            } else if let Ok(arrived) = &mut text
                && let Err(exhausted) = arrived.push(&data, most)
            {
                text = Err(crowded(exhausted));
            }
        }
        Ok::<_, axum::Error>(text)
    };
    match tokio::time::timeout(time, all).await {
        Ok(Ok(text)) => text,
        Ok(Err(_)) => Err(Problem::new(Kind::BadRequest, "The connection ended within the body.")),
        Err(_) => Err(Problem::new(Kind::RequestTimeout, "The body did not arrive in time.")),
    }
}

/// Parses one JSON document without limits.
#[cfg(any(test, feature = "fuzzing"))]
pub(in crate::http) fn parse(bytes: &[u8]) -> Result<Value, Problem> {
    let memory = Shares::halves(usize::MAX).take(None, 0).map_err(crowded)?;
    parse_metered(bytes, &mut ValueMeter::new(usize::MAX, memory))
}

/// Parses one JSON document within the limits of `meter`.
fn parse_metered(bytes: &[u8], meter: &mut ValueMeter) -> Result<Value, Problem> {
    let at = |kind: Kind, line: usize, column: usize, detail: String| {
        Problem::new(kind, detail).with("line", line).with("column", column)
    };
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let before = &bytes[..error.valid_up_to()];
        let line = before.iter().filter(|&&b| b == b'\n').count() + 1;
        let column = before.iter().rev().take_while(|&&b| b != b'\n').count() + 1;
        at(Kind::InvalidJson, line, column, format!("invalid UTF-8 at line {line} column {column}"))
    })?;
    let mut deserializer = serde_json::Deserializer::from_str(text);
    let value = Strict(&mut *meter).deserialize(&mut deserializer).and_then(|value| {
        deserializer.end()?;
        meter.take_pending()?;
        Ok(value)
    });
    value.map_err(|error| {
        let place = |kind: Kind| at(kind, error.line(), error.column(), error.to_string());
        match meter.refusal {
            None => place(Kind::InvalidJson),
            Some(MeterRefusal::Values) => place(Kind::PayloadTooLarge).with("limit", meter.max_values),
            // The end of the document has no place.
            Some(MeterRefusal::Memory) if error.line() == 0 => Problem::new(Kind::PayloadTooLarge, error.to_string()),
            Some(MeterRefusal::Memory) => place(Kind::PayloadTooLarge),
            Some(MeterRefusal::Crowded(exhausted)) => crowded(exhausted),
        }
    })
}

/// Counts the values of a document while they are parsed, and takes their memory from the budget.
struct ValueMeter {
    values: usize,
    max_values: usize,
    memory: Share,
    /// Memory that is still to be taken, in bytes.
    pending: usize,
    /// The reason for which parsing stopped, if it is not the syntax.
    refusal: Option<MeterRefusal>,
}

#[derive(Clone, Copy)]
enum MeterRefusal {
    /// The document has too many values.
    Values,
    /// The document alone takes more memory than there is, so a retry would not help.
    Memory,
    /// Other bodies take the memory.
    Crowded(Exhausted),
}

impl ValueMeter {
    fn new(max_values: usize, memory: Share) -> Self {
        Self { values: 0, max_values, memory, pending: 0, refusal: None }
    }

    /// Counts a value without its contents.
    fn count_value<E: de::Error>(&mut self) -> Result<(), E> {
        if self.values == self.max_values {
            self.refusal = Some(MeterRefusal::Values);
            return Err(E::custom(format_args!("the body has more than {} values", self.max_values)));
        }
        self.values += 1;
        self.count_bytes(VALUE_BYTES)
    }

    fn count_bytes<E: de::Error>(&mut self, bytes: usize) -> Result<(), E> {
        self.pending += bytes;
        if self.pending < VALUE_STEP { Ok(()) } else { self.take_pending() }
    }

    fn take_pending<E: de::Error>(&mut self) -> Result<(), E> {
        let bytes = std::mem::take(&mut self.pending);
        self.memory.grow(bytes).map_err(|exhausted| {
            let is_alone = self.memory.amount() + bytes > exhausted.limit();
            self.refusal = Some(if is_alone { MeterRefusal::Memory } else { MeterRefusal::Crowded(exhausted) });
            E::custom(format_args!("the values of the body need more than {} MiB of memory", exhausted.limit() >> 20))
        })
    }
}

/// Reads a JSON value without duplicate members.
struct Strict<'a>(&'a mut ValueMeter);

impl<'de> DeserializeSeed<'de> for Strict<'_> {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        self.0.count_value()?;
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Strict<'_> {
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

    fn visit_str<E: de::Error>(self, value: &str) -> Result<Value, E> {
        self.0.count_bytes(value.len())?;
        Ok(value.into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Value, A::Error> {
        let mut items = Vec::new();
        while let Some(item) = seq.next_element_seed(Strict(&mut *self.0))? {
            if items.is_empty() {
                self.0.count_bytes(LIST_BYTES)?;
            }
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
            let of_node = if map.is_empty() { OBJECT_BYTES } else { 0 };
            self.0.count_bytes(of_node + MEMBER_BYTES + key.len())?;
            let value = entries.next_value_seed(Strict(&mut *self.0))?;
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

    fn metered(text: &str, max_values: usize, max_bytes: usize) -> Result<usize, Problem> {
        let shares = Shares::halves(max_bytes);
        let mut meter = ValueMeter::new(max_values, shares.take(None, 0).unwrap());
        parse_metered(text.as_bytes(), &mut meter).map(|_| shares.used())
    }

    #[test]
    fn the_values_of_a_document_are_limited() {
        for (text, values) in [("[1,\n[2], {\"a\": 3}]", 6), ("{\"a\":\n{\"b\": null, \"c\": \"x\"}}", 4)] {
            assert!(metered(text, values, usize::MAX).is_ok());
            let problem = metered(text, values - 1, usize::MAX).unwrap_err();
            assert_eq!(problem.kind(), Kind::PayloadTooLarge);
            let body = serde_json::to_value(problem.body("", "")).unwrap();
            assert_eq!(
                (&body["limit"], body["line"].as_u64()),
                (&(values - 1).into(), Some(text.lines().count() as u64))
            );
            assert!(body["column"].is_u64());
        }
    }

    /// A sixth of the members of an object with sorted names begins a node of eleven members.
    #[test]
    fn the_memory_of_values_is_counted() {
        let value = size_of::<Value>();
        let node = 11 * (size_of::<String>() + value);
        for (text, at_least) in [
            (format!("[{}]", vec!["{}"; 1000].join(",")), 1000 * value),
            (format!("[{}]", vec!["[0]"; 1000].join(",")), 1000 * (value + 4 * value)),
            (format!("[{}]", vec!["{\"\":0}"; 1000].join(",")), 1000 * (value + node)),
            (format!("{}0{}", "{\"\":".repeat(100), "}".repeat(100)), 100 * node),
            (format!("\"{}\"", "x".repeat(1000)), 1000),
            (format!("{{\"{}\":0}}", "x".repeat(1000)), 1000 + node),
            (
                format!("{{{}}}", (10_000..11_000).map(|n| format!("\"{n}\":0")).collect::<Vec<_>>().join(",")),
                1000 / 6 * node + 1000 * 5,
            ),
        ] {
            let counted = metered(&text, usize::MAX, usize::MAX).unwrap();
            assert!((at_least..4 * at_least + 200).contains(&counted), "{counted}, not {at_least}, of {text:.50}");
            let problem = metered(&text, usize::MAX, at_least - 1).unwrap_err();
            assert_eq!(problem.kind(), Kind::PayloadTooLarge, "{text:.50}");
        }
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
