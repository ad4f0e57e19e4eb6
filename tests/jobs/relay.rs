//! A relay to a PostgreSQL server whose connections can be cut or fall silent.

use oviduct::random::{Stream, below, words};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;

/// What a relay does with connections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    Open,
    /// Forwards statements, but no answers.
    Deaf,
    /// Forwards nothing.
    Dead,
    /// Becomes deaf at the next commit, for all connections that are open then.
    DeafAtCommit,
    /// Cuts the connection of the next commit after it took effect, before its response.
    CutAfterCommit,
    /// Cuts the connection of the next commit before it takes effect; the server commits shortly
    /// afterwards.
    CutBeforeCommit,
    /// Cuts the connection of the next commit. The line is then held.
    HeldAtCommit,
    /// Like an open line, but the commit whose connection was cut waits for the line to be open. If
    /// the line is cut instead, the server rolls back.
    Held,
    /// Cuts all connections, and refuses new ones.
    Cut,
    /// Loses the response to one commit in `one_in`, drawn by the seed and the number of the
    /// commit: the connection is cut before or after the commit, or falls silent before or after it.
    Lossy {
        seed: u64,
        one_in: u32,
    },
}

/// How the response to a commit is lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Loss {
    CutBefore,
    CutAfter,
    SilentBefore,
    SilentAfter,
}

const LOSSES: [Loss; 4] = [Loss::CutBefore, Loss::CutAfter, Loss::SilentBefore, Loss::SilentAfter];

impl Line {
    /// The fate of a commit, of which `number` were before.
    fn loss(self, number: u32) -> Option<Loss> {
        match self {
            Self::CutAfterCommit => Some(Loss::CutAfter),
            Self::CutBeforeCommit | Self::HeldAtCommit => Some(Loss::CutBefore),
            Self::Lossy { seed, one_in } => {
                let [whether, how, ..] = words(seed, Stream::Growth, number, 0);
                (below(whether, one_in) == 0).then(|| LOSSES[below(how, 4) as usize])
            }
            _ => None,
        }
    }
}

/// Numbers of commits that a relay forwarded, and of those whose response it lost.
#[derive(Debug, Default)]
pub struct Commits {
    pub all: AtomicU32,
    pub lost: AtomicU32,
    pub silent: AtomicU32,
}

/// A way to a server through a relay. Connections that have been silent stay so.
pub struct Way {
    pub url: String,
    pub line: Arc<watch::Sender<Line>>,
    pub commits: Arc<Commits>,
}

impl Way {
    /// A way to the server of this URL.
    pub async fn open(url: &str) -> Self {
        let server = url.split(['@', '/']).nth(3).unwrap().to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let through = url.replace(&server, &listener.local_addr().unwrap().to_string());
        let line = Arc::new(watch::Sender::new(Line::Open));
        let commits = Arc::<Commits>::default();
        let (lines, counts) = (Arc::clone(&line), Arc::clone(&commits));
        tokio::spawn(async move {
            while let Ok((client, _)) = listener.accept().await {
                // Without a server, the client's connection is closed.
                let Ok(server) = TcpStream::connect(&server).await else { continue };
                tokio::spawn(relay(client, server, Arc::clone(&lines), Arc::clone(&counts)));
            }
        });
        Self { url: through, line, commits }
    }

    pub fn set(&self, line: Line) {
        self.line.send_replace(line);
    }
}

/// The transaction of a connection, by the messages of the client.
#[derive(Default)]
struct Transaction {
    is_open: bool,
}

impl Transaction {
    /// Follows a message. Returns true if it commits: `COMMIT`, or a submission or ends of attempts
    /// outside a transaction, which are known by members of their parameters.
    fn is_committed_by(&mut self, message: &[u8]) -> bool {
        let has = |text: &str| message.windows(text.len()).any(|window| window == text.as_bytes());
        let (begins, commits) = (has("BEGIN"), has("COMMIT"));
        let changes = has("\"backend_requested\":") || has("\"fallback\":");
        let is_alone = !self.is_open && !begins && changes;
        self.is_open = (self.is_open || begins) && !commits && !has("ROLLBACK");
        commits || is_alone
    }
}

/// Relays a connection until it is cut; a silent one is held open.
async fn relay(
    client: TcpStream,
    server: TcpStream,
    lines: Arc<watch::Sender<Line>>,
    commits: Arc<Commits>,
) -> std::io::Result<()> {
    let ((mut from_client, mut to_client), (mut from_server, mut to_server)) =
        (client.into_split(), server.into_split());
    let (mut asked, mut answered) = (vec![0; 1 << 16], vec![0; 1 << 16]);
    let (mut is_deaf, mut is_dead, mut is_cut) = (false, false, false);
    let mut cuts = lines.subscribe();
    let mut transaction = Transaction::default();
    loop {
        tokio::select! {
            length = from_client.read(&mut asked) => {
                let bytes = &asked[..length?];
                if transaction.is_committed_by(bytes) {
                    let line = *lines.borrow();
                    let loss = line.loss(commits.all.fetch_add(1, Ordering::Relaxed));
                    commits.lost.fetch_add(u32::from(loss.is_some()), Ordering::Relaxed);
                    match (line, loss) {
                        (Line::DeafAtCommit, _) => drop(lines.send_replace(Line::Deaf)),
                        (Line::HeldAtCommit, _) => drop(lines.send_replace(Line::Held)),
                        (Line::CutAfterCommit | Line::CutBeforeCommit, _) => drop(lines.send_replace(Line::Open)),
                        (_, Some(Loss::SilentBefore | Loss::SilentAfter)) => {
                            commits.silent.fetch_add(1, Ordering::Relaxed);
                        }
                        _ => {}
                    }
                    is_cut |= matches!(loss, Some(Loss::CutBefore | Loss::CutAfter));
                    is_deaf |= matches!(loss, Some(Loss::SilentBefore | Loss::SilentAfter));
                    is_dead |= loss == Some(Loss::SilentBefore);
                    if loss == Some(Loss::CutBefore) {
                        to_client.shutdown().await?;
                        tokio::time::sleep(Duration::from_millis(300)).await;
                        let _ = lines.subscribe().wait_for(|line| *line != Line::Held).await;
                        if *lines.borrow() == Line::Cut {
                            return Ok(());
                        }
                    }
                }
                if !is_dead && *lines.borrow() != Line::Dead {
                    to_server.write_all(bytes).await?;
                }
                if bytes.is_empty() {
                    return Ok(());
                }
            }
            length = from_server.read(&mut answered) => {
                let bytes = &answered[..length?];
                if bytes.is_empty() || is_cut {
                    return Ok(());
                }
                is_deaf |= matches!(*lines.borrow(), Line::Deaf | Line::Dead);
                if !is_deaf {
                    to_client.write_all(bytes).await?;
                }
            }
            () = until_cut(&mut cuts) => return Ok(()),
        }
    }
}

async fn until_cut(line: &mut watch::Receiver<Line>) {
    // Without a sender, nobody cuts any more.
    if line.wait_for(|line| *line == Line::Cut).await.is_err() {
        std::future::pending::<()>().await;
    }
}
