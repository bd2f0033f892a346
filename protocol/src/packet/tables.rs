//! The tables of the packets' coder: contexts, expectations, alphabets.
//!
//! Normative (PROTOCOL 5.4). Fitted to recorded motion, of a foreign engine's too; see ARCHITECTURE.md, "tables".

use super::saying::MODE_COUNT;

/// Symbols of a number's alphabet, the escape included.
pub(super) const SYMBOLS: usize = 18;
/// Classes of expectation, four to an octave.
pub(super) const CLASSES: usize = 28;
/// All contexts.
pub(super) const CONTEXTS: usize = contexts::END;

/// Which context a number is said in.
pub(super) mod contexts {
    const GAP: usize = 0;
    const AGE: usize = 2;
    /// Of the age of a carrier's track.
    pub(crate) const CARRIER_AGE: usize = 6;
    const POSITION: usize = 8;
    const TURN: usize = POSITION + 4 * 6 * 5;
    const VELOCITY: usize = TURN + 4 * 6 * 9;
    pub(super) const END: usize = VELOCITY + 2 * 2 * 2 * 5;

    /// How many indices lie between; the first of a packet is one for itself.
    pub(crate) const fn gap(begun: bool) -> usize {
        GAP + begun as usize
    }

    /// An age less one, by the kind of the update's form.
    pub(crate) const fn age(kind: usize) -> usize {
        AGE + kind
    }

    /// Ages fall into six classes.
    pub(crate) const fn age_class(age: u32) -> usize {
        match age {
            0..=1 => 0,
            2 => 1,
            3..=4 => 2,
            5..=10 => 3,
            11..=30 => 4,
            _ => 5,
        }
    }

    /// Of the second and third number of a triple, by what came before them.
    const fn follows(part: usize, sum: u32) -> usize {
        if sum == 0 {
            0
        } else if sum <= part as u32 {
            1
        } else if sum <= 3 * part as u32 {
            2
        } else {
            3
        }
    }

    /// A part of a position.
    pub(crate) const fn position(kind: usize, age: usize, part: usize, sum: u32) -> usize {
        let slot = if part == 0 { 0 } else { 1 + follows(part, sum) };
        POSITION + (kind * 6 + age) * 5 + slot
    }

    /// A part of a turn; `largest` is that of the position before.
    pub(crate) const fn turn(
        kind: usize,
        age: usize,
        part: usize,
        sum: u32,
        largest: u32,
    ) -> usize {
        let slot = if part > 0 {
            follows(part, sum)
        } else if largest == 0 {
            4
        } else if largest < 8 {
            5 + largest.ilog2() as usize
        } else {
            8
        };
        TURN + (kind * 6 + age) * 9 + slot
    }

    /// A part of a linear (triple 2) or angular (triple 3) velocity, of a form that says velocities.
    pub(crate) const fn velocity(
        kind: usize,
        age: usize,
        triple: usize,
        part: usize,
        sum: u32,
    ) -> usize {
        let slot = if part == 0 { 0 } else { 1 + follows(part, sum) };
        let late = (age >= 2) as usize;
        VELOCITY + (((kind / 2) * 2 + late) * 2 + (triple - 2)) * 5 + slot
    }

    /// What is expected after an update of this form: nothing was said yet, the same course, the same with velocities,
    /// another.
    pub(crate) const fn after(mode: usize) -> usize {
        match mode {
            0 => 1,
            1 => 2,
            _ => 3,
        }
    }
}

/// What each context expects when a packet begins, in 1/256.
#[rustfmt::skip]
pub(super) const EXPECTED: [u16; CONTEXTS] = [
    3793, 559, 483, 588, 863, 9085, 142, 170, 351, 268, 260, 516, 1289, 169, 174, 152,
    269, 1373, 145, 157, 124, 298, 1413, 126, 129, 106, 302, 880, 97, 235, 61, 190,
    120, 61, 973, 392, 6062, 107, 138, 146, 129, 207, 1141, 138, 137, 124, 123, 170,
    131, 118, 109, 123, 170, 121, 102, 95, 80, 170, 131, 44, 55, 170, 170, 73,
    103, 170, 170, 170, 215, 261, 226, 376, 1177, 152, 178, 155, 176, 780, 124, 139,
    110, 141, 384, 79, 223, 75, 101, 170, 63, 550, 86, 268, 2, 23, 2812, 154,
    278, 1, 181, 164, 149, 226, 3828, 134, 163, 145, 158, 170, 107, 185, 109, 133,
    170, 101, 172, 122, 82, 768, 114, 90, 102, 345, 170, 469, 445, 367, 643, 1697,
    148, 181, 449, 1023, 197, 138, 255, 546, 1256, 108, 115, 267, 915, 185, 114, 152,
    588, 1474, 95, 98, 293, 955, 167, 94, 132, 694, 1489, 97, 87, 266, 431, 148,
    86, 112, 445, 866, 71, 91, 319, 332, 122, 91, 4, 524, 200, 38, 118, 290,
    283, 119, 108, 18, 541, 339, 117, 125, 169, 491, 179, 127, 124, 170, 576, 125,
    125, 105, 170, 188, 129, 85, 170, 170, 112, 116, 89, 170, 185, 118, 43, 170,
    170, 119, 106, 29, 170, 163, 115, 32, 170, 170, 131, 96, 39, 170, 105, 87,
    170, 170, 170, 219, 219, 170, 170, 170, 73, 170, 170, 170, 163, 146, 238, 828,
    211, 160, 209, 404, 703, 142, 122, 113, 182, 203, 164, 131, 212, 910, 124, 104,
    88, 176, 163, 127, 109, 455, 384, 69, 83, 72, 102, 128, 108, 27, 143, 170,
    108, 77, 45, 73, 57, 98, 191, 210, 2, 28, 41, 38, 102, 80, 217, 185,
    22, 40, 117, 137, 219, 1836, 179, 135, 112, 184, 1233, 125, 120, 107, 170, 180,
    135, 101, 109, 170, 92, 102, 54, 128, 176, 112, 31, 256, 170, 106, 84, 37,
    326, 163, 105, 68, 597, 768, 145, 103, 112, 294, 141, 119, 216, 438, 170, 152,
    240, 525, 1362, 119, 201, 234, 778, 1915, 306, 257, 265, 337, 424, 296, 261, 263,
    340, 467, 152, 120, 125, 269, 342, 128, 130, 111, 175, 155, 285, 287, 280, 326,
    440, 295, 275, 236, 333, 439, 374, 285, 230, 600, 2698, 420, 120, 144, 473, 2368,
];

/// For each class of expectation, where the parts of each symbol begin.
#[rustfmt::skip]
pub(super) const SHAPES: [[u16; SYMBOLS + 1]; CLASSES] = [
    [0, 3962, 4062, 4075, 4079, 4080, 4081, 4082, 4083, 4084, 4085, 4086, 4087, 4088, 4089, 4090, 4091, 4092, 4096],
    [0, 3987, 4079, 4081, 4082, 4083, 4084, 4085, 4086, 4087, 4088, 4089, 4090, 4091, 4092, 4093, 4094, 4095, 4096],
    [0, 3927, 4075, 4081, 4082, 4083, 4084, 4085, 4086, 4087, 4088, 4089, 4090, 4091, 4092, 4093, 4094, 4095, 4096],
    [0, 3870, 4071, 4081, 4082, 4083, 4084, 4085, 4086, 4087, 4088, 4089, 4090, 4091, 4092, 4093, 4094, 4095, 4096],
    [0, 3564, 4001, 4054, 4069, 4077, 4080, 4082, 4083, 4084, 4085, 4086, 4087, 4088, 4089, 4090, 4091, 4092, 4096],
    [0, 3678, 4042, 4078, 4082, 4083, 4084, 4085, 4086, 4087, 4088, 4089, 4090, 4091, 4092, 4093, 4094, 4095, 4096],
    [0, 3227, 3982, 4050, 4069, 4075, 4078, 4081, 4083, 4085, 4086, 4087, 4088, 4089, 4090, 4091, 4092, 4093, 4096],
    [0, 3482, 3995, 4070, 4081, 4083, 4084, 4085, 4086, 4087, 4088, 4089, 4090, 4091, 4092, 4093, 4094, 4095, 4096],
    [0, 2911, 3978, 4054, 4071, 4077, 4081, 4083, 4085, 4086, 4087, 4088, 4089, 4090, 4091, 4092, 4093, 4094, 4096],
    [0, 2663, 3970, 4054, 4073, 4080, 4083, 4085, 4086, 4087, 4088, 4089, 4090, 4091, 4092, 4093, 4094, 4095, 4096],
    [0, 2541, 3970, 4056, 4073, 4080, 4083, 4085, 4086, 4087, 4088, 4089, 4090, 4091, 4092, 4093, 4094, 4095, 4096],
    [0, 2420, 3947, 4050, 4071, 4079, 4083, 4085, 4086, 4087, 4088, 4089, 4090, 4091, 4092, 4093, 4094, 4095, 4096],
    [0, 2269, 3895, 4036, 4065, 4077, 4082, 4085, 4086, 4087, 4088, 4089, 4090, 4091, 4092, 4093, 4094, 4095, 4096],
    [0, 2076, 3780, 3998, 4050, 4069, 4078, 4083, 4085, 4087, 4088, 4089, 4090, 4091, 4092, 4093, 4094, 4095, 4096],
    [0, 1928, 3627, 3939, 4024, 4057, 4071, 4078, 4082, 4085, 4087, 4088, 4089, 4090, 4091, 4092, 4093, 4094, 4096],
    [0, 1814, 3432, 3847, 3983, 4037, 4058, 4070, 4077, 4081, 4084, 4087, 4088, 4089, 4090, 4091, 4092, 4093, 4096],
    [0, 1683, 3193, 3718, 3923, 4006, 4040, 4057, 4068, 4075, 4080, 4083, 4085, 4087, 4088, 4089, 4090, 4091, 4096],
    [0, 1528, 2917, 3528, 3818, 3943, 4000, 4032, 4053, 4065, 4074, 4079, 4083, 4085, 4087, 4088, 4089, 4090, 4096],
    [0, 1514, 2715, 3340, 3671, 3840, 3932, 3983, 4015, 4037, 4052, 4061, 4068, 4073, 4077, 4079, 4081, 4083, 4096],
    [0, 1381, 2487, 3136, 3505, 3721, 3843, 3918, 3966, 3999, 4021, 4035, 4046, 4053, 4059, 4064, 4068, 4071, 4096],
    [0, 1125, 2106, 2926, 3318, 3575, 3743, 3848, 3919, 3964, 3995, 4016, 4031, 4041, 4050, 4056, 4061, 4065, 4096],
    [0, 973, 1903, 2575, 3038, 3360, 3572, 3722, 3830, 3894, 3948, 3981, 4005, 4021, 4037, 4047, 4055, 4061, 4096],
    [0, 1027, 1857, 2458, 2900, 3229, 3458, 3619, 3740, 3829, 3888, 3934, 3968, 3993, 4012, 4026, 4037, 4046, 4096],
    [0, 704, 1488, 2104, 2572, 2969, 3254, 3448, 3608, 3716, 3798, 3859, 3908, 3941, 3969, 3991, 4009, 4021, 4096],
    [0, 761, 1394, 1896, 2295, 2822, 3116, 3314, 3463, 3578, 3673, 3750, 3806, 3848, 3879, 3905, 3927, 3944, 4096],
    [0, 643, 1181, 1663, 2029, 2360, 2884, 3125, 3274, 3415, 3540, 3640, 3709, 3765, 3811, 3847, 3878, 3907, 4096],
    [0, 745, 1195, 1554, 1879, 2151, 2384, 2961, 3123, 3263, 3433, 3550, 3626, 3686, 3740, 3780, 3810, 3839, 4096],
    [0, 1603, 2066, 2348, 2568, 2754, 2915, 3050, 3145, 3264, 3417, 3515, 3570, 3625, 3677, 3713, 3741, 3758, 4096],
];

/// By the form of the update before, where the parts of each form begin, and of the taking of a seat.
#[rustfmt::skip]
pub(super) const MODES: [[u16; MODE_COUNT + 2]; 4] = [
    [0, 3524, 3709, 3793, 3875, 3939, 4009, 4028, 4029, 4030, 4031, 4032, 4056, 4070, 4096],
    [0, 3504, 3728, 3814, 3891, 3946, 3994, 4031, 4032, 4033, 4034, 4035, 4063, 4084, 4096],
    [0, 2697, 3479, 3677, 3760, 3900, 3942, 4071, 4072, 4073, 4074, 4075, 4079, 4092, 4096],
    [0, 2395, 2745, 2962, 3090, 3203, 3432, 3531, 3532, 3533, 3534, 3535, 3552, 3855, 4096],
];

/// The tables as the specification prints them.
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub struct Tables {
    /// What each context expects when a packet begins, in 1/256.
    pub expected: &'static [u16],
    /// For each class, where the parts of each symbol begin, and their end.
    pub shapes: &'static [[u16; SYMBOLS + 1]],
    /// For each form of the update before, where the parts of each code begin, and their end.
    pub modes: &'static [[u16; MODE_COUNT + 2]],
}

impl Tables {
    /// What both ends go by.
    pub const ALL: Self = Self {
        expected: &EXPECTED,
        shapes: &SHAPES,
        modes: &MODES,
    };
}
