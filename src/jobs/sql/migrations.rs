//! Migrations of the tables, compiled into the program.
//!
//! `sqlx::migrate!` would do the same, but it compiles both drivers, and SQLite, a second time as a
//! part of the compiler.

use sqlx::SqlSafeStr as _;
use sqlx::migrate::{Migration, MigrationType, Migrator};

/// The files `migrations/NAME.sql` in the directory of the caller, as pairs of a name and the
/// statements.
macro_rules! migrations {
    ($($name:literal),+ $(,)?) => {
        [$(($name, include_str!(concat!("migrations/", $name, ".sql")))),+]
    };
}
pub(in crate::jobs) use migrations;

/// The migrations of these files, whose names begin with a number and `_`. Tables of a newer
/// version stay unchanged, because they work in this version too.
pub(in crate::jobs) fn migrator(files: &[(&'static str, &'static str)]) -> Migrator {
    let migration = |&(name, sql): &(&'static str, &'static str)| {
        let (number, description) = name.split_once('_').expect("a migration has a number and a description");
        let version = number.parse().expect("the number of a migration is decimal");
        Migration::new(version, description.replace('_', " ").into(), MigrationType::Simple, sql.into_sql_str(), false)
    };
    let mut migrator = Migrator::with_migrations(files.iter().map(migration).collect());
    migrator.set_ignore_missing(true);
    migrator
}
