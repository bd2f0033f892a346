//! Random bytes of the system, for keys.

use std::io;

use ring::rand::{SecureRandom, SystemRandom};

/// Bytes that no other process can guess.
///
/// # Errors
///
/// If the system gives none.
pub fn random_bytes<const N: usize>() -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    let filled = SystemRandom::new().fill(&mut bytes);
    filled.map_err(|_| io::Error::other("the system gives no random bytes"))?;
    Ok(bytes)
}
