"""Recordings for the Rerun viewer: what its own reader finds in them is what the arm did."""

import sys
import urllib.parse
from http.client import HTTPConnection
from types import SimpleNamespace

import numpy as np
import pytest
import rerun as rr
from episodes import SMALL, make_episode, play, write_headstand
from octoarm_agents.cli import watch as command
from octoarm_agents.common.orbit import orbit_distance
from octoarm_agents.viewing import rerun_streams, rerun_viewers

from octoarm_env import ArmParameters
from octoarm_env.rendering import mesh
from octoarm_env.rendering.colours import strain_colours

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


def step_independently(actions, seed):
    """What the environment gives for these actions: lists of a row for each moment or step."""
    episode = make_episode("hold/quadratic", steps=len(actions), seed=seed)
    envs, lengths, infos = episode.envs, episode.lengths, episode.infos
    seen = SimpleNamespace(lengths=[], joints=[], base=[], target=[], error=[])
    steps = SimpleNamespace(reward=[], tracking=[], action_change=[], command=[])

    def look():
        seen.lengths.append(lengths[0])
        seen.joints.append(envs.get_attr("arm_joints")[0])
        seen.base.append(infos["base_angles"][0])
        seen.target.append(infos["target"][0])
        seen.error.append(infos["tracking_error"][0])

    look()
    for action in actions.astype(np.float32):
        lengths, rewards, _, _, infos = envs.step(action[np.newaxis])
        look()
        steps.reward.append(rewards[0])
        steps.tracking.append(infos["reward_tracking"][0])
        steps.action_change.append(infos["reward_action_change"][0])
        steps.command.append(action.astype(float) * episode.action_range)
    everything = vars(seen) | vars(steps)
    return SimpleNamespace(
        **{name: np.array(rows) for name, rows in everything.items()}, orbit=episode.target.points
    )


def log(path, name, **settings):
    """Record an episode: itself at its end, and what is read back."""
    episode = make_episode(name, **settings)
    with rerun_streams.recording_file(path) as recording:
        rerun_streams.log_episode(recording, episode)
    return episode, Recorded(path)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Thirty steps of a network, and the environment stepped by itself."""
    path = tmp_path_factory.mktemp("rerun") / "ppo.rrd"
    episode, recording = log(path, "ppo/quadratic", steps=30, seed=3)
    return recording, step_independently(episode.rollout.actions[:, 0], 3)


class TestStreams:
    def test_every_stream_is_there_and_documented(self, recorded):
        recording, _ = recorded
        assert set(recording.rows) == {*SCALARS, *OF_STEPS, *SHAPES, *FLAT, "/events"}
        assert recording.application == "octoarm"
        about = recording.still["/about"]["TextDocument:text"][0]
        named = " ".join(rerun_streams.STREAMS)
        assert all(f"`{path}`" in about for path in rerun_streams.STREAMS)
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

    @pytest.mark.parametrize("block", [7, 31])
    def test_blocks_do_not_show(self, recorded, block, tmp_path, monkeypatch):
        monkeypatch.setattr(rerun_streams, "_BLOCK", block)
        _, again = log(tmp_path / "blocks.rrd", "ppo/quadratic", steps=30, seed=3)
        assert again.data() == recorded[0].data()


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
    def test_logging_changes_nothing_and_the_same_is_recorded_again(self, tmp_path):
        settings = {"steps": 130, "seed": 7, "push": 8.0, "noise": 1e-5}
        plain = play(make_episode("readout_ridge/van_der_pol", **settings))
        kept = []
        for name in ("first.rrd", "second.rrd"):
            episode, recording = log(tmp_path / name, "readout_ridge/van_der_pol", **settings)
            for part in ("rewards", "errors", "angles", "actions"):
                found = getattr(episode.rollout, part)
                np.testing.assert_array_equal(found, getattr(plain.rollout, part))
            kept.append(recording.data())
        assert kept[0] == kept[1]
        rewards, errors = plain.rollout.rewards[:, 0], plain.rollout.errors[:, 0]
        np.testing.assert_array_equal(recording.scalars("/reward/reward"), rewards)
        np.testing.assert_array_equal(recording.scalars("/error/tracking")[1:], errors)

    def test_another_body(self, octoarm, tmp_path):
        body, path = tmp_path / "body.json", tmp_path / "other.rrd"
        ArmParameters(compartments=10, arm_density=1400.0).to_json(body)
        options = ("--steps", 10, "--arm", body, "--out", path)
        result = octoarm("record", "hold/lissajous", *options)
        assert result.exit_code == 0, result.output
        recording = Recorded(path)
        assert recording.scalars("/springs/4").shape == (11, 10)
        vertices = recording.values("/world/arm/skin", "Mesh3D:vertex_positions")
        assert vertices.shape[1:] == (14 * mesh.SIDES, 3)
        about = recording.still["/about"]["TextDocument:text"][0]
        for row in ("| compartments | 10 |", "| arm_density | 1400.0 |", "| target | lissajous |"):
            assert row in about


class TestEvents:
    def test_push_and_noise_are_told(self, tmp_path, capfd):
        episode, recording = log(
            tmp_path / "e.rrd", "hold/quadratic", steps=125, push=12.0, noise=2e-5
        )
        assert capfd.readouterr() == ("", "")
        texts = [text.as_py()[0] for text in recording.rows["/events"]["TextLog:text"]]
        steps = recording.steps("/events").tolist()
        levels = [level.as_py()[0] for level in recording.rows["/events"]["TextLog:level"]]
        assert list(zip(steps, levels, texts, strict=True)) == [
            (0, "INFO", "hold/quadratic, seed 0 begins on the orbit"),
            (0, "WARN", "the agent sees the lengths with noise of ±2e-05 m"),
            (100, "WARN", "somebody pushes the base by 12°"),
            (120, "INFO", "the push ends"),
            (125, "INFO", episode.report()),
        ]
        command = np.hypot(
            *(recording.scalars(f"/angles/{name}/command") for name in ("theta", "phi"))
        )
        pushed = (np.arange(1, 126) > 100) & (np.arange(1, 126) <= 120)
        # The action is of single precision.
        np.testing.assert_allclose(command, np.where(pushed, 12.0, 0.0), atol=1e-5)
        about = recording.still["/about"]["TextDocument:text"][0]
        assert "| push [degrees] | 12.0 |" in about
        assert "| noise [m] | 2e-05 |" in about

    def test_an_arm_that_leaves_its_domain(self, tmp_path):
        """All that is recorded up to then are numbers."""
        arm = write_headstand(tmp_path)
        episode, recording = log(tmp_path / "e.rrd", "clock/quadratic", steps=300, arm=arm)
        end = episode.steps_made
        assert end < 300
        assert recording.steps("/springs/1").tolist() == list(range(end + 1))
        assert recording.steps("/reward/reward").tolist() == list(range(1, end + 1))
        texts = [text.as_py()[0] for text in recording.rows["/events"]["TextLog:text"]]
        assert texts[1].startswith("the arm left its domain: ")
        assert recording.rows["/events"]["TextLog:level"][1].as_py() == ["ERROR"]
        assert recording.steps("/events").tolist() == [0, end, end]
        for path, stream in recording.rows.items():
            for name in stream:
                if ":" in name and not name.startswith("TextLog"):
                    assert np.isfinite(recording.values(path, name).astype(float)).all()


def test_logging_may_be_switched_off(octoarm, tmp_path, monkeypatch):
    monkeypatch.setenv("RERUN", "off")
    path = tmp_path / "e.rrd"
    for options in (("record", "--out", path), ("watch", "--view", "rerun")):
        result = octoarm(options[0], "hold/quadratic", "--steps", 10, *SMALL, *options[1:])
        assert result.exit_code == 1
        assert "switched off by the environment variable RERUN=off" in result.stderr
        assert "Traceback" not in result.output
    assert list(tmp_path.iterdir()) == []


class TestViewers:
    @pytest.fixture
    def watch(self, octoarm):
        def run(view):
            return octoarm("watch", "hold/quadratic", "--steps", 20, "--view", view)

        return run

    def test_no_display(self, watch, monkeypatch):
        monkeypatch.setattr(rerun_viewers, "_listens", lambda port: False)
        monkeypatch.setattr(rerun_viewers.sys, "platform", "linux")
        for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
            monkeypatch.delenv(name, raising=False)
        result = watch("rerun")
        assert result.exit_code == 1
        assert "there is no display for the viewer's window. octoarm record" in result.stderr
        assert "Traceback" not in result.output

    @pytest.mark.parametrize("found", [True, False])
    def test_a_viewer_that_does_not_open(self, found, watch, monkeypatch):
        def spawn(**_):
            if not found:
                raise RuntimeError("Failed to find Rerun Viewer executable in PATH.\n\nInstall it")

        monkeypatch.setattr(rr, "spawn", spawn)
        monkeypatch.setattr(rerun_viewers, "_listens", lambda port: False)
        monkeypatch.setenv("DISPLAY", ":99")
        result = watch("rerun")
        assert result.exit_code == 1
        reason = "" if found else ": Failed to find Rerun Viewer executable in PATH"
        assert f"cannot show it: the viewer did not open{reason}. octoarm record" in result.stderr

    def test_a_viewer_that_is_open_is_used(self, watch, monkeypatch):
        """A server without a window stands for the viewer."""
        port = rerun_viewers._free_port(0)
        receiver = rr.RecordingStream("receiver")
        receiver.set_sinks(rr.GrpcServerSink(bind_ip="127.0.0.1", port=port))
        monkeypatch.setattr(rerun_viewers, "_VIEWER_PORT", port)
        result = watch("rerun")
        receiver.disconnect()
        assert result.exit_code == 0, result.output
        assert result.stdout.startswith("seed 0: return")

    def test_in_a_browser(self, watch, monkeypatch):
        """Page and data are there while the command waits for Ctrl-C."""
        addresses, pages = [], []
        show = rerun_viewers.recording_in_browser

        def noted(**settings):
            recording, address = show(**settings)
            addresses.append(address)
            return recording, address

        def look(_):
            address = urllib.parse.urlparse(addresses[0])
            connection = HTTPConnection("127.0.0.1", address.port, timeout=60)
            connection.request("GET", "/")
            pages.append(connection.getresponse().read())
            connection.close()
            (source,) = urllib.parse.parse_qs(address.query)["url"]
            assert source.startswith("rerun+http://127.0.0.1:")
            assert rerun_viewers._listens(urllib.parse.urlparse(source).port)
            raise KeyboardInterrupt

        monkeypatch.setattr(rerun_viewers, "recording_in_browser", noted)
        monkeypatch.setattr(command.time, "sleep", look)
        result = watch("browser")
        assert result.exit_code == 0, result.output
        report, where, end, stopped = result.stdout.splitlines()
        assert report.startswith("seed 0: return")
        assert addresses[0] in where
        assert b"Rerun" in pages[0]
        assert (end, stopped) == ("Ctrl-C ends it.", "Stopped.")

    def test_one_episode(self, octoarm):
        result = octoarm("watch", "hold/quadratic", "--view", "browser", "--episodes", 2)
        assert result.exit_code == 2
        assert "'--episodes': --view browser shows one" in result.stderr


@pytest.mark.parametrize(
    "options",
    [("record", "--out", "a.rrd"), ("watch", "--view", "rerun")],
)
def test_the_extra_is_named(octoarm, options, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in [name for name in sys.modules if name.split(".")[0] == "rerun"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rerun", None)
    for name in ("rerun_streams", "rerun_viewers", "rerun_layout"):
        monkeypatch.delitem(sys.modules, f"octoarm_agents.viewing.{name}", raising=False)
    result = octoarm(options[0], "hold/quadratic", "--steps", 10, *options[1:])
    assert result.exit_code == 1
    assert 'pip install "octoarm-agents[rerun]"' in result.stderr
    assert list(tmp_path.iterdir()) == []
