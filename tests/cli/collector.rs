//! A trace collector on the loopback interface that receives OTLP over HTTP and stores the spans.

use opentelemetry_proto::tonic::collector::trace::v1::ExportTraceServiceRequest;
use opentelemetry_proto::tonic::common::v1::any_value::Value;
use opentelemetry_proto::tonic::trace::v1::Span;
use prost::Message;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};

/// Received service names and spans.
#[derive(Clone, Debug, Default)]
pub struct Arrived {
    pub services: Vec<String>,
    pub spans: Vec<Span>,
}

impl Arrived {
    pub fn named(&self, name: &str) -> impl Iterator<Item = &Span> {
        self.spans.iter().filter(move |span| span.name == name)
    }
}

pub struct Collector {
    pub url: String,
    arrived: Arc<Mutex<Arrived>>,
}

impl Collector {
    pub fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let url = format!("http://{}", listener.local_addr().expect("bound"));
        let arrived = Arc::new(Mutex::new(Arrived::default()));
        let all = Arc::clone(&arrived);
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let all = Arc::clone(&all);
                std::thread::spawn(move || serve(stream, &all));
            }
        });
        Self { url, arrived }
    }

    pub fn arrived(&self) -> Arrived {
        self.arrived.lock().expect("not poisoned").clone()
    }
}

fn serve(stream: TcpStream, all: &Mutex<Arrived>) {
    let mut reader = BufReader::new(stream);
    while let Some((head, body)) = request(&mut reader) {
        assert!(head.starts_with("POST /v1/traces "), "{head}");
        let sent = ExportTraceServiceRequest::decode(body.as_slice()).expect("an OTLP request");
        let mut all = all.lock().expect("not poisoned");
        for of_resource in sent.resource_spans {
            for attribute in of_resource.resource.into_iter().flat_map(|resource| resource.attributes) {
                if let ("service.name", Some(Value::StringValue(name))) =
                    (attribute.key.as_str(), attribute.value.and_then(|value| value.value))
                {
                    all.services.push(name);
                }
            }
            all.spans.extend(of_resource.scope_spans.into_iter().flat_map(|scope| scope.spans));
        }
        drop(all);
        let answer = "HTTP/1.1 200 OK\r\nContent-Type: application/x-protobuf\r\nContent-Length: 0\r\n\r\n";
        reader.get_mut().write_all(answer.as_bytes()).expect("answered");
    }
}

/// The next request on a connection: its head and its body. `None` at the end.
fn request(reader: &mut BufReader<TcpStream>) -> Option<(String, Vec<u8>)> {
    let (mut head, mut length) = (String::new(), 0);
    loop {
        let mut line = String::new();
        if reader.read_line(&mut line).ok()? == 0 {
            return None;
        }
        if line == "\r\n" {
            break;
        }
        let lower = line.to_lowercase();
        if let Some(value) = lower.strip_prefix("content-length:") {
            length = value.trim().parse().expect("a length");
        }
        head.push_str(&line);
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body).ok()?;
    Some((head, body))
}
