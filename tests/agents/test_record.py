"""`octoarm record`: what a player finds in a film is what the arm did, when it did it."""

import os
import re
import signal
import stat
import subprocess
import sys
import time
from contextlib import contextmanager
from fractions import Fraction
from types import SimpleNamespace

import imageio_ffmpeg
import numpy as np
import pytest
from episodes import SMALL, full_disk, interrupt_at, make_episode, play, write_headstand
from octoarm_agents.cli import record as command
from octoarm_agents.reservoir import train_policy
from octoarm_agents.viewing import film
from PIL import Image

from octoarm_env import ArmParameters
from octoarm_env.rendering import CAMERAS, Camera

# An ffmpeg that waits for frames must not wait for long.
pytestmark = pytest.mark.timeout(120)

SIZE = (320, 240)
"""With figures, which tell apart steps between which the arm hardly moves."""
SIDES = ("--width", SIZE[0], "--height", SIZE[1])
NEAR = {".mp4": 3.5, ".gif": 1.5}
"""Mean difference of a frame from what was drawn, in levels of 255. An MP4 has one colour for four
pixels: of the thin coloured lines that costs 1.9 of the 2.5 that were measured, the encoder's
quality the rest. A GIF has 256 colours, the others are mixed of dots: 0.9. The next step of the arm
is 1 further away, another camera or body 5 and more."""

only_posix = pytest.mark.skipif(os.name != "posix", reason="signals, scripts and limits of POSIX")


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


@pytest.fixture
def record(octoarm):
    """Run the command, which has nothing to complain of; the lines that it prints."""

    def run(*options):
        result = octoarm("record", *options)
        assert result.exit_code == 0, result.output
        assert result.stderr == ""
        return result.stdout.splitlines()

    return run


def draw_all(name, *, size=SIZE, camera=CAMERAS["perspective"], overlay=True, **settings):
    """What a renderer draws of every step, and the episode at its end."""
    episode = make_episode(name, **settings)
    renderer = episode.renderer(size, camera, overlay=overlay)
    frames = [renderer.frame(episode.joints, episode.history)]
    while not episode.ended:
        episode.step()
        frames.append(renderer.frame(episode.joints, episode.history))
    return np.array(frames), episode


@pytest.fixture(scope="module")
def drawn():
    return draw_all("clock/quadratic", steps=20, seed=3)


@pytest.fixture
def started_processes(monkeypatch):
    """The processes that films start, in a list."""
    started = []

    class Process(subprocess.Popen):
        def __init__(self, *arguments, **settings):
            super().__init__(*arguments, **settings)
            started.append(self)

    monkeypatch.setattr(film.subprocess, "Popen", Process)
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
        assert list(film.frame_steps(steps, period, fps, speed)) == expected

    @pytest.mark.parametrize("period", ["0.01", "0.03", "0.005"])
    @pytest.mark.parametrize("speed", ["0.01", "0.1", "0.3", "1", "7", "100"])
    def test_a_frame_shows_the_step_of_its_time(self, period, speed):
        """Compared with exact fractions; the last frame is the last that the episode reaches."""
        for fps in ("1", "24", "25", "29.97", "30", "60", "240"):
            shown = list(film.frame_steps(123, *(float(each) for each in (period, fps, speed))))
            forward = Fraction(speed) / Fraction(fps) / Fraction(period)
            assert shown == [int(k * forward) for k in range(int(123 / forward) + 1)]


def write(path, frames, fps=25.0):
    return film.write_film(path, iter(frames), frames[0].shape[1::-1], fps)


BLACK = np.zeros((48, 64, 3), np.uint8)


class TestFilm:
    def test_a_film_is_what_was_added(self, tmp_path):
        """Patches of one colour: nothing is lost but the colours' rounding, by 2 levels."""
        colours = np.random.default_rng(0).integers(0, 256, (3, 3, 4, 3), dtype=np.uint8)
        frames = colours.repeat(16, axis=1).repeat(16, axis=2)
        assert write(tmp_path / "a.mp4", frames, 20.0) == 3
        found = read_mp4(tmp_path / "a.mp4")
        assert found.frames.shape == frames.shape
        inner = np.s_[:, 8::16, 8::16]
        assert np.abs(found.frames[inner].astype(int) - frames[inner]).max() <= 4
        assert np.abs(found.frames[inner].astype(int) - frames[inner]).mean() <= 2
        assert found.times == pytest.approx([0.0, 0.05, 0.1])

    def test_every_player_can_show_it(self, tmp_path):
        """H.264 with colours that are named, and the table of contents before the pictures."""
        path = tmp_path / "a.mp4"
        write(path, [BLACK])
        found = read_mp4(path)
        assert len(found.frames) == 1
        assert found.kind.startswith("h264")
        assert "yuv420p(tv, bt709" in found.kind
        content = path.read_bytes()
        assert 0 < content.index(b"moov") < content.index(b"mdat")

    def test_frames_that_are_alike_keep_their_time(self, tmp_path):
        for name in ("a.mp4", "a.gif"):
            write(tmp_path / name, [BLACK + 100] * 12, 10.0)
        assert read_gif(tmp_path / "a.gif").durations == [100] * 12
        assert read_mp4(tmp_path / "a.mp4").times == pytest.approx(np.arange(12) / 10)

    @pytest.mark.parametrize(
        ("fps", "durations"), [(50, {20}), (25, {40}), (12.5, {80}), (30, {30, 40}), (24, {40, 50})]
    )
    def test_a_gif_takes_its_time(self, tmp_path, fps, durations):
        """In hundredths of a second, which need not be those of a frame, but are those of all."""
        path = tmp_path / "a.gif"
        write(path, [np.full((16, 16, 3), level, np.uint8) for level in range(0, 240, 4)], fps)
        found = read_gif(path)
        assert set(found.durations) == durations
        assert sum(found.durations) == pytest.approx(60e3 / fps, abs=10.0)
        assert found.loop == 0  # again and again

    @pytest.mark.parametrize(
        ("name", "size", "fps", "frames", "reason"),
        [
            ("a.mp4", (65, 48), 50.0, 1, "size = 65×48: H.264 needs an even"),
            ("a.mp4", (64, 47), 50.0, 1, "size = 64×47: H.264 needs an even"),
            ("a.gif", (64, 48), 60.0, 1, "fps = 60 is too fast for a .gif, at most 50"),
            # All frames are kept by ffmpeg, 4 bytes a pixel: together at most 2 GB.
            ("a.gif", (640, 480), 25.0, 1628, "1,628 frames of 640×480 .* at most 1,627: choose"),
            ("a.GIF", (4096, 4096), 25.0, 30, "at most 29: choose .mp4, fewer steps"),
        ],
    )
    def test_what_cannot_be_a_film_is_refused(self, name, size, fps, frames, reason, tmp_path):
        with pytest.raises(ValueError, match=reason):
            film.check_film(tmp_path / name, size, fps, frames)

    def test_what_can_be_a_film_is_not(self, tmp_path):
        film.check_film(tmp_path / "a.gif", (641, 479), 50.0, 1600)
        film.check_film(tmp_path / "a.mp4", (640, 480), 240.0, 1_000_000)

    # A broken pipe of others is not taken for the encoder's, which would be waited for in vain.
    @pytest.mark.parametrize("error", [ZeroDivisionError, BrokenPipeError, KeyboardInterrupt])
    def test_an_error_in_between_leaves_neither_file_nor_encoder(
        self, error, tmp_path, started_processes
    ):
        def spoilt():
            yield BLACK
            assert started_processes[0].poll() is None
            if os.name == "posix":  # a terminal's Ctrl-C is not for it
                assert os.getpgid(started_processes[0].pid) != os.getpgrp()
            raise error

        with pytest.raises(error):
            film.write_film(tmp_path / "a.mp4", spoilt(), (64, 48), 25.0)
        assert started_processes[0].returncode is not None
        assert list(tmp_path.iterdir()) == []


class TestFrames:
    def test_an_mp4_shows_every_second_step(self, record, drawn, tmp_path):
        frames, episode = drawn
        path = tmp_path / "film.mp4"
        lines = record("clock/quadratic", "--steps", 20, "--seed", 3, "--out", path, *SIDES)
        found = check_frames(path, frames, range(0, 21, 2))
        assert found.fps == 50
        assert found.times == pytest.approx(np.arange(11) / 50)
        size = f"{path.stat().st_size / 1e6:.2f} MB"
        assert lines == [episode.report(), "11 frames, 0.22 s", f"Wrote {path}, {size}."]
        assert lines[0].startswith("seed 3: return 20.0 of 20, error 0.000°")

    def test_a_gif_shows_every_fourth_step(self, record, drawn, tmp_path):
        path = tmp_path / "film.gif"
        lines = record("clock/quadratic", "--steps", 20, "--seed", 3, "--out", path, *SIDES)
        found = check_frames(path, drawn[0], range(0, 21, 4))
        assert (found.durations, found.loop) == ([40] * 6, 0)
        assert lines[1] == "6 frames, 0.24 s"

    def test_options_of_the_film_and_of_the_picture(self, record, tmp_path):
        camera = Camera(azimuth=90.0, elevation=80.0, zoom=1.5, exaggeration=3.0)
        frames, _ = draw_all(
            "clock/lissajous", steps=10, camera=camera, overlay=False, size=(200, 90)
        )
        path = tmp_path / "film.mp4"
        record(
            *("clock/lissajous", "--steps", 10, "--camera", "top", "--zoom", 1.5, "--out", path),
            *("--exaggeration", 3, "--no-overlay", "--width", 200, "--height", 90),
            *("--fps", 12.5, "--speed", 0.4),
        )
        found = check_frames(path, frames, [0, 3, 6, 9])
        assert found.fps == 12.5
        assert found.times == pytest.approx(np.arange(4) / 12.5, abs=1e-4)

    @pytest.mark.parametrize(
        ("options", "arguments"),
        [
            ((), {}),
            (("--camera", "side", "--exaggeration", 4), {"camera": CAMERAS["side"]}),
            (("--width", 301, "--height", 217), {"size": (301, 217)}),
            (("--width", 64, "--height", 1000, "--no-overlay"), {"size": (64, 1000)}),
        ],
    )
    def test_a_png_of_the_end_loses_nothing(self, record, options, arguments, tmp_path):
        path = tmp_path / "end.png"
        if "--exaggeration" in options:
            arguments = {"camera": Camera(azimuth=180.0, elevation=4.0, exaggeration=4.0)}
        arguments |= {"overlay": "--no-overlay" not in options}
        record("clock/lissajous", "--steps", 10, "--out", path, *SIDES, *options)
        frames, _ = draw_all("clock/lissajous", steps=10, **arguments)
        assert np.array_equal(read_png(path), frames[-1])

    @pytest.mark.parametrize("kind", [".mp4", ".gif", ".png"])
    def test_the_same_call_gives_the_same_file(self, record, kind, tmp_path):
        paths = [tmp_path / name / f"film{kind}" for name in ("one", "other")]
        for path in paths:
            record("ppo/quadratic", "--steps", 10, "--noise", 1e-5, *SMALL, "--out", path)
        first, second = (path.read_bytes() for path in paths)
        assert len(first) > 1000
        assert first == second
        record("ppo/quadratic", "--steps", 10, "--noise", 2e-5, *SMALL, "--out", paths[1])
        assert paths[1].read_bytes() != first

    def test_capital_letters_will_do(self, record, tmp_path):
        for name in ("film.Gif", "film.PNG"):
            record("hold/quadratic", "--out", tmp_path / name, "--steps", 10, *SMALL)
            assert (tmp_path / name).stat().st_size


class Steps:
    """Draws nothing but which step an episode is at."""

    def frame(self, joints, history):
        return history.steps


class TestCourse:
    def test_filming_does_not_touch_it_by_a_bit(self, tmp_path):
        """Some steps are after the last frame, none is left out."""
        settings = {"push": 5.0, "noise": 1e-5, "steps": 125, "seed": 2}
        filmed, pictured, plain = (make_episode("ppo/quadratic", **settings) for _ in range(3))
        made = []
        filmed.progress = lambda: made.append(1)
        frames = film.film_frames(filmed, Steps(), fps=7.0, speed=1.0)
        assert list(frames) == list(film.frame_steps(125, 0.01, 7.0, 1.0))
        film.picture_end(pictured, pictured.renderer((64, 48), Camera()), tmp_path / "end.png")
        play(plain)
        for episode in (filmed, pictured):
            assert episode.steps_made == 125
            for name in ("rewards", "angles", "actions"):
                found = getattr(episode.rollout, name)
                assert np.array_equal(found, getattr(plain.rollout, name))
            assert episode.envs._core.save() == plain.envs._core.save()
        assert len(made) == 125

    def test_the_time_is_that_of_the_control_period(self, tmp_path):
        policy = tmp_path / "slow.npz"
        train_policy({"control_period": 0.02}, steps=200).save(policy)
        episode = make_episode(policy, steps=12)
        assert list(film.film_frames(episode, Steps(), fps=50.0, speed=1.0)) == list(range(13))

    def test_an_arm_that_leaves_its_domain_ends_the_film(self, record, tmp_path):
        arm = write_headstand(tmp_path)
        episode = make_episode("clock/quadratic", steps=300, arm=arm)
        shown = list(film.film_frames(episode, Steps(), fps=50.0, speed=8.0))
        end = episode.steps_made
        assert 16 < end < 300
        # The last frame says so, though it is for a step that was never made.
        assert shown == [*range(0, end, 16), end]
        lines = record(
            *("clock/quadratic", "--steps", 300, "--arm", arm, "--speed", 8, *SMALL),
            *("--out", tmp_path / "film.mp4"),
        )
        assert lines[0] == episode.report()
        assert f"left its domain after {end * 0.01:.2f} s" in lines[0]
        assert lines[1].startswith(f"{len(shown)} frames, ")

    def test_another_body(self, octoarm, record, tmp_path):
        body, path = tmp_path / "body.json", tmp_path / "end.png"
        ArmParameters(compartments=7).to_json(body)
        lines = record("clock/quadratic", "--arm", body, "--steps", 10, "--out", path, *SIDES)
        frames, episode = draw_all("clock/quadratic", arm=body, steps=10)
        assert lines[0] == episode.report()
        assert np.array_equal(read_png(path), frames[-1])
        result = octoarm("record", "ppo/quadratic", "--arm", body, "--out", path)
        assert result.exit_code == 2
        assert "has 7 compartments, the agent is for a body with 20" in result.stderr


KINDS = (".mp4", ".gif", ".png", ".rrd")


class TestFiles:
    @pytest.fixture
    def kept(self, tmp_path):
        """Names of files: one that is new, and one of which there is an older one."""
        folder = tmp_path / "films"
        folder.mkdir()

        def names(kind):
            older = folder / f"older{kind}"
            older.write_bytes(b"of yesterday")
            return older, folder / f"new{kind}"

        yield names
        (older,) = folder.iterdir()
        assert older.stem == "older"
        assert older.read_bytes() == b"of yesterday"

    @pytest.mark.parametrize("kind", KINDS)
    @pytest.mark.parametrize("step", [0, 15])
    def test_an_interrupted_one_leaves_nothing(self, octoarm, kind, step, kept, monkeypatch):
        interrupt_at(monkeypatch, step)
        for path in kept(kind):
            result = octoarm("record", "hold/quadratic", "--steps", 20, *SMALL, "--out", path)
            assert result.exit_code == 130
            assert result.stderr == "Stopped; nothing was written.\n"
            assert result.stdout == ""

    @only_posix
    def test_an_interruption_while_ffmpeg_ends_ends_it(
        self, octoarm, kept, started_processes, tmp_path, monkeypatch
    ):
        set_ffmpeg(monkeypatch, tmp_path, "cat > /dev/null; exec sleep 60")
        wait, waits = film.subprocess.Popen.wait, []

        def interrupted(self, timeout=None):
            waits.append(self)
            if waits.count(self) == 1:
                raise KeyboardInterrupt
            return wait(self, timeout)

        monkeypatch.setattr(film.subprocess.Popen, "wait", interrupted)
        for path in kept(".gif"):
            result = octoarm("record", "hold/quadratic", "--steps", 10, *SMALL, "--out", path)
            assert result.exit_code == 130
        assert [process.returncode for process in started_processes] == [-signal.SIGKILL] * 2

    @only_posix
    @pytest.mark.parametrize(
        ("name", "hidden"), [("SIGINT", 0), pytest.param("SIGKILL", 1, marks=pytest.mark.long)]
    )
    def test_signals(self, name, hidden, tmp_path):
        """Ctrl-C of a terminal leaves nothing, SIGKILL a hidden file, neither touches a film."""
        path = tmp_path / "film.mp4"
        path.write_bytes(b"of yesterday")
        main = "from octoarm_agents.cli import main; main()"
        options = ("hold/quadratic", "--steps", 100_000, *SMALL, "--out", path)
        process = subprocess.Popen(
            [sys.executable, "-c", main, "record", *(str(each) for each in options)],
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        try:
            while not list(tmp_path.glob(".film-*")) and process.poll() is None:
                time.sleep(0.02)
            # As a terminal does: to the command and what it has started.
            os.killpg(process.pid, getattr(signal, name))
            errors = process.communicate(timeout=60)[1]
        finally:
            process.kill()
        if name == "SIGINT":
            assert process.returncode == 130
            assert errors == b"Stopped; nothing was written.\n"
        assert path.read_bytes() == b"of yesterday"
        assert len(list(tmp_path.glob(".film-*"))) == hidden
        assert len(list(tmp_path.iterdir())) == 1 + hidden

    @only_posix
    @pytest.mark.parametrize("kind", [".mp4", ".gif"])
    def test_a_full_disk_is_told_and_leaves_nothing(
        self, octoarm, kind, kept, tmp_path, monkeypatch
    ):
        """A file that may not grow beyond 8 blocks; a GIF is then cut off where it was full."""
        script = f'trap "" XFSZ\nulimit -f 8\nexec {imageio_ffmpeg.get_ffmpeg_exe()} "$@"'
        set_ffmpeg(monkeypatch, tmp_path, script)
        for path in kept(kind):
            result = octoarm("record", "clock/quadratic", "--steps", 50, *SMALL, "--out", path)
            assert result.exit_code == 1
            assert result.stderr.startswith(f"cannot write {path}: ffmpeg: ")
            assert "File too large" in result.stderr
            assert result.stderr.count("\n") == 1

    @only_posix
    @pytest.mark.parametrize(
        ("kind", "size", "reason"),
        [
            (".png", 4096, "[Errno 27] File too large"),
            (".rrd", 100_000, "[Errno 27] File too large"),
        ],
    )
    def test_a_full_disk_and_other_files(self, octoarm, kept, kind, size, reason):
        for path in kept(kind):
            with full_disk(size):
                result = octoarm("record", "clock/quadratic", "--steps", 20, *SMALL, "--out", path)
            assert result.exit_code == 1
            assert result.stderr == f"cannot write {path}: {reason}.\n"

    @only_posix
    @pytest.mark.parametrize(
        ("script", "reason"),
        [
            ("exit 1", "ffmpeg: ended with status 1"),
            ("cat > /dev/null; exit 3", "ffmpeg: ended with status 3"),
            ("echo '[mov @ 0x5f] It is late.' >&2; head -c 99 > /dev/null", "ffmpeg: It is late"),
            ("exit 0", "ffmpeg: ended with status 0"),
            ("kill -9 $$", "ffmpeg: ended with status -9"),
        ],
    )
    def test_an_ffmpeg_that_fails(self, script, reason, tmp_path, kept, monkeypatch):
        set_ffmpeg(monkeypatch, tmp_path, script)
        for path in kept(".gif"):
            with pytest.raises(OSError, match=f"^{reason}$"):
                write(path, [BLACK] * 50)

    def test_no_ffmpeg(self, octoarm, kept, monkeypatch):
        monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "no-such-ffmpeg")
        for path in kept(".mp4"):
            with pytest.raises(OSError, match="no-such-ffmpeg"):
                write(path, [BLACK])

        def find():
            raise RuntimeError("No ffmpeg exe could be found")

        monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", find)
        result = octoarm("record", "hold/quadratic", "--steps", 10, *SMALL, "--out", path)
        assert result.exit_code == 1
        assert result.stderr == f"cannot write {path}: No ffmpeg exe could be found.\n"

    @pytest.mark.parametrize("kind", KINDS)
    def test_it_is_a_file_like_others(self, record, kind, tmp_path, monkeypatch):
        """An older one is replaced, folders are made, names may be odd, and all may read it."""
        path = tmp_path / "new" / f"%03d a:b ü{kind}"
        path.parent.mkdir()
        path.write_bytes(b"of yesterday")
        record("hold/quadratic", "--steps", 10, *SMALL, "--out", path)
        assert path.read_bytes() != b"of yesterday"
        plain = tmp_path / "plain"
        plain.touch()
        assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)
        monkeypatch.chdir(tmp_path / "new")
        last = record("hold/quadratic", "--steps", 10, *SMALL, f"--out=deep/er/-v{kind}")[-1]
        assert last.startswith(f"Wrote deep/er/-v{kind}, ")
        files = [file.relative_to(tmp_path) for file in tmp_path.rglob("*") if file.is_file()]
        assert len(files) == 3

    @pytest.mark.skipif(sys.platform != "linux", reason="/proc takes no files, even of root")
    @pytest.mark.parametrize("kind", KINDS)
    def test_a_folder_that_takes_no_files(self, octoarm, kind):
        result = octoarm(
            "record", "hold/quadratic", "--steps", 10, *SMALL, "--out", f"/proc/film{kind}"
        )
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


@pytest.mark.parametrize("kind", KINDS)
def test_those_who_wait_see_every_step(record, kind, tmp_path, monkeypatch):
    made = []

    @contextmanager
    def bar(total, description, unit):
        assert total == 12
        yield SimpleNamespace(update=lambda: made.append(1))

    monkeypatch.setattr(command, "progress_bar", bar)
    record("hold/quadratic", "--steps", 12, *SMALL, "--out", tmp_path / f"film{kind}")
    assert len(made) == 12
