"""How long a step takes: arm, batch, environments, and their peers, in one run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from octoarm_agents.benchmark.contenders import (
    ARM,
    ARM_DRY,
    ARM_SERVO,
    ASYNC,
    BATCH,
    ENV_BARE,
    ENV_MADE,
    HALVES,
    LIMIT,
    PHYSICS_STEPS,
    REACH,
    RESETS,
    RESETS_ANY,
    RESETS_OWN,
    SYNC,
    TWIN,
    WEB,
    batch_name,
    elsewhere_name,
    make_contenders,
    other_instruction_sets,
    vector_name,
)
from octoarm_agents.benchmark.programs import node
from octoarm_agents.benchmark.turns import (
    NOT_INSTALLED,
    Advance,
    Comparison,
    Result,
    has_mujoco,
    take_turns,
)
from octoarm_env import OctoArmVectorEnv, instruction_set

MEMORY_ENVS = 4096


def measure_speed(
    seconds: float = 30.0, rounds: int = 11, advance: Advance | None = None
) -> Result:
    """Time all contenders; peers only where they are installed.

    Args:
        seconds: time for all slices together; making the contenders comes on top.
        rounds: slices of each contender.
        advance: called with a contender's name and the number of slices in all, after each slice.
    """
    memory = _memory_per_environment()
    result = take_turns(make_contenders(), seconds, rounds, advance)
    result.comparisons = comparisons(2 if batch_name(BATCH, 2) in result.figures else 1)
    result.left_out = {} if has_mujoco() else {TWIN: NOT_INSTALLED}
    if node() is None:
        result.left_out[WEB] = "there is no node on the path"
    result.more = {"bytes_per_vector_sub_environment": memory}
    result.packages = ["mujoco"]
    return result


def comparisons(threads: int) -> list[Comparison]:
    """What is compared where so many threads were measured, 1 or 2."""
    batch, vector = batch_name(BATCH, threads), vector_name(BATCH, threads)
    alone, dry = vector_name(BATCH, 1), batch_name(BATCH, 1, dry=True)
    batches = {instruction_set(): dry}
    batches |= {each: elsewhere_name(each) for each in other_instruction_sets()}
    pairs = [
        ("twin_over_arm", "MuJoCo twin / one arm, same physics", TWIN, ARM_DRY),
        ("twin_over_wet_arm", "MuJoCo twin / one arm in water", TWIN, ARM),
        *(
            (f"twin_over_batch_{name}", f"MuJoCo twin / batch of {BATCH}, {name}", TWIN, own)
            for name, own in batches.items()
        ),
        ("arm_over_batch", f"one arm / batch of {BATCH}", ARM_DRY, dry),
        ("web_over_arm", "one arm, WebAssembly / native", WEB, ARM),
        ("batch_threads", f"ArmBatch of {BATCH}: 1 / 2 threads", batch_name(BATCH, 1), batch),
        ("vector_threads", f"OctoArmVectorEnv of {BATCH}: 1 / 2 threads", alone, vector),
        ("threads_limit", f"the same of {BATCH // 2} twice, a thread each", alone, HALVES),
        ("sync_over_vector", f"SyncVectorEnv / {vector}", SYNC, vector),
        ("sync_over_vector_1", "SyncVectorEnv / the same, 1 thread", SYNC, alone),
        ("resets_any_over_own", "16 bodies: reset onto any / onto its own", RESETS_ANY, RESETS_OWN),
        ("resets_any_over_one", "reset onto any of 16 bodies / of one", RESETS_ANY, RESETS),
        ("reaching_over_vector", "a physics step with muscles / without", REACH, alone),
        ("async_over_vector", f"AsyncVectorEnv / {vector}", ASYNC, vector),
    ]
    found = [Comparison(*pair) for pair in pairs]
    for count in sorted({1, threads}):
        own, name = batch_name(BATCH, count), vector_name(BATCH, count)
        label = f"{name}: speed over the bare batch's"
        found.append(Comparison(f"vector_share_{count}_threads", label, own, name, "%"))
    for key, name in (("batch", batch_name(BATCH, 1)), ("arm", ARM)):
        label = f"{name}: share of what the processor's multiplications allow"
        found.append(Comparison(f"limit_over_{key}", label, LIMIT, name, "%"))
    for key, name in (("bare", ENV_BARE), ("made", ENV_MADE)):
        label = f"{name} beyond its {PHYSICS_STEPS} physics steps"
        beyond = Comparison(f"overhead_{key}", label, name, ARM_SERVO, "µs", factor=PHYSICS_STEPS)
        found.append(beyond)
    return found


def _memory_per_environment() -> float | None:
    """Resident bytes that an environment of a large native batch adds; None: no system tells.

    Measured in a process of its own, which has no memory left over from anything else.
    """
    if not _STATM.exists():
        return None
    code = f"from {__name__} import measure_memory; print(measure_memory({MEMORY_ENVS}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(done.stdout)


def measure_memory(count: int) -> float:
    """Make a native batch in this process, and give the resident bytes of an environment."""
    # The swing's snapshots, which all share, are there before.
    first = OctoArmVectorEnv(1)
    before = _resident_bytes()
    envs = OctoArmVectorEnv(count)
    envs.reset(seed=0)
    after = _resident_bytes()
    first.close()
    envs.close()
    return (after - before) / count


_STATM = Path("/proc/self/statm")


def _resident_bytes() -> int:
    return int(_STATM.read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
