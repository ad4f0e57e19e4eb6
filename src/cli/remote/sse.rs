//! Reads server-sent events (WHATWG HTML, section 9.2) from a stream of bytes.

/// One event.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(in crate::cli) struct Event {
    /// Type; `message` if the server sent none.
    pub(in crate::cli) kind: String,
    /// Id of this event, or of the last earlier event that has an id.
    pub(in crate::cli) id: Option<String>,
    /// Payload.
    pub(in crate::cli) data: String,
}

/// Assembles events from pieces that may be cut anywhere.
#[derive(Debug, Default)]
pub(in crate::cli) struct Parser {
    line: Vec<u8>,
    kind: String,
    data: Option<String>,
    id: Option<String>,
}

impl Parser {
    /// Takes the next piece of the stream and returns the events that it completes.
    pub(in crate::cli) fn feed(&mut self, piece: &[u8]) -> Vec<Event> {
        let mut events = Vec::new();
        for &byte in piece {
            if byte == b'\n' {
                let line = std::mem::take(&mut self.line);
                let line = String::from_utf8_lossy(&line);
                events.extend(self.end_of_line(line.strip_suffix('\r').unwrap_or(&line)));
            } else {
                self.line.push(byte);
            }
        }
        events
    }

    fn end_of_line(&mut self, line: &str) -> Option<Event> {
        if line.is_empty() {
            let kind = std::mem::take(&mut self.kind);
            let data = self.data.take()?;
            let kind = if kind.is_empty() { "message".to_owned() } else { kind };
            return Some(Event { kind, id: self.id.clone(), data });
        }
        let (field, value) = line.split_once(':').unwrap_or((line, ""));
        let value = value.strip_prefix(' ').unwrap_or(value);
        match field {
            "event" => value.clone_into(&mut self.kind),
            "id" => self.id = Some(value.to_owned()),
            "data" => match &mut self.data {
                Some(data) => {
                    data.push('\n');
                    data.push_str(value);
                }
                None => self.data = Some(value.to_owned()),
            },
            _ => {}
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const STREAM: &str = ": hello\n\nevent: status\nid: 1\ndata: {\"a\":\ndata: \"ü\"}\n\n:\n\nid: 2\ndata:x\n\nevent: end\n\n\
                          event: end\r\nid: 3\r\ndata: bye\r\n\r\ndata: unfinished\n";

    fn expected() -> Vec<Event> {
        let event =
            |kind: &str, id: &str, data: &str| Event { kind: kind.into(), id: Some(id.into()), data: data.into() };
        vec![event("status", "1", "{\"a\":\n\"ü\"}"), event("message", "2", "x"), event("end", "3", "bye")]
    }

    proptest! {
        #[test]
        fn events_do_not_depend_on_where_the_stream_is_cut(cuts in proptest::collection::vec(0..STREAM.len(), 0..8)) {
            let mut cuts = cuts;
            cuts.extend([0, STREAM.len()]);
            cuts.sort_unstable();
            let mut parser = Parser::default();
            let events: Vec<_> = cuts.windows(2).flat_map(|w| parser.feed(&STREAM.as_bytes()[w[0]..w[1]])).collect();
            prop_assert_eq!(events, expected());
        }
    }
}
