//! Faults that strike while clients work, drawn from a seed.

use crate::cluster::Cluster;
use crate::dice::Dice;
use crate::processes::Process;
use crate::relay::{Line, Way};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::task::JoinSet;

/// Time for which a process is stopped: longer than a lease.
const STALL: Duration = Duration::from_millis(3000);

/// Line of a process between other faults of its line.
const USUAL: Line = Line::Lossy { seed: 0, one_in: 20 };

/// Numbers of faults.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Struck {
    pub kills: u32,
    pub stalls: u32,
    pub outages: u32,
    pub database_kills: u32,
    pub lost_commits: u32,
    /// Lost commits whose connection fell silent.
    pub silent: u32,
}

impl Struck {
    /// True if there are at least as many kills of either kind and lost commits as in `wanted`.
    pub fn reaches(&self, wanted: &Self) -> bool {
        self.kills >= wanted.kills
            && self.database_kills >= wanted.database_kills
            && self.lost_commits >= wanted.lost_commits
    }
}

/// The parts of a system that can fail.
#[derive(Default)]
pub struct Parts {
    pub processes: Vec<Arc<Process>>,
    /// Ways to the database, one per process.
    pub ways: Vec<Way>,
    pub database: Option<Arc<Cluster>>,
}

/// The faults, and what they have done.
pub struct Nemesis {
    parts: Parts,
    dice: Dice,
    struck: Struck,
    /// Held while the database is not up.
    is_up: Arc<tokio::sync::Mutex<()>>,
    /// Ends of faults that last.
    lasting: JoinSet<()>,
}

impl Nemesis {
    pub fn new(parts: Parts, dice: Dice) -> Self {
        for way in &parts.ways {
            way.set(USUAL);
        }
        Self { parts, dice, struck: Struck::default(), is_up: Arc::default(), lasting: JoinSet::new() }
    }

    pub fn struck(&self) -> Struck {
        let sum = |number: fn(&Way) -> u32| self.parts.ways.iter().map(number).sum();
        let lost_commits = sum(|way| way.commits.lost.load(Ordering::Relaxed));
        let silent = sum(|way| way.commits.silent.load(Ordering::Relaxed));
        Struck { lost_commits, silent, ..self.struck }
    }

    /// Strikes once, and waits a little.
    pub async fn strike(&mut self) {
        while self.lasting.try_join_next().is_some() {}
        match self.dice.below(if self.parts.ways.is_empty() { 35 } else { 100 }) {
            0..30 => {
                let process = self.dice.pick(&self.parts.processes);
                self.struck.kills += u32::from(process.kill());
            }
            30..35 => {
                let process = Arc::clone(self.dice.pick(&self.parts.processes));
                if process.stop() {
                    self.struck.stalls += 1;
                    self.lasting.spawn(async move {
                        tokio::time::sleep(STALL).await;
                        process.resume();
                    });
                }
            }
            35..83 => {
                let (seed, one_in) = (u64::from(self.dice.below(1 << 16)), 2 + self.dice.below(4));
                self.set_line(Line::Lossy { seed, one_in }, 1000, 3000);
            }
            83..91 => {
                let lines = [Line::Cut, Line::Deaf, Line::Dead, Line::DeafAtCommit];
                let line = *self.dice.pick(&lines);
                self.struck.outages += 1;
                self.set_line(line, 100, 4000);
            }
            _ => self.kill_database(),
        }
        tokio::time::sleep(Duration::from_millis(50 + u64::from(self.dice.below(450)))).await;
    }

    /// Gives the way of one process this line for a random time.
    fn set_line(&mut self, line: Line, at_least: u64, at_most: u32) {
        let way = self.dice.pick(&self.parts.ways);
        way.set(line);
        let line = Arc::clone(&way.line);
        let time = Duration::from_millis(at_least + u64::from(self.dice.below(at_most)));
        self.lasting.spawn(async move {
            tokio::time::sleep(time).await;
            line.send_replace(USUAL);
        });
    }

    /// Kills the database, unless it has not started yet since the last kill.
    fn kill_database(&mut self) {
        let away = Duration::from_millis(u64::from(self.dice.below(1500)));
        let Some(database) = &self.parts.database else { return };
        let Ok(free) = Arc::clone(&self.is_up).try_lock_owned() else { return };
        self.struck.database_kills += 1;
        let database = Arc::clone(database);
        self.lasting.spawn(async move {
            let restart = tokio::task::spawn_blocking(move || {
                database.crash();
                std::thread::sleep(away);
                database.restart();
            });
            restart.await.unwrap();
            drop(free);
        });
    }

    /// Ends all faults.
    pub async fn relent(&mut self) {
        while self.lasting.join_next().await.is_some() {}
        for way in &self.parts.ways {
            way.set(Line::Open);
        }
    }
}
