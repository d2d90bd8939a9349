"""Independent calls, computed by processes of this machine or on a Ray cluster.

On a cluster they are plain Ray tasks. Ray's backend for joblib would have been shorter, but (in
Ray 2.60) it holds back all results until the last one is there, and it computes with actors: when
their node dies, it raises an error. A task whose node dies is begun again elsewhere by Ray itself.
"""

from __future__ import annotations

import itertools
import logging
import os
import socket
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from octoarm_agents.common.provenance import code_digest, package_versions
from octoarm_agents.common.whole import whole_number

Result = TypeVar("Result")

_RETRIES = 10
"""How often a call is begun again because its node or its process is lost."""

_PATIENCE = 10.0
"""Time that a cluster may take to answer at its address [s]."""

_PACKAGES = (
    *("octoarm-env", "octoarm-agents", "numpy", "scipy", "scikit-learn", "reservoirpy"),
    *("cma", "gymnasium", "torch", "stable-baselines3", "sb3-contrib"),
)


@dataclass(frozen=True)
class Cluster:
    """A Ray cluster that this process is connected to, until it ends or calls `ray.shutdown`.

    It shares no disk with this machine: what calls are to read is sent along, and they return what
    is to be kept. Its nodes must have these packages in the same versions.

    Attributes:
        jobs: how many calls are computed at once, each with one processor of its own.
    """

    jobs: int

    @classmethod
    def connect(cls, address: str = "auto", jobs: int | None = None) -> Cluster:
        """Connect to a cluster, unless this process is connected to one already.

        Args:
            address: as `ray.init` takes it: HOST:PORT, ray://HOST:PORT, or "auto": that of the
                environment variable RAY_ADDRESS, or the cluster that this machine belongs to.
            jobs: how many calls are computed at once; None: as many as there are processors now.

        Raises:
            ValueError: nothing answers at the address, or `jobs` is not positive.
            ModuleNotFoundError: Ray is not installed.
        """
        jobs = None if jobs is None else whole_number("jobs", jobs, 1)
        try:
            import ray
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                f'{error}. A cluster needs more packages: pip install "octoarm-agents[ray]"',
                name=error.name,
            ) from error
        if not ray.is_initialized():
            try:
                _knock(address)
                ray.init(address, log_to_driver=False, logging_level=logging.WARNING)
            except (OSError, ValueError) as error:
                raise ValueError(
                    f"cluster = {address!r}: no Ray cluster answers there: {error}"
                ) from None
        return cls(jobs or max(int(ray.cluster_resources().get("CPU", 1)), 1))


Jobs = int | Cluster
"""Where calls are computed: in so many processes of this machine, or on a cluster."""


def number_of(jobs: Jobs) -> int:
    """How many calls are computed at once.

    Raises:
        ValueError: processes that are no positive whole number.
    """
    return jobs.jobs if isinstance(jobs, Cluster) else whole_number("jobs", jobs, 1)


def map_unordered(
    function: Callable[..., Result], calls: Sequence[tuple[Any, ...]], jobs: Jobs
) -> Iterator[tuple[int, Result]]:
    """Call ``function(*call)`` for each of `calls`, and give the results as they come.

    An error of a call, and an interrupt, end the others. With one process they are computed here.

    Args:
        function: at the top level of a module, or a partial of one that is; it must depend on its
            arguments alone: on a cluster a call whose node is lost is computed again.
        calls: the arguments of each.
        jobs: where.

    Yields:
        The number of a call in `calls`, and its result; each once.
    """
    if isinstance(jobs, Cluster):
        yield from _map_on_cluster(function, calls, jobs)
        return
    from joblib import Parallel, delayed

    run = Parallel(n_jobs=max(min(jobs, len(calls)), 1), return_as="generator_unordered")
    yield from run(delayed(_call)(function, index, call) for index, call in enumerate(calls))


def _call(function: Callable[..., Result], index: int, call: tuple[Any, ...]) -> tuple[int, Result]:
    return index, function(*call)


def _map_on_cluster(
    function: Callable[..., Result], calls: Sequence[tuple[Any, ...]], cluster: Cluster
) -> Iterator[tuple[int, Result]]:
    import ray
    from ray.exceptions import RayTaskError

    task = ray.remote(num_cpus=1, max_retries=_RETRIES)(_call_alike)
    here = installed()
    left = enumerate(calls)
    begun: dict[Any, int] = {}
    try:
        while True:
            for index, call in itertools.islice(left, cluster.jobs - len(begun)):
                begun[task.remote(function, call, here)] = index
            if not begun:
                return
            ray.wait(list(begun), num_returns=1)
            # All that have ended by now: asking takes the longer, the more are under way.
            ended, _ = ray.wait(list(begun), num_returns=len(begun), timeout=0)
            for reference in ended:
                index = begun.pop(reference)
                try:
                    result = ray.get(reference)
                except RayTaskError as error:
                    raise error.cause from error
                yield index, result
    finally:
        for reference in begun:
            ray.cancel(reference, force=True)


def _call_alike(
    function: Callable[..., Result], call: tuple[Any, ...], expected: dict[str, str | None]
) -> Result:
    """On a node: call, but only with what the caller has installed, so that the bits are equal."""
    check_installed(expected)
    return function(*call)


def installed() -> dict[str, str | None]:
    """Versions of all packages that compute, and a digest of the code: for `check_installed`."""
    return package_versions(*_PACKAGES) | {"code": code_digest(__name__)}


def check_installed(expected: dict[str, str | None]) -> None:
    """On a node: raise a RuntimeError unless what is installed is what the caller has."""
    differing = {
        name: f"{version} instead of {expected[name]}"
        for name, version in installed().items()
        if version != expected[name]
    }
    if differing:
        raise RuntimeError(f"the node {socket.gethostname()} has other packages: {differing}")


def _knock(address: str) -> None:
    """Whether anything listens at an address; by itself Ray tries for many minutes.

    Raises:
        OSError: nothing does.
    """
    if address == "auto":
        address = os.environ.get("RAY_ADDRESS") or address
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if port.isdecimal():
        socket.create_connection((host.strip("[]"), int(port)), _PATIENCE).close()
