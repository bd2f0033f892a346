"""Runs reckoning.py over the golden vectors, and compares its constants with the document.

Usage: python3 check_reckoning.py. Prints failures, then a count; the exit code is 1 after a failure.
"""

import json
import math
import struct
import sys
from pathlib import Path

import reckoning as r

SPEC = Path(__file__).resolve().parent.parent


def bits64(values):
    """Each float as sixteen hexadecimal digits."""
    return [struct.pack(">d", value).hex() for value in values]


def bits32(values):
    """Each float, which an f32 holds, as eight hexadecimal digits."""
    return [struct.pack(">f", value).hex() for value in values]


def doubles(texts):
    return [struct.unpack(">d", bytes.fromhex(text))[0] for text in texts]


def singles(texts):
    """The floats, widened, since Python floats are doubles."""
    return [struct.unpack(">f", bytes.fromhex(text))[0] for text in texts]


def acceleration_of(case):
    """The acceleration of a case whose predictor is accelerated."""
    return case.get("acceleration") and r.Acceleration.of(case["acceleration"], case["exponent"])


FORMULAS = {
    "a*b + c": lambda a, b, c: a * b + c,
    "a*a + b*b + c*c": lambda a, b, c: a * a + b * b + c * c,
    "a*b - c*d": lambda a, b, c, d: a * b - c * d,
    "a / b": lambda a, b: a / b,
    "a + b + c": lambda a, b, c: a + b + c,
    "a + b": lambda a, b: a + b,
    "a * b": lambda a, b: a * b,
    "sqrt(a)": math.sqrt,
    "-a": lambda a: -a,
    # Python's floor is an integer, and so has no sign of zero; no case needs one.
    "floor(a + 0.5)": lambda a: float(math.floor(a + 0.5)),
}


def evaluated(formula, operands):
    return FORMULAS[formula](*operands)


def named(case, result):
    """A result of a trap's case; a known wrong one with the name of its trap."""
    wrong = dict(zip(case["wrong"], case["traps"]))
    return f"{result}, because of this trap: {wrong[result]}" if result in wrong else result


class Checks:
    """One method per section; each yields the expected and the computed result."""

    def __init__(self, vectors):
        self.vectors = vectors
        self.flows_of = [
            r.Flow(case["ticks"], case["seconds"], case["substeps"], *singles(case["damping"]))
            for case in vectors["integrators"]
        ]
        self.gravities_of = [
            r.gravity_of(singles(case["scene"]), singles(case["scale"])[0]) for case in vectors["gravities"]
        ]
        self.grids_of = [
            r.Grid.of(case["micrometres"], doubles(case["radius"])[0], case.get("microradians"))
            for case in vectors["grids"]
        ]

    def flows(self, case):
        row = self.flows_of[case["integrator"]].row(case["elapsed"])
        yield case["row"], bits64([row.velocity, row.reach, row.fall_velocity, row.fall, row.spin])

    def gravities(self, case):
        gravity = r.gravity_of(singles(case["scene"]), singles(case["scale"])[0])
        yield case["gravity"], bits64(gravity)

    def initial_states(self, case):
        motion = r.body_state_motion(singles(case["body_state"]))
        yield case["motion"], motion and bits64(motion.numbers())

    def predictions(self, case):
        initial_state = r.body_state_motion(singles(self.vectors["initial_states"][case["initial_state"]]["body_state"]))
        flow, gravity = self.flows_of[case["integrator"]], self.gravities_of[case["gravity"]]
        end = r.predicted(case["predictor"], initial_state, case["elapsed"], gravity, flow, acceleration=acceleration_of(case))
        yield case["end"], bits64(end.numbers())

    def inertias(self, case):
        inertia = r.Inertia.of(singles(case["moments"]), singles(case["frame"]))
        yield case["equal"], inertia and int(inertia.is_equal())

    def torque_free_rotations(self, case):
        initial_state = r.body_state_motion(singles(self.vectors["initial_states"][case["initial_state"]]["body_state"]))
        flow, gravity = self.flows_of[case["integrator"]], self.gravities_of[case["gravity"]]
        given = self.vectors["inertias"][case["inertia"]]
        inertia = r.Inertia.of(singles(given["moments"]), singles(given["frame"]))
        end = r.predicted(case["predictor"], initial_state, case["elapsed"], gravity, flow, inertia, acceleration_of(case))
        yield case["end"], bits64(end.numbers())

    def radii(self, case):
        yield case["radius"], bits64([r.bounding_radius(case["shape"], singles(case["extents"]), case.get("rows"))])

    def traps(self, case):
        yield case["result"], [named(case, bits64([evaluated(case["formula"], doubles(case["operands"]))])[0])]

    def turns(self, case):
        if "vector" in case:
            turn = r.turn_by(tuple(doubles(case["vector"])))
        else:
            turn = r.turn_about(tuple(doubles(case["axis"])), doubles(case["length"])[0], doubles(case["half_angle"])[0])
        yield case["rotation"], bits64(turn)

    def tolerance_scales(self, case):
        yield case["position"], r.scaled_tolerance(case["micrometres"], case["tolerance_scale"], 1000, 10000000)
        yield case["turn"], r.scaled_tolerance(case["microradians"], case["tolerance_scale"], 100, 3141593)

    def grids(self, case):
        grid = r.Grid.of(case["micrometres"], doubles(case["radius"])[0], case.get("microradians"))
        yield case["steps"], bits64([grid.position, grid.fine, grid.turn, grid.linear, grid.angular])

    def packings(self, case):
        packed = r.packed(doubles(case["rotation"]))
        yield (case["largest"], tuple(case["others"])), packed
        yield case["value"], bits64(r.unpacked(packed))

    def unpackings(self, case):
        largest, others = case["largest"], tuple(case["others"])
        value = bits64(r.unpacked((largest, others))) if r.is_packed(largest, others) else None
        yield case["value"], value

    def quantisations(self, case):
        grid = self.grids_of[case["grid"]]
        yield from same_quantised(case, r.Quantised.of(r.Motion.of(doubles(case["motion"])), grid), grid)

    def residuals(self, case):
        grid = self.grids_of[case["grid"]]
        parts = (case[part + "_residual"] for part in ("position", "turn", "linear", "angular"))
        residual = r.Residual(*(steps and tuple(steps) for steps in parts), case["velocity_exponent"] or 0)
        over = r.prediction_error(case["predictor"], case["age"], self.flows_of[case["integrator"]].dt)
        yield case["interval"], bits64([over])
        quantised = residual.onto(r.Motion.of(doubles(case["predicted"])), over, grid)
        yield from same_quantised(case, quantised, grid)

    def tracks(self, case):
        grid = self.grids_of[case["grid"]]
        rotation = (case["largest"], tuple(case["others"]))
        anchor = r.Quantised(case["position"], rotation, case["linear"], case["angular"])
        yield case["means"], bits64(anchor.motion(grid).numbers())
        flow, gravity = self.flows_of[case["integrator"]], self.gravities_of[case["gravity"]]
        elapsed = r.elapsed_ticks(case["tick"], case["origin"])
        end = r.predicted(case["predictor"], anchor.motion(grid), elapsed, gravity, flow, acceleration=acceleration_of(case))
        yield case["end"], bits64(end.numbers())

    def attachments(self, case):
        grid = self.grids_of[case["grid"]]
        parent, body = (r.Motion.of(doubles(case[name])) for name in ("parent", "body"))
        seen = r.relative_to(parent, body)
        yield case["relative"], bits64(seen.numbers())
        quantised = r.Quantised.of(seen, grid)
        yield from same_quantised(case, quantised, grid)
        yield case["attached_motion"], bits64(r.attached_motion(parent, quantised.motion(grid)).numbers())

    def rest_corrections(self, case):
        steps = (case[name] for name in ("position_steps", "others_steps"))
        predicted = r.Motion.of(doubles(case["predicted"]))
        numbers = r.rest_state(predicted, case["negated"], *steps, case["largest_step"][0])
        yield case["body_state"], numbers and bits32(numbers)


def same_quantised(case, quantised, grid):
    """A quantised motion, or None where its encoding would be refused; and the motion that it means."""
    if quantised is None or case["means"] is None:
        yield case["means"], quantised
        return
    rotation = (case["largest"], tuple(case["others"]))
    expected = (tuple(case["position"]), rotation, tuple(case["linear"]), tuple(case["angular"]))
    yield expected, (quantised.position, quantised.rotation, quantised.linear, quantised.angular)
    yield case["means"], bits64(quantised.motion(grid).numbers())


def constants():
    """Every constant of reckoning.py, as the document writes it."""
    named = {name: value for name, value in vars(r).items() if name.isupper()}
    for name, value in named.items():
        for one in value if isinstance(value, list) else [value]:
            if name == "LEAST_NORMAL":
                continue
            if name in ("ANGLE_LIMIT", "PACKED_STEPS"):
                yield name, str(int(one))
            elif isinstance(one, float):
                yield name, bits64([one])[0]
            else:
                yield name, f"| {one} |"


def main():
    passed, failed = 0, 0
    document = (SPEC / "RECKONING.md").read_text(encoding="utf-8")
    for name, text in constants():
        if text in document:
            passed += 1
        else:
            failed += 1
            print(f"constant {name}: {text} is missing in RECKONING.md")
    vectors = json.loads((SPEC / "vectors" / "reckoning.json").read_text(encoding="utf-8"))
    checks = Checks(vectors)
    for section, cases in vectors.items():
        if section in ("format", "integrators"):
            continue
        for number, case in enumerate(cases):
            wrong = [(want, got) for want, got in getattr(checks, section)(case) if want != got]
            passed += not wrong
            failed += bool(wrong)
            for want, got in wrong:
                print(f"{section} {number}: expected {want}, got {got}")
    print(f"{passed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
