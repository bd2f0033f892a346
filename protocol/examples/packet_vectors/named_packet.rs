//! A case of the vectors.

/// The name of a case and its datagram.
pub(crate) type NamedPacket = (String, Vec<u8>);
