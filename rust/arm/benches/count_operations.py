"""Counts the floating-point instructions of a physics step, by kind, under valgrind.

    python rust/arm/benches/count_operations.py

Callgrind counts every instruction of the AVX2 kernel (it knows no AVX-512); objdump says what each
is. Counted are the steps between a short run and a longer one. An instruction on four arms of the
eight in lanes is one on all eight with AVX-512, so that the count is halved for that.
"""

import collections
import functools
import json
import os
import re
import subprocess
import tempfile
from pathlib import Path

STEPS = (20, 120)
KINDS = {
    "fused": r"vf[n]?m(add|sub)\d+[ps]d",
    "multiply": r"vmul[ps]d",
    "add": r"v(add|sub)[ps]d",
    "divide": r"vdiv[ps]d",
    "root": r"vsqrt[ps]d",
}


@functools.cache
def binary() -> str:
    """Build what makes the steps, and say where it is."""
    build = ["cargo", "bench", "-p", "octoarm-arm", "--bench", "steps", "--no-run"]
    text = subprocess.run(
        [*build, "--message-format=json"], stdout=subprocess.PIPE, text=True, check=True
    ).stdout
    built = [json.loads(line).get("executable") for line in text.splitlines()]
    return str(next(path for path in built if path))


def kinds() -> dict[int, str]:
    """Kind of every floating-point instruction by its address, and whether it is packed."""
    text = subprocess.run(
        ["objdump", "-d", "--no-show-raw-insn", binary()],
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
    """Instructions by kind in a run of so many steps."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        subprocess.run(
            [
                "valgrind",
                "--tool=callgrind",
                "--dump-instr=yes",
                f"--callgrind-out-file={out}",
                binary(),
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


def main() -> None:
    """Print the table."""
    known = kinds()
    for kind, arms in (("one", 1), ("lanes", 8)):
        few, many = (executed(kind, steps, known) for steps in STEPS)
        each = {name: (many[name] - few[name]) / (STEPS[1] - STEPS[0]) for name in many}
        print(f"{kind}: instructions a step of {arms}, AVX2")
        for name, count in sorted(each.items(), key=lambda item: -item[1]):
            print(f"  {name:10} {count:12,.0f}")


if __name__ == "__main__":
    main()
