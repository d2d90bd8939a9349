"""Counts the instructions of a physics step, by kind.

    python rust/arm/benches/count_operations.py [--neon]

Counted are the steps between a short run and a longer one; objdump says what each instruction is.
Valgrind counts those of the AVX2 kernel (it knows no AVX-512); an instruction on four arms of the
eight in lanes is one on all eight with AVX-512, so that the count is halved for that. With
`--neon` it is the code for aarch64, which works on two numbers at a time, and qemu counts: `rustup
target add aarch64-unknown-linux-gnu`, `apt install qemu-user gcc-aarch64-linux-gnu`.
"""

import argparse
import collections
import functools
import json
import os
import re
import subprocess
import tempfile
from pathlib import Path

TARGET = "aarch64-unknown-linux-gnu"
TOOLS = "aarch64-linux-gnu"
# Where qemu puts a program.
BASE = 0x55_0000_0000
KINDS = {
    "fused": r"vf[n]?m(add|sub)\d+[ps]d|fml[as]|fn?m(add|sub)",
    "multiply": r"vmul[ps]d|fn?mul",
    "add": r"v(add|sub)[ps]d|f(add|sub)",
    "divide": r"vdiv[ps]d|fdiv",
    "root": r"vsqrt[ps]d|fsqrt",
}


@functools.cache
def binary(neon: bool) -> str:
    """Build what makes the steps, and say where it is."""
    build = ["cargo", "bench", "-p", "octoarm-arm", "--bench", "steps", "--no-run"]
    linker = {f"CARGO_TARGET_{TARGET.upper().replace('-', '_')}_LINKER": f"{TOOLS}-gcc"}
    text = subprocess.run(
        [*build, *(["--target", TARGET] if neon else []), "--message-format=json"],
        env=os.environ | linker,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    ).stdout
    built = [json.loads(line).get("executable") for line in text.splitlines()]
    return str(next(path for path in built if path))


def kinds(neon: bool) -> dict[int, str]:
    """Kind of every instruction by its address."""
    text = subprocess.run(
        [f"{TOOLS}-objdump" if neon else "objdump", "-d", "--no-show-raw-insn", binary(neon)],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    found = {}
    for address, mnemonic in re.findall(r"^\s+([0-9a-f]+):\t(\w+)", text, re.MULTILINE):
        found[int(address, 16)] = next(
            (kind for kind, pattern in KINDS.items() if re.fullmatch(pattern, mnemonic)), "other"
        )
    return found


def executed(kind: str, steps: int, known: dict[int, str]) -> collections.Counter[str]:
    """Instructions by kind in a run of so many steps, as valgrind counts them."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        subprocess.run(
            [
                "valgrind",
                "--tool=callgrind",
                "--dump-instr=yes",
                f"--callgrind-out-file={out}",
                binary(False),
                kind,
                str(steps),
            ],
            env=os.environ | {"OCTOARM_INSTRUCTION_SET": "avx2"},
            check=True,
            capture_output=True,
        )
        counts: collections.Counter[str] = collections.Counter()
        address, call = 0, False
        for line in out.read_text().splitlines():
            if line.startswith("calls="):
                call = True  # the next line is the cost of the callee, which is counted itself
            elif match := re.match(r"(0x[0-9a-f]+|\+\d+|-\d+|\*) (?:\d+|[+-]\d+|\*) (\d+)$", line):
                place, count = match.groups()
                if place.startswith("0x"):
                    address = int(place, 16)
                elif place != "*":
                    address += int(place)
                if not call:
                    counts[known.get(address, known.get(address - 0x400000, "elsewhere"))] += int(
                        count
                    )
                call = False
        return counts


def executed_by_qemu(kind: str, steps: int, known: dict[int, str]) -> collections.Counter[str]:
    """Instructions by kind in a run of so many steps, each a line of what qemu tells."""
    command = ["qemu-aarch64", "-singlestep", "-L", f"/usr/{TOOLS}", "-d", "exec,nochain"]
    command += ["-D", "/dev/stdout", binary(True), kind, str(steps)]
    counts: collections.Counter[str] = collections.Counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout or ():
            if line.startswith("Trace"):
                address = int(line.split("/")[1], 16)
                counts[known.get(address - BASE, "elsewhere")] += 1
    return counts


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Counts the instructions of a physics step.")
    parser.add_argument("--neon", action="store_true", help="of the code for aarch64, under qemu")
    neon = parser.parse_args().neon
    known = kinds(neon)
    count, steps = (executed_by_qemu, (2, 4)) if neon else (executed, (20, 120))
    for kind, arms in (("one", 1), ("lanes", 8)):
        few, many = (count(kind, number, known) for number in steps)
        each = {name: (many[name] - few[name]) / (steps[1] - steps[0]) for name in many}
        print(f"{kind}: instructions a step of {arms}, {'NEON' if neon else 'AVX2'}")
        for name, number in sorted(each.items(), key=lambda item: -item[1]):
            print(f"  {name:10} {number:12,.0f}")


if __name__ == "__main__":
    main()
