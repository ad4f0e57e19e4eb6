//! Who sends a request, and what that allows: keys, tickets, quotas, and the checks of a service without keys.
//!
//! Each group of routes has a [`Rule`], which asks [`Access`] for the [`Caller`]. Handlers take the caller as an argument
//! and show it only what it sees.

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

/// What a service without any key does. As soon as one exists, every route but probes and pages asks for one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WithoutKeys {
    /// It serves anyone.
    #[default]
    Anyone,
    /// It serves anyone on this machine: requests must be addressed to a loopback name, so that no page can reach it by a
    /// name of its own that resolves to loopback.
    Loopback,
    /// It serves nobody.
    Nobody,
}

/// How requests are admitted.
#[derive(Clone, Debug)]
pub struct AccessOptions {
    /// What it does without any key.
    pub without_keys: WithoutKeys,
    /// Limits of keys that have none of their own.
    pub limits: KeyLimits,
    /// Time after which the keys are read again: a new or revoked key takes effect within it.
    pub refresh: Duration,
}

impl Default for AccessOptions {
    fn default() -> Self {
        Self { without_keys: WithoutKeys::default(), limits: KeyLimits::default(), refresh: Duration::from_secs(1) }
    }
}

/// Parameter of a ticket, and the name of its security scheme.
pub(super) const TICKET: &str = "ticket";
/// Name of the security scheme of keys.
pub(super) const BEARER: &str = "bearer";

/// Finds out who sends a request.
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

    /// Who sends a request, and the ticket that shows it, if it is one.
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

    /// Whether the key of a caller still works, or there are still no keys if it has none.
    pub(super) async fn still_works(&self, caller: &Caller) -> bool {
        // In an outage nothing is known, and what was allowed goes on.
        self.keyring.current().await.map_or(true, |keys| match caller {
            Caller::Anyone => keys.is_empty(),
            Caller::Key(key) => keys.working(&key.prefix).is_some(),
        })
    }

    /// Counts a request of this caller. `None` if it has no limit.
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

    /// Uses up the ticket of a request that is about to be served. Of several with the same ticket one is served.
    async fn use_ticket(&self, ticket: &TicketSecret, uri: &Uri) -> Result<(), Problem> {
        self.store.use_ticket(&ticket.hash(), uri.path()).await?.map(drop).ok_or_else(bad_ticket)
    }
}

fn bad_ticket() -> Problem {
    unauthorized("The ticket is for another path, was used before, or is older than a minute. Get another.")
}

/// The key that a header has.
fn by_secret(keys: &Keys, credential: &HeaderValue) -> Result<Arc<Key>, Problem> {
    let text = credential.to_str().unwrap_or_default();
    let (scheme, token) = text.split_once(' ').unwrap_or((text, ""));
    if !scheme.eq_ignore_ascii_case("bearer") {
        return Err(unauthorized("Send a key as `Authorization: Bearer …`."));
    }
    let invalid = || {
        let problem = unauthorized("The key does not exist, has expired, or was revoked.");
        problem.with_header(header::WWW_AUTHENTICATE, HeaderValue::from_static(INVALID))
    };
    let secret = Secret::parse(token.trim()).map_err(|_| invalid())?;
    keys.working_with(&secret).ok_or_else(invalid)
}

const CHALLENGE: &str = "Bearer realm=\"oviduct\"";
const INVALID: &str = "Bearer realm=\"oviduct\", error=\"invalid_token\"";

pub(super) fn unauthorized(detail: &str) -> Problem {
    let challenge = HeaderValue::from_static(CHALLENGE);
    Problem::new(Kind::Unauthorized, detail).with_header(header::WWW_AUTHENTICATE, challenge)
}

/// The ticket in a query string.
fn ticket(uri: &Uri) -> Option<String> {
    let Query(pairs) = Query::<Vec<(String, String)>>::try_from_uri(uri).ok()?;
    pairs.into_iter().find(|(name, _)| name == TICKET).map(|(_, value)| value)
}
