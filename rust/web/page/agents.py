"""Writes the trained networks as the page loads them: python3 agents.py FOLDER.

A file is the length of its header as 32 bits, the header in JSON, then mean and scale of the
lengths in double precision, and weights and bias of every layer in single precision, all
little-endian, as `rust/web/src/network.rs` reads them.
"""

from __future__ import annotations

import json
import struct
import sys
from pathlib import Path

import numpy as np

TRAINED = Path(__file__).parents[3] / "agents" / "octoarm_agents" / "trained"
TARGETS = ("quadratic", "van_der_pol", "lissajous")
TIMESTEP = 1e-3


def page_file(target: str) -> bytes:
    """Give the file of the network that PPO trained on a target."""
    with np.load(TRAINED / target / "ppo.npz", allow_pickle=False) as arrays:
        description = json.loads(str(arrays["description"]))
        network, environment = description["network"], description["environment"]
        plain = (network["activation"], network["output"], network["memory"], network["past"])
        if plain != ("tanh", "clip", 0, 0) or environment["actuator"] != "direct":
            raise ValueError(f"{target}: the page knows layers of tanh and a direct base only")
        layers = [(arrays[f"weights_{k}"], arrays[f"bias_{k}"]) for k in range(network["layers"])]
        header = {
            "sizes": [layers[0][0].shape[1], *(len(bias) for _, bias in layers)],
            "clip": network["clip"],
            "steps": round(environment["control_period"] / TIMESTEP),
            "action_range": environment["action_range"],
            "target": environment["target"],
            "amplitude": environment["amplitude"],
        }
        text = json.dumps(header).encode()
        parts = [struct.pack("<I", len(text)), text]
        parts += [arrays[name].astype("<f8").tobytes() for name in ("mean", "scale")]
        parts += [each.astype("<f4").tobytes() for layer in layers for each in layer]
    return b"".join(parts)


def main() -> None:
    """Write the files of all targets."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for target in TARGETS:
        (folder / f"{target}.bin").write_bytes(page_file(target))


if __name__ == "__main__":
    main()
