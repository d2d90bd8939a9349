"""`octoarm record`: what a player finds in a film is what the arm did, when it did it."""

import os
import re
import signal
import stat
import subprocess
import sys
import time
from fractions import Fraction
from types import SimpleNamespace

import imageio_ffmpeg
import numpy as np
import pytest
import typer
from octoarm_agents import recording
from octoarm_agents.cli import pictures
from octoarm_agents.cli.actors import find_actor
from octoarm_agents.cli.record import record
from octoarm_agents.policies import load_policy
from octoarm_agents.policies.episode import Episode
from octoarm_agents.policies.evaluation import evaluate_policy
from octoarm_agents.policies.rollout import Noise, Push
from octoarm_agents.reservoir import train_policy
from PIL import Image
from typer.testing import CliRunner

from octoarm_env import LIMIT_CYCLES, ArmParameters
from octoarm_env.rendering import CAMERAS, Camera
from octoarm_env.rendering.history import History
from octoarm_env.rendering.renderer import Renderer

# An ffmpeg that waits for frames must not wait for long.
pytestmark = pytest.mark.timeout(120)

APP = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
APP.command()(record)
MAIN = (
    "import typer\nfrom octoarm_agents.cli.record import record\n"
    "app = typer.Typer(pretty_exceptions_enable=False)\napp.command()(record)\napp()"
)
SMALL = ("--width", 160, "--height", 120)
SIZE = (320, 240)
"""With figures, which tell apart steps between which the arm hardly moves."""
NEAR = {".mp4": 3.5, ".gif": 1.5}
"""Mean difference of a frame from what was drawn, in levels of 255. An MP4 has one colour for four
pixels: of the thin coloured lines that costs 1.9 of the 2.5 that were measured, the encoder's
quality the rest. A GIF has 256 colours, the others are mixed of dots: 0.9. The next step of the arm
is 1 further away, another camera or body 5 and more."""
ALL = (".mp4", ".gif", ".png")
FILMS = (".mp4", ".gif")

only_posix = pytest.mark.skipif(os.name != "posix", reason="signals, scripts and limits of POSIX")


def run(*options):
    """Run the command: `run("clock/quadratic", "--steps", 30, "--out", path)`."""
    return CliRunner().invoke(APP, [str(each) for each in options], env={"COLUMNS": "300"})


def succeed(*options):
    """Run the command, which has nothing to complain of; the lines that it prints."""
    result = run(*options)
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    return result.stdout.splitlines()


def start(*options, **arguments):
    """The command in a process of its own, in a group of its own as in a terminal."""
    return subprocess.Popen(
        [sys.executable, "-c", MAIN, *(str(each) for each in options)],
        stdout=subprocess.PIPE,
        start_new_session=True,
        **({"stderr": subprocess.PIPE} | arguments),
    )


def ffmpeg(*arguments):
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-hide_banner", "-nostdin", *arguments]
    return subprocess.run(command, capture_output=True, check=False)


def read_mp4(path):
    """All frames of a film, when each is shown [s], and how the film calls itself."""
    ((kind, width, height, fps),) = re.findall(
        r"Video: (.*), (\d+)x(\d+).*, ([\d.]+) fps", ffmpeg("-i", path).stderr.decode()
    )
    every = ("-i", path, "-fps_mode", "passthrough")
    pixels = ffmpeg(
        *every,
        *("-vf", "scale=flags=accurate_rnd+full_chroma_int", "-pix_fmt", "rgb24"),
        *("-f", "rawvideo", "-"),
    ).stdout
    size = (int(width), int(height))
    lines = ffmpeg(*every, "-f", "framecrc", "-").stdout.decode().splitlines()
    ((base,),) = (re.findall("#tb 0: (.*)", line) for line in lines if line.startswith("#tb 0"))
    times = [int(line.split(",")[2]) * Fraction(base) for line in lines if line[0] != "#"]
    return SimpleNamespace(
        frames=np.frombuffer(pixels, np.uint8).reshape(-1, size[1], size[0], 3),
        size=size,
        times=[float(each) for each in times],
        fps=float(fps),
        kind=kind,
    )


def read_gif(path):
    """All frames of a GIF, for how long each is shown [ms], and how often all are repeated."""
    with Image.open(path) as image:
        frames, durations = [], []
        for index in range(image.n_frames):
            image.seek(index)
            frames.append(np.asarray(image.convert("RGB")))
            durations.append(image.info["duration"])
        loop = image.info["loop"]
    return SimpleNamespace(
        frames=np.array(frames), size=frames[0].shape[1::-1], durations=durations, loop=loop
    )


def read_png(path):
    with Image.open(path) as image:
        return np.asarray(image)


def draw_all(name, *, arm=None, steps=30, seed=0, every=1, size=SIZE, **arguments):
    """What a renderer draws of every step, or every so many and the last; the episode at its end.

    The arguments are the renderer's.
    """
    actor = find_actor(str(name), arm)
    episode = Episode(actor.policy, actor.make_env(steps), seed=seed, steps=steps)
    bare = episode.arm_env
    orbit, reach = bare.orbit, bare.action_range
    renderer = Renderer(episode.parameters, orbit, reach, str(name), size=size, **arguments)
    history = History(episode.period)
    history.begin(episode.info)
    frames = [renderer.frame(bare.arm_joints, history)]
    while not episode.ended:
        episode.step()
        history.add(episode.info, episode.reward)
        if episode.steps_made % every == 0 or episode.ended:
            frames.append(renderer.frame(bare.arm_joints, history))
    return np.array(frames), episode


def check_frames(path, drawn, steps):
    """Frame k looks like step `steps[k]`, and more so than like any other step."""
    film = read_mp4(path) if path.suffix == ".mp4" else read_gif(path)
    assert film.size == (drawn.shape[2], drawn.shape[1])
    assert len(film.frames) == len(steps)
    every_fourth = drawn[:, ::2, ::2].astype(np.int16)  # of the pixels, which is quicker
    for k, (frame, step) in enumerate(zip(film.frames, steps, strict=True)):
        distances = np.abs(every_fourth - frame[::2, ::2]).mean(axis=(1, 2, 3))
        assert distances.argmin() == step, f"frame {k}"
        assert distances[step] < NEAR[path.suffix], f"frame {k}"
    return film


def words(figures, *, seed, steps):
    """How figures of an evaluation are reported."""
    parts = [
        f"return {figures['return']:.1f} of {steps}",
        f"error {figures['tracking_error']:.3f}°",
    ]
    for name, key in (("orbit distance", "orbit_distance"), ("period", "period")):
        value = figures[key]
        parts.append(f"{name} {'-' if value is None else format(value, '.4f')}")
    return f"seed {seed}: {', '.join(parts)}"


@pytest.fixture(scope="module")
def headstand(tmp_path_factory):
    """A body that stands on its base, too heavy for that: it leaves its domain within 3 s."""
    path = tmp_path_factory.mktemp("bodies") / "headstand.json"
    ArmParameters(gravity=(0.0, 0.0, -70.0)).to_json(path)
    return path


@pytest.fixture
def started_processes(monkeypatch):
    """The processes that films start, in a list."""
    started = []

    class Process(subprocess.Popen):
        def __init__(self, *arguments, **settings):
            super().__init__(*arguments, **settings)
            started.append(self)

    monkeypatch.setattr(recording.subprocess, "Popen", Process)
    return started


class TestFrameSteps:
    @pytest.mark.parametrize(
        ("steps", "period", "fps", "speed", "expected"),
        [
            (10, 0.01, 50, 1.0, [0, 2, 4, 6, 8, 10]),
            (11, 0.01, 50, 1.0, [0, 2, 4, 6, 8, 10]),
            (5, 0.01, 50, 0.5, [0, 1, 2, 3, 4, 5]),
            (2, 0.01, 50, 0.25, [0, 0, 1, 1, 2]),
            (20, 0.01, 50, 4.0, [0, 8, 16]),
            (3, 0.02, 100, 1.0, [0, 0, 1, 1, 2, 2, 3]),
            (10, 0.01, 30, 1.0, [0, 3, 6, 10]),
            (10, 0.01, 50, 100.0, [0]),
        ],
    )
    def test_by_hand(self, steps, period, fps, speed, expected):
        shown = recording.frame_steps(steps, period, fps, speed)
        assert shown.tolist() == expected

    @pytest.mark.parametrize("period", ["0.01", "0.03", "0.005"])
    @pytest.mark.parametrize("fps", ["1", "24", "25", "29.97", "30", "60", "240"])
    @pytest.mark.parametrize("speed", ["0.01", "0.1", "0.3", "1", "7", "100"])
    def test_a_frame_shows_the_step_of_its_time(self, period, fps, speed):
        """Compared with exact fractions; the last frame is the last that the episode reaches."""
        steps, numbers = 123, [float(each) for each in (period, fps, speed)]
        shown = recording.frame_steps(steps, *numbers).tolist()
        forward = Fraction(speed) / Fraction(fps) / Fraction(period)
        assert shown == [int(k * forward) for k in range(int(steps / forward) + 1)]


class TestFilm:
    def test_a_film_is_what_was_added(self, tmp_path):
        """Patches of one colour: nothing is lost but the colours' rounding, by 2 levels."""
        colours = np.random.default_rng(0).integers(0, 256, (3, 3, 4, 3), dtype=np.uint8)
        frames = colours.repeat(16, axis=1).repeat(16, axis=2)
        with recording.open_film(tmp_path / "a.mp4", (64, 48), 20.0) as film:
            for frame in frames:
                film.add(frame)
        assert film.frames == 3
        found = read_mp4(tmp_path / "a.mp4")
        assert found.frames.shape == frames.shape
        inner = np.s_[:, 8::16, 8::16]
        assert np.abs(found.frames[inner].astype(int) - frames[inner]).max() <= 4
        assert np.abs(found.frames[inner].astype(int) - frames[inner]).mean() <= 2
        assert found.times == pytest.approx([0.0, 0.05, 0.1])

    def test_every_player_can_show_it(self, tmp_path):
        """H.264 with colours that are named, and the table of contents before the pictures."""
        path = tmp_path / "a.mp4"
        with recording.open_film(path, (64, 48), 50.0) as film:
            film.add(np.zeros((48, 64, 3), np.uint8))
        kind = read_mp4(path).kind
        assert kind.startswith("h264")
        assert "yuv420p(tv, bt709" in kind
        content = path.read_bytes()
        assert 0 < content.index(b"moov") < content.index(b"mdat")

    @pytest.mark.parametrize("suffix", FILMS)
    def test_frames_that_are_alike_keep_their_time(self, tmp_path, suffix):
        path = tmp_path / f"a{suffix}"
        with recording.open_film(path, (64, 48), 10.0) as film:
            for _ in range(12):
                film.add(np.full((48, 64, 3), 100, np.uint8))
        if suffix == ".gif":
            assert read_gif(path).durations == [100] * 12
        else:
            assert read_mp4(path).times == pytest.approx(np.arange(12) / 10)

    @pytest.mark.parametrize(
        ("fps", "durations"), [(50, {20}), (25, {40}), (12.5, {80}), (30, {30, 40}), (24, {40, 50})]
    )
    def test_a_gif_takes_its_time(self, tmp_path, fps, durations):
        """In hundredths of a second, which need not be those of a frame, but are those of all."""
        path = tmp_path / "a.gif"
        with recording.open_film(path, (16, 16), fps) as film:
            for level in range(0, 240, 4):
                film.add(np.full((16, 16, 3), level, np.uint8))
        found = read_gif(path)
        assert set(found.durations) == durations
        assert sum(found.durations) == pytest.approx(60e3 / fps, abs=10.0)
        assert found.loop == 0  # again and again

    def test_a_film_of_one_frame(self, tmp_path):
        for suffix, reader in ((".mp4", read_mp4), (".gif", read_gif)):
            path = tmp_path / f"a{suffix}"
            with recording.open_film(path, (64, 48), 50.0) as film:
                film.add(np.zeros((48, 64, 3), np.uint8))
            assert len(reader(path).frames) == 1

    @pytest.mark.parametrize(
        ("name", "size", "fps", "reason"),
        [
            ("a.avi", (64, 48), 50.0, "ends in .mp4 or .gif"),
            ("a", (64, 48), 50.0, "ends in .mp4 or .gif"),
            ("a.mp4", (65, 48), 50.0, "size = 65×48: H.264 needs an even"),
            ("a.mp4", (64, 47), 50.0, "size = 64×47: H.264 needs an even"),
            ("a.gif", (64, 48), 60.0, "fps = 60: a GIF shows at most 50"),
        ],
    )
    def test_what_cannot_be_a_film_is_refused(self, tmp_path, name, size, fps, reason):
        with (
            pytest.raises(ValueError, match=reason),
            recording.open_film(tmp_path / name, size, fps),
        ):
            pytest.fail("it was opened")
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize(
        "frame",
        [
            np.zeros((64, 48, 3), np.uint8),
            np.zeros((48, 64, 4), np.uint8),
            np.zeros((48, 64), np.uint8),
            np.zeros((48, 64, 3)),
        ],
    )
    def test_a_frame_of_another_kind_is_refused(self, tmp_path, frame):
        path = tmp_path / "a.gif"
        with (
            pytest.raises(ValueError, match=r"expected uint8 \(48, 64, 3\)"),
            recording.open_film(path, (64, 48), 25.0) as film,
        ):
            film.add(frame)
        assert list(tmp_path.iterdir()) == []

    def test_frames_need_not_lie_in_order(self, tmp_path):
        frame = np.arange(48 * 64 * 3, dtype=np.uint32).reshape(48, 64, 3).astype(np.uint8)
        for name, given in (("a.mp4", frame), ("b.mp4", np.asfortranarray(frame))):
            with recording.open_film(tmp_path / name, (64, 48), 25.0) as film:
                film.add(given)
        assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()

    @pytest.mark.parametrize("suffix", FILMS)
    def test_a_film_without_frames_is_none(self, tmp_path, suffix):
        with (
            pytest.raises(OSError, match="no frame was added"),
            recording.open_film(tmp_path / f"a{suffix}", (64, 48), 25.0),
        ):
            pass
        assert list(tmp_path.iterdir()) == []

    # A broken pipe of others is not taken for the encoder's, which would be waited for in vain.
    @pytest.mark.parametrize("error", [ZeroDivisionError, BrokenPipeError, KeyboardInterrupt])
    def test_an_error_in_between_leaves_neither_file_nor_encoder(
        self, error, tmp_path, started_processes
    ):
        def spoil():
            with recording.open_film(tmp_path / "a.mp4", (64, 48), 25.0) as film:
                film.add(np.zeros((48, 64, 3), np.uint8))
                assert started_processes[0].poll() is None
                if os.name == "posix":  # a terminal's Ctrl-C is not for it
                    assert os.getpgid(started_processes[0].pid) != os.getpgrp()
                raise error

        with pytest.raises(error):
            spoil()
        assert started_processes[0].returncode is not None
        assert list(tmp_path.iterdir()) == []

    def test_the_longest_gif(self):
        """All frames are kept by ffmpeg, 4 bytes a pixel: together at most 2 GB."""
        assert recording.longest_gif((640, 480)) == 1627
        assert recording.longest_gif((4096, 4096)) == 29
        assert 4 * 640 * 480 * 1627 <= 2e9 < 4 * 640 * 480 * 1628


class TestFrames:
    @pytest.mark.parametrize("target", LIMIT_CYCLES)
    def test_a_frame_is_the_step_of_its_time(self, target, tmp_path):
        drawn, episode = draw_all(f"clock/{target}", steps=40, seed=3)
        for suffix, fps in ((".mp4", 50), (".gif", 25)):
            path = tmp_path / f"film{suffix}"
            lines = succeed(
                *(f"clock/{target}", "--steps", 40, "--seed", 3, "--out", path),
                *("--width", SIZE[0], "--height", SIZE[1]),
            )
            steps = list(range(0, 41, 100 // fps))
            film = check_frames(path, drawn, steps)
            assert lines[0] == episode.report()
            assert lines[0].startswith("seed 3: return 40.0 of 40, error 0.000°")
            megabytes = path.stat().st_size / 1e6
            assert lines[1] == f"{len(steps)} frames, {len(steps) / fps:.2f} s, {megabytes:.2f} MB"
            assert lines[2:] == [f"Wrote {path}."]
            if suffix == ".mp4":
                assert film.fps == fps
                assert film.times == pytest.approx(np.arange(len(steps)) / fps)
            else:
                assert film.durations == [40] * len(steps)
                assert film.loop == 0

    @pytest.mark.parametrize(
        ("options", "steps"),
        [
            (("--fps", 20), range(0, 31, 5)),
            (("--speed", 0.25), np.repeat(range(31), 2)[:-1]),
            (("--speed", 0.4, "--fps", 12.5), [0, 3, 6, 9, 12, 16, 19, 22, 25, 28]),
            (("--speed", 5), [0, 10, 20, 30]),
            (("--speed", 100), [0]),
            (("--fps", 240, "--speed", 2.4), range(31)),
        ],
    )
    def test_fps_and_speed(self, options, steps, tmp_path):
        path = tmp_path / "film.mp4"
        drawn, episode = draw_all("clock/lissajous")
        lines = succeed(
            *("clock/lissajous", "--steps", 30, *options, "--out", path),
            *("--width", SIZE[0], "--height", SIZE[1]),
        )
        film = check_frames(path, drawn, list(steps))
        fps = dict(zip(options[::2], options[1::2], strict=True)).get("--fps", 50)
        assert film.fps == fps
        assert film.times == pytest.approx(np.arange(len(steps)) / fps, abs=1e-4)
        assert lines[0] == episode.report()

    def test_the_time_is_that_of_the_control_period(self, tmp_path):
        policy = tmp_path / "slow.npz"
        train_policy({"control_period": 0.02}, steps=300).save(policy)
        drawn, _ = draw_all(policy, steps=12)
        path = tmp_path / "film.mp4"
        succeed(policy, "--steps", 12, "--out", path, "--width", SIZE[0], "--height", SIZE[1])
        check_frames(path, drawn, list(range(13)))

    @pytest.mark.parametrize("suffix", ALL)
    def test_the_same_call_gives_the_same_file(self, suffix, tmp_path):
        paths = [tmp_path / name / f"film{suffix}" for name in ("one", "other")]
        for path in paths:
            succeed("ppo/quadratic", "--steps", 20, "--noise", 1e-5, *SMALL, "--out", path)
        first, second = (path.read_bytes() for path in paths)
        assert len(first) > 1000
        assert first == second
        succeed("ppo/quadratic", "--steps", 20, "--noise", 2e-5, *SMALL, "--out", paths[1])
        assert paths[1].read_bytes() != first

    @pytest.mark.parametrize(
        ("options", "arguments"),
        [
            ((), {}),
            (("--no-overlay",), {"overlay": False}),
            (("--zoom", 2.5), {"camera": Camera(zoom=2.5)}),
            (("--exaggeration", 4), {"camera": Camera(exaggeration=4.0)}),
            (("--width", 301, "--height", 217), {"size": (301, 217)}),
            (("--width", 64, "--height", 1000), {"size": (64, 1000)}),
            *((("--camera", name), {"camera": camera}) for name, camera in CAMERAS.items()),
            (
                ("--camera", "base", "--zoom", 0.5, "--exaggeration", 2, "--no-overlay"),
                {
                    "camera": Camera(zoom=1.5, focus=0.08, exaggeration=2.0),
                    "overlay": False,
                },
            ),
        ],
    )
    def test_options_of_the_picture(self, options, arguments, tmp_path):
        """A .png of the end loses nothing."""
        path = tmp_path / "end.png"
        size = arguments.get("size", SIZE)
        lines = succeed(
            *("clock/lissajous", "--steps", 15, "--out", path),
            *("--width", size[0], "--height", size[1], *options),
        )
        drawn, episode = draw_all("clock/lissajous", steps=15, **arguments)
        assert np.array_equal(read_png(path), drawn[-1])
        assert lines == [episode.report(), f"Wrote {path}."]

    def test_options_of_the_picture_in_a_film(self, tmp_path):
        camera = Camera(azimuth=90.0, elevation=80.0, zoom=1.5, exaggeration=3.0)
        drawn, _ = draw_all(
            "clock/lissajous", steps=10, camera=camera, overlay=False, size=(200, 90)
        )
        for suffix, steps in ((".mp4", range(0, 11, 2)), (".gif", [0, 4, 8])):
            path = tmp_path / f"film{suffix}"
            succeed(
                *("clock/lissajous", "--steps", 10, "--camera", "top", "--zoom", 1.5),
                *("--exaggeration", 3, "--no-overlay", "--width", 200, "--height", 90),
                *("--out", path),
            )
            check_frames(path, drawn, steps)

    def test_odd_sizes(self, tmp_path):
        path = tmp_path / "film.mp4"
        for size in (("--width", 161), ("--height", 121)):
            result = run("hold/quadratic", "--steps", 10, *SMALL, *size, "--out", path)
            assert result.exit_code == 2
            assert "H.264 needs an even width and height" in result.stderr
            assert not path.exists()
            succeed(
                *("hold/quadratic", "--steps", 10, *SMALL, *size),
                *("--out", path.with_suffix(".gif")),
            )


class TestCourse:
    """Filming changes nothing, and what is reported is what an evaluation gives."""

    @pytest.mark.parametrize(
        ("agent", "disturbed"),
        [
            ("readout_ridge/quadratic", {}),
            ("readout_ridge/lissajous", {"push": 15.0}),
            ("ppo/van_der_pol", {"noise": 2e-5}),
            ("ppo/quadratic", {"push": 8.0, "noise": 1e-5}),
        ],
    )
    @pytest.mark.parametrize("suffix", [".mp4", ".png"])
    def test_the_report_is_the_evaluation(self, agent, disturbed, suffix, tmp_path):
        options = [part for name, size in disturbed.items() for part in (f"--{name}", size)]
        # Some steps are after the last frame, none is left out.
        lines = succeed(
            *(agent, "--seed", 7, "--steps", 140, *options, "--fps", 3, *SMALL),
            *("--out", tmp_path / f"film{suffix}"),
        )
        policy = find_actor(agent, None).policy
        kinds = {"push": Push, "noise": Noise}
        figures = evaluate_policy(
            policy,
            policy,
            episodes=1,
            steps=140,
            seed=7,
            **{name: kinds[name](size) for name, size in disturbed.items()},
        )
        assert lines[0] == words(figures, seed=7, steps=140)

    @pytest.mark.parametrize("kind", ["clock", "hold"])
    def test_the_trivial_ones(self, kind, tmp_path):
        home = find_actor("readout_ridge/lissajous", None).policy
        lines = succeed(f"{kind}/lissajous", "--steps", 60, *SMALL, "--out", tmp_path / "film.gif")
        figures = evaluate_policy(kind, home, episodes=1, steps=60, seed=0)
        assert lines[0] == words(figures, seed=0, steps=60)

    def test_it_is_not_touched_by_a_bit(self, tmp_path):
        def make():
            actor = find_actor("ppo/quadratic", None)
            settings = {"push": 5.0, "noise": 1e-5, "steps": 125, "seed": 2}
            return Episode(actor.policy, actor.make_env(125), **settings)

        filmed, pictured, plain, made = make(), make(), make(), []
        bare = filmed.arm_env
        renderer = Renderer(filmed.parameters, bare.orbit, bare.action_range, size=(64, 48))
        with recording.open_film(tmp_path / "film.mp4", (64, 48), 7.0) as film:
            recording.film_episode(filmed, renderer, film, fps=7.0, speed=1.0, progress=made.append)
        recording.picture_end(pictured, renderer, tmp_path / "end.png")
        while not plain.ended:
            plain.step()
        for episode in (filmed, pictured):
            assert episode.steps_made == 125
            assert np.array_equal(episode._rewards, plain._rewards)
            assert np.array_equal(episode._angles, plain._angles)
            assert np.array_equal(episode._actions, plain._actions)
            assert np.array_equal(episode.lengths, plain.lengths)
            assert episode.arm_env._core.save() == plain.arm_env._core.save()
        assert sum(made) == 125
        assert film.frames == 9

    def test_an_arm_that_leaves_its_domain_ends_the_film(self, headstand, tmp_path):
        drawn, episode = draw_all("clock/quadratic", steps=300, arm=headstand, every=16)
        end = episode.steps_made
        assert 16 < end < 300
        assert end % 16  # it is not for this step that there is a frame
        options = ("clock/quadratic", "--steps", 300, "--arm", headstand)
        options += ("--width", SIZE[0], "--height", SIZE[1], "--speed", 8)
        lines = succeed(*options, "--out", tmp_path / "film.mp4")
        # The last frame says so, though it is for a step that was never made.
        check_frames(tmp_path / "film.mp4", drawn, range(len(drawn)))
        assert len(drawn) == end // 16 + 2
        assert lines[0] == episode.report()
        assert f"left its domain after {end * 0.01:.2f} s" in lines[0]
        assert lines[1].startswith(f"{len(drawn)} frames, ")
        succeed(*options, "--out", tmp_path / "end.png")
        assert np.array_equal(read_png(tmp_path / "end.png"), drawn[-1])

    def test_another_body(self, tmp_path):
        body, path = tmp_path / "body.json", tmp_path / "end.png"
        ArmParameters(arm_density=1060.0).to_json(body)
        options = ("readout_ridge/quadratic", "--steps", 30, "--out", path)
        own = succeed(*options, "--width", SIZE[0], "--height", SIZE[1])
        other = succeed(*options, "--width", SIZE[0], "--height", SIZE[1], "--arm", body)
        assert own[0] != other[0]
        drawn, episode = draw_all("readout_ridge/quadratic", arm=body)
        assert other[0] == episode.report()
        assert np.array_equal(read_png(path), drawn[-1])

    def test_another_number_of_compartments(self, tmp_path):
        body, path = tmp_path / "body.json", tmp_path / "end.png"
        ArmParameters(compartments=7).to_json(body)
        for kind in ("clock", "hold"):
            succeed(
                *(f"{kind}/quadratic", "--arm", body, "--steps", 20, "--out", path),
                *("--width", SIZE[0], "--height", SIZE[1]),
            )
            drawn, _ = draw_all(f"{kind}/quadratic", arm=body, steps=20)
            assert np.array_equal(read_png(path), drawn[-1])
            path.unlink()
        result = run("ppo/quadratic", "--arm", body, "--out", path)
        assert result.exit_code == 2
        assert "has 7 compartments, the agent is for a body with 20" in result.stderr
        assert not path.exists()

    def test_an_agent_in_a_file(self, tmp_path):
        file = tmp_path / "mine.json"
        find_actor("readout_ridge/quadratic", None).policy.save(file)
        assert load_policy(file).parameters == ArmParameters()
        lines = succeed(file, "--steps", 20, *SMALL, "--out", tmp_path / "film.gif")
        _, episode = draw_all("readout_ridge/quadratic", steps=20)
        assert lines[0] == episode.report()


class TestFiles:
    @pytest.fixture
    def kept(self, tmp_path):
        """Names of films: one that is new, and one of which there is an older film."""
        folder = tmp_path / "films"
        folder.mkdir()

        def names(suffix):
            older = folder / f"older{suffix}"
            older.write_bytes(b"of yesterday")
            return older, folder / f"new{suffix}"

        yield names
        (older,) = folder.iterdir()
        assert older.stem == "older"
        assert older.read_bytes() == b"of yesterday"

    @pytest.mark.parametrize("suffix", ALL)
    @pytest.mark.parametrize("step", [0, 1, 25])
    def test_an_interrupted_film_leaves_nothing(self, suffix, step, kept, monkeypatch):
        make_step = Episode.step

        def interrupted(self):
            if self.steps_made == step:
                raise KeyboardInterrupt
            make_step(self)

        monkeypatch.setattr(Episode, "step", interrupted)
        for path in kept(suffix):
            result = run("hold/quadratic", "--steps", 50, *SMALL, "--out", path)
            assert result.exit_code == 130
            assert result.stderr == "Stopped; no film was written.\n"
            assert result.stdout == ""

    @only_posix
    def test_an_interruption_while_ffmpeg_ends_ends_it(
        self, kept, started_processes, tmp_path, monkeypatch
    ):
        set_ffmpeg(monkeypatch, tmp_path, "cat > /dev/null; exec sleep 60")
        wait, waits = recording.subprocess.Popen.wait, []

        def interrupted(self, timeout=None):
            waits.append(self)
            if waits.count(self) == 1:
                raise KeyboardInterrupt
            return wait(self, timeout)

        monkeypatch.setattr(recording.subprocess.Popen, "wait", interrupted)
        for path in kept(".gif"):
            result = run("hold/quadratic", "--steps", 20, *SMALL, "--out", path)
            assert result.exit_code == 130
        assert [process.returncode for process in started_processes] == [-signal.SIGKILL] * 2

    @only_posix
    def test_signals(self, tmp_path):
        """Ctrl-C of a terminal leaves nothing, SIGKILL a hidden file, neither touches a film."""
        processes = {}
        for name in ("SIGINT", "SIGKILL"):
            path = tmp_path / name / "film.mp4"
            path.parent.mkdir()
            path.write_bytes(b"of yesterday")
            processes[name] = start("hold/quadratic", "--steps", 100_000, *SMALL, "--out", path)
        try:
            for name, process in processes.items():
                end = time.monotonic() + 60
                while not list((tmp_path / name).glob(".film*.mp4")) and time.monotonic() < end:
                    time.sleep(0.02)
                time.sleep(0.1)
                # As a terminal does: to the command and what it has started.
                os.killpg(process.pid, getattr(signal, name))
            errors = {
                name: process.communicate(timeout=60)[1] for name, process in processes.items()
            }
        finally:
            for process in processes.values():
                process.kill()
        assert processes["SIGINT"].returncode == 130
        assert errors["SIGINT"] == b"Stopped; no film was written.\n"
        assert processes["SIGKILL"].returncode == -signal.SIGKILL
        for name, hidden in (("SIGINT", 0), ("SIGKILL", 1)):
            files = [path.name for path in (tmp_path / name).iterdir()]
            assert (tmp_path / name / "film.mp4").read_bytes() == b"of yesterday"
            assert len([each for each in files if each.startswith(".film-")]) == hidden
            assert len(files) == 1 + hidden

    @only_posix
    @pytest.mark.parametrize("suffix", FILMS)
    def test_a_full_disk_is_told_and_leaves_nothing(self, suffix, kept, tmp_path, monkeypatch):
        """A file that may not grow beyond 8 blocks; a GIF is then cut off where it was full."""
        script = f'trap "" XFSZ\nulimit -f 8\nexec {imageio_ffmpeg.get_ffmpeg_exe()} "$@"'
        set_ffmpeg(monkeypatch, tmp_path, script)
        for path in kept(suffix):
            result = run("clock/quadratic", "--steps", 50, *SMALL, "--out", path)
            assert result.exit_code == 1
            assert result.stderr.startswith(f"cannot write {path}: ffmpeg: ")
            assert "File too large" in result.stderr
            assert result.stderr.count("\n") == 1

    @only_posix
    def test_a_full_disk_and_a_picture(self, kept):
        resource = pytest.importorskip("resource")
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        for path in kept(".png"):
            resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
            try:
                result = run("clock/quadratic", "--steps", 20, *SMALL, "--out", path)
            finally:
                resource.setrlimit(resource.RLIMIT_FSIZE, limits)
            assert result.exit_code == 1
            assert result.stderr == f"cannot write {path}: [Errno 27] File too large.\n"

    @only_posix
    @pytest.mark.parametrize("suffix", FILMS)
    @pytest.mark.parametrize(
        ("script", "reason"),
        [
            ("exit 1", "ffmpeg: ended with status 1."),
            ("cat > /dev/null; exit 3", "ffmpeg: ended with status 3."),
            ("echo '[mov @ 0x5f] It is late.' >&2; head -c 99 > /dev/null", "ffmpeg: It is late."),
            ("exit 0", "ffmpeg: ended with status 0."),
            ("kill -9 $$", "ffmpeg: ended with status -9."),
        ],
    )
    def test_an_ffmpeg_that_fails(self, suffix, script, reason, kept, tmp_path, monkeypatch):
        set_ffmpeg(monkeypatch, tmp_path, script)
        for path in kept(suffix):
            result = run("hold/quadratic", "--steps", 50, *SMALL, "--out", path)
            assert result.exit_code == 1
            assert result.stderr == f"cannot write {path}: {reason}\n"
            assert result.stdout == ""

    def test_no_ffmpeg(self, kept, monkeypatch):
        monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "no-such-ffmpeg")
        for path in kept(".mp4"):
            result = run("hold/quadratic", "--steps", 20, *SMALL, "--out", path)
            assert result.exit_code == 1
            assert result.stderr.startswith(f"cannot write {path}: ")
            assert "no-such-ffmpeg" in result.stderr

        def find():
            raise RuntimeError("No ffmpeg exe could be found")

        monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", find)
        result = run("hold/quadratic", "--steps", 20, *SMALL, "--out", path)
        assert result.exit_code == 1
        assert result.stderr == f"cannot write {path}: No ffmpeg exe could be found.\n"

    @pytest.mark.parametrize("suffix", ALL)
    def test_a_film_is_a_file_like_others(self, suffix, tmp_path):
        """An older one is replaced, folders are made, names may be odd, and all may read it."""
        path = tmp_path / "new" / f"%03d a:b ü{suffix}"
        path.parent.mkdir()
        path.write_bytes(b"of yesterday")
        succeed("hold/quadratic", "--steps", 10, *SMALL, "--out", path)
        deep = tmp_path / "newer" / "deep" / f"film{suffix}"
        succeed("hold/quadratic", "--steps", 10, *SMALL, "--out", deep)
        assert path.read_bytes() == deep.read_bytes()
        plain = tmp_path / "plain"
        plain.touch()
        assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)
        assert len(list(tmp_path.rglob("*"))) == 6

    def test_a_name_in_this_folder(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        assert succeed("hold/quadratic", "--steps", 10, *SMALL, "--out=-v.gif")[-1] == (
            "Wrote -v.gif."
        )
        assert [path.name for path in tmp_path.iterdir()] == ["-v.gif"]

    @pytest.mark.skipif(sys.platform != "linux", reason="/proc takes no files, even of root")
    @pytest.mark.parametrize("suffix", ALL)
    def test_a_folder_that_takes_no_files(self, suffix):
        result = run("hold/quadratic", "--steps", 10, *SMALL, "--out", f"/proc/film{suffix}")
        assert result.exit_code in (1, 2)
        assert "cannot write" in result.stderr
        assert "/proc" in result.stderr
        assert "Traceback" not in result.output


def set_ffmpeg(monkeypatch, folder, script):
    """Let a script stand for ffmpeg."""
    file = folder / "ffmpeg"
    file.write_text(f"#!/bin/sh\n{script}\n")
    file.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(file))


class TestOptions:
    @pytest.mark.parametrize(
        ("option", "value", "allowed"),
        [
            ("--steps", "9", "between 10 and 1,000,000"),
            ("--seed", "-1", "between 0 and 2,147,483,647"),
            ("--push", "-3", "between 0 and 360 degrees"),
            ("--noise", "0.5", "between 0 and 0.01 metres"),
            ("--arm", "no-such-file.json", "cannot read no-such-file.json"),
            ("--fps", "0.5", "between 1 and 240"),
            ("--fps", "241", "between 1 and 240"),
            ("--fps", "nan", "between 1 and 240"),
            ("--speed", "0", "between 0.01 and 100"),
            ("--speed", "-1", "between 0.01 and 100"),
            ("--speed", "inf", "between 0.01 and 100"),
            ("--width", "63", "between 64 and 4,096 pixels"),
            ("--height", "4097", "between 64 and 4,096 pixels"),
            ("--camera", "behind", "one of perspective, front, side, top, base"),
            ("--zoom", "0.1", "between 0.2 and 6"),
            ("--zoom", "nan", "between 0.2 and 6"),
            ("--exaggeration", "0.5", "between 1 and 50"),
        ],
    )
    def test_a_bad_option_is_named(self, option, value, allowed, tmp_path):
        result = run("hold/quadratic", option, value, "--out", tmp_path / "film.mp4")
        assert result.exit_code == 2
        for part in (option, value, allowed):
            assert part in result.stderr
        assert "Traceback" not in result.output
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("name", ["film", "film.avi", ".mp4", "film.mp4.part"])
    def test_another_kind_of_file(self, name, tmp_path):
        result = run("hold/quadratic", "--out", tmp_path / name)
        assert result.exit_code == 2
        assert "'--out'" in result.stderr
        assert f"{name} does not end in one of .mp4, .gif, .png" in result.stderr
        assert list(tmp_path.iterdir()) == []

    def test_capital_letters_will_do(self, tmp_path):
        for name in ("film.MP4", "film.Gif", "film.PNG"):
            succeed("hold/quadratic", "--out", tmp_path / name, "--steps", 10)
            assert (tmp_path / name).stat().st_size

    def test_cameras_are_those_of_the_library(self):
        assert tuple(CAMERAS) == pictures._CAMERAS

    def test_no_name(self):
        result = run("hold/quadratic")
        assert result.exit_code == 2
        assert "--out" in result.stderr

    def test_a_folder_in_the_way(self, tmp_path):
        (tmp_path / "film.mp4").mkdir()
        (tmp_path / "file").touch()
        for path, reason in (
            (tmp_path / "film.mp4", "is a folder, expected a file"),
            (tmp_path / "file" / "film.mp4", "cannot make folder"),
        ):
            result = run("hold/quadratic", "--out", path)
            assert result.exit_code == 2
            assert reason in result.stderr

    @pytest.mark.parametrize(
        ("options", "reason"),
        [
            (
                ("--steps", 100_000),
                "25,001 frames of 640×480 are too many for a .gif, at most 1,627",
            ),
            (("--steps", 200, *("--width", 4096, "--height", 4096)), "51 frames of 4096×4096"),
            (("--steps", 200, "--speed", 0.01), "too many for a .gif, at most 1,627"),
            (("--fps", 50.5), "50.5 is too fast for a .gif, at most 50: choose .mp4"),
        ],
    )
    def test_a_gif_too_long_or_too_fast(self, options, reason, tmp_path):
        result = run("hold/quadratic", *options, "--out", tmp_path / "film.gif")
        assert result.exit_code == 2
        assert reason in result.stderr
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize(
        ("name", "reason"),
        [
            ("no-such-agent.npz", "cannot read no-such-agent.npz"),
            ("nobody/quadratic", "neither a file nor one of"),
            ("agent.txt", "neither a file nor one of"),
            ("hold", "'hold' is neither a file nor one of"),
            ("clock/nowhere", "'clock/nowhere' is neither a file nor one of"),
            ("", "expected a file"),
        ],
    )
    def test_a_missing_agent_is_named(self, name, reason, tmp_path):
        result = run(name, "--out", tmp_path / "film.mp4")
        assert result.exit_code == 2
        assert reason in result.stderr
        assert "Traceback" not in result.output

    def test_a_body_that_cannot_swing_so_is_refused(self, tmp_path):
        body = tmp_path / "body.json"
        ArmParameters(arm_density=20_000.0).to_json(body)
        for name in ("ppo/quadratic", "clock/quadratic"):
            result = run(name, "--arm", body, "--out", tmp_path / "film.mp4")
            assert result.exit_code == 2
            assert "--arm" in result.stderr

    @pytest.mark.parametrize("suffix", FILMS)
    def test_the_extra_is_named_without_ffmpeg(self, suffix, tmp_path, monkeypatch):
        monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
        result = run("hold/quadratic", "--steps", 10, *SMALL, "--out", tmp_path / f"film{suffix}")
        assert result.exit_code == 1
        assert 'pip install "octoarm-agents[render]"' in result.stderr
        assert result.stderr.count("\n") == 1
        assert list(tmp_path.iterdir()) == []
        # A picture needs none.
        succeed("hold/quadratic", "--steps", 10, *SMALL, "--out", tmp_path / "end.png")

    @pytest.mark.parametrize("suffix", ALL)
    def test_the_extra_is_named_without_pygame(self, suffix, tmp_path, monkeypatch):
        for name in ("toolkit", "renderer", "panels", "water", "window"):
            monkeypatch.delitem(sys.modules, f"octoarm_env.rendering.{name}", raising=False)
        monkeypatch.setitem(sys.modules, "pygame", None)
        result = run("hold/quadratic", "--steps", 10, *SMALL, "--out", tmp_path / f"film{suffix}")
        assert result.exit_code == 1
        assert 'pip install "octoarm-agents[render]"' in result.stderr
        assert result.stderr.count("\n") == 1
        assert list(tmp_path.iterdir()) == []

    def test_the_help(self):
        result = run("--help")
        assert result.exit_code == 0
        for part in ("--exaggeration", ".mp4 or .gif", "clock/TARGET", "50, of a .gif 25"):
            assert part in result.stdout


@only_posix
def test_the_bar_is_for_those_who_wait(tmp_path):
    """It is drawn in the terminal, standard error; the pipe behind standard output has none."""
    pty, termios = pytest.importorskip("pty"), pytest.importorskip("termios")
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (24, 80))
    path = tmp_path / "film.mp4"
    process = start("clock/quadratic", "--steps", 100, *SMALL, "--out", path, stderr=theirs)
    os.close(theirs)
    written = b""
    try:
        while True:
            try:
                part = os.read(ours, 65536)
            except OSError:  # how Linux says that nobody writes any more
                part = b""
            if not part:
                break
            written += part
        output, _ = process.communicate(timeout=60)
    finally:
        process.kill()
        os.close(ours)
    assert process.returncode == 0
    assert b"/100" in written
    assert b"steps/s" in written
    lines = output.decode().splitlines()
    assert lines[0].startswith("seed 0: return 100.0 of 100")
    assert lines[1].startswith("51 frames, 1.02 s, ")
    assert lines[2:] == [f"Wrote {path}."]
    assert b"\r" not in output
