"""Types of the native module, with the documentation that help() shows.

Every array that is returned is read-only or the caller's own, and never changes.
"""

import os
from types import TracebackType
from typing import Literal, Mapping, Optional, Sequence, Tuple, Type, TypedDict, Union, final

import numpy as np
import numpy.typing as npt

__version__: str

_Vector = npt.ArrayLike
"""Three numbers; where bodies are a row, also one row of three numbers for each."""
_Rotation = npt.ArrayLike
"""A unit quaternion x, y, z, w, body to world; where bodies are a row, also one for each."""
_Bodies = Union[int, Sequence[int], npt.NDArray[np.uint64]]
"""An id of a body, or a row of ids: integers."""
_Kind = Literal["dynamic", "fixed", "kinematic"]
_Edges = Literal["plain", "smooth"]
_Sleep = Union[Literal["settled", "never"], Tuple[float, float, float]]
"""Conditions of sleep; three numbers are a speed, an angular speed in rad/s, and seconds."""

def connect(
    address: str,
    *,
    fingerprint: Optional[str] = None,
    roots: Union[str, os.PathLike[str], None] = None,
    token: Optional[str] = None,
    timeout: float = 5.0,
) -> Connection:
    """Connects to the server at host:port.

    Trust its certificate by the fingerprint that the server prints, or by a PEM file with roots; not by both. A token
    admits the client to a server that is not open. The time limit, in seconds, holds for every later call that waits.
    """

@final
class Connection:
    """A connection to a server that has joined no scene; connect makes it.

    It closes at the end of a with block, unless join has used it up.
    """

    def join(
        self,
        scene: str,
        *,
        coordinates: Literal["rhumb", "unity", "unreal", "z-up"] = "rhumb",
        condition: Literal["create or join", "create", "join"] = "create or join",
        tolerance: float = 0.05,
        stepping: Literal["lockstep", "free running"] = "lockstep",
        ticks_per_second: int = 60,
        substeps: int = 4,
        publish_interval: int = 1,
        gravity: Optional[_Vector] = None,
        sleep: Optional[_Sleep] = None,
        delay_ticks: float = 0.0,
        lead_ticks: float = 0.0,
        whole_ticks: bool = False,
        smooth: bool = True,
        refusals: Literal["raise", "events"] = "raise",
        resume_within: Optional[float] = None,
    ) -> Scene:
        """Joins a scene by name, makes it if it is new, and returns it. Uses the connection up; wrong arguments do not.

        coordinates: axes and unit of every position, length and force of this client. "rhumb": y up, metres; "unity":
        left-handed, y up, metres; "unreal": left-handed, z up, centimetres; "z-up": z up, metres, as in ROS and PyBullet.
        condition: "create or join", "create" (the scene must be new), or "join" (it must exist).
        tolerance: how far any point of a copied body may be off, 0.001 to 10 metres whatever the coordinates.
        refusals: "raise" has the next advance, wait or poll raise RefusedError for what the server refused; "events" leaves
        that to events().
        resume_within: seconds for which the client tries to go on over another connection; None: as the scene suggests.

        Of a new scene are: stepping, "lockstep" (advance steps it) or "free running" (the server's clock does);
        ticks_per_second, 1 to 1000; substeps of each tick, 1 to 16; publish_interval, the ticks from one that is sent to the
        next; gravity, three numbers, the earth's if it is None; sleep, as of add_body, of bodies without one, "settled" if it is
        None.

        Of a free-running view are: delay_ticks, by which it stays behind the server's clock, so that nothing of it is
        guessed; whole_ticks, whether only whole ticks are shown; smooth, whether corrections are shown as short glides;
        lead_ticks, by which publish is ahead of the server's clock.
        """

    def close(self) -> None:
        """Closes the connection. A second time does nothing."""
    @property
    def closed(self) -> bool:
        """True once it is closed, or a scene was joined with it."""
    def __enter__(self) -> Connection: ...
    def __exit__(
        self,
        error_type: Optional[Type[BaseException]],
        error: Optional[BaseException],
        traceback: Optional[TracebackType],
    ) -> None: ...

@final
class Shape:
    """A shape. Its origin is its body's centre of mass, but for hulls and compounds: see centre. Long axes point up. Lengths are in
    the scene's unit.

    Make one with Shape.ball, cuboid, rounded_cuboid, capsule, cylinder, cone, half_space, hull, mesh, heights or compound.
    Each extent is 0.001 to 10,000 metres.
    """

    @staticmethod
    def ball(radius: float) -> Shape:
        """A sphere."""
    @staticmethod
    def cuboid(x: float, y: float, z: float) -> Shape:
        """A box, by half its edge lengths: cuboid(0.5, 0.5, 0.5) is a cube of edge 1."""
    @staticmethod
    def rounded_cuboid(x: float, y: float, z: float, radius: float) -> Shape:
        """A box with round edges: every point within the radius of a box, which is given by half its edge lengths."""
    @staticmethod
    def capsule(half_height: float, radius: float) -> Shape:
        """A cylinder with half balls on its ends, by half the length of its straight part."""
    @staticmethod
    def cylinder(half_height: float, radius: float) -> Shape:
        """A cylinder, by half its length."""
    @staticmethod
    def cone(half_height: float, radius: float) -> Shape:
        """A cone whose tip points up, by half its height."""
    @staticmethod
    def half_space(normal: _Vector) -> Shape:
        """Everything behind a plane, whose normal points out of it. For fixed bodies."""
    @staticmethod
    def hull(points: npt.ArrayLike) -> Shape:
        """The convex hull of rows of three numbers, from any origin: see centre. At most 255 corners; other points are left out."""
    @staticmethod
    def mesh(points: npt.ArrayLike, triangles: npt.ArrayLike, *, edges: Optional[_Edges] = None) -> Shape:
        """A mesh of triangles, each a row of three places of points. For fixed and kinematic bodies.

        edges: "smooth", the default: bodies slide and roll over flat ground as over one face; "plain": each triangle is
        touched as if it were alone, so that they may catch on its edges.
        """
    @staticmethod
    def heights(
        heights: npt.ArrayLike, row_spacing: float = 1.0, column_spacing: float = 1.0, *, edges: Optional[_Edges] = None
    ) -> Shape:
        """A field of heights by row and column. For fixed and kinematic bodies.

        The first post is at the body's origin; the rows follow each other along x, the columns along the other axis of the
        ground. edges: as of a mesh; with "smooth" ones the field is touched from above only.
        """
    @staticmethod
    def compound(parts: Sequence[Union[Tuple[Shape, _Vector], Tuple[Shape, _Vector, _Rotation]]]) -> Shape:
        """Several shapes in the axes of a body: shape, position, and a rotation if it is turned."""
    @property
    def centre(self) -> Tuple[float, float, float]:
        """The centre of mass at an even density, from the origin of the shape and in its axes.

        Hulls and compounds alone have another than the origin. A body of such a shape is placed by the origin, and so is
        every pose of it that this client gives and gets; forces act at the centre. Other members see the body from its
        centre of mass.
        """
    def centred(self) -> Tuple[Shape, Tuple[float, float, float]]:
        """The shape moved so that its centre of mass is the origin, and the centre: where that was."""

@final
class Joint:
    """A joint of two bodies, for Scene.add_joint and Scene.change_joint.

    kind: "fixed"; "spherical", which leaves every turn free; "revolute", a hinge, which leaves the turn about x of its
    frames; "prismatic", a slider, which leaves the displacement along x; "rope", with a greatest length; "spring", with a
    length, a stiffness in N/m and a damping in N s/m; "generic", which leaves every axis but the locked_axes, bits in the
    order below.

    Each body has a frame of the joint: first_anchor and second_anchor, from the origin of its shape, and first_rotation and
    second_rotation, a quaternion x, y, z, w. To hinge about another axis than x, turn both frames.

    limits and motors are by axis: 0 to 2 along x, y, z, 3 to 5 about them. A limit is the least and the most, in units
    of length or in radians from -2 pi to 2 pi, at most a whole turn apart: limits={3: (0, 4.7)} is 270 degrees. A motor
    is (position, velocity, stiffness, damping, force): what it drives to, its stiffness in 1/s², its damping in 1/s,
    and its greatest force or torque, or None for any. For a motor that keeps a speed, the stiffness is 0:
    motors={3: (0, 2.0, 0, 10.0, None)} turns a hinge at 2 rad/s.

    collide: whether the two bodies also collide with each other. breaks_at: the force in N and the torque in N m at which
    it breaks.
    """

    def __init__(
        self,
        kind: Literal["fixed", "spherical", "revolute", "prismatic", "rope", "spring", "generic"],
        first: int,
        second: int,
        *,
        first_anchor: Optional[_Vector] = None,
        second_anchor: Optional[_Vector] = None,
        first_rotation: Optional[_Rotation] = None,
        second_rotation: Optional[_Rotation] = None,
        locked_axes: int = 0,
        limits: Optional[Mapping[int, Tuple[float, float]]] = None,
        motors: Optional[Mapping[int, Tuple[float, float, float, float, Optional[float]]]] = None,
        length: float = 1.0,
        stiffness: float = 0.0,
        damping: float = 0.0,
        collide: bool = False,
        breaks_at: Optional[Tuple[float, float]] = None,
    ) -> None: ...

@final
class Character:
    """A character, for Scene.set_character: a kinematic body that walks, as far as the world lets it, and falls.

    Up is the direction away from the ground, of unit length; against gravity if it is left out.

    The offset is the gap that it keeps to its surroundings, 0.02 m if it is left out. It climbs slopes of up to the
    first angle, and slides down from the second one on; both are radians from level ground, 45 degrees if they are left
    out. It pushes dynamic bodies with its mass, in kilograms.

    A step is the greatest height that it climbs, and the free width that it needs there; without one it climbs none.
    It climbs onto dynamic bodies too if it is set so, and pushes them otherwise. The snap is the greatest drop of the
    ground that it follows without a fall, 0.2 m if it is left out, and none at 0.
    """

    def __init__(
        self,
        *,
        up: Optional[_Vector] = None,
        offset: Optional[float] = None,
        climb_angle: float = ...,
        slide_angle: float = ...,
        mass: float = 80.0,
        step: Optional[Tuple[float, float]] = None,
        onto_dynamic: bool = False,
        snap: Optional[float] = None,
    ) -> None: ...

@final
class Wheel:
    """A wheel of a vehicle, for Scene.set_vehicle: a ray with a spring, in the axes of its chassis.

    The position is the upper end of its suspension, from the origin of the chassis' shape.

    The direction of the suspension, of unit length, is down if it is left out. The axle, of unit length, points to the
    right of the way forward. It is along x if it is left out, in Unreal's coordinates along y: forward is then -z in
    Rhumb's coordinates, z in Unity's, x in Unreal's, and y where z is up.

    The suspension has its rest length without load, 0.3 m, and changes by at most its travel, 0.25 m. Its stiffness is
    an acceleration for a length, 50/s²; its damping is 4/s in compression, and 6/s in relaxation. It pushes with any
    force unless a greatest one is set.

    The greatest force along the ground is a share of the suspension's force, the friction slip, 2; the part along the
    way forward counts half. The side friction, 1, is a factor of the force that keeps the wheel from sliding sideways.
    """

    def __init__(
        self,
        position: _Vector,
        radius: float,
        *,
        direction: Optional[_Vector] = None,
        axle: Optional[_Vector] = None,
        rest_length: Optional[float] = None,
        travel: Optional[float] = None,
        stiffness: Optional[float] = None,
        compression: Optional[float] = None,
        relaxation: Optional[float] = None,
        force_max: Optional[float] = None,
        friction_slip: Optional[float] = None,
        side_friction: Optional[float] = None,
    ) -> None: ...

@final
class WheelInput:
    """Steering, force and brake of a wheel, for Scene.set_wheels.

    A positive steering, in radians, turns left; in left-handed coordinates it turns right.

    The force acts forward, a negative one backward. The brake is the greatest force that stops the wheel; one with a
    force does not brake.
    """

    def __init__(self, steering: float = 0.0, force: float = 0.0, brake: float = 0.0) -> None: ...

@final
class Query:
    """A question about where the bodies are, for Scene.query: Query.ray, shape_cast, projection or overlap.

    hits is the most bodies that it finds, 1 to 64. among changes which bodies count.
    """

    @staticmethod
    def ray(origin: _Vector, translation: _Vector, *, hits: int = 1) -> Query:
        """The nearest bodies along a line from origin to origin + translation. Sensors do not count."""
    @staticmethod
    def shape_cast(
        shape: Shape, position: _Vector, translation: _Vector, *, rotation: Optional[_Rotation] = None, hits: int = 1
    ) -> Query:
        """The nearest bodies that a shape touches on its way: a ball, cuboid, rounded cuboid, capsule, cylinder or cone."""
    @staticmethod
    def projection(point: _Vector, distance: float, *, hits: int = 1) -> Query:
        """The bodies whose surfaces are nearest to a point, within a distance."""
    @staticmethod
    def overlap(shape: Shape, position: _Vector, *, rotation: Optional[_Rotation] = None, hits: int = 64) -> Query:
        """The bodies that a shape overlaps: a ball, cuboid, rounded cuboid, capsule, cylinder or cone."""
    def among(
        self,
        *,
        fixed: bool = True,
        dynamic: bool = True,
        kinematic: bool = True,
        sensors: bool = False,
        groups: int = 0xFFFFFFFF,
        excluding: Optional[int] = None,
    ) -> Query:
        """The same question about some bodies: of these kinds, of a group in the bits of groups, but not the one excluded."""

@final
class Hit:
    """A body that a query found."""

    @property
    def body(self) -> int:
        """The body's id."""
    @property
    def distance(self) -> float:
        """Along the way, or from the point to the surface; zero for an overlap."""
    @property
    def point(self) -> Tuple[float, float, float]:
        """On the body's surface; zero for an overlap."""
    @property
    def normal(self) -> Tuple[float, float, float]:
        """Outward from the surface, of unit length; zero where there is none, as for a ray that begins inside."""

@final
class Contact:
    """Two bodies that touch now, of Scene.contacts."""

    @property
    def body(self) -> int:
        """The body that was asked for, or the first one."""
    @property
    def other(self) -> int:
        """The body that it touches."""
    @property
    def point(self) -> Tuple[float, float, float]:
        """Of the deepest contact: a point on the first body, as of the last event about the two."""
    @property
    def normal(self) -> Tuple[float, float, float]:
        """From the other body towards this one, of unit length."""
    @property
    def separation(self) -> float:
        """Units of length; negative where they overlap."""
    @property
    def force(self) -> float:
        """The sum of all forces between the two."""
    @property
    def tick(self) -> int:
        """The tick of the last event about the two."""

@final
class Event:
    """Something that happened, or the answer to a command. What its kind does not name is zero, None or empty."""

    @property
    def kind(self) -> str:
        """One of: "commands applied", "command refused", "body placed", "body removed", "contact began", "contact ended",
        "contact force", "sensor entered", "sensor left", "fell asleep", "woke", "body fault", "reached ground", "left
        ground", "events missed", "stream changed", "publisher silent", "publisher active", "scene restored", "scene
        faulted", "scene deleted", "interrupted", "resumed", "session lost", "durable", "authority granted", "authority
        denied", "denied", "ended", "other"."""
    @property
    def after(self) -> int:
        """The newest complete tick when the event was read: no view of an earlier tick shows its effect."""
    @property
    def tick(self) -> int:
        """The tick in which it happened, if the server says so; otherwise the same as `after`."""
    @property
    def number(self) -> int:
        """The command's number, or the count that the kind names."""
    @property
    def body(self) -> Optional[int]:
        """The body that the kind names; of a contact the first one, of a sensor the sensor."""
    @property
    def other(self) -> Optional[int]:
        """The other body."""
    @property
    def point(self) -> Tuple[float, float, float]:
        """Of a contact: a point on the body."""
    @property
    def normal(self) -> Tuple[float, float, float]:
        """Of a contact: from the other body towards the body, of unit length."""
    @property
    def separation(self) -> float:
        """Of a contact: units of length; negative where the bodies overlap."""
    @property
    def force(self) -> float:
        """Of a contact: the sum of all forces between the bodies."""
    @property
    def text(self) -> str:
        """A reason, a sentence; empty for most kinds."""

class _Upstream(TypedDict):
    updates: int
    packets: int
    bytes: int

class _Statistics(TypedDict):
    sent_bytes: int
    received_bytes: int
    updates: int
    complete_tick: int
    upstream: _Upstream
    behind_ticks: Optional[float]

@final
class Scene:
    """A client of one scene; Connection.join makes it. It leaves the scene at the end of a with block.

    Bodies have ids, which add_body and add_bodies return. Every call that takes a body takes a row of ids too, with one row
    of numbers for all of them or one for each. The poses of all bodies are arrays of one order; place finds a body in them.

    Commands are queued, and sent together by the next call that waits, or by flush. Each returns its number, which events
    and refusals name; for a row of bodies, the number of the last. What is wrong at once raises InvalidError, and nothing is
    queued. What the server refuses raises RefusedError at the next advance, wait or poll.

    One thread at a time may be inside a call; a second one raises BusyError at once. len() is the number of bodies of the
    view, and "body in scene" tells whether it has one.
    """

    def add_body(
        self,
        shape: Shape,
        position: Optional[_Vector] = None,
        kind: _Kind = "dynamic",
        *,
        rotation: Optional[_Rotation] = None,
        linear_velocity: Optional[_Vector] = None,
        angular_velocity: Optional[_Vector] = None,
        mass: Optional[float] = None,
        moments: Optional[Tuple[float, float, float]] = None,
        material: Optional[Tuple[float, float, float]] = None,
        damping: Optional[Tuple[float, float]] = None,
        gravity_scale: float = 1.0,
        locked_axes: int = 0,
        groups: Tuple[int, int] = (0xFFFFFFFF, 0xFFFFFFFF),
        tolerance_exponent: int = 0,
        sensor: bool = False,
        swept: bool = False,
        gyroscopic: bool = True,
        sleep: Optional[_Sleep] = None,
    ) -> int:
        """Adds a body, and returns its id: an int, for place and every call that takes a body.

        position: the origin of its shape, which is its centre of mass but for hulls and compounds; rotation: a unit quaternion
        x, y, z, w, body to world; linear_velocity: units of length per second; angular_velocity: rad/s about world axes.

        shape: a Shape. kind: "dynamic" (the engine moves it), "fixed" (nothing does), or "kinematic" (commands do).
        mass: kilograms; None: volume times density. moments: of inertia about its own axes, kg m², beside a mass; None:
        those of its shape. material: friction, restitution from 0 to 1, and density in kg/m³; None: the scene's.
        damping: linear and angular, 1/s; None: the scene's. gravity_scale: factor on the scene's gravity.
        locked_axes: bits 1, 2, 4 for translations along x, y, z, bits 8, 16, 32 for rotations about them, in the world.
        groups: bits of its own collision groups, and of those that it touches. sensor: bodies pass through it, and events
        report them. swept: it does not pass through moving bodies however fast it is.
        tolerance_exponent: power of two on the tolerance of its copies, -3 to 3. gyroscopic: its axis of spin wanders if its
        moments differ, as in physics. sleep: "settled", once it is slow and neither gravity nor a motor moves it; "never"; or
        a speed of its fastest point, rad/s, and the seconds for which it must be as slow; None: as the scene has it.
        """

    def add_bodies(
        self,
        shape: Shape,
        positions: npt.ArrayLike,
        kind: _Kind = "dynamic",
        *,
        rotations: Optional[_Rotation] = None,
        linear_velocities: Optional[_Vector] = None,
        angular_velocities: Optional[_Vector] = None,
        mass: Optional[float] = None,
        moments: Optional[Tuple[float, float, float]] = None,
        material: Optional[Tuple[float, float, float]] = None,
        damping: Optional[Tuple[float, float]] = None,
        gravity_scale: float = 1.0,
        locked_axes: int = 0,
        groups: Tuple[int, int] = (0xFFFFFFFF, 0xFFFFFFFF),
        tolerance_exponent: int = 0,
        sensor: bool = False,
        swept: bool = False,
        gyroscopic: bool = True,
        sleep: Optional[_Sleep] = None,
    ) -> npt.NDArray[np.uint64]:
        """Adds a body of one shape for each row of positions, and returns their ids. If one is wrong, none is added.

        rotations, linear_velocities and angular_velocities have one row for all or one for each. All else holds for all:

        shape: a Shape. kind: "dynamic" (the engine moves it), "fixed" (nothing does), or "kinematic" (commands do).
        mass: kilograms; None: volume times density. moments: of inertia about its own axes, kg m², beside a mass; None:
        those of its shape. material: friction, restitution from 0 to 1, and density in kg/m³; None: the scene's.
        damping: linear and angular, 1/s; None: the scene's. gravity_scale: factor on the scene's gravity.
        locked_axes: bits 1, 2, 4 for translations along x, y, z, bits 8, 16, 32 for rotations about them, in the world.
        groups: bits of its own collision groups, and of those that it touches. sensor: bodies pass through it, and events
        report them. swept: it does not pass through moving bodies however fast it is.
        tolerance_exponent: power of two on the tolerance of its copies, -3 to 3. gyroscopic: its axis of spin wanders if its
        moments differ, as in physics. sleep: "settled", once it is slow and neither gravity nor a motor moves it; "never"; or
        a speed of its fastest point, rad/s, and the seconds for which it must be as slow; None: as the scene has it.
        """

    def remove(self, body: _Bodies) -> Optional[int]:
        """Removes bodies, and the joints of each."""
    def set_pose(self, body: _Bodies, position: _Vector, rotation: Optional[_Rotation] = None) -> Optional[int]:
        """Places fixed and dynamic bodies at once; kinematic ones move there during the next tick. Unturned without a
        rotation.

        Poses of a kinematic body may come more seldom than ticks, up to four a second: it then moves evenly from one to the
        next, carries what lies on it, and stops at the last one. A pose beyond 100 m/s or a quarter of a turn in a tick is a
        jump that shoves nothing. If set_velocity follows, the body is there after one tick and continues at that velocity.
        """
    def set_velocity(self, body: _Bodies, linear: _Vector, angular: Optional[_Vector] = None) -> Optional[int]:
        """Sets velocities, in units of length per second and rad/s; a kinematic body keeps them. No spin without one."""
    def apply_force(self, body: _Bodies, force: _Vector, point: Optional[_Vector] = None) -> Optional[int]:
        """A force during the next tick, at the centre of mass or at a point of the world."""
    def apply_torque(self, body: _Bodies, torque: _Vector) -> Optional[int]:
        """A torque during the next tick, about world axes."""
    def apply_impulse(self, body: _Bodies, impulse: _Vector, point: Optional[_Vector] = None) -> Optional[int]:
        """An impulse at once, at the centre of mass or at a point of the world."""
    def apply_torque_impulse(self, body: _Bodies, impulse: _Vector) -> Optional[int]:
        """An angular impulse at once, about world axes."""
    def set_gravity(self, gravity: _Vector) -> Optional[int]:
        """Sets the scene's gravity, units of length per s²."""
    def sleep(self, body: _Bodies) -> Optional[int]:
        """Puts dynamic bodies to sleep, until something touches them."""
    def wake(self, body: _Bodies) -> Optional[int]:
        """Wakes bodies."""
    def report_events(
        self,
        body: _Bodies,
        *,
        contacts: bool = False,
        force: Optional[float] = None,
        sensors: bool = False,
        sleep: bool = False,
    ) -> Optional[int]:
        """Turns the events of bodies on; what is left out, off. A new body reports none.

        contacts: "contact began" and "contact ended", and what contacts() knows. force: "contact force" in every tick in
        which the force of a contact is at least that; 0.0 for all. sensors: "sensor entered" and "sensor left", of a sensor
        or of what enters it. sleep: "fell asleep" and "woke".
        """
    def contacts(self, body: Optional[int] = None) -> list[Contact]:
        """The contacts of now: of one body, or of all bodies.

        It knows the bodies that touch where one of the two reports contacts: call report_events(body, contacts=True) when
        you add them. With force=0.0 beside it, point, normal and force are those of the newest tick in which the two were
        awake; otherwise those of the beginning. Raises InvalidError for a body that this client never knew.
        """
    def add_joint(self, id: int, joint: Joint) -> Optional[int]:
        """Adds a joint under a number of yours, below 65,536, that no joint of the scene has."""
    def change_joint(self, id: int, joint: Joint) -> Optional[int]:
        """Replaces a joint, its limits and motors among others."""
    def remove_joint(self, id: int) -> Optional[int]:
        """Removes a joint. It goes with either of its bodies too."""
    def set_character(self, body: _Bodies, character: Character) -> Optional[int]:
        """Makes kinematic bodies characters, which walk by the velocity of set_velocity, or gives them other settings.

        Events, "reached ground" and "left ground", report their ground.
        """
    def set_vehicle(self, body: _Bodies, wheels: Sequence[Wheel]) -> Optional[int]:
        """Makes dynamic bodies vehicles on 1 to 16 wheels, which begin without inputs."""
    def clear_locomotion(self, body: _Bodies) -> Optional[int]:
        """Makes characters and vehicles ordinary bodies again."""
    def jump(self, body: _Bodies, speed: float, *, anywhere: bool = False) -> Optional[int]:
        """Characters rise with this speed, in units of length per second. In the air nothing happens, unless anywhere is
        true."""
    def set_wheels(self, body: _Bodies, inputs: Sequence[WheelInput]) -> Optional[int]:
        """Sets the inputs of all wheels of vehicles, in the order of their wheels. A vehicle keeps them."""
    def take_authority(self, body: _Bodies, tolerance: float = 0.02) -> None:
        """Requests authority over kinematic bodies in place of those of now; an empty row ends it.

        One client has authority over 256 bodies at most. The server's bodies are within the tolerance, in metres, of what
        publish sends; the tolerance of a stream adds to it: a client that follows within 0.05 m sees a body that is
        published within 0.02 m within 0.07 m of the publisher's.

        It is sent at once. An event, "authority granted" or "authority denied", answers; a denial raises RefusedError too.
        """
    def publish(
        self,
        body: _Bodies,
        position: _Vector,
        rotation: Optional[_Rotation] = None,
        linear: Optional[_Vector] = None,
        angular: Optional[_Vector] = None,
    ) -> Optional[int]:
        """Publishes the states of all bodies under this client's authority, once per frame; returns their tick.

        None, and nothing is published, before the authority is granted, before the server's clock is known, and for a
        second frame of one tick. A body that is left out stands still.
        """
    def remove_unused_shapes(self) -> int:
        """Queues the removal of the shapes that came with this client's bodies and that no body has, and returns their number.

        Queued additions, changes and removals of bodies count. A scene keeps its shapes until they are removed.
        """
    def set_lead_ticks(self, ticks: float) -> None:
        """Sets lead_ticks of join anew: by how many ticks publish is ahead of the server's clock."""
    def flush(self) -> None:
        """Sends the queued commands at once."""
    def advance(self, ticks: int = 1, depth: int = 0) -> int:
        """Steps a lockstep scene by some ticks, computes the view, and returns its tick.

        At depth 1, the view is one tick behind, and the server computes the newest one meanwhile. It raises RefusedError
        for what the server refused, once and after all of the ticks; the next call continues.
        """
    def wait(self, depth: int = 0) -> int:
        """Waits again for the tick of an advance that timed out."""
    def poll(self) -> Tuple[int, float]:
        """Computes the view of a free-running scene for now: its tick, and the part of the step to the next.

        It does not wait. A lockstep scene stands still until a client advances it. It raises RefusedError as advance does.
        """
    def idle(self, duration: float) -> None:
        """Handles what arrives for a time in seconds, without computing the view."""
    @property
    def time(self) -> Tuple[int, float]:
        """The moment of the view."""
    @property
    def bodies(self) -> npt.NDArray[np.uint64]:
        """Ids of the bodies of the view. All arrays have this order, which changes from view to view."""
    @property
    def positions(self) -> npt.NDArray[np.float32]:
        """Rows of x, y, z: the centre of mass, or the origin of a hull or compound added here. They stay those of their view."""
    @property
    def rotations(self) -> npt.NDArray[np.float32]:
        """A row of x, y, z, w for each body: body to world."""
    @property
    def linear_velocities(self) -> npt.NDArray[np.float32]:
        """Velocities of the centres of mass, a row for each body, units of length per second; zero at rest."""
    @property
    def angular_velocities(self) -> npt.NDArray[np.float32]:
        """Spins, a row for each body, rad/s about world axes; zero at rest."""
    @property
    def resting(self) -> npt.NDArray[np.bool_]:
        """True for each body that rests: its pose stays until it wakes."""
    @property
    def changed(self) -> npt.NDArray[np.uint32]:
        """Places of the bodies whose pose differs from that of the last view."""
    @property
    def removed(self) -> npt.NDArray[np.uint64]:
        """Bodies that were removed since the last view."""
    def place(self, body: int) -> int:
        """Place of a body in the arrays: scene.positions[scene.place(body)].

        Raises NotInViewError, a KeyError, for a body that is still to come, has gone, or was never there. "body in scene" asks
        whether the view has it.
        """
    def places(self, body: _Bodies) -> npt.NDArray[np.uintp]:
        """Places of many bodies, which must all be in the view: scene.positions[scene.places(bodies)]."""
    def error_bound(self, body: _Bodies) -> Union[float, npt.NDArray[np.float32]]:
        """How far any point of a body, as the view shows it, may be from its true place at the moment of the view.

        In the scene's unit of length; an array for a row of bodies. Infinite while nothing finite is known: a packet is
        missing, or a free-running view shows a moment of which the news has not arrived. Give join delay_ticks of the
        network's delay and a little more for a finite one.
        """
    @property
    def error_bounds(self) -> npt.NDArray[np.float32]:
        """The error_bound of every body of the view, in the order of the arrays."""
    def tick_error_bound(self, body: _Bodies, tick: int) -> Union[float, npt.NDArray[np.float32]]:
        """How far any point of a body may be off at a tick by what is known of it, whatever the view shows."""
    def events(self) -> list[Event]:
        """All events since the last call, the oldest first. They tell what became of commands, and what bodies did."""
    def query(self, queries: Sequence[Query]) -> Tuple[int, list[list[Hit]]]:
        """Asks the server, and waits: the tick whose scene was asked, and what each query found."""
    @property
    def statistics(self) -> _Statistics:
        """Counts since the client connected: sent_bytes and received_bytes in UDP datagrams, updates of bodies, complete_tick
        (the newest one at which every copy is within its tolerance), behind_ticks (of the view behind the server's clock;
        None before it is known), and updates, packets and bytes of the upstream since authority was granted."""
    def delete(self) -> None:
        """Deletes the scene for all of its clients."""
    def close(self) -> None:
        """Leaves the scene. A second time does nothing."""
    @property
    def closed(self) -> bool:
        """True once it is closed."""
    def __len__(self) -> int: ...
    def __contains__(self, body: int) -> bool: ...
    def __enter__(self) -> Scene: ...
    def __exit__(
        self,
        error_type: Optional[Type[BaseException]],
        error: Optional[BaseException],
        traceback: Optional[TracebackType],
    ) -> None: ...
