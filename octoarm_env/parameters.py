"""The body's parameters."""

from __future__ import annotations

import dataclasses
import enum
import json
import math
import os
import secrets
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias, cast

import numpy as np

from octoarm_env import _core

#: The named bodies, each with all its fields, as the physics itself holds them.
_PRESETS: dict[str, dict[str, Any]] = json.loads(_core.preset_parameters())
_DEFAULTS = _PRESETS["nakajima2013"]

#: Names that :meth:`ArmParameters.preset` takes.
PRESETS = tuple(_PRESETS)


def plain(value: Any) -> Any:
    """Give what JSON can write, where there is such: numbers, texts, lists and dictionaries.

    Mappings and sequences of any kind are taken, those of OmegaConf as well, arrays, dataclasses,
    enumerations and paths; what is none of these is given back.
    """
    if isinstance(value, enum.Enum):
        return plain(value.value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    if hasattr(value, "tolist"):  # a scalar or an array of NumPy, or of who does like it
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return [plain(entry) for entry in value]
    return value


def _default(name: str) -> Any:
    """Give the default that the physics itself holds."""
    value = _DEFAULTS[name]
    return tuple(value) if isinstance(value, list) else value


@dataclasses.dataclass(frozen=True, kw_only=True)
class ArmParameters:
    """Every parameter of the arm, in SI units; immutable and validated when made.

    Defaults are Table 1 of Nakajima et al. (2013); what the table leaves open is marked *open*.

    Fields marked *each* are one number for the whole arm, or a sequence with a number for each
    compartment, from base to tip, as many as there are `compartments`; it is kept as a tuple. The
    entry j, counted from 0, is the value of compartment j: of its four longitudinal springs, and of
    the plane that is its ceiling, with its four transverse springs and four joints. The base plane
    has neither springs nor mass.

    ========================== ===================== ==================================================
    field                      range                 meaning
    ========================== ===================== ==================================================
    base_coupling              "gravity", "inertial" what a turning base does to the arm: it turns
                                                     gravity only, or accelerates the arm (*open*)
    rest_length                (0, 10] m             l_0 of every longitudinal spring
    base_radius                (0, 10] m             radius of the base plane
    tip_radius                 (0, 10] m             rest radius of the last plane; linear taper between
    longitudinal_mass          (0, 100] kg           M_l, at the spring's upper joint (*each*)
    transverse_mass            [0, 100] kg           M_r, at the same joint (*each*)
    longitudinal_mass_share    [1/3, 1]              part of M_l that moves with the joint (*open*)
    longitudinal_damping       [0, 1e6] N s/m        C_l (*each*)
    transverse_damping         [0, 1e6] N s/m        C_r (*each*)
    longitudinal_stiffness     (0, 1e9] N/m          K_l (*each*)
    transverse_stiffness       (0, 1e9] N/m          K_r (*each*)
    longitudinal_volume_gain   [0, 1e12] 1/m³        K_lv, Eq. 7
    transverse_volume_gain     [0, 1e12] 1/m³        K_rv, Eq. 8
    water_density              [0, 1e5] kg/m³        ρ_w; 0 takes the arm out of the water
    arm_density                [0, 1e5] kg/m³        ρ_o, Eqs. 10-11 (*open*)
    gravity                    3 × [-1e3, 1e3] m/s²  world frame; the resting arm points along +z (*open*)
    area_scale                 [0, 1e4]              factor on the reference area A_r (*open*)
    reference_area             "wetted", "planform"  π (R_b + R_t) h or (R_b + R_t) h (*open*)
    volume_force               "applied", "total"    reading of Eqs. 7-8 (*open*)
    drag_coefficients          5 numbers             Eq. 14, highest power first, angle in degrees
    lift_coefficients          5 numbers             Eq. 15, likewise
    lift_scale                 [-1e4, 1e4]           factor on the lift force; its sign is *open*: docs/body.md
    plane_mass                 [0, 100] kg           M_ce at each plane's centre (*open*, *each*)
    plane_inertia              [0, 100] kg m²        I_ce about x and y, twice that about z (*open*, *each*)
    compartments               [1, 200]              number of compartments
    timestep                   (0, 0.1] s            Runge-Kutta step
    servo_frequency            (0, 1e4] Hz           natural frequency of the base servo (*open*)
    ========================== ===================== ==================================================

    Raises:
        ValueError: a value outside its range; the message names the field, the value and the range.
        TypeError: a field that does not exist.
    """

    base_coupling: Literal["gravity", "inertial"] = _default("base_coupling")
    rest_length: float = _default("rest_length")
    base_radius: float = _default("base_radius")
    tip_radius: float = _default("tip_radius")
    longitudinal_mass: float | tuple[float, ...] = _default("longitudinal_mass")
    transverse_mass: float | tuple[float, ...] = _default("transverse_mass")
    longitudinal_mass_share: float = _default("longitudinal_mass_share")
    longitudinal_damping: float | tuple[float, ...] = _default("longitudinal_damping")
    transverse_damping: float | tuple[float, ...] = _default("transverse_damping")
    longitudinal_stiffness: float | tuple[float, ...] = _default("longitudinal_stiffness")
    transverse_stiffness: float | tuple[float, ...] = _default("transverse_stiffness")
    longitudinal_volume_gain: float = _default("longitudinal_volume_gain")
    transverse_volume_gain: float = _default("transverse_volume_gain")
    water_density: float = _default("water_density")
    arm_density: float = _default("arm_density")
    gravity: tuple[float, float, float] = _default("gravity")
    area_scale: float = _default("area_scale")
    reference_area: Literal["wetted", "planform"] = _default("reference_area")
    volume_force: Literal["applied", "total"] = _default("volume_force")
    drag_coefficients: tuple[float, float, float, float, float] = _default("drag_coefficients")
    lift_coefficients: tuple[float, float, float, float, float] = _default("lift_coefficients")
    lift_scale: float = _default("lift_scale")
    plane_mass: float | tuple[float, ...] = _default("plane_mass")
    plane_inertia: float | tuple[float, ...] = _default("plane_inertia")
    compartments: int = _default("compartments")
    timestep: float = _default("timestep")
    servo_frequency: float = _default("servo_frequency")

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = plain(getattr(self, field.name))
            entries = value if isinstance(value, list) else [value]
            for entry in entries:
                if isinstance(entry, float) and not math.isfinite(entry):
                    raise ValueError(f"{field.name} = {value}: all numbers must be finite")
            object.__setattr__(self, field.name, value)
        try:
            text = json.dumps(dataclasses.asdict(self))
        except TypeError as error:
            raise TypeError(f"a parameter is not a number, tuple or name: {error}") from None
        # The physics validates, and gives every field its own type back.
        for name, value in json.loads(_core.check_parameters(text)).items():
            object.__setattr__(self, name, tuple(value) if isinstance(value, list) else value)

    def replace(self, **changes: Any) -> ArmParameters:
        """Return a copy with some fields changed, validated again."""
        return dataclasses.replace(self, **changes)

    def scaled(self, **factors: float) -> ArmParameters:
        """Return a copy with some numbers multiplied, those of a tuple all by the same factor.

        Args:
            factors: by the names of the fields, such as `longitudinal_stiffness=1.2`.

        Raises:
            ValueError: the product is outside the field's range.
            AttributeError: a field that does not exist.
        """
        return self.replace(
            **{name: np.multiply(getattr(self, name), factor) for name, factor in factors.items()}
        )

    def to_dict(self) -> dict[str, Any]:
        """Return all fields as a dictionary of plain numbers, tuples and names."""
        return dataclasses.asdict(self)

    @classmethod
    def preset(cls, name: str) -> ArmParameters:
        """Make a named body.

        Args:
            name: "nakajima2013", the paper's, whose base turns gravity only; or "inertial", whose
                base accelerates the arm in the world (docs/body.md).

        Raises:
            ValueError: another name.
        """
        if name not in _PRESETS:
            raise ValueError(f"arm = {name!r}: expected one of the named bodies {PRESETS}")
        return cls(**_PRESETS[name])

    @classmethod
    def of(cls, body: BodyLike | None) -> ArmParameters:
        """Make parameters of whatever describes a body.

        Args:
            body: parameters (returned as they are), a name as in :meth:`preset`, a mapping as in
                :meth:`from_dict`, the path of a JSON file as in :meth:`from_json`, or None for the
                default.

        Raises:
            ValueError: no such name or file, or a body that is not valid.
            TypeError: something else.
            OSError: a file that cannot be read.
        """
        if body is None:
            return cls()
        if isinstance(body, cls):
            return body
        if isinstance(body, Mapping):
            return cls.from_dict(dict(body))
        if isinstance(body, str) and body in _PRESETS:
            return cls.preset(body)
        if isinstance(body, str | os.PathLike):
            if not Path(body).exists():
                raise ValueError(
                    f"arm: cannot read {os.fspath(body)}: neither a JSON file nor one of the named"
                    f" bodies {PRESETS}"
                )
            return cls.from_json(Path(body))
        kind = type(body).__name__
        raise TypeError(f"arm must be an ArmParameters, a name, a mapping or a file, not {kind}")

    @classmethod
    def from_dict(cls, fields: dict[str, Any]) -> ArmParameters:
        """Make parameters from a dictionary; fields left out take their defaults."""
        known = {field.name for field in dataclasses.fields(cls)}
        unknown = sorted(set(fields) - known)
        if unknown:
            raise ValueError(f"unknown parameters {unknown}; known are {sorted(known)}")
        return cls(**fields)

    def to_json(self, path: str | os.PathLike[str] | None = None) -> str:
        """Return the parameters as JSON text, exact to the bit; also write them to `path` if given.

        The file appears whole or not at all.
        """
        text = json.dumps(self.to_dict(), indent=2)
        if path is not None:
            target = Path(path)
            temporary = target.with_name(f".{target.name}.{secrets.token_hex(8)}")
            try:
                with temporary.open("x", encoding="utf-8") as file:
                    file.write(text + "\n")
                temporary.replace(target)
            except BaseException:
                temporary.unlink(missing_ok=True)
                raise
        return text

    @classmethod
    def from_json(cls, source: str | os.PathLike[str]) -> ArmParameters:
        """Make parameters from JSON text (a `str` that starts with ``{``) or from a JSON file.

        Raises:
            ValueError: text that is not a JSON object of known fields within their ranges; the
                message names the file.
            OSError: a file that cannot be read.
        """
        if isinstance(source, str) and source.lstrip().startswith("{"):
            text, name = source, "JSON text"
        else:
            text, name = Path(source).read_text(encoding="utf-8"), os.fspath(source)
        try:
            fields = json.loads(text)
        except json.JSONDecodeError as error:
            raise ValueError(f"{name} is not JSON: {error}") from None
        if not isinstance(fields, dict):
            raise ValueError(f"{name} holds a {type(fields).__name__}, expected a JSON object")
        try:
            return cls.from_dict(cast("dict[str, Any]", fields))
        except (ValueError, TypeError) as error:
            raise ValueError(f"{name}: {error}") from None


#: Whatever describes a body, see :meth:`ArmParameters.of`.
BodyLike: TypeAlias = ArmParameters | Mapping[str, Any] | str | os.PathLike[str]
