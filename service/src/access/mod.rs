//! Access: which clients a server admits.
//!
//! The dispatcher verifies a client's token once, before its first message reaches a scene; no tick waits for that. Scenes
//! get the resulting permit.
//!
//! Keys of tokens are files: they sign and verify.

mod claims;

use std::fmt;
use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::{Arc, PoisonError, RwLock};

use pasetors::keys::{AsymmetricKeyPair, AsymmetricPublicKey, AsymmetricSecretKey, Generate};
use pasetors::paserk::FormatAsPaserk;
use pasetors::token::UntrustedToken;
use pasetors::version4::{PublicToken, V4};
use pasetors::{Public, errors};
use rhumb_protocol::Span;
use rhumb_protocol::scene::SceneName;
use rhumb_scene::Permit;

use self::claims::names;

pub(crate) use self::claims::{Claims, DEFAULT_AUDIENCE, TokenError, role_of};

/// Seconds since 1970, by the system's clock.
type WallClock = Arc<dyn Fn() -> i64 + Send + Sync>;

/// Decides which connections are admitted.
#[derive(Clone)]
pub(crate) enum Authenticator {
    /// Every client may do everything.
    Open,
    /// A client may do what its token says.
    Tokens { keys: TokenKeys, clock: WallClock },
}

/// The admission of one connection.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Admitted {
    pub(crate) permit: Arc<Permit>,
    /// For how long; `None` without an end.
    pub(crate) valid_for: Option<Span>,
}

#[cfg(feature = "app")]
impl Admitted {
    /// The admission of a gateway in this process.
    pub(crate) fn gateway() -> Self {
        Self {
            permit: Arc::new(Permit::GATEWAY),
            valid_for: None,
        }
    }
}

/// Longest validity that a timer holds: a hundred years.
const SECONDS_MAX: u64 = 100 * 366 * 86_400;

impl Authenticator {
    /// Admits a connection to a scene, or names the reason not to.
    pub(crate) fn admit(
        &self,
        token: Option<&[u8]>,
        scene: &SceneName,
    ) -> Result<Admitted, TokenError> {
        let Self::Tokens { keys, clock } = self else {
            return Ok(Admitted {
                permit: Arc::new(Permit::OPEN),
                valid_for: None,
            });
        };
        let token = token.ok_or(TokenError::Absent)?;
        let verified = keys.verify(token)?;
        let (permit, seconds) = verified.claims.permit(&keys.audience, scene, clock())?;
        verified.check_key(scene)?;
        let permit = verified.in_account(permit);
        Ok(Admitted {
            permit: Arc::new(permit),
            valid_for: Some(Span::from_millis(seconds.min(SECONDS_MAX) * 1_000)),
        })
    }
}

impl fmt::Debug for Authenticator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Open => "Authenticator::Open",
            Self::Tokens { .. } => "Authenticator::Tokens",
        })
    }
}

/// The keys whose tokens a server accepts, and the audience that a token must name. All clones have the same keys.
#[derive(Clone, Debug)]
pub struct TokenKeys {
    files: Arc<[KeyFile]>,
    /// Keys of the files, as they were read last.
    read: Arc<RwLock<Vec<ScopedKey>>>,
    /// Keys of this process.
    own: Vec<ScopedKey>,
    audience: String,
}

/// A file with a public key, and the scenes for which the key may sign.
///
/// Its text is the file's path, then for some scenes only `=` and their names, separated by commas. A name that ends in `*`
/// stands for all names that begin so: `team.pub=team/*,lobby`. The last `=` counts, so that a path that has one itself
/// needs names behind it: `a=b.pub=*`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyFile {
    path: PathBuf,
    scenes: KeyScenes,
}

/// The scenes for which a key signs.
#[derive(Clone, Debug, PartialEq, Eq)]
enum KeyScenes {
    All,
    /// The scenes of these patterns.
    Some(Arc<[String]>),
}

/// A text that is no [`KeyFile`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InvalidKeyFile {
    text: String,
    pattern: String,
}

#[derive(Clone, Debug)]
struct ScopedKey {
    key: AsymmetricPublicKey<V4>,
    scenes: KeyScenes,
    issuer: Issuer,
}

/// The signer of a key. A client's account is its name with an issuer: no other issuer can take it over.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Issuer {
    /// That of the first file: its clients have the names of their tokens.
    First,
    /// That of another file, or this process, by its name.
    Other(Arc<str>),
}

/// Stands between a client's name and its issuer's: no name of a client has a control character.
const OF_ISSUER: char = '\u{1f}';
/// The issuer's name of this process.
const OWN_ISSUER: &str = "server";

impl Issuer {
    /// That of a file by its place in the configuration. Its name does not depend on the folder or on the kind of the file.
    fn of(place: usize, file: &KeyFile) -> Self {
        let name = file.path.file_stem().unwrap_or(file.path.as_os_str());
        match place {
            0 => Self::First,
            _ => Self::Other(name.to_string_lossy().into()),
        }
    }

    fn is_own(&self) -> bool {
        matches!(self, Self::Other(name) if **name == *OWN_ISSUER)
    }
}

/// The claims of a token, the scenes for which its key signs, and who signs with it.
pub(crate) struct Verified {
    pub(crate) claims: Claims,
    scenes: KeyScenes,
    issuer: Issuer,
}

impl Verified {
    /// The permit of the client's account.
    fn in_account(&self, permit: Permit) -> Permit {
        let Issuer::Other(issuer) = &self.issuer else {
            return permit;
        };
        let account = |client: Arc<str>| format!("{client}{OF_ISSUER}{issuer}").into();
        Permit {
            client: permit.client.map(account),
            ..permit
        }
    }

    /// Refuses a scene for which the key may not sign, whatever the claims say.
    fn check_key(&self, scene: &SceneName) -> Result<(), TokenError> {
        match &self.scenes {
            KeyScenes::Some(patterns) if !patterns.iter().any(|pattern| names(pattern, scene)) => {
                Err(TokenError::OtherKey {
                    scene: scene.clone(),
                    of_key: patterns.join(","),
                })
            }
            _ => Ok(()),
        }
    }
}

impl KeyScenes {
    /// The scenes of both.
    fn and(&self, other: &Self) -> Self {
        match (self, other) {
            (Self::Some(these), Self::Some(those)) => {
                let new = those.iter().filter(|pattern| !these.contains(pattern));
                Self::Some(these.iter().chain(new).cloned().collect())
            }
            _ => Self::All,
        }
    }
}

impl KeyFile {
    /// A file whose key signs for all scenes.
    #[must_use]
    pub const fn for_all_scenes(path: PathBuf) -> Self {
        Self {
            path,
            scenes: KeyScenes::All,
        }
    }

    /// An error of reading it. Of a path that has `=` itself, only the beginning was sought.
    fn explained(&self, error: KeyError) -> KeyError {
        match (error, &self.scenes) {
            (KeyError::Read { path, cause }, KeyScenes::Some(patterns))
                if cause.kind() == io::ErrorKind::NotFound =>
            {
                KeyError::Absent {
                    path,
                    scenes: patterns.join(","),
                }
            }
            (error, _) => error,
        }
    }
}

impl FromStr for KeyFile {
    type Err = InvalidKeyFile;

    fn from_str(text: &str) -> Result<Self, InvalidKeyFile> {
        // No name of a scene has such a sign, and a path may.
        let Some((path, patterns)) = text.rsplit_once('=') else {
            return Ok(Self::for_all_scenes(text.into()));
        };
        let patterns: Arc<[String]> = patterns.split(',').map(str::to_owned).collect();
        match patterns.iter().find(|pattern| !Claims::is_pattern(pattern)) {
            Some(pattern) => Err(InvalidKeyFile {
                text: text.to_owned(),
                pattern: pattern.clone(),
            }),
            None => Ok(Self {
                path: path.into(),
                scenes: KeyScenes::Some(patterns),
            }),
        }
    }
}

impl fmt::Display for InvalidKeyFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "a key's file may be followed by = and names of scenes, separated by commas, such as team.pub=team/*; {:?} is no \
             such name, which has letters, digits, - _ . /, and may end in *. If the = belongs to the file's path, write {}=*",
            self.pattern, self.text
        )
    }
}

impl std::error::Error for InvalidKeyFile {}

/// Signs tokens with a key of this process, which is written nowhere.
#[cfg(feature = "view")]
#[derive(Clone, Debug)]
pub(crate) struct TokenIssuer {
    key: AsymmetricSecretKey<V4>,
    audience: String,
}

/// Reason why a key cannot be used or made.
#[derive(Debug)]
pub enum KeyError {
    /// The file cannot be read.
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        cause: io::Error,
    },
    /// The file of a key for some scenes is not there.
    Absent {
        /// The file.
        path: PathBuf,
        /// The names of the scenes.
        scenes: String,
    },
    /// The file cannot be written.
    Write {
        /// The file.
        path: PathBuf,
        /// The system's error.
        cause: io::Error,
    },
    /// The file holds no key of the wanted kind.
    NotAKey {
        /// The file.
        path: PathBuf,
        /// The first characters of such a key.
        begins: &'static str,
    },
    /// A key of a pair is there already.
    Exists {
        /// Its file.
        path: PathBuf,
    },
    /// A secret key is there already, and its file does not hold the whole of it.
    Torn {
        /// Its file.
        path: PathBuf,
    },
    /// Two files hold different keys, and their names would make one issuer of both.
    SameIssuer {
        /// The files.
        paths: [PathBuf; 2],
    },
    /// A file's name would make its issuer this process.
    OwnIssuer {
        /// The file.
        path: PathBuf,
    },
    /// The system gives no random bytes, or the key is refused.
    Failed,
}

impl fmt::Display for KeyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Read { path, cause } => write!(f, "cannot read {}: {cause}", path.display()),
            Self::Absent { path, scenes } => {
                let path = path.display();
                write!(
                    f,
                    "there is no file {path}, whose key was to sign for the scenes {scenes}; if the = belongs to the file's \
                     path, write {path}={scenes}=*"
                )
            }
            Self::Write { path, cause } => write!(f, "cannot write {}: {cause}", path.display()),
            Self::Exists { path } => write!(
                f,
                "{} exists, and a lost key cannot be made again: choose another name, or remove the file",
                path.display()
            ),
            Self::Torn { path } => write!(
                f,
                "{} exists and holds no whole secret key, as after a crash: nothing was signed with it; remove the file, and \
                 make the pair again",
                path.display()
            ),
            Self::NotAKey { path, begins } => {
                write!(
                    f,
                    "{} holds no whole key that begins with {begins}",
                    path.display()
                )
            }
            Self::SameIssuer {
                paths: [one, other],
            } => write!(
                f,
                "{} and {} hold different keys and have one name, which would make one issuer of both: give one of them \
                 another name",
                one.display(),
                other.display()
            ),
            Self::OwnIssuer { path } => write!(
                f,
                "{} has the name of the server's own issuer: give it another one, or make it the first key",
                path.display()
            ),
            Self::Failed => f.write_str("the key cannot be made or used"),
        }
    }
}

impl std::error::Error for KeyError {}

impl From<errors::Error> for KeyError {
    fn from(_: errors::Error) -> Self {
        Self::Failed
    }
}

impl TokenKeys {
    /// Reads public keys from files. A token of any of them is accepted if it names the audience, for scenes for which its
    /// key may sign. Each file is an issuer: clients of one name are one client only if the same issuer signed their tokens.
    ///
    /// # Errors
    ///
    /// [`KeyError`] for a file that cannot be read, that holds no public key, or whose name makes it another's issuer.
    pub fn read(files: &[KeyFile], audience: &str) -> Result<Self, KeyError> {
        Ok(Self {
            read: Arc::new(RwLock::new(read_all(files)?)),
            files: files.into(),
            own: Vec::new(),
            audience: audience.to_owned(),
        })
    }

    /// Reads the files again, for later tokens. Connections that are admitted stay until their tokens expire.
    ///
    /// # Errors
    ///
    /// [`KeyError`] as of [`TokenKeys::read`]; then nothing has changed.
    pub fn read_again(&self) -> Result<(), KeyError> {
        let keys = read_all(&self.files)?;
        *self.read.write().unwrap_or_else(PoisonError::into_inner) = keys;
        Ok(())
    }

    /// Makes a key pair of this process, whose tokens are accepted too.
    #[cfg(feature = "view")]
    pub(crate) fn issuer(&mut self) -> Result<TokenIssuer, KeyError> {
        let pair = AsymmetricKeyPair::<V4>::generate()?;
        self.own.push(ScopedKey {
            key: pair.public,
            scenes: KeyScenes::All,
            issuer: Issuer::Other(OWN_ISSUER.into()),
        });
        Ok(TokenIssuer {
            key: pair.secret,
            audience: self.audience.clone(),
        })
    }

    /// The claims of a token that one of the keys has signed.
    pub(crate) fn verify(&self, token: &[u8]) -> Result<Verified, TokenError> {
        let (payload, scoped) = self.payload(token).ok_or(TokenError::NotSigned)?;
        Ok(Verified {
            claims: Claims::parse(&payload)?,
            scenes: scoped.scenes,
            issuer: scoped.issuer,
        })
    }

    fn payload(&self, token: &[u8]) -> Option<(String, ScopedKey)> {
        let text = std::str::from_utf8(token).ok()?;
        let token = UntrustedToken::<Public, V4>::try_from(text).ok()?;
        let verify = |scoped: &ScopedKey| {
            let trusted = PublicToken::verify(&scoped.key, &token, None, None).ok()?;
            Some((trusted.payload().to_owned(), scoped.clone()))
        };
        let read = self.read.read().unwrap_or_else(PoisonError::into_inner);
        read.iter().chain(&self.own).find_map(verify)
    }
}

/// The seconds for which a token is valid by its own words; `None` if it cannot be read or has ended. For a
/// token that another server has verified.
pub(crate) fn stated_seconds_left(token: &[u8], now: i64) -> Option<u64> {
    let text = std::str::from_utf8(token).ok()?;
    let token = UntrustedToken::<Public, V4>::try_from(text).ok()?;
    let payload = std::str::from_utf8(token.untrusted_payload()).ok()?;
    Claims::parse(payload).ok()?.seconds_to_end(now)
}

/// Reads keys from files. One that several files hold signs for the scenes of all of them; different keys have different
/// issuers.
fn read_all(files: &[KeyFile]) -> Result<Vec<ScopedKey>, KeyError> {
    let mut keys: Vec<ScopedKey> = Vec::new();
    let mut paths: Vec<&Path> = Vec::new();
    for (place, file) in files.iter().enumerate() {
        let text = read(&file.path).map_err(|error| file.explained(error))?;
        let key = AsymmetricPublicKey::try_from(text.trim());
        let key = key.map_err(|_| KeyError::NotAKey {
            path: file.path.clone(),
            begins: "k4.public.",
        })?;
        if let Some(known) = keys.iter_mut().find(|known| known.key == key) {
            known.scenes = known.scenes.and(&file.scenes);
            continue;
        }
        let issuer = Issuer::of(place, file);
        if issuer.is_own() {
            let path = file.path.clone();
            return Err(KeyError::OwnIssuer { path });
        }
        if let Some(same) = keys.iter().position(|known| known.issuer == issuer) {
            let paths = [paths[same], &file.path].map(Path::to_owned);
            return Err(KeyError::SameIssuer { paths });
        }
        paths.push(&file.path);
        keys.push(ScopedKey {
            key,
            scenes: file.scenes.clone(),
            issuer,
        });
    }
    Ok(keys)
}

#[cfg(feature = "view")]
impl TokenIssuer {
    /// A token with which a client may observe every scene, for so many seconds from `now` on, in seconds since 1970.
    pub(crate) fn observer(
        &self,
        client: &str,
        now: i64,
        seconds: i64,
    ) -> Result<String, KeyError> {
        let claims = Claims {
            aud: self.audience.clone(),
            sub: client.to_owned(),
            exp: Claims::moment(now.saturating_add(seconds)).ok_or(KeyError::Failed)?,
            nbf: None,
            scenes: vec!["*".to_owned()],
            role: "observer".to_owned(),
            bodies: None,
            commands: None,
            load: None,
            members: None,
            tenant_scenes: None,
        };
        let payload = serde_json::to_vec(&claims).map_err(|_| KeyError::Failed)?;
        Ok(PublicToken::sign(&self.key, &payload, None, None)?)
    }
}

/// The files of a key pair.
#[derive(Debug)]
pub(crate) struct KeyPair {
    pub(crate) public: PathBuf,
    /// True if the secret key was there without its public key, as after a crash, and only that one was written.
    pub(crate) was_completed: bool,
}

/// Makes a key pair: the secret key in a new file that only its user may read, the public key beside it. A pair that was
/// begun and not ended is completed.
pub(crate) fn make_keys(path: &Path) -> Result<KeyPair, KeyError> {
    let mut public = path.as_os_str().to_owned();
    public.push(".pub");
    let public = PathBuf::from(public);
    if public.exists() {
        return Err(KeyError::Exists { path: public });
    }
    let was_completed = path.exists();
    let key = if was_completed {
        let secret = AsymmetricSecretKey::<V4>::try_from(read(path)?.trim());
        let secret = secret.map_err(|_| KeyError::Torn {
            path: path.to_owned(),
        })?;
        AsymmetricPublicKey::try_from(&secret)?
    } else {
        let pair = AsymmetricKeyPair::<V4>::generate()?;
        write_new(path, &pair.secret, 0o600)?;
        pair.public
    };
    write_new(&public, &key, 0o644)?;
    Ok(KeyPair {
        public,
        was_completed,
    })
}

/// A token of these claims, signed by the key in a file.
pub(crate) fn sign(path: &Path, claims: &Claims) -> Result<String, KeyError> {
    let text = read(path)?;
    let key = AsymmetricSecretKey::<V4>::try_from(text.trim()).map_err(|_| KeyError::NotAKey {
        path: path.to_owned(),
        begins: "k4.secret.",
    })?;
    let payload = serde_json::to_vec(claims).map_err(|_| KeyError::Failed)?;
    Ok(PublicToken::sign(&key, &payload, None, None)?)
}

fn read(path: &Path) -> Result<String, KeyError> {
    fs::read_to_string(path).map_err(|cause| KeyError::Read {
        path: path.to_owned(),
        cause,
    })
}

/// Writes a key to a file that must not exist yet: a lost key cannot be made again.
fn write_new(path: &Path, key: &impl FormatAsPaserk, mode: u32) -> Result<(), KeyError> {
    let failed = |cause| KeyError::Write {
        path: path.to_owned(),
        cause,
    };
    let mut text = String::new();
    key.fmt(&mut text).map_err(|_| KeyError::Failed)?;
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, mode);
    #[cfg(not(unix))]
    let _ = mode;
    let mut file = options.open(path).map_err(failed)?;
    let written = (file.write_all(text.as_bytes())).and_then(|()| file.sync_all());
    written.map_err(|cause| {
        // A file that the disk had no room for is no key. If it stays, the next run says so.
        let _ = fs::remove_file(path);
        failed(cause)
    })
}

#[cfg(test)]
pub(crate) mod tests;
