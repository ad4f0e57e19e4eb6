//! PostgreSQL for tests: a cluster from Debian's package, in a temporary folder and on a free port
//! of the loopback interface.
//!
//! A shell supervises the cluster. When the process that started the shell ends for any reason, the
//! pipe to the shell closes; the shell then stops the server and removes the folder. If the tests
//! run as root, the shell and the server run as user `postgres`.
#![allow(clippy::unwrap_used, reason = "a test: what fails, fails here")]

use std::hash::{BuildHasher, RandomState};
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// Supervisor script. It creates a cluster in the folder `$1` and prints `made`. Then it reads
/// ports from its input until the server starts on one: it prints `busy` for an occupied port and
/// `ready` once the server runs. When its input ends, the script stops the server and removes the
/// folder.
///
/// `fsync` stays enabled, as in production.
const HOLD: &str = r#"
set -e
trap '' INT TERM HUP
trap 'pg_ctl -D "$1/data" -m immediate stop >/dev/null 2>&1 || true; rm -rf "$1"' EXIT
initdb -D "$1/data" -U postgres -A trust -E UTF8 --locale=C.UTF-8 --no-sync >"$1/log" 2>&1 || { cat "$1/log" >&2; exit 1; }
cat >>"$1/data/postgresql.conf" <<END
listen_addresses = '127.0.0.1'
unix_socket_directories = ''
max_connections = 200
shared_buffers = 64MB
log_min_messages = warning
END
echo made
while read -r port; do
  # The last setting counts; after a crash the server starts there again.
  echo "port = $port" >>"$1/data/postgresql.conf"
  if pg_ctl -D "$1/data" -l "$1/log" -w start >/dev/null 2>&1; then
    echo ready
    read -r _ || true
    exit 0
  fi
  echo busy
done
cat "$1/log" >&2
exit 1
"#;

/// Number of ports to try.
const PORTS: u32 = 5;

/// A free port below the range of ephemeral ports.
pub fn free_port() -> u16 {
    loop {
        let port = 15_000 + (RandomState::new().hash_one(0) % 15_000) as u16;
        if TcpListener::bind(("127.0.0.1", port)).is_ok() {
            return port;
        }
    }
}

/// A running PostgreSQL server.
pub struct Cluster {
    folder: PathBuf,
    port: u16,
    bin: PathBuf,
    databases: AtomicU32,
    _holder: Child,
    _pipe: ChildStdin,
}

/// Folder with the programs of the newest installed PostgreSQL version.
fn programs() -> PathBuf {
    let mut found: Vec<PathBuf> = std::fs::read_dir("/usr/lib/postgresql")
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path().join("bin"))
        .filter(|bin| bin.join("initdb").exists() && bin.join("pg_ctl").exists())
        .collect();
    let version = |bin: &PathBuf| bin.parent()?.file_name()?.to_str()?.parse::<u32>().ok();
    found.sort_by_key(version);
    found.pop().expect(
        "PostgreSQL is missing: these tests start a server of their own from Debian's package; \
         run scripts/need, or apt-get install postgresql",
    )
}

fn is_root() -> bool {
    Command::new("id").arg("-u").output().is_ok_and(|out| out.stdout.trim_ascii() == b"0")
}

/// A PostgreSQL program, run as a user other than root, because PostgreSQL refuses to run as root.
fn program(bin: &Path, name: &str) -> Command {
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap_or_default());
    let mut command = if is_root() {
        let mut command = Command::new("setpriv");
        command.args(["--reuid=postgres", "--regid=postgres", "--init-groups", "--"]).arg(name);
        command
    } else {
        Command::new(name)
    };
    command.env("PATH", path).env("LC_ALL", "C.UTF-8").env("PGCTLTIMEOUT", "300").current_dir("/");
    command
}

impl Cluster {
    /// The cluster that all tests of this process share; the first call starts it.
    pub fn shared() -> &'static Self {
        static SHARED: OnceLock<Cluster> = OnceLock::new();
        SHARED.get_or_init(Self::start)
    }

    /// Starts a separate cluster for one test.
    pub fn start() -> Self {
        let bin = programs();
        // The user of the server creates the folder, so the server has access to it.
        let made = program(&bin, "mktemp").args(["-d", "-p", "/tmp", "oviduct-postgres-XXXXXX"]).output().unwrap();
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        let folder = PathBuf::from(String::from_utf8(made.stdout).unwrap().trim());
        let mut holder = program(&bin, "bash")
            .args(["-c", HOLD, "hold"])
            .arg(&folder)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("bash and setpriv are there");
        let mut pipe = holder.stdin.take().expect("a pipe");
        let mut lines = BufReader::new(holder.stdout.take().expect("a pipe")).lines();
        let mut says = || lines.next().expect("PostgreSQL did not start").unwrap();
        assert_eq!(says(), "made");
        let try_port = |_| {
            let port = free_port();
            writeln!(pipe, "{port}").unwrap();
            (says() == "ready").then_some(port)
        };
        let port = (0..PORTS).find_map(try_port).expect("PostgreSQL found no port");
        Self { folder, port, bin, databases: AtomicU32::new(0), _holder: holder, _pipe: pipe }
    }

    fn url(&self, database: &str) -> String {
        format!("postgres://postgres@127.0.0.1:{}/{database}?sslmode=disable", self.port)
    }

    /// Creates an empty database; returns its URL.
    pub fn database(&self) -> String {
        let name = format!("t{}", self.databases.fetch_add(1, Ordering::Relaxed));
        self.psql("postgres", &format!("CREATE DATABASE {name}"));
        self.url(&name)
    }

    /// Runs statements in a database, given by name or URL; returns their output without headings.
    pub fn psql(&self, database: &str, sql: &str) -> String {
        let url = if database.contains("://") { database.to_owned() } else { self.url(database) };
        let mut child = program(&self.bin, "psql")
            .args(["-X", "-q", "-A", "-t", "-v", "ON_ERROR_STOP=1", "-d", &url])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        child.stdin.take().unwrap().write_all(sql.as_bytes()).unwrap();
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "{sql}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    /// Stops the server immediately, without a shutdown checkpoint, like a crash.
    pub fn crash(&self) {
        assert!(self.control(&["-m", "immediate", "stop"]), "it was not stopped");
    }

    /// Starts the server after [`Self::crash`].
    pub fn restart(&self) {
        let log = self.folder.join("log");
        // An outgoing connection may occupy the port for a moment.
        let start = |_| {
            let started = self.control(&["-l", log.to_str().expect("UTF-8"), "-w", "start"]);
            if !started {
                std::thread::sleep(Duration::from_secs(1));
            }
            started
        };
        assert!((0..60).any(start), "it did not start again");
    }

    fn control(&self, what: &[&str]) -> bool {
        let status = program(&self.bin, "pg_ctl")
            .arg("-D")
            .arg(self.folder.join("data"))
            .args(what)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        status.unwrap().success()
    }
}
