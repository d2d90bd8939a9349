"""An episode as streams of the Rerun viewer: the arm in space, its springs, the base, the rewards.

Every row lies on two timelines, ``time`` in seconds of the simulation and ``step`` in control
periods; both are 0 when the episode begins. Lengths are in metres, angles in degrees.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from octoarm_agents.common.environment import SETTINGS
from octoarm_agents.common.files import atomic_file
from octoarm_agents.common.orbit import orbit_distance
from octoarm_agents.viewing.episode import Episode
from octoarm_agents.viewing.rerun_layout import layout
from octoarm_env import ArmParameters
from octoarm_env.arrays import Float
from octoarm_env.rendering import mesh
from octoarm_env.rendering.colours import (
    BASE,
    FLESH,
    ORBIT,
    SPRINGS,
    TARGET,
    Colour,
    strain_colours,
)

Steps = NDArray[np.int64]
Columns = Iterable[rr.ComponentColumn]

APPLICATION = "octoarm"
"""Under this name the viewer files the recordings."""

STREAMS = {
    "/world/arm/skin": "surface of the arm, rings of the planes and a rounded tip [m]",
    "/world/arm/springs": "the four rows of longitudinal springs, base to tip [m]",
    "/world/base": "attitude of the base; its pointer points away from the arm",
    "/world/target": "attitude that the base should have",
    "/world/orbit": "where the end of the target's pointer passes [m]",
    "/portrait/plane": "base and target, θ to the right, φ upwards [degrees]",
    "/strain": "strain of the springs, a row for each of the four, the base on the left",
    "/springs/1 … /springs/4": "lengths of a row of springs, compartment 1 at the base [m]",
    "/angles/theta/base, /angles/phi/base": "where the base is [degrees]",
    "/angles/theta/command, /angles/phi/command": "where it was sent, push included [degrees]",
    "/angles/theta/target, /angles/phi/target": "where it should be [degrees]",
    "/error/tracking": "distance of the base from the target now [degrees]",
    "/error/orbit": "distance of the base from the orbit, whatever the phase [degrees]",
    "/reward/reward": "of the step that ends here: the sum of the two that follow",
    "/reward/tracking, /reward/action_change": "its terms",
    "/reward/return": "sum of the rewards so far",
    "/events": "what happens to the arm and to the agent",
}
"""What is logged, and its unit."""

_BLOCK = 100
"""Rows sent at a time."""
_POINTER = 0.2
"""Length of the base's pointer, as a share of the arm's."""

_METAL: Colour = (150, 160, 168)
_COMMAND: Colour = (110, 150, 175)
_ERROR: Colour = (255, 120, 100)
_AXES: Colour = (60, 96, 116)


class RecordingError(OSError):
    """Nothing can be recorded: no viewer opens, or logging is switched off."""


@contextmanager
def recording_file(path: Path) -> Iterator[rr.RecordingStream]:
    """Give a recording that fills a file; the file appears when the block has ended well.

    Raises:
        OSError: the file cannot be written, or not all of it.
        RecordingError: logging is switched off.
    """
    recording = begin_recording()
    # In memory, some 10 kB a step: where the disk is full, Rerun's own writer of files may leave
    # whoever waits for it waiting for ever.
    stream = rr.binary_stream(recording)
    with atomic_file(path) as temporary:
        try:
            yield recording
            # All at once, since what is read in parts is no file that can be read.
            temporary.write_bytes(stream.read() or b"")
        finally:
            recording.disconnect()


def begin_recording() -> rr.RecordingStream:
    """Give a recording that leads nowhere yet.

    Raises:
        RecordingError: logging is switched off.
    """
    recording = rr.RecordingStream(APPLICATION)
    if not rr.is_enabled(recording=recording):
        value = os.environ.get("RERUN")
        raise RecordingError(f"logging is switched off by the environment variable RERUN={value}")
    return recording


def log_episode(recording: rr.RecordingStream, episode: Episode) -> None:
    """Let an episode run, and log all of it; the episode notices nothing of that.

    Args:
        recording: where the streams go; what is to receive them is attached already.
        episode: at its beginning.
    """
    log = _EpisodeLog(recording, episode)
    while not episode.ended:
        log.step()


class _EpisodeLog:
    """What `log_episode` does.

    Row k of what describes a moment is k control periods after the beginning. What belongs to a
    step, command and reward, is in the row of the moment in which the step ends; there is none
    in row 0.
    """

    def __init__(self, recording: rr.RecordingStream, episode: Episode) -> None:
        self._recording, self._episode = recording, episode
        self._nanoseconds = 1e9 * episode.control_period
        self._waiting: list[dict[str, Any]] = []
        self._events: list[tuple[int, str, str]] = []
        self._trail_end: Float = episode.command
        self._was_pushed = False
        title = f"{episode.title}, seed {episode.seed}"
        recording.send_recording_name(title)
        recording.send_blueprint(layout(episode))
        for path, archetype in _still(episode, title).items():
            recording.log(path, archetype, static=True, strict=True)
        self._note(f"{title} begins on the orbit")
        if episode.noise is not None:
            size = episode.noise.size
            self._note(f"the agent sees the lengths with noise of ±{size:g} m", "WARN")
        self._remember()

    def step(self) -> None:
        """Let the episode make a step, and log it."""
        self._episode.step()
        self._remember()
        if self._episode.history.failure:
            self._note(f"the arm left its domain: {self._episode.history.failure}", "ERROR")
        if self._episode.ended:
            self._note(self._episode.report())
        if self._episode.ended or len(self._waiting) >= _BLOCK:
            self._send()

    def _remember(self) -> None:
        episode, info, step = self._episode, self._episode.info, self._episode.steps_made
        base = info["base_angles"]
        row = {"step": step, "joints": episode.joints, "lengths": episode.lengths[0]}
        row |= {"base": base, "target": info["target"], "trail": (self._trail_end, base)}
        row |= {"command": episode.command, "error/tracking": info["tracking_error"]}
        row["reward/reward"] = episode.rollout.rewards[step - 1, 0]
        row |= {f"reward/{name}": info[f"reward_{name}"] for name in ("tracking", "action_change")}
        row["reward/return"] = episode.history.total
        self._waiting.append(row)
        self._trail_end = base
        pushed = "pushed" in episode.disturbances and not episode.ended
        if pushed and not self._was_pushed and episode.push is not None:
            self._note(f"somebody pushes the base by {episode.push.size:g}°", "WARN")
        elif self._was_pushed and not pushed:
            self._note("the push ends")
        self._was_pushed = pushed

    def _note(self, text: str, level: str = "INFO") -> None:
        self._events.append((self._episode.steps_made, text, level))

    def _send(self) -> None:
        """Send the rows and events that wait."""
        if self._waiting:
            names = self._waiting[0]
            rows = {name: np.array([row[name] for row in self._waiting]) for name in names}
            self._waiting.clear()
            rows["error/orbit"] = orbit_distance(rows["base"], self._episode.target.points)
            self._send_streams(rows["step"], _moments(rows, self._episode.settings.arm.rest_length))
            made = rows["step"] > 0
            if made.any():
                of_steps = _axes("command", rows["command"])
                of_steps |= {name: rows[name] for name in rows if name.startswith("reward/")}
                streams = {path: _scalars(values[made]) for path, values in of_steps.items()}
                self._send_streams(rows["step"][made], streams)
        if self._events:
            steps, texts, levels = zip(*self._events, strict=True)
            self._events.clear()
            events = rr.TextLog.columns(text=texts, level=levels)
            self._send_streams(np.array(steps), {"events": events})

    def _send_streams(self, steps: Steps, streams: dict[str, Columns]) -> None:
        # Whole nanoseconds: a float of seconds would be cut off, not rounded.
        times = np.rint(steps * self._nanoseconds).astype("timedelta64[ns]")
        indexes = [rr.TimeColumn("time", duration=times), rr.TimeColumn("step", sequence=steps)]
        for path, columns in streams.items():
            self._recording.send_columns(path, indexes, columns, strict=True)


def _moments(rows: dict[str, Float], rest_length: float) -> dict[str, Columns]:
    """Give the streams that describe moments, of those rows."""
    joints, lengths = rows["joints"], rows["lengths"]
    count, planes = joints.shape[:2]
    skins = np.array([mesh.skin(each) for each in joints], dtype=np.float32)
    vertices = rr.Mesh3D.columns(vertex_positions=skins.reshape(-1, 3))
    strips = joints.transpose(0, 2, 1, 3).reshape(-1, planes, 3).astype(np.float32)
    springs = rr.LineStrips3D.columns(strips=list(strips))
    strains = lengths.reshape(count, -1, 4).transpose(0, 2, 1) / rest_length - 1
    pictures = strain_colours(strains).reshape(count, -1)
    trail = rr.LineStrips2D.columns(strips=list(rows["trail"].astype(np.float32)))
    streams: dict[str, Columns] = {
        "world/arm/skin": vertices.partition([skins[0].size // 3] * count),
        "world/arm/springs": springs.partition([4] * count),
        "strain": rr.Image.columns(buffer=list(pictures)),
        "portrait/plane/trail": trail,
    }
    scalars = {f"springs/{spring + 1}": lengths[:, spring::4] for spring in range(4)}
    scalars |= {f"error/{kind}": rows[f"error/{kind}"] for kind in ("tracking", "orbit")}
    for kind in ("base", "target"):
        points = rows[kind].astype(np.float32)
        attitudes = _attitudes(rows[kind]).as_quat().astype(np.float32)
        streams[f"world/{kind}"] = rr.Transform3D.columns(quaternion=attitudes)
        streams[f"portrait/plane/{kind}"] = rr.Points2D.columns(positions=points)
        scalars |= _axes(kind, rows[kind])
    return streams | {path: _scalars(values) for path, values in scalars.items()}


def _axes(kind: str, pairs: Float) -> dict[str, Float]:
    """Give both angles (n, 2) by the paths of their streams."""
    return {f"angles/{name}/{kind}": pairs[:, axis] for axis, name in enumerate(("theta", "phi"))}


def _scalars(values: Float) -> Columns:
    """Give the column of numbers, (n,) or, several a row, (n, k)."""
    columns = rr.Scalars.columns(scalars=values.reshape(-1))
    return columns.partition([values[0].size] * len(values))


def _still(episode: Episode, title: str) -> dict[str, rr.AsComponents]:
    """Give what does not change: looks, names, the orbit, the text about the episode."""
    body, orbit, reach = episode.settings.arm, _thinned(episode.target.points), episode.action_range
    count, radius = body.compartments, body.base_radius
    pointer = [0.0, 0.0, -_POINTER * body.rest_length * count]
    stands, handed = body.gravity[2] < 0, rr.ViewCoordinates
    points = rr.Radius.ui_points
    still: dict[str, rr.AsComponents] = {
        "about": rr.TextDocument(_about(episode, title), media_type=rr.MediaType.MARKDOWN),
        "world": handed.RIGHT_HAND_Z_UP if stands else handed.RIGHT_HAND_Z_DOWN,
        "world/arm/skin": rr.Mesh3D.from_fields(
            triangle_indices=_skin_triangles(count),
            vertex_normals=_skin_normals(body),
            vertex_colors=_skin_colours(count),
        ),
        "world/arm/springs": rr.LineStrips3D.from_fields(colors=SPRINGS, radii=0.09 * radius),
        "world/base/plate": rr.Cylinders3D(
            lengths=0.3 * radius,
            radii=1.25 * radius,
            centers=[0.0, 0.0, -0.15 * radius],
            colors=_METAL,
            fill_mode=rr.components.FillMode.Solid,
        ),
        "world/orbit": rr.LineStrips3D(
            [_attitudes(orbit).apply(pointer)], radii=0.04 * radius, colors=ORBIT
        ),
        # The flip turns the downward axis of a flat view upwards; the data keep their signs.
        "portrait/plane": rr.Transform3D(scale=[1.0, -1.0, 1.0]),
        "portrait/plane/axes": rr.LineStrips2D(
            [[[-reach, 0.0], [reach, 0.0]], [[0.0, -reach], [0.0, reach]]],
            colors=_AXES,
            radii=points(0.5),
            draw_order=0.0,
        ),
        "portrait/plane/names": rr.Points2D(
            [[reach, 0.0], [0.0, reach]],
            labels=[f"θ {reach:g}°", f"φ {reach:g}°"],
            show_labels=True,
            colors=_AXES,
            radii=points(1.0),
        ),
        "portrait/plane/orbit": rr.LineStrips2D(
            [orbit], colors=ORBIT, radii=points(1.5), draw_order=1.0
        ),
        "portrait/plane/trail": rr.LineStrips2D.from_fields(
            colors=BASE, radii=points(1.0), draw_order=2.0
        ),
        "strain": rr.Image.from_fields(
            format=rr.components.ImageFormat(
                width=count,
                height=4,
                color_model=rr.ColorModel.RGB,
                channel_datatype=rr.ChannelDatatype.U8,
            )
        ),
    }
    for name, colour, thick, size in (("base", BASE, 0.12, 5.0), ("target", TARGET, 0.06, 7.0)):
        still[f"world/{name}/pointer"] = rr.Arrows3D(
            vectors=pointer, radii=thick * radius, colors=colour
        )
        still[f"portrait/plane/{name}"] = rr.Points2D.from_fields(
            colors=colour, radii=points(size), draw_order=40.0 - size
        )
    names = [f"compartment {index + 1}" for index in range(count)]
    for spring, colour in enumerate(SPRINGS, start=1):
        still[f"springs/{spring}"] = rr.SeriesLines(colors=_fading(colour, count), names=names)
    for path, name, colour in _SERIES:
        # A command holds from the moment of the row before to that of its own.
        held = rr.components.InterpolationMode.StepBefore if path.endswith("command") else None
        still[path] = rr.SeriesLines(colors=colour, names=name, interpolation_mode=held)
    return still


_SERIES: tuple[tuple[str, str, Colour], ...] = (
    *(
        (f"angles/{angle}/{kind}", f"{letter} {kind}", colour)
        for angle, letter in (("theta", "θ"), ("phi", "φ"))
        for kind, colour in (("command", _COMMAND), ("target", TARGET), ("base", BASE))
    ),
    ("error/tracking", "from the target", _ERROR),
    ("error/orbit", "from the orbit", ORBIT),
    ("reward/reward", "reward", BASE),
    ("reward/tracking", "for tracking", TARGET),
    ("reward/action_change", "for changes of the action", _ERROR),
    ("reward/return", "return", BASE),
)
"""Path, name and colour of each lone series."""


def _skin_triangles(compartments: int) -> NDArray[np.uint32]:
    """Give the triangles between the rings of `mesh.skin`, front sides outwards, (n, 3)."""
    rings = compartments + 4
    ring, side = np.meshgrid(np.arange(rings - 1), np.arange(mesh.SIDES), indexing="ij")
    beside = (side + 1) % mesh.SIDES
    here, there = ring * mesh.SIDES + side, ring * mesh.SIDES + beside
    below, diagonal = here + mesh.SIDES, there + mesh.SIDES
    first = np.stack((here, there, diagonal), axis=-1)
    second = np.stack((here, diagonal, below), axis=-1)
    return np.stack((first, second), axis=2).reshape(-1, 3).astype(np.uint32)


def _skin_normals(body: ArmParameters) -> NDArray[np.float32]:
    """Outward normals of the skin of the straight arm, (vertices, 3).

    They light the bent arm too: it leans little enough that nobody sees a difference, and a
    recording is half as large as with those of every moment.
    """
    count = body.compartments
    radii = np.linspace(body.base_radius, body.tip_radius, count + 1)
    corners = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    joints = radii[:, np.newaxis, np.newaxis] * corners
    # The cap of the tip is round about the last plane.
    heights = body.rest_length * np.minimum(np.arange(count + 4), count)
    joints[..., 2] = heights[: count + 1, np.newaxis]
    outwards = mesh.skin(joints)
    outwards[..., 2] -= heights[:, np.newaxis]
    outwards /= np.linalg.norm(outwards, axis=2, keepdims=True)
    return outwards.reshape(-1, 3).astype(np.float32)


def _skin_colours(compartments: int) -> NDArray[np.uint8]:
    """Rings of two shades of flesh, (vertices, 3)."""
    shades = np.array(FLESH, dtype=np.uint8)[np.arange(compartments + 4) % 2]
    return np.repeat(shades, mesh.SIDES, axis=0)


def _fading(colour: Colour, count: int) -> NDArray[np.uint8]:
    """Shades of a colour, bright at the base, dim at the tip, (count, 3)."""
    shades: NDArray[np.float64] = np.outer(np.linspace(1.0, 0.35, count), colour)
    return np.rint(shades).astype(np.uint8)


def _thinned(orbit: Float, points: int = 256) -> Float:
    """Points enough to draw a closed curve, the first again at the end, (n, 2)."""
    return np.concatenate((orbit[:: max(1, len(orbit) // points)], orbit[:1]))


def _attitudes(angles: Float) -> Any:
    """Attitudes of the base, a `Rotation`: turned by θ about x, then by φ about its own y.

    Args:
        angles: (n, 2) [degrees].
    """
    return Rotation.from_euler("XY", angles, degrees=True)


def _about(episode: Episode, title: str) -> str:
    """Describe an episode, its body and its streams, in Markdown."""
    settings = {name: getattr(episode.settings, name) for name in SETTINGS}
    if not isinstance(settings["target"], str):
        settings["target"] = f"its own, {len(settings['target'])} points"
    facts: dict[str, Any] = {
        "seed": episode.seed,
        "steps": episode.steps,
        "push [degrees]": episode.push.size if episode.push else "none",
        "noise [m]": episode.noise.size if episode.noise else "none",
        **settings,
        "period of the target [s]": episode.target.period,
    }
    lines = [f"# {title}", *_table("Episode", facts)]
    lines += _table("Streams", {f"`{path}`": meaning for path, meaning in STREAMS.items()})
    lines += _table("Body (SI units)", episode.settings.arm.to_dict())
    return "\n".join(lines) + "\n"


def _table(heading: str, entries: dict[str, Any]) -> list[str]:
    rows = [f"| {name} | {value} |" for name, value in entries.items()]
    return ["", f"## {heading}", "", "| | |", "|---|---|", *rows]
