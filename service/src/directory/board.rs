//! The board in etcd: its keys, and who has which scene.
//!
//! Decides nothing. A notice is a key under the lease of who posts it, so that none outlives its writer. Notices of a later
//! version are passed over.

use rhumb_protocol::scene::SceneName;
use serde_json::{Value, json};

use super::claims::{LeaseId, ServerPlace};
use super::etcd::{Etcd, SCENES, base64, from_base64, is_place, number};
use super::handovers::{Board, Notice};

/// Before the keys of all notices.
const BOARD: &str = "rhumb/board/";
/// Keys of one answer.
const PAGE: usize = 1_000;

/// A key with its value and lease.
struct Entry {
    key: String,
    value: String,
    lease: LeaseId,
}

impl Notice {
    /// Its key behind [`BOARD`], and its value.
    fn key_and_value(&self) -> (String, &str) {
        /// A value says nothing where the key says all; etcd leaves out an empty one.
        const PLAIN: &str = "1";
        match self {
            Self::Server(place) => (format!("server/{}", place.0), PLAIN),
            Self::Drained(place) => (format!("drained/{}", place.0), PLAIN),
            Self::Order(scene, to) => (format!("order/{scene}"), &to.0),
            Self::Standby(scene, by) => (format!("standby/{scene}"), &by.0),
        }
    }
}

impl Board {
    /// Adds a notice; others than ours are passed over, and addresses that no client could read.
    fn add(&mut self, entry: Entry) {
        let of_board = entry.key.strip_prefix(BOARD);
        let Some((kind, name)) = of_board.and_then(|key| key.split_once('/')) else {
            return;
        };
        if !is_place(name) || !is_place(&entry.value) {
            return;
        }
        let (place, value) = (ServerPlace(name.to_owned()), ServerPlace(entry.value));
        match (kind, name.parse::<SceneName>()) {
            ("server", _) => drop(self.servers.insert(place, entry.lease)),
            ("drained", _) => drop(self.drained.insert(place)),
            ("order", Ok(scene)) => drop(self.orders.insert(scene, value)),
            ("standby", Ok(scene)) => drop(self.standbys.insert(scene, value)),
            _ => {}
        }
    }
}

impl Etcd {
    /// A lease of so many seconds; `None` without an answer.
    pub(super) async fn grant(&self, seconds: u64) -> Option<LeaseId> {
        let grant = json!({ "TTL": seconds.to_string() });
        let answer = self.ask("/v3/lease/grant", &grant).await?;
        Some(LeaseId(number(&answer["ID"])?))
    }

    /// Gives a lease its whole time again; false without an answer.
    pub(super) async fn renew(&self, lease: LeaseId) -> bool {
        let renew = json!({ "ID": lease.0.to_string() });
        self.ask("/v3/lease/keepalive", &renew).await.is_some()
    }

    /// Ends a lease, and what it holds; false without an answer.
    pub(super) async fn revoke(&self, lease: LeaseId) -> bool {
        let revoke = json!({ "ID": lease.0.to_string() });
        self.ask("/v3/lease/revoke", &revoke).await.is_some()
    }

    /// All notices; `None` without an answer.
    pub(super) async fn read_board(&self) -> Option<Board> {
        let mut board = Board::default();
        for entry in self.range(BOARD).await? {
            board.add(entry);
        }
        Some(board)
    }

    /// Posts a notice that ends with a lease; false without an answer.
    pub(super) async fn post(&self, lease: LeaseId, notice: &Notice) -> bool {
        let (key, value) = notice.key_and_value();
        let key = base64(format!("{BOARD}{key}").as_bytes());
        let value = base64(value.as_bytes());
        let put = json!({ "key": key, "value": value, "lease": lease.0.to_string() });
        self.ask("/v3/kv/put", &put).await.is_some()
    }

    /// Takes a notice off the board, if it says the same there; false without an answer.
    pub(super) async fn remove(&self, notice: &Notice) -> bool {
        let (key, value) = notice.key_and_value();
        let key = base64(format!("{BOARD}{key}").as_bytes());
        let is_same = json!({ "target": "VALUE", "key": key, "value": base64(value.as_bytes()) });
        let delete = json!({ "request_delete_range": { "key": key } });
        let transaction = json!({ "compare": [is_same], "success": [delete] });
        self.ask("/v3/kv/txn", &transaction).await.is_some()
    }

    /// The scenes that servers have; `None` without an answer.
    pub(super) async fn scenes(&self) -> Option<Vec<(SceneName, ServerPlace)>> {
        let entries = self.range(SCENES).await?.into_iter();
        let scenes = entries.filter_map(|entry| {
            let name = entry.key.strip_prefix(SCENES)?.parse().ok()?;
            Some((name, ServerPlace(entry.value)))
        });
        Some(scenes.collect())
    }

    /// The server that has a scene: `Some(None)` if none has it, `None` without an answer.
    pub(super) async fn owner_of(&self, scene: &SceneName) -> Option<Option<ServerPlace>> {
        let key = format!("{SCENES}{scene}");
        let ask = json!({ "key": base64(key.as_bytes()) });
        let answer = self.ask("/v3/kv/range", &ask).await?;
        let entry = entries(&answer)?.pop();
        Some(entry.map(|entry| ServerPlace(entry.value)))
    }

    /// All keys that begin so.
    async fn range(&self, prefix: &str) -> Option<Vec<Entry>> {
        let mut end = prefix.as_bytes().to_vec();
        // No prefix of ours ends with the last of all bytes.
        if let Some(last) = end.last_mut() {
            *last += 1;
        }
        let (mut all, mut from) = (Vec::new(), prefix.as_bytes().to_vec());
        loop {
            let ask = json!({
                "key": base64(&from), "range_end": base64(&end), "limit": PAGE.to_string(),
            });
            let answer = self.ask("/v3/kv/range", &ask).await?;
            let mut page = entries(&answer)?;
            let last = page.last().map(|entry| entry.key.clone().into_bytes());
            let is_full = page.len() == PAGE;
            all.append(&mut page);
            match last {
                Some(last) if is_full => {
                    from = last;
                    from.push(0);
                }
                _ => return Some(all),
            }
        }
    }
}

/// The keys of an answer; `None` if it is none of etcd.
fn entries(answer: &Value) -> Option<Vec<Entry>> {
    answer.get("header")?;
    let Some(keys) = answer.get("kvs") else {
        return Some(Vec::new());
    };
    let text = |value: &Value| String::from_utf8(from_base64(value.as_str()?)?).ok();
    let entries = keys.as_array()?.iter().map(|entry| {
        Some(Entry {
            key: text(&entry["key"])?,
            value: text(&entry["value"])?,
            lease: LeaseId(number(&entry["lease"]).unwrap_or(0)),
        })
    });
    entries.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_notice_is_read_as_it_was_posted() {
        let (scene, place) = (
            "team/pit".parse::<SceneName>().expect("a name"),
            ServerPlace("rhumb://a:1#00".to_owned()),
        );
        let notices = [
            Notice::Server(place.clone()),
            Notice::Drained(place.clone()),
            Notice::Order(scene.clone(), place.clone()),
            Notice::Standby(scene.clone(), place.clone()),
        ];
        let mut board = Board::default();
        for notice in &notices {
            let (key, value) = notice.key_and_value();
            board.add(Entry {
                key: format!("{BOARD}{key}"),
                value: value.to_owned(),
                lease: LeaseId(7),
            });
        }
        let expected = Board {
            servers: [(place.clone(), LeaseId(7))].into(),
            drained: [place.clone()].into(),
            orders: [(scene.clone(), place.clone())].into(),
            standbys: [(scene, place)].into(),
        };
        assert_eq!(board, expected);
        board.add(Entry {
            key: format!("{BOARD}order/pit"),
            value: "a b".to_owned(),
            lease: LeaseId(7),
        });
        assert_eq!(board, expected, "no client could read the address");
    }

    /// Recorded of etcd 3.4.23.
    #[test]
    fn a_range_without_keys_is_empty_and_no_answer_is_none() {
        let read = |text: &str| {
            let answer = serde_json::from_str(text).expect("it is JSON");
            entries(&answer).map(|entries| entries.len())
        };
        assert_eq!(read(r#"{"header":{"revision":"2"}}"#), Some(0));
        let one =
            r#"{"header":{},"kvs":[{"key":"cmh1bWI=","value":"MQ==","lease":"7"}],"count":"1"}"#;
        assert_eq!(read(one), Some(1));
        assert_eq!(read("{}"), None);
    }
}
