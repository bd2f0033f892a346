//! Encoding of a body's inertia in a scene event.
//!
//! Omitted where it is implied: equal moments, and axes that are the body's own (PROTOCOL 4.6).

use rhumb_reckoning::Inertia;

use crate::wire::Malformed;
use crate::wire::bytes::{Reader, Writer};

/// Encodes the inertia of a body that can rotate torque-free.
pub(super) fn encode_inertia(inertia: Option<&Inertia>, to: &mut Writer) {
    let Some(inertia) = inertia else {
        return to.u8(0);
    };
    assert!(!inertia.is_isotropic(), "equal moments are not encoded");
    let own_axes = bits(inertia.frame()) == bits(Inertia::OWN_AXES);
    to.u8(if own_axes { 1 } else { 2 });
    to.f32s(&inertia.moments());
    if !own_axes {
        to.f32s(&inertia.frame());
    }
}

/// Decodes the inertia of a body that can rotate torque-free.
///
/// # Errors
///
/// [`Malformed`] for an invalid or a redundant inertia.
pub(super) fn decode_inertia(from: &mut Reader<'_>) -> Result<Option<Inertia>, Malformed> {
    let form = from.u8()?;
    let (moments, frame) = match form {
        0 => return Ok(None),
        1 => (from.f32s()?, Inertia::OWN_AXES),
        2 => (from.f32s()?, from.f32s()?),
        _ => return Err(Malformed::UnknownCode),
    };
    let inertia = Inertia::new(moments, frame).map_err(|_| Malformed::OutOfRange)?;
    let is_own_axes = form == 2 && bits(frame) == bits(Inertia::OWN_AXES);
    if inertia.is_isotropic() || is_own_axes {
        return Err(Malformed::NotCanonical);
    }
    Ok(Some(inertia))
}

fn bits(frame: [f32; 4]) -> [u32; 4] {
    frame.map(f32::to_bits)
}

#[cfg(test)]
mod tests {
    use alloc::vec::Vec;

    use super::*;

    fn bytes(form: u8, numbers: &[f32]) -> Vec<u8> {
        let mut writer = Writer::default();
        writer.u8(form);
        numbers.iter().for_each(|number| writer.f32(*number));
        writer.into_bytes()
    }

    fn read(bytes: &[u8]) -> Result<Option<Inertia>, Malformed> {
        let mut reader = Reader::new(bytes);
        let inertia = decode_inertia(&mut reader)?;
        reader.finish()?;
        Ok(inertia)
    }

    #[test]
    fn an_inertia_round_trips() {
        let slab = Inertia::new([1.0, 2.0, 2.5], Inertia::OWN_AXES).unwrap();
        let askew = Inertia::new([1.0, 2.0, 2.5], [0.5, -0.5, 0.5, 0.5]).unwrap();
        for (inertia, length) in [(None, 1), (Some(slab), 13), (Some(askew), 29)] {
            let mut writer = Writer::default();
            encode_inertia(inertia.as_ref(), &mut writer);
            let bytes = writer.into_bytes();
            assert_eq!(bytes.len(), length);
            assert_eq!(read(&bytes), Ok(inertia));
            for cut in 0..length {
                assert_eq!(read(&bytes[..cut]), Err(Malformed::Truncated));
            }
        }
    }

    #[test]
    fn invalid_or_redundant_inertia_is_refused() {
        let own = [1.0, 2.0, 2.5, 0.0, 0.0, 0.0, 1.0];
        assert_eq!(read(&bytes(2, &own)), Err(Malformed::NotCanonical));
        let equal = read(&bytes(1, &[3.0; 3]));
        assert_eq!(equal, Err(Malformed::NotCanonical));
        for wrong in [0.0, -1.0, f32::NAN, f32::INFINITY, 1e-12] {
            let refused = read(&bytes(1, &[1.0, wrong, 2.0]));
            assert_eq!(refused, Err(Malformed::OutOfRange));
        }
        assert_eq!(read(&bytes(3, &own)), Err(Malformed::UnknownCode));
    }
}
