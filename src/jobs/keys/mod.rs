//! API keys and tickets: what a client may do, and how much. The secret of a key is shown once and
//! stored as a hash.

mod secret;

pub use secret::{NoSecret, Secret, TicketSecret};

use super::job::Quota;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::str::FromStr;
use std::time::Duration;

/// A right that a key grants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Scope {
    /// Read the owner's models, and everything that is not a model.
    Read,
    /// Request, cancel, repeat and delete the owner's models.
    Submit,
    /// Everything, including the models of other owners.
    Admin,
}

impl Scope {
    /// All scopes.
    pub const ALL: [Self; 3] = [Self::Read, Self::Submit, Self::Admin];

    /// Name in requests and responses.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Submit => "submit",
            Self::Admin => "admin",
        }
    }
}

impl std::fmt::Display for Scope {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// Error of a name that is not a scope.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a scope is read, submit or admin, not `{0}`")]
pub struct NoScope(String);

impl FromStr for Scope {
    type Err = NoScope;

    fn from_str(name: &str) -> Result<Self, NoScope> {
        Self::ALL.into_iter().find(|scope| scope.name() == name).ok_or_else(|| NoScope(name.to_owned()))
    }
}

/// A set of scopes. `admin` contains the others.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Scopes(BTreeSet<Scope>);

impl Scopes {
    /// True if the set grants `scope`.
    #[must_use]
    pub fn allow(&self, scope: Scope) -> bool {
        self.0.contains(&scope) || self.0.contains(&Scope::Admin)
    }
}

impl FromIterator<Scope> for Scopes {
    fn from_iter<I: IntoIterator<Item = Scope>>(scopes: I) -> Self {
        Self(scopes.into_iter().collect())
    }
}

impl std::fmt::Display for Scopes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let names: Vec<&str> = self.0.iter().map(|scope| scope.name()).collect();
        f.write_str(&names.join(","))
    }
}

/// Owner of keys and models: 1 to 64 letters, digits, `.`, `_`, `-` and `@`. Several keys may have
/// the same owner.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(transparent)]
pub struct Owner(String);

impl Owner {
    /// The name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.0
    }
}

impl std::fmt::Display for Owner {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

/// Error of a text that is not an owner.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("an owner is 1 to 64 letters, digits, `.`, `_`, `-` and `@`")]
pub struct NoOwner;

impl FromStr for Owner {
    type Err = NoOwner;

    fn from_str(name: &str) -> Result<Self, NoOwner> {
        let plain = |c: char| c.is_ascii_alphanumeric() || "._-@".contains(c);
        let valid = (1..=64).contains(&name.len()) && name.chars().all(plain);
        if valid { Ok(Self(name.to_owned())) } else { Err(NoOwner) }
    }
}

/// Limits of a key. `None` means the limit of the service.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct KeyLimits {
    /// Requests per second, on average.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate: Option<f64>,
    /// Quota of the owner.
    #[serde(flatten)]
    pub quota: Quota,
}

/// An API key without its secret.
#[derive(Clone, Debug, PartialEq)]
pub struct Key {
    /// Public part of the secret, which names the key.
    pub prefix: String,
    /// SHA-256 of the secret, lower-case hex.
    pub hash: String,
    /// Owner.
    pub owner: Owner,
    /// Scopes.
    pub scopes: Scopes,
    /// Limits.
    pub limits: KeyLimits,
    /// Time of creation.
    pub created_at: Timestamp,
    /// Time at which it expires; `None` for never.
    pub expires_at: Option<Timestamp>,
    /// Time from which it is revoked.
    pub revoked_at: Option<Timestamp>,
}

impl Key {
    /// True if the key is valid at this time.
    #[must_use]
    pub fn works_at(&self, now: Timestamp) -> bool {
        self.revoked_at.is_none_or(|at| now < at) && self.expires_at.is_none_or(|at| now < at)
    }

    /// Logs the creation of the key for audits.
    pub(crate) fn audit_added(&self) {
        let Self { prefix, owner, scopes, .. } = self;
        tracing::info!(target: "oviduct::audit", action = "key added", key = prefix, %owner, %scopes);
    }

    /// Logs the revocation of the key for audits.
    pub(crate) fn audit_revoked(&self) {
        tracing::info!(target: "oviduct::audit", action = "key revoked", key = self.prefix, owner = %self.owner);
    }
}

/// A key to be stored.
#[derive(Clone, Debug)]
pub struct NewKey {
    /// Public part of the secret, which names the key.
    pub prefix: String,
    /// SHA-256 of the secret.
    pub hash: String,
    /// Owner.
    pub owner: Owner,
    /// Scopes.
    pub scopes: Scopes,
    /// Limits.
    pub limits: KeyLimits,
    /// Time at which it expires; `None` for never.
    pub expires_at: Option<Timestamp>,
}

/// A ticket to be stored.
#[derive(Clone, Debug)]
pub struct NewTicket {
    /// SHA-256 of the secret.
    pub hash: String,
    /// Prefix of the key whose rights the ticket has.
    pub key: String,
    /// Path that the ticket is valid for.
    pub path: String,
    /// Time for which the ticket is valid.
    pub life: Duration,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn admin_allows_everything_and_the_others_only_themselves() {
        let of = |scopes: &[Scope]| scopes.iter().copied().collect::<Scopes>();
        let allowed = |scopes: &Scopes| Scope::ALL.map(|scope| scopes.allow(scope));
        assert_eq!(allowed(&of(&[Scope::Admin])), [true; 3]);
        assert_eq!(allowed(&of(&[Scope::Read])), [true, false, false]);
        assert_eq!(allowed(&of(&[Scope::Submit])), [false, true, false]);
        assert_eq!(allowed(&of(&[])), [false; 3]);
        assert_eq!(of(&[Scope::Submit, Scope::Read]).to_string(), "read,submit");
        assert!("root".parse::<Scope>().is_err() && "read".parse() == Ok(Scope::Read));
    }

    #[test]
    fn owners_are_plain_names() {
        for name in ["a", "lab-3", "r.smith@uni.example", &"x".repeat(64)] {
            assert!(name.parse::<Owner>().is_ok(), "{name}");
        }
        for name in ["", "two words", "a\u{1f}b", "ä", "a/b", &"x".repeat(65)] {
            assert_eq!(name.parse::<Owner>(), Err(NoOwner), "{name}");
        }
    }

    #[test]
    fn a_key_stops_working_when_it_expires_or_is_revoked() {
        let at = |seconds| Timestamp::from_second(seconds).expect("in range");
        let key = Key {
            prefix: "p".into(),
            hash: "h".into(),
            owner: "lab".parse().expect("valid"),
            scopes: Scopes::default(),
            limits: KeyLimits::default(),
            created_at: at(0),
            expires_at: Some(at(10)),
            revoked_at: None,
        };
        assert!(key.works_at(at(9)) && !key.works_at(at(10)));
        assert!(!Key { revoked_at: Some(at(5)), ..key.clone() }.works_at(at(5)));
        assert!(Key { expires_at: None, ..key }.works_at(at(1_000_000)));
    }
}
