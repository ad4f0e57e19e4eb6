//! A relay to a PostgreSQL server whose connections can be cut or fall silent.

use std::sync::Arc;
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
}

/// A way to a server through a relay. Connections that have been silent stay so.
pub struct Way {
    pub url: String,
    pub line: Arc<watch::Sender<Line>>,
}

impl Way {
    /// A way to the server of this URL.
    pub async fn open(url: &str) -> Self {
        let server = url.split(['@', '/']).nth(3).unwrap().to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let through = url.replace(&server, &listener.local_addr().unwrap().to_string());
        let line = Arc::new(watch::Sender::new(Line::Open));
        let lines = Arc::clone(&line);
        tokio::spawn(async move {
            while let Ok((client, _)) = listener.accept().await {
                let server = TcpStream::connect(&server).await.unwrap();
                tokio::spawn(relay(client, server, Arc::clone(&lines)));
            }
        });
        Self { url: through, line }
    }

    pub fn set(&self, line: Line) {
        self.line.send_replace(line);
    }
}

/// Relays a connection until it is cut; a silent one is held open.
async fn relay(client: TcpStream, server: TcpStream, lines: Arc<watch::Sender<Line>>) -> std::io::Result<()> {
    let ((mut from_client, mut to_client), (mut from_server, mut to_server)) =
        (client.into_split(), server.into_split());
    let (mut asked, mut answered) = (vec![0; 1 << 16], vec![0; 1 << 16]);
    let (mut is_deaf, mut is_cut) = (false, false);
    loop {
        tokio::select! {
            length = from_client.read(&mut asked) => {
                let bytes = &asked[..length?];
                if bytes.windows(6).any(|window| window == b"COMMIT") {
                    let line = *lines.borrow();
                    match line {
                        Line::DeafAtCommit => drop(lines.send_replace(Line::Deaf)),
                        Line::CutAfterCommit | Line::CutBeforeCommit => {
                            lines.send_replace(Line::Open);
                            is_cut = true;
                        }
                        Line::Open | Line::Deaf | Line::Dead => {}
                    }
                    if line == Line::CutBeforeCommit {
                        to_client.shutdown().await?;
                        tokio::time::sleep(Duration::from_millis(300)).await;
                    }
                }
                if *lines.borrow() != Line::Dead {
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
        }
    }
}
