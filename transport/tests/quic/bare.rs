//! Bare ends say what they are told, and tell how it ended.

use std::time::Duration;

use rhumb_transport::{
    BareEnd, BareError, BareLine, BareServer, BareTerms, Certificate, Seen, Trust,
};

const PATIENCE: Duration = Duration::from_secs(10);

fn server(terms: &BareTerms) -> BareServer {
    let certificate = Certificate::development(["localhost"]).expect("a good name");
    let anywhere = "127.0.0.1:0".parse().expect("an address");
    BareServer::listen(anywhere, &certificate, terms).expect("loopback has a free port")
}

fn connect(server: &BareServer, terms: &BareTerms) -> Result<BareLine, BareError> {
    let trust = Trust::Fingerprint(server.fingerprint());
    BareLine::connect(server.address(), "localhost", &trust, terms, PATIENCE)
}

fn pair() -> (BareServer, BareLine, BareLine) {
    let server = server(&BareTerms::default());
    let client = connect(&server, &BareTerms::default()).expect("it is let in");
    let there = server.accept(PATIENCE).expect("somebody came");
    (server, client, there.expect("and shook hands"))
}

/// All bytes of the control stream up to so many.
fn control(line: &mut BareLine, length: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    while bytes.len() < length {
        match line.hear(PATIENCE) {
            Some(Seen::Control(more)) => bytes.extend_from_slice(&more),
            Some(Seen::Opened { both_ways }) => assert!(both_ways),
            other => panic!("{other:?}"),
        }
    }
    bytes
}

#[test]
fn both_ends_say_and_hear_on_both_lanes() {
    let (_server, mut client, mut there) = pair();
    client.open_control();
    client.say(vec![1, 2, 3]);
    assert_eq!(control(&mut there, 3), [1, 2, 3]);
    there.say(vec![4; 100_000]);
    assert_eq!(control(&mut client, 100_000), vec![4; 100_000]);
    assert!(client.datagram(vec![7; 1_150]));
    let came = there.hear(PATIENCE);
    assert_eq!(came, Some(Seen::Datagram(vec![7; 1_150].into())));
}

#[test]
fn a_code_is_seen_as_it_was_given() {
    let (_server, client, mut there) = pair();
    client.close(0x3fff_1234);
    let ended = Some(Seen::Ended(BareEnd::Closed(0x3fff_1234)));
    assert_eq!(there.hear(PATIENCE), ended);
    assert_eq!(there.hear(Duration::ZERO), None);
}

#[test]
fn who_speaks_another_protocol_sees_the_alert() {
    let terms = BareTerms {
        alpn: vec![b"other".to_vec()],
        ..BareTerms::default()
    };
    let server = server(&BareTerms::default());
    match connect(&server, &terms) {
        Err(BareError::Handshake(end)) => assert_eq!(end, BareEnd::Transport(0x178)),
        other => panic!("{other:?}"),
    }
}

#[test]
fn who_reads_no_control_hears_it_later() {
    let (_server, mut client, mut there) = pair();
    client.read_control(false);
    client.open_control();
    client.say(vec![1]);
    assert_eq!(control(&mut there, 1), [1]);
    there.say(vec![9; 10]);
    assert!(there.datagram(vec![8]));
    assert_eq!(client.hear(PATIENCE), Some(Seen::Datagram(vec![8].into())));
    client.read_control(true);
    assert_eq!(control(&mut client, 10), [9; 10]);
}
