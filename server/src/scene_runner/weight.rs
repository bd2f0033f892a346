//! Weights of waiting messages.

use rhumb_protocol::message::ClientMessage;
use rhumb_protocol::scene::{Command, CommandError, Locomotion};

/// Weight of a waiting message beside its shape or packet.
pub(super) const MESSAGE_WEIGHT: usize = 64;

/// Weight of a waiting message: about its bytes in memory.
pub(super) fn weight(message: &Result<ClientMessage, CommandError>) -> usize {
    MESSAGE_WEIGHT
        + match message {
            Ok(ClientMessage::Command(Command::AddShape { shape, .. })) => shape.bytes(),
            Ok(ClientMessage::Command(Command::SetLocomotion { locomotion, .. })) => {
                size_of::<Locomotion>() + wheels_bytes(locomotion)
            }
            Ok(ClientMessage::Command(Command::SetWheels { inputs, .. })) => size_of_val(&**inputs),
            Ok(ClientMessage::Upstream(packet)) => packet.len(),
            Ok(ClientMessage::Query(queries)) => size_of_val(&**queries),
            _ => 0,
        }
}

fn wheels_bytes(locomotion: &Locomotion) -> usize {
    match locomotion {
        Locomotion::Vehicle(vehicle) => size_of_val(&*vehicle.wheels),
        Locomotion::None | Locomotion::Character(_) => 0,
    }
}
