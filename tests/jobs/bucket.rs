//! An S3 server in the test process that can be made unavailable and available again.

use hyper_util::rt::{TokioExecutor, TokioIo};
use hyper_util::server::conn::auto::Builder;
use oviduct::jobs::artifacts::Artifacts;
use s3s::auth::SimpleAuth;
use s3s::service::S3ServiceBuilder;
use s3s_fs::FileSystem;
use std::net::SocketAddr;
use tokio::net::TcpListener;
use tokio::sync::watch;

const KEY: &str = "test-key";
const SECRET: &str = "test-secret";

/// An S3 server with one bucket in a temporary folder.
pub struct Bucket {
    address: SocketAddr,
    up: watch::Sender<bool>,
    server: tokio::task::JoinHandle<()>,
    _root: tempfile::TempDir,
}

impl Bucket {
    pub async fn start() -> Self {
        let root = tempfile::tempdir().unwrap();
        std::fs::create_dir(root.path().join("models")).unwrap();
        let mut service = S3ServiceBuilder::new(FileSystem::new(root.path()).unwrap());
        service.set_auth(SimpleAuth::from_single(KEY, SECRET));
        let service = service.build();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (up, is_up) = watch::channel(true);
        let server = tokio::spawn(async move {
            loop {
                let Ok((socket, _)) = listener.accept().await else { continue };
                let (service, mut is_up) = (service.clone(), is_up.clone());
                if !*is_up.borrow() {
                    continue;
                }
                tokio::spawn(async move {
                    let builder = Builder::new(TokioExecutor::new());
                    tokio::select! {
                        _ = builder.serve_connection(TokioIo::new(socket), service) => {}
                        _ = is_up.wait_for(|up| !up) => {}
                    }
                });
            }
        });
        Self { address, up, server, _root: root }
    }

    /// With `false`, closes all connections and accepts no new ones; with `true`, serves again.
    pub fn set_up(&self, up: bool) {
        self.up.send_replace(up);
    }

    /// URL of the bucket, for `--artifacts`.
    pub const URL: &str = "s3://models/of/tests";

    /// Endpoint and credentials as the standard AWS environment variables.
    pub fn variables(&self) -> [(String, String); 3] {
        [
            ("AWS_ACCESS_KEY_ID", KEY.to_owned()),
            ("AWS_SECRET_ACCESS_KEY", SECRET.to_owned()),
            ("AWS_ENDPOINT_URL", format!("http://{}", self.address)),
        ]
        .map(|(name, value)| (name.to_owned(), value))
    }

    pub fn artifacts(&self) -> Artifacts {
        Artifacts::s3(Self::URL, self.variables()).unwrap()
    }
}

impl Drop for Bucket {
    fn drop(&mut self) {
        self.server.abort();
    }
}
