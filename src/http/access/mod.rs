//! Access control: API keys, tickets, rate limits, quotas, and the checks of a service without
//! keys.
//!
//! Each group of routes has a [`Rule`], which gets the [`Caller`] from [`Access`]. Handlers take
//! the caller as an argument and filter every resource by it.

mod audit;
mod bucket;
mod caller;
mod keyring;
mod origin;
mod rule;
pub(in crate::http) mod tickets;

pub(super) use audit::{audit, audited, run_to_completion};
pub(super) use caller::Caller;
pub(super) use rule::Rule;

use crate::http::wire::cors::Origin;
use crate::http::wire::problem::{Kind, Problem};
use crate::jobs::Store;
use crate::jobs::keys::{Key, KeyLimits, Secret, TicketSecret};
use axum::extract::Query;
use axum::http::{HeaderMap, HeaderValue, Method, Uri, header};
use bucket::{Buckets, Standing};
use keyring::{Keyring, Keys};
use std::sync::Arc;
use std::time::Duration;

/// Behaviour of a service that has no key. As soon as a key exists, every route except probes and
/// pages requires one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WithoutKeys {
    /// Serves anyone.
    #[default]
    Anyone,
    /// Serves anyone on this machine. Requests must be addressed to a loopback name, so a page
    /// cannot reach the service through a name of its own that resolves to a loopback address.
    Loopback,
    /// Serves nobody.
    Nobody,
}

/// Options of access control.
#[derive(Clone, Debug)]
pub struct AccessOptions {
    /// Behaviour while no key exists.
    pub without_keys: WithoutKeys,
    /// Limits of keys without limits of their own.
    pub limits: KeyLimits,
    /// Refresh interval of the cached keys. A new or revoked key takes effect within this time.
    pub refresh: Duration,
}

impl Default for AccessOptions {
    fn default() -> Self {
        Self { without_keys: WithoutKeys::default(), limits: KeyLimits::default(), refresh: Duration::from_secs(1) }
    }
}

/// Query parameter of a ticket, and name of its security scheme.
pub(super) const TICKET: &str = "ticket";
/// Name of the security scheme of API keys.
pub(super) const BEARER: &str = "bearer";

/// Identifies callers and counts their requests.
pub(super) struct Access {
    store: Store,
    options: AccessOptions,
    /// Origins whose pages may call the service.
    origins: Vec<Origin>,
    keyring: Keyring,
    buckets: Buckets,
}

impl Access {
    pub(super) fn new(store: Store, options: AccessOptions, origins: Vec<Origin>) -> Self {
        let keyring = Keyring::new(store.clone(), options.refresh);
        Self { store, options, origins, keyring, buckets: Buckets::default() }
    }

    /// Returns the sender of a request, and the ticket if the request has one instead of a key.
    async fn caller(
        &self,
        method: &Method,
        uri: &Uri,
        headers: &HeaderMap,
    ) -> Result<(Caller, Option<TicketSecret>), Problem> {
        let keys = self.keyring.current().await?;
        if keys.is_empty() {
            match self.options.without_keys {
                WithoutKeys::Nobody => {
                    return Err(unauthorized("The service has no keys yet. `oviduct keys add` makes one."));
                }
                WithoutKeys::Loopback => origin::check_loopback(uri, headers)?,
                WithoutKeys::Anyone => {}
            }
            origin::check_same(method, uri, headers, &self.origins)?;
            return Ok((Caller::Anyone, None));
        }
        let mut credentials = headers.get_all(header::AUTHORIZATION).iter();
        let (key, ticket) = match (credentials.next(), credentials.next(), ticket(uri)) {
            (Some(credential), None, _) => (by_secret(&keys, credential)?, None),
            (Some(_), Some(_), _) => {
                return Err(unauthorized("The request has more than one Authorization header."));
            }
            (None, _, Some(text)) => {
                let ticket = TicketSecret::parse(&text).map_err(|_| bad_ticket())?;
                (self.by_ticket(&keys, &ticket, method, uri).await?, Some(ticket))
            }
            (None, _, None) => return Err(unauthorized("Send a key as `Authorization: Bearer …`.")),
        };
        Ok((Caller::Key(key).with_limits(self.options.limits), ticket))
    }

    /// True if the key of the caller is still valid, or for [`Caller::Anyone`], if there are still
    /// no keys.
    pub(super) async fn still_works(&self, caller: &Caller) -> bool {
        // While the job store is unavailable, running requests continue.
        self.keyring.current().await.map_or(true, |keys| match caller {
            Caller::Anyone => keys.is_empty(),
            Caller::Key(key) => keys.working(&key.prefix).is_some(),
        })
    }

    /// Counts a request of this caller; `None` if the caller has no rate limit.
    fn count(&self, caller: &Caller) -> Option<Result<Standing, Standing>> {
        let Caller::Key(key) = caller else { return None };
        Some(self.buckets.take(&key.prefix, key.limits.rate?))
    }

    async fn by_ticket(
        &self,
        keys: &Keys,
        ticket: &TicketSecret,
        method: &Method,
        uri: &Uri,
    ) -> Result<Arc<Key>, Problem> {
        if method != Method::GET && method != Method::HEAD {
            return Err(unauthorized("A ticket is for GET only. Send a key as `Authorization: Bearer …`."));
        }
        let prefix = self.store.ticket(&ticket.hash(), uri.path()).await?;
        prefix.and_then(|prefix| keys.working(&prefix)).ok_or_else(bad_ticket)
    }

    /// Uses up the ticket of a request that is about to be served. Of several requests with the
    /// same ticket, one is served.
    async fn use_ticket(&self, ticket: &TicketSecret, uri: &Uri) -> Result<(), Problem> {
        self.store.use_ticket(&ticket.hash(), uri.path()).await?.map(drop).ok_or_else(bad_ticket)
    }
}

fn bad_ticket() -> Problem {
    unauthorized("The ticket is for another path, was used before, or is older than a minute. Get another.")
}

/// The key in a header `Authorization`.
fn by_secret(keys: &Keys, credential: &HeaderValue) -> Result<Arc<Key>, Problem> {
    let text = credential.to_str().unwrap_or_default();
    let (scheme, token) = text.split_once(' ').unwrap_or((text, ""));
    if !scheme.eq_ignore_ascii_case("bearer") {
        return Err(unauthorized("Send a key as `Authorization: Bearer …`."));
    }
    let invalid = || {
        unauthorized("The key does not exist, has expired, or was revoked.")
            .with_header(header::WWW_AUTHENTICATE, INVALID)
    };
    let secret = Secret::parse(token.trim()).map_err(|_| invalid())?;
    keys.working_with(&secret).ok_or_else(invalid)
}

const CHALLENGE: &str = "Bearer realm=\"oviduct\"";
const INVALID: &str = "Bearer realm=\"oviduct\", error=\"invalid_token\"";

pub(super) fn unauthorized(detail: &str) -> Problem {
    Problem::new(Kind::Unauthorized, detail).with_header(header::WWW_AUTHENTICATE, CHALLENGE)
}

/// The ticket in a query string.
fn ticket(uri: &Uri) -> Option<String> {
    let Query(pairs) = Query::<Vec<(String, String)>>::try_from_uri(uri).ok()?;
    pairs.into_iter().find(|(name, _)| name == TICKET).map(|(_, value)| value)
}
