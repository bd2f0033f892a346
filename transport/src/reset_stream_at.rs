//! Resets of streams with partial delivery, for a QUIC library without them.
//!
//! A frame RESET_STREAM_AT resets a stream and has the peer deliver its first bytes all the same: the bytes in which
//! WebTransport names the session. This protocol has no use for any byte of a stream that was reset, so that its end may
//! take such a frame for a plain RESET_STREAM, which every library knows. An end never sends one: it opens no stream
//! that has such bytes. Source: draft-ietf-quic-reliable-stream-reset, sections 3 and 4; RFC 9000, section 19.
//!
//! TLS of a server that allows its peers resets with partial delivery. QUIC's library has neither the transport
//! parameter nor the frame. Both pass through its TLS side, which is replaceable: this one adds the parameter to those
//! that the library sends, and hands it each packet with plain resets. All else is as in the library's own. Invariant:
//! only packets behind the handshake are changed, since none before has such a frame.

use std::any::Any;
use std::io::Cursor;
use std::mem;
use std::sync::Arc;

use bytes::BytesMut;
use quinn::crypto::rustls::{HandshakeData, NoInitialCipherSuite, QuicServerConfig};
use quinn::crypto::{
    CryptoError, ExportKeyingMaterialError, HeaderKey, KeyPair, Keys, PacketKey, ServerConfig,
    Session, UnsupportedVersion,
};
use quinn::{ConnectionId, Side, TransportErrorCode, VarInt, rustls};
use quinn_proto::TransportError;
use quinn_proto::coding::Codec;
use quinn_proto::transport_parameters::TransportParameters;
use rustls::pki_types::CertificateDer;
use rustls::quic;

/// The numbers of the transport parameter by which an end allows the frame: the registered one, and that of drafts.
const PARAMETERS: [u64; 2] = [0x1d, 0x17_f758_6d2c_b571];

const RESET_STREAM: u8 = 0x04;
const RESET_STREAM_AT: u8 = 0x24;

/// Turns each RESET_STREAM_AT among the frames of a packet into a RESET_STREAM with padding behind it.
///
/// An invalid one stays: the library then closes the connection, as it must.
fn make_plain(mut frames: &mut [u8]) {
    while let Some(length) = frame_length(frames) {
        let (frame, rest) = mem::take(&mut frames).split_at_mut(length);
        if frame[0] == RESET_STREAM_AT {
            make_reset_plain(frame);
        }
        frames = rest;
    }
}

fn make_reset_plain(frame: &mut [u8]) {
    let mut numbers = PacketReader { rest: &frame[1..] };
    // Stream, code, and the length of the whole stream.
    let Some((_, _, final_size)) = numbers.three() else {
        return;
    };
    let padded = numbers.rest.len();
    if numbers
        .number()
        .is_some_and(|reliable| reliable <= final_size)
    {
        frame[0] = RESET_STREAM;
        let kept = frame.len() - padded;
        // A byte of zero is a frame PADDING.
        frame[kept..].fill(0);
    }
}

/// Bytes of the first of some frames; `None` for no frame, for one that is cut off, and for one of another extension.
fn frame_length(frames: &[u8]) -> Option<usize> {
    let mut reader = PacketReader { rest: frames };
    match reader.number()? {
        // PADDING, PING, HANDSHAKE_DONE.
        0x00 | 0x01 | 0x1e => {}
        // ACK: the largest, the delay, further ranges; then the first range and two numbers for each further one.
        kind @ 0x02..=0x03 => {
            let (_, _, ranges) = reader.three()?;
            reader.numbers(ranges.saturating_mul(2).saturating_add(1))?;
            reader.numbers(if kind == 0x03 { 3 } else { 0 })?;
        }
        // RESET_STREAM.
        0x04 => reader.numbers(3)?,
        // STOP_SENDING, MAX_STREAM_DATA, STREAM_DATA_BLOCKED.
        0x05 | 0x11 | 0x15 => reader.numbers(2)?,
        // CRYPTO.
        0x06 => {
            reader.number()?;
            reader.counted()?;
        }
        // NEW_TOKEN, DATAGRAM with its length.
        0x07 | 0x31 => reader.counted()?,
        // STREAM, with or without its offset and its length.
        kind @ 0x08..=0x0f => {
            reader.numbers(if kind & 0x04 == 0 { 1 } else { 2 })?;
            match kind & 0x02 {
                0 => reader.rest = &[],
                _ => reader.counted()?,
            }
        }
        // MAX_DATA, MAX_STREAMS, DATA_BLOCKED, STREAMS_BLOCKED, RETIRE_CONNECTION_ID.
        0x10 | 0x12..=0x14 | 0x16 | 0x17 | 0x19 => reader.numbers(1)?,
        // NEW_CONNECTION_ID: two numbers, the id by its length, a token.
        0x18 => {
            reader.numbers(2)?;
            let (&length, rest) = reader.rest.split_first()?;
            reader.rest = rest;
            reader.skip(usize::from(length) + 16)?;
        }
        // PATH_CHALLENGE, PATH_RESPONSE.
        0x1a | 0x1b => reader.skip(8)?,
        // CONNECTION_CLOSE of the transport, and of the application.
        kind @ 0x1c..=0x1d => {
            reader.numbers(if kind == 0x1c { 2 } else { 1 })?;
            reader.counted()?;
        }
        // RESET_STREAM_AT.
        0x24 => reader.numbers(4)?,
        // DATAGRAM, to the end of the packet.
        0x30 => reader.rest = &[],
        _ => return None,
    }
    Some(frames.len() - reader.rest.len())
}

/// Reads numbers of QUIC; `None` where they are cut off.
struct PacketReader<'a> {
    rest: &'a [u8],
}

impl PacketReader<'_> {
    fn number(&mut self) -> Option<u64> {
        let length = 1 << (self.rest.first()? >> 6);
        let (bytes, rest) = self.rest.split_at_checked(length)?;
        self.rest = rest;
        let first = u64::from(bytes[0] & 0x3f);
        let more = bytes[1..].iter();
        Some(more.fold(first, |number, byte| number << 8 | u64::from(*byte)))
    }

    fn three(&mut self) -> Option<(u64, u64, u64)> {
        Some((self.number()?, self.number()?, self.number()?))
    }

    /// Passes numbers over. As many as a peer claims: each takes a byte at least.
    fn numbers(&mut self, count: u64) -> Option<()> {
        (0..count).try_for_each(|_| self.number().map(drop))
    }

    fn skip(&mut self, bytes: usize) -> Option<()> {
        self.rest = self.rest.get(bytes..)?;
        Some(())
    }

    /// Passes bytes behind their count over.
    fn counted(&mut self) -> Option<()> {
        let bytes = usize::try_from(self.number()?).ok()?;
        self.skip(bytes)
    }
}

/// The TLS configuration of such a server.
pub(crate) struct PartialResetConfig {
    library: Arc<QuicServerConfig>,
    tls: Arc<rustls::ServerConfig>,
}

impl PartialResetConfig {
    /// # Errors
    ///
    /// The provider has no initial cipher suite.
    pub(crate) fn new(tls: Arc<rustls::ServerConfig>) -> Result<Self, NoInitialCipherSuite> {
        let library = Arc::new(QuicServerConfig::try_from(Arc::clone(&tls))?);
        Ok(Self { library, tls })
    }
}

impl ServerConfig for PartialResetConfig {
    fn initial_keys(&self, version: u32, id: &ConnectionId) -> Result<Keys, UnsupportedVersion> {
        self.library.initial_keys(version, id)
    }

    fn retry_tag(&self, version: u32, id: &ConnectionId, packet: &[u8]) -> [u8; 16] {
        self.library.retry_tag(version, id, packet)
    }

    fn start_session(
        self: Arc<Self>,
        version: u32,
        parameters: &TransportParameters,
    ) -> Box<dyn Session> {
        let mut bytes = Vec::new();
        parameters.write(&mut bytes);
        for parameter in PARAMETERS {
            let parameter = VarInt::from_u64(parameter).expect("below 2^62");
            parameter.encode(&mut bytes);
            // It is empty.
            VarInt::from_u32(0).encode(&mut bytes);
        }
        // `initial_keys` has refused other versions.
        let of_tls = match version {
            0xff00_001d..=0xff00_0020 => quic::Version::V1Draft,
            _ => quic::Version::V1,
        };
        let tls = quic::ServerConnection::new(Arc::clone(&self.tls), of_tls, bytes);
        let tls = tls.expect("the configuration has tls 1.3: the library's own was made of it");
        Box::new(PartialResetSession {
            library: Arc::clone(&self.library),
            version,
            tls: quic::Connection::Server(tls),
            handshake_data_ready: false,
            next_secrets: None,
        })
    }
}

/// The TLS side of one connection.
struct PartialResetSession {
    library: Arc<QuicServerConfig>,
    version: u32,
    tls: quic::Connection,
    handshake_data_ready: bool,
    next_secrets: Option<quic::Secrets>,
}

impl PartialResetSession {
    fn server_name(&self) -> Option<&str> {
        match &self.tls {
            quic::Connection::Server(tls) => tls.server_name(),
            quic::Connection::Client(_) => None,
        }
    }
}

impl Session for PartialResetSession {
    fn initial_keys(&self, id: &ConnectionId, _side: Side) -> Keys {
        let keys = self.library.initial_keys(self.version, id);
        keys.unwrap_or_else(|_| unreachable!("the session began with this version"))
    }

    fn handshake_data(&self) -> Option<Box<dyn Any>> {
        self.handshake_data_ready.then(|| {
            Box::new(HandshakeData {
                protocol: self.tls.alpn_protocol().map(<[u8]>::to_vec),
                server_name: self.server_name().map(str::to_owned),
            }) as Box<dyn Any>
        })
    }

    fn peer_identity(&self) -> Option<Box<dyn Any>> {
        let chain = self.tls.peer_certificates()?;
        let chain: Vec<CertificateDer<'static>> = chain
            .iter()
            .map(|certificate| certificate.clone().into_owned())
            .collect();
        Some(Box::new(chain))
    }

    fn early_crypto(&self) -> Option<(Box<dyn HeaderKey>, Box<dyn PacketKey>)> {
        let keys = self.tls.zero_rtt_keys()?;
        Some((Box::new(keys.header), Box::new(PlainResets(keys.packet))))
    }

    fn early_data_accepted(&self) -> Option<bool> {
        None
    }

    fn is_handshaking(&self) -> bool {
        self.tls.is_handshaking()
    }

    fn read_handshake(&mut self, bytes: &[u8]) -> Result<bool, TransportError> {
        self.tls.read_hs(bytes).map_err(|cause| TransportError {
            code: match self.tls.alert() {
                Some(alert) => TransportErrorCode::crypto(alert.into()),
                None => TransportErrorCode::PROTOCOL_VIOLATION,
            },
            frame: None,
            reason: cause.to_string(),
        })?;
        let known = self.tls.alpn_protocol().is_some()
            || self.server_name().is_some()
            || !self.tls.is_handshaking();
        let is_new = known && !self.handshake_data_ready;
        self.handshake_data_ready |= known;
        Ok(is_new)
    }

    fn transport_parameters(&self) -> Result<Option<TransportParameters>, TransportError> {
        let bytes = self.tls.quic_transport_parameters();
        let read =
            bytes.map(|bytes| TransportParameters::read(Side::Server, &mut Cursor::new(bytes)));
        Ok(read.transpose()?)
    }

    fn write_handshake(&mut self, bytes: &mut Vec<u8>) -> Option<Keys> {
        let (header, packet) = match self.tls.write_hs(bytes)? {
            quic::KeyChange::Handshake { keys } => {
                let remote: Box<dyn PacketKey> = Box::new(keys.remote.packet);
                let header = headers(keys.local.header, keys.remote.header);
                (header, packets(keys.local.packet, remote))
            }
            quic::KeyChange::OneRtt { keys, next } => {
                self.next_secrets = Some(next);
                let remote = Box::new(PlainResets(keys.remote.packet));
                let header = headers(keys.local.header, keys.remote.header);
                (header, packets(keys.local.packet, remote))
            }
        };
        Some(Keys { header, packet })
    }

    fn next_1rtt_keys(&mut self) -> Option<KeyPair<Box<dyn PacketKey>>> {
        let keys = self.next_secrets.as_mut()?.next_packet_keys();
        Some(packets(keys.local, Box::new(PlainResets(keys.remote))))
    }

    fn is_valid_retry(&self, _id: &ConnectionId, _header: &[u8], _payload: &[u8]) -> bool {
        // Clients alone receive one.
        false
    }

    fn export_keying_material(
        &self,
        output: &mut [u8],
        label: &[u8],
        context: &[u8],
    ) -> Result<(), ExportKeyingMaterialError> {
        let exported = self
            .tls
            .export_keying_material(output, label, Some(context));
        exported.map(drop).map_err(|_| ExportKeyingMaterialError)
    }
}

fn headers(
    local: Box<dyn quic::HeaderProtectionKey>,
    remote: Box<dyn quic::HeaderProtectionKey>,
) -> KeyPair<Box<dyn HeaderKey>> {
    KeyPair {
        local: Box::new(local),
        remote: Box::new(remote),
    }
}

fn packets(
    local: Box<dyn quic::PacketKey>,
    remote: Box<dyn PacketKey>,
) -> KeyPair<Box<dyn PacketKey>> {
    KeyPair {
        local: Box::new(local),
        remote,
    }
}

/// A key whose packets have plain resets once they are decrypted.
struct PlainResets(Box<dyn quic::PacketKey>);

impl PacketKey for PlainResets {
    fn encrypt(&self, packet: u64, buffer: &mut [u8], header_bytes: usize) {
        PacketKey::encrypt(&self.0, packet, buffer, header_bytes);
    }

    fn decrypt(
        &self,
        packet: u64,
        header: &[u8],
        payload: &mut BytesMut,
    ) -> Result<(), CryptoError> {
        PacketKey::decrypt(&self.0, packet, header, payload)?;
        make_plain(payload);
        Ok(())
    }

    fn tag_len(&self) -> usize {
        PacketKey::tag_len(&self.0)
    }

    fn confidentiality_limit(&self) -> u64 {
        PacketKey::confidentiality_limit(&self.0)
    }

    fn integrity_limit(&self) -> u64 {
        PacketKey::integrity_limit(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use rhumb_link::Trust;
    use rhumb_link::trust;
    use rhumb_link::tuning::DRAFT_ALPN;

    use crate::certificate::Certificate;

    /// A frame of each kind of RFC 9000 and RFC 9221 that says where it ends, with bytes like RESET_STREAM_AT inside.
    const FRAMES: &[&[u8]] = &[
        &[0x00],
        &[0x01],
        &[0x02, 0x24, 0x00, 0x02, 0x24, 0x01, 0x01, 0x24, 0x24],
        &[0x03, 0x40, 0x24, 0x00, 0x00, 0x24, 0x24, 0x24, 0x24],
        &[0x04, 0x24, 0x24, 0x24],
        &[0x05, 0x24, 0x24],
        &[0x06, 0x24, 0x02, 0x24, 0x24],
        &[0x07, 0x03, 0x24, 0x24, 0x24],
        &[0x0a, 0x04, 0x02, 0x24, 0x04],
        &[0x0f, 0x04, 0x24, 0x03, 0x24, 0x00, 0x00],
        &[0x10, 0x80, 0x00, 0x24, 0x24],
        &[0x11, 0x24, 0x24],
        &[0x12, 0x24],
        &[0x13, 0x24],
        &[0x14, 0x24],
        &[0x15, 0x24, 0x24],
        &[0x16, 0x24],
        &[0x17, 0x24],
        &[
            0x18, 0x24, 0x00, 0x02, 0x24, 0x24, // the id; a token follows
            0x24, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x24,
        ],
        &[0x19, 0x24],
        &[0x1a, 0x24, 0, 0, 0, 0, 0, 0, 0x24],
        &[0x1b, 0x24, 0, 0, 0, 0, 0, 0, 0x24],
        &[0x1c, 0x24, 0x24, 0x01, 0x24],
        &[0x1d, 0x24, 0x02, 0x24, 0x24],
        &[0x1e],
        &[0x31, 0x03, 0x24, 0x24, 0x24],
    ];

    /// The reset of stream 4 with code 0x170d7b68 after 700 bytes, the first three of which are to be delivered.
    const AT: &[u8] = &[0x24, 0x04, 0x97, 0x0d, 0x7b, 0x68, 0x42, 0xbc, 0x03];
    const PLAIN: &[u8] = &[0x04, 0x04, 0x97, 0x0d, 0x7b, 0x68, 0x42, 0xbc, 0x00];

    #[test]
    fn a_reset_behind_any_frame_becomes_plain_and_the_other_bytes_stay() {
        for before in FRAMES {
            for after in FRAMES {
                let mut frames = [before, AT, AT, after].concat();
                make_plain(&mut frames);
                assert_eq!(frames, [*before, PLAIN, PLAIN, after].concat());
            }
        }
    }

    #[test]
    fn bytes_behind_a_frame_without_an_end_are_its_own() {
        for kind in [0x08, 0x09, 0x0c, 0x30] {
            let open = [&[kind, 0x04, 0x05], AT].concat();
            let mut frames = open.clone();
            make_plain(&mut frames);
            assert_eq!(frames, open);
        }
    }

    #[test]
    fn an_invalid_reset_and_what_follows_an_unknown_frame_stay() {
        let beyond_the_end: &[u8] = &[0x24, 0x04, 0x00, 0x03, 0x04];
        for kept in [beyond_the_end, &AT[..AT.len() - 1], &[0x24]] {
            let mut frames = kept.to_vec();
            make_plain(&mut frames);
            assert_eq!(frames, kept);
        }
        // A number of two bytes, and the same kind in more bytes than it needs.
        for unknown in [&[0x40, 0xaf], &[0x40, 0x24]] {
            let kept = [unknown, AT].concat();
            let mut frames = kept.clone();
            make_plain(&mut frames);
            assert_eq!(frames[..2], kept[..2]);
        }
    }

    proptest! {
        #[test]
        fn any_bytes_keep_their_length_and_a_second_pass_changes_nothing(bytes: Vec<u8>) {
            let mut once = bytes.clone();
            make_plain(&mut once);
            prop_assert_eq!(once.len(), bytes.len());
            let mut twice = once.clone();
            make_plain(&mut twice);
            prop_assert_eq!(twice, once);
        }
    }

    /// Numbers of the parameters in their encoding, in order.
    fn numbers(mut parameters: &[u8]) -> Vec<u64> {
        let mut numbers = Vec::new();
        while !parameters.is_empty() {
            numbers.push(VarInt::decode(&mut parameters).unwrap().into_inner());
            let length = VarInt::decode(&mut parameters).unwrap().into_inner();
            parameters = &parameters[usize::try_from(length).unwrap()..];
        }
        numbers
    }

    #[test]
    fn a_client_learns_once_by_each_number_that_resets_may_deliver_a_part() {
        let certificate = Certificate::development(["localhost"]).unwrap();
        let (tls, _) = trust::tls(&Trust::Fingerprint(certificate.fingerprint())).unwrap();
        let name = "localhost".try_into().unwrap();
        let mut client =
            quic::ClientConnection::new(tls, quic::Version::V1, name, Vec::new()).unwrap();
        let nothing = TransportParameters::read(Side::Client, &mut Cursor::new(&[])).unwrap();
        let config = Arc::new(PartialResetConfig::new(certificate.tls()).unwrap());
        let mut server = config.start_session(1, &nothing);
        let mut flight = Vec::new();
        assert!(client.write_hs(&mut flight).is_none());
        assert!(server.handshake_data().is_none());
        assert!(
            server.read_handshake(&flight).unwrap(),
            "the protocol is known"
        );
        let known = server.handshake_data().unwrap();
        let known = known.downcast::<HandshakeData>().unwrap();
        assert_eq!(known.protocol.as_deref(), Some(DRAFT_ALPN));
        assert_eq!(known.server_name.as_deref(), Some("localhost"));
        // Keys of the handshake, and those behind it, each when the bytes before them are written.
        for _ in 0..2 {
            let mut flight = Vec::new();
            assert!(server.write_handshake(&mut flight).is_some());
            client.read_hs(&flight).unwrap();
            client.write_hs(&mut Vec::new());
        }
        let sent = numbers(client.quic_transport_parameters().unwrap());
        for parameter in PARAMETERS {
            let times = sent.iter().filter(|number| **number == parameter).count();
            assert_eq!(times, 1, "{parameter:#x}");
        }
        assert!(server.is_handshaking() && server.next_1rtt_keys().is_some());
    }
}
