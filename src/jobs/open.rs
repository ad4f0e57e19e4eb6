//! Opens the job store that a URL names.

use super::postgres::{self, PostgresStore};
use super::sqlite::SqliteStore;
use super::store::{Store, StoreError, StoreOptions};
use std::path::PathBuf;
use std::sync::Arc;

/// A database of jobs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Database {
    /// A file, opened by one process at a time.
    Sqlite(PathBuf),
    /// The URL of a server that any number of processes share.
    Postgres(String),
}

impl Database {
    /// Reads `sqlite:PATH`, a plain path, or `postgres://…`.
    ///
    /// # Errors
    /// What is wrong, without the URL (it may contain a password).
    pub fn parse(url: &str) -> Result<Self, String> {
        let path = match url.split_once(':') {
            Some(("sqlite", rest)) => rest.strip_prefix("//").unwrap_or(rest),
            Some(("postgres" | "postgresql", rest)) if rest.starts_with("//") => {
                return Ok(Self::Postgres(url.to_owned()));
            }
            // One letter is a drive, not a scheme.
            Some((scheme, _)) if scheme.len() > 1 && scheme.bytes().all(|b| b.is_ascii_alphanumeric()) => {
                return Err(format!("unsupported scheme `{scheme}:`: use sqlite:PATH or postgres://…"));
            }
            _ => url,
        };
        if path.is_empty() { Err("the path is empty".to_owned()) } else { Ok(Self::Sqlite(path.into())) }
    }

    /// Whether several processes may use it at the same time.
    #[must_use]
    pub fn is_shared(&self) -> bool {
        matches!(self, Self::Postgres(_))
    }

    /// Opens the store and brings its tables up to date. Attempts that an earlier process left running in a file end at once,
    /// because no other process has it open; on a server their leases must expire.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn open(&self, options: StoreOptions) -> Result<Arc<dyn Store>, StoreError> {
        match self {
            Self::Sqlite(path) => {
                let store = SqliteStore::open(path, options).await?;
                let left = store.recover().await?;
                if !left.is_empty() {
                    tracing::warn!(jobs = left.len(), "attempts that an earlier process left running were ended");
                }
                Ok(Arc::new(store))
            }
            Self::Postgres(url) => Ok(Arc::new(PostgresStore::open(url, options).await?)),
        }
    }

    /// Opens it to manage keys, also while a service has it open.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn open_for_keys(&self) -> Result<Arc<dyn Store>, StoreError> {
        match self {
            Self::Sqlite(path) => Ok(Arc::new(SqliteStore::open_for_keys(path).await?)),
            Self::Postgres(url) => Ok(Arc::new(PostgresStore::open(url, StoreOptions::default()).await?)),
        }
    }

    /// Only brings the tables up to date.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn migrate(&self) -> Result<(), StoreError> {
        match self {
            Self::Sqlite(path) => {
                SqliteStore::open(path, StoreOptions::default()).await?.close().await;
                Ok(())
            }
            Self::Postgres(url) => postgres::migrate(url).await,
        }
    }
}

/// Opens the store at `url`: [`Database::parse`], [`Database::open`].
///
/// # Errors
/// [`StoreError::Database`].
pub async fn open(url: &str, options: StoreOptions) -> Result<Arc<dyn Store>, StoreError> {
    Database::parse(url).map_err(StoreError::Database)?.open(options).await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn urls_name_a_database() {
        let file = |path: &str| Ok(Database::Sqlite(path.into()));
        assert_eq!(Database::parse("a/b.db"), file("a/b.db"));
        assert_eq!(Database::parse("sqlite:a/b.db"), file("a/b.db"));
        assert_eq!(Database::parse("sqlite:///a/b.db"), file("/a/b.db"));
        assert_eq!(Database::parse("C:\\b.db"), file("C:\\b.db"));
        for url in ["postgres://u:p@h/d", "postgresql://h/d?sslmode=require"] {
            let database = Database::parse(url).unwrap();
            assert!(database.is_shared() && database == Database::Postgres(url.into()));
        }
        for wrong in ["mysql://u:secret@h/d", "sqlite:", "", "s3://bucket", "postgres:d"] {
            let fault = Database::parse(wrong).unwrap_err();
            assert!(!fault.contains("secret"), "{fault}");
        }
    }
}
