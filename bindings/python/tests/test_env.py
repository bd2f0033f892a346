"""The example environment: episodes repeat to the bit.

Gymnasium's own check passes, if it is installed.
"""

import pathlib
import sys

import numpy as np
import pytest

sys.path.insert(0, str(pathlib.Path(__file__).parents[1] / "examples"))
from push_env import PushEnv, push_towards_mark


@pytest.fixture
def env(server, request):
    one = PushEnv(server.address, server.fingerprint, request.node.name[:64])
    yield one
    one.close()


def episode(env, seed):
    observation, _ = env.reset(seed=seed)
    seen, rewards, over = [observation], [], False
    while not over:
        observation, reward, terminated, truncated, info = env.step(push_towards_mark(observation))
        assert info["error_bound"] == pytest.approx(0.005)
        seen.append(observation)
        rewards.append(reward)
        over = terminated or truncated
    return np.array(seen), rewards


def test_a_policy_reaches_the_mark(env):
    _, rewards = episode(env, 7)
    assert rewards[-1] > 10 and len(rewards) < 200


def test_an_episode_repeats_to_the_bit(server, env):
    first, rewards = episode(env, 3)
    other = PushEnv(server.address, server.fingerprint, "push-again")
    second, again = episode(other, 3)
    other.close()
    assert np.array_equal(first, second) and rewards == again


def test_it_is_what_gymnasium_takes_for_an_environment(env):
    checker = pytest.importorskip("gymnasium.utils.env_checker")
    checker.check_env(env, skip_render_check=True, skip_close_check=True)
    env.close()
    env.close()
