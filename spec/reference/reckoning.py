"""Reckoning in Python: a second implementation, written from RECKONING.md only.

It encodes no bytes; check_reckoning.py runs the vectors. Names, and numbers in brackets, are the document's.
Python floats are doubles, rounded after each operation, so the formulas equal those of the document.
"""

import math
import struct
from dataclasses import dataclass

Vector = tuple  # of three floats or integers
Quaternion = tuple  # x, y, z, w


def double(bits):
    """The float of sixteen hexadecimal digits."""
    return struct.unpack(">d", bytes.fromhex(bits))[0]


# Constants [1.4, 1.6, 2.2, 2.6, 3.2, 3.9, 4.2, 4.3]

TWO_OVER_PI = double("3fe45f306dc9c883")
HALF_PI_HIGH = double("3ff921fb54400000")
HALF_PI_LOW = double("3dd0b4611a626331")
ANGLE_LIMIT = 1000000.0

# Coefficients, from the highest power down.
SINE = [double(bits) for bits in (
    "3de6124613a86d09", "be5ae64567f544e4", "3ec71de3a556c734", "bf2a01a01a01a01a", "3f81111111111111",
    "bfc5555555555555",
)]
COSINE = [double(bits) for bits in (
    "bda93974a8c07c9d", "3e21eed8eff8d898", "be927e4fb7789f5c", "3efa01a01a01a01a", "bf56c16c16c16c17",
    "3fa5555555555555", "bfe0000000000000",
)]

SLACK = double("3f50624dd2f1a9fc")
RATIO = double("4170000000000000")
EQUAL = double("3eb0000000000000")
LEAST_NORMAL = 2.0 ** -126  # of f32
TRACK_AGE_MAX = 1023

POSITION_SHARE = double("3fe2000000000000")
TURN_SHARE = double("3fe2000000000000")
VELOCITY_SHARE = double("3fb0000000000000")
COARSEST_TURN = double("3fd0000000000000")
COARSEST_ANGULAR = double("4010000000000000")

FINE_STEPS = 16
REST_PREDICTION_ERROR = 3
ACCELERATION_STEP = double("3f70000000000000")
ACCELERATION_TICKS, ACCELERATION_LIMIT, ACCELERATION_EXPONENT_MAX = 64, 1023, 12

POSITION_LIMIT = 1073741824
RESIDUAL_LIMIT = 67108864
VELOCITY_LIMIT = 16777216
TURN_LIMIT = 1024
VELOCITY_EXPONENT_MAX = 12
PACKED_LIMIT = 370728
PACKED_STEPS = 524288.0


# Arithmetic [1]

def scaled(a, k):
    return tuple(part * k for part in a)


def plus(a, b):
    return tuple(x + y for x, y in zip(a, b))


def minus(a, b):
    return tuple(x - y for x, y in zip(a, b))


def dot3(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def length3(a):
    return math.sqrt(dot3(a, a))


def cross3(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def length4(q):
    x, y, z, w = q
    return math.sqrt(x * x + y * y + z * z + w * w)


def normalised(q):
    n = length4(q)
    return tuple(part / n for part in q)


def product(p, q):
    px, py, pz, pw = p
    qx, qy, qz, qw = q
    return (
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
        pw * qw - px * qx - py * qy - pz * qz,
    )


def conjugate(q):
    x, y, z, w = q
    return (-x, -y, -z, w)


def turned(q, v):
    r = q[:3]
    t = scaled(cross3(r, v), 2.0)
    return plus(plus(v, scaled(t, q[3])), cross3(r, t))


def polynomial(coefficients, x):
    """Horner's rule; coefficients from the highest power down."""
    total = coefficients[0]
    for coefficient in coefficients[1:]:
        total = total * x + coefficient
    return total


def sin_cos(x):
    if not abs(x) <= ANGLE_LIMIT:
        return 0.0, 1.0
    k = math.floor(x * TWO_OVER_PI + 0.5)
    r = (x - k * HALF_PI_HIGH) - k * HALF_PI_LOW
    r2 = r * r
    s = r + r * (r2 * polynomial(SINE, r2))
    c = 1.0 + r2 * polynomial(COSINE, r2)
    return [(s, c), (c, -s), (-s, -c), (-c, s)][k % 4]


def turn_about(axis, length, half_angle):
    sine, cosine = sin_cos(half_angle)
    return scaled(axis, sine / length) + (cosine,)


def turn_by(vector):
    angle = length3(vector)
    if angle == 0.0:
        return (0.0, 0.0, 0.0, 1.0)
    return turn_about(vector, angle, 0.5 * angle)


@dataclass
class Motion:
    position: Vector
    rotation: Quaternion
    linear: Vector
    angular: Vector

    @staticmethod
    def of(numbers):
        """From thirteen numbers in the document's order."""
        n = tuple(numbers)
        return Motion(n[0:3], n[3:7], n[7:10], n[10:13])

    def numbers(self):
        return [*self.position, *self.rotation, *self.linear, *self.angular]


def body_state_motion(numbers):
    """The motion of thirteen widened f32, or None where it is refused [1.6]."""
    motion = Motion.of(numbers)
    finite = all(math.isfinite(number) for number in numbers)
    if not finite or not abs(length4(motion.rotation) - 1.0) <= SLACK:
        return None
    motion.rotation = normalised(motion.rotation)
    return motion


# Flow [2]

@dataclass
class Row:
    """The coefficients of n steps of the integrator [2.3]."""

    velocity: float = 1.0
    reach: float = 0.0
    fall_velocity: float = 0.0
    fall: float = 0.0
    spin: float = 1.0
    t1: float = 0.0
    t3: float = 0.0
    t5: float = 0.0


class Flow:
    """An integrator with a damping, and the rows computed so far."""

    def __init__(self, ticks, seconds, substeps, linear_damping, angular_damping):
        self.dt = float(seconds) / float(ticks)
        self.substeps = float(substeps)
        self.half_substep = (self.dt / self.substeps) * 0.5
        self.linear_keep = 1.0 / (1.0 + self.dt * linear_damping)
        self.angular_keep = 1.0 / (1.0 + self.dt * angular_damping)
        self.fall_in_tick = (self.dt * self.dt) * ((self.substeps + 1.0) / (2.0 * self.substeps))
        self.rows = [Row()]

    def row(self, elapsed):
        while len(self.rows) <= elapsed:
            self.rows.append(self.next_row(self.rows[-1]))
        return self.rows[elapsed]

    def next_row(self, last):
        spin2 = last.spin * last.spin
        spin3 = spin2 * last.spin
        spin5 = spin3 * spin2
        return Row(
            velocity=last.velocity * self.linear_keep,
            reach=last.reach + self.dt * last.velocity,
            fall_velocity=(last.fall_velocity + self.dt) * self.linear_keep,
            fall=(last.fall + self.dt * last.fall_velocity) + self.fall_in_tick,
            spin=last.spin * self.angular_keep,
            t1=last.t1 + last.spin,
            t3=last.t3 + spin3,
            t5=last.t5 + spin5,
        )

    def half_angle(self, speed, row):
        u = speed * self.half_substep
        u2 = u * u
        return (self.substeps * u) * (row.t1 - u2 * (row.t3 / 3.0 - u2 * (row.t5 / 5.0)))


def gravity_of(scene_gravity, scale):
    return scaled(scene_gravity, scale)


@dataclass
class Inertia:
    """Moments of inertia and their frame [2.6]."""

    moments: Vector
    frame: Quaternion

    @staticmethod
    def of(moments, frame):
        """From widened f32s, or None where they are refused."""
        normal = all(math.isfinite(m) and m >= LEAST_NORMAL for m in moments)
        if not normal or max(moments) > min(moments) * RATIO or not abs(length4(frame) - 1.0) <= SLACK:
            return None
        return Inertia(tuple(moments), tuple(frame))

    def is_equal(self):
        least, greatest = min(self.moments), max(self.moments)
        return greatest - least <= greatest * EQUAL


# Predictors [3]

def elapsed_ticks(tick, origin):
    return 0 if tick < origin else min(tick - origin, TRACK_AGE_MAX)


@dataclass
class Acceleration:
    """A constant acceleration [3.9]."""

    steps: tuple
    exponent: int

    @staticmethod
    def of(steps, exponent):
        """From encoded steps, or None where they are refused."""
        within = all(abs(part) <= ACCELERATION_LIMIT for part in steps) and 0 <= exponent <= ACCELERATION_EXPONENT_MAX
        return Acceleration(tuple(steps), exponent) if within else None

    def acceleration(self):
        return scaled(self.steps, 2.0 ** self.exponent * ACCELERATION_STEP)


def accelerated(elapsed, flow):
    """Coefficients of an acceleration for position and velocity [3.9]."""
    lasts = min(elapsed, ACCELERATION_TICKS)
    fall, coast = flow.row(lasts), flow.row(elapsed - lasts)
    return fall.fall + fall.fall_velocity * coast.reach, fall.fall_velocity * coast.velocity


def predicted(predictor, start, elapsed, gravity, flow, inertia=None, acceleration=None):
    """The predicted motion `elapsed` ticks after `start`; `acceleration` belongs to the accelerated predictor."""
    if predictor == "rest":
        return Motion(start.position, start.rotation, (0.0,) * 3, (0.0,) * 3)
    elapsed = min(elapsed, TRACK_AGE_MAX)
    row = flow.row(elapsed)
    position = plus(start.position, scaled(start.linear, row.reach))
    linear = scaled(start.linear, row.velocity)
    if predictor in ("ballistic", "ballistic_torque_free"):
        position = plus(position, scaled(gravity, row.fall))
        linear = plus(linear, scaled(gravity, row.fall_velocity))
    if predictor == "constant_acceleration":
        fall, fall_velocity = accelerated(elapsed, flow)
        position = plus(position, scaled(acceleration.acceleration(), fall))
        linear = plus(linear, scaled(acceleration.acceleration(), fall_velocity))
    rotates_freely = predictor in ("torque_free", "ballistic_torque_free", "constant_acceleration") and inertia is not None
    if rotates_freely and elapsed != 0 and length3(start.angular) != 0.0:
        rotation, angular = torque_free(start, elapsed, flow, inertia)
    else:
        rotation, angular = spun(start, row, flow), scaled(start.angular, row.spin)
    return Motion(position, rotation, linear, angular)


def spun(start, row, flow):
    """The rotation after a row [3.6]."""
    speed = length3(start.angular)
    half = flow.half_angle(speed, row)
    if half == 0.0:
        return start.rotation
    return normalised(product(turn_about(start.angular, speed, half), start.rotation))


def torque_free(start, elapsed, flow, inertia):
    """Rotation and angular velocity after `elapsed` ticks [3.7]."""
    m, f = inertia.moments, normalised(inertia.frame)
    n = tuple(1.0 / moment for moment in m)
    axes = normalised(product(start.rotation, f))
    p = times(m, turned(conjugate(axes), start.angular))
    for _ in range(elapsed):
        p = half_tick(p, m, n, flow)
        tx, ty, tz = scaled(times(p, n), flow.half_substep)
        substep = normalised((tx, ty, tz, 1.0))
        for _ in range(int(flow.substeps)):
            axes = product(axes, substep)
        p = half_tick(scaled(p, flow.angular_keep), m, n, flow)
    unit = normalised(axes)
    return normalised(product(unit, conjugate(f))), turned(unit, times(p, n))


def half_tick(p, m, n, flow):
    """The angular momentum relative to the principal axes, half a tick later [3.7]."""
    least, middle, greatest = sorted(range(3), key=lambda axis: (m[axis], axis))
    steps = (int(flow.substeps) + 1) // 2
    step = (flow.dt * 0.5) / float(steps)
    small = (n[least] - n[middle]) * (step * 0.25)
    large = (n[greatest] - n[middle]) * (step * 0.5)
    for _ in range(steps):
        for axis, tangent in ((least, small), (greatest, large), (least, small)):
            p = turned_about(p, axis, tangent)
    return p


def turned_about(p, axis, tangent):
    """An angular momentum, turned about one of its axes [3.7]."""
    i, j, k = axis, (axis + 1) % 3, (axis + 2) % 3
    a = p[i] * tangent
    r = 1.0 / (1.0 + a * a)
    c, s = (1.0 - a * a) * r, (a + a) * r
    turned = list(p)
    turned[j], turned[k] = c * p[j] + s * p[k], c * p[k] - s * p[j]
    return tuple(turned)


def times(a, b):
    return tuple(x * y for x, y in zip(a, b))


def attached_motion(parent, attached):
    """The world motion of an attached body, from the motion of its own track [3.8]."""
    arm = turned(parent.rotation, attached.position)
    return Motion(
        position=plus(parent.position, arm),
        rotation=normalised(product(parent.rotation, attached.rotation)),
        linear=plus(parent.linear, cross3(parent.angular, arm)),
        angular=parent.angular,
    )


def relative_to(parent, motion):
    """A world motion, relative to a parent [3.8]."""
    back = conjugate(parent.rotation)
    return Motion(
        position=turned(back, minus(motion.position, parent.position)),
        rotation=normalised(product(back, motion.rotation)),
        linear=(0.0,) * 3,
        angular=(0.0,) * 3,
    )


# Grids [4]

def scaled_tolerance(integer, tolerance_scale, least, most):
    """A tolerance, as an integer, for a body with a tolerance scale [4.1]."""
    scaled = integer << tolerance_scale if tolerance_scale >= 0 else integer >> -tolerance_scale
    return min(max(scaled, least), most)


@dataclass
class Grid:
    position: float
    fine: float
    turn: float
    linear: float
    angular: float

    @staticmethod
    def of(micrometres, radius, microradians=None):
        length = float(micrometres) / 1000000.0
        if microradians is not None:
            angle = float(microradians) / 1000000.0
            position = (length * 2.0) * POSITION_SHARE
            return Grid(
                position=position,
                fine=position / FINE_STEPS,
                turn=min((angle * 2.0) * TURN_SHARE, COARSEST_TURN),
                linear=(length * 2.0) * VELOCITY_SHARE,
                angular=(angle * 2.0) * VELOCITY_SHARE,
            )
        position, linear = length * POSITION_SHARE, length * VELOCITY_SHARE
        return Grid(
            position=position,
            fine=position / FINE_STEPS,
            turn=min(over(length * TURN_SHARE, radius), COARSEST_TURN),
            linear=linear,
            angular=min(over(linear, radius), COARSEST_ANGULAR),
        )


def over(length, radius):
    """A quotient by IEEE 754 rules: infinite for a radius of zero."""
    return length / radius if radius else math.inf


def bounding_radius(shape, extents, rows=None):
    """4.5; `extents` in the order of vectors/README.md."""
    if shape == "ball":
        return extents[0]
    if shape == "cuboid":
        return length3(extents)
    if shape == "rounded cuboid":
        return length3(extents[:3]) + extents[3]
    if shape == "half-space":
        return 10000.0
    if shape in ("hull", "mesh"):
        return max(length3(extents[place : place + 3]) for place in range(0, len(extents), 3))
    if shape == "heights":
        along, across, *heights = extents
        posts = ((divmod(place, len(heights) // rows), y) for place, y in enumerate(heights))
        return max(length3([row * along, y, column * across]) for (row, column), y in posts)
    if shape == "compound":
        reaches = [length3(extents[place : place + 3]) + extents[place + 3] for place in range(0, len(extents), 4)]
        return max([0.0010000000474974513, *reaches])
    half_height, radius = extents
    if shape == "capsule":
        return half_height + radius
    if shape == "cone":
        half = half_height * 0.5
        return max(math.sqrt(half * half + radius * radius), half_height * 1.5)
    return math.sqrt(half_height * half_height + radius * radius)


def clamped(number, limit):
    return max(-limit, min(limit, number))


def quantise(value, step, limit):
    steps = value / step + 0.5
    # Clamped before floor, which Python allows for finite numbers only; the limit is an integer, so the result is equal.
    return math.floor(clamped(steps, float(limit)))


def quantised(vector, step, limit):
    return tuple(quantise(x, step, limit) for x in vector)


def nearest(q):
    """The packed rotation nearest to a unit quaternion: (largest, others)."""
    steps = [math.floor(part * PACKED_STEPS + 0.5) for part in q]
    largest = max(range(4), key=lambda place: abs(steps[place]))
    if steps[largest] < 0:
        steps = [-s for s in steps]
    others = tuple(s for place, s in enumerate(steps) if place != largest)
    return largest, others


def packed(q):
    rotation = nearest(q)
    for _ in range(3):
        again = nearest(unpacked(rotation))
        if again == rotation:
            break
        rotation = again
    return rotation


def unpacked(rotation):
    """The quaternion of a packed rotation."""
    largest, others = rotation
    a, b, c = (float(s) / PACKED_STEPS for s in others)
    rest = max(0.0, 1.0 - ((a * a + b * b) + c * c))
    parts = [a, b, c]
    parts.insert(largest, math.sqrt(rest))
    return normalised(parts)


def is_packed(largest, others):
    """True if these parts are the only valid encoding of their rotation."""
    if not 0 <= largest < 4 or any(abs(s) > PACKED_LIMIT for s in others):
        return False
    rotation = (largest, tuple(others))
    return nearest(unpacked(rotation)) == rotation


@dataclass
class Quantised:
    """A motion on a grid, in steps [4.6]."""

    position: Vector
    rotation: tuple  # largest, others
    linear: Vector
    angular: Vector

    @staticmethod
    def of(motion, grid):
        return Quantised(
            position=quantised(motion.position, grid.fine, POSITION_LIMIT),
            rotation=packed(motion.rotation),
            linear=quantised(motion.linear, grid.linear, VELOCITY_LIMIT),
            angular=quantised(motion.angular, grid.angular, VELOCITY_LIMIT),
        )

    def motion(self, grid):
        return Motion(
            position=scaled(self.position, grid.fine),
            rotation=unpacked(self.rotation),
            linear=scaled(self.linear, grid.linear),
            angular=scaled(self.angular, grid.angular),
        )


def prediction_error(predictor, age, dt):
    """The time over which a predictor's error grows, `over` of [4.4]."""
    return (min(age, REST_PREDICTION_ERROR) if predictor == "rest" else age) * dt


@dataclass
class Residual:
    """A correction; both velocities are None if it contains none [4.4]."""

    position: Vector
    turn: Vector
    linear: Vector = None
    angular: Vector = None
    velocity_exponent: int = 0

    def is_within_limits(self):
        def within(steps, limit):
            return steps is None or all(abs(step) <= limit for step in steps)

        return (
            within(self.position, RESIDUAL_LIMIT)
            and within(self.turn, TURN_LIMIT)
            and self.velocity_exponent <= VELOCITY_EXPONENT_MAX
            and within(self.linear, VELOCITY_LIMIT >> self.velocity_exponent)
            and within(self.angular, VELOCITY_LIMIT >> self.velocity_exponent)
        )

    def onto(self, prediction, over, grid):
        """The quantised motion of a prediction plus this residual, or None where it is refused."""
        if not self.is_within_limits():
            return None
        start = Quantised.of(prediction, grid)
        turn = scaled(self.turn, grid.turn)
        rotation = start.rotation
        if any(self.turn):
            rotation = packed(normalised(product(turn_by(turn), prediction.rotation)))
        rate = 1.0 / over
        linear = plus(prediction.linear, scaled(scaled(self.position, grid.position), rate))
        angular = plus(prediction.angular, scaled(turn, rate))
        more = [scaled(steps or (0, 0, 0), 1 << self.velocity_exponent) for steps in (self.linear, self.angular)]
        return Quantised(
            position=summed(start.position, scaled(self.position, FINE_STEPS), POSITION_LIMIT),
            rotation=rotation,
            linear=summed(quantised(linear, grid.linear, VELOCITY_LIMIT), more[0], VELOCITY_LIMIT),
            angular=summed(quantised(angular, grid.angular, VELOCITY_LIMIT), more[1], VELOCITY_LIMIT),
        )


def summed(a, b, limit):
    return tuple(clamped(steps, limit) for steps in plus(a, b))


# RestCorrection [4.7]


def single(number):
    """The nearest f32, widened; infinite beyond the largest."""
    try:
        return struct.unpack("<f", struct.pack("<f", number))[0]
    except OverflowError:
        return math.copysign(math.inf, number)


def stepped(number, by):
    """The f32 that is `by` places after the nearest one to a number."""
    bits = struct.unpack("<I", struct.pack("<f", single(number)))[0]
    rank = (bits if bits < 1 << 31 else (bits ^ 0x7FFFFFFF) - (1 << 32)) + by
    rank = (rank + (1 << 31)) % (1 << 32) - (1 << 31)
    return struct.unpack("<f", struct.pack("<I", rank if rank >= 0 else (rank + (1 << 32)) ^ 0x7FFFFFFF))[0]


def rest_state(prediction, negated, position_steps, others_steps, largest_step):
    """The thirteen widened f32s of a body at rest, or None where they are refused."""
    position = [stepped(number, by) for number, by in zip(prediction.position, position_steps)]
    expected = [-part if negated else part for part in prediction.rotation]
    largest = max(range(4), key=lambda place: (abs(expected[place]), -place))
    places = [place for place in range(4) if place != largest]
    rotation = [0.0] * 4
    for place, by in zip(places, others_steps):
        rotation[place] = stepped(expected[place], by)
    a, b, c = (rotation[place] for place in places)
    rest = 1.0 - ((a * a + b * b) + c * c)
    size = math.sqrt(rest) if rest > 0.0 else 0.0
    rotation[largest] = stepped(-size if expected[largest] < 0.0 else size, largest_step)
    numbers = [*position, *rotation, *[0.0] * 6]
    return numbers if body_state_motion(numbers) else None
