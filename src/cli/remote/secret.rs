//! An API key given as an option. Logs, errors and debug output never contain it.

use crate::cli::exit::Failure;
use reqwest::header::HeaderValue;
use std::convert::Infallible;
use std::fmt;
use std::str::FromStr;

/// An API key. Any text parses, because an error of the parser would print it.
#[derive(Clone, PartialEq, Eq)]
pub struct Key(String);

impl FromStr for Key {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(Self(text.to_owned()))
    }
}

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key(…)")
    }
}

impl Key {
    /// Returns the value of `Authorization` for this key, marked as sensitive.
    ///
    /// # Errors
    /// [`Failure::Usage`] if the key is empty or cannot be part of a header.
    pub(in crate::cli) fn authorization(&self) -> Result<HeaderValue, Failure> {
        let text = self.0.trim();
        let value = HeaderValue::from_str(&format!("Bearer {text}")).ok().filter(|_| !text.is_empty());
        let mut value = value.ok_or_else(|| Failure::usage("--key: must be visible ASCII characters, at least one"))?;
        value.set_sensitive(true);
        Ok(value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_sent_and_never_shown() {
        let key: Key = "s3cret\n".parse().expect("any text");
        let value = key.authorization().expect("valid");
        assert_eq!(value.to_str().expect("ASCII"), "Bearer s3cret");
        assert!(!format!("{key:?} {value:?}").contains("s3cret"));
        for wrong in ["", " ", "s3cret\0x", "s3cret\r\nx: y"] {
            let key: Key = wrong.parse().expect("any text");
            let (code, lines) = key.authorization().expect_err(wrong).report();
            assert!(code == 2 && lines[0].contains("--key") && !lines[0].contains("s3cret"), "{lines:?}");
        }
    }
}
