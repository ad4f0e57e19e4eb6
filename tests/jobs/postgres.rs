//! The suite over PostgreSQL, and what only several processes over one server can show.

use crate::cluster::Cluster;
use crate::suite::Factory;
use futures_util::FutureExt;
use oviduct::jobs::Store;
use oviduct::jobs::postgres::PostgresStore;
use std::sync::Arc;

const SERVER: Factory = |options| {
    async move {
        let url = tokio::task::spawn_blocking(|| Cluster::shared().database()).await.unwrap();
        let store: Arc<dyn Store> = Arc::new(PostgresStore::open(&url, options).await.unwrap());
        (store, Box::new(()) as Box<dyn Send>)
    }
    .boxed()
};

mod suite {
    crate::suite::over!(super::SERVER);
}
