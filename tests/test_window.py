"""The window: its time, its keys, its mouse, its end."""

import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from octoarm_env import ArmParameters
from octoarm_env.rendering import CAMERAS, Camera
from octoarm_env.rendering.history import History
from octoarm_env.rendering.renderer import Renderer
from octoarm_env.rendering.toolkit import pygame
from octoarm_env.rendering.window import Window, WindowError

# A window that waits for somebody must not wait for long.
pytestmark = pytest.mark.timeout(60)


@pytest.fixture(autouse=True)
def no_display(monkeypatch):
    """A display that nobody sees."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


@pytest.fixture
def arm():
    """Joints and history of an arm that has just begun."""
    env = gym.make("OctoArm-v0").unwrapped
    _, info = env.reset(seed=0)
    history = History(0.01)
    history.begin(info)
    return env.arm_joints, history


@pytest.fixture
def make_window(arm):
    env = gym.make("OctoArm-v0").unwrapped

    def make(size=(320, 240), **arguments):
        renderer = Renderer(ArmParameters(), env.orbit, env.action_range, size=size)
        return Window(renderer, "arm", 0.01, **arguments)

    return make


def press(key, letter=""):
    pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key, unicode=letter))


def drag(button, *ways):
    pygame.event.post(pygame.event.Event(pygame.MOUSEBUTTONDOWN, button=button, pos=(0, 0)))
    for way in ways:
        pygame.event.post(pygame.event.Event(pygame.MOUSEMOTION, rel=way, pos=(0, 0)))
    pygame.event.post(pygame.event.Event(pygame.MOUSEBUTTONUP, button=button, pos=(0, 0)))


@pytest.mark.parametrize("speed", [1.0, 3.0])
def test_steps_take_their_time(make_window, arm, clock, speed):
    window = make_window(speed=speed)
    window.show(*arm)
    begin = clock.now
    for _ in range(100):
        window.show(*arm)
    assert clock.now - begin == pytest.approx(1.0 / speed)


def test_at_most_sixty_frames_are_drawn(make_window, arm, clock, monkeypatch):
    window, drawn = make_window(speed=10.0), []
    monkeypatch.setattr(window, "_draw", lambda *_: (drawn.append(0), draw(*arm)))
    draw = Window._draw.__get__(window)
    begin = clock.now
    for _ in range(300):
        window.show(*arm)
    assert 1 < len(drawn) <= 1 + 70 * (clock.now - begin)


def test_what_was_slept_through_is_not_hurried_after(make_window, arm, clock):
    window = make_window()
    window.show(*arm)
    clock.sleep(0.3)
    window.show(*arm)
    begin = clock.now
    for _ in range(10):
        window.show(*arm)
    assert clock.now - begin == pytest.approx(0.1)


def test_speed_keys(make_window, arm):
    window = make_window()
    press(pygame.K_PLUS, "+")
    press(pygame.K_EQUALS, "=")
    window.show(*arm)
    assert window.speed == 4.0
    press(pygame.K_MINUS, "-")
    window.show(*arm)
    assert window.speed == 2.0
    for _ in range(30):
        press(pygame.K_KP_MINUS)
    press(pygame.K_PERIOD)
    window.show(*arm)
    assert window.speed == 0.01
    press(pygame.K_SPACE)
    press(pygame.K_1, "1")
    window.show(*arm)
    assert window.speed == 1.0


def test_pause_step_and_on(make_window, arm):
    window = make_window()
    window.show(*arm)
    press(pygame.K_PERIOD)
    window.show(*arm)  # comes back although it stands from here on
    assert window.paused
    press(pygame.K_PERIOD)
    window.show(*arm)
    assert window.paused
    press(pygame.K_SPACE)
    window.show(*arm)
    assert not window.paused


def test_while_paused_time_stands(make_window, arm, monkeypatch):
    window, slept = make_window(), []

    def sleep(seconds):
        slept.append(seconds)
        if len(slept) == 20:
            press(pygame.K_SPACE)

    monkeypatch.setattr("octoarm_env.rendering.window.time.sleep", sleep)
    press(pygame.K_SPACE)
    window.show(*arm)
    assert len(slept) >= 20
    assert not window.paused


def test_the_mouse_goes_around_and_nearer(make_window, arm):
    window = make_window()
    drag(1, (10, 0), (0, 5))
    pygame.event.post(pygame.event.Event(pygame.MOUSEWHEEL, y=2))
    window.show(*arm)
    camera = window.renderer.camera
    assert camera.azimuth == pytest.approx(Camera().azimuth + 4.0)
    assert camera.elevation == pytest.approx(Camera().elevation + 2.0)
    assert camera.zoom == pytest.approx(1.15**2)
    press(pygame.K_r, "r")
    window.show(*arm)
    assert window.renderer.camera == Camera()


def test_a_moved_mouse_without_a_button_does_nothing(make_window, arm):
    window = make_window()
    pygame.event.post(pygame.event.Event(pygame.MOUSEMOTION, rel=(50, 50), pos=(0, 0)))
    window.show(*arm)
    assert window.renderer.camera == Camera()


def test_the_left_button_leads_the_base(make_window, arm):
    window = make_window(lead=True)
    drag(1, (30, 0))  # a quarter of the height is the whole way
    window.show(*arm)
    np.testing.assert_allclose(window.lean, [0.5, 0.0])
    assert window.renderer.camera == Camera()
    drag(1, (0, -30))
    window.show(*arm)
    np.testing.assert_allclose(window.lean, [0.5, 0.5])
    drag(1, (300, 0))
    window.show(*arm)
    assert np.hypot(*window.lean) == pytest.approx(1.0)
    drag(3, (10, 0))
    window.show(*arm)
    assert window.renderer.camera.azimuth == pytest.approx(Camera().azimuth + 4.0)
    press(pygame.K_r, "r")
    press(pygame.K_UP)
    window.show(*arm)
    np.testing.assert_allclose(window.lean, [0.0, 0.1])


def test_cameras_overlay_help_and_exaggeration(make_window, arm):
    window = make_window()
    names = []
    for _ in CAMERAS:
        press(pygame.K_c, "c")
        window.show(*arm)
        names.append(next(n for n, c in CAMERAS.items() if c == window.renderer.camera))
    assert sorted(names) == sorted(CAMERAS)
    press(pygame.K_o, "o")
    press(pygame.K_h, "h")
    press(pygame.K_x, "x")
    window.show(*arm)
    assert not window.renderer.overlay
    assert any("space" in note for note in window.renderer.notes)
    assert window.renderer.camera.exaggeration == 2.0
    for _ in range(3):
        press(pygame.K_x, "x")
    window.show(*arm)
    assert window.renderer.camera.exaggeration == 1.0


def test_another_size(make_window, arm):
    window = make_window()
    press(pygame.K_x, "x")
    for size, expected in (
        ((400, 300), (400, 300)),
        ((10, 10), (160, 160)),
        ((5120, 200), (4096, 200)),
    ):
        pygame.event.post(pygame.event.Event(pygame.VIDEORESIZE, w=size[0], h=size[1], size=size))
        window.show(*arm)
        assert window.renderer.size == expected
        assert window.renderer.camera.exaggeration == 2.0


@pytest.mark.parametrize("end", ["q", "escape", "cross"])
def test_a_closed_window_waits_no_more(make_window, arm, clock, end):
    window = make_window(speed=0.01)
    if end == "cross":
        pygame.event.post(pygame.event.Event(pygame.QUIT))
    else:
        press({"q": pygame.K_q, "escape": pygame.K_ESCAPE}[end], "q" if end == "q" else "")
    for _ in range(100):
        window.show(*arm)
    assert clock.now == 0.0
    assert window.closed
    assert not pygame.display.get_init()
    window.close()
    window.hold(*arm)


def test_the_end_is_held_until_a_key(make_window, arm, monkeypatch):
    window, frames = make_window(), []

    def sleep(_):
        frames.append(window.renderer.camera.azimuth)
        if len(frames) == 3:
            drag(1, (10, 0))
        if len(frames) == 5:
            press(pygame.K_o, "o")
        if len(frames) == 6:
            press(pygame.K_SPACE)

    monkeypatch.setattr("octoarm_env.rendering.window.time.sleep", sleep)
    window.hold(*arm)
    assert frames == [60.0] * 3 + [64.0] * 3
    assert window.renderer.notes == ("the end; space closes",)
    assert not window.renderer.overlay
    assert not window.closed


def test_no_display(make_window, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "nothing")
    with pytest.raises(WindowError, match='no window can be opened.*render_mode="rgb_array"'):
        make_window()


def test_a_window_that_is_nowhere(make_window, monkeypatch):
    """What SDL opens where it finds no display; nobody could press a key in it."""
    assert make_window().seen
    pygame.display.quit()
    monkeypatch.setattr(pygame.display, "get_driver", lambda: "offscreen")
    assert not make_window().seen
    pygame.display.quit()
    monkeypatch.setenv("SDL_VIDEODRIVER", "offscreen")
    assert make_window().seen


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="Linux lists what is loaded")
def test_a_window_loads_no_opengl():
    """With Mesa's comes its LLVM, beside which PyTorch's Triton crashes when it is imported."""
    script = """
import gymnasium, octoarm_env
env = gymnasium.make("OctoArm-v0", render_mode="human", width=160, height=120)
env.reset(seed=0)
loaded = open("/proc/self/maps").read()
print([name for name in ("libGL", "libLLVM") if name in loaded])
"""
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={"SDL_VIDEODRIVER": "offscreen"},
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[1],
    )
    assert done.stdout.splitlines()[-1] == "[]"


def test_one_window_at_a_time(make_window):
    first, second = make_window(), make_window()
    assert first.closed
    first.close()
    assert not second.closed
    assert not second.lost
    second.close()


def test_an_environment_goes_on_without_its_window(clock):
    env = gym.make("OctoArm-v0", render_mode="human", width=160, height=120)
    unseen = gym.make("OctoArm-v0")
    env.reset(seed=0)
    unseen.reset(seed=0)
    action = np.array([0.5, -0.5], np.float32)
    env.step(action)
    unseen.step(action)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    with pytest.warns(UserWarning, match="window was closed"):
        env.step(action)
    unseen.step(action)
    begin = clock.now
    for _ in range(100):
        assert np.array_equal(env.step(action)[0], unseen.step(action)[0])
    assert clock.now == begin
    env.reset(seed=1)
    env.render()
    env.close()
