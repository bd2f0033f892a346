//! Answers of a scene as flat structs of C: hits of queries, events, refusals.

use std::ffi::c_char;

use rhumb_bindings::rhumb_client::BodyId;
use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{Query, QueryFilter, QueryKind};
use rhumb_bindings::{
    BindingError, EventRecord, HitRecord, RefusalRecord, packed_id, parse_packed_id,
};

use crate::border::{
    RhumbCode, check_out, copy_out, copy_text, elements, guard, one_of, write, write_if_wanted,
};
use crate::descriptions::{RhumbBody, RhumbShape};
use crate::generated::RhumbEventKind;
use crate::kinds::RhumbQueryKind;
use crate::scene::{RhumbScene, with};

/// A question about where the bodies are. Begin with `rhumb_query_init`. Fields that its kind does not name are ignored.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbQuery {
    /// A `RhumbQueryKind`.
    pub kind: u32,
    /// Most bodies in its answer, 1 to 64.
    pub hits: u32,
    /// Beginning of a line or way, or the point.
    pub position: [f32; 3],
    /// Unit quaternion x, y, z, w: of the shape.
    pub rotation: [f32; 4],
    /// From the beginning to the end of the line or way. A ray that only reaches a surface with its end does not hit it.
    pub translation: [f32; 3],
    /// Units of length.
    pub distance: f32,
    /// Ball, cuboid, rounded cuboid, capsule, cylinder or cone.
    pub shape: RhumbShape,
    /// Not zero: fixed bodies do not count.
    pub without_fixed: u8,
    /// Not zero: dynamic bodies do not count.
    pub without_dynamic: u8,
    /// Not zero: kinematic bodies do not count.
    pub without_kinematic: u8,
    /// Not zero: sensors count.
    pub with_sensors: u8,
    /// Only bodies in one of these collision groups count.
    pub groups: u32,
    /// A body that does not count; zero for none.
    pub except: RhumbBody,
    /// The body whose contacts are asked for.
    pub body: RhumbBody,
}

/// A body that a query found.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbHit {
    /// The body.
    pub body: RhumbBody,
    /// Place of the query in the call.
    pub query: u32,
    /// Units of length along the way, from the point to the surface, or from surface to surface, negative inside; zero for an
    /// overlap.
    pub distance: f32,
    /// On the body's surface, of a contact on that of the body that is asked about; zero for an overlap.
    pub point: [f32; 3],
    /// Outward from the surface, unit; zero where there is none.
    pub normal: [f32; 3],
}

/// Makes a plain query: a ray downwards of length zero that finds one body of any kind.
///
/// # Safety
///
/// `query` points to memory for a `RhumbQuery`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_query_init(query: *mut RhumbQuery) -> RhumbCode {
    // SAFETY: the caller promises the memory.
    guard(|| unsafe { write(query, RhumbQuery::PLAIN, "query") })
}

/// Sends `count` queries with all queued commands, waits for the answer, and writes what was found to `hits`, in the order
/// of the queries; the nearest of each comes first.
///
/// `hit_count` receives the number of hits, also if `capacity` is too small for them. The sum of the queries' `hits` is
/// always enough. `tick` may be null; otherwise it receives the tick whose scene was asked.
///
/// # Safety
///
/// `queries` points to `count` queries, `hits` to memory for `capacity` hits, `hit_count` to memory for a number; `tick` is
/// null or points to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_query(
    scene: RhumbScene,
    queries: *const RhumbQuery,
    count: usize,
    hits: *mut RhumbHit,
    capacity: usize,
    hit_count: *mut usize,
    tick: *mut u64,
) -> RhumbCode {
    guard(|| {
        check_out(hit_count, "hit_count")?;
        if capacity > 0 {
            check_out(hits, "hits")?;
        }
        // SAFETY: the caller promises the queries; the shapes that a query may have point to nothing.
        let queries = unsafe {
            let queries = elements(queries, count, "queries")?.iter();
            queries
                .map(|query| query.query())
                .collect::<Result<Vec<_>, _>>()?
        };
        let (asked, found) = with(scene, |scene| scene.query(queries))?;
        let found: Vec<_> = found.iter().map(RhumbHit::of).collect();
        // SAFETY: the caller promises the memory.
        unsafe {
            write(hit_count, found.len(), "hit_count")?;
            write_if_wanted(tick, asked.value(), "tick")?;
            copy_out(hits, capacity, &found, "hits")
        }
    })
}

impl RhumbQuery {
    const PLAIN: Self = Self {
        kind: RhumbQueryKind::Ray as u32,
        hits: 1,
        position: [0.0; 3],
        rotation: [0.0, 0.0, 0.0, 1.0],
        translation: [0.0; 3],
        distance: 0.0,
        shape: RhumbShape::PLAIN,
        without_fixed: 0,
        without_dynamic: 0,
        without_kinematic: 0,
        with_sensors: 0,
        groups: u32::MAX,
        except: RhumbBody(0),
        body: RhumbBody(0),
    };

    /// # Safety
    ///
    /// As [`RhumbShape::shape`].
    unsafe fn query(&self) -> Result<Query, BindingError> {
        let argument = |argument, needed| BindingError::Argument { argument, needed };
        let position = Vec3::from_array(self.position);
        let rotation = Quat::from_array(self.rotation);
        let translation = Vec3::from_array(self.translation);
        let shape = || {
            // SAFETY: the caller promises what the shape points to.
            let shape = unsafe { self.shape.shape() }?;
            match Query::allows(&shape) {
                true => Ok(shape),
                false => Err(argument("query.shape", "of a simple kind")),
            }
        };
        let kind = match one_of(&RhumbQueryKind::EACH, self.kind, "query.kind")? {
            RhumbQueryKind::Ray => QueryKind::Ray {
                origin: position,
                translation,
            },
            RhumbQueryKind::ShapeCast => QueryKind::ShapeCast {
                shape: shape()?,
                position,
                rotation,
                translation,
            },
            RhumbQueryKind::Projection => QueryKind::Projection {
                point: position,
                distance: self.distance,
            },
            RhumbQueryKind::Overlap => QueryKind::Overlap {
                shape: shape()?,
                position,
                rotation,
            },
            RhumbQueryKind::Contacts => QueryKind::Contacts {
                body: parse_packed_id(self.body.0)?,
            },
        };
        let except = match self.except {
            RhumbBody(0) => None,
            RhumbBody(word) => Some(parse_packed_id(word)?),
        };
        let hits = u8::try_from(self.hits).map_err(|_| argument("query.hits", "1 to 64"))?;
        Ok(Query {
            kind,
            filter: QueryFilter {
                with_fixed: self.without_fixed == 0,
                with_dynamic: self.without_dynamic == 0,
                with_kinematic: self.without_kinematic == 0,
                with_sensors: self.with_sensors != 0,
                except,
                groups: self.groups,
            },
            hits,
        })
    }
}

impl RhumbHit {
    fn of(record: &HitRecord) -> Self {
        Self {
            body: RhumbBody(packed_id(record.body)),
            query: record.query,
            distance: record.distance,
            point: record.point.to_array(),
            normal: record.normal.to_array(),
        }
    }
}

/// Bytes of the text of an event, with the zero byte that ends it.
pub const RHUMB_EVENT_TEXT_BYTES: usize = 192;

/// An event. Fields that its kind does not name are zero.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbEvent {
    /// A `RhumbEventKind`.
    pub kind: u32,
    /// Of a contact: units of length; negative if the bodies overlap.
    pub separation: f32,
    /// The newest complete tick when the event was read. No view of an earlier tick shows its effect.
    pub after: u64,
    /// The tick in which it happened, if the server says so; otherwise `after`.
    pub tick: u64,
    /// The number that the kind names.
    pub number: u64,
    /// The body.
    pub body: RhumbBody,
    /// The other body.
    pub other: RhumbBody,
    /// Of a contact: a point on `body`.
    pub point: [f32; 3],
    /// Of a contact: from `other` towards `body`, unit.
    pub normal: [f32; 3],
    /// Of a contact: the sum of all forces between the bodies.
    pub force: f32,
    /// A sentence in UTF-8 that ends with a zero byte; a longer one is cut.
    pub text: [c_char; 192],
}

/// Takes the oldest unread event. If there is none, the kind is `RHUMB_EVENT_KIND_NONE`. At most 65,536 unread events are
/// kept; `events_left_out` of the statistics counts those that were dropped, the oldest first.
///
/// # Safety
///
/// `event` points to memory for a `RhumbEvent`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_poll_event(
    scene: RhumbScene,
    event: *mut RhumbEvent,
) -> RhumbCode {
    guard(|| {
        check_out(event, "event")?;
        let record = with(scene, |scene| Ok(scene.poll_event()))?;
        let record = record.map_or(RhumbEvent::NONE, |record| RhumbEvent::of(&record));
        // SAFETY: the caller promises the memory.
        unsafe { write(event, record, "event") }
    })
}

impl RhumbEvent {
    const NONE: Self = Self {
        kind: RhumbEventKind::None as u32,
        separation: 0.0,
        after: 0,
        tick: 0,
        number: 0,
        body: RhumbBody(0),
        other: RhumbBody(0),
        point: [0.0; 3],
        normal: [0.0; 3],
        force: 0.0,
        text: [0; RHUMB_EVENT_TEXT_BYTES],
    };

    fn of(record: &EventRecord) -> Self {
        let word = |id: Option<BodyId>| RhumbBody(id.map_or(0, packed_id));
        Self {
            kind: RhumbEventKind::of(record.kind) as u32,
            separation: record.separation,
            after: record.after.value(),
            tick: record.tick.value(),
            number: record.number,
            body: word(record.body),
            other: word(record.other),
            point: record.point.to_array(),
            normal: record.normal.to_array(),
            force: record.force,
            text: copy_text(&record.text),
        }
    }
}

/// Bytes of the reason of a refusal, with the zero byte that ends it.
pub const RHUMB_REASON_BYTES: usize = 32;

/// A request that the server refused, and that changed nothing.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbRefusal {
    /// Zero: there is no further refusal, and all other fields are zero.
    pub exists: u8,
    /// Not zero: `number` is that of a command. Zero: the request was for authority, or of another member.
    pub is_command: u8,
    /// The command's number.
    pub number: u64,
    /// The body that the request is about; zero if that is not known.
    pub body: RhumbBody,
    /// The reason in one or a few words, such as "unknown body"; it ends with a zero byte.
    pub reason: [c_char; 32],
    /// The reason, a sentence in UTF-8 that ends with a zero byte; a longer one is cut.
    pub text: [c_char; 192],
}

/// Takes the oldest refusal of the last call that was `RHUMB_CODE_REFUSED`, of which 1,024 are kept. Its sentences are those
/// of `rhumb_last_error`, which names the first and tells how many others there are.
///
/// # Safety
///
/// `refusal` points to memory for a `RhumbRefusal`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_poll_refusal(
    scene: RhumbScene,
    refusal: *mut RhumbRefusal,
) -> RhumbCode {
    guard(|| {
        check_out(refusal, "refusal")?;
        let record = with(scene, |scene| Ok(scene.poll_refusal()))?;
        let record = record.map_or(RhumbRefusal::NONE, |record| RhumbRefusal::of(&record));
        // SAFETY: the caller promises the memory.
        unsafe { write(refusal, record, "refusal") }
    })
}

impl RhumbRefusal {
    const NONE: Self = Self {
        exists: 0,
        is_command: 0,
        number: 0,
        body: RhumbBody(0),
        reason: [0; RHUMB_REASON_BYTES],
        text: [0; RHUMB_EVENT_TEXT_BYTES],
    };

    fn of(record: &RefusalRecord) -> Self {
        Self {
            exists: 1,
            is_command: u8::from(record.number.is_some()),
            number: record.number.unwrap_or(0),
            body: RhumbBody(record.body.map_or(0, packed_id)),
            reason: copy_text(record.reason),
            text: copy_text(&record.text),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::ffi::CStr;

    use rhumb_bindings::Coordinates;
    use rhumb_bindings::rhumb_client::scene::CommandError;
    use rhumb_bindings::rhumb_client::{BodyId, Event, Tick};

    use super::*;

    fn query(query: RhumbQuery) -> Result<Query, BindingError> {
        // SAFETY: no query of these tests has a shape that points to anything.
        unsafe { query.query() }
    }

    #[test]
    fn a_plain_query_is_a_ray_among_all_but_sensors() {
        let expected = Query::ray(Vec3::ZERO, Vec3::ZERO);
        assert_eq!(query(RhumbQuery::PLAIN).unwrap(), expected);
    }

    #[test]
    fn a_filter_and_a_shape_are_read() {
        let overlap = RhumbQuery {
            kind: RhumbQueryKind::Overlap as u32,
            hits: 64,
            without_fixed: 1,
            with_sensors: 1,
            except: RhumbBody(3),
            ..RhumbQuery::PLAIN
        };
        let read = query(overlap).unwrap();
        assert!(matches!(read.kind, QueryKind::Overlap { .. }));
        assert!(!read.filter.with_fixed && read.filter.with_sensors);
        assert_eq!(read.filter.except.map(packed_id), Some(3));
        assert_eq!(read.hits, 64);
    }

    #[test]
    fn wrong_queries_are_errors_that_name_the_field() {
        let error = |wrong| query(wrong).expect_err("the query is wrong").to_string();
        let plain = RhumbQuery::PLAIN;
        assert!(error(RhumbQuery { kind: 5, ..plain }).starts_with("query.kind"));
        assert!(error(RhumbQuery { hits: 256, ..plain }).starts_with("query.hits"));
        let except = RhumbBody(1 << 33);
        assert!(error(RhumbQuery { except, ..plain }).contains("id of no body"));
        let mut cast = RhumbQuery {
            kind: RhumbQueryKind::ShapeCast as u32,
            ..plain
        };
        cast.shape.kind = crate::kinds::RhumbShapeKind::HalfSpace as u32;
        assert!(error(cast).starts_with("query.shape must be"));
    }

    #[test]
    fn a_record_keeps_its_numbers_and_its_sentence() {
        let id = BodyId::new(4, 1);
        let refused = Event::Refused {
            number: 9,
            error: CommandError::UnknownBody(id),
        };
        let record = EventRecord::new(Tick::new(7), refused, Coordinates::Rhumb);
        let event = RhumbEvent::of(&record);
        assert_eq!(event.kind, RhumbEventKind::CommandRefused as u32);
        assert_eq!((event.number, event.after, event.tick), (9, 7, 7));
        // SAFETY: the text of an event ends with a zero byte.
        let text = unsafe { CStr::from_ptr(event.text.as_ptr()) };
        assert_eq!(text.to_str(), Ok("the scene has no body 8589934597"));
    }

    #[test]
    fn a_long_sentence_is_cut_between_two_characters() {
        let placed = Event::BodyPlaced(BodyId::new(0, 0));
        let mut record = EventRecord::new(Tick::ZERO, placed, Coordinates::Rhumb);
        record.text = "å".repeat(200);
        let event = RhumbEvent::of(&record);
        // SAFETY: the text of an event ends with a zero byte.
        let text = unsafe { CStr::from_ptr(event.text.as_ptr()) };
        assert_eq!(text.to_str(), Ok("å".repeat(95).as_str()));
        assert_eq!(event.body, RhumbBody(1));
    }

    #[test]
    fn a_refusal_keeps_its_numbers_and_its_sentences() {
        let record = RefusalRecord {
            number: Some(0),
            subject: "command",
            body: Some(BodyId::new(4, 0)),
            reason: "unknown body",
            text: "the scene has no body 5".to_owned(),
        };
        let refusal = RhumbRefusal::of(&record);
        assert_eq!(
            (refusal.exists, refusal.is_command, refusal.number),
            (1, 1, 0)
        );
        assert_eq!(refusal.body, RhumbBody(5));
        // SAFETY: the texts of a refusal end with a zero byte.
        let texts = unsafe {
            [refusal.reason.as_ptr(), refusal.text.as_ptr()].map(|text| CStr::from_ptr(text))
        };
        assert_eq!(texts, [c"unknown body", c"the scene has no body 5"]);
        assert_eq!(RhumbRefusal::NONE.exists, 0);
    }
}
