"""However an array lies in memory, what is read of it is what NumPy reads."""

from collections.abc import Callable

import gymnasium as gym
import numpy as np
import pytest

import octoarm_env  # noqa: F401, registers the environments
from octoarm_env import Arm, ArmBatch, _core

Layout = Callable[[np.ndarray], np.ndarray]


def packed(values: np.ndarray) -> np.ndarray:
    """A field of packed records: strides that are no multiple of the numbers' size."""
    field = [("step", "i4"), ("field", values.dtype, values.shape[1:])]
    records = np.zeros(len(values), dtype=field)
    records["field"] = values
    return records["field"]


def misaligned(values: np.ndarray) -> np.ndarray:
    """Numbers that begin between two places for numbers."""
    memory = bytes(1) + values.tobytes()
    return np.frombuffer(memory, values.dtype, offset=1).reshape(values.shape)


def gaps(values: np.ndarray) -> np.ndarray:
    wide = np.zeros((*values.shape[:-1], 3 * values.shape[-1]), values.dtype)
    wide[..., 1::3] = values
    return wide[..., 1::3]


LAYOUTS: list[Layout] = [
    packed,
    misaligned,
    gaps,
    np.asfortranarray,
    lambda values: values[::-1].copy()[::-1],
    lambda values: values.astype(values.dtype.newbyteorder(">")),
    lambda values: values.astype(np.longdouble),
    lambda values: np.ma.masked_array(values, mask=False),
    lambda values: values.view(np.matrix) if values.ndim == 2 else values,
    lambda values: values.tolist(),
]


@pytest.fixture(params=LAYOUTS, ids=lambda layout: layout.__name__)
def layout(request: pytest.FixtureRequest) -> Layout:
    return request.param


def noise(*shape: int) -> np.ndarray:
    return np.random.default_rng(3).uniform(-0.5, 0.5, shape)


def test_arms(layout: Layout) -> None:
    angles, weights, push = noise(30, 2), noise(80, 2), noise(30, 2)
    one, two = Arm(), Arm()
    assert np.array_equal(one.run(layout(angles)), two.run(angles))
    for ours, theirs in zip(
        one.run_closed_loop(layout(weights), 30, layout(push)),
        two.run_closed_loop(weights, 30, push),
        strict=True,
    ):
        assert np.array_equal(ours, theirs)
    one.muscles = (layout(noise(20, 4)), layout(0.1 * noise(20, 4)))
    two.muscles = (noise(20, 4), 0.1 * noise(20, 4))
    assert np.array_equal(one.muscles, two.muscles)
    state = two.state
    given = type(state)(
        layout(state.coordinates), layout(state.rates), layout(state.base), 7, state.muscles
    )
    one.state = given
    assert np.array_equal(one.state.coordinates, state.coordinates)
    assert np.array_equal(one.state.base, state.base)


def test_batches_of_arms(layout: Layout) -> None:
    ours, theirs = ArmBatch([Arm()] * 2), ArmBatch([Arm()] * 2)
    for angles in (noise(30, 2), noise(2, 30, 2)):
        if layout(angles) is not None:
            assert np.array_equal(ours.run(layout(angles)).lengths, theirs.run(angles).lengths)
    weights, push = noise(2, 80, 2), noise(30, 2)
    run = ours.run_closed_loop(layout(weights), 30, layout(push))
    assert np.array_equal(run.outputs, theirs.run_closed_loop(weights, 30, push).outputs)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_environments(layout: Layout, dtype: type) -> None:
    action = np.array([0.25, -0.5], dtype)
    single, other = gym.make("OctoArm-v0").unwrapped, gym.make("OctoArm-v0").unwrapped
    single.reset(seed=1)
    other.reset(seed=1)
    assert np.array_equal(single.step(layout(action))[0], other.step(action)[0])
    # What the remote environment checks its actions with.
    assert np.array_equal(_core.check_step(layout(action), True), action)
    actions = noise(3, 2).astype(dtype)
    envs, others = gym.make_vec("OctoArm-v0", num_envs=3), gym.make_vec("OctoArm-v0", num_envs=3)
    envs.reset(seed=1)
    others.reset(seed=1)
    assert np.array_equal(envs.step(layout(actions))[0], others.step(actions)[0])


def test_targets(layout: Layout) -> None:
    turn = np.linspace(0, 2 * np.pi, 500, endpoint=False)
    target = 20.0 * np.stack((np.sin(turn), np.cos(turn)), axis=1)
    env = gym.make("OctoArm-v0", target=layout(target)).unwrapped
    assert np.array_equal(env.orbit, target)


def test_what_a_mask_hides_is_not_read() -> None:
    angles = np.ma.masked_greater(noise(5, 2), 0.0)
    arm = Arm()
    with pytest.raises(TypeError, match="angles must be .*, not one with masked entries"):
        arm.run(angles)
    with pytest.raises(TypeError, match="target .* masked"):
        gym.make("OctoArm-v0", target=angles)
    assert arm.time == 0.0
