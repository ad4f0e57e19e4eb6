//! Limit on the connections of one address that have no request.
//!
//! A connection has no request until a head has arrived, and again after the response. Such
//! connections cost a client nothing, and one client could hold all places with them.

use crate::lock::Mutex;
use axum::body::Body;
use axum::response::Response;
use http_body_util::BodyExt;
use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::Arc;
use tokio_util::sync::CancellationToken;

/// The connections without a request, by address.
#[derive(Debug)]
pub(super) struct WaitingConnections {
    /// Maximum per address.
    most: usize,
    counts: Mutex<HashMap<IpAddr, usize>>,
}

/// Counts one connection while it exists.
#[derive(Debug)]
struct Waiting {
    all: Arc<WaitingConnections>,
    address: IpAddr,
}

/// A connection of a client.
#[derive(Debug)]
pub(super) struct ClientConnection {
    all: Arc<WaitingConnections>,
    address: IpAddr,
    /// `None` during a request.
    waiting: Mutex<Option<Waiting>>,
    /// Cancelled if the connection must be closed after its response.
    surplus: CancellationToken,
}

impl WaitingConnections {
    pub(super) fn new(most: usize) -> Arc<Self> {
        Arc::new(Self { most, counts: Mutex::default() })
    }

    /// Counts a new connection. `None` if too many connections of its address have no request.
    pub(super) fn open(self: &Arc<Self>, address: IpAddr) -> Option<Arc<ClientConnection>> {
        let address = client(address);
        let waiting = Mutex::new(Some(self.enter(address)?));
        let (all, surplus) = (Arc::clone(self), CancellationToken::new());
        Some(Arc::new(ClientConnection { all, address, waiting, surplus }))
    }

    fn enter(self: &Arc<Self>, address: IpAddr) -> Option<Waiting> {
        let mut counts = self.counts.lock();
        let count = counts.entry(address).or_default();
        if *count >= self.most {
            return None;
        }
        *count += 1;
        Some(Waiting { all: Arc::clone(self), address })
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        let mut counts = self.all.counts.lock();
        if let Some(count) = counts.get_mut(&self.address) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.address);
            }
        }
    }
}

impl ClientConnection {
    /// Reports that the head of a request has arrived.
    pub(super) fn begin_request(&self) {
        drop(self.waiting.lock().take());
    }

    /// Reports the end of a request when the body of its response is dropped.
    pub(super) fn until_sent(self: &Arc<Self>, response: Response) -> Response {
        let end = RequestEnd(Arc::clone(self));
        response.map(|body| {
            Body::new(body.map_err(move |error| {
                let _ = &end;
                error
            }))
        })
    }

    /// Waits until the connection must be closed, because it would wait for another request while
    /// too many others do.
    pub(super) async fn is_surplus(&self) {
        self.surplus.cancelled().await;
    }

    fn end_request(&self) {
        let waiting = self.all.enter(self.address);
        if waiting.is_none() {
            self.surplus.cancel();
        }
        *self.waiting.lock() = waiting;
    }
}

/// Reports the end of a request when it is dropped.
struct RequestEnd(Arc<ClientConnection>);

impl Drop for RequestEnd {
    fn drop(&mut self) {
        self.0.end_request();
    }
}

/// The client of an address. A client of IPv6 usually has a network of 64 bits.
fn client(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => IpAddr::V6(Ipv6Addr::from_bits(address.to_bits() & !u128::from(u64::MAX))),
        address @ IpAddr::V4(_) => address,
    }
}
