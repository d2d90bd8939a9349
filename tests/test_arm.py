"""The body through its Python face."""

from __future__ import annotations

import copy
import dataclasses
import pickle

import numpy as np
import pytest

from octoarm_env import Arm, ArmBatch, ArmParameters, ArmState, DomainError


def swing(steps: int, reach: float = 20.0) -> np.ndarray:
    t = np.arange(steps) * 1e-3
    return reach * np.stack([np.sin(6.0 * t) ** 2, np.sin(4.0 * t) ** 2], axis=1)


def test_the_arm_starts_in_equilibrium_and_stays() -> None:
    arm = Arm()
    before = arm.lengths
    assert before.shape == (80,)
    after = arm.run(np.zeros((500, 2)))[-1]
    # Newton's method leaves accelerations of 1e-9 at most; 0.5 s of them move nothing by 1e-12 m.
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-12)
    # It hangs: the base carries everything below it.
    assert before[0] > before[40] > 0.02


def test_undeformed_reset() -> None:
    arm = Arm()
    lengths = arm.reset(undeformed=True)
    np.testing.assert_allclose(lengths, 0.02, rtol=0, atol=1e-16)
    assert arm.energy() == (0.0, pytest.approx(0.0, abs=1e-25))
    assert arm.time == 0.0
    positions = arm.positions
    assert positions.shape == (21, 3)
    np.testing.assert_allclose(positions[:, :2], 0.0, atol=1e-17)
    assert np.all(np.diff(positions[:, 2]) > 0.0199)


def test_observation_order_is_the_paper_s() -> None:
    # Bending about +x by moving θ stretches and shortens springs 2 and 4, not 1 and 3.
    arm = Arm()
    for _ in range(20):
        lengths = arm.step(arm.base_angles[0] + 0.2, 0.0).reshape(20, 4)
    spread = np.abs(lengths[0] - lengths[0].mean())
    assert spread[1] > 20 * spread[0]
    assert spread[3] > 20 * spread[2]


@pytest.mark.parametrize("actuator", ["direct", "servo"])
def test_step_and_run_are_the_same_bits(actuator: str) -> None:
    angles = swing(300)
    one, other = Arm(actuator=actuator), Arm(actuator=actuator)
    stepped = np.array([one.step(theta, phi) for theta, phi in angles])
    assert np.array_equal(stepped, other.run(angles))
    assert one.state == other.state


def test_direct_base_is_where_it_was_commanded_and_servo_follows_its_equation() -> None:
    arm = Arm()
    arm.step(0.5, -0.25)
    np.testing.assert_allclose(arm.base_angles, [0.5, -0.25], rtol=1e-14)
    arm = Arm(actuator="servo")
    arm.run(np.tile([10.0, 0.0], (30, 1)))
    omega_t = 2 * np.pi * 12.0 * 0.03
    expected = 10.0 * (1.0 - (1.0 + omega_t) * np.exp(-omega_t))
    np.testing.assert_allclose(arm.base_angles[0], expected, rtol=1e-12)


def test_a_state_holds_the_muscle_inputs() -> None:
    arm, rng = Arm(), np.random.default_rng(0)
    arm.muscles = rng.uniform(-0.05, 0.05, (2, 20, 4))
    arm.run(np.zeros((40, 2)))
    state = arm.state
    assert np.array_equal(state.muscles, arm.muscles)
    expected = arm.run(np.zeros((40, 2)))
    arm.muscles = np.zeros((2, 20, 4))
    assert arm.state != dataclasses.replace(arm.state, muscles=state.muscles)
    batch = ArmBatch([arm, arm])
    batch.states = [state, dataclasses.replace(state, muscles=None)]
    runs = batch.run(np.zeros((40, 2))).lengths
    arm.state = state
    assert np.array_equal(arm.run(np.zeros((40, 2))), expected)
    assert np.array_equal(runs[0], expected)
    assert not np.array_equal(runs[1], expected)
    arm.state = dataclasses.replace(state, muscles=None)
    assert not np.any(arm.muscles)
    assert arm.state == dataclasses.replace(state, muscles=None)
    for bad, words in [((np.zeros((19, 4)),) * 2, r"muscles\[0\] has shape \(19, 4\)")]:
        with pytest.raises(ValueError, match=words):
            arm.state = dataclasses.replace(state, muscles=bad)
    for steps in (-1, 2**64):
        with pytest.raises(ValueError, match=f"state.steps = {steps}"):
            arm.state = dataclasses.replace(state, steps=steps)


def test_state_pickle_and_deepcopy_go_on_with_the_same_bits() -> None:
    arm = Arm(ArmParameters(compartments=9), actuator="servo")
    arm.muscles = (np.full((9, 4), 0.01), np.full((9, 4), -0.02))
    arm.run(swing(200))
    saved = arm.state
    copies = [pickle.loads(pickle.dumps(arm)), copy.deepcopy(arm)]
    fresh = Arm(ArmParameters(compartments=9), actuator="servo")
    fresh.muscles = arm.muscles
    fresh.state = saved
    copies.append(fresh)
    expected = arm.run(swing(200, 15.0))
    for twin in copies:
        assert np.array_equal(twin.run(swing(200, 15.0)), expected)
        assert twin.time == arm.time
    assert isinstance(saved, ArmState)
    assert saved.coordinates.shape == saved.rates.shape == (9, 7)
    assert saved.base.shape == (4,)


def test_closed_loop_is_open_loop_with_the_readout_s_outputs() -> None:
    rng = np.random.default_rng(0)
    weights = rng.normal(size=(81, 2)) * 3.0
    arm, twin = Arm(), Arm()
    weights[80] = -weights[:80].T @ arm.lengths
    push = 0.01 * rng.normal(size=(100, 2))
    outputs, lengths = arm.run_closed_loop(weights, 100, perturbation=push)
    assert outputs.shape == (100, 2)
    assert lengths.shape == (100, 80)
    assert np.array_equal(twin.run(outputs + push), lengths)
    said = lengths[:-1] @ weights[:80] + weights[80]
    np.testing.assert_allclose(outputs[1:], said, rtol=0, atol=1e-12)
    zero_out, zero_lengths = arm.run_closed_loop(weights, 0)
    assert zero_out.shape == (0, 2)
    assert zero_lengths.shape == (0, 80)


@pytest.mark.parametrize("actuator", ["direct", "servo"])
def test_a_linearised_step_is_that_of_small_deviations(actuator: str) -> None:
    arm = Arm(ArmParameters(compartments=5), actuator)
    arm.run(swing(420))
    before = arm.state
    command = swing(421)[-1]
    step = arm.linearise(*command)
    assert arm.state == before
    assert [matrix.shape for matrix in step] == [(74, 74), (74, 2), (20, 74)]

    random = np.random.default_rng(0)
    scale = np.concatenate((np.tile([0.02, 1, 1, *[0.015] * 4], 5), [0.3] * 35, [0.5] * 4))
    deviation, turn = scale * random.normal(size=74), random.normal(size=2)

    def after(share: float) -> tuple[np.ndarray, np.ndarray]:
        by = share * deviation
        arm.state = dataclasses.replace(
            before,
            coordinates=before.coordinates + by[:35].reshape(5, 7),
            rates=before.rates + by[35:70].reshape(5, 7),
            base=before.base + by[70:],
        )
        lengths = arm.lengths
        arm.step(*(command + share * turn))
        state = arm.state
        return lengths, np.concatenate((state.coordinates.ravel(), state.rates.ravel(), state.base))

    (long, ahead), (short, behind) = after(1e-6), after(-1e-6)
    expected = (ahead - behind) / 2e-6
    found = step.state @ deviation + step.command @ turn
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7 * np.abs(expected).max())
    np.testing.assert_allclose(step.lengths @ deviation, (long - short) / 2e-6, rtol=0, atol=1e-8)
    for angle, words in ((float("nan"), "theta = NaN"), (10**400, "theta or phi")):
        with pytest.raises(ValueError, match=words):
            arm.linearise(angle, 0.0)


def test_leaving_the_domain_names_the_limit_and_keeps_the_last_state() -> None:
    inertial = ArmParameters.preset("inertial")
    arm = Arm(inertial)
    rng = np.random.default_rng(1)
    with pytest.raises(DomainError, match=r"compartment \d+ is .* at t = ") as caught:
        arm.run(rng.uniform(-2, 2, (2000, 2)))
    error = caught.value
    assert error.lengths.shape == (error.step, 80)
    assert np.isfinite(error.lengths).all()
    assert error.limit in {"bend_angle", "height", "radius", "spring_length", "not_finite"}
    assert 1 <= error.compartment <= 20
    assert error.step > 0
    assert np.array_equal(arm.lengths, error.lengths[-1])
    assert arm.time == pytest.approx(error.step * 1e-3)
    weights = np.full((80, 2), 1e4)
    with pytest.raises(DomainError) as caught:
        Arm(inertial).run_closed_loop(weights, 50)
    assert caught.value.outputs.shape == (caught.value.step, 2)


@pytest.mark.parametrize(
    ("call", "kind", "words"),
    [
        (lambda arm: arm.step(np.nan, 0.0), ValueError, "theta = NaN"),
        (lambda arm: arm.step(0.0, np.inf), ValueError, "phi = inf"),
        (lambda arm: arm.step(0.0, 1e300), ValueError, "-3600, 3600"),
        (lambda arm: arm.step("a", 0.0), TypeError, "theta"),
        (lambda arm: arm.step(10**400, 0.0), ValueError, "theta or phi .* 3600"),
        (lambda arm: arm.reset(undeformed="no"), TypeError, "undeformed = 'no'"),
        (lambda arm: Arm(undeformed=1), TypeError, "undeformed = 1"),
        (lambda arm: Arm(actuator=3), ValueError, "actuator = 3"),
        (lambda arm: arm.run(np.zeros((5, 3))), ValueError, r"angles has shape \(5, 3\)"),
        (lambda arm: arm.run(np.zeros(5)), ValueError, r"angles has shape \(5,\)"),
        (lambda arm: arm.run([[0.0, np.nan]]), ValueError, r"angles\[0, 1\] = NaN"),
        (lambda arm: arm.run([[0.0, 1e9]]), ValueError, r"angles\[0\]: phi"),
        (lambda arm: arm.run([["a", "b"]]), TypeError, "angles must be an array of real numbers"),
        (lambda arm: arm.run(np.zeros((2, 2), complex)), TypeError, "complex"),
        (lambda arm: arm.run(None), TypeError, "angles"),
        (lambda arm: arm.run_closed_loop(np.zeros((79, 2)), 5), ValueError, r"weights has shape"),
        (lambda arm: arm.run_closed_loop(np.zeros((80, 2)), -1), ValueError, "steps = -1"),
        (
            lambda arm: arm.run_closed_loop(np.zeros((80, 2)), 5, np.zeros((4, 2))),
            ValueError,
            r"perturbation has shape \(4, 2\)",
        ),
        (lambda arm: arm.run_closed_loop(np.zeros((80, 2)), 2**62), MemoryError, "steps = 4611"),
        (lambda arm: arm.run_closed_loop(np.zeros((80, 2)), 2**70), ValueError, "steps = 1180"),
        (lambda arm: arm.run_closed_loop(np.zeros((80, 2)), 10.0), TypeError, r"steps = 10\.0"),
        (
            lambda arm: setattr(arm, "muscles", (np.zeros((20, 3)), np.zeros((20, 4)))),
            ValueError,
            "longitudinal has shape",
        ),
        (
            lambda arm: setattr(arm, "muscles", (np.zeros((20, 4)), np.full((20, 4), np.inf))),
            ValueError,
            r"transverse\[0, 0\] = inf",
        ),
    ],
)
def test_bad_input_is_refused_and_changes_nothing(call, kind, words) -> None:
    arm = Arm()
    arm.run(swing(20))
    before = arm.state
    with pytest.raises(kind, match=words):
        call(arm)
    assert arm.state == before


def test_bad_states_are_refused_and_change_nothing() -> None:
    arm = Arm()
    good = arm.state

    def broken(**changes: object) -> ArmState:
        fields = {"coordinates": good.coordinates, "rates": good.rates, "base": good.base}
        return ArmState(**{**fields, **changes}, steps=0)  # type: ignore[arg-type]

    folded = good.coordinates.copy()
    folded[3, 1] = 2.7
    nan = good.rates.copy()
    nan[2, 2] = np.nan
    with pytest.raises(TypeError, match="ArmState"):
        arm.state = (good.coordinates, good.rates)
    with pytest.raises(TypeError, match="muscles"):
        arm.muscles = 3
    for state, words in [
        (broken(coordinates=good.coordinates[:-1]), r"state.coordinates has shape \(19, 7\)"),
        (broken(rates=nan), r"state.rates\[2, 2\]"),
        (broken(base=np.zeros(3)), "state.base has shape"),
        (broken(coordinates=folded), "bend_angle of compartment 4"),
    ]:
        with pytest.raises(ValueError, match=words):
            arm.state = state
        assert arm.state == good


def test_a_body_without_equilibrium_can_start_undeformed() -> None:
    sideways = ArmParameters(gravity=(100.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="no static equilibrium"):
        Arm(sideways)
    arm = Arm(sideways, undeformed=True)
    arm.run(np.zeros((20, 2)))
    with pytest.raises(ValueError, match="no static equilibrium"):
        arm.reset()
    assert arm.time == pytest.approx(0.02)
    assert pickle.loads(pickle.dumps(arm)).state == arm.state


def test_bad_construction() -> None:
    with pytest.raises(ValueError, match="actuator"):
        Arm(actuator="hydraulic")
    with pytest.raises(TypeError, match="ArmParameters"):
        Arm(1000.0)


def test_releases_the_gil() -> None:
    # Another thread counts while the arm runs; with the GIL held it would stand still.
    import threading

    arm = Arm()
    counts = []
    done = threading.Event()

    def count() -> None:
        n = 0
        while not done.is_set():
            n += 1
            if n % 100 == 0:
                counts.append(n)

    thread = threading.Thread(target=count)
    thread.start()
    arm.run(np.zeros((8000, 2)))
    done.set()
    thread.join()
    assert len(counts) > 10


@pytest.mark.parametrize("columns", [82, 162])
def test_muscles_are_outputs_too(columns: int) -> None:
    """Against a loop in Python; muscles without a readout stay as they are."""
    random = np.random.default_rng(columns)
    weights = np.zeros((81, columns))
    weights[:, 2:] = random.uniform(-1.0, 1.0, (81, columns - 2))
    weights[80] = -0.02 * weights[:80].sum(axis=0) + random.uniform(-0.2, 0.0, columns)
    push = random.uniform(-1.0, 1.0, (60, 2))
    arm, twin = Arm(), Arm()
    held = np.full((20, 4), -0.05)
    arm.muscles = twin.muscles = held, held
    outputs, lengths = arm.run_closed_loop(weights, 60, push)
    assert outputs.shape == (60, columns)
    for step in range(60):
        said = np.append(twin.lengths, 1.0) @ weights
        np.testing.assert_allclose(outputs[step], said, atol=1e-12)
        along = outputs[step, 2:82].reshape(20, 4)
        across = outputs[step, 82:].reshape(20, 4) if columns == 162 else held
        twin.muscles = along, across
        twin.step(*(outputs[step, :2] + push[step]))
        np.testing.assert_array_equal(lengths[step], twin.lengths)
    np.testing.assert_array_equal(arm.muscles[0], along)
    np.testing.assert_array_equal(arm.muscles[1], across)


def test_a_run_that_ends_early_keeps_its_muscles() -> None:
    weights = np.zeros((81, 82))
    weights[80, 2:] = -30.0
    arm = Arm()
    with pytest.raises(DomainError) as caught:
        arm.run_closed_loop(weights, 1000)
    assert caught.value.outputs is not None
    assert caught.value.outputs.shape == (caught.value.step, 82)
    np.testing.assert_array_equal(arm.muscles[0], -30.0 if caught.value.step else 0.0)
    weights[80, 2:] = 1e308
    weights[:80, 2:] = 1e308
    fresh = Arm()
    with pytest.raises(DomainError, match="no finite state"):
        fresh.run_closed_loop(weights, 10)
    np.testing.assert_array_equal(fresh.muscles[0], 0.0)
    for columns in (1, 3, 81, 163):
        with pytest.raises(ValueError, match="weights"):
            fresh.run_closed_loop(np.zeros((81, columns)), 1)
