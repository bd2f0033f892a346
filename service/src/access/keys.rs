//! Keys of tokens as files: signing and verifying.
//!
//! A key file holds one key in the PASERK format, without a line break: other libraries take the whole file as the key.
//! A server needs public keys only; the secret one stays with the issuer of tokens. Signatures are Ed25519, as PASETO
//! version 4 prescribes: a token cannot choose another algorithm.

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

use rhumb_protocol::scene::SceneName;

use super::claims::{Claims, TokenError, names};

/// The keys whose tokens a server accepts, and the audience that a token must name. All clones have the same keys.
#[derive(Clone, Debug)]
pub struct TokenKeys {
    files: Arc<[KeyFile]>,
    /// Keys of the files, as they were read last.
    read: Arc<RwLock<Vec<ScopedKey>>>,
    /// Keys of this process.
    own: Vec<ScopedKey>,
    pub(super) audience: String,
}

/// A file with a public key, and the scenes for which the key may sign.
///
/// Its text is the file's path, then for some scenes only `=` and their names, separated by commas. A name that ends in `*`
/// stands for all names that begin so: `team.pub=team/*,lobby`.
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
    pattern: String,
}

#[derive(Clone, Debug)]
struct ScopedKey {
    key: AsymmetricPublicKey<V4>,
    scenes: KeyScenes,
}

/// The claims of a token, and the scenes for which its key signs.
pub(crate) struct Verified {
    pub(crate) claims: Claims,
    scenes: KeyScenes,
}

impl Verified {
    /// False if the key may not sign for the scene, whatever the claims say.
    pub(crate) fn key_admits(&self, scene: &SceneName) -> bool {
        match &self.scenes {
            KeyScenes::All => true,
            KeyScenes::Some(patterns) => patterns.iter().any(|pattern| names(pattern, scene)),
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
}

impl FromStr for KeyFile {
    type Err = InvalidKeyFile;

    fn from_str(text: &str) -> Result<Self, InvalidKeyFile> {
        let Some((path, patterns)) = text.split_once('=') else {
            return Ok(Self::for_all_scenes(text.into()));
        };
        let patterns: Arc<[String]> = patterns.split(',').map(str::to_owned).collect();
        match patterns.iter().find(|pattern| !Claims::is_pattern(pattern)) {
            Some(pattern) => Err(InvalidKeyFile {
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
             such name, which has letters, digits, - _ . /, and may end in *",
            self.pattern
        )
    }
}

impl std::error::Error for InvalidKeyFile {}

/// Signs tokens with a key of this process, which is written nowhere.
#[cfg(feature = "view")]
#[derive(Clone, Debug)]
pub(crate) struct TokenIssuer {
    key: AsymmetricSecretKey<V4>,
    pub(super) audience: String,
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
    /// The system gives no random bytes, or the key is refused.
    Failed,
}

impl fmt::Display for KeyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Read { path, cause } => write!(f, "cannot read {}: {cause}", path.display()),
            Self::Write { path, cause } => write!(f, "cannot write {}: {cause}", path.display()),
            Self::NotAKey { path, begins } => {
                write!(
                    f,
                    "{} holds no key that begins with {begins}",
                    path.display()
                )
            }
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
    /// key may sign. Clients of one name are one client, whichever key signed: keys that share scenes belong to one issuer.
    ///
    /// # Errors
    ///
    /// [`KeyError`] for a file that cannot be read or holds no public key.
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
    /// [`KeyError`] for a file that cannot be read or holds no public key; then nothing has changed.
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
        });
        Ok(TokenIssuer {
            key: pair.secret,
            audience: self.audience.clone(),
        })
    }

    /// The claims of a token that one of the keys has signed.
    pub(crate) fn verify(&self, token: &[u8]) -> Result<Verified, TokenError> {
        let (payload, scenes) = self.payload(token).ok_or(TokenError::NotSigned)?;
        Ok(Verified {
            claims: Claims::parse(&payload)?,
            scenes,
        })
    }

    fn payload(&self, token: &[u8]) -> Option<(String, KeyScenes)> {
        let text = std::str::from_utf8(token).ok()?;
        let token = UntrustedToken::<Public, V4>::try_from(text).ok()?;
        let verify = |scoped: &ScopedKey| {
            let trusted = PublicToken::verify(&scoped.key, &token, None, None).ok()?;
            Some((trusted.payload().to_owned(), scoped.scenes.clone()))
        };
        let read = self.read.read().unwrap_or_else(PoisonError::into_inner);
        read.iter().chain(&self.own).find_map(verify)
    }
}

fn read_all(files: &[KeyFile]) -> Result<Vec<ScopedKey>, KeyError> {
    let key = |file: &KeyFile| {
        let text = read(&file.path)?;
        let key = AsymmetricPublicKey::try_from(text.trim());
        Ok(ScopedKey {
            key: key.map_err(|_| KeyError::NotAKey {
                path: file.path.clone(),
                begins: "k4.public.",
            })?,
            scenes: file.scenes.clone(),
        })
    };
    files.iter().map(key).collect()
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
        };
        let payload = serde_json::to_vec(&claims).map_err(|_| KeyError::Failed)?;
        Ok(PublicToken::sign(&self.key, &payload, None, None)?)
    }
}

/// Makes a key pair: the secret key in a new file that only its user may read, the public key beside it.
pub(crate) fn make_keys(path: &Path) -> Result<PathBuf, KeyError> {
    let pair = AsymmetricKeyPair::<V4>::generate()?;
    write_new(path, &pair.secret, 0o600)?;
    let mut beside = path.as_os_str().to_owned();
    beside.push(".pub");
    let beside = PathBuf::from(beside);
    write_new(&beside, &pair.public, 0o644)?;
    Ok(beside)
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
    file.write_all(text.as_bytes()).map_err(failed)
}
