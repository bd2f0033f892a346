//! A scene that its owner feeds: its steps, requests, a silent owner.
//!
//! A command of the owner acts as in any scene; one of another member is a request to the owner, but for shapes, which move
//! nothing. Invariants: a step waits for the owner's commands that come before its states; a request changes nothing until
//! the owner has accepted it.

use rhumb_protocol::message::{SceneEvent, ServerMessage};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, CommandError};
use rhumb_protocol::{Instant, Peer};

use super::RunningScene;
use crate::clients::Clients;
use crate::feed::{FedAnswer, FedRequest, FedScene};
use crate::load;
use crate::scene::Scene;

/// How a scene takes a command of a member.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Treatment {
    /// It acts.
    Applied,
    /// The owner decides.
    Requested,
    /// Nothing in a fed scene could carry it out.
    Unsupported,
}

/// How a fed scene takes a command of its owner, or of another member.
const fn treatment(command: &Command, is_owner: bool) -> Treatment {
    match command {
        Command::AddShape { .. } | Command::RemoveShape { .. } => Treatment::Applied,
        Command::SetEvents { .. }
        | Command::SetLocomotion { .. }
        | Command::Jump { .. }
        | Command::SetWheels { .. } => Treatment::Unsupported,
        Command::AddBody { .. }
        | Command::RemoveBody { .. }
        | Command::ChangeBody { .. }
        | Command::AddJoint { .. }
        | Command::ChangeJoint { .. }
        | Command::RemoveJoint { .. }
        | Command::SetGravity { .. }
        | Command::SetPose { .. }
        | Command::Sleep { .. } => match is_owner {
            true => Treatment::Applied,
            false => Treatment::Requested,
        },
        // The owner moves its bodies by what it feeds.
        Command::SetVelocity { .. }
        | Command::Force { .. }
        | Command::Torque { .. }
        | Command::Impulse { .. }
        | Command::TorqueImpulse { .. }
        | Command::ForceAt { .. }
        | Command::ImpulseAt { .. }
        | Command::Wake { .. } => match is_owner {
            true => Treatment::Unsupported,
            false => Treatment::Requested,
        },
    }
}

/// True if the scene changes by a command once its owner accepts it; the others move a body, which the owner does.
const fn changes_scene(command: &Command) -> bool {
    matches!(
        command,
        Command::AddBody { .. }
            | Command::RemoveBody { .. }
            | Command::ChangeBody { .. }
            | Command::AddJoint { .. }
            | Command::ChangeJoint { .. }
            | Command::RemoveJoint { .. }
            | Command::SetGravity { .. }
    )
}

/// Checks what can be known of a request before the owner sees it.
fn check_request(command: &Command, scene: &Scene) -> Result<(), CommandError> {
    command.check().map_err(CommandError::Invalid)?;
    match (command, command.body()) {
        (Command::AddBody { .. }, _) | (_, None) => Ok(()),
        (_, Some(id)) if scene.body(id).is_some() => Ok(()),
        (_, Some(id)) => Err(CommandError::UnknownBody(id)),
    }
}

fn can_move(body: &BodyDesc) -> bool {
    body.enabled && body.kind != BodyKind::Fixed
}

impl RunningScene {
    /// Hands a command to the owner; false if it is to be applied as in any scene.
    pub(super) fn request_of_owner(
        &self,
        (peer, number): (Peer, u64),
        command: &Command,
        clients: &Clients,
    ) -> Result<bool, CommandError> {
        let Some(fed) = &self.fed else {
            return Ok(false);
        };
        match treatment(command, peer == fed.owner()) {
            Treatment::Applied => Ok(false),
            Treatment::Unsupported => Err(CommandError::Unsupported),
            Treatment::Requested => {
                check_request(command, &self.scene)?;
                let client = clients.name(peer).cloned();
                let session = clients.member(peer).and_then(|member| member.session);
                let request = FedRequest::new(client, peer, (number, command.clone()));
                let request = request.of_session(session);
                let retry_seconds = load::RETRY_SECONDS;
                match fed.request(request) {
                    true => Ok(true),
                    false => Err(CommandError::Overloaded { retry_seconds }),
                }
            }
        }
    }

    /// Carries out the owner's answers, and notes its silence or its return; true if a step is due.
    pub(super) fn begin_fed_turn(&mut self, now: Instant, clients: &mut Clients) -> bool {
        let answers = self.fed.as_ref().map(FedScene::take_answers);
        for answer in answers.into_iter().flatten() {
            match answer {
                FedAnswer::Refused(request, error) => self.refuse_request(&request, error, clients),
                FedAnswer::Accepted(request) => {
                    if let Err(error) = self.apply_accepted(&request, clients) {
                        self.refuse_request(&request, error, clients);
                        if let Some(fed) = &self.fed {
                            fed.fail(request, error);
                        }
                    }
                }
            }
        }
        let is_due = self.fed.as_ref().is_some_and(FedScene::is_due);
        for event in self.note_owner(now, is_due) {
            self.record_event(event);
        }
        self.answer_pending(clients);
        is_due
    }

    fn apply_accepted(
        &mut self,
        request: &FedRequest,
        clients: &mut Clients,
    ) -> Result<(), CommandError> {
        if !changes_scene(&request.command) {
            return Ok(());
        }
        // The member may have left since it asked, and others may have what it asked for.
        let member = self.member_of(request).ok_or(CommandError::NotAllowed)?;
        let rights = self.rights_of(member, clients);
        rights
            .ok_or(CommandError::NotAllowed)?
            .command(&request.command)?;
        self.apply_and_announce(&request.command, clients)?;
        (self.ownership).note(request.client.as_ref(), &request.command);
        Ok(())
    }

    /// The present connection of the member that made a request; `None` while its session has none. A connection without a
    /// session may have ended.
    fn member_of(&self, request: &FedRequest) -> Option<Peer> {
        let session = request.session;
        session.map_or(Some(request.member), |session| {
            self.sessions.member_of(session)
        })
    }

    /// Refuses a request: at once, or when its member comes back.
    fn refuse_request(&mut self, request: &FedRequest, error: CommandError, clients: &mut Clients) {
        let number = request.number;
        let member = self.member_of(request);
        if let Some(member) = member.filter(|member| clients.member(*member).is_some()) {
            return clients.send(member, &ServerMessage::Refused { number, error });
        }
        let sessions = &self.sessions;
        if let (Some(fed), Some(session)) = (&mut self.fed, request.session) {
            fed.keep_refusal(session, (number, error));
            fed.keep_sessions(|session| sessions.get(session).is_some());
        }
    }

    /// Sends a member that came back the refusals that it has not received.
    pub(super) fn repeat_fed_refusals(&mut self, peer: Peer, clients: &mut Clients) {
        let session = clients.member(peer).and_then(|member| member.session);
        if let (Some(fed), Some(session)) = (&mut self.fed, session) {
            for (number, error) in fed.take_refusals(session) {
                clients.send(peer, &ServerMessage::Refused { number, error });
            }
        }
    }

    /// The scene events of an owner that became silent, or is active again.
    fn note_owner(&mut self, now: Instant, is_due: bool) -> Vec<SceneEvent> {
        let tick = self.scene.tick().next();
        let stepping = self.config().stepping;
        let Some(fed) = &mut self.fed else {
            return Vec::new();
        };
        if is_due {
            return fed.note_active(now, tick);
        }
        if !fed.is_overdue(now, stepping) {
            return Vec::new();
        }
        tracing::warn!(%tick, "the owner of a fed scene is silent: its bodies are where they were");
        let bodies = self.scene.bodies().filter(|body| can_move(body));
        fed.note_silent(tick, bodies.map(|body| body.id).collect())
    }

    /// Informs members of a body that comes while the owner is silent.
    pub(super) fn announce_silence(&mut self, body: &BodyDesc) {
        let fed = self.fed.as_mut().filter(|_| can_move(body));
        if let Some(event) = fed.and_then(|fed| fed.include(body.id)) {
            self.record_event(event);
        }
    }
}
