//! Opens the job store that a URL names.

use super::error::StoreError;
use super::options::StoreOptions;
use super::postgres::{self, Postgres};
use super::sql::{Engine, LastRead, Store, Time};
use super::sqlite::Sqlite;
use crate::clock::Clock;
use std::path::{Path, PathBuf};

/// A database of jobs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Database {
    /// Path of a file, which one process at a time opens.
    Sqlite(PathBuf),
    /// URL of a server, which any number of processes share.
    Postgres(String),
}

impl Database {
    /// Parses `sqlite:PATH`, a plain path, or `postgres://…`.
    ///
    /// # Errors
    /// A message for users, without the URL, which may contain a password.
    pub fn parse(url: &str) -> Result<Self, String> {
        let path = match url.split_once(':') {
            Some(("sqlite", rest)) => rest.strip_prefix("//").unwrap_or(rest),
            Some(("postgres" | "postgresql", rest)) if rest.starts_with("//") => {
                return Ok(Self::Postgres(url.to_owned()));
            }
            // A single letter is a drive, not a scheme.
            Some((scheme, _)) if scheme.len() > 1 && scheme.bytes().all(|b| b.is_ascii_alphanumeric()) => {
                return Err(format!("unsupported scheme `{scheme}:`: use sqlite:PATH or postgres://…"));
            }
            _ => url,
        };
        if path.is_empty() { Err("the path is empty".to_owned()) } else { Ok(Self::Sqlite(path.into())) }
    }

    /// True if several processes may use the database at the same time.
    #[must_use]
    pub fn is_shared(&self) -> bool {
        matches!(self, Self::Postgres(_))
    }

    /// Opens the job store and migrates its tables.
    ///
    /// Attempts that an earlier process left running in a file end immediately, because no other
    /// process has the file open. On a server, their leases must expire.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn open(&self, options: StoreOptions) -> Result<Store, StoreError> {
        match self {
            Self::Sqlite(path) => {
                let store = Store::open_sqlite(path, options).await?;
                let left = store.recover().await?;
                if !left.is_empty() {
                    tracing::warn!(jobs = left.len(), "ended attempts that an earlier process had left running");
                }
                Ok(store)
            }
            Self::Postgres(url) => Store::open_postgres(url, options).await,
        }
    }

    /// Opens the job store to manage its API keys, or only to read it, even while a service has it
    /// open. No other call may be made.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn open_beside_service(&self) -> Result<Store, StoreError> {
        let options = StoreOptions::default();
        match self {
            Self::Sqlite(path) => match Sqlite::open_shared(path).await? {
                Some(engine) => Ok(Store::over_sqlite(engine, options)),
                None => Store::open_sqlite(path, options).await,
            },
            Self::Postgres(url) => Store::open_postgres(url, options).await,
        }
    }

    /// Migrates the tables and does nothing else.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn migrate(&self) -> Result<(), StoreError> {
        match self {
            Self::Sqlite(path) => {
                Store::open_sqlite(path, StoreOptions::default()).await?.close().await;
                Ok(())
            }
            Self::Postgres(url) => postgres::migrate(url).await,
        }
    }
}

/// Opens the job store at `url`: [`Database::parse`], [`Database::open`].
///
/// # Errors
/// [`StoreError::Database`].
pub async fn open(url: &str, options: StoreOptions) -> Result<Store, StoreError> {
    Database::parse(url).map_err(|fault| StoreError::Database(fault.into()))?.open(options).await
}

impl Store {
    /// Opens the job store in the file at `path`, creates the file if it does not exist, and
    /// migrates its tables. Attempts that an earlier process left running keep their leases; see
    /// [`Store::recover`].
    ///
    /// # Errors
    /// [`StoreError::Database`] if the file cannot be opened, is damaged, or is open in another
    /// process.
    pub async fn open_sqlite(path: impl AsRef<Path>, options: StoreOptions) -> Result<Self, StoreError> {
        Ok(Self::over_sqlite(Sqlite::open(path.as_ref(), &options).await?, options))
    }

    /// Opens an empty job store in memory, for tests. Its data are lost with it.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn open_in_memory(options: StoreOptions) -> Result<Self, StoreError> {
        Ok(Self::over_sqlite(Sqlite::open_in_memory().await?, options))
    }

    /// Connects to the PostgreSQL database at `url`
    /// (`postgres://user:password@host/name?sslmode=…`) and migrates its tables; several processes
    /// may do so at the same time.
    ///
    /// # Errors
    /// [`StoreError::Database`] if the URL is invalid or the database is unavailable.
    pub async fn open_postgres(url: &str, options: StoreOptions) -> Result<Self, StoreError> {
        let changes = Self::channel();
        let engine = Postgres::open(url, &options, changes.clone()).await?;
        let time = match &options.clock {
            Clock::System => Time::Database(LastRead::default()),
            Clock::Manual(_) => Time::from_clock(options.clock.clone()),
        };
        Ok(Self::new(Engine::Postgres(engine), time, options, changes))
    }

    fn over_sqlite(engine: Sqlite, options: StoreOptions) -> Self {
        let time = Time::from_clock(options.clock.clone());
        Self::new(Engine::Sqlite(engine), time, options, Self::channel())
    }
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
