"""Arms driven side by side are the arms driven alone."""

import numpy as np
import pytest
from octoarm_agents.common.lanes import LANES, record_arms

from octoarm_env import LIMIT_CYCLES, Arm, ArmParameters, DomainError

# Carried along by its base, slow and draggy: one that some motions take out of its domain.
HEAVY = ArmParameters.preset("inertial").replace(area_scale=48.0, plane_mass=0.044, lift_scale=-1.0)


def alone(arm, angles):
    """The arm's run, or the error that ended it; the arm itself stays as it is."""
    state = arm.state
    try:
        return arm.run(angles)
    except DomainError as error:
        return error
    finally:
        arm.state = state


def assert_same(recording, expected):
    if isinstance(expected, DomainError):
        assert isinstance(recording, DomainError)
        assert str(recording) == str(expected)
        for name in ("limit", "compartment", "value", "low", "high", "time", "step"):
            assert getattr(recording, name) == getattr(expected, name)
    else:
        assert recording.flags.c_contiguous
        np.testing.assert_array_equal(recording, expected)


@pytest.mark.parametrize("count", [0, 1, 2, 3, LANES + 3])
def test_every_arm_runs_as_alone(count):
    names = list(LIMIT_CYCLES)
    arms, angles = [], []
    for index in range(count):
        body = HEAVY.replace(area_scale=5.0 + index, compartments=20 if index % 4 else 18)
        arms.append(Arm(body))
        angles.append(LIMIT_CYCLES[names[index % 3]].signal(1500 - 100 * index, 10.0 + index))
    if count:
        # One that leaves its domain, and that does not start at rest.
        arms[-1].step(0.5, 0.5)
        angles[-1] = np.where(np.arange(900) % 2, 90.0, -90.0)[:, None].repeat(2, axis=1)
    states = [arm.state for arm in arms]
    recordings = record_arms(arms, angles)
    assert [arm.state for arm in arms] == states
    expected = [alone(arm, commands) for arm, commands in zip(arms, angles, strict=True)]
    assert [isinstance(each, DomainError) for each in expected] == [
        index == count - 1 for index in range(count)
    ]
    assert len(recordings) == count
    for recording, each in zip(recordings, expected, strict=True):
        assert_same(recording, each)


def test_what_is_beyond_an_arms_own_commands_does_not_count():
    arm = Arm(HEAVY)
    violent = LIMIT_CYCLES["van_der_pol"].signal(5_000, 400.0)
    step = alone(arm, violent).step
    # It is still alive here, and breaks when its base then stands still.
    own = next(
        violent[:end]
        for end in range(step, 0, -10)
        if isinstance(alone(arm, held(violent[:end])), DomainError)
        and not isinstance(alone(arm, violent[:end]), DomainError)
    )
    gentle = np.zeros((len(own) + 2_000, 2))
    recordings = record_arms([arm] * 4, [gentle, own, violent, own[:-100]])
    for recording, angles in zip(recordings, (gentle, own, violent, own[:-100]), strict=True):
        assert_same(recording, alone(arm, angles))
    assert len(recordings[1]) == len(own)


def held(angles):
    return np.vstack((angles, np.repeat(angles[-1:], 2_000, axis=0)))
