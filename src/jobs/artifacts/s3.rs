//! An S3 bucket, or a compatible store, as artifact store.
//!
//! An upload becomes visible when it is complete: small files are uploaded in one request, larger
//! ones in parts that the store joins at the end. Every request carries the SHA-256 of its bytes,
//! which the store verifies. A comparison of the object's size with the bytes sent then detects a
//! wrong join. The record of the job contains the SHA-256 of the whole file, which is also its
//! ETag.

use super::error::ArtifactError;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey, Checksum};
use object_store::path::Path as Key;
use object_store::prefix::PrefixStore;
use object_store::signer::{Method, SignedUrlOptions, Signer, Url};
use object_store::{BackoffConfig, ClientOptions, ObjectStore, RetryConfig};
use std::sync::Arc;
use std::time::Duration;

/// Maximum time for which one request is retried. Workers retry the whole upload in addition.
const RETRY: Duration = Duration::from_secs(8);
/// Time without data after which a request fails. The duration of a download is not limited.
const SILENCE: Duration = Duration::from_secs(10);

/// Signer of URLs at which a file can be downloaded without credentials.
#[derive(Clone, Debug)]
pub(super) struct Signing {
    signer: Arc<dyn Signer>,
    prefix: Key,
}

impl Signing {
    /// A URL for the file under `key`, valid for `time`.
    pub(super) async fn url(
        &self,
        key: &str,
        name: &str,
        media_type: &str,
        time: Duration,
    ) -> Result<String, ArtifactError> {
        let location: Key = self.prefix.parts().chain(Key::from(key).parts()).collect();
        let options = SignedUrlOptions::default().with_query([
            ("response-content-disposition", format!("attachment; filename=\"{name}\"")),
            ("response-content-type", media_type.to_owned()),
        ]);
        Ok(self.signer.signed_url_opts(Method::GET, &location, time, &options).await?.into())
    }
}

/// Opens the bucket of `url`; see [`Artifacts::s3`](super::Artifacts::s3).
pub(super) fn open(
    url: &str,
    variables: impl IntoIterator<Item = (String, String)>,
) -> Result<(Arc<dyn ObjectStore>, Signing), ArtifactError> {
    crate::tls::install();
    let wrong = || ArtifactError::Store(format!("{url} is not s3://BUCKET or s3://BUCKET/PREFIX").into());
    let path = url.strip_prefix("s3://").ok_or_else(wrong)?;
    let (bucket, prefix) = path.split_once('/').unwrap_or((path, ""));
    if bucket.is_empty() {
        return Err(wrong());
    }
    let prefix = Key::parse(prefix.trim_end_matches('/')).map_err(|_| wrong())?;
    let client = ClientOptions::new()
        .with_timeout_disabled()
        .with_connect_timeout(Duration::from_secs(3))
        .with_read_timeout(SILENCE);
    let backoff =
        BackoffConfig { init_backoff: Duration::from_millis(100), max_backoff: Duration::from_secs(2), base: 2.0 };
    let mut builder = AmazonS3Builder::new()
        .with_client_options(client)
        .with_retry(RetryConfig { backoff, max_retries: 6, retry_timeout: RETRY })
        .with_checksum_algorithm(Checksum::SHA256)
        .with_region("us-east-1");
    for (name, value) in variables {
        let key = name.starts_with("AWS_").then(|| name.to_ascii_lowercase().parse::<AmazonS3ConfigKey>());
        if let Some(Ok(key)) = key {
            builder = builder.with_config(key, value);
        }
    }
    if builder.get_config_value(&AmazonS3ConfigKey::Endpoint).is_some_and(|endpoint| is_loopback(&endpoint)) {
        builder = builder.with_allow_http(true);
    }
    let store = Arc::new(builder.with_bucket_name(bucket).build()?);
    let signing = Signing { signer: Arc::clone(&store) as Arc<dyn Signer>, prefix: prefix.clone() };
    let store: Arc<dyn ObjectStore> =
        if prefix.as_ref().is_empty() { store } else { Arc::new(PrefixStore::new(store, prefix)) };
    Ok((store, signing))
}

/// True if the URL refers to this machine.
fn is_loopback(endpoint: &str) -> bool {
    let Ok(url) = Url::parse(endpoint) else { return false };
    let host = url.host_str().unwrap_or_default().trim_matches(['[', ']']);
    host == "localhost" || host.parse::<std::net::IpAddr>().is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::super::Artifacts;
    use super::*;

    fn settings(endpoint: &str) -> Vec<(String, String)> {
        [("AWS_ACCESS_KEY_ID", "a"), ("AWS_SECRET_ACCESS_KEY", "b"), ("AWS_ENDPOINT_URL", endpoint), ("HOME", "/")]
            .map(|(name, value)| (name.to_owned(), value.to_owned()))
            .into()
    }

    #[test]
    fn addresses_of_buckets() {
        for good in ["s3://bucket", "s3://bucket/", "s3://bucket/a/b", "s3://bucket/a/"] {
            assert!(Artifacts::s3(good, settings("http://127.0.0.1:9")).is_ok(), "{good}");
        }
        for bad in ["s3://", "s3:///a", "file:x", "bucket"] {
            assert!(Artifacts::s3(bad, settings("http://127.0.0.1:9")).is_err(), "{bad}");
        }
    }

    #[test]
    fn plain_http_is_for_this_machine() {
        for here in ["http://127.0.0.1:9000", "http://localhost", "http://[::1]:9000"] {
            assert!(is_loopback(here), "{here}");
        }
        for elsewhere in ["http://minio:9000", "http://10.0.0.1", "https://s3.amazonaws.com", "nonsense"] {
            assert!(!is_loopback(elsewhere), "{elsewhere}");
        }
    }

    #[tokio::test]
    async fn signed_addresses_name_the_key_under_its_prefix() {
        let artifacts = Artifacts::s3("s3://bucket/some/where", settings("http://127.0.0.1:9")).unwrap();
        let time = Duration::from_secs(300);
        let url =
            artifacts.signed_url("models/a/1/model.glb", "pig-7-model.glb", "model/gltf-binary", time).await.unwrap();
        let url = url.unwrap();
        assert!(url.starts_with("http://127.0.0.1:9/bucket/some/where/models/a/1/model.glb?"), "{url}");
        assert!(url.contains("X-Amz-Signature=") && url.contains("X-Amz-Expires=300"), "{url}");
        assert!(url.contains("response-content-disposition="), "{url}");
        let dir = tempfile::tempdir().unwrap();
        let local = Artifacts::local(dir.path()).unwrap();
        assert_eq!(local.signed_url("k", "n", "t", time).await.unwrap(), None);
    }
}
