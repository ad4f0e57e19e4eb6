//! The cryptography provider of all TLS connections of the process.

/// Installs the provider; further calls have no effect. Must be called before a client is created.
pub fn install() {
    // An error means that the provider is already installed.
    let _ = rustls::crypto::ring::default_provider().install_default();
}
