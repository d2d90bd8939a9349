"""What a result was computed with: versions, processor, operating system."""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import os
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

import octoarm_env
from octoarm_env import _core


def describe_machine() -> dict[str, Any]:
    """Operating system, Python, processor and the instruction set that the physics chose."""
    return {
        "platform": platform.platform(),
        "python": platform.python_version(),
        "processor": _processor(),
        "cpu_count": os.cpu_count(),
        "instruction_set": octoarm_env.instruction_set(),
    }


def package_versions(*names: str) -> dict[str, str | None]:
    """Installed versions by distribution name; None for what is not installed."""
    return {name: _version(name) for name in names}


@functools.cache
def code_digest(module: str) -> str:
    """Digest of this package, of the module that a trial is in, and of the compiled physics.

    The version alone would let trials of an older state of a checkout pass for present ones.

    Args:
        module: full name of an importable module.
    """
    specification = importlib.util.find_spec(module)
    own = set() if specification is None else {Path(str(specification.origin))}
    digest = hashlib.sha256(Path(_core.__file__).read_bytes())
    for file in sorted(own | set(Path(__file__).parents[1].rglob("*.py"))):
        digest.update(file.read_bytes())
    return digest.hexdigest()


@functools.cache
def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _processor() -> str:
    """The processor's own name where the system tells it, else its architecture."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
