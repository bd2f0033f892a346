//! The face of an edge to owners.
//!
//! A connection belongs to a mirror or a voice: its input goes there, and their output goes out over it.

use bytes::Bytes;
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Transmit, Wake};

use super::OwnerSide;
use crate::mirror::Mirror;
use crate::owners::{LinkUse, to_link};
use crate::voice::Voice;

impl Endpoint for OwnerSide<'_> {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        let opened = |mirror: &mut Mirror| mirror.handle_opened(now);
        self.0.heed(now, peer, opened, Voice::handle_opened);
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        let of_voice = |voice: &mut Voice| voice.handle_control(bytes);
        let of_mirror = |mirror: &mut Mirror| mirror.handle_control(now, bytes);
        self.0.heed(now, from, of_mirror, of_voice);
    }

    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        let shared = || Bytes::copy_from_slice(bytes);
        let of_mirror = |mirror: &mut Mirror| mirror.handle_datagram(now, shared());
        let of_voice = |voice: &mut Voice| voice.handle_datagram(bytes);
        self.0.heed(now, from, of_mirror, of_voice);
    }

    fn handle_ended(&mut self, now: Instant, peer: Peer, ending: Ending) {
        let of_mirror = |mirror: &mut Mirror| mirror.handle_ended(now, ending);
        let of_voice = |voice: &mut Voice| voice.handle_ended(ending);
        self.0.heed(now, peer, of_mirror, of_voice);
        if let Some(LinkUse::Mirror(id)) = self.0.owners.links.remove(&peer)
            && !self.0.owners.note_mirror_end(now, id, ending)
            && let Some(mirror) = self.0.owners.get(id)
        {
            // Clients that wait for it have to come again.
            let of = (&mirror.scene, mirror.choice);
            self.0.clients.turn_away(of, &mut self.0.out);
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.0.wake(now);
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        self.0.owners.poll_transmit().or_else(|| {
            let clients = self.0.clients.by_peer.values_mut();
            let mut voices = clients.filter_map(|client| client.voice.as_mut());
            voices.find_map(|voice| {
                let transmit = voice.poll_transmit()?;
                Some(to_link(transmit, voice.link()))
            })
        })
    }

    fn poll_timeout(&self) -> Option<Wake> {
        self.0.next_wake()
    }
}
