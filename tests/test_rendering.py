"""What is on the pictures, and that drawing them changes nothing."""

import copy
import json
import pickle
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled, ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import AddRenderObservation, HumanRendering, RecordVideo, RenderCollection
from gymnasium.wrappers.vector import RecordVideo as RecordVectorVideo

from octoarm_env import LIMIT_CYCLES, ArmParameters, OctoArmEnv, OctoArmVectorEnv, TeacherPolicy
from octoarm_env.parameters import plain
from octoarm_env.rendering import CAMERAS, Camera, mesh
from octoarm_env.rendering.colours import BASE, SPRINGS, TARGET, strain_colours
from octoarm_env.rendering.history import History
from octoarm_env.rendering.renderer import Renderer
from octoarm_env.rendering.toolkit import pygame

PICTURES = Path(__file__).parent / "pictures"


@pytest.fixture(autouse=True)
def no_display(monkeypatch):
    """A display that nobody sees."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


def make(**arguments):
    return gym.make("OctoArm-v0", **{"render_mode": "rgb_array"} | arguments).unwrapped


def play(env, steps, *, seed=3):
    """Let the clock act; the last info."""
    teacher = TeacherPolicy(env)
    observation, info = env.reset(seed=seed)
    for _ in range(steps):
        observation, *_, info = env.step(teacher.predict(observation)[0])
    return info


def make_renderer(env, parameters=None, **arguments):
    return Renderer(
        parameters or ArmParameters(), env.orbit, env.action_range, "quadratic", **arguments
    )


def check_stage(env, driven, steps=200, camera=None):
    """The arm and all that belongs to it stay in the picture, and above the seabed."""
    _, info = env.reset(seed=0)
    history = History(0.01)
    history.begin(info)
    parameters = ArmParameters.from_dict(json.loads(env._core.config)["arm"])
    renderer = make_renderer(env, parameters, camera=camera or env._pictures._camera)
    view, random, stage = renderer._look(), np.random.default_rng(0), renderer._stage
    width, height = renderer._canvas.get_size()
    room = height - renderer._panels.bottom * renderer._fine
    for step in range(steps):
        action = {
            "clock": env.teacher_action(),
            "random": random.uniform(-1, 1, 2),
            "bang": np.sign([np.sin(0.1 * step), np.cos(0.1 * step)]),
        }[driven]
        *_, terminated, _, info = env.step(action.astype(np.float32))
        skin = mesh.skin(env.arm_joints).reshape(-1, 3)
        end = renderer._body._pointed(info["base_angles"][np.newaxis])
        pixels, _ = view.project(np.concatenate((skin, renderer._body.path, end)))
        assert pixels.min() >= 4
        assert pixels[:, 0].max() <= width - 4
        assert pixels[:, 1].max() <= room
        assert (skin @ stage.up).min() > stage.floor
        if terminated:
            break


class TestFrames:
    def test_a_frame_is_an_array_of_its_own(self):
        env = make(width=200, height=120)
        env.reset(seed=0)
        first, second = env.render(), env.render()
        assert first.shape == (120, 200, 3)
        assert first.dtype == np.uint8
        assert np.array_equal(first, second)
        assert not np.shares_memory(first, second)
        assert first.flags.writeable
        env.step(np.array([1.0, -1.0], np.float32))
        assert np.array_equal(first, second)
        assert not np.array_equal(first, env.render())

    @pytest.mark.parametrize("target", LIMIT_CYCLES)
    @pytest.mark.parametrize("overlay", [True, False])
    def test_a_known_pose_gives_the_stored_frame(self, target, overlay):
        """Within what other versions of pygame, SDL and FreeType may do to edges and letters.

        Shapes are drawn with whole pixels and then shrunk by two, which other processors may round
        by one level; text may be smoothed otherwise. So a thousandth of the pixels may differ by
        any amount, with panels three hundredths; all others by two levels of 255. A step of the
        arm, 10 ms, changes more.
        """
        env = make(target=target, width=320, height=240, overlay=overlay)
        play(env, 60)
        file = PICTURES / f"{target}{'_overlay' if overlay else ''}.png"
        stored = pygame.surfarray.array3d(pygame.image.load(file)).swapaxes(0, 1)

        def share_that_differs(frame):
            difference = np.abs(frame.astype(int) - stored.astype(int)).max(axis=2)
            return (difference > 2).mean()

        allowed = 0.03 if overlay else 0.001
        assert share_that_differs(env.render()) <= allowed
        env.step(env.teacher_action())
        assert share_that_differs(env.render()) > allowed

    def test_motion_is_continuous(self):
        """From step to step the arm moves on, nothing jumps, flickers or vanishes."""
        env = make(target="lissajous", width=320, height=240, overlay=False)
        env.reset(seed=0)
        frames = []
        for _ in range(20):
            env.step(env.teacher_action())
            frames.append(env.render().astype(int))
        changed = [
            (np.abs(now - before).max(axis=2) > 30).mean() for before, now in pairwise(frames)
        ]
        assert min(changed) > 0.0005
        assert max(changed) < 0.04

    def test_an_own_target_and_another_body(self):
        turns = np.linspace(0, 2 * np.pi, 500, endpoint=False)
        circle = 10 * np.stack((np.cos(turns), np.sin(turns)), axis=1)
        env = make(target=circle, arm=ArmParameters(compartments=7), width=320, height=240)
        env.reset(seed=0)
        assert env.render().shape == (240, 320, 3)

    @pytest.mark.parametrize("size", [(16, 16), (64, 48), (288, 216), (50, 400), (900, 60)])
    def test_any_size(self, size):
        env = make(width=size[0], height=size[1])
        env.reset(seed=0)
        assert env.render().shape == (size[1], size[0], 3)


class TestContents:
    def test_four_springs_two_marks(self):
        """The colours that the figures explain are there, from a side where they can be seen."""
        env = make(width=960, height=720)
        env.reset(seed=1)
        for _ in range(7):
            env.step(env.teacher_action() * 0.5)
        missing = {*SPRINGS, BASE, TARGET}
        for camera in (Camera(azimuth=azimuth) for azimuth in (0.0, 90.0, 180.0, 270.0)):
            renderer = make_renderer(env, size=(960, 720), camera=camera, overlay=False)
            frame = renderer.frame(env.arm_joints, env._history)
            missing = {colour for colour in missing if not (frame == colour).all(axis=2).any()}
        assert not missing

    def test_strains(self):
        colours = strain_colours(np.array([-0.5, -0.2, -0.05, 0.0, 0.05, 0.2, 0.5])).astype(int)
        blue_to_red = colours[:, 0] - colours[:, 2]
        assert np.all(np.diff(blue_to_red)[1:-1] > 0)
        assert np.array_equal(colours[0], colours[1])
        assert np.array_equal(colours[5], colours[6])

    @pytest.mark.parametrize("camera", ["perspective", "front", "side", "top"])
    @pytest.mark.parametrize("driven", ["clock", "random", "bang"])
    def test_nothing_is_clipped(self, camera, driven):
        """Arm, pointer and target stay inside the picture, and above the strains."""
        env = make(camera=camera, target="lissajous")
        check_stage(env, driven)

    @pytest.mark.parametrize(
        "body",
        [
            {"compartments": 1},
            {"compartments": 2},
            {"compartments": 4},
            {"compartments": 60},
            {"gravity": (0.0, 0.0, -9.81)},
            {"gravity": (9.0, 0.0, 0.0)},
            {"gravity": (0.0, 6.0, 4.0)},
            {"gravity": (0.0, 0.0, 0.0)},
            {"base_radius": 0.005, "tip_radius": 0.03},
        ],
        ids=str,
    )
    def test_nothing_of_any_body_is_clipped(self, body):
        """However many compartments it has, and whether it hangs, stands, sags or floats."""
        env = make(arm=ArmParameters(**body))
        for azimuth in (0.0, 60.0, 90.0, 180.0):
            check_stage(env, "random", 40, Camera(azimuth=azimuth, elevation=10.0))

    @pytest.mark.parametrize("target", LIMIT_CYCLES)
    def test_the_arm_points_where_its_base_points(self, target):
        """As the documentation says: the base turns the whole arm, which hardly bends."""
        env = make(target=target, render_mode=None)
        env.reset(seed=0)
        for _ in range(400):
            *_, info = env.step(env.teacher_action())
            theta, phi = np.radians(info["base_angles"])
            axis = [np.sin(phi), -np.sin(theta) * np.cos(phi), np.cos(theta) * np.cos(phi)]
            tip = env.arm_positions[-1]
            assert axis @ tip > np.cos(np.radians(15.0)) * np.linalg.norm(tip)

    def test_a_standing_arm_stands(self):
        for gravity, sign in ((9.81, 1), (-9.81, -1)):
            parameters = ArmParameters(gravity=(0.0, 0.0, gravity), compartments=9)
            renderer = make_renderer(make(), parameters, overlay=False)
            pixels, _ = renderer._look().project(np.array([[0, 0, 0], [0, 0, 0.18]]))
            assert sign * (pixels[1, 1] - pixels[0, 1]) > 100

    @pytest.mark.parametrize("size", [(288, 216), (320, 240), (640, 480), (480, 640), (1280, 720)])
    def test_texts_are_inside_and_do_not_touch(self, size):
        env = make(width=size[0], height=size[1])
        play(env, 499)
        env.render()
        renderer = next(iter(env._pictures._renderers.values()))
        panels, history = renderer._panels, env._history
        assert panels.shown
        lines = renderer._lines(history)
        labels = panels.draw(renderer._canvas, history, np.zeros((20, 4)), lines)
        boxes = []
        for text, x, y, _, points, anchor in labels:
            wide, high = panels._letters(text, (255, 255, 255), points).get_size()
            left = x - {"left": 0.0, "middle": 0.5, "right": 1.0}[anchor] * wide
            # Letters do not fill the whole height of their line.
            box = pygame.Rect(round(left), round(y + 0.2 * high), wide, round(0.55 * high))
            assert pygame.Rect(0, 0, *size).contains(box), text
            assert box.collidelist(boxes) == -1, text
            boxes.append(box)

    def test_letters_are_in_the_font(self):
        font = pygame.font.Font(None, 20)
        missing = pygame.image.tobytes(font.render("\uffff", True, (255, 255, 255)), "RGBA")
        for letter in "θφ°±−×":
            drawn = pygame.image.tobytes(font.render(letter, True, (255, 255, 255)), "RGBA")
            assert drawn != missing, letter

    def test_the_end_is_said(self):
        env = make()
        info = play(env, 5)
        history, renderer = env._history, make_renderer(env)
        assert not any("domain" in text for text, _ in renderer._lines(history))
        history.add(info | {"failure": "height of compartment 1"}, 0.0)
        assert any("left its domain" in text for text, _ in renderer._lines(history))

    def test_what_disturbs_is_said(self):
        env = make()
        play(env, 5)
        env._history.disturbances = ("pushed",)
        renderer = make_renderer(env)
        assert ("pushed", (255, 120, 100)) in renderer._lines(env._history)

    def test_an_exaggeration_is_said(self):
        env = make()
        env.reset(seed=0)
        history = env._history
        renderer = make_renderer(env, camera=Camera(exaggeration=3.0))
        assert ("sideways ×3", (156, 190, 204)) in renderer._lines(history)


class TestSimulation:
    @pytest.mark.parametrize("mode", ["rgb_array", "human"])
    def test_pictures_change_no_bit(self, mode):
        seen = make(render_mode=mode, width=64, height=48)
        unseen = make(render_mode=None)
        random = np.random.default_rng(0)
        for seed in (5, None):
            one, other = seen.reset(seed=seed), unseen.reset(seed=seed)
            assert np.array_equal(one[0], other[0])
            for _ in range(30):
                action = random.uniform(-1, 1, 2).astype(np.float32)
                one, other = seen.step(action), unseen.step(action)
                seen.render()
                assert np.array_equal(one[0], other[0])
                assert one[1:4] == other[1:4]
                assert plain(one[4]) == plain(other[4])
        assert seen._core.save() == unseen._core.save()
        seen.close()

    def test_what_is_off_costs_nothing(self):
        """Without a render mode nothing is kept; pygame is not even imported before a picture."""
        assert make(render_mode=None)._history is None
        assert OctoArmVectorEnv(2)._history is None
        code = """
import sys, gymnasium as gym, octoarm_env
for mode in (None, "rgb_array"):
    env = gym.make("OctoArm-v0", render_mode=mode)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    envs = gym.make_vec("OctoArm-v0", num_envs=2, render_mode=mode)
    envs.reset(seed=0)
    envs.step(envs.action_space.sample())
assert "pygame" not in sys.modules
env.render()
assert "pygame" in sys.modules
"""
        result = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=False
        )
        assert result.returncode == 0, result.stderr
        assert result.stdout == ""

    def test_infos_may_be_changed_by_their_owner(self):
        env = make(width=64, height=48, overlay=False)
        _, info = env.reset(seed=0)
        expected = env.render()
        info["base_angles"][:] = 99.0
        info["target"][:] = 99.0
        assert np.array_equal(env.render(), expected)


class TestGymnasium:
    @pytest.mark.parametrize("mode", [None, *OctoArmEnv.metadata["render_modes"]])
    def test_check_env(self, mode):
        check_env(make(render_mode=mode, width=64, height=48))

    def test_metadata(self):
        assert make().metadata == {"render_modes": ["human", "rgb_array"], "render_fps": 100}
        assert make(control_period=0.02).metadata["render_fps"] == 50
        assert make(control_period=0.03).metadata["render_fps"] == pytest.approx(100 / 3)
        assert OctoArmEnv.metadata["render_fps"] == 100
        envs = OctoArmVectorEnv(2, control_period=0.02)
        assert envs.metadata["render_modes"] == ["rgb_array"]
        assert envs.metadata["render_fps"] == 50

    def test_before_reset(self):
        with pytest.raises(ResetNeeded, match="before reset"):
            make().render()
        with pytest.raises(ResetNeeded):
            gym.make("OctoArm-v0", render_mode="rgb_array").render()
        with pytest.raises(ResetNeeded, match="before reset"):
            OctoArmVectorEnv(2, render_mode="rgb_array").render()

    def test_without_a_mode(self):
        env = make(render_mode=None)
        env.reset(seed=0)
        with pytest.warns(UserWarning, match="render_mode is None"):
            assert env.render() is None

    def test_after_the_end_and_after_close(self):
        env = gym.make(
            "OctoArm-v0", render_mode="rgb_array", width=64, height=48, max_episode_steps=3
        )
        env.reset(seed=0)
        for _ in range(3):
            *_, truncated, _ = env.step(np.zeros(2, np.float32))
        assert truncated
        last = env.render()
        assert last.shape == (48, 64, 3)
        env.close()
        env.close()
        assert np.array_equal(env.render(), last)

    def test_after_leaving_the_domain(self):
        """The last valid pose stays in the picture."""
        # Ninety degrees there and back in 10 ms: no arm that is carried along bears that.
        env = make(arm="inertial", amplitude=10.0, action_range=90.0, width=320, height=240)
        env.reset(seed=0)
        sign, terminated = 1.0, False
        for _ in range(50):
            _, _, terminated, *_ = env.step(np.array([sign, sign], np.float32))
            sign = -sign
            if terminated:
                break
        assert terminated
        assert env._history.failure
        assert env.render().shape == (240, 320, 3)

    def test_human_again_after_close(self):
        env = make(render_mode="human", width=64, height=48)
        env.reset(seed=0)
        assert env.render() is None
        env.close()
        assert not pygame.display.get_init()
        assert env.render() is None
        env.close()

    def test_others_may_quit_pygame(self):
        """As Gymnasium's own environments do when they are closed."""
        env = make(width=320, height=240)
        env.reset(seed=0)
        expected = env.render()
        other = gym.make("CartPole-v1", render_mode="rgb_array")
        other.reset(seed=0)
        other.render()
        other.close()
        assert np.array_equal(env.render(), expected)
        pygame.quit()
        pygame.font.init()
        env.step(np.ones(2, np.float32))
        env.render()

    def test_a_window_comes_back_after_others_quit_pygame(self):
        env = make(render_mode="human", width=64, height=48)
        env.reset(seed=0)
        pygame.quit()
        env.step(np.zeros(2, np.float32))
        assert pygame.display.get_init()
        env.close()

    def test_a_shallow_copy_has_its_own_past(self):
        env = make(width=320, height=240)
        play(env, 20)
        expected = env.render()
        twin = copy.copy(env)
        twin.step(np.zeros(2, np.float32))
        assert twin._history.steps == 21
        assert np.array_equal(env.render(), expected)

    def test_pickle_and_deepcopy(self):
        env = make(width=320, height=240)
        play(env, 20)
        expected = env.render()
        for twin in (pickle.loads(pickle.dumps(env)), copy.deepcopy(env)):
            assert np.array_equal(twin.render(), expected)
            twin.step(np.zeros(2, np.float32))
            assert not np.array_equal(twin.render(), expected)

    def test_a_window_that_is_nowhere_is_told(self, monkeypatch, capsys):
        """As SDL opens where it finds no display; the arm goes on."""
        monkeypatch.setattr(pygame.display, "get_driver", lambda: "offscreen")
        env = make(render_mode="human", width=64, height=48)
        env.reset(seed=0)
        assert "no display was found" in capsys.readouterr().err
        env.step(np.zeros(2, np.float32))
        env.close()

    def test_another_window_takes_the_place(self):
        first, second = (make(render_mode="human", width=64, height=48) for _ in range(2))
        first.reset(seed=0)
        second.reset(seed=0)
        zeros = np.zeros(2, np.float32)
        with pytest.warns(UserWarning, match="another one opened"):
            first.step(zeros)
        first.close()
        assert pygame.display.get_init()
        second.step(zeros)
        assert not second._pictures._window.closed
        second.close()
        assert not pygame.display.get_init()

    def test_a_missing_extra_names_the_command(self, monkeypatch):
        for name in ("toolkit", "renderer", "panels", "water", "window"):
            monkeypatch.delitem(sys.modules, f"octoarm_env.rendering.{name}", raising=False)
        monkeypatch.setitem(sys.modules, "pygame", None)
        words = r'pip install "octoarm-env\[render\]"'
        env = OctoArmEnv(render_mode="rgb_array")
        env.reset(seed=0)
        with pytest.raises(DependencyNotInstalled, match=words):
            env.render()
        with pytest.raises(DependencyNotInstalled, match=words):
            OctoArmEnv(render_mode="human").reset(seed=0)

    def test_the_missing_toolkit_leaves_the_arm_alone(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "pygame", None)
        env = make()
        env.reset(seed=0)
        env.step(np.zeros(2, np.float32))

    def test_record_video(self, tmp_path):
        import imageio_ffmpeg

        env = gym.make(
            "OctoArm-v0", render_mode="rgb_array", width=160, height=120, max_episode_steps=25
        )
        env = RecordVideo(
            env, str(tmp_path / "films"), episode_trigger=lambda _: True, disable_logger=True
        )
        env.reset(seed=0)
        truncated = False
        while not truncated:
            *_, truncated, _ = env.step(np.zeros(2, np.float32))
        env.close()
        (film,) = tmp_path.glob("films/*.mp4")
        frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(film))
        assert frames in (26, 27)  # moviepy may repeat the last one
        assert seconds == pytest.approx(0.26, abs=0.02)

    def test_record_video_of_a_batch(self, tmp_path):
        envs = gym.make_vec(
            "OctoArm-v0", num_envs=4, render_mode="rgb_array", width=160, height=120
        )
        envs = RecordVectorVideo(
            envs,
            str(tmp_path / "films"),
            step_trigger=lambda step: step == 0,
            video_length=5,
            disable_logger=True,
        )
        envs.reset(seed=0)
        for _ in range(8):
            envs.step(np.zeros((4, 2), np.float32))
        envs.close()
        assert len(list(tmp_path.glob("films/*.mp4"))) == 1

    def test_lists_and_human_wrappers(self):
        env = gym.make("OctoArm-v0", render_mode="rgb_array_list", width=64, height=48)
        env.reset(seed=0)
        for _ in range(3):
            env.step(np.zeros(2, np.float32))
        frames = env.render()
        assert [frame.shape for frame in frames] == [(48, 64, 3)] * 4
        inner = gym.make("OctoArm-v0", render_mode="rgb_array", width=64, height=48)
        collection = RenderCollection(inner)
        collection.reset(seed=0)
        assert len(collection.render()) == 1
        shown = HumanRendering(inner)
        shown.reset(seed=0)
        shown.step(np.zeros(2, np.float32))
        shown.close()

    def test_pictures_as_observations(self):
        env = gym.make("OctoArm-v0", render_mode="rgb_array", width=84, height=84, overlay=False)
        env = AddRenderObservation(env)
        observation, _ = env.reset(seed=0)
        assert env.observation_space.contains(observation)
        assert observation.shape == (84, 84, 3)


class TestVectorEnv:
    @pytest.mark.parametrize("mode", list(AutoresetMode))
    def test_frames_are_those_of_single_environments(self, mode):
        """To the bit, over ends of episodes."""
        arguments = {"render_mode": "rgb_array", "width": 300, "height": 225}
        native = gym.make_vec(
            "OctoArm-v0",
            num_envs=3,
            max_episode_steps=6,
            autoreset_mode=mode,
            target=["quadratic", "lissajous", "quadratic"],
            **arguments,
        )
        loop = gym.vector.SyncVectorEnv(
            [
                lambda target=target: gym.make(
                    "OctoArm-v0", target=target, max_episode_steps=6, **arguments
                )
                for target in ("quadratic", "lissajous", "quadratic")
            ],
            autoreset_mode=mode,
        )
        native.reset(seed=0)
        loop.reset(seed=0)
        random = np.random.default_rng(0)
        for _ in range(15):
            actions = random.uniform(-1, 1, (3, 2)).astype(np.float32)
            *_, terminated, truncated, _ = native.step(actions)
            loop.step(actions)
            for one, other in zip(native.render(), loop.render(), strict=True):
                assert np.array_equal(one, other)
            if mode == AutoresetMode.DISABLED and (terminated | truncated).any():
                options = {"reset_mask": terminated | truncated}
                native.reset(options=options)
                loop.reset(options=dict(options))
                for one, other in zip(native.render(), loop.render(), strict=True):
                    assert np.array_equal(one, other)

    def test_call(self):
        envs = OctoArmVectorEnv(3, render_mode="rgb_array", width=64, height=48)
        envs.reset(seed=0)
        frames = envs.render()
        assert isinstance(frames, tuple)
        called = envs.call_at([2, 0], "render")
        assert np.array_equal(called[0], frames[2])
        assert np.array_equal(called[1], frames[0])

    def test_more_arms_than_renderers_are_kept(self, monkeypatch):
        bodies = [ArmParameters(arm_density=1200.0 + 10 * index) for index in range(6)]
        envs = OctoArmVectorEnv(6, arm=bodies, render_mode="rgb_array", width=64, height=48)
        envs.reset(seed=0)
        frames = envs.render()
        assert len(envs._pictures._renderers) == 6
        envs._pictures.close()
        monkeypatch.setattr("octoarm_env.rendering.pictures._MEMORY", 3 * 4 * 128 * 96)
        envs.render()
        assert len(envs._pictures._renderers) == 3
        assert all(np.array_equal(a, b) for a, b in zip(frames, envs.render(), strict=True))
        envs.close()

    def test_snapshots_and_copies(self):
        envs = OctoArmVectorEnv(2, render_mode="rgb_array", width=320, height=240)
        envs.reset(seed=0)
        zeros = np.zeros((2, 2), np.float32)
        for _ in range(5):
            envs.step(zeros)
        snapshot, frames = envs.snapshot(), envs.render()
        for twin in (pickle.loads(pickle.dumps(envs)), copy.deepcopy(envs)):
            assert all(np.array_equal(a, b) for a, b in zip(frames, twin.render(), strict=True))
        envs.step(zeros)
        envs.restore(snapshot)
        assert all(np.array_equal(a, b) for a, b in zip(frames, envs.render(), strict=True))
        envs.step(zeros)
        envs.restore(snapshot)
        assert all(np.array_equal(a, b) for a, b in zip(frames, envs.render(), strict=True))

    @pytest.mark.parametrize("past", [True, False])
    def test_a_restored_end_is_an_end(self, past):
        """The step after it begins an episode, in the pictures too."""
        mode = "rgb_array" if past else None
        envs = OctoArmVectorEnv(2, render_mode=mode, max_episode_steps=5)
        twin = OctoArmVectorEnv(
            2, render_mode="rgb_array", width=64, height=48, max_episode_steps=5
        )
        zeros = np.zeros((2, 2), np.float32)
        envs.reset(seed=0)
        for _ in range(5):
            *_, infos = envs.step(zeros)
        twin.reset(seed=9)
        twin.restore(envs.snapshot())
        history = twin._history.of(1)
        assert np.array_equal(history.trace[-1], infos["base_angles"][1])
        assert np.array_equal(history.target, infos["target"][1])
        assert history.tracking_error == infos["tracking_error"][1]
        assert history.steps == (5 if past else 0)
        twin.step(zeros)
        assert (twin._history.of(1).steps, len(twin._history.of(1).trace)) == (0, 1)
        assert len(twin.render()) == 2

    def test_without_a_mode(self):
        envs = OctoArmVectorEnv(2)
        envs.reset(seed=0)
        with pytest.warns(UserWarning, match="render_mode is None"):
            assert envs.render() is None


def test_a_camera_as_an_argument():
    near = make(camera=replace(CAMERAS["base"], zoom=6.0), width=160, height=120)
    far = make(camera="perspective", width=160, height=120)
    near.reset(seed=0)
    far.reset(seed=0)
    assert not np.array_equal(near.render(), far.render())
