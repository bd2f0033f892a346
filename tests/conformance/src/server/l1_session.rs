//! L1.1: how sessions begin.

use rhumb_protocol::message::{
    ClientMessage, Extension, Extensions, Role, ServerMessage, StreamChoice,
};
use rhumb_protocol::session::CloseCode;

use super::scenery::lockstep;
use crate::case::Case;
use crate::outcome::{CaseResult, ensure};
use crate::peer::RawClient;
use crate::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    vec![
        Case::server(
            "L1.1.1",
            "a hello is answered by a welcome with an offered version",
        )
        .cites("PROTOCOL 3.1-4, 3.1-7")
        .play(|trial| {
            let welcome = trial.client()?.hello()?;
            ensure(welcome.version == 1, "version 1 was offered")?;
            ensure(welcome.scene.is_none(), "the scene does not exist yet")
        }),
        Case::server(
            "L1.1.2",
            "a client that offers only future versions is closed with code 3",
        )
        .cites("PROTOCOL 3.1-5, 3.5-2")
        .play(|trial| {
            let mut client = trial.client()?;
            offer(&mut client, &[0x7777, 2], Extensions::NONE);
            client.must_be_closed(CloseCode::VERSION)
        }),
        Case::server(
            "L1.1.3",
            "a client that offers only greased versions is closed with code 3",
        )
        .cites("PROTOCOL 3.5-18, 3.5-16")
        .play(|trial| {
            let mut client = trial.client()?;
            offer(&mut client, &[0x0a0a, 0xfafa], Extensions::NONE);
            client.must_be_closed(CloseCode::VERSION)
        }),
        Case::server("L1.1.4", "an unknown critical extension closes with code 5")
            .cites("PROTOCOL 3.5-4, 3.5-13")
            .play(|trial| {
                let mut client = trial.client()?;
                offer(&mut client, &[1], extension(62));
                client.must_be_closed(CloseCode::EXTENSION)
            }),
        Case::server("L1.1.5", "an unknown optional extension is skipped")
            .cites("PROTOCOL 3.5-4, 3.5-11, 3.5-16")
            .play(|trial| {
                let mut client = trial.client()?;
                offer(&mut client, &[1], extension(27));
                welcomed(&mut client)
            }),
        Case::server(
            "L1.1.6",
            "a member's message from a client that has not joined closes with code 2",
        )
        .cites("PROTOCOL 3.2-1")
        .play(too_early),
        Case::server(
            "L1.1.7",
            "an open server makes a client with an invalid token its owner; other servers refuse it",
        )
            .cites("PROTOCOL 3.6-3")
            .play(role_for_token),
    ]
}

fn role_for_token(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    offer(&mut client, &[1], extension(Extension::TOKEN));
    if client.token.is_some() {
        return client.must_be_closed(CloseCode::TOKEN_INVALID);
    }
    let role = client.await_message("welcome", |message| match message {
        ServerMessage::Welcome(welcome) => Some(
            welcome
                .extensions
                .value(Extension::TOKEN)
                .map(<[u8]>::to_vec),
        ),
        _ => None,
    })?;
    let owner = vec![Role::Owner.code()];
    ensure(role == Some(owner), "an open server makes owners")
}

fn offer(client: &mut RawClient, versions: &[u16], extensions: Extensions) {
    let scene = client.scene.clone();
    client.send(&ClientMessage::Hello {
        versions: versions.to_vec(),
        scene,
        extensions,
    });
}

fn extension(id: u32) -> Extensions {
    let mut extensions = Extensions::NONE;
    let value = vec![1, 2, 3];
    assert!(
        extensions.insert(Extension { id, value }),
        "one short value fits"
    );
    extensions
}

fn welcomed(client: &mut RawClient) -> CaseResult {
    client.await_message("welcome", |message| {
        matches!(message, ServerMessage::Welcome(_)).then_some(())
    })
}

fn too_early(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    client.hello()?;
    client.create(lockstep())?;
    client.send(&ClientMessage::Subscribe(StreamChoice::Full));
    client.must_be_closed(CloseCode::VIOLATION)
}
