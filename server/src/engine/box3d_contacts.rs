//! Contacts of a Box3D body after a step.
//!
//! Box3D reports pairs of shapes, and a contact is one of bodies: of several the deepest counts, and their forces add up.
//! Points that are still apart and bear nothing are no contact.

use glam::Vec3;
use rhumb_protocol::scene::Contact;
use rhumb_reckoning::BodyId;

use super::box3d_native::{NativeShape, Touching};

/// Adds one contact for each body that touches this one, in the order of ids.
///
/// `centre`: the body's centre of mass, world frame. `dt`: length of a step, seconds. `owner`: the body of a shape.
pub(super) fn contacts(
    pairs: &[Touching],
    (of, centre): (BodyId, Vec3),
    dt: f32,
    owner: impl Fn(NativeShape) -> Option<BodyId>,
    out: &mut Vec<Contact>,
) {
    let mut found = Vec::new();
    for pair in pairs {
        let [first, second] = pair.shapes.map(&owner);
        let (Some(first), Some(second)) = (first, second) else {
            continue;
        };
        let [on_first, on_second] = pair.anchors;
        let (with, anchor, normal) = if first == of {
            (second, on_first, -pair.normal)
        } else {
            (first, on_second, pair.normal)
        };
        let contact = Contact {
            with,
            point: centre + anchor,
            normal,
            separation: pair.separation,
            force: pair.impulse / dt,
        };
        let touches = contact.force > 0.0 || contact.separation <= 0.0;
        if touches && is_finite(&contact) {
            found.push(contact);
        }
    }
    found.sort_by(|a, b| (a.with.cmp(&b.with)).then(a.separation.total_cmp(&b.separation)));
    let before = out.len();
    for contact in found {
        match out[before..].last_mut() {
            Some(deepest) if deepest.with == contact.with => deepest.force += contact.force,
            _ => out.push(contact),
        }
    }
}

fn is_finite(contact: &Contact) -> bool {
    let numbers = contact.force.is_finite() && contact.separation.is_finite();
    numbers && contact.point.is_finite() && contact.normal.is_finite()
}
