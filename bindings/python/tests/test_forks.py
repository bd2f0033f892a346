"""Forks step together, alike to the bit, and are environments of Gymnasium."""

import importlib.util

import numpy as np
import pytest

import rhumb

COUNT = 5


def saved_pile():
    """A pile that has just begun to fall, and its bodies."""
    with rhumb.local(tolerance=0.001) as scene:
        scene.add_body(rhumb.Shape.cuboid(10, 0.5, 10), (0, -0.5, 0), "fixed")
        boxes = scene.add_bodies(rhumb.Shape.cuboid(0.3, 0.3, 0.3), [(0.1 * (n % 3), 0.6 + 0.7 * n, 0) for n in range(8)])
        scene.advance(10)
        return scene.save(), boxes


@pytest.fixture(scope="module")
def pile():
    return saved_pile()


def test_forks_are_as_scenes_that_are_stepped_one_by_one_whatever_the_threads(pile):
    saved, boxes = pile
    pushes = np.random.default_rng(3).normal(scale=800, size=(COUNT, 3))
    alone = [rhumb.restore(saved, tolerance=0.001) for _ in range(COUNT)]
    for scene, push in zip(alone, pushes):
        scene.apply_impulse(boxes[4], push)
        for _ in range(50):
            scene.advance()
    for threads in (1, 2, 7, None):
        with rhumb.Forks(saved, COUNT, threads=threads) as forks:
            forks.apply_impulse(boxes[4], pushes)
            forks.advance(17)
            forks.advance(33)
            assert [fork.save() for fork in forks] == [scene.save() for scene in alone]
            assert forks.positions.shape == (COUNT, 9, 3) and forks.rotations.shape == (COUNT, 9, 4)
            assert forks.resting.shape == (COUNT, 9) and forks.linear_velocities.dtype == np.float32
            for number, scene in enumerate(alone):
                order = [forks.place(body) for body in scene.bodies]
                np.testing.assert_allclose(forks.positions[number, order], scene.positions, atol=0.002)
                np.testing.assert_allclose(forks.angular_velocities[number, order], scene.angular_velocities, atol=0.1)


def test_numbers_are_of_all_forks_or_of_each(pile):
    saved, boxes = pile
    with rhumb.Forks(saved, 3) as forks:
        two = boxes[:2]
        forks.set_velocity(two, (1, 0, 0))
        forks.set_velocity(two, [[[number, 2, 0], [number, 3, 0]] for number in range(2)], which=[2, 0])
        forks.set_pose(boxes[7], [[0, 50 + number, 0] for number in range(3)])
        forks.advance()
        velocities = forks.linear_velocities
        places = [forks.place(body) for body in two]
        np.testing.assert_allclose(velocities[:, places, 0], [[1, 1], [1, 1], [0, 0]], atol=0.3)
        np.testing.assert_allclose(forks.positions[:, forks.place(boxes[7]), 1], [50, 51, 52], atol=0.05)


def test_chosen_forks_begin_anew(pile):
    saved, boxes = pile
    with rhumb.Forks(saved, 3) as forks:
        begun = forks.positions.copy()
        old = forks[1]
        forks.advance(30)
        later = forks.positions.copy()
        assert not np.allclose(begun, later)
        forks.restore(np.array([False, True, False]))
        assert old.closed and not forks[1].closed
        np.testing.assert_array_equal(forks.positions[1], begun[1])
        np.testing.assert_array_equal(forks.positions[[0, 2]], later[[0, 2]])
        forks.advance(which=[1])
        assert [fork.time[0] for fork in forks] == [40, 11, 40]
        other = forks[0].save()
        forks.restore([2], checkpoint=other)
        assert forks[2].time[0] == 40


def test_wrong_choices_and_numbers_are_refused(pile):
    saved, boxes = pile
    with rhumb.Forks(saved, 3, threads=2) as forks:
        for which in ([3], [-1], [1, 1], [True], [[0, 1]], [0.5], "all"):
            with pytest.raises(rhumb.InvalidError, match="which"):
                forks.advance(which=which)
        forks.advance(which=[])
        assert forks[0].time[0] == 10
        with pytest.raises(rhumb.InvalidError, match="4 rows.*3 forks"):
            forks.set_velocity(boxes[0], np.zeros((4, 3)))
        with pytest.raises(rhumb.InvalidError, match="2 joints.*3 forks"):
            forks.change_joint(0, [rhumb.Joint("spherical", boxes[0], boxes[1])] * 2)
        with pytest.raises(rhumb.InvalidError, match="ticks"):
            forks.advance(0)
        with pytest.raises(rhumb.InvalidError, match="threads"):
            rhumb.Forks(saved, 1, threads=0).advance()
    for wrong in ("a", 1.5, None):
        with pytest.raises(TypeError, match="count is .* must be a whole number"):
            rhumb.Forks(saved, wrong)
    with pytest.raises(rhumb.InvalidError, match="count is 0"):
        rhumb.Forks(saved, 0)
    with pytest.raises(rhumb.ClosedError, match="fork 0"):
        forks.advance()


def test_an_error_names_its_fork_and_the_others_are_stepped(pile):
    saved, boxes = pile
    with rhumb.Forks(saved, 3) as forks:
        forks[1].apply_impulse(boxes[0], (1e6, 0, 0))
        forks[2].apply_impulse(boxes[0], (1e6, 0, 0))
        with pytest.raises(rhumb.RefusedError, match="^fork 1: .*1 fork more has an error") as refused:
            forks.advance(2)
        assert refused.value.body == boxes[0]
        assert [fork.time[0] for fork in forks] == [12, 12, 12]
        forks[2].remove(boxes[0])
        forks.advance()
        with pytest.raises(rhumb.InvalidError, match="the same bodies"):
            forks.positions
        assert len(forks[2].positions) == 8


def test_a_refusal_names_its_fork_and_wrong_numbers_reach_none(pile):
    saved, boxes = pile
    with rhumb.Forks(saved, 3) as forks, rhumb.Forks(saved, 3) as untouched:
        one_wrong = np.full((3, 3), 50.0)
        one_wrong[2, 1] = np.nan
        masked = np.ma.masked_array(np.full((3, 3), 50.0), mask=np.isnan(one_wrong))
        for wrong, words in (
            (one_wrong, "^fork 2: .*finite"),
            ((0, np.inf, 0), "^fork 0: .*finite"),
            (masked, "^fork 2: .*mask"),
            (one_wrong.astype(complex), "^fork 0: "),
        ):
            with pytest.raises((rhumb.InvalidError, TypeError), match=words):
                forks.apply_impulse(boxes[0], wrong)
        forks.advance()
        untouched.advance()
        np.testing.assert_array_equal(forks.positions, untouched.positions)
        too_great = np.zeros((3, 3))
        too_great[1, 0] = 1e12
        with pytest.raises(rhumb.InvalidError, match=r"^fork 1: .*Forks before it have the command: \[0\]"):
            forks.apply_impulse(boxes[0], too_great)
        with pytest.raises(rhumb.NotInViewError, match="12345"):
            forks.place(12345)


needs_gymnasium = pytest.mark.skipif(importlib.util.find_spec("gymnasium") is None, reason="gymnasium is not installed")


def hop(pile, count, **options):
    """A task: a box of the pile is pushed about, and must not sink below a height."""
    import gymnasium

    from rhumb.learning import VectorEnv

    saved, boxes = pile

    class Hop(VectorEnv):
        def begin(self, which):
            pushes = [self.generators[fork].normal(scale=50, size=3) for fork in which]
            self.forks.apply_impulse(boxes[7], pushes, which=which)

        def act(self, which, actions):
            self.forks.apply_impulse(boxes[7], actions, which=which)

        def observe(self):
            return self.forks.positions[:, self.forks.place(boxes[7])]

        def reward(self):
            return self.observe()[:, 1]

        def terminated(self):
            return self.observe()[:, 1] < 4.9

    spaces = {
        "observation_space": gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32),
        "action_space": gymnasium.spaces.Box(-20, 20, (3,), np.float32),
    }
    return Hop(saved, count, **spaces, **options)


def played(env, steps, seed=7):
    env.action_space.seed(5)
    seen = [env.reset(seed=seed)[0]]
    ends = []
    for _ in range(steps):
        observation, reward, terminated, truncated, infos = env.step(env.action_space.sample())
        assert observation in env.observation_space and reward.shape == terminated.shape == (env.num_envs,)
        assert not (terminated & truncated).any()
        seen.append(observation)
        ends.append((terminated, truncated, reward, infos))
    return np.array(seen), ends


@needs_gymnasium
def test_episodes_repeat_to_the_bit_and_depend_on_their_own_seeds(pile):
    first, again = (played(hop(pile, 3, max_steps=12), 40)[0] for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert len({tuple(each) for each in first[0]}) == 3, "each episode begins with its own seed"
    shifted, _ = played(hop(pile, 3, max_steps=12), 1, seed=8)
    np.testing.assert_array_equal(shifted[0][:2], first[0][1:])


@needs_gymnasium
def test_an_episode_that_is_over_begins_anew_in_the_next_step(pile):
    env = hop(pile, 2, max_steps=6)
    seen, ends = played(env, 20)
    truncated = np.array([end[1] for end in ends])
    assert truncated[[5, 12, 19]].all() and truncated.sum() == 6
    rewards = np.array([end[2] for end in ends])
    np.testing.assert_array_equal(rewards[6], 0)
    # Seven steps an episode, of which the first one is its beginning.
    np.testing.assert_allclose(seen[7], seen[0], atol=0.05)
    assert not np.allclose(seen[6], seen[0], atol=0.05)
    assert env.forks[0].time[0] == 10 + 1 + 6
    env.close()
    assert env.forks[0].closed


@needs_gymnasium
def test_an_episode_that_is_over_begins_anew_in_the_same_step_or_by_reset(pile):
    import gymnasium

    env = hop(pile, 2, max_steps=6, autoreset_mode="SameStep")
    seen, ends = played(env, 12)
    infos = ends[5][3]
    assert infos["_final_obs"].all()
    np.testing.assert_allclose(seen[6], seen[0], atol=0.05)
    assert not np.allclose(np.stack(infos["final_obs"]), seen[0], atol=0.05)
    env = hop(pile, 2, max_steps=6, autoreset_mode=gymnasium.vector.AutoresetMode.DISABLED)
    played(env, 6)
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"\[0, 1\] are over"):
        env.step(env.action_space.sample())
    env.reset(options={"reset_mask": np.array([True, True])})
    env.step(env.action_space.sample())
    with pytest.raises(rhumb.InvalidError, match="reset_mask"):
        env.reset(options={"reset_mask": np.array([False, False])})


@needs_gymnasium
def test_wrappers_of_gymnasium_take_it(pile):
    from gymnasium.wrappers import vector

    env = vector.NormalizeObservation(vector.RecordEpisodeStatistics(hop(pile, 2, max_steps=5)))
    env.reset(seed=1)
    lengths = []
    for _ in range(12):
        *_, infos = env.step(env.action_space.sample())
        if "episode" in infos:
            lengths.extend(infos["episode"]["l"][infos["_episode"]])
    assert lengths == [5] * 4


@needs_gymnasium
def test_an_episode_that_loses_a_body_is_terminated_and_the_others_continue(pile):
    for count in (1, 3):
        env = hop(pile, count)
        begun, _ = env.reset(seed=4)
        env.forks[count - 1].remove(pile[1][2])
        actions = np.zeros((count, 3), np.float32)
        observation, reward, terminated, _, infos = env.step(actions)
        assert terminated.tolist() == [False] * (count - 1) + [True]
        assert infos["lost_body"].tolist() == terminated.tolist() and reward[-1] == 0
        assert observation.shape == begun.shape and np.isfinite(observation).all()
        observation, _, terminated, *_ = env.step(actions)
        assert not terminated.any() and (pile[1][2] in env.forks[count - 1])
        env.close()


@needs_gymnasium
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_an_episode_that_loses_a_body_begins_once(pile, mode):
    env = hop(pile, 2, autoreset_mode=mode)
    begun = []
    begin = env.begin
    env.begin = lambda which: (begun.append(which.tolist()), begin(which))
    env.reset(seed=4)
    env.forks[1].remove(pile[1][2])
    actions = np.zeros((2, 3), np.float32)
    seen, *_ = env.step(actions)
    if mode == "NextStep":
        again, _, terminated, truncated, _ = env.step(actions)
        # The beginning that was seen is that of the episode.
        np.testing.assert_array_equal(again[1], seen[1])
        assert not terminated.any() and not truncated.any()
    assert begun == [[0, 1], [1]]
    env.step(actions)
    assert begun == [[0, 1], [1]]
    env.close()


@needs_gymnasium
def test_spaces_that_are_no_arrays_are_refused(pile):
    import gymnasium

    from rhumb.learning import VectorEnv

    box = gymnasium.spaces.Box(-1, 1, (3,), np.float32)
    with pytest.raises(rhumb.InvalidError, match="action_space is of Dict"):
        VectorEnv(pile[0], 2, observation_space=box, action_space=gymnasium.spaces.Dict({"push": box}))
    with pytest.raises(rhumb.InvalidError, match="observation_space is of Tuple"):
        VectorEnv(pile[0], 2, observation_space=gymnasium.spaces.Tuple([box]), action_space=box)
    for space in (gymnasium.spaces.Discrete(3), gymnasium.spaces.MultiDiscrete([2, 3]), gymnasium.spaces.MultiBinary(2)):
        VectorEnv(pile[0], 2, observation_space=box, action_space=space).close()
