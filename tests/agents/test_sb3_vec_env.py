"""`Sb3VecEnv` against stable-baselines3's own `DummyVecEnv` over the same environments."""

from functools import partial

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from octoarm_agents.rl import Sb3VecEnv, make_sb3_vec_env, sb3_vec_env
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecMonitor, VecNormalize

COUNT = 4
SAME_STEP = AutoresetMode.SAME_STEP


def single_envs(count=COUNT, **options):
    return [partial(gym.make, "OctoArm-v0", **({"max_episode_steps": 7} | options))] * count


def sync_envs(count=COUNT, **options):
    return SyncVectorEnv(single_envs(count, **options), autoreset_mode=SAME_STEP)


class WholeVectorEnv(VectorEnv):
    """A vector environment without single environments to reach for, but with `call`."""

    def __init__(self, envs):
        self._hidden = envs
        for name in ("num_envs", "metadata", "render_mode", "single_action_space"):
            setattr(self, name, getattr(envs, name))
        self.single_observation_space = envs.single_observation_space
        self.reset, self.step, self.close = envs.reset, envs.step, envs.close
        self.call, self.get_attr, self.set_attr = envs.call, envs.get_attr, envs.set_attr


class ReachableVectorEnv(WholeVectorEnv):
    """The same, with `call_at` as well."""

    def call_at(self, indices, name, *args, **kwargs):
        envs = [self._hidden.envs[index] for index in indices]
        return tuple(env.get_wrapper_attr(name)(*args, **kwargs) for env in envs)


def native_envs(count=COUNT, **options):
    return gym.make_vec(
        "OctoArm-v0",
        num_envs=count,
        vectorization_mode="vector_entry_point",
        autoreset_mode=SAME_STEP,
        **({"max_episode_steps": 7} | options),
    )


VECTOR_ENVS = {
    "native": native_envs,
    "sync": sync_envs,
    "whole": lambda *args, **options: WholeVectorEnv(sync_envs(*args, **options)),
    "reachable": lambda *args, **options: ReachableVectorEnv(sync_envs(*args, **options)),
}


@pytest.fixture(params=VECTOR_ENVS)
def envs(request):
    envs = Sb3VecEnv(VECTOR_ENVS[request.param]())
    yield envs
    envs.close()


class Recorder(gym.Wrapper):
    """Keeps the seeds and options that resets come with, and has pictures."""

    def __init__(self, env, render_mode=None):
        super().__init__(env)
        self.resets = []
        self.picture_mode = render_mode

    @property
    def render_mode(self):
        return self.picture_mode

    def reset(self, *, seed=None, options=None):
        self.resets.append((seed, options))
        return self.env.reset(seed=seed, options=options)

    def render(self):
        return np.full((2, 3, 3), len(self.resets), np.uint8)


def recorders(**options):
    fns = [lambda: Recorder(gym.make("OctoArm-v0", max_episode_steps=7), **options)] * COUNT
    return Sb3VecEnv(SyncVectorEnv(fns, autoreset_mode=SAME_STEP))


def assert_same(ours, theirs):
    """Equal to the bit, and of the same types."""
    assert type(ours) is type(theirs)
    if isinstance(theirs, dict):
        assert set(ours) == set(theirs)
        for key, value in theirs.items():
            assert_same(ours[key], value)
    elif isinstance(theirs, list):
        for our, their in zip(ours, theirs, strict=True):
            assert_same(our, their)
    elif isinstance(theirs, np.ndarray):
        assert ours.dtype == theirs.dtype
        np.testing.assert_array_equal(ours, theirs, strict=True)
    else:
        assert ours == theirs


def random_actions(steps, seed):
    return np.random.default_rng(seed).uniform(-1, 1, (steps, COUNT, 2)).astype(np.float32)


def jumps(steps):
    """At rest, but for jumps that no such arm survives: each environment at steps of its own."""
    actions = np.zeros((steps, COUNT, 2), np.float32)
    for index in range(COUNT):
        actions[3 * index + 2 :: 13, index] = 1.0
    return actions


RUNS = {
    "truncated": ({}, random_actions(40, 1), 0),
    "terminated": (
        {"arm": "inertial", "amplitude": 20.0, "action_range": 300.0, "max_episode_steps": 9},
        jumps(40),
        4,
    ),
}


@pytest.mark.parametrize("vector_env", VECTOR_ENVS)
@pytest.mark.parametrize(("options", "actions", "failures"), RUNS.values(), ids=RUNS)
def test_the_same_as_the_dummy(vector_env, options, actions, failures):
    ours = Sb3VecEnv(VECTOR_ENVS[vector_env](**options))
    theirs = DummyVecEnv(single_envs(**options))
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.seed(11) == theirs.seed(11)
    assert_same(ours.reset(), theirs.reset())
    assert_same(ours.reset_infos, theirs.reset_infos)
    ends = failed = 0
    for action in actions:
        our, their = ours.step(action), theirs.step(action)
        for one, other in zip(our, their, strict=True):
            assert_same(one, other)
        assert_same(ours.reset_infos, theirs.reset_infos)
        for info in our[3]:
            ends += "terminal_observation" in info
            failed += "failure" in info
            assert not ("failure" in info and info["TimeLimit.truncated"])
    assert ends > 4
    assert failed >= failures
    assert (failed == 0) == (failures == 0)


def test_truncated_and_terminated_at_once_is_not_truncated():
    class Ending(gym.Wrapper):
        def step(self, action):
            observation, reward, _, truncated, info = self.env.step(action)
            return observation, reward, truncated, truncated, info

    fns = [lambda: Ending(gym.make("OctoArm-v0", max_episode_steps=3))] * 2
    envs = Sb3VecEnv(SyncVectorEnv(fns, autoreset_mode=SAME_STEP))
    envs.reset()
    for step in range(1, 4):
        *_, dones, infos = envs.step(np.zeros((2, 2), np.float32))
        assert dones.tolist() == [step == 3] * 2
        assert [info["TimeLimit.truncated"] for info in infos] == [False, False]
        assert ["terminal_observation" in info for info in infos] == [step == 3] * 2


def test_nothing_given_changes_later(envs):
    observations = envs.reset()
    given = [observations]
    for _ in range(7):
        observations, rewards, dones, infos = envs.step(np.zeros((COUNT, 2), np.float32))
        given += [observations, rewards, dones, *(info["target"] for info in infos)]
    given += [info["terminal_observation"] for info in infos]
    copies = [array.copy() for array in given]
    for info in infos:
        info["base_angles"][:] = 99.0
    envs.step(np.ones((COUNT, 2), np.float32))
    for array, copy in zip(given, copies, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_nested_infos_and_infos_without_a_mask():
    infos = {
        "speed": np.array([1.0, 2.0, 0.0]),
        "_speed": np.array([True, True, False]),
        "total": np.array([7, 8, 9]),
        "_episode": np.array([False, True, False]),
        "episode": {"steps": np.array([0, 5, 0])},
        "name": np.array([None, "b", None], object),
        "_name": np.array([False, True, False]),
        "axis": np.arange(6.0).reshape(3, 2),
        "_axis": np.array([True, True, True]),
    }
    rows = sb3_vec_env._rows(infos, 3)
    axes = [row.pop("axis") for row in rows]
    np.testing.assert_array_equal(axes, infos["axis"])
    assert rows == [
        {"speed": 1.0, "total": 7},
        {"speed": 2.0, "total": 8, "episode": {"steps": 5}, "name": "b"},
        {"total": 9},
    ]


def test_seeds_and_options_are_used_once():
    envs = recorders()
    assert isinstance(envs, VecEnv)
    envs.seed(3)
    envs.set_options({"phase": 0.25})
    envs.reset()
    envs.reset()
    for index, resets in enumerate(envs.get_attr("resets")):
        assert resets == [(3 + index, {"phase": 0.25}), (None, None)]


def test_options_reach_the_arm(envs):
    envs.set_options([{"phase": 0.5}] * COUNT)
    first = envs.reset()
    assert (first == first[0]).all()
    targets = [info["target"] for info in envs.reset_infos]
    envs.set_options({"phase": 0.0})
    envs.reset()
    assert np.abs(envs.reset_infos[0]["target"] - targets[0]).max() > 1.0
    envs.set_options(None)
    assert not (envs.reset() == first[0]).all()


def test_the_same_seed_gives_the_same_episodes(envs):
    envs.seed(5)
    first = envs.reset()
    assert not np.array_equal(first[0], first[1])
    assert not np.array_equal(envs.reset(), first)
    envs.seed(5)
    np.testing.assert_array_equal(envs.reset(), first)


def test_options_that_differ_are_refused(envs):
    with pytest.raises(ValueError, match=r"options\[2\] = {'phase': 0.5}, but options\[0\] = {}"):
        envs.set_options([{}, {}, {"phase": 0.5}, {}])
    with pytest.raises(ValueError, match="options has 1 entries, expected one for each of the 4"):
        envs.set_options([{}])


def test_attributes(envs):
    assert envs.get_attr("action_range") == [117.0] * COUNT
    assert envs.get_attr("amplitude", indices=[2, 0]) == [90.0, 90.0]
    assert envs.get_attr("amplitude", indices=1) == [90.0]
    assert envs.has_attr("orbit")
    assert not envs.has_attr("fins")
    envs.set_attr("label", "all")
    assert envs.get_attr("label") == ["all"] * COUNT
    envs.set_attr("label", "some", indices=[1, 3])
    assert envs.get_attr("label") == ["all", "some", "all", "some"]


def test_setting_an_argument_is_an_error(envs):
    for name, value in (("target", "lissajous"), ("reward_width", 0.1), ("arm", "inertial")):
        with pytest.raises(AttributeError, match=f"{name} .*cannot be changed.*{name}=..."):
            envs.set_attr(name, value)
        with pytest.raises(AttributeError, match=name):
            envs.set_attr(name, value, indices=[1])


def test_methods(envs):
    envs.seed(0)
    envs.reset()
    actions = envs.env_method("teacher_action")
    assert [action.shape for action in actions] == [(2,)] * COUNT
    assert not np.array_equal(actions[0], actions[1])
    reverse = envs.env_method("teacher_action", indices=range(COUNT - 1, -1, -1))
    np.testing.assert_array_equal(reverse, actions[::-1])


@pytest.mark.parametrize("vector_env", ["sync", "reachable"])
def test_methods_of_some(vector_env):
    envs = Sb3VecEnv(VECTOR_ENVS[vector_env]())
    envs.seed(0)
    envs.reset()
    before = envs.env_method("teacher_action")
    ((_, info),) = envs.env_method("reset", indices=2, options={"phase": 0.3})
    after = envs.env_method("teacher_action")
    changed = [not np.array_equal(one, other) for one, other in zip(before, after, strict=True)]
    assert changed == [False, False, True, False]
    assert info["tracking_error"] < 1e-9
    np.testing.assert_array_equal(
        envs.env_method("teacher_action", indices=[3, 1]), [after[3], after[1]]
    )


def test_methods_of_some_where_only_all_can_be_called():
    envs = Sb3VecEnv(WholeVectorEnv(sync_envs()))
    with pytest.raises(
        NotImplementedError,
        match=r"'reset', indices=\[2\]\): a WholeVectorEnv can only call all of its 4",
    ):
        envs.env_method("reset", indices=2)


def test_wrappers(envs):
    reachable = isinstance(envs.vector_env, SyncVectorEnv)
    assert envs.env_is_wrapped(gym.wrappers.TimeLimit) == [reachable] * COUNT
    assert envs.env_is_wrapped(Monitor, indices=[0, 1]) == [False, False]


def test_pictures():
    envs = recorders(render_mode="rgb_array")
    assert envs.render_mode == "rgb_array"
    envs.reset()
    assert [image.shape for image in envs.get_images()] == [(2, 3, 3)] * COUNT
    assert envs.render().shape == (4, 6, 3)
    blind = Sb3VecEnv(sync_envs())
    with pytest.warns(UserWarning, match="render_mode = None: pictures need 'rgb_array'"):
        assert blind.get_images() == [None] * COUNT


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (
            lambda: gym.make("OctoArm-v0"),
            TypeError,
            "envs = <.*>: expected a gymnasium.vector.VectorEnv, not TimeLimit",
        ),
        (lambda: DummyVecEnv(single_envs()), TypeError, "VectorEnv, not DummyVecEnv"),
        (
            lambda: SyncVectorEnv(single_envs()),
            ValueError,
            r"envs.metadata\['autoreset_mode'\] = AutoresetMode.NEXT_STEP: "
            "expected AutoresetMode.SAME_STEP",
        ),
    ],
)
def test_what_is_no_such_vector_environment_is_refused(make, error, message):
    with pytest.raises(error, match=message):
        Sb3VecEnv(make())


def test_the_vector_environment_may_be_wrapped():
    envs = Sb3VecEnv(gym.wrappers.vector.ClipReward(sync_envs(), max_reward=0.5))
    envs.reset()
    _, rewards, _, _ = envs.step(np.zeros((COUNT, 2), np.float32))
    assert rewards.max() <= 0.5
    assert envs.get_attr("amplitude") == [90.0] * COUNT


@pytest.mark.parametrize("vector_env", ["native", "sync"])
@pytest.mark.parametrize("stats_key", ["episode", "statistics"])
def test_statistics_of_a_vector_wrapper_are_in_the_info_of_the_step_that_ended(
    vector_env, stats_key
):
    wrapped = gym.wrappers.vector.RecordEpisodeStatistics(
        VECTOR_ENVS[vector_env](
            arm="inertial", amplitude=20.0, action_range=300.0, max_episode_steps=9
        ),
        stats_key=stats_key,
    )
    envs = Sb3VecEnv(wrapped)
    envs.reset()
    totals, lengths, ends = np.zeros(COUNT), np.zeros(COUNT, int), []
    for step in range(18):
        actions = np.array(envs.env_method("teacher_action"), np.float32)
        # A jump that no such arm survives, at another step in each environment.
        actions[np.arange(COUNT) == step] = 1.0
        _, rewards, dones, infos = envs.step(actions)
        totals += rewards
        lengths += 1
        for index, (done, info) in enumerate(zip(dones, infos, strict=True)):
            assert (stats_key in info) == done
            assert stats_key not in envs.reset_infos[index]
            if done:
                statistics = info[stats_key]
                assert set(statistics) == {"r", "l", "t"}
                assert type(statistics["l"]) is int
                assert statistics["l"] == lengths[index]
                # The rewards are in single precision here.
                assert statistics["r"] == pytest.approx(totals[index], rel=1e-5)
                ends.append((step, index))
                totals[index] = lengths[index] = 0
        assert all("base_angles" in info for info in envs.reset_infos)
    assert ends == [(start + index, index) for start in (0, 9) for index in range(COUNT)]


def test_ppo_hears_of_the_statistics_of_a_vector_wrapper():
    torch.set_num_threads(1)
    envs = Sb3VecEnv(gym.wrappers.vector.RecordEpisodeStatistics(native_envs()))
    model = PPO("MlpPolicy", envs, n_steps=32, batch_size=64, seed=0)
    model.learn(128)
    assert [entry["l"] for entry in model.ep_info_buffer] == [7] * 16


def test_what_a_vector_wrapper_adds_belongs_to_the_step():
    class Counting(gym.vector.VectorWrapper):
        """Adds infos at resets and at steps; a single environment inside adds some at resets."""

        def reset(self, *, seed=None, options=None):
            observations, infos = self.env.reset(seed=seed, options=options)
            self.steps = 0
            return observations, infos | {"step": np.zeros(COUNT, int)}

        def step(self, actions):
            *rest, infos = self.env.step(actions)
            self.steps += 1
            return *rest, infos | {"step": np.full(COUNT, self.steps)}

    class Drawing(gym.Wrapper):
        def reset(self, **options):
            observation, info = self.env.reset(**options)
            return observation, info | {"drawn": 5}

    fns = [lambda: Drawing(gym.make("OctoArm-v0", max_episode_steps=3))] * COUNT
    inner = SyncVectorEnv(fns, autoreset_mode=SAME_STEP)
    # Two wrappers: the one that adds need not be the innermost.
    envs = Sb3VecEnv(Counting(gym.wrappers.vector.ClipReward(inner, max_reward=0.5)))
    envs.reset()
    assert [(info["step"], info["drawn"]) for info in envs.reset_infos] == [(0, 5)] * COUNT
    for step in range(1, 8):
        *_, dones, infos = envs.step(np.zeros((COUNT, 2), np.float32))
        assert dones.tolist() == [step % 3 == 0] * COUNT
        assert [info["step"] for info in infos] == [step] * COUNT
        assert not any("drawn" in info for info in infos)
        assert all(info["drawn"] == 5 for info in envs.reset_infos)


@pytest.mark.parametrize("name", ["DictInfoToList", "NumpyToTorch"])
def test_wrappers_that_turn_arrays_into_something_else_are_refused(name):
    class Wrapper(gym.vector.VectorWrapper):
        """Stands in for one: Gymnasium's own may need more packages."""

    converter = type({"NumpyToTorch": "ArrayConversion"}.get(name, name), (Wrapper,), {})
    envs = gym.wrappers.vector.ClipReward(type(name, (converter,), {})(sync_envs()), max_reward=0.5)
    with pytest.raises(ValueError, match=f"envs is wrapped in {name}: expected NumPy's arrays"):
        Sb3VecEnv(envs)


def test_made_natively_and_seeded(monkeypatch):
    asked = []

    def make_vec(name, **options):
        asked.append((name, options))
        return sync_envs(options["num_envs"])

    monkeypatch.setattr(gym, "make_vec", make_vec)
    envs = make_sb3_vec_env(3, seed=8, target="lissajous", max_episode_steps=7)
    assert envs.num_envs == 3
    expected = {
        "num_envs": 3,
        "vectorization_mode": "vector_entry_point",
        "autoreset_mode": SAME_STEP,
        "target": "lissajous",
        "max_episode_steps": 7,
    }
    assert asked == [("OctoArm-v0", expected)]
    other = Sb3VecEnv(sync_envs(3))
    other.seed(8)
    np.testing.assert_array_equal(envs.reset(), other.reset())


def test_monitored_and_normalised(envs):
    monitored = VecMonitor(envs)
    normalised = VecNormalize(monitored, gamma=0.9)
    observations = normalised.reset()
    assert observations.shape == (COUNT, 80)
    total = np.zeros(COUNT)
    for step in range(1, 15):
        _, _, dones, infos = normalised.step(np.zeros((COUNT, 2), np.float32))
        total += normalised.get_original_reward()
        assert dones.tolist() == [step % 7 == 0] * COUNT
        if not dones.any():
            continue
        assert [info["episode"]["l"] for info in infos] == [7] * COUNT
        # The monitor gives six decimals.
        np.testing.assert_allclose([info["episode"]["r"] for info in infos], total, atol=1e-6)
        total[:] = 0.0
        # The terminal observation is normalised too.
        assert np.abs(infos[0]["terminal_observation"]).max() <= normalised.clip_obs


def test_ppo_runs(envs):
    torch.set_num_threads(1)
    model = PPO("MlpPolicy", VecNormalize(VecMonitor(envs)), n_steps=32, batch_size=64, seed=0)
    model.learn(256)
    assert model.num_timesteps == 256
    assert model.ep_info_buffer[0]["l"] == 7
    mean, deviation = evaluate_policy(model, VecMonitor(envs), n_eval_episodes=4)
    assert np.isfinite([mean, deviation]).all()
