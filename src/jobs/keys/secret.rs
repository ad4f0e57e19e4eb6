//! Secrets of keys and tickets. They are random, so their hashes need neither salt nor stretching.

use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

/// How a key begins, so that it is recognised by scanners for leaked secrets.
const KEY: &str = "oviduct_";
/// How a ticket begins.
const TICKET: &str = "ovt_";
/// Characters of the prefix of a key.
const PREFIX: usize = 8;
/// Random bytes of a secret.
const BYTES: usize = 32;

/// The secret of a key: `oviduct_`, a prefix that names it, `_` and 256 random bits in hex. Neither shown by `Debug` nor
/// serialisable, so that it does not get into a log.
#[derive(Clone)]
pub struct Secret {
    text: String,
}

/// A text that is no secret of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a key is `oviduct_`, 8 and 64 hexadecimal digits, separated by `_`")]
pub struct NoSecret;

impl std::fmt::Debug for Secret {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Secret({KEY}{}_…)", self.prefix())
    }
}

/// Random bytes of the operating system as hex.
fn random(bytes: usize) -> String {
    // Version 4 UUIDs have 122 random bits from the operating system; hashing three of them leaves none out.
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
    /// A new one.
    #[must_use]
    pub fn generate() -> Self {
        Self { text: format!("{KEY}{}_{}", random(PREFIX / 2), random(BYTES)) }
    }

    /// Reads what a client sent.
    ///
    /// # Errors
    /// [`NoSecret`] if it has not the form of a secret.
    pub fn parse(text: &str) -> Result<Self, NoSecret> {
        let rest = text.strip_prefix(KEY).ok_or(NoSecret)?;
        let (prefix, random) = rest.split_once('_').ok_or(NoSecret)?;
        let valid = is_hex(prefix, PREFIX) && is_hex(random, 2 * BYTES);
        if valid { Ok(Self { text: text.to_owned() }) } else { Err(NoSecret) }
    }

    /// The secret itself: to be shown once, to whom it is made for.
    #[must_use]
    pub fn reveal(&self) -> &str {
        &self.text
    }

    /// The part that names the key.
    #[must_use]
    pub fn prefix(&self) -> &str {
        &self.text[KEY.len()..KEY.len() + PREFIX]
    }

    /// SHA-256, lower-case hex: what is stored.
    #[must_use]
    pub fn hash(&self) -> String {
        hash(&self.text)
    }

    /// Whether it has this hash, in a time that does not depend on where they differ.
    #[must_use]
    pub fn matches(&self, hash: &str) -> bool {
        self.hash().as_bytes().ct_eq(hash.as_bytes()).into()
    }
}

/// Whether a text is that many lower-case hexadecimal digits.
fn is_hex(text: &str, length: usize) -> bool {
    text.len() == length && text.bytes().all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(&b))
}

/// The secret of a ticket. Looked up by its hash, so no comparison takes a time that depends on it.
#[derive(Clone)]
pub struct TicketSecret {
    text: String,
}

impl TicketSecret {
    /// A new one.
    #[must_use]
    pub fn generate() -> Self {
        Self { text: format!("{TICKET}{}", random(BYTES)) }
    }

    /// Reads one.
    ///
    /// # Errors
    /// If the text does not have the form of a ticket.
    pub fn parse(text: &str) -> Result<Self, NoSecret> {
        let valid = text.strip_prefix(TICKET).is_some_and(|random| is_hex(random, 2 * BYTES));
        if valid { Ok(Self { text: text.to_owned() }) } else { Err(NoSecret) }
    }

    /// The secret itself: to be sent once.
    #[must_use]
    pub fn reveal(&self) -> &str {
        &self.text
    }

    /// SHA-256, lower-case hex: what is stored.
    #[must_use]
    pub fn hash(&self) -> String {
        hash(&self.text)
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
