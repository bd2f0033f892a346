//! A member whose cells change while messages are under way.

use std::collections::BTreeMap;

use proptest::prelude::*;
use rhumb_protocol::scene::Stepping;
use rhumb_scene::engine::Engines;
use rhumb_tests::{DeliveryAction, LossFilter};

use crate::cell_members::{AWAY, BESIDE, Divided, HERE, within};

/// What happens to the member.
#[derive(Clone, Debug)]
enum Change {
    /// It takes these of both cells, within a tolerance in millimetres.
    Take([Option<u32>; 2]),
    /// What the server sends it does not arrive until the next [`Change::Release`].
    Hold,
    Release,
    /// A body is put into one cell, the other, or neither.
    Put(u32, usize),
    Step,
}

fn any_change() -> impl Strategy<Value = Change> {
    let tolerance = || prop_oneof![Just(None), Just(Some(10)), Just(Some(50))];
    prop_oneof![
        4 => (tolerance(), tolerance()).prop_map(|(here, beside)| Change::Take([here, beside])),
        2 => Just(Change::Hold),
        1 => Just(Change::Release),
        1 => (0..3_u32, 0..3_usize).prop_map(|(index, place)| Change::Put(index, place)),
        3 => Just(Change::Step),
    ]
}

impl Divided {
    fn change(&mut self, change: &Change) {
        match *change {
            Change::Take(wanted) => {
                let wanted = [HERE, BESIDE].into_iter().zip(wanted);
                let wanted =
                    wanted.filter_map(|(cell, tolerance)| Some((cell, within(tolerance?))));
                let session = self.table.session(self.member);
                let wanted = wanted.collect();
                session.take_cells(&wanted).expect("a member by cells");
                self.table.run_until_idle();
            }
            Change::Hold => self.table.hold(self.member),
            Change::Release => self.table.release(self.member),
            Change::Put(index, place) => self.put(index, [5.0, 15.0, AWAY][place]),
            Change::Step => self.step(),
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn cells_that_are_given_up_and_taken_again_while_messages_are_under_way_are_shown(
        is_lockstep in any::<bool>(),
        // The link says what it takes, so that the server answers some requests at a time.
        is_paced in any::<bool>(),
        is_lossy in any::<bool>(),
        // Another member has the cells, whose streams last.
        has_others in any::<bool>(),
        last_body in 0..3_u32,
        changes in proptest::collection::vec(any_change(), 1..24),
    ) {
        let stepping = if is_lockstep { Stepping::Lockstep } else { Stepping::FreeRunning };
        let mut divided = Divided::new(stepping, Engines::default());
        if has_others {
            let other = divided.table.connect("divided");
            let member = std::mem::replace(&mut divided.member, other);
            divided.enter(None);
            divided.member = member;
        }
        divided.enter(None);
        if is_paced {
            divided.table.pace(divided.member);
        }
        let mut datagrams = 0_u32..;
        let lossy = LossFilter::new(move |_| match datagrams.next() {
            Some(number) if is_lossy && number % 3 > 0 => DeliveryAction::Lost,
            _ => DeliveryAction::Arrives,
        });
        divided.table.filter_downlink(divided.member, lossy);
        for change in &changes {
            divided.change(change);
        }
        divided.change(&Change::Take([Some(10), Some(50)]));
        divided.table.release(divided.member);
        let reliable = LossFilter::new(|_| DeliveryAction::Arrives);
        divided.table.filter_downlink(divided.member, reliable);
        divided.put(last_body, 12.0);
        for _ in 0..if is_paced || is_lossy { 120 } else { 4 } {
            divided.step();
        }
        let truth = divided.true_bodies();
        let in_cells = |cell| truth.get(&cell).into_iter().flatten().copied().collect::<Vec<_>>();
        let bodies = divided.bodies();
        prop_assert_eq!(bodies, BTreeMap::from([HERE, BESIDE].map(|cell| (cell, in_cells(cell)))));
        let [owner, member] = [divided.owner, divided.member];
        let complete = |divided: &mut Divided, peer| divided.table.session(peer).complete();
        let late = complete(&mut divided, owner).zip(complete(&mut divided, member));
        let late = late.map(|(owner, member)| owner.value().saturating_sub(member.value()));
        prop_assert!(late.is_some_and(|late| late <= if is_lockstep { 0 } else { 150 }), "{late:?}");
        prop_assert_eq!(divided.table.closed(member), None);
    }
}
