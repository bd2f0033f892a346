//! Our codec beside that of crate dis-rs: each reads what the other writes.
//!
//! It is no golden master: it writes other bytes than it has read. Only fields are compared.

use bytes::BytesMut;
use dis_rs::model::{
    EntityId as TheirId, Location, Pdu as TheirPdu, PduBody, Timestamp as Stamp, VectorF32,
};
use glam::DVec3;
use proptest::prelude::*;
use rhumb_dis::entity::{
    DeadReckoning, EntityId, EntityState, EntityStateUpdate, EntityType, Kinematics, Marking,
    RemoveEntity,
};
use rhumb_dis::pdu::{Body, Bundle, Header, Pdu, Timestamp};

fn id() -> impl Strategy<Value = EntityId> {
    (any::<u16>(), any::<u16>(), any::<u16>()).prop_map(|(site, application, entity)| EntityId {
        site,
        application,
        entity,
    })
}

fn floats() -> impl Strategy<Value = [f32; 3]> {
    prop::array::uniform3(-1e3_f32..1e3)
}

fn kinematics() -> impl Strategy<Value = Kinematics> {
    let location = prop::array::uniform3(-7e6_f64..7e6);
    (floats(), location, floats()).prop_map(|(velocity, location, orientation)| Kinematics {
        velocity,
        location: DVec3::from(location),
        orientation,
        appearance: 0,
    })
}

fn body() -> impl Strategy<Value = Body<'static>> {
    let state = (id(), kinematics(), 1..=9_u8, floats(), floats()).prop_map(
        |(id, kinematics, model, acceleration, spin)| {
            let entity_type: EntityType = "1.2.225.1.3.4.5".parse().expect("a type");
            Body::EntityState(EntityState {
                id,
                force: 1,
                entity_type,
                alternative_type: entity_type,
                kinematics,
                dead_reckoning: DeadReckoning {
                    model,
                    other: [0; 15],
                    acceleration,
                    spin,
                },
                marking: Marking::ascii("RHUMB 12345"),
                capabilities: 0,
                parameters: &[],
            })
        },
    );
    let update = (id(), kinematics()).prop_map(|(id, kinematics)| {
        Body::EntityStateUpdate(EntityStateUpdate {
            id,
            padding: 0,
            kinematics,
            parameters: &[],
        })
    });
    let remove = (id(), id(), any::<u32>()).prop_map(|(originating, receiving, request)| {
        Body::RemoveEntity(RemoveEntity {
            originating,
            receiving,
            request,
        })
    });
    prop_oneof![state, update, remove]
}

fn theirs(id: EntityId) -> TheirId {
    TheirId::new(id.site, id.application, id.entity)
}

fn vector([x, y, z]: [f32; 3]) -> VectorF32 {
    VectorF32::new(x, y, z)
}

fn place(location: DVec3) -> Location {
    Location::new(location.x, location.y, location.z)
}

/// True if their PDU has the fields of ours.
fn check(ours: &Pdu<'_>, read: &TheirPdu) -> Result<(), TestCaseError> {
    prop_assert_eq!(read.header.exercise_id, ours.header.exercise);
    prop_assert_eq!(u32::from(read.header.timestamp), ours.header.timestamp.0);
    prop_assert_eq!(usize::from(read.header.pdu_length), ours.encoded_len());
    match (&ours.body, &read.body) {
        (Body::EntityState(ours), PduBody::EntityState(read)) => {
            prop_assert_eq!(read.entity_id, theirs(ours.id));
            prop_assert_eq!(
                read.entity_linear_velocity,
                vector(ours.kinematics.velocity)
            );
            prop_assert_eq!(read.entity_location, place(ours.kinematics.location));
            let angles = read.entity_orientation;
            let angles = [angles.psi, angles.theta, angles.phi];
            prop_assert_eq!(angles, ours.kinematics.orientation);
            let reckoning = &read.dead_reckoning_parameters;
            prop_assert_eq!(u8::from(reckoning.algorithm), ours.dead_reckoning.model);
            let [acceleration, spin] =
                [ours.dead_reckoning.acceleration, ours.dead_reckoning.spin].map(vector);
            prop_assert_eq!(reckoning.linear_acceleration, acceleration);
            prop_assert_eq!(reckoning.angular_velocity, spin);
            prop_assert_eq!(
                read.entity_marking.marking_string.as_bytes(),
                ours.marking.text
            );
            prop_assert_eq!(u8::from(read.entity_type.kind), ours.entity_type.kind);
            prop_assert_eq!(
                u16::from(read.entity_type.country),
                ours.entity_type.country
            );
            prop_assert_eq!(read.entity_type.extra, ours.entity_type.extra);
        }
        (Body::EntityStateUpdate(ours), PduBody::EntityStateUpdate(read)) => {
            prop_assert_eq!(read.entity_id, theirs(ours.id));
            prop_assert_eq!(
                read.entity_linear_velocity,
                vector(ours.kinematics.velocity)
            );
            prop_assert_eq!(read.entity_location, place(ours.kinematics.location));
        }
        (Body::RemoveEntity(ours), PduBody::RemoveEntity(read)) => {
            prop_assert_eq!(read.originating_id, theirs(ours.originating));
            prop_assert_eq!(read.receiving_id, theirs(ours.receiving));
            prop_assert_eq!(read.request_id, ours.request);
        }
        _ => return Err(TestCaseError::fail("another type of pdu")),
    }
    Ok(())
}

proptest! {
    #[test]
    fn another_codec_reads_what_is_written(
        bodies in prop::collection::vec(body(), 1..5), exercise: u8, stamp: u32,
    ) {
        let pdus: Vec<_> = bodies.into_iter().map(|body| {
            let mut header = Header::new(exercise, Timestamp(stamp));
            // Updates and removals have no status of version 7 that both codecs have.
            header.version = if matches!(body, Body::EntityState(_)) { 7 } else { 6 };
            Pdu { header, body }
        }).collect();
        for pdu in &pdus {
            let mut bytes = vec![0; pdu.encoded_len()];
            prop_assert_eq!(pdu.encode(&mut bytes), Ok(bytes.len()));
            let read = dis_rs::parse(&bytes);
            let read = read.map_err(|error| TestCaseError::fail(error.to_string()))?;
            prop_assert_eq!(read.len(), 1);
            check(pdu, &read[0])?;
        }
    }

    #[test]
    fn what_another_codec_writes_is_read(body in body(), exercise: u8, stamp: u32) {
        let header = Header::new(exercise, Timestamp(stamp));
        let pdu = Pdu { header, body };
        let mut bytes = vec![0; pdu.encoded_len()];
        prop_assert_eq!(pdu.encode(&mut bytes), Ok(bytes.len()));
        let read = dis_rs::parse(&bytes).map_err(|error| TestCaseError::fail(error.to_string()))?;
        let [TheirPdu { header, body }] = <[TheirPdu; 1]>::try_from(read).expect("one pdu");
        let again = TheirPdu::finalize_from_parts(header, body, Stamp::new(stamp));
        let mut written = BytesMut::with_capacity(300);
        again.serialize(&mut written).map_err(|error| TestCaseError::fail(error.to_string()))?;
        let ours: Vec<_> = Bundle::new(&written).collect();
        prop_assert_eq!(ours.len(), 1);
        let (_, ours) = ours[0].map_err(|error| TestCaseError::fail(error.to_string()))?;
        check(&ours, &again)?;
    }
}
