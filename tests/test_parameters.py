"""ArmParameters: frozen, validated, and exact on their way through files."""

from __future__ import annotations

import copy
import dataclasses
import json
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from hypothesis import given
from hypothesis import strategies as st

from octoarm_env import Arm, ArmBatch, ArmParameters, EpisodeSettings


def test_defaults_are_table_1() -> None:
    p = ArmParameters()
    assert (p.rest_length, p.base_radius, p.tip_radius) == (0.02, 0.015, 0.0067)
    assert (p.longitudinal_mass, p.transverse_mass) == (1.25e-3, 1.25e-3)
    assert (p.longitudinal_stiffness, p.transverse_stiffness) == (196.0, 1570.0)
    assert (p.longitudinal_damping, p.transverse_damping) == (1.0, 1.0)
    assert (p.longitudinal_volume_gain, p.transverse_volume_gain) == (1e6, 1e6)
    assert p.drag_coefficients == (-5.5e-9, 6.3e-7, -7.7e-6, 0.0015, 0.017)
    assert p.lift_coefficients == (1.8e-9, -5.9e-7, 2.8e-5, 0.0011, 0.00089)
    assert (p.water_density, p.compartments, p.timestep) == (1000.0, 20, 1e-3)


def test_frozen_hashable_replaceable() -> None:
    p = ArmParameters()
    with pytest.raises(dataclasses.FrozenInstanceError):
        p.timestep = 0.1
    changed = p.replace(arm_density=1042, gravity=[0, 0, 1])
    assert changed.arm_density == 1042.0
    assert isinstance(changed.arm_density, float)
    assert changed.gravity == (0.0, 0.0, 1.0)
    assert changed != p
    assert hash(p) == hash(ArmParameters())
    assert pickle.loads(pickle.dumps(changed)) == copy.deepcopy(changed) == changed


@given(
    density=st.floats(0, 1e5),
    gravity=st.tuples(*[st.floats(-1e3, 1e3)] * 3),
    compartments=st.integers(1, 200),
)
def test_round_trips_are_exact(density: float, gravity: tuple, compartments: int) -> None:
    p = ArmParameters(arm_density=density, gravity=gravity, compartments=compartments)
    assert ArmParameters.from_json(p.to_json()) == p
    assert ArmParameters.from_dict(p.to_dict()) == p


def test_files(tmp_path) -> None:
    p = ArmParameters(area_scale=3.0)
    path = tmp_path / "body.json"
    p.to_json(path)
    assert ArmParameters.from_json(path) == p
    assert [entry.name for entry in tmp_path.iterdir()] == ["body.json"]
    path.write_text('{"area_scale": ')
    with pytest.raises(ValueError, match="body.json is not JSON"):
        ArmParameters.from_json(path)
    path.write_text("[1, 2]")
    with pytest.raises(ValueError, match="expected a JSON object"):
        ArmParameters.from_json(path)
    path.write_text(json.dumps({"colour": "red"}))
    with pytest.raises(ValueError, match="body.json: unknown parameters \\['colour'\\]"):
        ArmParameters.from_json(str(path))
    with pytest.raises(FileNotFoundError):
        ArmParameters.from_json(tmp_path / "absent.json")
    with pytest.raises(OSError, match="absent"):
        p.to_json(tmp_path / "absent" / "body.json")


@pytest.mark.parametrize(
    ("fields", "kind", "words"),
    [
        ({"longitudinal_mass": -1.0}, ValueError, r"longitudinal_mass = -1 .* \(0, 100\]"),
        ({"timestep": float("nan")}, ValueError, "timestep = nan"),
        ({"rest_length": float("inf")}, ValueError, "rest_length = inf"),
        ({"gravity": (0.0, 0.0, 1e9)}, ValueError, r"gravity\[2\]"),
        ({"gravity": (0.0, 1.0)}, ValueError, "gravity: invalid length 2"),
        ({"gravity": 3}, ValueError, "gravity: invalid type"),
        ({"gravity": (0.0, 0.0, float("nan"))}, ValueError, "gravity"),
        ({"compartments": 0}, ValueError, r"compartments = 0 .* \[1, 200\]"),
        ({"compartments": 2.5}, ValueError, "compartments: invalid type.*2.5"),
        ({"compartments": -1}, ValueError, "compartments: invalid value.*-1"),
        ({"volume_force": "both"}, ValueError, "volume_force: .*both.*applied"),
        ({"area_scale": "1"}, ValueError, "area_scale: invalid type"),
        ({"area_scale": None}, ValueError, "area_scale: invalid type: null"),
        ({"area_scale": True}, ValueError, "area_scale: invalid type: boolean"),
        ({"area_scale": object()}, TypeError, "not a number"),
        ({"drag_coefficients": (0, 0, 0, -1.0, 0.5)}, ValueError, "drag_coefficients"),
        ({"stiffness": 3.0}, TypeError, "stiffness"),
        (
            {"plane_mass": (0.0, 0.1)},
            ValueError,
            r"plane_mass has shape \(2,\), expected \(20,\), a number for each compartment, or one",
        ),
        (
            {"transverse_damping": [1.0, -1.0], "compartments": 2},
            ValueError,
            r"transverse_damping\[1\] = -1 .* \[0, 1000000\]",
        ),
        ({"plane_inertia": [0.0, "x"], "compartments": 2}, ValueError, r"plane_inertia.*\"x\""),
        ({"plane_mass": np.zeros((2, 2)), "compartments": 2}, ValueError, "plane_mass"),
        ({"plane_mass": [0, float("nan")], "compartments": 2}, ValueError, "plane_mass"),
        ({"longitudinal_mass": "heavy"}, ValueError, "longitudinal_mass: .*heavy.*a number, or a"),
        ({"rest_length": [0.02] * 20}, ValueError, "rest_length: invalid type"),
    ],
)
def test_bad_values_are_named(fields: dict, kind: type[Exception], words: str) -> None:
    with pytest.raises(kind, match=words):
        ArmParameters(**fields)


def uneven() -> ArmParameters:
    random = np.random.default_rng(5)
    return ArmParameters(
        longitudinal_stiffness=196 * random.uniform(0.8, 1.2, 20),
        transverse_damping=random.uniform(0.5, 1.0, 20),
        longitudinal_mass=[1.25e-3] * 19 + [2e-3],
        plane_mass=1e-4 * np.arange(20),
    )


def test_a_number_for_each_compartment_goes_all_ways(tmp_path) -> None:
    body = uneven()
    assert body.longitudinal_mass == (1.25e-3,) * 19 + (2e-3,)
    assert body.plane_mass[3] == 1e-4 * 3
    assert hash(body) == hash(uneven())
    assert pickle.loads(pickle.dumps(body)) == copy.deepcopy(body) == body == uneven()
    body.to_json(tmp_path / "body.json")
    assert (
        ArmParameters.of(tmp_path / "body.json") == ArmParameters.from_dict(body.to_dict()) == body
    )
    arm = Arm(body, actuator="servo")
    angles = 10 * np.random.default_rng(0).standard_normal((50, 2))
    arm.run(angles)
    assert pickle.loads(pickle.dumps(arm)).parameters == body
    # In lanes, beside arms of one number.
    bodies = [ArmParameters(), body, body.replace(plane_mass=body.plane_mass[::-1])]
    batch = ArmBatch([Arm(each, actuator="servo") for each in bodies])
    batch.run(angles)
    for index, each in enumerate(bodies):
        alone = Arm(each, actuator="servo")
        alone.run(angles)
        np.testing.assert_array_equal(batch.lengths[index], alone.lengths)
    assert np.abs(np.diff(batch.lengths, axis=0)).max(axis=1).min() > 1e-9


def test_the_first_entry_is_of_the_compartment_at_the_base() -> None:
    stretch = Arm().lengths - 0.02
    soft = Arm(ArmParameters(longitudinal_stiffness=[98.0] + [196.0] * 19)).lengths - 0.02
    # The same weight hangs from springs half as stiff; their rings become a little narrower.
    np.testing.assert_allclose(soft[:4], 2 * stretch[:4], rtol=0.05)
    np.testing.assert_allclose(soft[8:], stretch[8:], rtol=0.05)


def test_a_factor_is_of_every_entry() -> None:
    body = uneven().scaled(longitudinal_stiffness=2.0, plane_mass=0.5, transverse_stiffness=3.0)
    assert body.longitudinal_stiffness == tuple(2 * k for k in uneven().longitudinal_stiffness)
    assert body.plane_mass == tuple(0.5 * m for m in uneven().plane_mass)
    assert body.transverse_stiffness == 3 * 1570.0
    kept = ("longitudinal_stiffness", "plane_mass", "transverse_stiffness")
    assert body.replace(**{name: getattr(uneven(), name) for name in kept}) == uneven()
    settings = EpisodeSettings("lissajous", arm=uneven(), vary={"plane_mass": (2.0, 2.0)}, bodies=2)
    assert settings.drawn_bodies == (uneven().scaled(plane_mass=2.0),) * 2


@pytest.mark.parametrize("name", ["OctoArm-v0", "OctoArmReach-v0"])
def test_environments_take_numbers_for_each_compartment(name: str) -> None:
    body = uneven()
    env = gym.make(name, arm=body)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.settings == env.unwrapped.settings
    assert again.unwrapped.settings.arm == body
    envs = gym.make_vec(name, num_envs=2, arm=body.to_dict())

    def seen(observation: Any) -> Any:
        return observation["observation"] if isinstance(observation, dict) else observation

    rows, one = envs.reset(seed=4)[0], env.reset(seed=4)[0]
    np.testing.assert_array_equal(seen(one), seen(rows)[0])
    action = env.action_space.sample()
    rows, after = envs.step(np.stack([action] * 2))[0], env.step(action)[0]
    np.testing.assert_array_equal(seen(after), seen(rows)[0])
    assert not np.array_equal(seen(gym.make(name).reset(seed=4)[0]), seen(one))
    envs.close()


def test_numpy_values() -> None:
    p = ArmParameters(
        arm_density=np.float32(1200.0), gravity=np.array([0.0, 0.0, 5.0]), compartments=np.int64(6)
    )
    assert p == ArmParameters(arm_density=1200.0, gravity=(0.0, 0.0, 5.0), compartments=6)
    assert Arm(p).lengths.shape == (24,)


def test_field_documentation_is_complete() -> None:
    text = ArmParameters.__doc__ or ""
    for field in dataclasses.fields(ArmParameters):
        assert f"\n    {field.name} " in text


def test_a_written_file_has_the_mode_of_any_other(tmp_path):
    (tmp_path / "plain").touch()
    ArmParameters().to_json(tmp_path / "body.json")
    assert (tmp_path / "body.json").stat().st_mode == (tmp_path / "plain").stat().st_mode
    assert sorted(path.name for path in tmp_path.iterdir()) == ["body.json", "plain"]


def test_named_bodies() -> None:
    paper, inertial = (ArmParameters.preset(name) for name in ("nakajima2013", "inertial"))
    assert (paper.base_coupling, inertial.base_coupling) == ("gravity", "inertial")
    with pytest.raises(ValueError, match="arm = 'octopus': expected one of .*nakajima2013"):
        ArmParameters.preset("octopus")


def test_a_body_by_name_mapping_and_file(tmp_path) -> None:
    paper = ArmParameters.preset("nakajima2013")
    path = tmp_path / "body.json"
    paper.to_json(path)
    for body in ("nakajima2013", paper.to_dict(), path, str(path), paper):
        assert ArmParameters.of(body) == Arm(body).parameters == paper
        envs = gym.make_vec("OctoArm-v0", num_envs=2, arm=body)
        lengths, _ = envs.reset(seed=0)
        envs.close()
        env = gym.make("OctoArm-v0", arm=body)
        assert np.array_equal(env.reset(seed=0)[0], lengths[0])
    assert ArmParameters.of(None) == ArmParameters()
    with pytest.raises(ValueError, match="arm: cannot read octopus: neither"):
        gym.make("OctoArm-v0", arm="octopus")
    with pytest.raises(TypeError, match="arm must be an ArmParameters, a name"):
        gym.make("OctoArm-v0", arm=3)


def test_gravity_alone_reaches_the_arm_of_the_paper() -> None:
    weightless = ArmParameters.preset("nakajima2013").replace(gravity=(0.0, 0.0, 0.0))
    angles = np.cumsum(np.full((300, 2), 0.2), axis=0)
    for coupling, moves in (("gravity", False), ("inertial", True)):
        arm = Arm(weightless.replace(base_coupling=coupling))
        rest = arm.lengths
        assert (np.abs(arm.run(angles) - rest).max() > 1e-6) == moves
