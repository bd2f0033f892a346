//! The facts that the page needs to connect, as JSON.

use core::net::{IpAddr, SocketAddr};

use serde::Serialize;

/// A scene that the page offers, whether or not it has begun.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ViewScene {
    /// Its name.
    pub name: String,
    /// The body that the page's keys drive: its index.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub player: Option<u32>,
}

/// `/connect.json`.
#[derive(Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Facts {
    /// Of the server.
    pub(super) version: &'static str,
    /// Address of WebTransport.
    pub(super) url: String,
    /// The same through the relay.
    pub(super) conditioned_url: String,
    /// SHA-256 of each certificate that the server may show, hexadecimal.
    pub(super) certificate_hashes: Vec<String>,
    pub(super) scenes: Vec<ViewScene>,
    /// A token that lets the page observe, if the server asks for tokens.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) token: Option<String>,
}

/// The URL of WebTransport at an address.
pub(super) fn url(listens: SocketAddr, page_host: &str) -> String {
    format!("https://{}:{}/", host(listens, page_host), listens.port())
}

/// The URLs of WebTransport at an address and any port, as a content security policy names them.
pub(super) fn source(listens: SocketAddr, page_host: &str) -> String {
    match host(listens, page_host) {
        // A policy cannot name an address of IPv6, nor a name with an underscore.
        host if host.contains(['[', '_']) => "https:".to_owned(),
        host => format!("https://{host}:*"),
    }
}

/// The host of an address. A server that listens at every address is reached where the page was.
fn host(listens: SocketAddr, page_host: &str) -> String {
    match listens.ip() {
        ip if ip.is_unspecified() => page_host.to_owned(),
        IpAddr::V4(ip) => ip.to_string(),
        IpAddr::V6(ip) => format!("[{ip}]"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_url_is_where_the_server_listens_or_where_the_page_was_reached() {
        let of = |listens: &str| url(listens.parse().unwrap(), "192.0.2.7");
        assert_eq!(of("127.0.0.1:4433"), "https://127.0.0.1:4433/");
        assert_eq!(of("[::1]:4433"), "https://[::1]:4433/");
        assert_eq!(of("0.0.0.0:4433"), "https://192.0.2.7:4433/");
        assert_eq!(of("[::]:4433"), "https://192.0.2.7:4433/");
        let source = |listens: &str| source(listens.parse().unwrap(), "192.0.2.7");
        assert_eq!(source("0.0.0.0:4433"), "https://192.0.2.7:*");
        assert_eq!(source("[::1]:4433"), "https:");
        assert_eq!(
            super::source("0.0.0.0:1".parse().unwrap(), "my_server"),
            "https:"
        );
    }
}
