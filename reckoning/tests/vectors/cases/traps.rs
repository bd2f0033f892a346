//! Cases of bare arithmetic, each with the results of known ways to break it.
//!
//! Every wrong result differs from the right one, so that a check that fails can name the trap. Operands are plain
//! decimals that were found by search.

use crate::document::CaseJson;

/// A wrong result, and the trap that leads to it.
type Trap = (&'static str, f64);

const FUSED: &str = "fused multiply-add";
const RECIPROCAL: &str = "multiplied by a reciprocal";
const REORDERED: &str = "reordered";
const EXTENDED: &str = "extended precision";
const SINGLE: &str = "single precision";
const FLUSHED: &str = "subnormal flushed to zero";
const ROUNDED: &str = "a library's rounding";
const NEGATED: &str = "negation as a subtraction from zero";

/// The whole section.
pub(super) fn traps() -> Vec<CaseJson> {
    let mut cases = Vec::new();
    cases.extend(PRODUCTS.map(product_and_sum));
    cases.extend(SQUARES.map(sum_of_squares));
    cases.extend(DIFFERENCES.map(difference_of_products));
    cases.extend(QUOTIENTS.map(quotient));
    cases.extend([sum_of_three(), halfway_sum(), subnormal_product()]);
    cases.extend([root(), negation(), decimal()]);
    cases.extend([-0.5, 0.5, -1.5, 0.499_999_999_999_999_94].map(nearest));
    cases
}

fn case(formula: &str, operands: &[f64], result: f64, traps: &[Trap]) -> CaseJson {
    // Of traps with one result the first is named.
    let (mut names, mut wrong) = (Vec::new(), Vec::<f64>::new());
    for (name, value) in traps {
        let is_same = |other: &f64| other.to_bits() == value.to_bits();
        if !is_same(&result) && !wrong.iter().any(is_same) {
            names.push(*name);
            wrong.push(*value);
        }
    }
    assert!(!wrong.is_empty(), "{formula}: no trap shows");
    CaseJson::new()
        .text("formula", formula)
        .doubles("operands", operands)
        .doubles("result", &[result])
        .texts("traps", &names)
        .doubles("wrong", &wrong)
}

/// Products that are not exact, so that one rounding differs from two.
const PRODUCTS: [[f64; 3]; 3] = [
    [1.1, 1.1, -1.21],
    [0.1, 0.3, 0.016_666_666_666_666_666],
    [0.1, 1.3, 1.1],
];

fn product_and_sum([a, b, c]: [f64; 3]) -> CaseJson {
    let single = f64::from(a as f32 * b as f32 + c as f32);
    case(
        "a*b + c",
        &[a, b, c],
        a * b + c,
        &[(FUSED, a.mul_add(b, c)), (SINGLE, single)],
    )
}

const SQUARES: [[f64; 3]; 3] = [[0.1, 0.3, 0.123], [0.1, 1.7, 2.3], [0.9, 1.1, 1.3]];

fn sum_of_squares([a, b, c]: [f64; 3]) -> CaseJson {
    let traps = [
        (FUSED, c.mul_add(c, b.mul_add(b, a * a))),
        (FUSED, c.mul_add(c, a * a + b * b)),
        (FUSED, b.mul_add(b, a * a) + c * c),
        (FUSED, c.mul_add(c, a.mul_add(a, b * b))),
        (FUSED, a.mul_add(a, b * b) + c * c),
        (REORDERED, a * a + (b * b + c * c)),
    ];
    case("a*a + b*b + c*c", &[a, b, c], a * a + b * b + c * c, &traps)
}

const DIFFERENCES: [[f64; 4]; 2] = [
    [0.1, 0.3, 1.1, 0.016_666_666_666_666_666],
    [0.1, 0.3, 0.016_666_666_666_666_666, 1.7],
];

fn difference_of_products([a, b, c, d]: [f64; 4]) -> CaseJson {
    let traps = [
        (FUSED, a.mul_add(b, -(c * d))),
        (FUSED, (-c).mul_add(d, a * b)),
    ];
    case("a*b - c*d", &[a, b, c, d], a * b - c * d, &traps)
}

const QUOTIENTS: [[f64; 2]; 2] = [[0.1, 3.9], [0.7, 0.9]];

fn quotient([a, b]: [f64; 2]) -> CaseJson {
    case("a / b", &[a, b], a / b, &[(RECIPROCAL, a * (1.0 / b))])
}

fn sum_of_three() -> CaseJson {
    let [a, b, c] = [1e16, -1e16, 1.5];
    case(
        "a + b + c",
        &[a, b, c],
        a + b + c,
        &[(REORDERED, a + (b + c))],
    )
}

/// Two roundings, to 64 bits and then to 53, lead to the other neighbour.
fn halfway_sum() -> CaseJson {
    let [a, b] = [1.0, f64::EPSILON / 2.0 + f64::EPSILON / 8_192.0];
    case("a + b", &[a, b], a + b, &[(EXTENDED, a)])
}

fn subnormal_product() -> CaseJson {
    let [a, b] = [1e-160, 3e-160];
    case("a * b", &[a, b], a * b, &[(FLUSHED, 0.0)])
}

fn root() -> CaseJson {
    let a = 0.7_f64;
    let reciprocal = a * (1.0 / a.sqrt());
    let single = f64::from((a as f32).sqrt());
    case(
        "sqrt(a)",
        &[a],
        a.sqrt(),
        &[(RECIPROCAL, reciprocal), (SINGLE, single)],
    )
}

fn negation() -> CaseJson {
    case("-a", &[0.0], -0.0, &[(NEGATED, 0.0)])
}

/// An f32 that is widened, as 1.2 of RECKONING demands; its decimal is another double.
fn decimal() -> CaseJson {
    let a = f64::from(0.1_f32);
    case(
        "a * b",
        &[a, 3.0],
        a * 3.0,
        &[("the decimal of an f32", 0.1 * 3.0)],
    )
}

fn nearest(a: f64) -> CaseJson {
    let traps = [(ROUNDED, a.round()), (ROUNDED, a.round_ties_even())];
    case("floor(a + 0.5)", &[a], (a + 0.5).floor(), &traps)
}
