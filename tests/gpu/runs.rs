//! Whole small runs.

use crate::common::{device, plan};
use oviduct::geometry::polygon::{check_contour, check_nested};
use oviduct::model::Section;
use oviduct::sim::gpu::{BatchSink, Checkpoint, run_batch};
use oviduct::sim::{SimError, Statistics};
use serde_json::json;

#[derive(Default)]
pub(crate) struct Kept {
    pub(crate) sections: Vec<Vec<(Section, Checkpoint)>>,
    pub(crate) finished: Vec<Option<Statistics>>,
    pub(crate) failed: Vec<Option<SimError>>,
    pub(crate) progress: Vec<i64>,
    pub(crate) cancel: Option<(usize, i64)>,
}

impl Kept {
    pub(crate) fn new(members: usize) -> Self {
        Self {
            sections: vec![Vec::new(); members],
            finished: vec![None; members],
            failed: vec![None; members],
            progress: vec![i64::MIN; members],
            cancel: None,
        }
    }
}

impl BatchSink for Kept {
    fn section(&mut self, member: usize, section: Section, checkpoint: Checkpoint) {
        self.sections[member].push((section, checkpoint));
    }
    fn progress(&mut self, member: usize, step: i64, particles: u32) {
        assert!(step >= self.progress[member] && particles > 0);
        self.progress[member] = step;
    }
    fn cancelled(&mut self, member: usize) -> bool {
        self.cancel.is_some_and(|(m, step)| m == member && self.progress[m] >= step)
    }
    fn failed(&mut self, member: usize, error: SimError) {
        self.failed[member] = Some(error);
    }
    fn finished(&mut self, member: usize, statistics: Statistics) {
        self.finished[member] = Some(statistics);
    }
}

pub(crate) fn assert_sound(section: &Section) {
    let (inner, outer) = (&section.inner.points, &section.outer.points);
    check_contour(inner).unwrap_or_else(|e| panic!("inner loop at step {}: {e}", section.step));
    check_contour(outer).unwrap_or_else(|e| panic!("outer loop at step {}: {e}", section.step));
    check_nested(inner, outer).unwrap_or_else(|e| panic!("step {}: {e}", section.step));
}

#[test]
fn a_batch_runs_to_its_end_without_crossings() {
    let plans: Vec<_> = (1..=3).map(|seed| plan(&json!({}), seed)).collect();
    let mut kept = Kept::new(3);
    let watch = oviduct::clock::Stopwatch::start();
    let report = run_batch(device(), &plans, &mut kept).unwrap();
    eprintln!("{:?} {report:?}", watch.seconds());
    for member in 0..3 {
        assert_eq!(kept.failed[member], None);
        let statistics = kept.finished[member].unwrap();
        eprintln!("{statistics:?}");
        let sections = &kept.sections[member];
        let steps: Vec<f64> = sections.iter().map(|(s, _)| s.step).collect();
        assert_eq!(steps, (0..=15).map(|k| f64::from(10 * k)).collect::<Vec<_>>());
        sections.iter().for_each(|(s, _)| assert_sound(s));
        let last = &sections[15].0;
        assert_eq!(last.particles() as u64 + statistics.splits_missing, 900);
    }
}
