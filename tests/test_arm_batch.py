"""Many arms at once are the arms one by one."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from octoarm_env import LIMIT_CYCLES, Arm, ArmBatch, ArmParameters, DomainError

STEPS = 1500
"""More than a block between two looks at Python's signals."""


def arms(count: int = 11) -> list[Arm]:
    made = []
    for index in range(count):
        body = ArmParameters(area_scale=40.0 + index, longitudinal_stiffness=196.0 + 2 * index)
        made.append(Arm(body, "servo" if index % 3 == 0 else "direct", undeformed=index % 2 == 0))
    return made


def drives(count: int = 11) -> np.ndarray:
    names = list(LIMIT_CYCLES)
    return np.array([LIMIT_CYCLES[names[i % 3]].signal(STEPS, 10.0 + i) for i in range(count)])


@pytest.mark.parametrize("threads", [1, 2])
def test_open_loop(threads: int) -> None:
    alone, angles = arms(), drives()
    batch = ArmBatch(alone, threads=threads)
    assert len(batch) == 11
    assert np.array_equal(batch.lengths, [arm.lengths for arm in alone])
    run = batch.run(angles[:, :1200])
    assert run.outputs is None
    assert run.failures == (None,) * 11
    assert run.steps.tolist() == [1200] * 11
    for index, arm in enumerate(alone):
        assert np.array_equal(run.lengths[index], arm.run(angles[index, :1200]))
        assert batch.states[index] == arm.state
    run = batch.run(angles[:, 1200:])
    for index, arm in enumerate(alone):
        assert np.array_equal(run.lengths[index], arm.run(angles[index, 1200:]))
    # The same commands for all.
    alone = arms()
    run = ArmBatch(alone, threads=threads).run(angles[0])
    for index, arm in enumerate(alone):
        assert np.array_equal(run.lengths[index], arm.run(angles[0]))


def test_closed_loop() -> None:
    rng = np.random.default_rng(0)
    weights = rng.normal(0, 20.0, (9, 81, 2))
    weights[:, 80] = -0.02 * weights[:, :80].sum(axis=1)
    push = rng.uniform(-0.05, 0.05, (9, STEPS, 2))
    alone = [Arm(actuator="servo") for _ in range(9)]
    batch = ArmBatch(alone)
    run = batch.run_closed_loop(weights, STEPS, push)
    assert run.outputs is not None
    assert run.steps.tolist() == [STEPS] * 9
    for index, arm in enumerate(alone):
        outputs, lengths = arm.run_closed_loop(weights[index], STEPS, push[index])
        assert np.array_equal(run.outputs[index], outputs)
        assert np.array_equal(run.lengths[index], lengths)
    run = batch.run_closed_loop(weights[0, :80], 50)
    for index, arm in enumerate(alone):
        outputs, lengths = arm.run_closed_loop(weights[0, :80], 50)
        assert np.array_equal(run.outputs[index], outputs)
        assert np.array_equal(run.lengths[index], lengths)
    assert batch.run_closed_loop(weights[0], 0).lengths.shape[:2] == (9, 0)


@pytest.mark.parametrize("stride", [7, 300, STEPS, 2 * STEPS])
def test_lengths_of_every_few_steps(stride: int) -> None:
    angles, weights = drives(9), np.zeros((80, 2))
    whole, thin = ArmBatch(arms(9)), ArmBatch(arms(9))
    every, some = whole.run(angles), thin.run(angles, stride=stride)
    assert some.lengths.shape == (9, STEPS // stride, 80)
    assert np.array_equal(some.lengths, every.lengths[:, stride - 1 :: stride])
    assert some.steps.tolist() == [STEPS] * 9
    assert whole.states == thin.states
    every = whole.run_closed_loop(weights, 700, 0.01 * angles[:, :700])
    some = thin.run_closed_loop(weights, 700, 0.01 * angles[:, :700], stride=stride)
    assert np.array_equal(some.lengths, every.lengths[:, stride - 1 :: stride])
    assert np.array_equal(some.outputs, every.outputs)
    with pytest.raises(ValueError, match="stride = 0: expected a whole number from 1 to"):
        thin.run(angles, stride=0)


def test_an_arm_that_fails_stops_and_the_others_go_on() -> None:
    angles = drives(4)
    angles[2, 1200:] = np.where(np.arange(300) % 2, 90.0, -90.0)[:, None]
    alone = [Arm(ArmParameters.preset("inertial")) for _ in range(4)]
    batch = ArmBatch(alone)
    run = batch.run(angles)
    with pytest.raises(DomainError) as caught:
        alone[2].run(angles[2])
    failure = run.failures[2]
    assert isinstance(failure, DomainError)
    assert str(failure) == str(caught.value)
    assert run.steps[2] == failure.step == caught.value.step < STEPS
    assert np.array_equal(run.lengths[2, : failure.step], caught.value.lengths)
    assert (run.lengths[2, failure.step :] == run.lengths[2, failure.step - 1]).all()
    assert batch.states[2] == alone[2].state
    for index in (0, 1, 3):
        assert run.failures[index] is None
        assert np.array_equal(run.lengths[index], alone[index].run(angles[index]))


def test_states() -> None:
    batch = ArmBatch(arms(3))
    saved = batch.states
    first = batch.run(drives(3)[:, :100])
    batch.states = saved
    assert np.array_equal(batch.run(drives(3)[:, :100]).lengths, first.lengths)
    now = batch.states
    with pytest.raises(ValueError, match=r"states has shape \(2,\), expected \(3,\)"):
        batch.states = saved[:2]
    bad = copy.deepcopy(saved)
    bad[2].coordinates[4, 1] = 3.0
    with pytest.raises(ValueError, match="bend_angle of compartment 5"):
        batch.states = bad
    assert batch.states == now
    with pytest.raises(TypeError, match=r"states\[0\] must be an ArmState"):
        batch.states = [1, 2, 3]  # type: ignore[list-item]


def test_muscles_are_those_of_every_arm_alone() -> None:
    arms, rng = [Arm() for _ in range(11)], np.random.default_rng(0)
    batch = ArmBatch(arms)
    assert not np.any(batch.muscles)
    for _ in range(2):
        inputs = rng.uniform(-0.05, 0.05, (2, 11, 20, 4))
        batch.muscles = inputs
        assert np.array_equal(batch.muscles, inputs)
        lengths = batch.run(np.zeros((30, 2))).lengths
        for index, arm in enumerate(arms):
            arm.muscles = inputs[:, index]
            assert np.array_equal(arm.run(np.zeros((30, 2))), lengths[index])
    before = batch.muscles
    holed = inputs.copy()
    holed[1, 8, 3, 2] = np.nan
    for bad, kind, words in (
        (holed, ValueError, r"transverse\[8, 3, 2\] = NaN"),
        (
            inputs[:, :10],
            ValueError,
            r"longitudinal has shape \(10, 20, 4\), expected \(11, 20, 4\)",
        ),
        (inputs[0], TypeError, "muscles must be a pair"),
    ):
        with pytest.raises(kind, match=words):
            batch.muscles = bad
        assert np.array_equal(batch.muscles, before)


def test_bad_input_is_named() -> None:
    with pytest.raises(ValueError, match="arms = 0"):
        ArmBatch([])
    with pytest.raises(TypeError, match=r"arms\[1\] must be an Arm, not int"):
        ArmBatch([Arm(), 3])  # type: ignore[list-item]
    with pytest.raises(ValueError, match="compartments = 5"):
        ArmBatch([Arm(), Arm(ArmParameters(compartments=5))])
    with pytest.raises(ValueError, match="threads = 0"):
        ArmBatch([Arm()], threads=0)
    batch = ArmBatch([Arm(), Arm()])
    before = batch.states
    for angles, words in [
        (np.zeros((5, 3)), r"angles has shape \(5, 3\), expected \(any, 2\) or \(2, any, 2\)"),
        (np.zeros((3, 5, 2)), "angles has shape"),
        ([[0.0, np.nan]], r"angles\[0, 1\] = NaN"),
        (np.full((2, 4, 2), 4000.0), r"angles\[0, 0\]: theta = 4000"),
    ]:
        with pytest.raises(ValueError, match=words):
            batch.run(angles)
    for weights, count, push, words in [
        (np.zeros((79, 2)), 5, None, "weights has shape"),
        (np.zeros((80, 2)), -1, None, "steps = -1"),
        (np.zeros((80, 2)), 5, np.zeros((4, 2)), "perturbation has 4 rows, expected 5"),
        (np.zeros((80, 2)), 2**64, None, "steps = 18446744073709551616"),
    ]:
        with pytest.raises(ValueError, match=words):
            batch.run_closed_loop(weights, count, push)
    with pytest.raises(MemoryError, match="outputs of 1000000000000000 steps"):
        batch.run_closed_loop(np.zeros((80, 2)), 10**15)
    for stride, error in [(0, ValueError), (1.0, TypeError), (2**70, ValueError)]:
        with pytest.raises(error, match=f"stride = {stride}"):
            batch.run(np.zeros((5, 2)), stride=stride)
    for threads, error in [(1.5, TypeError), (2**70, ValueError), (True, TypeError)]:
        with pytest.raises(error, match=f"threads = {threads}"):
            ArmBatch([Arm()], threads=threads)
    assert batch.states == before
    with pytest.raises(TypeError, match="cannot be pickled"):
        pickle.dumps(batch)
    assert repr(batch) == "ArmBatch(2 arms)"
