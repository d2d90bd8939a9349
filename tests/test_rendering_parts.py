"""What pictures are made of: cameras, the skin, the past, tiles."""

import gymnasium as gym
import numpy as np
import pytest

from octoarm_env import ArmParameters
from octoarm_env.rendering import CAMERAS, Camera, mesh, tile_images
from octoarm_env.rendering.camera import View, find_camera
from octoarm_env.rendering.history import History
from octoarm_env.rendering.renderer import Renderer


def make(**arguments):
    return gym.make("OctoArm-v0", **{"render_mode": "rgb_array"} | arguments).unwrapped


def make_renderer(env, parameters=None, **arguments):
    return Renderer(
        parameters or ArmParameters(), env.orbit, env.action_range, "quadratic", **arguments
    )


class TestTiles:
    def test_they_lie_row_by_row(self):
        images = [np.full((2, 3, 3), index + 1, np.uint8) for index in range(5)]
        whole = tile_images(images, columns=2, gap=1)
        assert whole.shape == (3 * 2 + 2, 2 * 3 + 1, 3)
        assert np.array_equal(whole[:2, 4:], images[1])
        assert np.array_equal(whole[6:, :3], images[4])
        assert not whole[6:, 3:].any()
        assert not whole[2].any()

    def test_nearly_square(self):
        images = [np.zeros((48, 64, 3), np.uint8)] * 16
        height, width, _ = tile_images(images).shape
        assert 0.6 < width / height < 1.7

    @pytest.mark.parametrize(
        ("images", "arguments", "kind", "words"),
        [
            ([], {}, ValueError, "images is empty"),
            ([np.zeros((2, 2, 3))], {}, TypeError, r"images\[0\] is float64"),
            ([np.zeros((2, 2), np.uint8)], {}, TypeError, r"images\[0\]"),
            (
                [np.zeros((2, 2, 3), np.uint8), np.zeros((2, 3, 3), np.uint8)],
                {},
                ValueError,
                r"images\[1\] has shape \(2, 3, 3\)",
            ),
            ([np.zeros((2, 2, 3), np.uint8)], {"columns": 0}, ValueError, "columns = 0"),
            ([np.zeros((2, 2, 3), np.uint8)], {"gap": -1}, ValueError, "gap = -1"),
        ],
    )
    def test_what_cannot_be_is_refused(self, images, arguments, kind, words):
        with pytest.raises(kind, match=words):
            tile_images(images, **arguments)


class TestCamera:
    @pytest.mark.parametrize(
        ("arguments", "kind", "words"),
        [
            ({"elevation": 90.0}, ValueError, r"camera.elevation = 90.0.*\[-89, 89\]"),
            ({"azimuth": np.nan}, ValueError, "camera.azimuth = nan.*finite"),
            ({"zoom": 0.0}, ValueError, r"camera.zoom = 0.0.*\[0.2, 20\]"),
            ({"focus": "tip"}, TypeError, "camera.focus = 'tip'"),
            ({"exaggeration": 0.5}, ValueError, "camera.exaggeration = 0.5"),
        ],
    )
    def test_bad_cameras_are_refused(self, arguments, kind, words):
        with pytest.raises(kind, match=words):
            Camera(**arguments)

    def test_by_name(self):
        assert find_camera("top") is CAMERAS["top"]
        assert find_camera(None) == Camera()

    def test_it_stays_in_its_range(self):
        assert Camera().orbited(0.0, 300.0).elevation == 89.0
        assert Camera(azimuth=170.0).orbited(20.0, 0.0).azimuth == -170.0
        assert Camera().zoomed(1e9).zoom == 20.0

    def test_where_the_axes_run(self):
        env = make()
        x, y, z = np.eye(3) * 0.05

        def way(camera, direction):
            view = View(CAMERAS[camera], make_renderer(env)._stage, (640, 480))
            pixels, _ = view.project(np.stack((np.zeros(3), direction)))
            return pixels[1] - pixels[0]

        assert way("front", x)[0] > 20
        assert abs(way("front", x)[1]) < 1
        assert way("side", y)[0] > 20
        assert way("top", x)[0] > 20
        for camera in ("front", "side", "perspective"):
            assert way(camera, z)[1] > 20  # it hangs

    def test_nearer_is_larger(self):
        env = make()
        view = View(Camera(), make_renderer(env)._stage, (640, 480))
        near, far = view.back * 0.1, -view.back * 0.1
        assert view.size_at(0.01, near) > view.size_at(0.01, far)
        pixels, depth = view.project(np.stack((near, far)))
        assert depth[0] < depth[1]
        wide = view.project(near + 0.01 * view.right)[0] - pixels[0]
        assert wide[0] == pytest.approx(view.size_at(0.01, near))

    @pytest.mark.parametrize("azimuth", [0.0, 60.0, 200.0])
    @pytest.mark.parametrize("lean", [(1.0, 0.0), (0.0, 1.0), (-0.5, 0.3), (0.0, 0.0)])
    def test_the_arm_leans_where_it_is_dragged(self, azimuth, lean):
        env = make(amplitude=20.0)
        renderer = make_renderer(env, camera=Camera(azimuth=azimuth))
        angles = renderer.tilt_towards(*lean)
        assert np.abs(angles).max() == pytest.approx(env.action_range * np.hypot(*lean))
        theta, phi = np.radians(angles)
        normal = np.array([np.sin(phi), -np.sin(theta) * np.cos(phi), 0.0])
        view = renderer._look()
        up = np.array([0.0, 0.0, -1.0])
        away = -view.back + (view.back @ up) * up
        seen = np.array([normal @ view.right, normal @ away / np.linalg.norm(away)])
        if np.hypot(*lean):
            # sin θ cos φ is not sin θ: 26 degrees turn the direction by up to 3.
            cosine = seen @ lean / np.linalg.norm(seen) / np.hypot(*lean)
            assert cosine > np.cos(np.radians(3.5))


class TestMesh:
    @pytest.fixture
    def env(self):
        env = make()
        env.reset(seed=0)
        for step in range(60):
            env.step(np.array([np.sin(step), np.cos(0.7 * step)], np.float32))
        return env

    def test_centres(self, env):
        np.testing.assert_allclose(mesh.centres(env.arm_joints), env.arm_positions, atol=1e-15)

    def test_the_skin_goes_through_the_joints(self, env):
        rings = mesh.skin(env.arm_joints)
        assert rings.shape == (24, mesh.SIDES, 3)
        np.testing.assert_allclose(
            rings[:21, :: mesh.SIDES // 4], env.arm_joints, rtol=0, atol=1e-15
        )

    def test_facets_look_outwards(self, env):
        rings = mesh.skin(env.arm_joints)
        corners, normals = mesh.facets(rings)
        assert corners.shape == (23 * mesh.SIDES, 4, 3)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
        along = rings.mean(axis=1)
        middles = np.repeat(0.5 * (along[:-1] + along[1:]), mesh.SIDES, axis=0)
        assert np.all(((corners.mean(axis=1) - middles) * normals).sum(axis=1) > 0)

    def test_exaggeration_moves_sideways_alone(self, env):
        rest = np.zeros((21, 3))
        rest[:, 2] = np.linspace(0.0, 0.4, 21)
        joints = env.arm_joints
        assert mesh.exaggerate(joints, rest, 1.0) is joints
        moved = mesh.exaggerate(joints, rest, 3.0)
        centres = mesh.centres(joints)
        expected = centres * [3.0, 3.0, 1.0]
        np.testing.assert_allclose(mesh.centres(moved), expected, atol=1e-14)
        np.testing.assert_allclose(
            moved - mesh.centres(moved)[:, None], joints - centres[:, None], atol=1e-14
        )

    def test_light_comes_from_above(self):
        up, back, water = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0]), np.zeros(3)
        colours = np.full((2, 3), 200.0)
        top, bottom = mesh.lit(colours, np.stack((up, -up)), up, back, water)
        assert top.min() > bottom.max()
        assert np.all(mesh.lit(colours, np.stack((up, back)), up, back, water) <= 255)


class TestHistory:
    def test_it_keeps_two_seconds(self):
        history = History(0.01)
        assert not history.began
        info = {"base_angles": np.zeros(2), "target": np.ones(2), "tracking_error": 1.5}
        history.begin(info)
        for step in range(300):
            history.add(info | {"base_angles": np.full(2, step + 1.0)}, 0.5)
        assert history.trace.shape == (200, 2)
        assert history.trace[-1, 0] == 300.0
        assert (history.steps, history.total) == (300, 150.0)
        assert history.time == pytest.approx(3.0)
        history.begin(info)
        assert (history.steps, history.total) == (0, 0.0)
        assert len(history.trace) == 1
