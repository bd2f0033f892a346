//! TLS of a server that allows its peers resets with partial delivery.
//!
//! QUIC's library has neither the transport parameter nor the frame. Both pass through its TLS side, which is replaceable:
//! this one adds the parameter to those that the library sends, and hands it each packet with plain resets. All else is
//! as in the library's own. Invariant: only packets behind the handshake are changed, since none before has such a frame.

use std::any::Any;
use std::io::Cursor;
use std::sync::Arc;

use bytes::BytesMut;
use quinn::crypto::rustls::{HandshakeData, NoInitialCipherSuite, QuicServerConfig};
use quinn::crypto::{
    CryptoError, ExportKeyingMaterialError, HeaderKey, KeyPair, Keys, PacketKey, ServerConfig,
    Session, UnsupportedVersion,
};
use quinn::rustls;
use quinn::{ConnectionId, Side, TransportErrorCode, VarInt};
use quinn_proto::TransportError;
use quinn_proto::coding::Codec;
use quinn_proto::transport_parameters::TransportParameters;
use rustls::pki_types::CertificateDer;
use rustls::quic;

use super::reset_stream_at::{PARAMETERS, make_plain};

/// The TLS configuration of such a server.
pub(super) struct PartialResetConfig {
    library: Arc<QuicServerConfig>,
    tls: Arc<rustls::ServerConfig>,
}

impl PartialResetConfig {
    /// # Errors
    ///
    /// The provider has no initial cipher suite.
    pub(super) fn new(tls: Arc<rustls::ServerConfig>) -> Result<Self, NoInitialCipherSuite> {
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
    use super::super::certificate::Certificate;
    use super::super::trust::{self, Trust};
    use super::super::tuning::DRAFT_ALPN;
    use super::*;

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
