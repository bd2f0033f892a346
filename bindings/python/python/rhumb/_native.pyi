"""Types of the native module, with the documentation that help() shows.

Every array that is returned is read-only or the caller's own, and never changes.
"""

import os
from types import TracebackType
from typing import Dict, List, Literal, Mapping, Optional, Sequence, Tuple, Type, TypedDict, Union, final

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
    """Connects to the server at host:port, or at unix:PATH.

    Trust its certificate by the fingerprint that the server prints, or by a PEM file with roots; not by both. The Unix
    socket of a server of this machine and user has none, and needs neither. A token admits the client to a server that is
    not open. The time limit, in seconds, holds for every later call that waits.
    """

def local(
    scene: str = "main",
    *,
    fed: bool = False,
    coordinates: Literal["rhumb", "unity", "unreal", "z-up"] = "rhumb",
    condition: Literal["create or join", "create", "join"] = "create or join",
    tolerance: float = 0.05,
    cells: bool = False,
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
    """A scene in this process, on a server of its own: no program to start, no sockets, no fingerprint.

    The options are those of Connection.join. The server ends with the scene. It steps within the scene's calls, so that a
    free-running scene moves on only while it is polled. LocalServer has several clients of one scene, and a thread.
    fed: whether this program has the engine, and feeds the scene: see Scene.feed.
    """

def serve(
    scene: str = "main",
    *,
    listen: str = "127.0.0.1:0",
    open_to_network: bool = False,
    quiet: bool = False,
    checkpoint: Optional[Checkpoint] = None,
    fed: bool = False,
    coordinates: Literal["rhumb", "unity", "unreal", "z-up"] = "rhumb",
    condition: Literal["create or join", "create", "join"] = "create or join",
    tolerance: float = 0.05,
    cells: bool = False,
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
    """A scene in this process that others join, on a server of its own: no program to start, no fingerprint to copy.

    Scene.address is the one text by which other processes connect: rhumb.connect(scene.address).join("main"). It is printed
    too, unless quiet. rhumb.view(scene) shows the scene in a browser.

    listen: IP address and port of the server; port 0 is a free one. open_to_network: whether the address may be one that
    other machines reach. There are no tokens: each client may do everything. The rest is as of Connection.join. The
    server has threads of its own and ends with the scene, for every member. With a checkpoint, the scene continues from it.
    fed: whether this program has the engine, and feeds the scene: see Scene.feed; not with a checkpoint.
    """

@final
class LocalServer:
    """A physics server in this process, without sockets. It ends with the last of its clients and of the references to it.

    own_thread: whether it steps on a thread of its own, so that a free-running scene moves on between calls; without it, it
    steps within the calls of its clients. Clients on several threads take turns then: each waits while another one's call
    steps, and other threads of the interpreter run meanwhile.
    """

    def __init__(self, *, own_thread: bool = False) -> None: ...
    def connect(self, *, timeout: float = 5.0, feed: Optional[str] = None) -> Connection:
        """A connection of one more client, which joins a scene. The time limit, in seconds, holds for every later call that waits.

        feed: the name of the scene that the client will make when it joins, and feed: see Scene.feed.
        """
    def restore(self, scene: str, checkpoint: Checkpoint) -> None:
        """Makes a scene that continues from a checkpoint, to be joined by its name.

        Bodies keep their ids. The scene has no members at first: it ends if none joins for ten minutes.
        """

@final
class Checkpoint:
    """A scene at a moment, with all that decides its further run; Scene.save makes it, and restore makes scenes of it.

    bytes(checkpoint) is a file of it, and Checkpoint(data) reads that: what is damaged, or of another version of rhumb, is
    refused. The checksum finds damage and no malice: read files of those whose programs you would run.
    """

    def __init__(self, data: bytes) -> None: ...
    @property
    def tick(self) -> int:
        """The tick of the scene."""
    def __bytes__(self) -> bytes: ...
    def __hash__(self) -> int: ...

@final
class Connection:
    """A connection to a server that has joined no scene; connect makes it, and LocalServer.connect.

    It closes at the end of a with block, unless join has used it up.
    """

    def join(
        self,
        scene: str,
        *,
        coordinates: Literal["rhumb", "unity", "unreal", "z-up"] = "rhumb",
        condition: Literal["create or join", "create", "join"] = "create or join",
        tolerance: float = 0.05,
        cells: bool = False,
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
        cells: whether the scene is taken by cells, if its server divides it: see Scene.take_cells_around. The tolerance is then
        of the bodies that are in no cell.
        refusals: "raise" has the next advance, wait or poll raise RefusedError for what the server refused; "events" leaves
        that to events().
        resume_within: seconds for which the client tries to continue over another connection; None: as the scene suggests.

        Of a new scene are: stepping, "lockstep" (advance steps it) or "free running" (the server's clock does);
        ticks_per_second, 1 to 1000; substeps of each tick, 1 to 16; publish_interval, the ticks from one that is sent to the
        next; gravity, three numbers, the earth's if it is None; sleep, as of add_body, of bodies without one, "settled" if it is
        None.

        Of a free-running view are: delay_ticks, by which it stays behind the server's clock, so that nothing of it is
        guessed; whole_ticks, whether only whole ticks are shown; smooth, whether corrections are shown as short glides;
        lead_ticks, by which publish is ahead of the server's clock.

        resume_within: seconds for which the session continues over another connection after one that ended, as when the
        process stood still for ten seconds; None: a minute if the server keeps its scenes, else not at all.
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

    collide: whether the two bodies also collide with each other. breaks_at: the force and the torque at which it breaks, N and
    N m, or kg cm/s² and kg cm²/s² in Unreal's coordinates.
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

# >>> records, made by bindings/table
@final
class Character:
    """A character: a kinematic body that walks by its velocity, as far as the world lets it, and falls.

    offset: gap that it keeps to its surroundings, units of length: 0.001 to 10,000 m; 0.02 m by default.
    climb_angle: steepest slope that it climbs, from level ground: 0 to π/2 rad; π/4 rad by default.
    slide_angle: slope from which on it slides down, from level ground: 0 to π/2 rad; π/4 rad by default.
    mass: mass with which it pushes dynamic bodies, none at zero: 0 to 1,000,000 kg; 80 kg by default.
    up: direction away from the ground, of unit length, instead of the one against gravity.
    step: greatest height of a step that it climbs, units of length: 0.001 to 10,000 m, and free width that it
    needs on a step, units of length: 0.001 to 10,000 m; None for none.
    onto_dynamic: it also climbs onto dynamic bodies; otherwise it pushes them.
    snap: greatest drop of the ground that it follows without a fall, units of length: 0.001 to 10,000 m; 0.2 m
    by default; 0 for none.
    """

    def __init__(
        self,
        *,
        offset: Optional[float] = None,
        climb_angle: Optional[float] = None,
        slide_angle: Optional[float] = None,
        mass: Optional[float] = None,
        up: Optional[_Vector] = None,
        step: Optional[Tuple[float, float]] = None,
        onto_dynamic: bool = False,
        snap: Optional[float] = None,
    ) -> None: ...

@final
class Wheel:
    """A wheel of a vehicle, in the axes of its chassis and from the origin of its shape: a ray with a spring.

    position: upper end of the suspension, units of length: at most 10,000 m along each axis.
    radius: radius of the wheel, units of length: 0.001 to 10,000 m.
    direction: direction of the suspension, of unit length, towards the ground; down by default.
    axle: axis about which the wheel turns, of unit length, to the right of the way forward; along x by default,
    in Unreal's coordinates along y.
    rest_length: length of the suspension without load, from the position to the wheel's centre, units of
    length: 0 to 10,000 m; 0.3 m by default.
    travel: greatest change of that length, units of length: 0 to 10,000 m; 0.25 m by default.
    stiffness: acceleration of the chassis for a change of that length: 0 to 1,000,000 1/s²; 50 1/s² by default.
    compression: damping while the spring is compressed: 0 to 1,000,000 1/s; 4 1/s by default.
    relaxation: damping while the spring relaxes: 0 to 1,000,000 1/s; 6 1/s by default.
    force_max: greatest force of the suspension, kg times units of length per s²: 0 to 1,000,000,000 N; any by
    default.
    friction_slip: greatest force along the ground, as a share of the suspension's force, of which the part
    along the way forward counts half: 0 to 100; 2 by default.
    side_friction: factor of the force along the axle that keeps the wheel from sliding sideways: 0 to 100; 1 by
    default.
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
    """Steering, force and brake of a wheel.

    Without any, it rolls freely.

    steering: turn about the axis that points up, to the left if positive, in left-handed coordinates to the
    right: -π to π rad.
    force: force along the way forward, backward if negative, kg times units of length per s²: -1,000,000,000 to
    1,000,000,000 N.
    brake: greatest force that stops it, while it has no force, kg times units of length per s²: 0 to
    1,000,000,000 N.
    """

    def __init__(self, steering: float = 0.0, force: float = 0.0, brake: float = 0.0) -> None: ...

# <<< records

@final
class Request:
    """A request of another member of a scene that this program feeds, of Scene.requests. A field that its kind does not name is None."""

    @property
    def kind(self) -> str:
        """One of: "add body", "remove body", "change body", "set pose", "set velocity", "apply force", "apply torque",
        "apply impulse", "apply torque impulse", "sleep", "wake", "set gravity", "add joint", "change joint", "remove joint"."""
    @property
    def body(self) -> Optional[int]:
        """The body that it is about; of a joint the first one."""
    @property
    def client(self) -> Optional[str]:
        """The client that the member's token names, if it has one."""
    @property
    def number(self) -> int:
        """The number of the member's command."""
    @property
    def position(self) -> Optional[Tuple[float, float, float]]:
        """Of a body or a pose: the centre of mass."""
    @property
    def rotation(self) -> Optional[Tuple[float, float, float, float]]:
        """Of a body or a pose: a unit quaternion x, y, z, w, body to world."""
    @property
    def linear_velocity(self) -> Optional[Tuple[float, float, float]]:
        """Of a body or a velocity: units of length per second."""
    @property
    def angular_velocity(self) -> Optional[Tuple[float, float, float]]:
        """Of a body or a velocity: rad/s about world axes."""
    @property
    def vector(self) -> Optional[Tuple[float, float, float]]:
        """The force, torque, impulse or gravity."""
    @property
    def point(self) -> Optional[Tuple[float, float, float]]:
        """The point of the world where a force or an impulse acts, if not at the centre of mass."""

@final
class Loaded:
    """A file that was added to a scene; Scene.load makes it.

    A name that the file has twice, or not at all, has a number here.
    """

    @property
    def name(self) -> str:
        """The file's own name of its robot or scene."""
    @property
    def bodies(self) -> Dict[str, int]:
        """The id of each body by its name in the file; those that others hold come after them."""
    @property
    def joints(self) -> Dict[str, int]:
        """The number of each joint by its name in the file."""
    @property
    def frames(self) -> Dict[str, Tuple[Tuple[float, float, float], Tuple[float, float, float, float]]]:
        """By the name of a body: position and rotation of the file's frame of it, from its centre of mass and in its axes."""
    @property
    def left_out(self) -> List[str]:
        """A sentence for each thing that the file says and the scene has not, or has by something near to it."""

def file_settings(
    file: Union[str, os.PathLike[str]], coordinates: str = "rhumb", **keywords: object
) -> Tuple[Tuple[float, float, float], Optional[int], int]:
    """Gravity, ticks per second (None: no whole number) and substeps that a file asks of a new scene."""

def advance_scenes(scenes: Sequence[Scene], numbers: Sequence[int], ticks: int, threads: int) -> None:
    """Steps each of these lockstep scenes by some ticks, on as many threads, and computes their views.

    Raises the error of the first of them that has one, after all were stepped as far as they can be; numbers are their names.
    """

def numbers_of_scenes(scenes: Sequence[Scene], what: str) -> npt.NDArray[np.float32]:
    """The numbers of all bodies in all of these scenes, in one row.

    what: "positions", "rotations", "linear_velocities" or "angular_velocities". Raises InvalidError if the scenes do not have
    the same bodies.
    """

def resting_of_scenes(scenes: Sequence[Scene]) -> npt.NDArray[np.bool_]:
    """Which bodies of all of these scenes rest, in one row.

    Raises InvalidError if the scenes do not have the same bodies.
    """

@final
class Query:
    """A question about where the bodies are, for Scene.query: Query.ray, shape_cast, projection, overlap or
    contacts.

    hits is the most bodies that it finds, 1 to 64. among changes which bodies count.
    """

    @staticmethod
    def ray(origin: _Vector, translation: _Vector, *, hits: int = 1) -> Query:
        """The nearest bodies along a line from origin to origin + translation. Sensors do not count.

        A body whose surface the line only reaches with its end is not hit.
        """
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
    @staticmethod
    def contacts(body: int, *, hits: int = 64) -> Query:
        """The bodies that touch a body after the last step, the deepest contact first: the points of its hits lie on the body
        that is asked about."""
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
        """Along the way, from the point to the surface, or from surface to surface, negative inside; zero for an overlap."""
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
    """Something that happened, or the answer to a command. A field that its kind does not name is zero, None or empty."""

    @property
    def kind(self) -> str:
        # >>> kinds of events, made by bindings/table
        """One of: "commands applied", "command refused", "body placed", "body removed", "contact began", "contact
        ended", "contact force", "sensor entered", "sensor left", "fell asleep", "woke", "body fault", "reached
        ground", "left ground", "events missed", "stream changed", "publisher silent", "publisher active", "scene
        restored", "scene faulted", "scene deleted", "interrupted", "resumed", "session lost", "durable",
        "authority granted", "authority denied", "denied", "ended", "other"."""
        # <<< kinds of events
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
    events_left_out: int
    contacts_left_out: int

@final
class Scene:
    """A client of one scene. It leaves the scene at the end of a with block.

    It has no constructor: rhumb.connect(address, fingerprint=...).join(name), rhumb.local() and rhumb.serve() return one.

    Bodies have ids, which add_body and add_bodies return. Every call that takes a body takes a row of ids too, with one row
    of numbers for all of them or one for each. The poses of all bodies are arrays of one order; place finds a body in them.

    Lengths are in the unit of the scene's coordinates, and so are forces and torques: N and N m, and in Unreal's coordinates
    kg cm/s² and kg cm²/s². Impulses are those times a second. Limits are stated in SI units.

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

    # >>> commands, made by bindings/table
    def remove(self, body: _Bodies) -> Optional[int]:
        """Removes a body, and its joints."""
    def set_pose(self, body: _Bodies, position: _Vector, rotation: Optional[_Rotation] = None) -> Optional[int]:
        """Puts a fixed or dynamic body elsewhere at once, and moves a kinematic one there during the next tick.

        If poses of a kinematic body come more seldom than ticks, up to four a second, it moves evenly from one to
        the next, carries what lies on it, and stops at the last one. A pose that is farther than 100 m/s or a
        quarter of a turn in a tick from where its motion leads is a jump that shoves nothing. If a velocity is set
        after the pose, the body is there after one tick and continues at that velocity.

        position: place of its centre of mass, or of the origin of a hull or compound added here, units of length:
        at most 100,000 m along each axis.
        rotation: unit quaternion x, y, z, w, body to world.
        """
    def set_velocity(self, body: _Bodies, linear: _Vector, angular: Optional[_Vector] = None) -> Optional[int]:
        """Sets both velocities.

        A kinematic body keeps them, and a character walks by them.

        linear: velocity of the centre of mass, units of length per second: at most 1,000 m/s along each axis.
        angular: angular velocity about world axes: at most 100 rad/s along each axis.
        """
    def apply_force(self, body: _Bodies, force: _Vector, point: Optional[_Vector] = None) -> Optional[int]:
        """Applies a force at the centre of mass during the next tick; one that makes the body too fast is refused.

        With a point, it acts there.

        force: in world axes, kg times units of length per s²: at most 1,000,000,000 N along each axis.
        point: point of the world where it acts, units of length: at most 100,000 m along each axis.
        """
    def apply_torque(self, body: _Bodies, torque: _Vector) -> Optional[int]:
        """Applies a torque during the next tick; one that makes the body spin too fast is refused.

        torque: about world axes, kg times units of length² per s²: at most 1,000,000,000 N·m along each axis.
        """
    def apply_impulse(self, body: _Bodies, impulse: _Vector, point: Optional[_Vector] = None) -> Optional[int]:
        """Applies an impulse at the centre of mass: the velocity changes at once; one that makes the body too fast
        is refused.

        With a point, it acts there.

        impulse: in world axes, kg times units of length per second: at most 1,000,000,000 N·s along each axis.
        point: point of the world where it acts, units of length: at most 100,000 m along each axis.
        """
    def apply_torque_impulse(self, body: _Bodies, impulse: _Vector) -> Optional[int]:
        """Applies an angular impulse: the spin changes at once; one that makes the body spin too fast is refused.

        impulse: about world axes, kg times units of length² per second: at most 1,000,000,000 N·m·s along each
        axis.
        """
    def sleep(self, body: _Bodies) -> Optional[int]:
        """Puts a dynamic body to sleep, until something that moves touches it."""
    def wake(self, body: _Bodies) -> Optional[int]:
        """Wakes a dynamic body."""
    def report_events(
        self,
        body: _Bodies,
        *,
        contacts: bool = False,
        sensors: bool = False,
        sleep: bool = False,
        force: Optional[float] = None,
    ) -> Optional[int]:
        """Turns the events of a body on; what is left out, off.

        A new body reports none.

        contacts: its contacts begin and end.
        sensors: bodies enter and leave the sensor, or the body enters and leaves sensors.
        sleep: it falls asleep and wakes.
        force: least force of a contact that is reported, in each tick, zero for all, kg times units of length per
        s²: 0 to 1,000,000,000 N.
        """
    def clear_locomotion(self, body: _Bodies) -> Optional[int]:
        """Makes a character or a vehicle an ordinary body again."""
    def set_character(self, body: _Bodies, character: Character) -> Optional[int]:
        """Makes a kinematic body a character, which walks by the velocity that is set, or gives a character other
        settings.

        Events report when it reaches the ground and when it leaves it.
        """
    def set_vehicle(self, body: _Bodies, wheels: Sequence[Wheel]) -> Optional[int]:
        """Makes a dynamic body a vehicle, whose wheels begin without inputs."""
    def jump(self, body: _Bodies, speed: float, *, anywhere: bool = False) -> Optional[int]:
        """Lets a character rise along its direction up.

        In the air nothing happens, unless it may jump from anywhere.

        speed: speed with which it rises, units of length per second: -1,000 to 1,000 m/s.
        anywhere: it jumps in the air too.
        """
    def set_wheels(self, body: _Bodies, inputs: Sequence[WheelInput]) -> Optional[int]:
        """Sets steering, force and brake of all wheels of a vehicle.

        It keeps them until the next ones.

        inputs: in the order of the wheels.
        """
    def set_gravity(self, gravity: _Vector) -> Optional[int]:
        """Changes the gravity of the scene.

        gravity: in world axes, units of length per s²: at most 1,000 m/s² along each axis.
        """
    # <<< commands
    def contacts(self, body: Optional[int] = None) -> list[Contact]:
        """The contacts of now: of one body, or of all bodies.

        It knows the bodies that touch where one of the two reports contacts: call report_events(body, contacts=True) when
        you add them. With force=0.0 beside it, point, normal and force are those of the newest tick in which the two were
        awake; otherwise those of the beginning. Where more than 1,024 pairs report forces, they take turns: tick tells. A
        member that joins later knows those that touch already, too. Query.contacts
        asks the server about any body. Raises InvalidError for a body that this client never knew.
        """
    def add_joint(self, id: int, joint: Joint) -> Optional[int]:
        """Adds a joint under a number of yours, below 65,536, that no joint of the scene has."""
    def change_joint(self, id: int, joint: Joint) -> Optional[int]:
        """Replaces a joint, its limits and motors among others."""
    def remove_joint(self, id: int) -> Optional[int]:
        """Removes a joint. It goes with either of its bodies too."""
    def take_authority(self, body: _Bodies, tolerance: float = 0.02) -> None:
        """Requests authority over kinematic bodies in place of those of now; an empty row ends it.

        One client has authority over 256 bodies at most. The server's bodies are within the tolerance, in metres, of what
        publish sends; the tolerance of a stream adds to it: a client that follows within 0.05 m sees a body that is
        published within 0.02 m within 0.07 m of the publisher's.

        It is sent at once. An event, "authority granted" or "authority denied", answers; a denial raises RefusedError too. A
        second request before the answer raises InvalidError. For a member by cells, the grant of a body waits until a cell that
        it takes has had the body.
        """
    @property
    def cell_grid(self) -> Optional[Tuple[float, float, float]]:
        """Edges of the scene's cells along x, y and z, units of length; 0 along an axis that is not divided.

        Cell (i, j, k) reaches from i times the edge to i + 1 times the edge along x, and so on; along an axis that is not
        divided, its number is 0. None for a scene that is not divided, and for one that was not joined with cells=True.
        """
    def take_cells_around(self, point: _Vector, bands: Sequence[Tuple[float, Optional[float]]]) -> None:
        """Takes the cells around a point and no others: each with the tolerance of the nearest band that reaches it.

        bands: pairs of a radius in units of length and a tolerance in metres, as in [(40, 0.01), (150, 0.2)];
        None in place of a tolerance: exact states. Call it as the point moves: what is taken already costs nothing.

        The view has the bodies of these cells, each once, and those that are in no cell: bodies whose bounding radius is more
        than half of the shortest edge, such as floors. A body that leaves the cells is among removed, and no event tells of it: it
        was not removed from the scene. It does not wait: cells tells which are there. A radius of 0 takes the cell that has the point.

        Raises InvalidError for a scene whose cell_grid is None, for more than 256 cells, for a point that is in no world, and for a
        radius that is negative or not finite; then all stays as it was.
        """
    def take_cells(self, cells: Mapping[Tuple[int, int, int], Optional[float]]) -> None:
        """Takes these cells and no others, each with its tolerance in metres; None: exact states. As take_cells_around."""
    @property
    def cells(self) -> Dict[Tuple[int, int, int], str]:
        """States of the cells that are taken: "awaited", "shown", or "denied", as denied_cells explains.

        A cell is awaited until its snapshot has come, once more after a resumed session, which shows it until then as it was. It stays
        shown while another tolerance is on its way. A cell that was denied is asked for again by the next take_cells or take_cells_around.
        """
    @property
    def denied_cells(self) -> Dict[Tuple[int, int, int], str]:
        """Why the server denies cells that are taken, a sentence each."""
    def publish(
        self,
        body: _Bodies,
        position: _Vector,
        rotation: Optional[_Rotation] = None,
        linear: Optional[_Vector] = None,
        angular: Optional[_Vector] = None,
    ) -> Optional[int]:
        """Publishes the states of all bodies under this client's authority, once per frame; returns their tick.

        Give the states of now. In a lockstep scene their tick is the one that the next advance makes. In a free-running scene
        it is the tick nearest to now by the server's clock, plus lead_ticks; positions are moved to it by their velocities, by
        half a tick at most.

        None, and nothing is published, before the authority is granted, before the server's clock is known, and for a
        second frame of one tick. A body that is left out stands still.
        """
    def feed(
        self,
        body: _Bodies,
        position: _Vector,
        rotation: Optional[_Rotation] = None,
        linear: Optional[_Vector] = None,
        angular: Optional[_Vector] = None,
        *,
        tick: Optional[int] = None,
    ) -> int:
        """Hands over the states of one tick of a scene whose engine is in this program, has it step, and returns the tick.

        The scene is one of local(fed=True), serve(fed=True) or LocalServer.connect(feed=name). Call it once for each step of the
        engine, with the bodies in any order. A body that is left out rests where it is, and so does one that is fed at one pose
        without a velocity for five ticks; resting bodies cost nothing.

        tick: that of the states, from 1 on; None: the next one. Up to 600 ticks may be left out: the bodies then go evenly from
        one state to the next. rotation: None for bodies that are not turned, whatever they were before. Without linear and angular,
        velocities follow from the poses, as for an engine whose own are of no use.

        Followers see every pose within their tolerance. How many bytes that takes depends on gravity and substeps of join, and on
        mass, moments, damping and gravity_scale of add_body.

        It raises RefusedError, after it has handed the states over, for what the scene refused since the last call: commands of
        this program, and requests that it accepted.
        """
    def requests(self) -> List[Request]:
        """The unread requests of other members of a scene that this program feeds, the oldest first.

        Each is a command that a member gave. One that moves a body is answered by what is fed. One that adds, changes or removes
        something changes the scene once it is accepted: a body that is asked for has an id already, and is fed from then on.
        """
    def accept(self, request: Request) -> None:
        """Changes the scene as another member asked. A request has one answer: Error for a second one.

        If the scene cannot, or the member has left, the member is refused after all, and the next feed raises RefusedError.
        """
    def refuse(self, request: Request) -> None:
        """Refuses what another member asked for: it learns of it as of any refusal."""
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

        At depth 1, the view is one tick behind, and the server computes the newest one meanwhile. A greater depth, up to
        64, hides a link whose round trip is longer than a tick. It raises RefusedError
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
        """Bodies of the last view that are not in this one: removed, or in no cell that is taken."""
    def place(self, body: int) -> Optional[int]:
        """Place of a body in the arrays: scene.positions[scene.place(body)].

        None for a body that is still to come or has gone; the arrays refuse None as a place, with an IndexError. Raises
        NotInViewError, a KeyError, for a body that this client never knew. "body in scene" asks whether the view has it.
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
        """All events since the last call, the oldest first. They tell what became of commands, and what bodies did.

        At most 65,536 unread ones are kept: statistics["events_left_out"] counts those that were dropped, the oldest first.
        """
    def query(self, queries: Sequence[Query]) -> Tuple[int, list[list[Hit]]]:
        """Asks the server, and waits: the tick whose scene was asked, and what each query found."""
    @property
    def statistics(self) -> _Statistics:
        """Counts since the client connected: sent_bytes and received_bytes in UDP datagrams, updates of bodies, complete_tick
        (the newest one at which every copy is within its tolerance), behind_ticks (of the view behind the server's clock;
        None before it is known), updates, packets and bytes of the upstream since authority was granted, events_left_out
        (dropped unread, beyond 65,536) and contacts_left_out (pairs that touch and that contacts lacks, beyond 32,768)."""
    def delete(self) -> None:
        """Deletes the scene for all of its clients."""
    def load(
        self,
        file: Union[str, os.PathLike[str]],
        position: Optional[_Vector] = None,
        *,
        rotation: Optional[_Vector] = None,
        base: Literal["file", "fixed", "free"] = "file",
        own_contacts: Literal["file", "all"] = "file",
        packages: Sequence[Union[str, os.PathLike[str]]] = (),
        density: float = 1000.0,
        group: int = 1,
        first_joint: Optional[int] = None,
    ) -> Loaded:
        """Adds a robot or a scene from a file: URDF, MJCF with their meshes, glTF, or Rhumb's JSON.

        Loaded.left_out lists what the file says and a scene has not, with file and line. A file that cannot be read
        raises InvalidError, and nothing is added. Gravity and ticks are the scene's: rhumb.load makes a scene with the file's.

        position, rotation: where the file's world, or a robot's root, begins; what is up in the file is up in the scene.
        base: whether the root of a robot moves: "fixed", "free", or as the file has it. own_contacts: whether parts of a
        robot touch each other: "all" that no joint connects, or as other programs read the file. packages: folders that are
        searched for package:// names, before those above the file. density: kg/m³ of bodies with shapes and no mass.
        group: the collision group, below 32, of a robot's parts. first_joint: number of the first joint; None: the least
        that are free.
        """
    @property
    def address(self) -> Optional[str]:
        """Address and fingerprint of the server, by which other processes connect; None unless serve made the scene."""
    def page(self) -> str:
        """The address of the page that shows this scene to browsers of this machine, until the scene is closed.

        Queued commands are sent first. The server must be in this process: serve, local or LocalServer. While a browser shows a
        scene of local, the scene's server is looked at between calls too, so that one that runs free moves on.
        """
    def save(self) -> Checkpoint:
        """The whole state of the scene, with everything that this client has sent: bodies, joints, sleep, contacts, and the
        engine's own memory of them. Scenes that restore makes of it run to the same bits, given the same commands before the
        same ticks. A fork of a scene is rhumb.restore(scene.save()).

        The server must be in this process: of serve, local or LocalServer.
        """
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
