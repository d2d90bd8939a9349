"""`octoarm watch`: the drawing, and that what is drawn is what an evaluation would measure."""

import itertools
import os
import re
import signal
import subprocess
import sys
import threading
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import typer
from octoarm_agents.cli.watch import watch
from octoarm_agents.cli.watch_terminal import TerminalEpisode, _Pace
from octoarm_agents.policies import Lstm, Network, NetworkPolicy, load_policy, save_network
from octoarm_agents.policies.evaluation import evaluate_policy
from octoarm_agents.policies.rollout import Noise, Push
from octoarm_agents.policies.terminal import (
    LARGEST,
    Canvas,
    Moment,
    Scene,
    draw_frame,
    phase_portrait,
    round_up,
    side_view,
    strain_strip,
)
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
    train_policy(steps=1000).save(folder / "readout.json")
    save_network(folder / "recurrent.npz", make_recurrent())
    return {"readout": folder / "readout.json", "recurrent": folder / "recurrent.npz"}


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
    return TerminalEpisode("title", policy, env, **{"seed": 0} | settings)


def play(episode):
    while not episode.ended:
        episode.step()
    return episode


@pytest.fixture(scope="module")
def scene_and_moment(agents):
    """The scene of an episode, and the moment in which a push ends."""
    episode = make_episode(agents["readout"], push=15.0)
    while episode.steps_made < 119:
        episode.step()
    return episode.scene, episode.moment("1×")


def plain(lines):
    return [line.plain for line in lines]


class TestCanvas:
    @pytest.mark.parametrize(
        ("column", "row", "symbol"),
        [(index // 4, index % 4, symbol) for index, symbol in enumerate("⠁⠂⠄⡀⠈⠐⠠⢀")],
    )
    def test_each_dot_of_a_cell(self, column, row, symbol):
        canvas = Canvas(3, 2, 0, 5, 0, 7)
        canvas.points(2 + column, 4 + row, "red")
        assert plain(canvas.lines()) == ["   ", f" {symbol} "]

    def test_coordinates_of_the_data(self):
        canvas = Canvas(10, 5, -1.0, 1.0, 3.0, -3.0)
        assert canvas.cell(-1, 3) == (0, 0)
        assert canvas.cell(1, 3) == (0, 9)
        assert canvas.cell(-1, -3) == (4, 0)
        assert canvas.cell(1.2, 0) is None
        assert canvas.dot == pytest.approx((2 / 19, 6 / 19))

    def test_dots_add_up_and_a_later_style_covers(self):
        canvas = Canvas(1, 1, 0, 1, 0, 3)
        canvas.points([0, 1], [0, 3], "red")
        assert plain(canvas.lines()) == ["⢁"]
        canvas.points(0, 1, "blue")
        (line,) = canvas.lines()
        assert line.plain == "⠂"
        assert [span.style for span in line.spans] == ["blue"]

    def test_a_line_has_no_gaps(self):
        canvas = Canvas(8, 1, 0, 15, 0, 3)
        canvas.line([0, 15], [1, 1], "red")
        assert plain(canvas.lines()) == ["⠒" * 8]
        dotted = Canvas(8, 1, 0, 15, 0, 3)
        dotted.line([0, 15], [1, 1], "red", every=2)
        assert plain(dotted.lines()) == ["⠂" * 8]

    def test_what_lies_outside_is_left_out(self):
        canvas = Canvas(4, 2, 0, 7, 0, 7)
        canvas.points([-3, 9, np.nan, 2], [0, 0, 0, -5], "red")
        canvas.line([1e300, 1e300], [-1e300, 1e300], "red")
        canvas.line([np.nan], [0.0], "red")
        canvas.mark(8, 0, "x", "red")
        assert plain(canvas.lines()) == [" " * 4] * 2
        canvas.line([-1e9, 1e9], [0, 0], "red")
        assert plain(canvas.lines()) == ["⠉" * 4, " " * 4]

    def test_marks_replace_cells(self):
        canvas = Canvas(3, 1, 0, 5, 0, 3)
        canvas.mark(3, 2, "●", "red")
        canvas.points([0, 2], [0, 0], "blue")
        assert plain(canvas.lines()) == ["⠁● "]

    @pytest.mark.parametrize(
        "arguments",
        [(0, 1, 0, 1, 0, 1), (1, 0, 0, 1, 0, 1), (1, 1, 2, 2, 0, 1), (1, 1, 0, np.inf, 0, 1)],
    )
    def test_no_room_is_refused(self, arguments):
        with pytest.raises(ValueError, match="expected"):
            Canvas(*arguments)


class TestPortrait:
    def test_base_target_and_orbit_are_where_they_should_be(self, scene_and_moment):
        scene, moment = scene_and_moment
        canvas = phase_portrait(scene, moment, 50, 24)
        lines = plain(canvas.lines())
        for point, symbol in ((moment.trace[-1], "●"), (moment.target, "○")):
            row, column = canvas.cell(*point)
            assert lines[row][column] == symbol
        assert sum(line.count("●") + line.count("◉") for line in lines) == 1
        assert canvas.dot[0] == pytest.approx(canvas.dot[1])
        cells = {canvas.cell(*point) for point in scene.orbit[::20]}
        shown = [lines[row][column] != " " for row, column in cells]
        assert np.mean(shown) > 0.9

    def test_one_marker_for_both_where_they_meet(self, scene_and_moment):
        scene, moment = scene_and_moment
        met = replace(moment, target=moment.trace[-1])
        lines = plain(phase_portrait(scene, met, 50, 24).lines())
        assert sum(line.count("◉") for line in lines) == 1
        assert not any("○" in line or "●" in line for line in lines)

    def test_the_orbit_is_dotted_and_the_trace_bright(self, scene_and_moment):
        scene, moment = scene_and_moment
        begin = replace(moment, trace=moment.trace[:1])
        counts = {}
        for name, shown in (("begin", begin), ("late", moment)):
            styles = [
                str(span.style)
                for line in phase_portrait(scene, shown, 50, 24).lines()
                for span in line.spans
            ]
            counts[name] = styles.count("yellow"), styles.count("bright_cyan")
        assert counts["begin"][0] > 50
        assert counts["begin"][1] <= 1
        assert counts["late"][1] > 20

    def test_a_base_far_away_is_still_in_view(self, scene_and_moment):
        scene, moment = scene_and_moment
        away = replace(moment, trace=np.array([[0.0, 0.0], [150.0, -80.0]]))
        lines = plain(phase_portrait(scene, away, 30, 15).lines())
        assert sum(line.count("●") for line in lines) == 1


class TestArm:
    def test_base_and_arm_are_where_they_should_be(self, scene_and_moment):
        scene, moment = scene_and_moment
        canvas = side_view(scene, moment, 42, 18)
        lines = plain(canvas.lines())
        row, _ = canvas.cell(0.0, 0.0)
        assert "┳" in lines[row]
        for x, _, depth in moment.arm[2:]:
            row, column = canvas.cell(x, depth)
            assert lines[row][column] != " "

    def test_the_strip(self):
        strains = np.zeros(80)
        strains[0], strains[5], strains[79] = 0.1, -0.2, 0.05
        lines = strain_strip(strains, 0.1, 45, colour=False)
        rows = plain(lines)
        assert rows[0] == "▇▇" + "▄" * 38
        assert rows[1] == "▄▄▁▁" + "▄" * 36
        assert rows[2] == "▄" * 40
        assert rows[3] == "▄" * 38 + "▆▆"

    def test_the_colours_of_the_strip(self):
        strains = np.zeros(80)
        strains[0], strains[4], strains[8] = 1.0, -1.0, 0.0
        line = strain_strip(strains, 0.1, 20)[0]
        assert line.plain == " " * 20
        red, blue, neutral = (span.style.bgcolor.triplet for span in line.spans[:3])
        assert red.red > 200 > red.blue
        assert blue.blue > 200 > blue.red
        assert max(neutral) < 60

    def test_too_many_compartments_are_put_together(self):
        strains = np.zeros(4 * 200)
        strains[4 * 150] = -1.0
        rows = plain(strain_strip(strains, 1.0, 20, colour=False))
        assert [len(row) for row in rows] == [20] * 4
        assert rows[0] == "▄" * 15 + "▁" + "▄" * 4
        assert rows[1] == "▄" * 20

    @pytest.mark.parametrize(
        ("value", "rounded"), [(1.0, 1.0), (1.2, 1.5), (0.021, 0.03), (760.0, 1000.0), (8e-4, 1e-3)]
    )
    def test_round_up(self, value, rounded):
        assert round_up(value) == pytest.approx(rounded)


class TestFrame:
    @pytest.mark.parametrize(("width", "height"), SIZES)
    @pytest.mark.parametrize("colour", [True, False])
    def test_it_never_exceeds_its_room(self, scene_and_moment, width, height, colour):
        frame = draw_frame(*scene_and_moment, width, height, colour=colour)
        lines = frame.plain.split("\n")
        assert 1 <= len(lines) <= height
        console = Console(width=width)
        assert max(len(line) for line in lines) <= width
        assert all(line.cell_len <= width for line in frame.split("\n"))
        with console.capture() as capture:
            console.print(frame)
        # Nothing is wrapped on the way to the terminal.
        assert len(capture.get().rstrip("\n").split("\n")) == len(frame.plain.rstrip().split("\n"))

    def test_a_huge_terminal_is_not_filled(self, scene_and_moment):
        lines = draw_frame(*scene_and_moment, 500, 200).plain.split("\n")
        assert (max(len(line) for line in lines), len(lines)) == LARGEST

    @pytest.mark.parametrize(("width", "height"), [(100, 30), (80, 24)])
    def test_an_ordinary_terminal_shows_everything(self, scene_and_moment, width, height):
        scene, moment = scene_and_moment
        text = draw_frame(scene, moment, width, height, colour=False).plain
        assert len(text.split("\n")) == height
        for part in ("θ →", "φ ↑", "● base", "○ target", "depth ↓", "spring lengths", "PUSHED"):
            assert part in text
        for part in ("1.19 of 2.00 s", "of 119 (", f"{moment.error:.2f}°", "off the orbit", "1×"):
            assert part in text
        assert re.search(r"-(\d+)% ▁▂▃▄▅▆▇ \+\1%", text)

    def test_the_least_that_a_small_one_shows(self, scene_and_moment):
        text = draw_frame(*scene_and_moment, 40, 12).plain
        assert "◉" in text or ("●" in text and "○" in text)
        for part in ("┳", "time 1.19 of 2.00 s", "error", "orbit", "PUSHED"):
            assert part in text

    @pytest.mark.parametrize("size", [(0, 10), (10, 0)])
    def test_no_room_is_refused(self, scene_and_moment, size):
        with pytest.raises(ValueError, match="expected at least 1"):
            draw_frame(*scene_and_moment, *size)

    @pytest.mark.parametrize("compartments", [1, 7, 200])
    @pytest.mark.parametrize(("width", "height"), SIZES)
    def test_other_bodies(self, scene_and_moment, compartments, width, height):
        moment = scene_and_moment[1]
        depths = np.linspace(0, 0.02 * compartments, compartments + 1)
        arm = np.stack((np.zeros_like(depths), np.zeros_like(depths), depths), axis=1)
        other = replace(
            moment,
            arm=arm,
            sway=arm[:, [0, 0]].T,
            reach=0.0,
            strain=0.0,
            lengths=np.full(4 * compartments, 0.02),
        )
        assert draw_frame(scene_and_moment[0], other, width, height).plain

    def test_a_still_base_on_a_point(self, scene_and_moment):
        _, moment = scene_and_moment
        scene = Scene("still", np.zeros((8, 2)), 0.02, 1.0, 100.0)
        still = replace(moment, trace=np.zeros((1, 2)), target=np.zeros(2), possible=0.0)
        assert isinstance(still, Moment)
        assert "◉" in draw_frame(scene, still, 80, 24).plain


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
        moment = episode.moment("")
        assert moment.earned == pytest.approx(expected["return"])
        assert (moment.time, moment.possible) == (pytest.approx(3.0), 300)

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
            if episode.moment("").disturbance:
                shown.append(episode.steps_made)
            episode.step()
        assert shown == list(range(100, 120))

    def test_the_push_is_timed_in_seconds(self):
        policy = train_policy({"control_period": 0.02}, steps=300)
        env = gym.make("OctoArm-v0", max_episode_steps=80, **policy.settings)
        episode, shown = TerminalEpisode("", policy, env, seed=0, steps=80, push=5.0), []
        while not episode.ended:
            if episode.moment("").disturbance:
                shown.append(episode.steps_made)
            episode.step()
        assert shown == list(range(50, 60))

    def test_the_trace_is_of_two_seconds(self, agents):
        episode = make_episode(agents["readout"], steps=300)
        assert len(episode.moment("").trace) == 1
        moment = play(episode).moment("")
        assert len(moment.trace) == 200
        assert np.all(moment.sway[0] <= moment.arm[:, 0])
        assert np.all(moment.sway[1] >= moment.arm[:, 0])
        np.testing.assert_array_equal(moment.trace[-1], episode.info["base_angles"])

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
        text = draw_frame(episode.scene, episode.moment(""), 80, 24).plain
        assert "LEFT ITS DOMAIN" in text


class TestCommand:
    def test_a_pipe_gets_the_last_frames_and_the_figures(self, run, agents):
        result = run("--episodes", 2, "--seed", 3, "--steps", 120)
        assert result.exit_code == 0, result.output
        assert "\x1b" not in result.stdout
        assert result.stdout.count("1.20 of 1.20 s") == 2
        policy = load_policy(agents["readout"])
        for seed in (3, 4):
            figures = evaluate_policy(policy, policy, episodes=1, steps=120, seed=seed)
            assert (
                f"seed {seed}: return {figures['return']:.1f} of 120, "
                f"error {figures['tracking_error']:.3f}°, "
                f"orbit distance {figures['orbit_distance']:.4f}, period "
            ) in result.stdout

    @pytest.mark.parametrize(("columns", "lines"), [(100, 31), (80, 24), (40, 12), (10, 4)])
    def test_frames_fit_the_console(self, run, columns, lines):
        result = run("--steps", 20, columns=columns, lines=lines)
        assert result.exit_code == 0, result.output
        frame = result.stdout.split("seed 0: return")[0].rstrip("\n").split("\n")
        assert len(frame) < lines
        assert max(len(line) for line in frame) <= columns

    def test_a_pipe_stays_a_pipe_where_colours_are_forced(self, run, monkeypatch):
        monkeypatch.setenv("FORCE_COLOR", "1")
        result = run("--steps", 20)
        assert result.exit_code == 0, result.output
        assert "\x1b[?1049h" not in result.stdout

    def test_an_agent_with_memory(self, run, agents):
        result = run("--steps", 50, policy=agents["recurrent"])
        assert result.exit_code == 0, result.output
        assert "of 50 (" in result.stdout

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
            ("no-such-agent.json", "cannot read no-such-agent.json"),
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

    def test_an_encoding_without_braille_is_named(self, agents):
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
        return process.wait(), written.decode()
    finally:
        timer.cancel()
        os.close(ours)


class TestTerminal:
    def test_it_is_drawn_live(self, agents):
        status, written = watch_in_a_terminal([agents["readout"], "--steps", 100, "--speed", 2])
        assert status == 0, written
        shown, after = written.split("\x1b[?1049l")
        assert "\x1b[?1049h" in shown
        assert shown.count("╰─") > 5
        assert "seed 0: return" in after
        assert "1.00 of 1.00 s" in after
        assert "\x1b[?25h" in written

    def test_ctrl_c_ends_it(self, agents):
        status, written = watch_in_a_terminal(
            [agents["readout"], "--steps", 100_000], interrupt_at="╰─".encode()
        )
        assert status == 0, written
        assert "\x1b[?1049l" in written
        assert "\x1b[?25h" in written
        assert "Stopped." in written
        assert "Traceback" not in written
