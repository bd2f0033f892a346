//! What members do with the bodies that they drive.

use rhumb_protocol::Peer;
use rhumb_protocol::message::{Drive, DriveError, Driving, ServerMessage};
use rhumb_protocol::scene::{BodyKind, Command, CommandError, Pace};
use rhumb_protocol::session::Driven;
use rhumb_reckoning::BodyId;

use super::Room;
use crate::drives::DriveStatistics;
use crate::member::Wish;
use crate::outbox::Outbox;
use crate::placing;

impl Room {
    /// A member wants to drive bodies in place of those that it drove before.
    pub(crate) fn drive(&mut self, peer: Peer, drive: Drive, out: &mut Outbox) {
        self.wish(peer, Wish::Drive(drive), out);
    }

    /// A member says on the control stream how its bodies move: before the steps that it asks for behind it.
    pub(crate) fn upstream(&mut self, peer: Peer, packet: Vec<u8>, out: &mut Outbox) {
        if self.terms().pace == Pace::Lockstep {
            self.wish(peer, Wish::Upstream(packet), out);
        }
    }

    /// The same by a datagram. Where members lead, what came at another moment in another run would be another truth.
    pub(crate) fn upstream_datagram(&mut self, peer: Peer, datagram: &[u8], out: &mut Outbox) {
        if self.terms().pace == Pace::FreeRunning {
            self.hear_driver(peer, datagram, out);
        }
    }

    pub(super) fn hear_driver(&mut self, peer: Peer, packet: &[u8], out: &mut Outbox) {
        if !self.drives.hear(peer, packet, self.scene.tick()) {
            self.drives.end(peer);
            tracing::debug!(peer = peer.0, "lost touch with a driver");
            out.say(peer, &ServerMessage::NotDriving(DriveError::LostTouch));
        }
    }

    pub(super) fn grant_drive(&mut self, peer: Peer, drive: &Drive, out: &mut Outbox) {
        // Who is told where a body begins must have heard that there is one.
        self.tell_notices(out);
        let answer = match self.begin_drive(peer, drive) {
            Ok(driving) => ServerMessage::Driving(driving),
            Err(error) => {
                tracing::debug!(peer = peer.0, %error, "may not drive");
                ServerMessage::NotDriving(error)
            }
        };
        out.say(peer, &answer);
    }

    fn begin_drive(&mut self, peer: Peer, drive: &Drive) -> Result<Driving, DriveError> {
        if self.faulted {
            return Err(DriveError::SceneFaulted);
        }
        let mut bodies = Vec::with_capacity(drive.bodies.len());
        for id in &drive.bodies {
            self.may_drive(peer, *id)?;
            let now = self.scene.observation(*id);
            let motion = now.ok_or(DriveError::UnknownBody(*id))?.motion;
            bodies.push((*id, motion));
        }
        let stream = self.new_stream();
        let driving = Driving {
            stream,
            tick: self.scene.tick(),
            bodies,
        };
        let scene = &self.scene;
        let integrator = scene.terms().integrator;
        let manner = |id| placing::manner(scene, id);
        let driven = Driven::new(&driving, drive.tolerance, integrator, manner);
        self.drives.begin(peer, driven);
        for (id, motion) in &driving.bodies {
            // What was commanded before and is not done yet is over.
            let pose = motion.motion().pose();
            let stands = self.scene.apply(&Command::SetPose {
                id: *id,
                position: pose.position.as_vec3(),
                rotation: pose.rotation.as_quat(),
            });
            debug_assert!(stands.is_ok(), "a body may be where it is");
        }
        let bodies = driving.bodies.len();
        tracing::debug!(peer = peer.0, bodies, stream = %stream, "drives from now on");
        Ok(driving)
    }

    fn may_drive(&self, peer: Peer, id: BodyId) -> Result<(), DriveError> {
        let terms = self.scene.body(id).ok_or(DriveError::UnknownBody(id))?;
        if terms.kind != BodyKind::Kinematic {
            return Err(DriveError::NotKinematic(id));
        }
        if self.grants.holder(id).is_some_and(|holder| holder != peer) {
            return Err(DriveError::NotYours(id));
        }
        if self.drives.driver(id).is_some_and(|driver| driver != peer) {
            return Err(DriveError::DrivenByAnother(id));
        }
        Ok(())
    }

    /// Who drives a body alone says where it is.
    pub(super) fn refuse_steering(&self, command: &Command) -> Result<(), CommandError> {
        match *command {
            Command::SetPose { id, .. } | Command::SetVelocity { id, .. }
                if self.drives.driver(id).is_some() =>
            {
                Err(CommandError::Driven(id))
            }
            _ => Ok(()),
        }
    }

    pub(crate) fn drive_statistics(&self) -> impl Iterator<Item = DriveStatistics> {
        self.drives.statistics(self.scene.tick())
    }
}
