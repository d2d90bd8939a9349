"""Contenders that are programs of their own: they make as many steps as they are told."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

_ASSETS = Path(__file__).parents[1] / "web" / "page" / "assets"

PRODUCT = 384
"""Rows and columns of the matrices that `matrix_product` multiplies."""

_PRODUCTS = f"""
import sys, numpy as np
one, two = np.random.default_rng(0).random((2, {PRODUCT}, {PRODUCT}))
out = np.empty_like(one)
for line in sys.stdin:
    for _ in range(int(line)):
        np.matmul(one, two, out=out)
    print(flush=True)
"""

_STEPS = """
import { readFileSync } from "node:fs";
import { createInterface } from "node:readline";

const [code, module] = process.argv.slice(1);
const text = encodeURIComponent(readFileSync(code, "utf8"));
const physics = await import("data:text/javascript," + text);
await physics.default({ module_or_path: readFileSync(module) });
for await (const line of createInterface({ input: process.stdin })) {
  const angles = new Float64Array(2 * Number(line));
  for (let step = 0; 2 * step < angles.length; step++) {
    angles[2 * step] = 20 * Math.sin(0.007 * step);
    angles[2 * step + 1] = 20 * Math.sin(0.011 * step);
  }
  physics.run("{}", angles);
  console.log();
}
"""


class Program:
    """A program in a process of its own, which makes so many steps for every line that it reads."""

    def __init__(self, *command: str) -> None:
        self._name = command[0]
        # One thread is one thread: what computes matrices starts as many as there are processors.
        one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | one,
            text=True,
            bufsize=1,
        )

    def run(self, steps: int) -> None:
        """Make so many steps.

        Raises:
            RuntimeError: the program has ended.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{steps}\n")
        if not self._process.stdout.readline():
            raise RuntimeError(f"{self._name} ended with {self._process.wait()}")

    def close(self) -> None:
        """End the program."""
        self._process.kill()
        self._process.communicate()


def matrix_product() -> Program:
    """What multiplies two matrices with NumPy, on one thread; a step is a product."""
    return Program(sys.executable, "-c", _PRODUCTS)


def node() -> str | None:
    """The path of Node.js, if there is one."""
    return shutil.which("node")


def web_module() -> Program:
    """What steps an arm with the page's module of WebAssembly, the one with vectors, in Node.js."""
    (page,) = _ASSETS.glob("index-*.js")
    # The page asks for the one with vectors first.
    names = re.findall(r"octoarm_web-[\w-]+\.js", page.read_text(encoding="utf-8"))
    code = _ASSETS / names[0]
    (module,) = set(re.findall(r"octoarm_web_bg-[\w-]+\.wasm", code.read_text(encoding="utf-8")))
    paths = str(code), str(_ASSETS / module)
    return Program(node() or "node", "--input-type=module", "-e", _STEPS, *paths)
