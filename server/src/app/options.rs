//! What a server of the paper's protocol leaves to its operator.

/// How clients of the paper's protocol are spoken to. The defaults spare the published plug-in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AppOptions {
    /// How the end of a frame is said.
    pub time_advanced: TimeAdvanced,
    /// Of which bodies the state is said in each frame.
    pub states: States,
    /// How many messages a datagram holds.
    pub datagrams: Datagrams,
}

/// How the end of a frame is said.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TimeAdvanced {
    /// On TCP: it is not lost when a burst of states overflows the client's buffer.
    #[default]
    Tcp,
    /// Behind the states, as the last datagram of a frame.
    Udp,
    /// Not at all: the published plug-in then keeps no list of what it heard, and shows a frame time of zero.
    Never,
}

/// Of which bodies the state is said in each frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum States {
    /// Of each that moves, in every frame.
    All,
    /// Of each that is awake.
    Active,
    /// Of each that is elsewhere than was said last; where it comes to rest it is said again on TCP.
    #[default]
    Changed,
}

/// How many messages a datagram holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Datagrams {
    /// One, as the protocol has it: the published plug-in reads no more.
    #[default]
    Single,
    /// As many as fit 1,472 bytes: for measuring what packing alone would give.
    Packed,
}
