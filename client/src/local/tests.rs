//! Servers of this process: bounds on the bytes of their clients.

use super::*;

#[test]
fn bytes_for_a_client_that_does_not_poll_count_as_taken_up_to_a_bound() {
    let client = LocalClient::new(Arc::default(), Arc::default(), None);
    let half = Bytes::from(vec![0; TAKEN_BYTES_MAX / 2]);
    let puts = [client.put(&half), client.put(&half), client.put(&half)];
    assert_eq!(puts, [half.len(), half.len(), 0]);
    // The client takes the first piece: those bytes were counted, so others count for them.
    assert_eq!(client.bytes.take(half.len()), half.len());
    assert_eq!(client.bytes.take(half.len()), 0);
    assert_eq!(client.put(&half), half.len());
}

#[test]
fn a_client_that_floods_is_held_back_or_ended_and_no_other_is() {
    let (sender, inputs) = channel();
    let host = Host::Thread(InputQueue::new(sender));
    let [mut flood, own] = [1, 2].map(|peer| LocalConnection::open(host.clone(), Peer(peer), None));
    let piece = Bytes::from(vec![0; 64 << 10]);
    let mut sent = 0;
    while flood.wants_control() {
        flood.send_control(piece.clone());
        sent += 1;
    }
    assert_eq!(sent, CARRIED_BYTES_MAX / piece.len());
    // Datagrams beyond a bound are lost; control bytes beyond one end the client that does not stop.
    for _ in 0..2 * WAITING_STATE_BYTES_MAX / piece.len() {
        flood.send_state(piece.clone());
    }
    assert!(flood.waiting_state.load(Ordering::Relaxed) <= WAITING_STATE_BYTES_MAX);
    for _ in 0..WAITING_BYTES_MAX / piece.len() {
        flood.send_control(piece.clone());
    }
    let ended = flood.recv(Duration::ZERO);
    let overflow = Ending::Closed(TransportCode::CONTROL_OVERFLOW.0);
    assert_eq!(ended, Some(Received::Ended(overflow)));
    assert!(own.wants_control());
    own.send_control(piece);
    assert!(!own.inbox.has_ended());
    // Bytes that the server has taken no longer count.
    drop(inputs.try_iter().collect::<Vec<_>>());
    let waiting = [&flood, &own].map(|of| of.waiting_control.load(Ordering::Relaxed));
    assert_eq!(waiting, [0, 0]);
}

#[test]
fn bytes_count_as_long_as_they_exist_up_to_a_bound() {
    let waiting: Arc<AtomicUsize> = Arc::default();
    let count = || waiting.load(Ordering::Relaxed);
    let piece = Bytes::from(vec![0; 100]);
    let most = 2 * cost(&piece);
    let take = || CountedBytes::within(most, &waiting, piece.clone());
    let kept = [take(), take()];
    assert!(take().is_none(), "a third one is beyond the bound");
    assert_eq!(count(), most);
    drop(kept);
    assert_eq!(count(), 0);
    assert!(take().is_some_and(|bytes| bytes.as_ref() == &piece[..]));
}
