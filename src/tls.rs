//! The one implementation of cryptography that all TLS connections of the process use.

/// Makes it known; further calls change nothing. To be called before a client is made.
pub fn install() {
    // An error says that one was installed before: it is the same.
    let _ = rustls::crypto::ring::default_provider().install_default();
}
