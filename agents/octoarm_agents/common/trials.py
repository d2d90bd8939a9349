"""Independent trials: run side by side, kept on disk as they finish, taken up again later."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from octoarm_agents.common.files import write_json
from octoarm_agents.common.lanes import LANES
from octoarm_agents.common.progress import progress_bar
from octoarm_agents.common.provenance import code_digest, package_versions
from octoarm_agents.common.workers import Cluster, Jobs, map_unordered, number_of
from octoarm_env import ArmParameters

Trial = Callable[..., dict[str, Any]]
Settings = Mapping[str, Any]
Record = Callable[[ArmParameters, Sequence[Settings]], Sequence[Any]]


def run_trials(
    function: Trial,
    parameters: ArmParameters,
    settings: Sequence[Settings],
    *,
    folder: Path,
    record: Record | None = None,
    jobs: Jobs = 1,
    fresh: bool = False,
    progress: bool | None = None,
    description: str = "trials",
) -> list[dict[str, Any]]:
    """Call ``function(parameters, **settings)`` for all settings, in processes or on a cluster.

    Every result is written to `folder` as soon as its trial is finished. A later call with the same
    function, body, settings and code takes it from there, so that an interrupted run loses at
    most the trials under way: one in each process, or with `record` some that it has begun together
    and not yet finished. On a cluster a trial is finished when its result has arrived here; those
    that are recorded together arrive together. Results do not depend on `jobs`: a trial knows its
    own settings only, and computes with one thread.

    Args:
        function: at the top level of a module; what it returns must fit into JSON, and it must
            depend on its arguments alone.
        parameters: the body.
        settings: keyword arguments of each trial, which must fit into JSON.
        folder: for the finished trials; made if it is not there.
        record: computes together what several trials need: from the body and the settings of each,
            a list with the argument ``recording`` of each. It must be in the module of `function`
            and give what the trial computes by itself without that argument, to the bit, whatever
            trials it is called with.
        jobs: processes, or a cluster.
        fresh: compute every trial anew, whatever `folder` holds.
        progress: as `shown` of `octoarm_agents.common.progress.progress_bar`.
        description: of the bar.

    Returns:
        The results in the order of `settings`, as they read in JSON.

    Raises:
        ValueError: fewer than one job, or a result with numbers that are not finite.
    """
    at_once = number_of(jobs)
    folder.mkdir(parents=True, exist_ok=True)
    fingerprints = [_fingerprint(function, parameters, each) for each in settings]
    texts = [json.dumps(each, sort_keys=True).encode() for each in fingerprints]
    files = [folder / f"{hashlib.sha256(text).hexdigest()[:24]}.json" for text in texts]
    stored = [] if fresh else map(_read, files, fingerprints)
    results = {index: result for index, result in enumerate(stored) if result is not None}
    missing: list[tuple[int, tuple[Settings, Path | None, dict[str, Any]]]] = [
        each
        for each in enumerate(zip(settings, files, fingerprints, strict=True))
        if each[0] not in results
    ]
    # Without `record` every trial is a share of its own.
    shares = share_out(len(missing), len(missing) if record is None else at_once)
    on_cluster = isinstance(jobs, Cluster)
    if on_cluster:  # Its nodes have no such folder.
        missing = [(index, (given, None, marks)) for index, (given, _, marks) in missing]
    calls = [(function, parameters, record, missing[each]) for each in shares]
    with progress_bar(len(settings), description, initial=len(results), shown=progress) as bar:
        for _, finished in map_unordered(_run_share, calls, jobs):
            if on_cluster:
                for index, result in finished.items():
                    _write(files[index], fingerprints[index], result)
            results |= finished
            bar.update(len(finished))
    return [results[index] for index in range(len(settings))]


def share_out(count: int, jobs: int) -> list[slice]:
    """Divide runs into shares that are computed together: even ones, so that no process idles.

    Args:
        count: number of runs.
        jobs: processes.

    Returns:
        The shares, in order; each of at most `LANES` runs and of at most count / jobs, rounded up.
    """
    if count == 0:
        return []
    rounds = math.ceil(count / (jobs * LANES))
    size = math.ceil(count / (jobs * rounds))
    return [slice(begin, min(begin + size, count)) for begin in range(0, count, size)]


def _run_share(
    function: Trial,
    parameters: ArmParameters,
    record: Record | None,
    share: Sequence[tuple[int, tuple[Settings, Path | None, dict[str, Any]]]],
) -> dict[int, dict[str, Any]]:
    """Some trials, where they are computed: what is finished is stored at once, with a file."""
    from threadpoolctl import threadpool_limits

    results = {}
    # Sums split over threads are rounded otherwise; and the processes are what fills the machine.
    with threadpool_limits(1):
        known: list[dict[str, Any]] = [{} for _ in share]
        if record is not None:
            recordings = record(parameters, [settings for _, (settings, _, _) in share])
            known = [{"recording": recording} for recording in recordings]
        for (index, (settings, file, fingerprint)), more in zip(share, known, strict=True):
            result = function(parameters, **settings, **more)
            if file is not None:
                _write(file, fingerprint, result)
            # As a later run would read it.
            results[index] = json.loads(json.dumps(result))
    return results


def _fingerprint(function: Trial, parameters: ArmParameters, settings: Settings) -> dict[str, Any]:
    """All that a trial's result depends on."""
    fingerprint = {
        "function": f"{function.__module__}.{function.__qualname__}",
        "settings": dict(settings),
        "body": parameters.to_dict(),
        "versions": package_versions(
            "octoarm-env", "octoarm-agents", "numpy", "scipy", "scikit-learn", "reservoirpy"
        ),
        "code": code_digest(function.__module__),
    }
    # Tuples become lists, as in the file that this is compared with.
    compared: dict[str, Any] = json.loads(json.dumps(fingerprint, allow_nan=False))
    return compared


def _write(file: Path, fingerprint: dict[str, Any], result: dict[str, Any]) -> None:
    write_json(file, {"fingerprint": fingerprint, "result": result})


def _read(file: Path, fingerprint: dict[str, Any]) -> dict[str, Any] | None:
    """A stored result; None if there is none, or the file is damaged or of another trial."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return None
    if not isinstance(content, dict) or content.get("fingerprint") != fingerprint:
        return None
    result: dict[str, Any] = content["result"]
    return result
