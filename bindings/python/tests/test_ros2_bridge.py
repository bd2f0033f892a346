"""The bridge to ROS 2, with stand-ins for rclpy and for the messages."""

import importlib
import pathlib
import sys
import types

import numpy as np
import pytest

EXAMPLES = pathlib.Path(__file__).parents[1] / "examples"

BALL = """<robot name="ball"><link name="base"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><sphere radius="0.1"/></geometry></collision></link></robot>"""


class Message(types.SimpleNamespace):
    """A message whose parts come into being when they are named."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        value = [] if name in ("transforms", "entities") else Message()
        setattr(self, name, value)
        return value


class Node:
    def __init__(self):
        self.published, self.services = {}, {}

    def create_publisher(self, kind, topic, depth):
        sent = self.published.setdefault(topic, [])
        return types.SimpleNamespace(publish=sent.append)

    def create_service(self, kind, name, answer):
        self.services[name] = answer

    def get_logger(self):
        return types.SimpleNamespace(info=lambda line: None)


@pytest.fixture
def bridge(monkeypatch):
    codes = dict(NAME_NOT_UNIQUE=101, NO_RESOURCE=104, RESOURCE_PARSE_ERROR=106)
    parts = {
        "builtin_interfaces.msg": ["Time"],
        "geometry_msgs.msg": ["TransformStamped"],
        "rosgraph_msgs.msg": ["Clock"],
        "tf2_msgs.msg": ["TFMessage"],
        "simulation_interfaces.msg": ["Result"],
        "simulation_interfaces.srv": "DeleteEntity GetEntities GetEntityState ResetSimulation SpawnEntity StepSimulation".split(),
    }
    monkeypatch.setitem(sys.modules, "rclpy", types.ModuleType("rclpy"))
    for name, kinds in parts.items():
        module = types.ModuleType(name)
        for kind in kinds:
            setattr(module, kind, type(kind, (Message,), {}))
        monkeypatch.setitem(sys.modules, name.split(".")[0], types.ModuleType(name.split(".")[0]))
        monkeypatch.setitem(sys.modules, name, module)
    sys.modules["simulation_interfaces.msg"].Result.RESULT_OK = 1
    sys.modules["simulation_interfaces.msg"].Result.RESULT_NOT_FOUND = 2
    sys.modules["simulation_interfaces.msg"].Result.RESULT_INCORRECT_STATE = 3
    sys.modules["simulation_interfaces.msg"].Result.RESULT_OPERATION_FAILED = 4
    sys.modules["simulation_interfaces.srv"].SpawnEntity.Response = types.SimpleNamespace(**codes)
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.delitem(sys.modules, "ros2_bridge", raising=False)
    return importlib.import_module("ros2_bridge").Bridge(Node())


def ask(bridge, service, **fields):
    return bridge.node.services[service](Message(**fields), Message())


def spawn(bridge, name, text, height=5.0):
    pose = Message(position=Message(x=1.0, y=2.0, z=height), orientation=Message(x=0.0, y=0.0, z=0.0, w=1.0))
    resource = Message(uri="", resource_string=text)
    return ask(bridge, "spawn_entity", name=name, allow_renaming=False, entity_resource=resource, initial_pose=Message(pose=pose))


def test_a_spawned_robot_falls_in_tf_and_in_its_state_by_the_simulated_clock(bridge):
    assert spawn(bridge, "ball", BALL).result.result == 1
    assert ask(bridge, "get_entities").entities == ["ball"]
    assert ask(bridge, "step_simulation", steps=30).result.result == 1
    clock = bridge.node.published["/clock"][-1].clock
    assert (clock.sec, clock.nanosec) == (0, 500_000_000)
    one = bridge.node.published["/tf"][-1].transforms[0]
    assert (one.header.frame_id, one.child_frame_id, one.header.stamp.nanosec) == ("world", "ball/base", 500_000_000)
    # The link's frame, not the centre of mass 0.1 m beside it.
    at = one.transform.translation
    assert np.allclose([at.x, at.y], [1, 2], atol=2e-3)
    assert abs(at.z - (5 - 9.80665 / 8)) < 0.03
    state = ask(bridge, "get_entity_state", entity="ball").state
    assert abs(state.pose.position.z - at.z) < 1e-6
    assert abs(state.twist.linear.z + 9.80665 / 2) < 0.05


def test_a_reset_leads_back_to_the_beginning(bridge):
    spawn(bridge, "ball", BALL)
    ask(bridge, "step_simulation", steps=3)
    assert ask(bridge, "reset_simulation").result.result == 1
    assert ask(bridge, "get_entities").entities == []
    assert bridge.node.published["/clock"][-1].clock.nanosec == 0
    assert spawn(bridge, "ball", BALL).result.result == 1


def test_what_cannot_be_is_answered_with_a_code_and_a_sentence(bridge):
    assert spawn(bridge, "ball", "").result.result == 104
    wrong = spawn(bridge, "ball", "<robot name='r'><link/></robot>").result
    assert wrong.result == 106 and "entity.urdf" in wrong.error_message
    assert spawn(bridge, "ball", BALL).result.result == 1
    assert spawn(bridge, "ball", BALL).result.result == 101
    for service in ("get_entity_state", "delete_entity"):
        assert ask(bridge, service, entity="cube").result.result == 2
    assert ask(bridge, "get_entity_state", entity="ball").result.result == 3
    assert ask(bridge, "delete_entity", entity="ball").result.result == 1
    assert ask(bridge, "get_entities").entities == []


def test_entities_without_a_name_get_free_ones(bridge):
    for _ in range(2):
        assert spawn(bridge, "", BALL).result.result == 1
    assert ask(bridge, "delete_entity", entity="entity_0").result.result == 1
    assert spawn(bridge, "", BALL).result.result == 1
    assert sorted(ask(bridge, "get_entities").entities) == ["entity_0", "entity_1"]


def test_what_the_scene_refuses_is_answered_and_the_bridge_continues(bridge):
    spawn(bridge, "ball", BALL)
    ((body, *_),) = bridge.entities["ball"].values()
    bridge.scene.remove(body)
    bridge.scene.wait()
    refused = ask(bridge, "delete_entity", entity="ball").result
    assert refused.result == 4 and refused.error_message
    assert ask(bridge, "step_simulation", steps=1).result.result == 1
    bridge.entities["empty"] = {}
    assert ask(bridge, "get_entity_state", entity="empty").result.result == 3
