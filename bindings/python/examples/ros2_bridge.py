"""A scene for ROS 2: /clock, /tf, and services of simulation_interfaces.

    python ros2_bridge.py [ROBOT.urdf]

It needs a ROS 2 installation with rclpy, tf2_msgs and simulation_interfaces 1.1 or later. Entities are files that were spawned; each
of their bodies has a frame `ENTITY/BODY`, where the file has its link. Gravity is along -z, as in ROS.

The tests of the package run all of it with stand-ins for rclpy and the messages, whose fields are those of the interfaces. It was
not run with ROS itself.
"""

import itertools
import pathlib
import sys
import tempfile

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rosgraph_msgs.msg import Clock
from simulation_interfaces.msg import Result
from simulation_interfaces.srv import DeleteEntity, GetEntities, GetEntityState, ResetSimulation, SpawnEntity, StepSimulation
from tf2_msgs.msg import TFMessage

import rhumb

TICKS = 60


def product(a, b):
    """Of two quaternions x, y, z, w: first b turns, then a."""
    turned = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.append(turned, a[3] * b[3] - a[:3] @ b[:3])


def turned(rotation, vector):
    """A vector in the axes that a rotation turns it to."""
    return vector + 2 * np.cross(rotation[:3], np.cross(rotation[:3], vector) + rotation[3] * vector)


class Bridge:
    """A scene in this process, as ROS sees it."""

    def __init__(self, node):
        self.node = node
        self.scene = rhumb.local(coordinates="z-up", tolerance=0.001, ticks_per_second=TICKS)
        self.tick = 0
        #: By entity: by body its id, and position and rotation of its link in it.
        self.entities = {}
        self.begin = self.scene.save(), {}
        self.clock = node.create_publisher(Clock, "/clock", 10)
        self.tf = node.create_publisher(TFMessage, "/tf", 10)
        for kind, name, answer in (
            (SpawnEntity, "spawn_entity", self.spawn),
            (DeleteEntity, "delete_entity", self.delete),
            (GetEntities, "get_entities", self.names),
            (GetEntityState, "get_entity_state", self.state),
            (StepSimulation, "step_simulation", self.step),
            (ResetSimulation, "reset_simulation", self.reset),
        ):
            node.create_service(kind, name, answer)
        self.publish()

    def now(self):
        nanoseconds = self.tick * 10**9 // TICKS
        return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)

    def pose(self, body, position, rotation):
        """Position and rotation of a link that has this place in a body; None before the first step of the body."""
        place = self.scene.place(body)
        if place is None:
            return None
        at, turn = self.scene.positions[place].astype(float), self.scene.rotations[place].astype(float)
        return at + turned(turn, np.array(position)), product(turn, np.array(rotation))

    def publish(self):
        """The time, and the frame of every link."""
        self.clock.publish(Clock(clock=self.now()))
        message = TFMessage()
        for entity, links in self.entities.items():
            for link, where in links.items():
                pose = self.pose(*where)
                if pose is None:
                    continue
                at, turn = pose
                one = TransformStamped()
                one.header.stamp, one.header.frame_id, one.child_frame_id = self.now(), "world", f"{entity}/{link}"
                one.transform.translation.x, one.transform.translation.y, one.transform.translation.z = map(float, at)
                rotation = one.transform.rotation
                rotation.x, rotation.y, rotation.z, rotation.w = map(float, turn)
                message.transforms.append(one)
        self.tf.publish(message)

    def advance(self):
        self.scene.advance()
        self.tick += 1
        self.publish()

    def load(self, name, path, position=(0, 0, 0), rotation=(0, 0, 0, 1)):
        loaded = self.scene.load(path, position, rotation=rotation)
        self.entities[name] = {link: (body, *loaded.frames[link]) for link, body in loaded.bodies.items()}
        for line in loaded.left_out:
            self.node.get_logger().info(line)

    def spawn(self, request, response):
        name = request.name or next(
            name for number in itertools.count() if (name := f"entity_{number}") not in self.entities
        )
        if name in self.entities and not request.allow_renaming:
            return failed(response, SpawnEntity.Response.NAME_NOT_UNIQUE, f"{name} is there")
        while name in self.entities:
            name += "_"
        resource, pose = request.entity_resource, request.initial_pose.pose
        at, turn = (pose.position.x, pose.position.y, pose.position.z), pose.orientation
        turn = (turn.x, turn.y, turn.z, turn.w)
        if not resource.uri and not resource.resource_string:
            return failed(response, SpawnEntity.Response.NO_RESOURCE, "neither a uri nor a text")
        try:
            if resource.uri:
                self.load(name, resource.uri.removeprefix("file://"), at, turn)
            else:
                with tempfile.TemporaryDirectory() as folder:
                    path = pathlib.Path(folder) / "entity.urdf"
                    path.write_text(resource.resource_string)
                    self.load(name, path, at, turn)
        except rhumb.Error as error:
            return failed(response, SpawnEntity.Response.RESOURCE_PARSE_ERROR, str(error))
        self.scene.wait()
        self.publish()
        response.entity_name = name
        return done(response)

    def delete(self, request, response):
        links = self.entities.get(request.entity)
        if links is None:
            return failed(response, Result.RESULT_NOT_FOUND, f"there is no {request.entity}")
        try:
            self.scene.remove([body for body, *_ in links.values()])
            self.scene.wait()
        except rhumb.Error as error:
            return failed(response, Result.RESULT_OPERATION_FAILED, str(error))
        del self.entities[request.entity]
        return done(response)

    def names(self, request, response):
        response.entities = list(self.entities)
        return done(response)

    def state(self, request, response):
        """Of the first body of an entity, which the others hang on."""
        links = self.entities.get(request.entity)
        if links is None:
            return failed(response, Result.RESULT_NOT_FOUND, f"there is no {request.entity}")
        where = next(iter(links.values()), None)
        if where is None:
            return failed(response, Result.RESULT_INCORRECT_STATE, f"{request.entity} has no body")
        pose = self.pose(*where)
        if pose is None:
            return failed(response, Result.RESULT_INCORRECT_STATE, f"{request.entity} is seen after the next step")
        state, place, (at, turn) = response.state, self.scene.place(where[0]), pose
        angular = self.scene.angular_velocities[place].astype(float)
        # The link's origin moves with the body, around its centre of mass.
        linear = self.scene.linear_velocities[place] + np.cross(angular, at - self.scene.positions[place])
        state.header.stamp, state.header.frame_id = self.now(), "world"
        for to, numbers in (
            (state.pose.position, at),
            (state.pose.orientation, turn),
            (state.twist.linear, linear),
            (state.twist.angular, angular),
        ):
            for axis, number in zip("xyzw", numbers):
                setattr(to, axis, float(number))
        return done(response)

    def step(self, request, response):
        try:
            for _ in range(request.steps):
                self.advance()
        except rhumb.Error as error:
            return failed(response, Result.RESULT_OPERATION_FAILED, str(error))
        return done(response)

    def reset(self, request, response):
        """Back to the beginning, with what was there."""
        checkpoint, entities = self.begin
        self.scene.close()
        self.scene = rhumb.restore(checkpoint, coordinates="z-up", tolerance=0.001)
        self.tick, self.entities = 0, dict(entities)
        self.publish()
        return done(response)


def done(response):
    response.result.result = Result.RESULT_OK
    return response


def failed(response, code, sentence):
    response.result.result, response.result.error_message = code, sentence
    return response


def main():
    rclpy.init()
    node = rclpy.create_node("rhumb")
    bridge = Bridge(node)
    if len(sys.argv) > 1:
        bridge.load("robot", sys.argv[1])
        bridge.scene.wait()
        bridge.begin = bridge.scene.save(), dict(bridge.entities)
    node.create_timer(1 / TICKS, bridge.advance)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
