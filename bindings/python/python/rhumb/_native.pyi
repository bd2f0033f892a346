"""Types of the native module.

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

def connect(
    address: str,
    *,
    fingerprint: Optional[str] = None,
    roots: Union[str, os.PathLike[str], None] = None,
    token: Optional[str] = None,
    timeout: float = 5.0,
) -> Connection:
    """Connects to the server at host:port.

    Trust its certificate by the fingerprint that the server prints, or by a PEM file with roots; not by both. The time
    limit, in seconds, holds for every later call that waits.
    """

@final
class Connection:
    """A connection to a server that has joined no scene."""

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
        delay_ticks: float = 0.0,
        smooth: bool = True,
        resume_within: Optional[float] = None,
    ) -> Scene:
        """Joins a scene, and uses the connection up; wrong arguments do not.

        The tolerance is how far any point of a copied body may be off, in metres whatever the coordinates. Stepping, ticks,
        substeps, publish interval and gravity are those of a new scene; no gravity means the earth's.
        """

    def close(self) -> None: ...
    @property
    def closed(self) -> bool: ...
    def __enter__(self) -> Connection: ...
    def __exit__(
        self,
        error_type: Optional[Type[BaseException]],
        error: Optional[BaseException],
        traceback: Optional[TracebackType],
    ) -> None: ...

@final
class Shape:
    """A shape, centred on its body's centre of mass. Long axes point up. Lengths are in the scene's unit."""

    @staticmethod
    def ball(radius: float) -> Shape: ...
    @staticmethod
    def cuboid(x: float, y: float, z: float) -> Shape:
        """By half the edge lengths."""
    @staticmethod
    def rounded_cuboid(x: float, y: float, z: float, radius: float) -> Shape: ...
    @staticmethod
    def capsule(half_height: float, radius: float) -> Shape: ...
    @staticmethod
    def cylinder(half_height: float, radius: float) -> Shape: ...
    @staticmethod
    def cone(half_height: float, radius: float) -> Shape: ...
    @staticmethod
    def half_space(normal: _Vector) -> Shape:
        """Everything behind a plane, whose normal points out of it. For fixed bodies."""
    @staticmethod
    def hull(points: npt.ArrayLike) -> Shape:
        """The convex hull of rows of three numbers."""
    @staticmethod
    def mesh(points: npt.ArrayLike, triangles: npt.ArrayLike) -> Shape:
        """A mesh of triangles, each a row of three places of points. For fixed bodies."""
    @staticmethod
    def heights(heights: npt.ArrayLike, row_spacing: float = 1.0, column_spacing: float = 1.0) -> Shape:
        """A field of heights by row and column. For fixed bodies.

        The first post is at the body's origin; the rows follow each other along x, the columns along the other axis of the
        ground.
        """
    @staticmethod
    def compound(parts: Sequence[Union[Tuple[Shape, _Vector], Tuple[Shape, _Vector, _Rotation]]]) -> Shape:
        """Several shapes in the axes of a body, from its centre of mass: shape, position, and a rotation if it is turned."""

@final
class Joint:
    """A joint of two bodies, for Scene.add_joint and Scene.change_joint."""

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
    ) -> None:
        """Each body has a frame of the joint: an anchor from its centre of mass, and a rotation.

        A spherical joint leaves every turn free, a revolute one the turn about x of the frames, a prismatic one the
        displacement along x, a generic one every axis that it does not lock. A rope has a greatest length; a spring has a
        length, a stiffness in N/m and a damping in N s/m.

        Limits and motors are by axis: 0 to 2 along x, y, z, 3 to 5 about them. A limit is the least and the most. A motor
        is the position and the velocity that it drives to, its stiffness in 1/s², its damping in 1/s, and its greatest
        force, or None for any. The joint breaks at a force or a torque.
        """

@final
class Character:
    """A character, for Scene.set_character: a kinematic body that walks, as far as the world lets it, and falls."""

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
    ) -> None:
        """Up is the direction away from the ground, of unit length; against gravity if it is left out.

        The offset is the gap that it keeps to its surroundings, 0.02 m if it is left out. It climbs slopes of up to the
        first angle, and slides down from the second one on; both are radians from level ground, 45 degrees if they are left
        out. It pushes dynamic bodies with its mass, in kilograms.

        A step is the greatest height that it climbs, and the free width that it needs there; without one it climbs none.
        It climbs onto dynamic bodies too if it is set so, and pushes them otherwise. The snap is the greatest drop of the
        ground that it follows without a fall, 0.2 m if it is left out, and none at 0.
        """

@final
class Wheel:
    """A wheel of a vehicle, for Scene.set_vehicle: a ray with a spring, in the axes of its chassis."""

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
    ) -> None:
        """The position is the upper end of its suspension, from the centre of mass of the chassis.

        The direction of the suspension, of unit length, is down if it is left out. The axle, of unit length, points to the
        right of the way forward. It is along x if it is left out, in Unreal's coordinates along y: forward is then -z in
        Rhumb's coordinates, z in Unity's, x in Unreal's, and y where z is up.

        The suspension has its rest length without load, 0.3 m, and changes by at most its travel, 0.25 m. Its stiffness is
        an acceleration for a length, 50/s²; its damping is 4/s in compression, and 6/s in relaxation. It pushes with any
        force unless a greatest one is set.

        The greatest force along the ground is a share of the suspension's force, the friction slip, 2; the part along the
        way forward counts half. The side friction, 1, is a factor of the force that keeps the wheel from sliding sideways.
        """

@final
class WheelInput:
    """Steering, force and brake of a wheel, for Scene.set_wheels."""

    def __init__(self, steering: float = 0.0, force: float = 0.0, brake: float = 0.0) -> None:
        """A positive steering, in radians, turns left; in left-handed coordinates it turns right.

        The force acts forward, a negative one backward. The brake is the greatest force that stops the wheel; one with a
        force does not brake.
        """

@final
class Query:
    """A question about where the bodies are."""

    @staticmethod
    def ray(origin: _Vector, translation: _Vector, *, hits: int = 1) -> Query:
        """The nearest bodies along a line."""
    @staticmethod
    def shape_cast(
        shape: Shape, position: _Vector, translation: _Vector, *, rotation: Optional[_Rotation] = None, hits: int = 1
    ) -> Query:
        """The nearest bodies that a simple shape touches on its way."""
    @staticmethod
    def projection(point: _Vector, distance: float, *, hits: int = 1) -> Query:
        """The bodies whose surfaces are nearest to a point, within a distance."""
    @staticmethod
    def overlap(shape: Shape, position: _Vector, *, rotation: Optional[_Rotation] = None, hits: int = 64) -> Query:
        """The bodies that a simple shape overlaps."""
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
        """The same question about other bodies."""

@final
class Hit:
    """A body that a query found."""

    @property
    def body(self) -> int: ...
    @property
    def distance(self) -> float: ...
    @property
    def point(self) -> Tuple[float, float, float]: ...
    @property
    def normal(self) -> Tuple[float, float, float]: ...

@final
class Event:
    """Something that happened, or the answer to a command. What its kind does not name is zero, None or empty."""

    @property
    def kind(self) -> str:
        """Such as "contact began", "body placed", "command refused"."""
    @property
    def after(self) -> int:
        """The newest complete tick when the event was read: no view of an earlier tick shows its effect."""
    @property
    def tick(self) -> int:
        """The tick in which it happened, if the server says so; otherwise the same as `after`."""
    @property
    def number(self) -> int: ...
    @property
    def body(self) -> Optional[int]: ...
    @property
    def other(self) -> Optional[int]: ...
    @property
    def point(self) -> Tuple[float, float, float]: ...
    @property
    def normal(self) -> Tuple[float, float, float]: ...
    @property
    def separation(self) -> float: ...
    @property
    def force(self) -> float: ...
    @property
    def text(self) -> str: ...

class _Statistics(TypedDict):
    sent_bytes: int
    received_bytes: int
    updates: int
    complete_tick: int

@final
class Scene:
    """A client of one scene. One thread at a time may be inside a call; a second one raises BusyError at once.

    Commands are queued, and sent together by the next call that waits, or by flush. Each returns its number, which events
    name; for a row of bodies, the number of the last.
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
        material: Optional[Tuple[float, float, float]] = None,
        damping: Optional[Tuple[float, float]] = None,
        gravity_scale: float = 1.0,
        locked_axes: int = 0,
        groups: Tuple[int, int] = (0xFFFFFFFF, 0xFFFFFFFF),
        tolerance_exponent: int = 0,
        sensor: bool = False,
        swept: bool = False,
    ) -> int:
        """Adds a body, and returns its id.

        The material is friction, restitution and density in kg/m³. Locked axes are bits: translations along x, y, z, then
        rotations about them. Groups are those of the body, and those that it touches.
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
        material: Optional[Tuple[float, float, float]] = None,
        damping: Optional[Tuple[float, float]] = None,
        gravity_scale: float = 1.0,
        locked_axes: int = 0,
        groups: Tuple[int, int] = (0xFFFFFFFF, 0xFFFFFFFF),
        tolerance_exponent: int = 0,
        sensor: bool = False,
        swept: bool = False,
    ) -> npt.NDArray[np.uint64]:
        """Adds a body of one shape for each row of positions, and returns their ids. If one is wrong, none is added."""

    def remove(self, body: _Bodies) -> Optional[int]: ...
    def set_pose(self, body: _Bodies, position: _Vector, rotation: Optional[_Rotation] = None) -> Optional[int]: ...
    def set_velocity(self, body: _Bodies, linear: _Vector, angular: Optional[_Vector] = None) -> Optional[int]: ...
    def apply_force(self, body: _Bodies, force: _Vector, point: Optional[_Vector] = None) -> Optional[int]:
        """A force during the next tick, at the centre of mass or at a point."""
    def apply_torque(self, body: _Bodies, torque: _Vector) -> Optional[int]: ...
    def apply_impulse(self, body: _Bodies, impulse: _Vector, point: Optional[_Vector] = None) -> Optional[int]: ...
    def apply_torque_impulse(self, body: _Bodies, impulse: _Vector) -> Optional[int]: ...
    def set_gravity(self, gravity: _Vector) -> Optional[int]: ...
    def sleep(self, body: _Bodies) -> Optional[int]: ...
    def wake(self, body: _Bodies) -> Optional[int]: ...
    def report_events(
        self,
        body: _Bodies,
        *,
        contacts: bool = False,
        force: Optional[float] = None,
        sensors: bool = False,
        sleep: bool = False,
    ) -> Optional[int]:
        """Turns the events of bodies on; what is left out, off. Contacts are reported from the force on."""
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
        """Requests authority over kinematic bodies in place of those of now; an empty row ends it. The tolerance is in metres.

        It is sent at once. An event, "authority granted" or "authority denied", answers.
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
    def flush(self) -> None: ...
    def advance(self, ticks: int = 1, depth: int = 0) -> int:
        """Steps a lockstep scene, computes the view, and returns its tick.

        At depth 1, the view is one tick behind, and the server computes the newest one meanwhile.
        """
    def wait(self, depth: int = 0) -> int:
        """Goes on waiting for the tick of an advance that timed out."""
    def poll(self) -> Tuple[int, float]:
        """Computes the view of a free-running scene for now: its tick, and the part of the step to the next."""
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
        """Centres of mass: a row of x, y, z for each body. Keep it as long as you like: it stays that of its view."""
    @property
    def rotations(self) -> npt.NDArray[np.float32]:
        """A row of x, y, z, w for each body: body to world."""
    @property
    def linear_velocities(self) -> npt.NDArray[np.float32]: ...
    @property
    def angular_velocities(self) -> npt.NDArray[np.float32]:
        """rad/s about world axes."""
    @property
    def resting(self) -> npt.NDArray[np.bool_]: ...
    @property
    def changed(self) -> npt.NDArray[np.uint32]:
        """Places of the bodies whose pose differs from that of the last view."""
    @property
    def removed(self) -> npt.NDArray[np.uint64]:
        """Bodies that were removed since the last view."""
    def place(self, body: int) -> Optional[int]:
        """Place of a body in the arrays; None for a body that is not in the view."""
    def places(self, body: _Bodies) -> npt.NDArray[np.uintp]:
        """Places of many bodies, which must all be in the view."""
    def error_bound(self, body: _Bodies) -> Union[float, npt.NDArray[np.float32]]:
        """How far any point of a body may be off, in the scene's unit of length; infinite while that is not known."""
    def events(self) -> list[Event]:
        """All events since the last call, the oldest first."""
    def query(self, queries: Sequence[Query]) -> Tuple[int, list[list[Hit]]]:
        """Asks the server, and waits: the tick whose scene was asked, and what each query found."""
    @property
    def statistics(self) -> _Statistics: ...
    def delete(self) -> None:
        """Deletes the scene for all of its clients."""
    def close(self) -> None:
        """Leaves the scene. A second time does nothing."""
    @property
    def closed(self) -> bool: ...
    def __len__(self) -> int: ...
    def __enter__(self) -> Scene: ...
    def __exit__(
        self,
        error_type: Optional[Type[BaseException]],
        error: Optional[BaseException],
        traceback: Optional[TracebackType],
    ) -> None: ...
