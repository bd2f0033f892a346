//! Access by tokens, as an operator sets it up.
//!
//! Each test makes its keys by the binary in a folder of its own.

use std::fs;
use std::path::PathBuf;

use pasetors::keys::AsymmetricSecretKey;
use pasetors::version4::{PublicToken, V4};
use rhumb_client::scene::{BodyDesc, Command, CommandError, SceneConfig, Shape};
use rhumb_client::{
    BodyId, Client, ClientError, CloseCode, Denial, Ending, Event, JoinMode, JoinOptions,
    OpenError, PipelineDepth, Trust,
};
use rhumb_tests::ServerProcess;

use crate::SERVER;

const ANYWHERE: &str = "127.0.0.1:0";

/// A server that asks for tokens, and the key that signs them.
pub(crate) struct Guarded {
    pub(crate) server: ServerProcess,
    pub(crate) folder: PathBuf,
}

impl Guarded {
    pub(crate) fn start(name: &str) -> Self {
        Self::start_with(name, "")
    }

    /// With the lines of a configuration.
    fn start_with(name: &str, settings: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("rhumb-{name}-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("a folder for keys");
        let guarded = make_key(&folder, "key");
        let config = folder.join("rhumb.toml").display().to_string();
        fs::write(&config, settings).expect("it can be written");
        let flags = ["--token-key", &guarded, "--config", &config];
        let server = SERVER.serve_with(ANYWHERE, &flags);
        Self { server, folder }
    }

    /// A token of this server, with more arguments.
    pub(crate) fn token(&self, client: &str, scene: &str, role: &str, more: &[&str]) -> String {
        let key = self.folder.join("key").display().to_string();
        token(&key, client, scene, role, more)
    }

    fn join(&self, token: Option<&str>, scene: &str) -> Result<Client, OpenError> {
        self.join_with(token, scene, JoinOptions::default())
    }

    fn join_with(
        &self,
        token: Option<&str>,
        scene: &str,
        options: JoinOptions,
    ) -> Result<Client, OpenError> {
        let trust = Trust::Fingerprint(self.server.fingerprint);
        let mut connection = Client::connect(&self.server.address.to_string(), trust)?;
        if let Some(token) = token {
            connection = connection.token(token);
        }
        connection.join_with(scene, options)
    }
}

impl Drop for Guarded {
    fn drop(&mut self) {
        // The rest of it lies in a folder of temporary files.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Makes a key pair, and returns the public key's path.
pub(crate) fn make_key(folder: &std::path::Path, name: &str) -> String {
    let key = folder.join(name).display().to_string();
    let made = SERVER.run(&["token", "--new-key", &key]);
    assert_eq!(made.code, Some(0), "{}", made.log);
    format!("{key}.pub")
}

pub(crate) fn token(key: &str, client: &str, scene: &str, role: &str, more: &[&str]) -> String {
    let plain = [
        "token", "--key", key, "--client", client, "--scene", scene, "--role", role,
    ];
    let made = SERVER.run(&[&plain, more].concat());
    assert_eq!(made.code, Some(0), "{}", made.log);
    made.out.trim().to_owned()
}

pub(crate) fn close_code(refused: Result<Client, OpenError>) -> CloseCode {
    match refused {
        Err(OpenError::Client(ClientError::Ended(Ending::Closed(code)))) => CloseCode(code),
        Err(other) => panic!("another error: {other}"),
        Ok(_) => panic!("the client was admitted"),
    }
}

fn joins_only() -> JoinOptions {
    JoinOptions {
        mode: JoinMode::Join,
        ..JoinOptions::default()
    }
}

/// The answer to a command: `None` if it was applied.
pub(crate) fn answer(client: &mut Client, command: Command) -> Option<CommandError> {
    let asked = client.command(command).expect("the connection is open");
    client.flush();
    loop {
        client.inspect().expect("the server answers");
        while let Some((_, event)) = client.poll_event() {
            match event {
                Event::Refused { number, error } if number == asked => return Some(error),
                Event::Applied { through, .. } if through >= asked => return None,
                _ => {}
            }
        }
    }
}

fn push(id: BodyId) -> Command {
    Command::Impulse {
        id,
        impulse: glam::Vec3::X,
    }
}

#[test]
fn a_token_is_checked_as_a_server_checks_it() {
    let folder = tempfile::tempdir().expect("a directory");
    let (public, other) = (
        make_key(folder.path(), "key"),
        make_key(folder.path(), "other"),
    );
    let secret = public.strip_suffix(".pub").expect("it ends so");
    let made = token(secret, "anna", "team/*", "owner", &["--bodies", "5"]);
    let check = |key: &str, more: &[&str]| {
        let plain = ["token", "--check", &made, "--key", key];
        SERVER.run(&[&plain, more].concat())
    };
    let good = check(&public, &["--scene", "team/a"]);
    assert_eq!(good.code, Some(0), "{}", good.log);
    for line in [
        "client anna",
        "role owner",
        "scenes team/*",
        "bodies 5",
        "valid",
    ] {
        assert!(
            good.out.lines().any(|have| have == line),
            "{line} in {}",
            good.out
        );
    }
    for (key, more, said) in [
        (
            &public,
            &["--scene", "pit"][..],
            "claim scenes does not name the scene pit",
        ),
        (&public, &["--audience", "other"], "claim aud is \"rhumb\""),
        (&other, &[], "no token that the key has signed"),
    ] {
        let refused = check(key, more);
        assert_eq!(refused.code, Some(1), "{}", refused.out);
        assert!(refused.log.contains(said), "{said} in {}", refused.log);
    }
}

#[test]
fn a_server_without_keys_starts_only_with_a_flag_that_opens_it() {
    for (arguments, named) in [
        (&["--listen", ANYWHERE][..], "--open"),
        (&["--open", "--listen", "0.0.0.0:0"], "--open-to-network"),
        (
            &["--listen", ANYWHERE, "--token-key", "no/such.pub"],
            "no/such.pub",
        ),
    ] {
        let ended = SERVER.run(arguments);
        assert_eq!(ended.code, Some(1), "{arguments:?}: {}", ended.log);
        assert_eq!(ended.log.lines().count(), 1, "{}", ended.log);
        assert!(ended.log.contains(named), "{}", ended.log);
    }
}

#[test]
fn a_client_needs_a_token_of_this_server_for_this_scene() {
    let guarded = Guarded::start("scene");
    let token_of = |scene| guarded.token("anna", scene, "owner", &[]);
    let mut client = guarded.join(Some(&token_of("pit")), "pit").unwrap();
    client.advance(PipelineDepth::LOCKSTEP).unwrap();
    assert!(guarded.join(Some(&token_of("team/*")), "team/7").is_ok());
    for (token, code) in [
        (None, CloseCode::TOKEN_MISSING),
        (Some("v4.public.AAAA".to_owned()), CloseCode::TOKEN_INVALID),
        (Some(token_of("pitch")), CloseCode::TOKEN_SCENE),
    ] {
        let refused = guarded.join(token.as_deref(), "pit");
        assert_eq!(close_code(refused), code);
    }
    // A key that the server does not have, and a token for another service of the same signer.
    make_key(&guarded.folder, "other");
    let key = |name: &str| guarded.folder.join(name).display().to_string();
    for stolen in [
        token(&key("other"), "anna", "pit", "owner", &[]),
        token(&key("key"), "anna", "pit", "owner", &["--audience", "shop"]),
    ] {
        let refused = guarded.join(Some(&stolen), "pit");
        assert_eq!(close_code(refused), CloseCode::TOKEN_INVALID);
    }
}

#[test]
fn a_tenant_has_its_part_of_the_scenes_and_leaves_the_rest_to_others() {
    let guarded = Guarded::start_with("tenants", "[limits]\nscenes = 8\ntenant_scenes = 2\n");
    let anna = guarded.token("anna", "team/*", "owner", &[]);
    let join = |token: &str, scene: &str| guarded.join(Some(token), scene);
    let full = |joined: Result<Client, OpenError>| {
        let denied = joined.err();
        let is_full = matches!(&denied, Some(OpenError::Denied { denial, .. }) if *denial == Denial::OverQuota);
        assert!(is_full, "{denied:?}");
    };
    let mut kept = vec![
        join(&anna, "team/1").unwrap(),
        join(&anna, "team/2").unwrap(),
    ];
    full(join(&anna, "team/3"));
    // Another client of the tenant shares its part, and its scenes are joined as before.
    let bert = guarded.token("bert", "team/*", "owner", &[]);
    full(join(&bert, "team/3"));
    kept.push(join(&bert, "team/1").unwrap());
    // Other tenants have parts of their own. Without a tenant, a client's scenes count for it.
    let carl = guarded.token("carl", "*", "owner", &[]);
    for scene in ["shop/1", "shop/2", "a", "b"] {
        kept.push(join(&carl, scene).unwrap());
    }
    full(join(&carl, "c"));
    let more = guarded.token("anna", "team/*", "owner", &["--tenant-scenes", "3"]);
    kept.push(join(&more, "team/3").unwrap());
    full(join(&more, "team/4"));
}

#[test]
fn a_stranger_deletes_no_scene_and_commands_no_body_of_others() {
    let guarded = Guarded::start("rights");
    let owner = guarded.token("olga", "pit", "owner", &[]);
    let mut owner = guarded.join(Some(&owner), "pit").unwrap();
    let watcher = guarded.token("walt", "*", "observer", &[]);
    let anna = guarded.token("anna", "pit", "controller", &[]);
    let bert = guarded.token("bert", "pit", "controller", &["--bodies", "1"]);
    let mut watcher_client = guarded.join(Some(&watcher), "pit").unwrap();
    let mut anna = guarded.join_with(Some(&anna), "pit", joins_only()).unwrap();
    let mut bert = guarded.join_with(Some(&bert), "pit", joins_only()).unwrap();
    let ball = || BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 5.0, 0.0);
    let hers = anna.add_body(ball()).unwrap();
    let his = bert.add_body(ball()).unwrap();
    assert_eq!(answer(&mut anna, push(hers)), None);
    assert_eq!(answer(&mut bert, push(his)), None);
    let not_allowed = Some(CommandError::NotAllowed);
    assert_eq!(answer(&mut bert, push(hers)), not_allowed);
    assert_eq!(answer(&mut watcher_client, push(hers)), not_allowed);
    let gravity = Command::SetGravity {
        gravity: glam::Vec3::ZERO,
    };
    assert_eq!(answer(&mut anna, gravity.clone()), not_allowed);
    assert_eq!(answer(&mut owner, gravity), None);
    assert_eq!(answer(&mut owner, push(hers)), None);
    // The token allows one body.
    let second = bert.new_ids(1).unwrap()[0];
    let shape = bert
        .replica()
        .and_then(|replica| replica.body(his))
        .unwrap()
        .shape;
    let add = Command::AddBody {
        desc: ball().desc(second, shape),
        motion: ball().state().unwrap(),
    };
    assert_eq!(answer(&mut bert, add), Some(CommandError::OverQuota));
    for denied in [anna.delete(), watcher_client.delete()] {
        assert!(matches!(
            denied,
            Err(ClientError::Denied(Denial::NotAllowed))
        ));
    }
    let advanced = watcher_client_advances(&guarded, &watcher);
    assert!(matches!(
        advanced,
        Err(ClientError::Denied(Denial::AdvanceNotAllowed))
    ));
    owner.delete().expect("an owner deletes the scene");
    // A scene that does not exist is created by owners only.
    let options = JoinOptions {
        mode: JoinMode::Create(SceneConfig::default()),
        ..JoinOptions::default()
    };
    let created = guarded.join_with(Some(&watcher), "new", options);
    assert!(matches!(
        created,
        Err(OpenError::Denied {
            denial: Denial::NotAllowed,
            ..
        })
    ));
}

fn watcher_client_advances(guarded: &Guarded, token: &str) -> Result<(), ClientError> {
    let mut client = guarded
        .join_with(Some(token), "pit", joins_only())
        .expect("an observer joins");
    client.advance(PipelineDepth::LOCKSTEP).map(|_| ())
}

#[test]
fn an_expired_token_admits_no_client() {
    let guarded = Guarded::start("expired");
    let key = fs::read_to_string(guarded.folder.join("key")).expect("the key is a file");
    let key = AsymmetricSecretKey::<V4>::try_from(key.trim()).expect("it is a PASERK");
    // As another service signs it, by the claims of PROTOCOL 3.6.
    let token = |expires: &str| {
        let claims = format!(
            r#"{{"aud":"rhumb","sub":"anna","exp":"{expires}","scenes":["pit"],"role":"owner"}}"#
        );
        let signed = PublicToken::sign(&key, claims.as_bytes(), None, None);
        signed.expect("it can be signed")
    };
    assert!(
        guarded
            .join(Some(&token("2999-01-01T00:00:00Z")), "pit")
            .is_ok()
    );
    let refused = guarded.join(Some(&token("2026-01-01T00:00:00Z")), "pit");
    assert_eq!(close_code(refused), CloseCode::TOKEN_EXPIRED);
    let unsigned = token("2999-01-01T00:00:00Z").replace("v4.public.", "v4.public.A");
    let refused = guarded.join(Some(&unsigned), "pit");
    assert_eq!(close_code(refused), CloseCode::TOKEN_INVALID);
}
