"""`octoarm watch` in the terminal, and that what is shown is what an evaluation would measure."""

import io
import itertools
import os
import re
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest
from episodes import interrupt_at, make_episode, play, write_headstand
from octoarm_agents.cli import app
from octoarm_agents.cli.policy_names import find_policy
from octoarm_agents.policies import Lstm, Network, Policy, load_policy
from octoarm_agents.policies.evaluation import evaluate_policy
from octoarm_agents.policies.rollout import Noise, Push
from octoarm_agents.reservoir import train_policy
from octoarm_agents.viewing.terminal import UPPER_HALF, _Pace, _Picture, _show_live, half_blocks
from rich.console import Console
from typer.testing import CliRunner

from octoarm_env import ArmParameters
from octoarm_env.rendering import Camera

SIZES = [
    (160, 50),
    (100, 30),
    (80, 24),
    (40, 12),
    (36, 9),
    (35, 40),
    (20, 8),
    (12, 6),
    (5, 3),
    (1, 1),
]


def make_recurrent():
    """A network with memory and random weights, lively enough to move the base about."""
    random = np.random.default_rng(5)
    settings = {
        "target": "quadratic",
        "amplitude": 90.0,
        "control_period": 0.01,
        "actuator": "direct",
        "action_range": 117.0,
    }

    def draw(*shape):
        return random.normal(0.0, 0.4, shape).astype(np.float32)

    network = Network(
        mean=np.full(80, 0.02),
        scale=np.full(80, 500.0),
        clip=10.0,
        layers=((draw(2, 16), draw(2)),),
        activation="tanh",
        output="tanh",
        memory=Lstm(draw(64, 80), draw(64, 16), draw(64)),
    )
    return Policy(network, "random", ArmParameters(), settings)


@pytest.fixture(autouse=True)
def no_display(monkeypatch):
    """The shows are to be in the terminal, also where a window could be opened."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(scope="module")
def agents(tmp_path_factory):
    """Files of a readout and of a network with memory."""
    folder = tmp_path_factory.mktemp("agents")
    train_policy(steps=1000).save(folder / "readout.npz")
    make_recurrent().save(folder / "recurrent.npz")
    return {"readout": folder / "readout.npz", "recurrent": folder / "recurrent.npz"}


@pytest.fixture
def run(octoarm, agents):
    """Run the command on the readout: `run("--steps", 50)`."""
    return lambda *options: octoarm("watch", agents["readout"], *options)


def shown(episode, width, height):
    """The lines of a frame as a console of this size prints it."""
    console = Console(width=width, height=height, color_system="truecolor", force_terminal=True)
    with console.capture() as capture:
        console.print(_Picture(episode, Camera()).frame(width, height, "1×"))
    return capture.get().splitlines()


class TestPicture:
    def test_upper_and_lower_pixels_are_the_two_colours_of_a_cell(self):
        picture = np.zeros((4, 3, 3), dtype=np.uint8)
        picture[0, 1], picture[1, 1], picture[3, 2] = (255, 0, 8), (0, 160, 0), (0, 0, 80)
        cells = [segment for segment in half_blocks(picture).segments if segment.text != "\n"]
        assert [segment.text for segment in cells] == [UPPER_HALF] * 6
        colours = [
            (segment.style.color.triplet, segment.style.bgcolor.triplet) for segment in cells
        ]
        # Colours that differ by less than 8 are one.
        assert colours[1] == ((248, 0, 8), (0, 160, 0))
        assert colours[5] == ((0, 0, 0), (0, 0, 80))
        assert colours[0] == colours[2] == colours[3] == ((0, 0, 0), (0, 0, 0))

    def test_it_never_exceeds_its_room(self, agents):
        episode = make_episode(agents["readout"], steps=200, push=15.0)
        for _ in range(119):
            episode.step()
        for width, height in SIZES:
            lines = shown(episode, width, height)
            plain = [re.sub(r"\x1b\[[\d;]*m", "", line) for line in lines]
            assert 1 <= len(plain) <= height
            assert max(len(line) for line in plain) <= width
            drawn = width >= 16 and height >= 9
            assert (len(plain) == min(height, 50)) == (drawn or height == 1)
            assert any(UPPER_HALF in line for line in plain) == drawn
            assert "PUSHED" in plain[-1] or width < 80

    def test_the_arm_is_in_it_and_moves(self, agents):
        episode = make_episode(agents["readout"])
        first = shown(episode, 80, 24)
        assert len(set(first[:-1])) > 5
        play(episode)
        assert shown(episode, 80, 24)[:-1] != first[:-1]


class TestEpisode:
    @pytest.mark.parametrize("agent", ["readout", "recurrent", "hold/lissajous", "clock/lissajous"])
    @pytest.mark.parametrize("disturbed", [{}, {"push": 12.0}, {"push": 8.0, "noise": 1e-5}])
    def test_it_is_the_evaluation(self, agents, agent, disturbed):
        named = find_policy(str(agents.get(agent, agent)), None)
        episode = play(make_episode(named.name, seed=7, steps=140, **disturbed))
        kinds = {"push": Push, "noise": Noise}
        disturbances = {name: kinds[name](size) for name, size in disturbed.items()}
        expected = evaluate_policy(
            named.policy, named, episodes=1, steps=140, seed=7, **disturbances
        )
        expected.pop("returns")
        assert episode.figures() == expected
        assert episode.history.total == pytest.approx(expected["return"])
        assert episode.history.time == pytest.approx(1.4)
        words = [f"seed 7: return {expected['return']:.1f} of 140"]
        words.append(f"error {expected['tracking_error']:.3f}°")
        for name, key in (("orbit distance", "orbit_distance"), ("period", "period")):
            words.append(f"{name} {'-' if expected[key] is None else f'{expected[key]:.4f}'}")
        assert episode.report() == ", ".join(words)

    def test_memory_is_carried_and_emptied(self, agents):
        """The state given back is handed in again; the episode starts once."""
        inner, seen = load_policy(agents["recurrent"]), []

        class Spy:
            def predict(self, observation, state=None, episode_start=None):
                action, next_state = inner.predict(observation, state, episode_start)
                seen.append((state, next_state, episode_start.tolist()))
                return action, next_state

        play(make_episode(agents["recurrent"], steps=20, policy=Spy()))
        assert seen[0][0] is None
        assert all(now[0] is before[1] for before, now in itertools.pairwise(seen))
        assert [starts for *_, starts in seen] == [[True]] + [[False]] * 19

    def test_push_and_noise_lower_the_return(self, agents):
        returns = [
            play(make_episode(agents["readout"], steps=200, **disturbed)).history.total
            for disturbed in ({}, {"push": 15.0}, {"noise": 1e-4})
        ]
        assert returns[0] > max(returns[1:]) + 5

    @pytest.mark.parametrize("period", [0.01, 0.02])
    def test_the_push_is_timed_in_seconds_and_shown_while_it_lasts(self, period, tmp_path):
        train_policy({"control_period": period}, steps=200).save(tmp_path / "a.npz")
        episode = make_episode(tmp_path / "a.npz", steps=round(1.4 / period), push=5.0)
        told = []
        while not episode.ended:
            assert episode.disturbances in ((), ("pushed",))
            told += [episode.steps_made * period] * bool(episode.disturbances)
            episode.step()
        assert told == pytest.approx(np.arange(1.0, 1.2 - 1e-9, period))

    def test_an_arm_that_leaves_its_domain_ends_the_episode(self, tmp_path):
        arm = write_headstand(tmp_path)
        episode = play(make_episode("clock/quadratic", steps=300, arm=arm))
        assert episode.steps_made < 300
        assert episode.figures()["survival"] == 0
        seconds = f"{episode.steps_made / 100:.2f} s"
        assert f"left its domain after {seconds}: " in episode.report()
        assert "LEFT ITS DOMAIN" in shown(episode, 100, 24)[-1]


class TestCommand:
    def test_a_pipe_gets_the_figures(self, run, agents, monkeypatch):
        """Also where colours are forced."""
        monkeypatch.setenv("FORCE_COLOR", "1")
        result = run("--episodes", 2, "--seed", 3, "--steps", 60, "--noise", 1e-5)
        assert result.exit_code == 0, result.output
        assert "\x1b" not in result.stdout
        assert result.stdout.splitlines() == [
            play(make_episode(agents["readout"], steps=60, seed=seed, noise=1e-5)).report()
            for seed in (3, 4)
        ]

    def test_another_body(self, run, agents, tmp_path):
        body = tmp_path / "body.json"
        ArmParameters(arm_density=1060.0).to_json(body)
        result = run("--arm", body, "--steps", 60)
        assert result.exit_code == 0, result.output
        episode = play(make_episode(agents["readout"], steps=60, arm=body))
        assert result.stdout == f"{episode.report()}\n"

    def test_an_encoding_without_half_blocks_is_named(self):
        result = CliRunner(charset="ascii").invoke(app, ["watch", "hold/quadratic"])
        assert result.exit_code == 1
        assert "PYTHONIOENCODING=utf-8" in result.stderr


class TestPace:
    @pytest.fixture
    def clock(self, monkeypatch):
        """A clock that runs only while one sleeps."""

        class Clock:
            now = 100.0

            def monotonic(self):
                return self.now

            def sleep(self, seconds):
                self.now += seconds

        clock = Clock()
        monkeypatch.setattr("octoarm_agents.viewing.terminal.time", clock)
        return clock

    def test_steps_take_their_time(self, clock):
        pace = _Pace(2.0, 0.01)
        for _ in range(400):
            pace.wait()
        assert clock.now == pytest.approx(102.0)
        assert str(pace) == "2×"

    def test_what_cannot_be_reached_is_said(self, clock):
        pace = _Pace(10.0, 0.01)
        for _ in range(200):
            clock.now += 0.01
            pace.wait()
        assert str(pace) == "1× of 10×"

    def test_after_a_stop_it_does_not_hurry(self, clock):
        pace = _Pace(1.0, 0.01)
        pace.wait()
        clock.now += 60
        pace.wait()
        begin = clock.now
        for _ in range(100):
            pace.wait()
        assert clock.now - begin == pytest.approx(1.0)


class TestTerminal:
    @pytest.mark.parametrize("interrupted", [False, True])
    def test_it_is_drawn_live(self, agents, interrupted, monkeypatch, capsys):
        if interrupted:
            interrupt_at(monkeypatch, 25)
        written = io.StringIO()
        console = Console(
            file=written, width=80, height=24, force_terminal=True, color_system="truecolor"
        )
        _show_live(console, iter([make_episode(agents["readout"])]), Camera(), 100.0)
        shown, after = written.getvalue().split("\x1b[?1049l")
        assert "\x1b[?1049h" in shown
        # However busy the machine is, the last moment is drawn.
        assert shown.count(UPPER_HALF) >= (0 if interrupted else 80 * 23)
        assert after.count(UPPER_HALF) >= 80 * 20
        assert ("0.25 of 0.30 s" if interrupted else "0.30 of 0.30 s") in after
        report = capsys.readouterr().out
        assert report.startswith("Stopped." if interrupted else "seed 0: return")
        assert "\x1b[?25h" in written.getvalue()

    def test_ctrl_c_of_a_terminal(self):
        pty = pytest.importorskip("pty")
        ours, theirs = pty.openpty()
        code = "from octoarm_agents.cli import main; main()"
        process = subprocess.Popen(
            [sys.executable, "-c", code, "watch", "hold/quadratic", "--steps", "100000"],
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            env=os.environ | {"TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24"},
        )
        os.close(theirs)
        # A program that hangs must not hang the tests.
        timer = threading.Timer(60.0, process.kill)
        timer.start()
        written, interrupted = b"", False
        try:
            while True:
                try:
                    part = os.read(ours, 65536)
                except OSError:  # how Linux says that nobody writes any more
                    part = b""
                if not part:
                    break
                written += part
                if UPPER_HALF.encode() in written and not interrupted:
                    process.send_signal(signal.SIGINT)
                    interrupted = True
            status = process.wait()
        finally:
            timer.cancel()
            os.close(ours)
        assert status == 0, written
        for part in (b"\x1b[?1049l", b"\x1b[?25h", b"Stopped."):
            assert part in written
        assert b"Traceback" not in written
