//! Tests of markers: processors, gaps, counts, wrong files.

use super::super::c3d::{BLOCK, KEY, Processor, is_c3d};
use super::*;

/// A file that this test writes: two markers, and two analog values of each frame.
#[derive(Clone, Copy)]
struct Written {
    processor: Processor,
    scale: f64,
    frames: usize,
    /// First and last frame in the header, and in TRIAL if that is there.
    header: (u16, u16),
    trial: Option<(u32, u32)>,
    units: &'static str,
    rate: f64,
    /// The number of markers as one with a point.
    used: Option<f64>,
}

const PLAIN: Written = Written {
    processor: Processor::Intel,
    scale: -1.0,
    frames: 60,
    header: (1, 60),
    trial: None,
    units: "mm",
    rate: 120.0,
    used: None,
};

/// Position of a marker in a frame, millimetres; no marker is there in frames 10 and 11.
fn place(frame: usize, marker: usize) -> [f64; 3] {
    [frame as f64, -250.0 * marker as f64, 1_000.0]
}

impl Written {
    fn word(&self, word: u16) -> [u8; 2] {
        match self.processor {
            Processor::Intel | Processor::Dec => word.to_le_bytes(),
            Processor::Mips => word.to_be_bytes(),
        }
    }

    fn number(&self, number: f64) -> [u8; 4] {
        let number = number as f32;
        match self.processor {
            Processor::Intel => number.to_le_bytes(),
            Processor::Mips => number.to_be_bytes(),
            Processor::Dec => {
                let [a, b, c, d] = (number * 4.0).to_le_bytes();
                [c, d, a, b]
            }
        }
    }

    fn parameters(&self) -> Vec<u8> {
        let mut all = vec![1, KEY, 2];
        all.push(match self.processor {
            Processor::Intel => 84,
            Processor::Dec => 85,
            Processor::Mips => 86,
        });
        let mut record = |group: i8, name: &str, body: &[u8]| {
            all.push(name.len() as u8);
            all.push(group.cast_unsigned());
            all.extend(name.bytes());
            all.extend(self.word(body.len() as u16 + 2));
            all.extend(body);
        };
        // A parameter may come before its group.
        let scalar = |kind: i8, data: &[u8]| [&[kind.cast_unsigned(), 0][..], data, &[0]].concat();
        match self.used {
            None => record(1, "USED", &scalar(2, &self.word(2))),
            Some(used) => record(1, "USED", &scalar(4, &self.number(used))),
        }
        record(-1, "POINT", &[0]);
        record(1, "SCALE", &scalar(4, &self.number(self.scale)));
        record(1, "RATE", &scalar(4, &self.number(self.rate)));
        record(1, "DATA_START", &scalar(2, &self.word(4)));
        let units = [
            &[255, 1, self.units.len() as u8][..],
            self.units.as_bytes(),
            &[0],
        ]
        .concat();
        record(1, "UNITS", &units);
        record(
            1,
            "LABELS",
            &[&[255, 2, 4, 2][..], b"LASIRKNE", &[0]].concat(),
        );
        if let Some((first, last)) = self.trial {
            record(-2, "TRIAL", &[0]);
            for (name, field) in [("ACTUAL_START_FIELD", first), ("ACTUAL_END_FIELD", last)] {
                let halves = [self.word(field as u16), self.word((field >> 16) as u16)].concat();
                record(2, name, &[&[2, 1, 2][..], &halves, &[0]].concat());
            }
        }
        all.push(0);
        all
    }

    fn bytes(&self) -> Vec<u8> {
        let mut all = vec![2, KEY];
        for word in [2, 2, self.header.0, self.header.1, 10] {
            all.extend(self.word(word));
        }
        all.extend(self.number(self.scale));
        all.extend(self.word(4));
        all.extend(self.word(1));
        all.extend(self.number(self.rate));
        all.resize(BLOCK, 0);
        all.extend(self.parameters());
        all.resize(3 * BLOCK, 0);
        let mut put = |number: f64| match self.scale > 0.0 {
            true => all.extend(self.word(((number / self.scale) as i16).cast_unsigned())),
            false => all.extend(self.number(number)),
        };
        for frame in 0..self.frames {
            for marker in 0..2 {
                let is_missing = (10..12).contains(&frame);
                let [x, y, z] = place(frame, marker);
                [x, y, z].into_iter().for_each(&mut put);
                put(if is_missing { -self.scale.abs() } else { 0.0 });
            }
            put(1.0);
            put(2.0);
        }
        all.resize(all.len().next_multiple_of(BLOCK), 0);
        all
    }
}

fn plain(bytes: &[u8]) -> Recording {
    read_c3d("walk", bytes, &ReadOptions::default()).expect("a C3D file")
}

fn refused(bytes: &[u8], options: &ReadOptions) -> String {
    read_c3d("walk", bytes, options)
        .expect_err("no C3D file")
        .to_string()
}

#[test]
fn numbers_of_all_processors_are_read_whole_or_with_a_point() {
    for processor in [Processor::Intel, Processor::Dec, Processor::Mips] {
        for scale in [-1.0, 0.5] {
            let written = Written {
                processor,
                scale,
                ..PLAIN
            };
            let bytes = written.bytes();
            assert!(is_c3d(&bytes));
            let recording = plain(&bytes);
            assert_eq!((recording.ticks(), recording.truth.placed.len()), (59, 2));
            assert_eq!(recording.integrator.rate.ticks(), 120);
            for (frame, row) in (1..).zip(&recording.truth.ticks) {
                assert_eq!(row.len(), 2, "{frame}: two missing frames are filled");
                for (marker, observation) in row.iter().enumerate() {
                    let [x, y, z] = place(frame, marker).map(|mm| (mm / 1_000.0) as f32);
                    let [px, py, pz] = observation.motion.position();
                    let off = (px - x).abs() + (py - y).abs() + (pz - z).abs();
                    assert!(off < 1e-6, "{processor:?} {scale} {frame}: {off}");
                }
            }
        }
    }
}

#[test]
fn a_marker_without_numbers_or_with_a_residual_below_zero_is_missing() {
    let mut bytes = PLAIN.bytes();
    // The second marker has no number from frame 30 on, which is no gap that is filled.
    for frame in 30..60 {
        let at = 3 * BLOCK + frame * 40 + 16;
        bytes[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    }
    let recording = plain(&bytes);
    let removed: Vec<u64> = recording
        .truth
        .removed
        .iter()
        .map(|(tick, _)| tick.value())
        .collect();
    assert_eq!(removed, [29]);
    let lost = PLAIN.bytes().len();
    for frame in 0..60 {
        let at = 3 * BLOCK + frame * 40 + 16;
        bytes[at..at + 4].copy_from_slice(&f32::INFINITY.to_le_bytes());
    }
    assert_eq!(bytes.len(), lost);
    let recording = plain(&bytes);
    let said = recording
        .notes
        .iter()
        .any(|note| note.contains("missing in all frames: RKNE"));
    assert!(
        said && recording.truth.placed.len() == 1,
        "{:?}",
        recording.notes
    );
}

#[test]
fn frames_beyond_sixteen_bits_are_counted_by_trial_or_by_the_file() {
    let long = Written {
        frames: 66_000,
        header: (1, 65_535),
        ..PLAIN
    };
    let stated = Written {
        trial: Some((1, 66_000)),
        ..long
    };
    assert_eq!(plain(&stated.bytes()).ticks(), 65_999);
    let recording = plain(&long.bytes());
    assert_eq!(
        recording.ticks(),
        65_999,
        "zeros that fill the last block are no frames"
    );
    let said = recording
        .notes
        .iter()
        .any(|note| note.contains("holds 66000 frames"));
    assert!(said, "{:?}", recording.notes);
    // Numbers that begin elsewhere.
    let later = Written {
        trial: Some((500, 559)),
        ..PLAIN
    };
    assert_eq!(plain(&later.bytes()).ticks(), 59);
}

#[test]
fn the_unit_is_the_file_s_unless_the_caller_states_one() {
    let metres = |units, unit| {
        let written = Written { units, ..PLAIN };
        let options = ReadOptions {
            unit,
            ..ReadOptions::default()
        };
        let read = read_c3d("walk", &written.bytes(), &options);
        read.map(|recording| recording.truth.placed[0].observation.motion.position()[2])
    };
    assert_eq!(metres("mm", None).expect("known"), 1.0);
    assert_eq!(metres("cm", None).expect("known"), 10.0);
    assert_eq!(metres("", Some(Metres::new(0.002))).expect("stated"), 2.0);
    let unknown = metres("ell", None).expect_err("unknown").to_string();
    assert!(
        unknown.contains("\"ell\"") && unknown.contains("--unit mm"),
        "{unknown}"
    );
    let none = metres("", None).expect_err("none").to_string();
    assert!(none.contains("does not say the unit"), "{none}");
}

#[test]
fn a_rate_in_single_precision_is_that_of_the_camera() {
    let written = Written {
        rate: 59.94,
        ..PLAIN
    };
    let rate = plain(&written.bytes()).integrator.rate;
    assert_eq!((rate.ticks(), rate.seconds()), (2_997, 50));
    for (rate, words) in [
        (0.0, "POINT:RATE"),
        (f64::NAN, "POINT:RATE"),
        (
            5_000.0,
            "is the step of no rate from 1 to 1000 Hz: --rate HZ",
        ),
    ] {
        let said = refused(&Written { rate, ..PLAIN }.bytes(), &ReadOptions::default());
        assert!(said.contains(words), "{said}");
    }
}

#[test]
fn a_cut_file_is_refused_with_the_byte_or_the_frame() {
    let bytes = PLAIN.bytes();
    let whole = 3 * BLOCK + 60 * 40;
    for length in 2..whole {
        let said = refused(&bytes[..length], &ReadOptions::default());
        let is_placed = said.contains("byte ") || said.contains("of the 60 frames");
        assert!(is_placed, "{length}: {said}");
    }
    assert_eq!(plain(&bytes[..whole]).ticks(), 59);
}

#[test]
fn wrong_counts_and_numbers_are_refused_by_name() {
    let none = ReadOptions::default();
    for (at, byte, words) in [
        (BLOCK + 3, 7, "processor 7"),
        // The offset from the first parameter to the next.
        (BLOCK + 10, 1, "does not lead on"),
        // The number of markers.
        (BLOCK + 15, 255, "frames that it counts"),
        (BLOCK + 14, 0, "needs two frames"),
        // The last frame of the header.
        (9, 200, "of the 51260 frames"),
    ] {
        let mut bytes = PLAIN.bytes();
        bytes[at] = byte;
        let said = refused(&bytes, &none);
        assert!(said.contains(words), "{at}: {words}: {said}");
    }
    let scale = Written {
        scale: f64::NAN,
        ..PLAIN
    };
    assert!(refused(&scale.bytes(), &none).contains("POINT:SCALE"));
}

#[test]
fn a_count_that_is_none_is_refused_before_it_is_multiplied() {
    let used = |used| Written {
        used: Some(used),
        ..PLAIN
    };
    assert_eq!(plain(&used(2.0).bytes()).truth.placed.len(), 2);
    for (count, said_as) in [
        (1e19, "9.999999980506448e18"),
        (131_073.0, "131073.0"),
        (-1.0, "-1.0"),
        (1.5, "1.5"),
        (f64::NAN, "NaN"),
        (f64::INFINITY, "inf"),
    ] {
        let said = refused(&used(count).bytes(), &ReadOptions::default());
        let words = format!(
            "parameter POINT:USED is {said_as}, and has to be a whole number from 0 to 131072"
        );
        assert!(said.contains(&words), "{words}: {said}");
    }
}

#[test]
fn a_header_that_counts_no_frames_is_not_said_to_be_full() {
    let none = Written {
        header: (1, 0),
        ..PLAIN
    };
    let recording = plain(&none.bytes());
    let notes = recording.notes.join("; ");
    let words = "the header has the frames from 1 to 0, which are none; the file holds 60 frames";
    assert!(
        notes.contains(words) && !notes.contains("cannot count"),
        "{notes}"
    );
}

#[test]
fn no_byte_makes_a_reader_panic() {
    let whole = Written {
        frames: 4,
        header: (1, 4),
        trial: Some((1, 4)),
        ..PLAIN
    };
    let whole = whole.bytes();
    let unit = ReadOptions {
        unit: Some(Metres::new(0.001)),
        ..ReadOptions::default()
    };
    for at in 0..whole.len() {
        for byte in [0, 1, 127, 128, 255] {
            let mut bytes = whole.clone();
            bytes[at] = byte;
            if let Err(error) = read_c3d("walk", &bytes, &unit) {
                assert!(!error.to_string().is_empty());
            }
        }
    }
}
