//! A server process with a Unix socket, and clients on both ways.

use rhumb_client::scene::{BodyDesc, Shape};
use rhumb_client::{Client, ClientError, OpenError, PipelineDepth, Trust};

use crate::SERVER;

#[test]
fn a_unix_socket_reaches_the_same_scenes() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("rhumb.sock");
    let path = path.to_str().expect("text");
    let server = SERVER.serve_with("127.0.0.1:0", &["--socket", path]);
    let address = format!("unix:{path}");
    let fingerprint = server.fingerprint;
    let trust = || Trust::Fingerprint(fingerprint);
    let mut near = Client::connect(&address, trust())
        .and_then(|connection| connection.join("near"))
        .expect("the server is there");
    let floor = BodyDesc::fixed(Shape::cuboid(10.0, 0.5, 10.0)).at(0.0, -0.5, 0.0);
    near.add_body(floor).expect("room for a body");
    let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 10.0, 0.0);
    let ball = near.add_body(ball).expect("room for a body");
    for _ in 0..180 {
        near.advance(PipelineDepth::LOCKSTEP)
            .expect("the scene continues");
    }
    let far = Client::connect(&server.address.to_string(), trust())
        .and_then(|connection| connection.join("near"))
        .expect("the server is there");
    let height = |client: &Client| client.view().position(ball).expect("a body").y;
    assert!((height(&near) - 0.5).abs() < 0.1);
    assert!((height(&far) - height(&near)).abs() < 0.1);
    drop(server);
    let ended = near.advance(PipelineDepth::LOCKSTEP);
    assert!(matches!(ended, Err(ClientError::Ended(_))), "{ended:?}");
    let refused = Client::connect(&address, trust()).err();
    assert!(
        matches!(refused, Some(OpenError::Socket { .. })),
        "{refused:?}"
    );
}
