//! A client of web-transport-quinn: one trial of a server, printed as JSON.
//!
//! Usage: web_client TRIAL ADDRESS HASH HELLO CREATE JOIN MALFORMED, messages as hexadecimal digits. `tests/webtransport/run`
//! asks for it. The version of the package is that of the lock file.

use std::error::Error;
use std::io::Write;
use std::net::Ipv4Addr;
use std::sync::Arc;
use std::time::Duration;

use quinn::crypto::rustls::QuicClientConfig;
use rhumb_link::Trust;
use rhumb_link::trust::client_tls;
use web_transport_quinn::http::HeaderValue;
use web_transport_quinn::http::header::ORIGIN;
use web_transport_quinn::proto::ConnectRequest;
use web_transport_quinn::{RecvStream, SendStream, Session, SessionError, WebTransportError};

type Failure = Box<dyn Error>;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut saw = Vec::new();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    let limit = Duration::from_secs(10);
    let tried = async { tokio::time::timeout(limit, attempt(&arguments, &mut saw)).await };
    if let Err(cause) = runtime.block_on(tried)? {
        saw.push(format!("\"error\": {:?}", cause.to_string()));
    }
    writeln!(std::io::stdout(), "{{{}}}", saw.join(", "))?;
    Ok(())
}

async fn attempt(arguments: &[String], saw: &mut Vec<String>) -> Result<(), Failure> {
    let [trial, address, hash, hello, create, join, malformed] = arguments else {
        return Err("seven arguments are needed".into());
    };
    let tls = client_tls(&Trust::Fingerprint(hash.parse()?))?;
    let mut tls = Arc::unwrap_or_clone(tls);
    tls.alpn_protocols = vec![b"h3".to_vec()];
    let config = quinn::ClientConfig::new(Arc::new(QuicClientConfig::try_from(tls)?));
    let endpoint = quinn::Endpoint::client((Ipv4Addr::LOCALHOST, 0).into())?;
    let connection = endpoint
        .connect_with(config, address.parse()?, "localhost")?
        .await?;
    let (path, origin) = match trial.as_str() {
        "path" => ("/rhumb/2", "http://localhost"),
        "origin" => ("/rhumb/1", "https://pages.example"),
        _ => ("/rhumb/1", "http://localhost"),
    };
    let url = format!("https://{address}{path}").parse::<url::Url>()?;
    let request = ConnectRequest::new(url)
        .with_header(ORIGIN, HeaderValue::from_static(origin))
        .with_protocol("rhumb/1");
    let session = Session::connect(connection, request).await?;
    saw.push("\"status\": 200".into());
    saw.push(format!(
        "\"protocol\": {:?}",
        session.protocol().unwrap_or_default()
    ));
    let (mut send, mut recv) = session.open_bi().await?;
    let welcome = say(&mut send, &mut recv, hello).await?;
    saw.push(format!("\"welcome\": {welcome}"));
    if trial == "session" {
        let created = say(&mut send, &mut recv, create).await?;
        saw.push(format!("\"created\": {created}"));
        let joined = say(&mut send, &mut recv, join).await?;
        saw.push(format!("\"joined\": {joined}"));
        let datagram = session.read_datagram().await?;
        saw.push(format!("\"datagram\": {}", datagram.len()));
        send.write_all(&bytes(malformed)?).await?;
        match session.closed().await {
            SessionError::WebTransportError(WebTransportError::Closed(code, _)) => {
                saw.push(format!("\"closed\": {code}"));
            }
            other => saw.push(format!("\"closed\": {:?}", other.to_string())),
        }
    } else {
        session.close(9, b"done");
        session.closed().await;
        tokio::time::timeout(Duration::from_secs(1), endpoint.wait_idle())
            .await
            .ok();
    }
    Ok(())
}

/// Sends a message; the type of the next one of the server.
async fn say(send: &mut SendStream, recv: &mut RecvStream, message: &str) -> Result<u8, Failure> {
    send.write_all(&bytes(message)?).await?;
    loop {
        let (mut length, mut shift) = (0, 0);
        loop {
            let mut one = [0];
            recv.read_exact(&mut one).await?;
            length |= usize::from(one[0] & 0x7f) << shift;
            shift += 7;
            if one[0] < 0x80 {
                break;
            }
        }
        let mut message = vec![0; length];
        recv.read_exact(&mut message).await?;
        // A type from 0x80 on is of a later version, and means nothing to this one.
        if let Some(kind) = message.first().filter(|kind| **kind < 0x80) {
            return Ok(*kind);
        }
    }
}

fn bytes(digits: &str) -> Result<Vec<u8>, Failure> {
    let pairs = digits.as_bytes().chunks(2);
    pairs
        .map(|pair| Ok(u8::from_str_radix(std::str::from_utf8(pair)?, 16)?))
        .collect()
}
