//! What one member heard and predicted_motion, to be held against the truth.
//!
//! Reads a session and changes nothing in it but that its events are taken.

use rhumb_protocol::Ending;
use rhumb_protocol::message::{
    AuthorityError, Denial, Inspection, RemovalCause, StreamChoice, TierChangeCause,
};
use rhumb_protocol::scene::{BodyKind, CommandError, IdRange};
use rhumb_protocol::session::{ClientSession, Event, Replica};
use rhumb_protocol::stream::ErrorBound;
use rhumb_reckoning::{BodyId, Metres, Pose, Tick, Tolerance};

use crate::fnv::Fnv;
use crate::truth::SceneTruth;

/// That a body was within a distance of this pose at a tick.
#[derive(Clone, Copy, Debug)]
pub struct Claim {
    /// Which body.
    pub id: BodyId,
    /// When.
    pub tick: Tick,
    /// Where the copy had it.
    pub pose: Pose,
    /// How far off any point of it may be.
    pub within: Metres,
    /// What its stream promised for it.
    pub tolerance: Tolerance,
    /// By what factor it said that this may be exceeded.
    pub error_scale: f64,
}

/// The account of one member.
#[derive(Debug, Default)]
pub struct ObservationHistory {
    /// Of every welcome.
    pub welcomes: usize,
    /// Indices of the last joining; none while it is no member.
    pub granted: Option<IdRange>,
    /// Commands up to a number, and the tick before whose step they acted.
    pub applied: Vec<(u64, Tick)>,
    /// Refused commands.
    pub refused: Vec<(u64, CommandError)>,
    /// Requests turned down.
    pub denied: Vec<Denial>,
    /// Bodies that went.
    pub removed: Vec<(BodyId, RemovalCause)>,
    /// Streams that it changed to.
    pub following: Vec<StreamChoice>,
    /// Where the server moved it, and why.
    pub moved: Vec<(StreamChoice, TierChangeCause)>,
    /// What it was given to drive, or why not.
    pub drives: Vec<Result<Vec<BodyId>, AuthorityError>>,
    /// Bodies whose tracks were other than the server's.
    pub mismatches: u64,
    /// Answers to inspections.
    pub inspections: Vec<Inspection>,
    /// How often the scene was created by it, it left, and the scene was deleted.
    pub created: usize,
    /// See `created`.
    pub left: usize,
    /// See `created`.
    pub deleted: usize,
    /// How the connection ended.
    pub ended: Option<Ending>,
    /// What its bounds promised.
    pub claims: Vec<Claim>,
    /// How often a bound was asked for and could not be given.
    pub unknown: usize,
    last_look: Option<(Tick, u64)>,
}

impl ObservationHistory {
    /// Takes the session's events.
    pub fn listen(&mut self, session: &mut ClientSession) {
        while let Some(event) = session.poll_event() {
            match event {
                Event::Welcomed(_) => self.welcomes += 1,
                Event::Created => self.created += 1,
                Event::Joined(granted) => self.granted = Some(granted),
                Event::SubscriptionChanged(choice) => self.following.push(choice),
                Event::TierChanged { to, cause } => self.moved.push((to, cause)),
                Event::Left => (self.granted, self.left) = (None, self.left + 1),
                Event::Deleted => (self.granted, self.deleted) = (None, self.deleted + 1),
                Event::Denied(denial) => self.denied.push(denial),
                Event::Applied { through, tick } => self.applied.push((through, tick)),
                Event::Refused { number, error } => self.refused.push((number, error)),
                Event::BodyRemoved { id, cause } => self.removed.push((id, cause)),
                Event::Inspected(inspection) => self.inspections.push(inspection),
                Event::Ended(ending) => self.ended = Some(ending),
                Event::ChecksumMismatch => self.mismatches += 1,
                Event::AuthorityGrant(bodies) => self.drives.push(Ok(bodies)),
                Event::AuthorityDenied(error) => self.drives.push(Err(error)),
                Event::Reserved(_)
                | Event::BodyPlaced(_)
                | Event::SceneFaulted(_)
                | Event::ClockSeen { .. } => {}
            }
        }
    }

    /// Notes what the copy claims now of every body that can move, if anything was heard since the last look.
    pub fn look(&mut self, session: &ClientSession) {
        let Some(replica) = session.replica() else {
            return;
        };
        let statistics = replica.stream().statistics();
        let now = (
            replica.stream().watermark_tick(),
            statistics.packets + statistics.refreshes,
        );
        if self.last_look == Some(now) {
            return;
        }
        self.last_look = Some(now);
        self.claim(replica, |kind| kind != BodyKind::Static);
    }

    /// Notes what the copy claims now of every body.
    pub fn look_at_all(&mut self, session: &ClientSession) {
        if let Some(replica) = session.replica() {
            self.claim(replica, |_| true);
        }
    }

    fn claim(&mut self, replica: &Replica, wanted: impl Fn(BodyKind) -> bool) {
        let stream = replica.stream();
        let tick = stream.watermark_tick();
        for desc in replica.bodies().filter(|desc| wanted(desc.kind)) {
            let id = desc.id;
            match stream
                .bound(id)
                .expect("a body of the copy has a bound, if only an unknown one")
            {
                ErrorBound::Unknown { .. } => self.unknown += 1,
                ErrorBound::Within(within) => {
                    let predicted_motion = stream
                        .predicted_motion(id, tick)
                        .expect("a body of the copy is predicted_motion");
                    let pose = predicted_motion.pose();
                    self.claims.push(Claim {
                        id,
                        tick,
                        pose,
                        within,
                        tolerance: stream
                            .tolerance_of(id)
                            .expect("a body of the copy has a tolerance"),
                        error_scale: stream
                            .error_scale_at(tick)
                            .expect("a bound knows its factor"),
                    });
                }
            }
        }
    }

    /// Holds every claim against the truth and returns the worst error of all.
    ///
    /// # Panics
    ///
    /// At the first claim that was not true.
    pub fn judge(&self, truth: &SceneTruth, who: &str) -> Metres {
        let mut worst = Metres::new(0.0);
        for Claim {
            id,
            tick,
            pose,
            within,
            tolerance,
            error_scale,
        } in &self.claims
        {
            let (apart, radius) = truth.apart(*id, *tick, pose).unwrap_or_else(|| {
                panic!("{who}: {id} was bounded at {tick}, where it was not at all")
            });
            let error = apart.surface_error(radius);
            assert!(
                error <= *within && tolerance.share(&apart, radius) <= *error_scale,
                "{who}: {id} at {tick} is off by {error}, bound {within}, tolerance {tolerance}"
            );
            if error > worst {
                worst = error;
            }
        }
        worst
    }
}

/// Two copies of one scene in one tier are equal to the bit: shapes aside, which nothing moves.
///
/// # Panics
///
/// At the first body whose config, track or belief differ.
pub fn assert_same_copy(one: &Replica, other: &Replica) {
    let ids = |replica: &Replica| replica.bodies().map(|desc| desc.id).collect::<Vec<_>>();
    assert_eq!(ids(one), ids(other), "the copies hold different bodies");
    assert_eq!(one.gravity(), other.gravity());
    let (one_stream, other_stream) = (one.stream(), other.stream());
    let tick = one_stream
        .watermark_tick()
        .max(other_stream.watermark_tick());
    for desc in one.bodies() {
        let id = desc.id;
        assert_eq!(Some(desc), other.body(id));
        assert_eq!(
            one_stream.track(id),
            other_stream.track(id),
            "the tracks of {id} at {tick}"
        );
        assert_eq!(
            one_stream.predicted_motion(id, tick),
            other_stream.predicted_motion(id, tick),
            "{id} at {tick}"
        );
    }
}

/// FNV-1a over what a copy shows at its complete tick: the tick, then for each body in order of index its index,
/// generation and the bits of position and rotation in f32. `so_far`: of the ticks before, or zero.
#[must_use]
pub fn copy_digest(so_far: u64, replica: &Replica) -> u64 {
    let mut digest = match so_far {
        0 => Fnv::START,
        _ => Fnv::from(so_far),
    };
    let mut fold = |word: u32| digest.fold(&word.to_le_bytes());
    let tick = replica.stream().complete();
    fold(tick.value() as u32);
    for desc in replica.bodies() {
        fold(desc.id.index());
        fold(u32::from(desc.id.generation()));
        let motion = replica.stream().predicted_motion(desc.id, tick);
        let pose = motion
            .expect("a body of the copy is predicted_motion")
            .pose();
        for part in pose.position.as_vec3().to_array() {
            fold(part.to_bits());
        }
        for part in pose.rotation.as_quat().to_array() {
            fold(part.to_bits());
        }
    }
    digest.value()
}
