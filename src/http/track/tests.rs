//! Which events are published, and which are held back.

use super::super::samples::{job, running};
use super::*;
use proptest::prelude::*;

const MS: Duration = Duration::from_millis(1);

#[test]
fn the_first_event_is_the_status_and_the_contour_if_there_is_one() {
    assert_eq!(Track::new(250 * MS).next(&job(), Duration::ZERO).0, [Name::Status]);
    assert_eq!(Track::new(250 * MS).next(&running(10), Duration::ZERO).0, [Name::Status, Name::Section]);
}

#[test]
fn nothing_new_makes_no_event() {
    let mut track = Track::new(250 * MS);
    track.next(&running(10), Duration::ZERO);
    assert_eq!(track.next(&running(10), MS), (vec![], None));
    assert_eq!(track.next(&running(20), 250 * MS).0, [Name::Progress, Name::Section]);
}

#[test]
fn progress_is_held_back_and_then_published() {
    let mut track = Track::new(250 * MS);
    track.next(&running(10), Duration::ZERO);
    assert_eq!(track.next(&running(20), 100 * MS), (vec![], Some(150 * MS)));
    assert_eq!(track.next(&running(20), 250 * MS), (vec![Name::Progress, Name::Section], None));
}

#[test]
fn moving_up_in_the_queue_is_published() {
    let mut track = Track::new(250 * MS);
    let behind = Job { queue_position: Some(3), ..job() };
    track.next(&behind, Duration::ZERO);
    assert_eq!(track.next(&job(), MS).0, [Name::Status]);
}

proptest! {
    /// Every change of state is published, progress at most once per interval, and what was held back is published when
    /// it is asked for again.
    #[test]
    fn thinning_never_loses_the_last_state(steps in prop::collection::vec((0u64..200, 0u32..3), 1..60)) {
        let interval = 250 * MS;
        let mut track = Track::new(interval);
        let (mut now, mut step, mut attempts) = (Duration::ZERO, 0, 1);
        let (mut published_at, mut last): (Vec<Duration>, _) = (vec![], running(0));
        for (gap, what) in steps {
            now += Duration::from_millis(gap);
            match what { 0 => attempts += 1, _ => step += 10 }
            last = Job { attempts, ..running(step) };
            let fresh = track.published.is_none();
            let (names, again) = track.next(&last, now);
            prop_assert!(what != 0 || fresh || names.contains(&Name::Status));
            if names.contains(&Name::Progress) { published_at.push(now); }
            prop_assert!(again.is_none_or(|a| a <= interval));
        }
        prop_assert!(published_at.windows(2).all(|w| w[1] - w[0] >= interval));
        track.next(&last, now + interval);
        prop_assert_eq!(&track.published, &Some(Published::of(&last)));
        prop_assert_eq!(track.next(&last, now + interval * 2), (vec![], None));
        let ended = Job { status: Status::Cancelled, ..last };
        prop_assert_eq!(track.next(&ended, now + interval * 2), (vec![Name::End], None));
    }
}
