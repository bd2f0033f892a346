//! Options of the APP server for its operator.

/// Options of sending to APP clients. The defaults protect the published plug-in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AppOptions {
    /// Transport of the end of a frame.
    pub time_advanced: TimeAdvanced,
    /// Bodies whose state is sent in each frame.
    pub states: States,
    /// Messages per datagram.
    pub datagrams: Datagrams,
}

/// Transport of the end of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TimeAdvanced {
    /// TCP: the message is not lost when a burst of states overflows the client's buffer.
    #[default]
    Tcp,
    /// UDP: the last datagram of a frame, after its states.
    Udp,
    /// None: the published plug-in then keeps no list of received states, and shows a frame time of zero.
    Never,
}

/// Bodies whose state is sent in each frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum States {
    /// Every body that can move.
    All,
    /// Every body that is awake.
    Active,
    /// Every body that has moved since its last sent state; a body that comes to rest is sent again on TCP.
    #[default]
    Changed,
}

/// Messages per datagram.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Datagrams {
    /// One, as the protocol has it: the published plug-in reads no more.
    #[default]
    Single,
    /// As many as fit 1,472 bytes: to measure the effect of packing alone.
    Packed,
}
