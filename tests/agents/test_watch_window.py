"""`octoarm watch` in a window: the show, its end, and the mouse that leads the base."""

import os
import signal
import subprocess
import sys
import threading
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from episodes import make_episode, play, write_headstand
from octoarm_agents.cli import app
from octoarm_agents.cli import watch as command
from octoarm_agents.viewing.episode import Episode
from octoarm_agents.viewing.window import MousePolicy
from typer.testing import CliRunner

from octoarm_env import ArmParameters
from octoarm_env.rendering import CAMERAS, Camera
from octoarm_env.rendering.toolkit import pygame
from octoarm_env.rendering.window import Window

# A window that waits for somebody must not wait for long.
pytestmark = pytest.mark.timeout(120)

SMALL = ("--width", 320, "--height", 240)
QUICK = (*SMALL, "--speed", 100)


def run(*options):
    """Run the command: `run("clock/quadratic", "--steps", 30)`."""
    arguments = ["watch", *(str(each) for each in options)]
    return CliRunner().invoke(app, arguments, env={"COLUMNS": "300"})


def press(key, letter=""):
    pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key, unicode=letter))


def cross():
    """Click the cross that closes the window."""
    pygame.event.post(pygame.event.Event(pygame.QUIT))


def drag(button, *ways):
    pygame.event.post(pygame.event.Event(pygame.MOUSEBUTTONDOWN, button=button, pos=(0, 0)))
    for way in ways:
        pygame.event.post(pygame.event.Event(pygame.MOUSEMOTION, rel=way, pos=(0, 0)))
    pygame.event.post(pygame.event.Event(pygame.MOUSEBUTTONUP, button=button, pos=(0, 0)))


class Audience:
    """Sits before the windows, notes what it sees, and uses mouse and keys.

    Attributes:
        windows: that were opened.
        seen: a note for every step shown, from 0, the reset, on, over all episodes.
        held: joints of the ends that were held, and how often each window then looked for keys.
        at: what to do when so many steps have been shown.
        patience: how often a window that is held may look for keys before `leave` is called.
        leave: what ends the holding.
    """

    def __init__(self):
        self.windows, self.seen, self.held, self.at = [], [], [], {}
        self.patience, self.leave = 3, lambda: press(pygame.K_RETURN)


@pytest.fixture(autouse=True)
def audience(monkeypatch):
    """A display that nobody sees but this one."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    audience, looks = Audience(), []
    make, show, hold, react = Window.__init__, Window.show, Window.hold, Window._react

    def made(self, *arguments, **settings):
        make(self, *arguments, **settings)
        audience.windows.append(self)
        self.caption = pygame.display.get_caption()[0]
        self.first_camera, self.first_speed = self.renderer.camera, self.speed

    def shown(self, joints, history, **settings):
        audience.seen.append(
            SimpleNamespace(
                joints=joints.copy(),
                step=history.steps,
                total=history.total,
                angles=history.trace[-1],
                failure=history.failure,
                tilt=self.renderer.tilt_towards(*self.lean),
                camera=self.renderer.camera,
            )
        )
        audience.at.get(len(audience.seen), lambda: None)()
        show(self, joints, history, **settings)

    def held(self, joints, history):
        audience.held.append([joints.copy(), 0])
        looks.append(self)
        hold(self, joints, history)
        looks.clear()

    def reacted(self):
        if looks:
            audience.held[-1][1] += 1
            if audience.held[-1][1] == audience.patience:
                audience.leave()
        return react(self)

    for name, wrapped in (("__init__", made), ("show", shown), ("hold", held), ("_react", reacted)):
        monkeypatch.setattr(Window, name, wrapped)
    yield audience
    pygame.display.quit()


class TestShow:
    def test_an_episode_runs_to_its_end_and_is_held(self, audience):
        result = run("clock/lissajous", "--view", "window", "--steps", 40, "--seed", 3, *QUICK)
        assert result.exit_code == 0, result.output
        assert result.stderr == ""
        episode = make_episode("clock/lissajous", seed=3, steps=40)
        assert [seen.step for seen in audience.seen] == list(range(41))
        for seen in audience.seen:
            assert np.array_equal(seen.joints, episode.joints)
            assert np.array_equal(seen.angles, episode.info["base_angles"])
            assert seen.total == episode.history.total
            if not episode.ended:
                episode.step()
        assert result.stdout == f"{episode.report()}\n"
        ((joints, looks),) = audience.held
        assert np.array_equal(joints, episode.joints)
        assert looks == audience.patience
        assert len(audience.windows) == 1
        assert not pygame.display.get_init()

    def test_what_is_seen_is_the_episode(self):
        options = ("--push", 5, "--noise", 2e-5, "--steps", 130, "--seed", 7, *QUICK)
        result = run("ppo/lissajous", "--view", "window", *options)
        assert result.exit_code == 0, result.output
        episode = make_episode("ppo/lissajous", steps=130, seed=7, push=5.0, noise=2e-5)
        assert result.stdout == f"{play(episode).report()}\n"

    def test_several_episodes_one_window(self, audience):
        agent = "ppo/quadratic"
        result = run(agent, "--view", "window", "--episodes", 3, "--steps", 20, "--seed", 5, *QUICK)
        assert result.exit_code == 0, result.output
        assert result.stdout.splitlines() == [
            play(make_episode(agent, seed=seed, steps=20)).report() for seed in (5, 6, 7)
        ]
        assert len(audience.windows) == 1
        assert [seen.step for seen in audience.seen] == [*range(21)] * 3
        # Each begins anew, and only the last end is held.
        assert [seen.total for seen in audience.seen[::21]] == [0.0] * 3
        assert len(audience.held) == 1
        assert np.array_equal(audience.held[0][0], audience.seen[-1].joints)

    def test_time_is_kept(self, audience, clock):
        """Thirty steps of 10 ms at four times real time take 75 ms of a clock that sleep moves."""
        stamps = []
        audience.at = dict.fromkeys((10, 40), lambda: stamps.append(clock.now))
        options = ("--view", "window", "--steps", 45, *SMALL, "--speed", 4)
        assert run("hold/quadratic", *options).exit_code == 0
        # A frame may be shown a little early, and never late.
        assert stamps[1] - stamps[0] == pytest.approx(0.075, abs=0.01)

    @pytest.mark.parametrize(
        ("options", "size", "speed", "camera"),
        [
            ((), (960, 720), 1.0, Camera()),
            (("--camera", "top", "--speed", 5, *SMALL), (320, 240), 5.0, CAMERAS["top"]),
            (
                ("--camera", "base", "--zoom", 2, "--exaggeration", 3, *SMALL),
                (320, 240),
                1.0,
                Camera(zoom=6.0, focus=0.08, exaggeration=3.0),
            ),
        ],
    )
    def test_options_reach_the_window(self, options, size, speed, camera, audience):
        result = run("hold/lissajous", "--view", "window", "--steps", 10, *options)
        assert result.exit_code == 0, result.output
        (window,) = audience.windows
        assert window.renderer.size == size
        assert window.first_speed == speed
        assert window.first_camera == camera
        assert window.renderer.title == "hold/lissajous"
        assert window.caption == "OctoArm · hold/lissajous"

    def test_an_arm_that_leaves_its_domain(self, audience, tmp_path):
        """It stands on its base, too heavy for that: the next episode begins."""
        options = ("--arm", write_headstand(tmp_path), "--steps", 300, "--episodes", 2)
        result = run("clock/quadratic", "--view", "window", *options, *QUICK)
        assert result.exit_code == 0, result.output
        lines = result.stdout.splitlines()
        assert len(lines) == 2
        assert all("left its domain after " in line for line in lines)
        ends = [index for index, seen in enumerate(audience.seen) if seen.failure]
        assert len(ends) == 2
        assert audience.seen[ends[0] + 1].step == 0
        assert ends[1] == len(audience.seen) - 1
        assert len(audience.held) == 1

    def test_another_number_of_compartments(self, audience, tmp_path):
        ArmParameters(compartments=7).to_json(tmp_path / "short.json")
        options = ("--arm", tmp_path / "short.json", "--view", "window", "--steps", 10, *QUICK)
        assert run("clock/quadratic", *options).exit_code == 0
        assert audience.seen[0].joints.shape == (8, 4, 3)


class TestEnd:
    """Closing the window ends the command, whenever it happens, and nothing waits."""

    @pytest.mark.parametrize("close", [cross, lambda: press(pygame.K_q, "q")])
    def test_in_an_episode(self, close, audience, clock):
        """While a step lasts that is a hundred times slowed down."""

        def close_a_slow_one():
            audience.windows[0].speed = 0.01
            close()

        audience.at = {7: close_a_slow_one}
        options = ("--view", "window", "--episodes", 3, "--steps", 100, "--seed", 4)
        result = run("hold/quadratic", *options, *QUICK)
        assert clock.now < 1.0
        assert result.exit_code == 0, result.output
        assert len(audience.seen) == 7
        assert audience.held == []
        earned = audience.seen[-1].total
        assert result.stdout == f"seed 4: closed after 0.06 s, return {earned:.1f} of 6\n"
        assert result.stderr == ""
        assert not pygame.display.get_init()

    def test_in_a_later_episode(self, audience):
        audience.at = {15: cross}
        options = ("--view", "window", "--episodes", 3, "--steps", 10, *QUICK)
        result = run("clock/quadratic", *options)
        assert result.exit_code == 0, result.output
        first, second = result.stdout.splitlines()
        assert first.startswith("seed 0: return 10.0 of 10")
        assert second == "seed 1: closed after 0.03 s, return 3.0 of 3"

    def test_before_the_first_step(self, audience):
        audience.at = {1: cross}
        result = run("hold/quadratic", "--view", "window", "--steps", 100, *QUICK)
        assert (result.exit_code, result.output) == (0, "")

    def test_in_the_last_step(self, audience):
        audience.at = {11: cross}
        options = ("--view", "window", "--steps", 10, "--episodes", 2, *QUICK)
        result = run("clock/quadratic", *options)
        assert result.exit_code == 0, result.output
        assert result.stdout.startswith("seed 0: return 10.0 of 10")
        assert result.stdout.count("\n") == 1
        assert audience.held == []

    @pytest.mark.parametrize("close", [cross, lambda: press(pygame.K_ESCAPE)])
    def test_while_the_end_is_held(self, close, audience):
        audience.leave = close
        result = run("clock/quadratic", "--view", "window", "--steps", 10, *QUICK)
        assert result.exit_code == 0, result.output
        assert result.stdout.startswith("seed 0: return 10.0 of 10")
        assert result.stdout.count("\n") == 1
        assert [looks for _, looks in audience.held] == [audience.patience]
        assert not pygame.display.get_init()

    @pytest.mark.parametrize("held", [False, True])
    def test_ctrl_c(self, held, audience):
        def interrupt():
            raise KeyboardInterrupt

        if held:
            audience.leave = interrupt
        else:
            audience.at = {5: interrupt}
        result = run("clock/quadratic", "--view", "window", "--steps", 10, *QUICK)
        assert result.exit_code == 0, result.output
        assert result.stdout.splitlines()[-1] == "Stopped."
        assert len(result.stdout.splitlines()) == (2 if held else 1)
        assert not pygame.display.get_init()

    @pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
    def test_ctrl_c_of_a_terminal(self):
        """The toolkit does not keep the signal to itself."""
        code = (
            "from octoarm_agents.cli import main\n"
            "from octoarm_env.rendering.window import Window\n"
            "show = Window.show\n"
            "def shown(self, joints, history):\n"
            "    if history.steps == 3: print('running', flush=True)\n"
            "    show(self, joints, history)\n"
            "Window.show = shown\nmain()"
        )
        options = ("watch", "hold/quadratic", "--view", "window", "--steps", "100000")
        process = subprocess.Popen(
            [sys.executable, "-c", code, *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        timer = threading.Timer(60.0, process.kill)
        timer.start()
        try:
            assert process.stdout.readline() == "running\n"
            process.send_signal(signal.SIGINT)
            rest, errors = process.communicate(timeout=60)
        finally:
            timer.cancel()
            process.kill()
        assert process.returncode == 0, errors
        assert rest == "Stopped.\n"
        assert errors == ""


class TestMouse:
    @pytest.fixture
    def steps(self, monkeypatch):
        """Actions, commands, base angles and rewards of the steps that are made."""
        made, step = [], Episode.step

        def noted(self):
            command, last = step(self), self.steps_made - 1
            made.append(
                SimpleNamespace(
                    action=self.rollout.actions[last, 0],
                    command=self.command,
                    angles=self.rollout.angles[last, 0],
                    reward=self.rollout.rewards[last, 0],
                )
            )
            return command

        monkeypatch.setattr(Episode, "step", noted)
        return made

    def test_dragging_leads_the_base(self, audience, steps):
        """Each action leans the base to where the mouse has dragged it before that step."""
        audience.at = {
            5: lambda: drag(1, (20, 10)),
            15: lambda: drag(1, (-90, 0), (0, -30)),
            25: lambda: press(pygame.K_UP),
            30: lambda: press(pygame.K_r, "r"),
            35: lambda: drag(1, (300, 300)),
        }
        result = run("--steps", 60, *QUICK)
        assert result.exit_code == 0, result.output
        assert len(steps) == 60
        reach = 117.0
        # What is seen in `show` is from before the events that the same call reacts to.
        for step, after in zip(steps[:-1], audience.seen[1:], strict=False):
            expected = np.clip(after.tilt / reach, -1, 1).astype(np.float32)
            assert np.array_equal(step.action, expected.astype(np.float64))
            np.testing.assert_allclose(step.command, after.tilt, rtol=0, atol=1e-4)
        changes = [
            index + 1
            for index in range(59)
            if not np.array_equal(steps[index].action, steps[index + 1].action)
        ]
        assert changes == [4, 14, 24, 29, 34]
        assert np.array_equal(steps[0].action, [0.0, 0.0])
        assert np.array_equal(steps[30].action, [0.0, 0.0])
        assert np.abs(steps[-1].action).max() == 1.0

    def test_the_base_follows(self, audience, steps):
        """From the front x runs to the right: dragged by a quarter of the height, φ = 117°."""
        audience.at = {1: lambda: drag(1, (60, 0)), 61: lambda: drag(1, (-60, -30))}
        result = run("--steps", 120, "--camera", "front", *QUICK)
        assert result.exit_code == 0, result.output
        np.testing.assert_allclose(steps[59].command, [0.0, 117.0], rtol=0, atol=1e-4)
        np.testing.assert_allclose(steps[59].angles, [0.0, 117.0], rtol=0, atol=0.3)
        np.testing.assert_allclose(np.abs(steps[-1].command), [58.5, 0.0], rtol=0, atol=1e-4)
        np.testing.assert_allclose(steps[-1].angles, steps[-1].command, rtol=0, atol=0.3)
        np.testing.assert_array_equal(audience.seen[-1].angles, steps[-1].angles)

    def test_where_right_is_depends_on_the_camera(self, audience, steps):
        """The right button looks around, the base then leans to where the picture's right is."""
        audience.at = {
            2: lambda: drag(1, (60, 0)),
            4: lambda: drag(3, (-225, 0)),  # 0.4° a pixel
        }
        result = run("--steps", 10, "--camera", "front", *QUICK)
        assert result.exit_code == 0, result.output
        assert [seen.camera.azimuth for seen in audience.seen] == [90.0] * 4 + [0.0] * 7
        np.testing.assert_allclose(steps[1].command, [0.0, 117.0], rtol=0, atol=1e-4)
        np.testing.assert_allclose(np.abs(steps[5].command), [117.0, 0.0], rtol=0, atol=1e-4)

    def test_the_score_counts(self, audience, steps):
        """The report is that of an environment in which the same actions are made."""
        audience.at = {k: lambda k=k: drag(1, (7 * (-1) ** k, k)) for k in range(1, 12)}
        options = ("--target", "lissajous", "--seed", 9, "--steps", 40, "--push", 6)
        result = run(*options, *QUICK)
        assert result.exit_code == 0, result.output
        env = gym.make("OctoArm-v0", target="lissajous")
        env.reset(seed=9)
        rewards = []
        for step in steps:
            command = (step.command / 13.0).astype(np.float32)
            rewards.append(env.step(command)[1])
        assert [step.reward for step in steps] == rewards
        assert result.stdout.startswith(f"seed 9: return {sum(rewards):.1f} of 40, ")
        assert audience.seen[-1].total == pytest.approx(sum(rewards))

    def test_it_is_told_also_of_who_closes(self, audience):
        """An episode lasts ten minutes: who leaves before is told his score all the same."""
        audience.at = {3: lambda: drag(1, (10, 0)), 21: cross}
        result = run(*QUICK)
        assert result.exit_code == 0, result.output
        total = audience.seen[-1].total
        assert result.stdout == f"seed 0: closed after 0.20 s, return {total:.1f} of 20\n"

    def test_several_episodes(self, audience, steps):
        """The base stays led where it was."""
        audience.at = {5: lambda: drag(1, (30, 0))}
        result = run("--steps", 10, "--episodes", 2, *QUICK)
        assert result.exit_code == 0, result.output
        assert [line[:6] for line in result.stdout.splitlines()] == ["seed 0", "seed 1"]
        assert len(audience.windows) == 1
        assert np.array_equal(steps[19].action, steps[9].action)
        assert steps[9].action.any()

    def test_without_a_window_it_stays(self):
        mouse = MousePolicy(117.0)
        action, state = mouse.predict(np.zeros((1, 80)), state="memory")
        assert action.dtype == np.float32
        assert np.array_equal(action, [[0.0, 0.0]])
        assert state == "memory"

    def test_the_caption_and_the_buttons(self, audience):
        """With an agent the left button looks around."""
        audience.at = {2: lambda: drag(1, (10, 0))}
        assert run("--steps", 10, *QUICK).exit_code == 0
        assert audience.windows[0].caption == "OctoArm · by hand"
        assert audience.windows[0].renderer.camera == Camera()
        audience.at = {13: lambda: drag(1, (10, 0))}
        assert run("hold/quadratic", "--view", "window", "--steps", 10, *QUICK).exit_code == 0
        assert audience.windows[1].renderer.camera.azimuth == pytest.approx(64.0)


class TestWhere:
    """In a window or in the terminal."""

    def is_terminal(self, result, audience):
        assert result.exit_code == 0, result.output
        assert "seed 0: return" in result.stdout
        return audience.windows == []

    @pytest.mark.parametrize(
        ("view", "display", "toolkit", "terminal"),
        [
            ("auto", None, True, True),
            ("auto", "DISPLAY", True, False),
            ("auto", "WAYLAND_DISPLAY", True, False),
            ("auto", "DISPLAY", False, True),
            ("terminal", "DISPLAY", True, True),
            ("window", None, True, False),
        ],
    )
    def test_by_view(self, view, display, toolkit, terminal, audience, monkeypatch):
        if display is not None:
            monkeypatch.setenv(display, "there")
        if not toolkit:
            monkeypatch.setattr(command, "find_spec", lambda name: None)
        monkeypatch.setattr(command.sys, "platform", "linux")
        result = run("hold/quadratic", "--view", view, "--steps", 10, *QUICK)
        assert self.is_terminal(result, audience) == terminal

    def test_an_empty_display_is_none(self, audience, monkeypatch):
        monkeypatch.setenv("DISPLAY", "")
        monkeypatch.setattr(command.sys, "platform", "linux")
        assert self.is_terminal(run("hold/quadratic", "--steps", 10), audience)

    @pytest.mark.parametrize("options", [("hold/quadratic", "--view", "window"), ()])
    def test_a_display_that_does_not_open(self, options, monkeypatch):
        monkeypatch.setenv("SDL_VIDEODRIVER", "nothing")
        result = run(*options, "--steps", 10)
        assert result.exit_code == 1
        assert result.stdout == ""
        assert result.stderr.startswith("no window can be opened: ")
        assert result.stderr.count("\n") == 1
        assert "octoarm record" in result.stderr

    @pytest.mark.skipif(sys.platform != "linux", reason="there always is a display")
    @pytest.mark.parametrize("options", [("hold/quadratic", "--view", "window"), ()])
    @pytest.mark.parametrize("display", [None, ":77"])
    def test_no_display(self, options, display, monkeypatch, tmp_path):
        """Nobody would end what runs in a window that the toolkit keeps in memory."""
        monkeypatch.delenv("SDL_VIDEODRIVER")
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
        if display is not None:
            monkeypatch.setenv("DISPLAY", display)
        result = run(*options, "--steps", 10)
        assert result.exit_code == 1
        assert result.stdout == ""
        assert result.stderr.startswith("no window can be opened: ")
        assert result.stderr.count("\n") == 1
        assert not pygame.display.get_init()

    def test_a_display_that_is_gone_leaves_the_terminal(self, monkeypatch):
        monkeypatch.setenv("SDL_VIDEODRIVER", "nothing")
        monkeypatch.setenv("DISPLAY", ":77")
        monkeypatch.setattr(command.sys, "platform", "linux")
        result = run("hold/quadratic", "--steps", 10)
        assert result.exit_code == 0
        assert result.stderr.startswith("no window can be opened: ")
        assert "seed 0: return" in result.stdout

    @pytest.mark.parametrize("options", [("hold/quadratic", "--view", "window"), ()])
    def test_the_extra_is_named(self, options, monkeypatch):
        for name in ("toolkit", "renderer", "panels", "water", "window"):
            monkeypatch.delitem(sys.modules, f"octoarm_env.rendering.{name}", raising=False)
        monkeypatch.delitem(sys.modules, "octoarm_agents.viewing.window", raising=False)
        monkeypatch.setitem(sys.modules, "pygame", None)
        result = run(*options, "--steps", 10)
        assert result.exit_code == 1
        assert 'pip install "octoarm-agents[render]"' in result.stderr
        assert result.stderr.count("\n") == 1
        assert result.stdout == ""
