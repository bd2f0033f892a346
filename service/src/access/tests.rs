//! Admission by token: scenes, roles, times, keys that were replaced.

use std::fs;
use std::path::PathBuf;
use std::sync::atomic::{AtomicI64, Ordering};

use rhumb_protocol::message::Role;
use rhumb_protocol::session::CloseCode;

use super::*;
use crate::access::{Claims, make_keys, sign};

/// An authenticator with a key of its own, and a clock that the test sets.
pub(crate) struct Signed {
    folder: PathBuf,
    pub(crate) seconds: Arc<AtomicI64>,
}

impl Signed {
    pub(crate) fn new(name: &str) -> Self {
        let folder = format!("rhumb-{name}-{}", std::process::id());
        let folder = std::env::temp_dir().join(folder);
        fs::create_dir_all(&folder).unwrap();
        make_keys(&folder.join("key")).unwrap();
        Self {
            folder,
            seconds: Arc::new(AtomicI64::new(1_767_225_600)),
        }
    }

    pub(crate) fn keys(&self) -> TokenKeys {
        TokenKeys::read(
            &[KeyFile::for_all_scenes(self.folder.join("key.pub"))],
            "rhumb",
        )
        .unwrap()
    }

    pub(crate) fn authenticator(&self) -> Authenticator {
        let seconds = Arc::clone(&self.seconds);
        Authenticator::Tokens {
            keys: self.keys(),
            clock: Arc::new(move || seconds.load(Ordering::SeqCst)),
        }
    }

    /// An observer's token for all scenes that expires in a minute.
    pub(crate) fn token(&self) -> String {
        self.token_as("observer")
    }

    /// The same with a role.
    pub(crate) fn token_as(&self, role: &str) -> String {
        self.token_of(role, "anna")
    }

    /// The same of a client.
    pub(crate) fn token_of(&self, role: &str, client: &str) -> String {
        let claims = Claims {
            aud: "rhumb".into(),
            sub: client.into(),
            exp: Claims::moment(self.seconds.load(Ordering::SeqCst) + 60).unwrap(),
            nbf: None,
            scenes: vec!["*".into()],
            role: role.into(),
            bodies: None,
            commands: None,
            load: None,
            members: None,
            tenant_scenes: None,
        };
        sign(&self.folder.join("key"), &claims).unwrap()
    }
}

impl Drop for Signed {
    fn drop(&mut self) {
        // The rest of it lies in a folder of temporary files.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

#[test]
fn only_a_whole_token_of_the_key_is_admitted() {
    let signed = Signed::new("authenticator");
    let (authenticator, token) = (signed.authenticator(), signed.token());
    let scene = "pit".parse().unwrap();
    let admission = authenticator.admit(Some(token.as_bytes()), &scene).unwrap();
    assert_eq!(admission.permit.client.as_deref(), Some("anna"));
    assert_eq!(admission.valid_for, Some(Span::from_millis(90_000)));
    assert!(token.len() <= rhumb_protocol::limits::EXTENSION_BYTES_MAX);
    assert_eq!(authenticator.admit(None, &scene), Err(TokenError::Absent));
    for place in 0..token.len() {
        let mut changed = token.clone().into_bytes();
        changed[place] ^= 1;
        for bytes in [&changed[..], &token.as_bytes()[..place]] {
            let refused = authenticator.admit(Some(bytes), &scene);
            assert_eq!(refused, Err(TokenError::NotSigned), "{place}");
        }
    }
    let other = Signed::new("authenticator-other").token();
    let refused = authenticator.admit(Some(other.as_bytes()), &scene);
    assert_eq!(refused, Err(TokenError::NotSigned));
}

#[test]
fn a_token_of_this_process_admits_an_observer_until_it_expires() {
    let signed = Signed::new("authenticator-issuer");
    let mut keys = signed.keys();
    let issuer = keys.issuer().unwrap();
    let now = signed.seconds.load(Ordering::SeqCst);
    let token = issuer.observer("view", now, 60).unwrap();
    let scene = "pit".parse().unwrap();
    let seconds = Arc::clone(&signed.seconds);
    let authenticator = Authenticator::Tokens {
        keys,
        clock: Arc::new(move || seconds.load(Ordering::SeqCst)),
    };
    let admission = authenticator.admit(Some(token.as_bytes()), &scene).unwrap();
    assert_eq!(admission.permit.role, Role::Observer);
    assert_eq!(admission.permit.client.as_deref(), Some("view\u{1f}server"));
    assert!(
        authenticator
            .admit(Some(signed.token().as_bytes()), &scene)
            .is_ok()
    );
    let without_issuer = signed.authenticator().admit(Some(token.as_bytes()), &scene);
    assert_eq!(without_issuer, Err(TokenError::NotSigned));
    signed.seconds.fetch_add(91, Ordering::SeqCst);
    let refused = authenticator.admit(Some(token.as_bytes()), &scene);
    assert!(
        matches!(refused, Err(TokenError::Expired(_))),
        "{refused:?}"
    );
}

#[test]
fn clients_of_one_name_and_two_issuers_are_two() {
    let (first, second) = (Signed::new("issuer-first"), Signed::new("issuer-second"));
    let other = second.folder.join("other.pub");
    fs::copy(second.folder.join("key.pub"), &other).unwrap();
    let account = |files: &[&PathBuf], token: &str| {
        let files: Vec<_> = files
            .iter()
            .map(|file| KeyFile::for_all_scenes(PathBuf::from(file)))
            .collect();
        let authenticator = Authenticator::Tokens {
            keys: TokenKeys::read(&files, "rhumb").unwrap(),
            clock: Arc::new(|| 1_767_225_600),
        };
        let admitted = authenticator.admit(Some(token.as_bytes()), &"pit".parse().unwrap());
        admitted.unwrap().permit.client.clone().unwrap()
    };
    let own = first.folder.join("key.pub");
    let (one, two) = (first.token(), second.token());
    assert_eq!(&*account(&[&own], &one), "anna");
    // Another issuer that is admitted beside changes no account, and has its own.
    assert_eq!(&*account(&[&own, &other], &one), "anna");
    assert_eq!(&*account(&[&own, &other], &two), "anna\u{1f}other");
    let guessed = first.token_of("owner", "anna\u{1f}other");
    let keys = first.keys();
    assert!(keys.verify(guessed.as_bytes()).is_err());
}

#[test]
fn a_key_signs_for_its_scenes_alone_whatever_its_tokens_claim() {
    let signed = Signed::new("authenticator-scope");
    let public = signed.folder.join("key.pub");
    let file = format!("{}=team/*,lobby", public.display());
    let keys = TokenKeys::read(&[file.parse().unwrap()], "rhumb").unwrap();
    let seconds = Arc::clone(&signed.seconds);
    let authenticator = Authenticator::Tokens {
        keys,
        clock: Arc::new(move || seconds.load(Ordering::SeqCst)),
    };
    let token = signed.token();
    for (scene, admitted) in [
        ("team/7", true),
        ("lobby", true),
        ("team", false),
        ("teams/7", false),
        ("lobby2", false),
    ] {
        let scene: SceneName = scene.parse().unwrap();
        let outcome = authenticator.admit(Some(token.as_bytes()), &scene);
        match outcome {
            Ok(_) => assert!(admitted, "{scene}"),
            Err(cause) => {
                assert!(!admitted, "{scene}");
                let said = cause.to_string();
                assert!(
                    said.contains("team/*,lobby") && said.contains(scene.as_str()),
                    "{said}"
                );
                assert_eq!(cause.code(), CloseCode::TOKEN_SCENE);
            }
        }
    }
    for wrong in ["k.pub=", "k.pub=a b", "k.pub=team/*,", "k.pub=*a"] {
        assert!(wrong.parse::<KeyFile>().is_err(), "{wrong}");
    }
}

#[test]
fn files_whose_names_would_make_one_issuer_of_two_keys_are_refused_with_both_paths() {
    let [first, one, other] = ["same-first", "same-one", "same-other"].map(Signed::new);
    let public = |signed: &Signed, name: &str| {
        let path = signed.folder.join(name);
        fs::copy(signed.folder.join("key.pub"), &path).unwrap();
        path
    };
    let (main, acme) = (first.folder.join("key.pub"), public(&one, "token.pub"));
    // The folder and the ending do not tell issuers apart.
    for beta in ["token.pub", "token.paserk"] {
        let beta = public(&other, beta);
        let files = [&main, &acme, &beta].map(|path| KeyFile::for_all_scenes(path.clone()));
        let refused = TokenKeys::read(&files, "rhumb").unwrap_err().to_string();
        for path in [&acme, &beta] {
            assert!(refused.contains(path.to_str().unwrap()), "{refused}");
        }
        // The first file's clients have their plain names.
        assert!(TokenKeys::read(&files[1..], "rhumb").is_ok());
    }
    let server = public(&one, "server.pub");
    let files = [&main, &server].map(|path| KeyFile::for_all_scenes(path.clone()));
    let refused = TokenKeys::read(&files, "rhumb").unwrap_err().to_string();
    assert!(refused.contains(server.to_str().unwrap()), "{refused}");
    assert!(TokenKeys::read(&files[1..], "rhumb").is_ok());

    // One key in two files of one name is one issuer, until one of them gets another key.
    let beta = other.folder.join("token.pub");
    fs::copy(&acme, &beta).unwrap();
    let files = [&main, &acme, &beta].map(|path| KeyFile::for_all_scenes(path.clone()));
    let keys = TokenKeys::read(&files, "rhumb").unwrap();
    fs::copy(other.folder.join("key.pub"), &beta).unwrap();
    let refused = keys.read_again().unwrap_err().to_string();
    assert!(refused.contains(acme.to_str().unwrap()), "{refused}");
    assert!(keys.verify(one.token().as_bytes()).is_ok());
    assert!(keys.verify(other.token().as_bytes()).is_err());
}

/// An authenticator with the keys of these texts.
fn with_keys(signed: &Signed, files: &[String]) -> Authenticator {
    let files: Vec<KeyFile> = files.iter().map(|file| file.parse().unwrap()).collect();
    let seconds = Arc::clone(&signed.seconds);
    Authenticator::Tokens {
        keys: TokenKeys::read(&files, "rhumb").unwrap(),
        clock: Arc::new(move || seconds.load(Ordering::SeqCst)),
    }
}

#[test]
fn a_key_that_is_given_twice_signs_for_the_scenes_of_both() {
    let signed = Signed::new("authenticator-twice");
    let public = signed.folder.join("key.pub");
    // The same key under another name is the same key.
    let copy = signed.folder.join("copy.pub");
    fs::copy(&public, &copy).unwrap();
    let (public, copy) = (public.display(), copy.display());
    let token = signed.token();
    for (files, admitted) in [
        (
            vec![format!("{public}=a/*"), format!("{public}=b")],
            vec!["a/1", "b"],
        ),
        (
            vec![format!("{public}=b"), format!("{copy}=a/*,b")],
            vec!["a/1", "b"],
        ),
        (
            vec![format!("{public}=b"), format!("{public}")],
            vec!["a/1", "b", "c"],
        ),
    ] {
        let authenticator = with_keys(&signed, &files);
        for scene in ["a/1", "b", "c"] {
            let scene: SceneName = scene.parse().unwrap();
            let outcome = authenticator.admit(Some(token.as_bytes()), &scene);
            let expected = admitted.contains(&scene.as_str());
            assert_eq!(outcome.is_ok(), expected, "{files:?} {scene}");
        }
    }
}

#[test]
fn a_key_s_path_may_have_an_equals_sign() {
    let signed = Signed::new("authenticator=equals");
    let public = signed.folder.join("key.pub");
    let token = signed.token();
    let authenticator = with_keys(&signed, &[format!("{}=pit", public.display())]);
    for (scene, admitted) in [("pit", true), ("other", false)] {
        let outcome = authenticator.admit(Some(token.as_bytes()), &scene.parse().unwrap());
        assert_eq!(outcome.is_ok(), admitted, "{scene}");
    }
    // Without scenes, the refusal says how to write it.
    let plain = public.display().to_string();
    let way_out = format!("{plain}=*");
    let refused = TokenKeys::read(&[plain.parse().unwrap()], "rhumb").unwrap_err();
    assert!(refused.to_string().contains(&way_out), "{refused}");
    let whole = with_keys(&signed, std::slice::from_ref(&way_out));
    assert!(
        whole
            .admit(Some(token.as_bytes()), &"other".parse().unwrap())
            .is_ok()
    );
    let refused = "odd=a b.pub".parse::<KeyFile>().unwrap_err();
    assert!(refused.to_string().contains("odd=a b.pub=*"), "{refused}");
}

#[test]
fn a_half_written_key_pair_is_completed_or_named() {
    let signed = Signed::new("authenticator-half");
    let (secret, public) = (signed.folder.join("key"), signed.folder.join("key.pub"));
    let whole = fs::read_to_string(&public).unwrap();
    fs::remove_file(&public).unwrap();
    let pair = make_keys(&secret).unwrap();
    assert!(pair.was_completed);
    assert_eq!(fs::read_to_string(&public).unwrap(), whole);
    // A public key alone is in the way before anything is written.
    let text = fs::read_to_string(&secret).unwrap();
    fs::remove_file(&secret).unwrap();
    let refused = make_keys(&secret).unwrap_err().to_string();
    assert!(refused.contains("key.pub exists"), "{refused}");
    assert!(!secret.exists());
    fs::remove_file(&public).unwrap();
    for torn in [0, 10, text.len() - 1] {
        fs::write(&secret, &text[..torn]).unwrap();
        let refused = make_keys(&secret).unwrap_err().to_string();
        assert!(refused.contains("no whole secret key"), "{torn}: {refused}");
        assert!(!public.exists());
    }
    fs::write(&public, &whole[..whole.len() - 1]).unwrap();
    let refused = TokenKeys::read(&[KeyFile::for_all_scenes(public.clone())], "rhumb");
    let refused = refused.unwrap_err().to_string();
    assert!(refused.contains("no whole key"), "{refused}");
}

#[test]
fn keys_are_read_again_all_or_none() {
    let (signed, next) = (
        Signed::new("authenticator-again"),
        Signed::new("authenticator-next"),
    );
    let authenticator = signed.authenticator();
    let Authenticator::Tokens { keys, .. } = &authenticator else {
        panic!("it asks for tokens");
    };
    let scene = "pit".parse().unwrap();
    let admits = |token: &str| authenticator.admit(Some(token.as_bytes()), &scene).is_ok();
    let (old, new) = (signed.token(), next.token());
    assert!(admits(&old) && !admits(&new));
    let file = signed.folder.join("key.pub");
    fs::copy(next.folder.join("key.pub"), &file).unwrap();
    keys.read_again().unwrap();
    assert!(!admits(&old) && admits(&new));
    fs::write(&file, "no key").unwrap();
    assert!(keys.read_again().is_err());
    assert!(!admits(&old) && admits(&new), "the keys stay as they were");
}

#[test]
fn key_files_hold_the_key_and_nothing_else() {
    let signed = Signed::new("authenticator-files");
    for (name, begins) in [("key", "k4.secret."), ("key.pub", "k4.public.")] {
        let text = fs::read_to_string(signed.folder.join(name)).unwrap();
        assert!(text.starts_with(begins) && text.trim() == text, "{name}");
    }
    // An editor may add a line break.
    let public = signed.folder.join("key.pub");
    let text = fs::read_to_string(&public).unwrap();
    fs::write(&public, format!("{text}\n")).unwrap();
    assert!(TokenKeys::read(&[KeyFile::for_all_scenes(public)], "rhumb").is_ok());
}

#[test]
fn a_secret_key_is_no_public_one_and_is_not_written_over() {
    let signed = Signed::new("authenticator-keys");
    let key = signed.folder.join("key");
    let refused = TokenKeys::read(&[KeyFile::for_all_scenes(key.clone())], "rhumb");
    assert!(refused.unwrap_err().to_string().contains("k4.public."));
    assert!(make_keys(&key).is_err());
}
