//! All limits of this protocol, with their reasons.

/// Bytes of a header.
pub const HEADER_BYTES: usize = 24;
/// Bytes of one message, header included: a triangle mesh at its limits.
pub const MESSAGE_BYTES_MAX: usize = 40 + 12 * POINTS_MAX + 12 * TRIANGLES_MAX;
/// Points of a mesh, as many as triangles: a closed mesh has half as many, a set of loose triangles three times.
pub const POINTS_MAX: usize = 65_536;
/// Triangles of a mesh: by measurement, building and stepping a larger one takes more than a frame.
pub const TRIANGLES_MAX: usize = 65_536;
/// Posts of a height field: 512 by 512, twice a region of OpenSimulator in each direction.
pub const POSTS_MAX: usize = 512 * 512;
/// Bytes of the text of an error.
pub const TEXT_BYTES_MAX: usize = 256;

const _: () = assert!(48 + 4 * POSTS_MAX <= MESSAGE_BYTES_MAX);
