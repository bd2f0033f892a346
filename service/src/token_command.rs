//! `rhumb-server token`: makes keys and tokens, and checks tokens.

use std::error::Error;
use std::io::Write;
use std::path::PathBuf;

use clap::Args;
use clap::builder::NonEmptyStringValueParser;
use rhumb_protocol::message::Token;

use crate::access::{Claims, DEFAULT_AUDIENCE, KeyFile, TokenKeys, make_keys, role_of, sign};

/// The token to make, or the key.
#[derive(Debug, Args)]
pub(crate) struct TokenArguments {
    /// Makes a key pair instead: the secret key in this new file, the public key in the same name with `.pub`. If only the
    /// secret key is there, as after a crash, its public key is written.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["check", "key", "client", "scene", "role"])]
    new_key: Option<PathBuf>,
    /// Checks this token instead, as a server with the public key of --key and this audience would, for the scene if one is
    /// named: prints its claims, or says which of them is wrong and ends with code 1.
    #[arg(long, value_name = "TOKEN", conflicts_with_all = ["client", "role"], value_parser = NonEmptyStringValueParser::new())]
    check: Option<String>,
    /// File with the secret key that signs, or to check with the public key.
    #[arg(long, value_name = "FILE", required_unless_present = "new_key")]
    key: Option<PathBuf>,
    /// Name of the client; it owns the bodies that it adds.
    #[arg(long, required_unless_present_any = ["new_key", "check"], value_parser = NonEmptyStringValueParser::new())]
    client: Option<String>,
    /// Name of a scene, or the beginning of names and a `*`; may be repeated.
    #[arg(long, required_unless_present_any = ["new_key", "check"], value_parser = pattern)]
    scene: Vec<String>,
    /// Its role: observer, controller or owner.
    #[arg(long, required_unless_present_any = ["new_key", "check"], value_parser = role)]
    role: Option<String>,
    /// Hours until it expires.
    #[arg(long, default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..=87_600))]
    hours: u32,
    /// The servers that it is for: their `--audience`.
    #[arg(long, default_value = DEFAULT_AUDIENCE, value_parser = NonEmptyStringValueParser::new())]
    audience: String,
    /// Most bodies of the client in a scene.
    #[arg(long)]
    bodies: Option<u32>,
    /// Most commands in a second.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    commands: Option<u32>,
    /// Most ticks in a second, times substeps, times the client's bodies in a scene.
    #[arg(long)]
    load: Option<u64>,
    /// Most members of the client in a scene.
    #[arg(long)]
    members: Option<u32>,
    /// Most scenes of the client's tenant, in place of the server's own limit.
    #[arg(long)]
    tenant_scenes: Option<u32>,
}

/// Prints a token, or the name of the public key's file.
pub(crate) fn run(arguments: &TokenArguments, now: i64) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    if let Some(path) = &arguments.new_key {
        let pair = make_keys(path)?;
        let (secret, public) = (path.display(), pair.public.display());
        if pair.was_completed {
            eprintln!("warning: {secret} was there without its public key, which is written now");
        }
        writeln!(out, "secret key {secret}\npublic key {public}")?;
        return Ok(());
    }
    let key = arguments.key.clone().unwrap_or_default();
    if let Some(token) = &arguments.check {
        let file = KeyFile::for_all_scenes(key);
        let keys = TokenKeys::read(&[file], &arguments.audience)?;
        write!(out, "{}", checked(&keys, token, arguments, now)?)?;
        return Ok(());
    }
    let expires = now.saturating_add(i64::from(arguments.hours) * 3_600);
    let claims = Claims {
        aud: arguments.audience.clone(),
        sub: arguments.client.clone().unwrap_or_default(),
        exp: Claims::moment(expires).ok_or("the token would expire too late")?,
        nbf: None,
        scenes: arguments.scene.clone(),
        role: arguments.role.clone().unwrap_or_default(),
        bodies: arguments.bodies,
        commands: arguments.commands,
        load: arguments.load,
        members: arguments.members,
        tenant_scenes: arguments.tenant_scenes,
    };
    for pattern in arguments
        .scene
        .iter()
        .filter(|pattern| crosses_tenants(pattern))
    {
        eprintln!(
            "warning: {pattern} also names scenes of other tenants that begin so; a pattern of one tenant ends in /*"
        );
    }
    let token = sign(&key, &claims)?;
    // A client could not show a longer one.
    let token: Token = token.parse()?;
    writeln!(out, "{}", token.as_str())?;
    Ok(())
}

/// The claims of a token, if a server would accept it.
fn checked(
    keys: &TokenKeys,
    token: &str,
    arguments: &TokenArguments,
    now: i64,
) -> Result<String, Box<dyn Error>> {
    let claims = keys.verify(token.trim().as_bytes())?.claims;
    let left = claims.seconds_left(&arguments.audience, now)?;
    for scene in &arguments.scene {
        claims.permit(&arguments.audience, &scene.parse()?, now)?;
    }
    let mut lines = vec![
        format!("client {}", claims.sub),
        format!("role {}", claims.role),
        format!("scenes {}", claims.scenes.join(" ")),
        format!("audience {}", claims.aud),
        format!("expires {}, in {} minutes", claims.exp, left / 60),
    ];
    let quotas = [
        ("bodies", claims.bodies.map(u64::from)),
        ("commands", claims.commands.map(u64::from)),
        ("load", claims.load),
        ("members", claims.members.map(u64::from)),
        ("tenant_scenes", claims.tenant_scenes.map(u64::from)),
    ];
    lines.extend(
        quotas
            .iter()
            .filter_map(|(name, most)| Some(format!("{name} {}", (*most)?))),
    );
    lines.push("valid".to_owned());
    Ok(lines.join("\n") + "\n")
}

/// True for the beginning of a tenant's name: other tenants' names may begin so, too.
fn crosses_tenants(pattern: &str) -> bool {
    let beginning = pattern.strip_suffix('*');
    beginning.is_some_and(|beginning| !beginning.is_empty() && !beginning.contains('/'))
}

fn pattern(text: &str) -> Result<String, &'static str> {
    let known = Claims::is_pattern(text);
    known
        .then(|| text.to_owned())
        .ok_or("a scene's name has letters, digits, - _ . /, and may end in *")
}

fn role(text: &str) -> Result<String, &'static str> {
    let known = role_of(text).is_some();
    known
        .then(|| text.to_owned())
        .ok_or("a role is observer, controller or owner")
}
