"""A batch of arms that is told what to do line by line: ``prepare``, a number of steps, ``end``.

The vector instructions are chosen once a process, by the environment variable
``OCTOARM_INSTRUCTION_SET``; so a benchmark of several of them needs a process for each.
"""

from __future__ import annotations

import sys

from octoarm_agents.benchmark.contenders import BATCH, batch, dry_body
from octoarm_env import LIMIT_CYCLES

__all__: list[str] = []


def main() -> None:
    """Do as standard input says, and answer every line with ``done``."""
    contender = batch(dry_body(), BATCH, LIMIT_CYCLES["quadratic"].signal(20_000, 20.0))
    for line in sys.stdin:
        word = line.strip()
        if word == "prepare":
            contender.prepare()
        elif word != "end":
            contender.run(int(word))
        sys.stdout.write("done\n")
        sys.stdout.flush()
        if word == "end":
            break


if __name__ == "__main__":
    main()
