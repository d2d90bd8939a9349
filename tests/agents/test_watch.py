"""`octoarm watch`: the terminal, and that what is shown is what an evaluation would measure."""

import itertools
import os
import re
import signal
import subprocess
import sys
import threading

import gymnasium as gym
import numpy as np
import pytest
import typer
from octoarm_agents.cli.pictures import make_renderer
from octoarm_agents.cli.watch import watch
from octoarm_agents.cli.watch_terminal import UPPER_HALF, _Pace, _Show, half_blocks
from octoarm_agents.policies import Lstm, Network, NetworkPolicy, load_policy
from octoarm_agents.policies.episode import Episode
from octoarm_agents.policies.evaluation import evaluate_policy
from octoarm_agents.policies.rollout import Noise, Push
from octoarm_agents.reservoir import train_policy
from rich.console import Console
from typer.testing import CliRunner

from octoarm_env import ArmParameters

APP = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
APP.command()(watch)

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
        lstm=Lstm(draw(64, 80), draw(64, 16), draw(64)),
    )
    return NetworkPolicy(network, "random", ArmParameters(), settings)


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
def run(agents):
    """Run the command on the readout: `run("--steps", 50)`."""

    def run(*options, policy=agents["readout"], columns=100, lines=31):
        arguments = [str(each) for each in (policy, *options)]
        environment = {"COLUMNS": str(columns), "LINES": str(lines)}
        return CliRunner().invoke(APP, arguments, env=environment)

    return run


def make_episode(file, **settings):
    policy = load_policy(file)
    steps = settings.setdefault("steps", 200)
    env = gym.make("OctoArm-v0", max_episode_steps=steps, arm=policy.parameters, **policy.settings)
    return Episode(policy, env, **{"seed": 0} | settings)


def play(episode):
    while not episode.ended:
        episode.step()
    return episode


def renderer_of(episode, size):
    return make_renderer(episode, "title", size, "perspective", 1.0, 1.0, overlay=False)


def shown(frame, width, height):
    """The lines of a frame as a console of this size prints it."""
    console = Console(width=width, height=height, color_system="truecolor", force_terminal=True)
    with console.capture() as capture:
        console.print(frame)
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

    @pytest.mark.parametrize(("width", "height"), SIZES)
    def test_it_never_exceeds_its_room(self, agents, width, height):
        show = _Show(make_episode(agents["readout"], push=15.0), renderer_of)
        for _ in range(119):
            show.step()
        plain = [re.sub(r"\x1b\[[\d;]*m", "", line) for line in show_lines(show, width, height)]
        assert 1 <= len(plain) <= height
        assert max(len(line) for line in plain) <= width
        drawn = width >= 16 and height >= 9
        assert (len(plain) == min(height, 50)) == (drawn or height == 1)
        assert any(UPPER_HALF in line for line in plain) == drawn
        assert "PUSHED" in plain[-1] or width < 80

    def test_the_arm_is_in_it_and_moves(self, agents):
        show = _Show(make_episode(agents["readout"]), renderer_of)
        first = show_lines(show, 80, 24)
        assert len(set(first[:-1])) > 5
        for _ in range(30):
            show.step()
        assert show_lines(show, 80, 24)[:-1] != first[:-1]


def show_lines(show, width, height):
    return shown(show.frame(width, height, "1×"), width, height)


class TestEpisode:
    @pytest.mark.parametrize("agent", ["readout", "recurrent"])
    @pytest.mark.parametrize(
        "disturbed", [{}, {"push": 12.0}, {"noise": 2e-5}, {"push": 8.0, "noise": 1e-5}]
    )
    def test_it_is_the_evaluation(self, agents, agent, disturbed):
        file = agents[agent]
        episode = play(make_episode(file, seed=7, steps=300, **disturbed))
        kinds = {"push": Push, "noise": Noise}
        policy = load_policy(file)
        expected = evaluate_policy(
            policy,
            policy,
            episodes=1,
            steps=300,
            seed=7,
            **{name: kinds[name](size) for name, size in disturbed.items()},
        )
        expected.pop("returns")
        assert episode.figures() == expected
        assert episode.earned == pytest.approx(expected["return"])
        assert episode.time == pytest.approx(3.0)

    def test_memory_is_carried_and_emptied(self, agents):
        """The state given back is handed in again; the episode starts once."""
        episode = make_episode(agents["recurrent"], steps=20)
        inner, seen = episode._policy, []

        class Spy:
            settings = inner.settings

            def predict(self, observation, state=None, episode_start=None):
                action, next_state = inner.predict(observation, state, episode_start)
                seen.append((state, next_state, episode_start.tolist()))
                return action, next_state

        episode._policy = Spy()
        play(episode)
        assert seen[0][0] is None
        assert all(now[0] is before[1] for before, now in itertools.pairwise(seen))
        assert [starts for *_, starts in seen] == [[True]] + [[False]] * 19

    def test_a_push_lowers_the_return(self, agents):
        calm, pushed = (
            play(make_episode(agents["readout"], push=size)).figures()["return"]
            for size in (0.0, 15.0)
        )
        assert pushed < calm - 5

    def test_the_push_is_shown_while_it_lasts(self, agents):
        episode, shown = make_episode(agents["readout"], push=5.0), []
        while not episode.ended:
            if episode.disturbances:
                shown.append(episode.steps_made)
            episode.step()
        assert shown == list(range(100, 120))

    def test_the_push_is_timed_in_seconds(self):
        policy = train_policy({"control_period": 0.02}, steps=300)
        env = gym.make("OctoArm-v0", max_episode_steps=80, **policy.settings)
        episode, shown = Episode(policy, env, seed=0, steps=80, push=5.0), []
        while not episode.ended:
            if episode.disturbances:
                shown.append(episode.steps_made)
            episode.step()
        assert shown == list(range(50, 60))

    def test_an_arm_that_leaves_its_domain_ends_the_episode(self, agents):
        episode = make_episode(agents["readout"])
        inner = episode._env

        class Breaking:
            unwrapped = inner.unwrapped

            def step(self, action):
                observation, reward, _, truncated, info = inner.step(action)
                broken = episode.steps_made == 29
                more = {"failure": "height of compartment 1 is 0"} if broken else {}
                return observation, reward, broken, truncated, info | more

        episode._env = Breaking()
        play(episode)
        assert episode.steps_made == 30
        assert episode.figures()["survival"] == 0
        assert "left its domain after 0.30 s: height of compartment 1" in episode.report()
        assert "LEFT ITS DOMAIN" in show_lines(_Show(episode, renderer_of), 100, 24)[-1]


class TestCommand:
    def test_a_pipe_gets_the_figures(self, run, agents):
        result = run("--episodes", 2, "--seed", 3, "--steps", 120)
        assert result.exit_code == 0, result.output
        assert "\x1b" not in result.stdout
        assert len(result.stdout.splitlines()) == 2
        policy = load_policy(agents["readout"])
        for seed in (3, 4):
            figures = evaluate_policy(policy, policy, episodes=1, steps=120, seed=seed)
            assert (
                f"seed {seed}: return {figures['return']:.1f} of 120, "
                f"error {figures['tracking_error']:.3f}°, "
                f"orbit distance {figures['orbit_distance']:.4f}, period "
            ) in result.stdout

    def test_a_pipe_stays_a_pipe_where_colours_are_forced(self, run, monkeypatch):
        monkeypatch.setenv("FORCE_COLOR", "1")
        result = run("--steps", 20)
        assert result.exit_code == 0, result.output
        assert "\x1b[?1049h" not in result.stdout

    def test_an_agent_with_memory(self, run, agents):
        result = run("--steps", 50, policy=agents["recurrent"])
        assert result.exit_code == 0, result.output
        assert "return " in result.stdout

    def test_push_and_noise_lower_the_return(self, run):
        earned = [
            float(run(*options).stdout.rsplit("return ", 1)[1].split()[0])
            for options in ((), ("--push", 20), ("--noise", 1e-4))
        ]
        assert earned[0] > max(earned[1:]) + 5

    def test_another_body(self, run, tmp_path):
        body = tmp_path / "body.json"
        ArmParameters(arm_density=1060.0).to_json(body)
        own, other = run(), run("--arm", body)
        assert other.exit_code == 0, other.output
        assert other.stdout != own.stdout

    @pytest.mark.parametrize(
        ("option", "value", "allowed"),
        [
            ("--speed", "0", "above 0 and at most 100"),
            ("--speed", "-1", "above 0 and at most 100"),
            ("--speed", "101", "above 0 and at most 100"),
            ("--speed", "nan", "above 0 and at most 100"),
            ("--steps", "9", "between 10 and 1,000,000"),
            ("--episodes", "0", "between 1 and 4,096"),
            ("--seed", "-1", "between 0 and 2,147,483,647"),
            ("--push", "-3", "between 0 and 360 degrees"),
            ("--noise", "0.5", "between 0 and 0.01 metres"),
            ("--arm", "no-such-file.json", "cannot read no-such-file.json"),
        ],
    )
    def test_a_bad_option_is_named(self, run, option, value, allowed):
        result = run(option, value, columns=300)
        assert result.exit_code == 2
        assert option in result.stderr
        assert value in result.stderr
        assert allowed in result.stderr
        assert "Traceback" not in result.output

    @pytest.mark.parametrize(
        ("name", "reason"),
        [
            ("no-such-agent.npz", "cannot read no-such-agent.npz"),
            ("nobody/quadratic", "neither a file nor one of"),
            ("agent.txt", "neither a file nor one of"),
        ],
    )
    def test_a_missing_agent_is_named(self, run, name, reason):
        result = run(policy=name, columns=300)
        assert result.exit_code == 2
        assert name.split("/")[0] in result.stderr
        assert reason in result.stderr

    def test_a_body_that_does_not_fit_is_refused(self, run, tmp_path):
        body = tmp_path / "body.json"
        ArmParameters(compartments=10).to_json(body)
        result = run("--arm", body, columns=300)
        assert result.exit_code == 2
        assert "10 compartments" in result.stderr
        assert "20." in result.stderr

    def test_a_body_that_cannot_swing_so_is_refused(self, run, tmp_path):
        body = tmp_path / "body.json"
        ArmParameters(arm_density=20_000.0).to_json(body)
        result = run("--arm", body, columns=300)
        assert result.exit_code == 2
        assert "--arm" in result.stderr
        assert "Traceback" not in result.output

    def test_an_encoding_without_half_blocks_is_named(self, agents):
        code = "import sys, typer\nfrom octoarm_agents.cli.watch import watch\ntyper.run(watch)"
        result = subprocess.run(
            [sys.executable, "-c", code, agents["readout"], "--steps", "10"],
            capture_output=True,
            text=True,
            check=False,
            env=os.environ | {"PYTHONIOENCODING": "ascii"},
        )
        assert result.returncode == 1
        assert "PYTHONIOENCODING=utf-8" in result.stderr
        assert "Traceback" not in result.stderr


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
        monkeypatch.setattr("octoarm_agents.cli.watch_terminal.time", clock)
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


def watch_in_a_terminal(arguments, *, interrupt_at=None):
    """Run the command with a pseudo-terminal as its output; exit code and what it wrote."""
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    code = (
        "import typer\nfrom octoarm_agents.cli.watch import watch\n"
        "app = typer.Typer()\napp.command()(watch)\napp()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, *(str(each) for each in arguments)],
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
            if interrupt_at is not None and not interrupted and interrupt_at in written:
                process.send_signal(signal.SIGINT)
                interrupted = True
        # An interrupt may cut a character in two.
        return process.wait(), written.decode(errors="replace")
    finally:
        timer.cancel()
        os.close(ours)


class TestTerminal:
    def test_it_is_drawn_live(self, agents):
        status, written = watch_in_a_terminal([agents["readout"], "--steps", 100, "--speed", 2])
        assert status == 0, written
        shown, after = written.split("\x1b[?1049l")
        assert "\x1b[?1049h" in shown
        # However busy the machine is, the last moment is drawn.
        assert shown.count(UPPER_HALF) >= 80 * 23
        assert "seed 0: return" in after
        assert "1.00 of 1.00 s" in after
        assert "\x1b[?25h" in written

    def test_ctrl_c_ends_it(self, agents):
        status, written = watch_in_a_terminal(
            [agents["readout"], "--steps", 100_000], interrupt_at=UPPER_HALF.encode()
        )
        assert status == 0, written
        assert "\x1b[?1049l" in written
        assert "\x1b[?25h" in written
        assert "Stopped." in written
        assert "Traceback" not in written
