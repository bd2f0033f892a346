//! Reasons of a failed connection attempt, for the user to act on.
//!
//! Nothing is retried. A refused certificate outranks the alert that QUIC reports for it.

use std::net::SocketAddr;
use std::time::Duration;
use std::{fmt, io};

use quinn::{ConnectionError, TransportErrorCode, rustls};

use crate::trust::{CertificateCheck, CertificateError, Distrust, Fingerprint};

/// Reason of a failed connection attempt.
#[derive(Debug)]
pub enum ConnectError {
    /// Nothing answered in time.
    NothingAnswers {
        /// The server's address.
        server: SocketAddr,
        /// The duration of the attempt.
        timeout: Duration,
    },
    /// The server's certificate is not the pinned one.
    WrongFingerprint {
        /// The server's address.
        server: SocketAddr,
        /// The pinned fingerprint.
        expected: Fingerprint,
        /// The fingerprint of the server's certificate.
        presented: Fingerprint,
    },
    /// No trusted root signed the server's certificate for its name.
    Untrusted {
        /// The server's address.
        server: SocketAddr,
        /// The requested name.
        server_name: String,
        /// The TLS error.
        cause: rustls::Error,
    },
    /// The server speaks another protocol, or another version of this one.
    OtherProtocol {
        /// The server's address.
        server: SocketAddr,
    },
    /// The server refused the attempt: it is full, or stopping.
    Refused {
        /// The server's address.
        server: SocketAddr,
    },
    /// The handshake failed for another reason.
    Handshake {
        /// The server's address.
        server: SocketAddr,
        /// The QUIC error.
        cause: ConnectionError,
    },
    /// The file of trusted roots cannot be used.
    Roots(CertificateError),
    /// The server's name is invalid.
    ServerName {
        /// The name.
        server_name: String,
    },
    /// The server's address cannot be reached from this machine.
    ServerAddress {
        /// The address.
        server: SocketAddr,
        /// The local address of the attempt.
        bind: SocketAddr,
    },
    /// The local socket failed.
    LocalSocket {
        /// The local address.
        bind: SocketAddr,
        /// The system's error.
        cause: io::Error,
    },
    /// The I/O thread cannot start, or failed.
    Thread(io::Error),
    /// The server has several addresses, and none of them led to it: the reason for each, in the order of attempts.
    EachAddress(Vec<Self>),
}

impl ConnectError {
    /// The meaning of a failed handshake, given the verifier's refusal.
    pub fn from_handshake(
        cause: ConnectionError,
        server: SocketAddr,
        server_name: &str,
        certificate_check: &CertificateCheck,
        timeout: Duration,
    ) -> Self {
        match certificate_check.refusal() {
            Some(&Distrust::OtherFingerprint {
                expected,
                presented,
            }) => {
                return ConnectError::WrongFingerprint {
                    server,
                    expected,
                    presented,
                };
            }
            Some(Distrust::Roots(cause)) => {
                let (server_name, cause) = (server_name.to_owned(), cause.clone());
                return ConnectError::Untrusted {
                    server,
                    server_name,
                    cause,
                };
            }
            None => {}
        }
        let no_alpn = TransportErrorCode::crypto(NO_APPLICATION_PROTOCOL);
        match cause {
            ConnectionError::TimedOut => ConnectError::NothingAnswers { server, timeout },
            ConnectionError::VersionMismatch => ConnectError::OtherProtocol { server },
            ConnectionError::TransportError(error) if error.code == no_alpn => {
                ConnectError::OtherProtocol { server }
            }
            ConnectionError::ConnectionClosed(close) if close.error_code == no_alpn => {
                ConnectError::OtherProtocol { server }
            }
            ConnectionError::ConnectionClosed(close)
                if close.error_code == TransportErrorCode::CONNECTION_REFUSED =>
            {
                ConnectError::Refused { server }
            }
            ConnectionError::ApplicationClosed(_) => ConnectError::Refused { server },
            cause => ConnectError::Handshake { server, cause },
        }
    }
}

/// TLS alert for an unknown application protocol. Source: RFC 7301, section 3.2.
const NO_APPLICATION_PROTOCOL: u8 = 120;

impl fmt::Display for ConnectError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NothingAnswers { server, timeout } => write!(
                f,
                "nothing answered at {server} within {timeout:?}: \
                check the address, that the server runs, and that udp passes"
            ),
            Self::WrongFingerprint {
                server,
                expected,
                presented,
            } => write!(
                f,
                "{server} shows another certificate than the pinned one: \
                expected {expected}, presented {presented}; \
                pin the new one if the server's certificate was renewed"
            ),
            Self::Untrusted {
                server,
                server_name,
                cause,
            } => {
                write!(
                    f,
                    "the certificate of {server} is not trusted for the name {server_name}: {cause}"
                )
            }
            Self::OtherProtocol { server } => {
                write!(
                    f,
                    "{server} does not speak rhumb/1: check the port and the server's version"
                )
            }
            Self::Refused { server } => write!(
                f,
                "{server} refused the connection: it is full or stopping, try later"
            ),
            Self::Handshake { server, cause } => {
                write!(f, "the handshake with {server} failed: {cause}")
            }
            Self::Roots(cause) => cause.fmt(f),
            Self::ServerName { server_name } => {
                write!(
                    f,
                    "{server_name:?} is not a server name: give a host name or an address"
                )
            }
            Self::ServerAddress { server, bind } => {
                write!(
                    f,
                    "{server} cannot be reached from {bind}: check its port and family"
                )
            }
            Self::LocalSocket { bind, cause } => {
                write!(f, "cannot open a local udp socket at {bind}: {cause}")
            }
            Self::Thread(cause) => write!(f, "the client's i/o thread failed: {cause}"),
            Self::EachAddress(errors) => {
                write!(f, "none of {} addresses leads to the server", errors.len())?;
                errors.iter().try_for_each(|error| write!(f, "; {error}"))
            }
        }
    }
}

impl std::error::Error for ConnectError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Untrusted { cause, .. } => Some(cause),
            Self::Handshake { cause, .. } => Some(cause),
            Self::Roots(cause) => Some(cause),
            Self::LocalSocket { cause, .. } | Self::Thread(cause) => Some(cause),
            _ => None,
        }
    }
}
