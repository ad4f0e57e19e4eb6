//! Secrets of API keys and tickets. They are random, so their hashes need neither salt nor
//! stretching.

use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

/// First characters of a key, by which scanners for leaked secrets recognise it.
const KEY: &str = "oviduct_";
/// First characters of a ticket.
const TICKET: &str = "ovt_";
/// Length of the prefix of a key, characters.
const PREFIX: usize = 8;
/// Random part of a secret, bytes.
const BYTES: usize = 32;

/// Secret of a key: `oviduct_`, a prefix that names the key, `_` and 256 random bits in hex.
/// `Debug` hides the secret, and it cannot be serialised, so that it does not get into a log.
#[derive(Clone)]
pub struct Secret(String);

/// Error of a text that is not the secret of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a key is `oviduct_`, 8 and 64 hexadecimal digits, separated by `_`")]
pub struct NoSecret;

impl std::fmt::Debug for Secret {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Secret({KEY}{}_…)", self.prefix())
    }
}

/// Random bytes from the operating system, as hex.
fn random(bytes: usize) -> String {
    // Version 4 UUIDs have 122 random bits from the operating system; hashing three of them leaves
    // none out.
    let mut digest = Sha256::new();
    for _ in 0..3 {
        digest.update(uuid::Uuid::new_v4().as_bytes());
    }
    let mut text = hex::encode(digest.finalize());
    text.truncate(2 * bytes);
    text
}

fn hash(text: &str) -> String {
    hex::encode(Sha256::digest(text))
}

impl Secret {
    /// A new secret.
    #[must_use]
    pub fn generate() -> Self {
        Self(format!("{KEY}{}_{}", random(PREFIX / 2), random(BYTES)))
    }

    /// Parses a secret that a client sent.
    ///
    /// # Errors
    /// [`NoSecret`] if the text does not have the form of a secret.
    pub fn parse(text: &str) -> Result<Self, NoSecret> {
        let rest = text.strip_prefix(KEY).ok_or(NoSecret)?;
        let (prefix, random) = rest.split_once('_').ok_or(NoSecret)?;
        let valid = is_hex(prefix, PREFIX) && is_hex(random, 2 * BYTES);
        if valid { Ok(Self(text.to_owned())) } else { Err(NoSecret) }
    }

    /// The secret itself, to be shown once to its owner.
    #[must_use]
    pub fn reveal(&self) -> &str {
        &self.0
    }

    /// The prefix, which names the key.
    #[must_use]
    pub fn prefix(&self) -> &str {
        &self.0[KEY.len()..KEY.len() + PREFIX]
    }

    /// SHA-256 in lower-case hex, which the store keeps.
    #[must_use]
    pub fn hash(&self) -> String {
        hash(&self.0)
    }

    /// True if the secret has this hash. The duration does not depend on where the two differ.
    #[must_use]
    pub fn matches(&self, hash: &str) -> bool {
        self.hash().as_bytes().ct_eq(hash.as_bytes()).into()
    }
}

/// True for a text of `length` lower-case hexadecimal digits.
fn is_hex(text: &str, length: usize) -> bool {
    text.len() == length && text.bytes().all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(&b))
}

/// Secret of a ticket. The store looks it up by its hash, so the duration of no comparison depends
/// on the secret.
#[derive(Clone)]
pub struct TicketSecret(String);

impl TicketSecret {
    /// A new secret.
    #[must_use]
    pub fn generate() -> Self {
        Self(format!("{TICKET}{}", random(BYTES)))
    }

    /// Parses a ticket that a client sent.
    ///
    /// # Errors
    /// [`NoSecret`] if the text does not have the form of a ticket.
    pub fn parse(text: &str) -> Result<Self, NoSecret> {
        let valid = text.strip_prefix(TICKET).is_some_and(|random| is_hex(random, 2 * BYTES));
        if valid { Ok(Self(text.to_owned())) } else { Err(NoSecret) }
    }

    /// The secret itself, to be sent once.
    #[must_use]
    pub fn reveal(&self) -> &str {
        &self.0
    }

    /// SHA-256 in lower-case hex, which the store keeps.
    #[must_use]
    pub fn hash(&self) -> String {
        hash(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_secret_is_found_by_its_prefix_and_matches_only_its_own_hash() {
        let (one, other) = (Secret::generate(), Secret::generate());
        let read = Secret::parse(one.reveal()).expect("its own form");
        assert_eq!((read.prefix(), read.hash()), (one.prefix(), one.hash()));
        assert!(read.matches(&one.hash()) && !read.matches(&other.hash()) && !read.matches(""));
        assert_ne!(one.prefix(), other.prefix());
        assert_eq!((one.reveal().len(), one.prefix().len()), (8 + 8 + 1 + 64, 8));
    }

    #[test]
    fn a_secret_is_not_shown() {
        let secret = Secret::generate();
        let shown = format!("{secret:?}");
        assert!(shown.contains(secret.prefix()) && !shown.contains(&secret.reveal()[17..]), "{shown}");
    }

    #[test]
    fn other_texts_are_no_secrets() {
        let text = Secret::generate().reveal().to_owned();
        for wrong in [
            "",
            "oviduct_",
            "oviduct__",
            &text[1..],
            &text[..80],
            &text.to_uppercase(),
            &format!("{text}0"),
            "oviduct_0000000ä_",
        ] {
            assert_eq!(Secret::parse(wrong).map(|_| ()), Err(NoSecret), "{wrong}");
        }
    }
}
