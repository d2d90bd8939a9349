"""`octoarm inspect`: what Rerun's own reader finds in a recording is what the arm did."""

import signal
import subprocess
import sys
import urllib.parse
from http.client import HTTPConnection
from types import SimpleNamespace

import numpy as np
import pytest
import rerun as rr
import typer
from octoarm_agents import inspection
from octoarm_agents.cli import inspect as command
from octoarm_agents.cli.actors import find_actor
from octoarm_agents.common.environment import make_vector_env
from octoarm_agents.common.orbit import orbit_distance
from octoarm_agents.policies.episode import Episode
from octoarm_agents.policies.evaluation import acting
from octoarm_agents.policies.rollout import Noise, Push, roll_out
from typer.testing import CliRunner

from octoarm_env import ArmParameters
from octoarm_env.rendering import mesh
from octoarm_env.rendering.colours import strain_colours

APP = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
APP.command()(command.inspect)

SCALARS = [
    *(f"/springs/{row}" for row in range(1, 5)),
    *(f"/angles/{name}/{kind}" for name in ("theta", "phi") for kind in ("base", "target")),
    *(f"/error/{kind}" for kind in ("tracking", "orbit")),
]
OF_STEPS = [
    *(f"/angles/{name}/command" for name in ("theta", "phi")),
    *(f"/reward/{kind}" for kind in ("reward", "tracking", "action_change", "return")),
]
SHAPES = ["/world/arm/skin", "/world/arm/springs", "/world/base", "/world/target", "/strain"]
FLAT = [f"/portrait/plane/{name}" for name in ("base", "target", "trail")]


def run(*options):
    """Run the command: `run("clock/quadratic", "--steps", 30)`."""
    return CliRunner().invoke(APP, [str(each) for each in options], env={"COLUMNS": "300"})


class Recorded:
    """A recording, read back: the rows of each stream in the order of its file."""

    def __init__(self, path):
        reader = rr.chunk.RrdReader(path)
        (entry,) = reader.recordings()
        self.application = entry.application_id
        self.still, self.rows = {}, {}
        for chunk in reader.stream():
            batch = chunk.to_record_batch()
            columns = {
                name: batch.column(name) for name in batch.schema.names if "RowId" not in name
            }
            if chunk.is_static:
                values = {name: column[0].as_py() for name, column in columns.items()}
                self.still.setdefault(chunk.entity_path, {}).update(values)
            else:
                stream = self.rows.setdefault(chunk.entity_path, {})
                for name, column in columns.items():
                    stream.setdefault(name, []).extend(column)
        self.views = {}
        for blueprint in reader.blueprints():
            for chunk in reader.stream(store=blueprint):
                batch = chunk.to_record_batch()
                names = ("ViewBlueprint:display_name", "ViewBlueprint:class_identifier")
                if all(name in batch.schema.names for name in names):
                    name, kind = (batch.column(each)[0].as_py()[0] for each in names)
                    self.views[name] = kind

    def steps(self, path):
        return np.array([step.as_py() for step in self.rows[path]["step"]])

    def nanoseconds(self, path):
        return np.array([time.value for time in self.rows[path]["time"]])

    def values(self, path, component):
        """All rows as one array."""
        return np.array([row.as_py() for row in self.rows[path][component]])

    def scalars(self, path):
        values = self.values(path, "Scalars:scalars")
        return values[:, 0] if values.shape[1] == 1 else values

    def data(self):
        """All that is logged, without the hour of the recording."""
        moving = {
            path: {name: [value.as_py() for value in values] for name, values in stream.items()}
            for path, stream in self.rows.items()
        }
        still = {path: each for path, each in self.still.items() if path != "/__properties"}
        return moving, still


def step_independently(actor, actions, seed):
    """What the environment gives for these actions: lists of a row for each moment or step."""
    env = actor.make_env(len(actions))
    bare = env.unwrapped
    lengths, info = env.reset(seed=seed)
    seen = SimpleNamespace(lengths=[], joints=[], base=[], target=[], error=[])
    steps = SimpleNamespace(reward=[], tracking=[], action_change=[], command=[])

    def look():
        seen.lengths.append(lengths)
        seen.joints.append(bare.arm_joints)
        seen.base.append(info["base_angles"])
        seen.target.append(info["target"])
        seen.error.append(info["tracking_error"])

    look()
    for action in actions:
        action = action.astype(np.float32)  # noqa: PLW2901
        lengths, reward, _, _, info = env.step(action)
        look()
        steps.reward.append(reward)
        steps.tracking.append(info["reward_tracking"])
        steps.action_change.append(info["reward_action_change"])
        steps.command.append(action.astype(float) * bare.action_range)
    everything = vars(seen) | vars(steps)
    return SimpleNamespace(
        **{name: np.array(rows) for name, rows in everything.items()},
        orbit=bare.orbit,
        period=bare.period,
    )


def roll(actor, seed, steps, **disturbances):
    envs = make_vector_env(1, actor.parameters, actor.settings, steps=steps)
    try:
        return roll_out(acting(actor.policy, envs), envs, seed=seed, steps=steps, **disturbances)
    finally:
        envs.close()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Thirty steps of a network, and the environment stepped by itself."""
    path = tmp_path_factory.mktemp("inspect") / "ppo.rrd"
    result = run("ppo/quadratic", "--steps", 30, "--seed", 3, "--out", path)
    assert result.exit_code == 0, result.output
    actor = find_actor("ppo/quadratic", None)
    actions = roll(actor, 3, 30).actions[:, 0]
    return Recorded(path), step_independently(actor, actions, 3)


class TestStreams:
    def test_every_stream_is_there_and_documented(self, recorded):
        recording, _ = recorded
        assert set(recording.rows) == {*SCALARS, *OF_STEPS, *SHAPES, *FLAT, "/events"}
        assert recording.application == "octoarm"
        about = recording.still["/about"]["TextDocument:text"][0]
        named = " ".join(inspection.STREAMS)
        assert all(f"`{path}`" in about for path in inspection.STREAMS)
        for path in (*OF_STEPS, *SCALARS[4:], *SHAPES, "/events"):
            assert path in named

    def test_rows_and_timelines(self, recorded):
        recording, _ = recorded
        for path in (*SCALARS, *SHAPES, *FLAT):
            np.testing.assert_array_equal(recording.steps(path), np.arange(31), err_msg=path)
        for path in OF_STEPS:
            np.testing.assert_array_equal(recording.steps(path), np.arange(1, 31), err_msg=path)
        for path, stream in recording.rows.items():
            assert {name for name in stream if ":" not in name} == {"time", "step"}
            expected = recording.steps(path) * 10_000_000
            np.testing.assert_array_equal(recording.nanoseconds(path), expected, err_msg=path)

    def test_lengths_are_those_of_the_environment(self, recorded):
        recording, truth = recorded
        for spring in range(4):
            own = recording.scalars(f"/springs/{spring + 1}")
            assert own.shape == (31, 20)
            np.testing.assert_array_equal(own, truth.lengths[:, spring::4])

    def test_angles_and_errors_are_those_of_the_environment(self, recorded):
        recording, truth = recorded
        for axis, name in enumerate(("theta", "phi")):
            for kind in ("base", "target", "command"):
                found = recording.scalars(f"/angles/{name}/{kind}")
                np.testing.assert_array_equal(found, getattr(truth, kind)[:, axis])
        np.testing.assert_array_equal(recording.scalars("/error/tracking"), truth.error)
        np.testing.assert_array_equal(
            recording.scalars("/error/orbit"), orbit_distance(truth.base, truth.orbit)
        )

    def test_rewards_are_those_of_the_environment(self, recorded):
        recording, truth = recorded
        for kind in ("reward", "tracking", "action_change"):
            np.testing.assert_array_equal(
                recording.scalars(f"/reward/{kind}"), getattr(truth, kind)
            )
        # Both are added up step by step.
        np.testing.assert_array_equal(recording.scalars("/reward/return"), np.cumsum(truth.reward))

    def test_the_strip_of_strains(self, recorded):
        recording, truth = recorded
        format_ = recording.still["/strain"]["Image:format"][0]
        assert (format_["width"], format_["height"]) == (20, 4)
        found = recording.values("/strain", "Image:buffer").reshape(31, 4, 20, 3)
        strains = truth.lengths.reshape(31, 20, 4) / ArmParameters().rest_length - 1
        np.testing.assert_array_equal(found, strain_colours(strains).transpose(0, 2, 1, 3))

    @pytest.mark.parametrize("block", [1, 7, 30, 31])
    def test_blocks_do_not_show(self, recorded, block, tmp_path, monkeypatch):
        monkeypatch.setattr(inspection, "_BLOCK", block)
        path = tmp_path / "blocks.rrd"
        assert run("ppo/quadratic", "--steps", 30, "--seed", 3, "--out", path).exit_code == 0
        assert Recorded(path).data() == recorded[0].data()


class TestShape:
    def test_the_skin_is_that_of_the_joints(self, recorded):
        recording, truth = recorded
        found = recording.values("/world/arm/skin", "Mesh3D:vertex_positions")
        expected = [mesh.skin(joints).reshape(-1, 3) for joints in truth.joints]
        np.testing.assert_array_equal(found, np.array(expected, dtype=np.float32))

    def test_the_springs_join_the_joints(self, recorded):
        recording, truth = recorded
        found = recording.values("/world/arm/springs", "LineStrips3D:strips")
        expected = truth.joints.transpose(0, 2, 1, 3).astype(np.float32)
        np.testing.assert_array_equal(found, expected)

    def test_the_skin_faces_outwards(self, recorded):
        recording, truth = recorded
        still = recording.still["/world/arm/skin"]
        triangles = np.array(still["Mesh3D:triangle_indices"])
        normals = np.array(still["Mesh3D:vertex_normals"])
        vertices = mesh.skin(truth.joints[0]).reshape(-1, 3)
        assert len(vertices) == len(normals) == len(still["Mesh3D:vertex_colors"])
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
        corners = vertices[triangles]
        faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert np.all((faces * normals[triangles].sum(axis=1)).sum(axis=1) > 0)
        # Both ways along every edge, except around the base and the end of the tip.
        edges = np.concatenate([np.roll(triangles, shift, axis=1)[:, :2] for shift in range(3)])
        assert len(np.unique(edges, axis=0)) == len(edges)
        there = {tuple(edge) for edge in edges.tolist()}
        assert sum((end, begin) not in there for begin, end in there) == 2 * mesh.SIDES

    def test_attitudes_are_those_of_the_base(self, recorded):
        recording, truth = recorded
        x, y, z, w = recording.values("/world/base", "Transform3D:quaternion")[:, 0].T
        downwards = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
        sideways = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
        first, second = (truth.joints[:, 0, row] for row in (0, 1))
        radius = ArmParameters().base_radius
        # Quaternions are of single precision.
        np.testing.assert_allclose(sideways.T, first / radius, atol=1e-6)
        np.testing.assert_allclose(downwards.T, np.cross(first, second) / radius**2, atol=1e-6)

    def test_the_targets_pointer_ends_on_the_curve(self, recorded):
        recording, _ = recorded
        (curve,) = np.array(recording.still["/world/orbit"]["LineStrips3D:strips"])
        (pointer,) = np.array(recording.still["/world/target/pointer"]["Arrows3D:vectors"])
        np.testing.assert_array_equal(curve[0], curve[-1])
        x, y, z, w = recording.values("/world/target", "Transform3D:quaternion")[:, 0].T
        ends = pointer[2] * np.array(
            [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
        )
        gaps = np.linalg.norm(ends.T[:, np.newaxis] - curve, axis=2).min(axis=1)
        # Half the distance of two points of the curve.
        assert gaps.max() <= 0.51 * np.linalg.norm(np.diff(curve, axis=0), axis=1).max()

    def test_the_world_hangs_down(self, recorded):
        recording, _ = recorded
        right, back, down = 3, 6, 2
        assert recording.still["/world"]["ViewCoordinates:xyz"] == [[right, back, down]]

    def test_the_portrait(self, recorded):
        recording, truth = recorded
        for kind in ("base", "target"):
            found = recording.values(f"/portrait/plane/{kind}", "Points2D:positions")[:, 0]
            np.testing.assert_array_equal(found, getattr(truth, kind).astype(np.float32))
        trail = recording.values("/portrait/plane/trail", "LineStrips2D:strips")[:, 0]
        points = truth.base.astype(np.float32)
        np.testing.assert_array_equal(trail[:, 1], points)
        np.testing.assert_array_equal(trail[:, 0], points[[0, *range(30)]])
        # Flat views have their second axis downwards.
        assert recording.still["/portrait/plane"]["Transform3D:scale"] == [[1.0, -1.0, 1.0]]

    def test_what_the_viewer_is_to_show(self, recorded):
        views = recorded[0].views
        assert sorted(views.values()) == sorted(
            ["3D", "2D", "2D", "TextDocument", "TextLog"] + 9 * ["TimeSeries"]
        )
        assert views["Arm"] == "3D"
        assert views["Base: θ to the right, φ upwards"] == "2D"


class TestCourse:
    @pytest.mark.parametrize(
        "name", ["ppo/quadratic", "readout_pinv/van_der_pol", "hold/lissajous", "clock/quadratic"]
    )
    @pytest.mark.parametrize(
        "disturbed", [{}, {"push": 12.0}, {"noise": 2e-5}, {"push": 8.0, "noise": 1e-5}]
    )
    def test_logging_changes_nothing(self, name, disturbed, tmp_path):
        path = tmp_path / "course.rrd"
        options = [part for key, size in disturbed.items() for part in (f"--{key}", size)]
        result = run(name, "--steps", 130, "--seed", 7, "--out", path, *options)
        assert result.exit_code == 0, result.output
        kinds = {"push": lambda size: Push.after_a_second(size, 0.01), "noise": Noise}
        disturbances = {key: kinds[key](size) for key, size in disturbed.items()}
        expected = roll(find_actor(name, None), 7, 130, keep_lengths=True, **disturbances)
        recording = Recorded(path)
        rewards = recording.scalars("/reward/reward")
        np.testing.assert_array_equal(rewards, expected.rewards[:, 0])
        np.testing.assert_array_equal(
            recording.scalars("/error/tracking")[1:], expected.errors[:, 0]
        )
        for axis, angle in enumerate(("theta", "phi")):
            base = recording.scalars(f"/angles/{angle}/base")[1:]
            np.testing.assert_array_equal(base, expected.angles[:, 0, axis])
        for spring in range(4):
            found = recording.scalars(f"/springs/{spring + 1}")[:-1]
            np.testing.assert_array_equal(found, expected.lengths[:, 0, spring::4])

    def test_the_same_call_records_the_same(self, tmp_path):
        options = ("readout_ridge/quadratic", "--steps", 120, "--push", 10, "--noise", 1e-5)
        kept = []
        for name in ("first.rrd", "second.rrd"):
            result = run(*options, "--out", tmp_path / name)
            assert result.exit_code == 0, result.output
            kept.append(Recorded(tmp_path / name).data())
        assert kept[0] == kept[1]

    def test_another_body(self, tmp_path):
        body = ArmParameters(compartments=10, arm_density=1400.0)
        body.to_json(tmp_path / "body.json")
        path = tmp_path / "other.rrd"
        result = run(
            "hold/lissajous", "--steps", 10, "--arm", tmp_path / "body.json", "--out", path
        )
        assert result.exit_code == 0, result.output
        recording = Recorded(path)
        assert recording.scalars("/springs/4").shape == (11, 10)
        assert recording.values("/world/arm/skin", "Mesh3D:vertex_positions").shape[1:] == (
            14 * mesh.SIDES,
            3,
        )
        about = recording.still["/about"]["TextDocument:text"][0]
        for row in ("| compartments | 10 |", "| arm_density | 1400.0 |", "| target | lissajous |"):
            assert row in about


def record(path, change=None, *, steps=20, name="hold/quadratic", **settings):
    """Record an episode in an environment whose steps `change(step, result)` alters."""
    actor = find_actor(name, None)
    env = actor.make_env(steps)
    episode = Episode(actor.policy, env, seed=0, steps=steps, **settings)

    class Changed:
        unwrapped = env.unwrapped

        def step(self, action):
            result = list(env.step(action))
            change(episode.steps_made + 1, result)
            return tuple(result)

    if change is not None:
        episode._env = Changed()
    with inspection.recording_file(path) as recording:
        log = inspection.EpisodeLog(recording, episode, "title", **settings)
        while not episode.ended:
            episode.step()
            log.step()
        log.finish()
    return episode, Recorded(path)


class TestEvents:
    def test_push_and_noise_are_told(self, tmp_path):
        episode, recording = record(tmp_path / "e.rrd", steps=150, push=12.0, noise=2e-5)
        texts = [text.as_py()[0] for text in recording.rows["/events"]["TextLog:text"]]
        steps = recording.steps("/events").tolist()
        levels = [level.as_py()[0] for level in recording.rows["/events"]["TextLog:level"]]
        assert list(zip(steps, levels, texts, strict=True)) == [
            (0, "INFO", "title begins on the orbit"),
            (0, "WARN", "the agent sees the lengths with noise of ±2e-05 m"),
            (100, "WARN", "somebody pushes the base by 12°"),
            (120, "INFO", "the push ends"),
            (150, "INFO", episode.report()),
        ]
        command = np.hypot(
            *(recording.scalars(f"/angles/{name}/command") for name in ("theta", "phi"))
        )
        pushed = (np.arange(1, 151) > 100) & (np.arange(1, 151) <= 120)
        # The action is of single precision.
        np.testing.assert_allclose(command, np.where(pushed, 12.0, 0.0), atol=1e-5)
        about = recording.still["/about"]["TextDocument:text"][0]
        assert "| push [degrees] | 12.0 |" in about
        assert "| noise [m] | 2e-05 |" in about

    def test_an_arm_that_leaves_its_domain(self, tmp_path):
        def fail(step, result):
            if step == 12:
                result[2] = True
                result[4] = result[4] | {"failure": "height of compartment 1 is 0"}

        episode, recording = record(tmp_path / "e.rrd", fail)
        assert episode.steps_made == 12
        assert recording.steps("/springs/1").tolist() == list(range(13))
        assert recording.steps("/reward/reward").tolist() == list(range(1, 13))
        texts = [text.as_py()[0] for text in recording.rows["/events"]["TextLog:text"]]
        assert texts[1] == "the arm left its domain: height of compartment 1 is 0"
        assert recording.rows["/events"]["TextLog:level"][1].as_py() == ["ERROR"]
        assert recording.steps("/events").tolist() == [0, 12, 12]

    def test_what_is_not_a_number_is_left_out(self, tmp_path):
        def spoil(step, result):
            if step == 5:
                result[4] = result[4] | {"tracking_error": np.nan}
            if step == 6:
                result[4] = result[4] | {"base_angles": np.array([np.nan, 1.0])}
            if step == 7:
                result[0] = np.where(np.arange(80) == 3, np.inf, result[0])
            if step == 8:
                result[4] = result[4] | {"reward_tracking": -np.inf}

        _, recording = record(tmp_path / "e.rrd", spoil, steps=12)

        def missing(path):
            return sorted({*range(13)} - {*recording.steps(path).tolist()})

        assert missing("/error/tracking") == [5]
        assert missing("/error/orbit") == [6]
        for path in ("/angles/theta/base", "/angles/phi/base", "/world/base", *FLAT[::2]):
            assert missing(path) == [6]
        for path in ("/springs/1", "/springs/4", "/world/arm/skin", "/strain"):
            assert missing(path) == [7]
        assert missing("/reward/tracking") == [0, 8]
        assert missing("/reward/reward") == [0]
        trail = recording.values("/portrait/plane/trail", "LineStrips2D:strips")[:, 0]
        np.testing.assert_array_equal(trail[1:, 0], trail[:-1, 1])
        for path, stream in recording.rows.items():
            for name in stream:
                if ":" in name and not name.startswith("TextLog"):
                    assert np.isfinite(recording.values(path, name).astype(float)).all()

    def test_nothing_is_printed(self, tmp_path, capfd):
        record(tmp_path / "e.rrd")
        assert capfd.readouterr() == ("", "")


class TestFiles:
    def test_the_name_of_a_recording(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        result = run("clock/van_der_pol", "--steps", 20, "--seed", 4)
        assert result.exit_code == 0, result.output
        (path,) = tmp_path.rglob("*.rrd")
        assert path.relative_to(tmp_path).as_posix() == "out/inspect/clock-van_der_pol-4.rrd"
        size = f"{path.stat().st_size / 1e6:.2f} MB"
        report, wrote, look = result.stdout.splitlines()
        assert report.startswith("seed 4: return 20.0 of 20, error 0.000°")
        assert wrote == f"Wrote out/inspect/clock-van_der_pol-4.rrd, {size}."
        assert look == "Look at it: rerun out/inspect/clock-van_der_pol-4.rrd"

    def test_a_file_of_an_agent_gives_its_name(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        file = tmp_path / "mine.json"
        find_actor("readout_ridge/quadratic", None).policy.save(file)
        result = run(file, "--steps", 10)
        assert result.exit_code == 0, result.output
        assert (tmp_path / "out/inspect/mine-quadratic-0.rrd").exists()

    def test_an_interrupted_run_leaves_nothing(self, tmp_path, monkeypatch):
        kept = tmp_path / "kept.rrd"
        kept.write_bytes(b"of yesterday")
        step = Episode.step

        def interrupted(self):
            if self.steps_made == 150:
                raise KeyboardInterrupt
            step(self)

        monkeypatch.setattr(Episode, "step", interrupted)
        for path in (kept, tmp_path / "new.rrd"):
            result = run("hold/quadratic", "--out", path)
            assert result.exit_code == 130
            assert "Stopped; no recording was written." in result.stderr
        assert [file.name for file in tmp_path.iterdir()] == ["kept.rrd"]
        assert kept.read_bytes() == b"of yesterday"

    def test_a_full_disk_is_told_and_leaves_nothing(self, tmp_path):
        resource = pytest.importorskip("resource")

        def small_disk():
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))

        path = tmp_path / "large.rrd"
        result = subprocess.run(
            [sys.executable, "-c", MAIN, "hold/quadratic", "--out", path],
            capture_output=True,
            text=True,
            check=False,
            preexec_fn=small_disk,
        )
        assert result.returncode == 1, result.stderr
        assert f"cannot write {path}: not all of it could be written." in result.stderr
        assert "Traceback" not in result.stderr
        assert list(tmp_path.iterdir()) == []

    def test_logging_may_be_switched_off(self, tmp_path, monkeypatch):
        monkeypatch.setenv("RERUN", "off")
        result = run("hold/quadratic", "--out", tmp_path / "e.rrd")
        assert result.exit_code == 1
        assert "switched off by the environment variable RERUN=off" in result.stderr
        assert list(tmp_path.iterdir()) == []


class TestOptions:
    @pytest.mark.parametrize(
        ("option", "value", "allowed"),
        [
            ("--steps", "9", "between 10 and 1,000,000"),
            ("--seed", "-1", "between 0 and 2,147,483,647"),
            ("--push", "-3", "between 0 and 360 degrees"),
            ("--push", "nan", "between 0 and 360 degrees"),
            ("--noise", "0.5", "between 0 and 0.01 metres"),
            ("--arm", "no-such-file.json", "cannot read no-such-file.json"),
            ("--out", "recording.mp4", "does not end in .rrd"),
        ],
    )
    def test_a_bad_option_is_named(self, option, value, allowed, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        result = run("hold/quadratic", option, value)
        assert result.exit_code == 2
        for part in (option, value, allowed):
            assert part in result.stderr
        assert "Traceback" not in result.output
        assert list(tmp_path.rglob("*.rrd")) == []

    @pytest.mark.parametrize("name", ["no-such-agent.npz", "nobody/quadratic", "hold/nowhere"])
    def test_a_missing_agent_is_named(self, name, tmp_path):
        result = run(name, "--out", tmp_path / "e.rrd")
        assert result.exit_code == 2
        assert name.split("/")[0] in result.stderr

    @pytest.mark.parametrize(
        "options",
        [("--spawn", "--serve"), ("--spawn", "--out", "e.rrd"), ("--serve", "--out", "e.rrd")],
    )
    def test_one_place_for_the_recording(self, options, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        result = run("hold/quadratic", *options)
        assert result.exit_code == 2
        assert "choose one of --out, --spawn and --serve" in result.stderr

    def test_the_extra_is_named(self, tmp_path, monkeypatch):
        for name in [name for name in sys.modules if name.split(".")[0] == "rerun"]:
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.setitem(sys.modules, "rerun", None)
        monkeypatch.delitem(sys.modules, "octoarm_agents.inspection")
        monkeypatch.delattr("octoarm_agents.inspection")
        result = run("hold/quadratic", "--out", tmp_path / "e.rrd")
        assert result.exit_code == 1
        assert 'pip install "octoarm-agents[inspect]"' in result.stderr
        assert list(tmp_path.iterdir()) == []

    def test_the_help_says_where_it_goes(self):
        result = run("--help")
        assert result.exit_code == 0
        for part in ("--spawn", "--serve", "out/inspect/AGENT-TARGET-SEED.rrd", "rerun FILE.rrd"):
            assert part in result.stdout


MAIN = (
    "import typer\nfrom octoarm_agents.cli.inspect import inspect\n"
    "app = typer.Typer(pretty_exceptions_enable=False)\napp.command()(inspect)\napp()"
)


class TestViewers:
    def test_no_display(self, monkeypatch):
        monkeypatch.setattr(command, "_listens", lambda port: False)
        monkeypatch.setattr(command.sys, "platform", "linux")
        for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
            monkeypatch.delenv(name, raising=False)
        result = run("hold/quadratic", "--steps", 10, "--spawn")
        assert result.exit_code == 1
        assert "there is no display for the viewer's window. Leave --spawn out" in result.stderr
        assert "Traceback" not in result.output

    @pytest.mark.parametrize("found", [True, False])
    def test_a_viewer_that_does_not_open(self, found, monkeypatch):
        def spawn(**_):
            if not found:
                raise RuntimeError("Failed to find Rerun Viewer executable in PATH.\n\nInstall it")

        monkeypatch.setattr(rr, "spawn", spawn)
        monkeypatch.setattr(command, "_listens", lambda port: False)
        monkeypatch.setenv("DISPLAY", ":99")
        result = run("hold/quadratic", "--steps", 10, "--spawn")
        assert result.exit_code == 1
        reason = "" if found else ": Failed to find Rerun Viewer executable in PATH"
        assert f"cannot record: the viewer did not open{reason}. Leave" in result.stderr

    def test_a_viewer_that_is_open_is_used(self, monkeypatch):
        """A server without a window stands for the viewer."""
        port = command._free_port(0)
        receiver = rr.RecordingStream("receiver")
        receiver.set_sinks(rr.GrpcServerSink(bind_ip="127.0.0.1", port=port))
        monkeypatch.setattr(command, "_VIEWER_PORT", port)
        result = run("hold/quadratic", "--steps", 40, "--spawn")
        receiver.disconnect()
        assert result.exit_code == 0, result.output
        assert "Wrote" not in result.stdout
        assert result.stdout.startswith("seed 0: return")

    def test_in_a_browser(self):
        process = subprocess.Popen(
            [sys.executable, "-u", "-c", MAIN, "hold/quadratic", "--steps", "40", "--serve"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            report, look, end = (process.stdout.readline() for _ in range(3))
            assert report.startswith("seed 0: return")
            assert end == "Ctrl-C ends it.\n"
            address = urllib.parse.urlparse(look.split(": ", 1)[1].strip())
            connection = HTTPConnection("127.0.0.1", address.port, timeout=60)
            connection.request("GET", "/")
            assert b"Rerun" in connection.getresponse().read()
            connection.close()
            (source,) = urllib.parse.parse_qs(address.query)["url"]
            assert source.startswith("rerun+http://127.0.0.1:")
            assert command._listens(urllib.parse.urlparse(source).port)
            process.send_signal(signal.SIGINT)
            rest, errors = process.communicate(timeout=60)
        finally:
            process.kill()
        assert process.returncode == 0, errors
        assert rest == "Stopped.\n"
        assert "Traceback" not in errors
