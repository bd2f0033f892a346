//! A snapshot file: an authenticated image of a scene with its sessions.
//!
//! Layout: magic number, version of the program and its engine, number of the segment that continues from it, tick,
//! digest, image of the sessions and owners, image of the scene, HMAC-SHA-256 of everything before. The engine trusts its image,
//! so that nothing behind the version is read before the code is verified.

use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::Tick;
use rhumb_scene::{Digest, IMAGE_FORMAT, Ownership, Sessions, decode_u64};
use ring::hmac;

use super::error::Damage;

const MAGIC: [u8; 8] = *b"RhSnap1\0";
const CODE_BYTES: usize = 32;
const VERSION_BYTES_MAX: usize = 200;

/// The state of a scene at the beginning of a segment.
#[derive(Clone, Debug)]
pub(super) struct Snapshot {
    /// Number of the segment.
    pub(super) segment: u32,
    pub(super) tick: Tick,
    pub(super) digest: Digest,
    pub(super) sessions: Sessions,
    pub(super) ownership: Ownership,
    /// The image of the scene.
    pub(super) scene: Vec<u8>,
}

impl Snapshot {
    pub(super) fn encode(&self, key: &hmac::Key) -> Vec<u8> {
        let mut to = Writer::new();
        to.raw(&MAGIC);
        to.sized(version().as_bytes());
        to.varint(u64::from(self.segment));
        to.varint(self.tick.value());
        to.raw(&self.digest.value().to_le_bytes());
        let mut members = Writer::new();
        self.sessions.encode(&mut members);
        self.ownership.encode(&mut members);
        to.sized(&members.into_bytes());
        to.raw(&self.scene);
        let mut bytes = to.into_bytes();
        let code = hmac::sign(key, &bytes);
        bytes.extend_from_slice(code.as_ref());
        bytes
    }

    pub(super) fn decode(bytes: &[u8], key: &hmac::Key) -> Result<Self, Damage> {
        let split = bytes.len().checked_sub(CODE_BYTES);
        let (signed, code) = bytes.split_at(split.ok_or(Damage::NotAuthentic)?);
        hmac::verify(key, signed, code).map_err(|_| Damage::NotAuthentic)?;
        let mut from = Reader::new(signed);
        let version = read_version(&mut from).map_err(|_| Damage::NotAuthentic)?;
        if version != self::version() {
            return Err(Damage::Version { found: version });
        }
        Self::read(&mut from).map_err(|_| Damage::NotAuthentic)
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let segment = from.varint32()?;
        let tick = Tick::new(from.varint()?);
        let digest = Digest::from_value(decode_u64(from)?);
        let mut inner = Reader::new(from.sized(from.rest().len())?);
        let sessions = Sessions::decode(&mut inner)?;
        let ownership = Ownership::decode(&mut inner)?;
        inner.finish()?;
        Ok(Self {
            segment,
            tick,
            digest,
            sessions,
            ownership,
            scene: from.rest().to_vec(),
        })
    }
}

/// The engine's version is that of this program's lock file: another one may run to other bits.
fn version() -> String {
    let program = env!("CARGO_PKG_VERSION");
    format!("rhumb-server {program} with {IMAGE_FORMAT}")
}

fn read_version(from: &mut Reader<'_>) -> Result<String, Malformed> {
    if from.raw(MAGIC.len())? != MAGIC {
        return Err(Malformed::UnknownCode);
    }
    let text = from.sized(VERSION_BYTES_MAX)?;
    String::from_utf8(text.to_vec()).map_err(|_| Malformed::Text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_damaged_snapshot_is_never_read() {
        let key = hmac::Key::new(hmac::HMAC_SHA256, &[7; 32]);
        let snapshot = Snapshot {
            segment: 3,
            tick: Tick::new(600),
            digest: Digest::START,
            sessions: Sessions::default(),
            ownership: Ownership::default(),
            scene: vec![1, 2, 3],
        };
        let bytes = snapshot.encode(&key);
        let read = Snapshot::decode(&bytes, &key).unwrap();
        assert_eq!(
            (read.segment, read.tick, read.scene),
            (3, Tick::new(600), vec![1, 2, 3])
        );
        for place in 0..bytes.len() {
            let mut flipped = bytes.clone();
            flipped[place] ^= 0x10;
            let refused = Snapshot::decode(&flipped, &key).err();
            assert_eq!(refused, Some(Damage::NotAuthentic), "byte {place}");
            let cut = Snapshot::decode(&bytes[..place], &key).err();
            assert_eq!(cut, Some(Damage::NotAuthentic), "cut to {place}");
        }
        let other = hmac::Key::new(hmac::HMAC_SHA256, &[8; 32]);
        assert!(Snapshot::decode(&bytes, &other).is_err());
    }
}
