//! Connections and attempts of each address, bounded.
//!
//! One address cannot take all connections of a server.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};

use super::tuning::CONNECTIONS_PER_ADDRESS_MAX;

/// Counts connections by address; all clones are one count.
#[derive(Clone, Debug, Default)]
pub(super) struct Addresses {
    counts: Arc<Mutex<BTreeMap<IpAddr, usize>>>,
}

/// The place of one connection; dropping it frees the place.
#[derive(Debug)]
pub(super) struct AddressPlace {
    address: IpAddr,
    addresses: Addresses,
}

impl Addresses {
    /// A place for another connection from this address; `None` if it has as many as it may.
    pub(super) fn take(&self, address: IpAddr) -> Option<AddressPlace> {
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        let count = counts.entry(address).or_insert(0);
        if *count >= CONNECTIONS_PER_ADDRESS_MAX {
            return None;
        }
        *count += 1;
        Some(AddressPlace {
            address,
            addresses: self.clone(),
        })
    }
}

impl Drop for AddressPlace {
    fn drop(&mut self) {
        let counts = &self.addresses.counts;
        let mut counts = counts.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = counts.get_mut(&self.address) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.address);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_address_leaves_places_for_others_and_gets_its_own_back() {
        let addresses = Addresses::default();
        let [one, other] = [1, 2].map(|last| IpAddr::from([127, 0, 0, last]));
        let mut places: Vec<_> = std::iter::from_fn(|| addresses.take(one)).collect();
        assert_eq!(places.len(), CONNECTIONS_PER_ADDRESS_MAX);
        assert!(addresses.take(other).is_some());
        places.pop();
        assert!(addresses.take(one).is_some());
        drop(places);
        assert!(addresses.counts.lock().expect("no panic").is_empty());
    }
}
