//! The cores of the caller and of the servers.

use rhumb_server::usable_cores;

/// Cores of the caller and the servers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct CoreAssignment {
    pub(crate) caller: Vec<usize>,
    pub(crate) servers: Vec<usize>,
}

impl CoreAssignment {
    /// The caller on the first core, the servers on the others, if there are at least two.
    pub(crate) fn apart() -> Self {
        match usable_cores().split_first() {
            Some((caller, servers)) if !servers.is_empty() => Self {
                caller: vec![*caller],
                servers: servers.to_vec(),
            },
            _ => Self::default(),
        }
    }

    /// As text, such as `caller 0, servers 1`.
    pub(crate) fn describe(&self) -> String {
        let list = |cores: &[usize]| {
            let cores: Vec<_> = cores.iter().map(usize::to_string).collect();
            cores.join("+")
        };
        match (self.caller.is_empty(), self.servers.is_empty()) {
            (true, true) => "not pinned".to_owned(),
            (true, false) => format!("caller anywhere, servers {}", list(&self.servers)),
            (false, true) => format!("caller {}, servers anywhere", list(&self.caller)),
            (false, false) => format!(
                "caller {}, servers {}",
                list(&self.caller),
                list(&self.servers)
            ),
        }
    }
}
