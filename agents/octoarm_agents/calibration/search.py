"""The search for the body: CMA-ES (Hansen 2016, arXiv:1604.00772) over what the paper leaves open.

The search is deterministic: candidates follow from the seed and from the scores before them. So an
interrupted search is taken up by asking for the same candidates again, and giving the scores on
file for an answer.
"""

from __future__ import annotations

import functools
import hashlib
import itertools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cma
import numpy as np

from octoarm_agents.calibration.evaluation import (
    Evaluation,
    append_evaluations,
    read_evaluations,
)
from octoarm_agents.calibration.score import evaluate_bodies
from octoarm_agents.calibration.space import OPEN_PARAMETERS, SearchSpace
from octoarm_agents.common.progress import progress_bar
from octoarm_agents.common.provenance import code_digest, package_versions
from octoarm_agents.common.trials import share_out
from octoarm_agents.common.whole import whole_number
from octoarm_agents.common.workers import Jobs, map_unordered, number_of
from octoarm_env.arrays import Float

POPULATION = 12
"""Candidates of a generation."""

INITIAL = 500
"""T_ini of Task 1."""


def search_bodies(
    spaces: Sequence[SearchSpace],
    *,
    evaluations: int,
    file: Path,
    amplitudes: Mapping[str, float] | None = None,
    noise_seeds: int = 0,
    seed: int = 0,
    jobs: Jobs = 1,
) -> list[Evaluation]:
    """Search every space for the body with the lowest score, all at the same pace.

    Every evaluation is written to `file` with its generation. A later call with the same spaces,
    seed and code goes on from there; a call with more evaluations too. Others' evaluations in the
    file stay as they are. Results do not depend on `jobs`.

    Args:
        spaces: each is searched by itself; they differ in their readings only.
        evaluations: bodies tried in each space.
        file: of the evaluations; its folder must exist.
        amplitudes: R by cycle, see `evaluate_bodies`.
        noise_seeds: trainings of each limit cycle, see `evaluate_bodies`.
        seed: of the search.
        jobs: processes, or a cluster.

    Returns:
        The evaluations of these searches, in the order in which they are tried.

    Raises:
        ValueError: a setting out of its range, or a file of something else.
        OSError: the file cannot be read or written.
    """
    evaluations, at_once = whole_number("evaluations", evaluations, 1), number_of(jobs)
    noise_seeds, seed = whole_number("noise_seeds", noise_seeds), whole_number("seed", seed)
    if not spaces:
        raise ValueError("spaces is empty: expected at least one")
    if any(space.base != spaces[0].base for space in spaces):
        raise ValueError("spaces: expected the same base in each")
    judge: dict[str, Any] = {
        "initial": INITIAL,
        "amplitudes": dict(amplitudes or {}),
        "noise_seeds": noise_seeds,
    }
    stored = read_evaluations(file)
    searches = [_Search(space, judge, seed, stored) for space in spaces]
    results: list[Evaluation] = []
    evaluate = functools.partial(evaluate_bodies, **judge)
    with progress_bar(evaluations * len(spaces), "bodies") as bar:
        for begin in range(0, evaluations, POPULATION):
            asked = [
                evaluation
                for search in searches
                for evaluation in search.ask(min(POPULATION, evaluations - begin))
            ]
            new = [each for each in asked if math.isnan(each.score)]
            bodies = [spaces[0].base.replace(**each.body) for each in new]
            calls = [(bodies[share],) for share in share_out(len(new), at_once)]
            judged = dict(map_unordered(evaluate, calls, jobs))
            in_order = itertools.chain.from_iterable(judged[index] for index in range(len(calls)))
            for evaluation, found in zip(new, in_order, strict=True):
                vars(evaluation).update(vars(found))
            append_evaluations(file, new)
            for search in searches:
                search.tell()
            results += asked
            bar.update(len(asked))
            bar.set_postfix(best=f"{min(each.score for each in results):.3f}")
    return results


class _Search:
    """CMA-ES in one space, fed from file where it can be.

    Where it has converged it begins again, from a random body.
    """

    def __init__(
        self,
        space: SearchSpace,
        judge: Mapping[str, Any],
        seed: int,
        stored: Sequence[Evaluation],
    ) -> None:
        self.space = space
        self._seed = seed
        self._digest = _digest(space, judge, seed)
        self._stored = {each.index: each for each in stored if each.search == self._digest}
        self._random = np.random.default_rng(seed)
        self._count = 0
        self._strategy = self._begin(np.array(space.begin))
        self._candidates: list[Float] = []
        self._asked: list[Evaluation] = []

    def ask(self, count: int) -> list[Evaluation]:
        """The next candidates, at most a generation; those on file with their scores.

        Raises:
            ValueError: the file holds another body in the place of a candidate.
        """
        if self._strategy.stop():
            self._strategy = self._begin(self._random.uniform(size=len(self.space.begin)))
        self._candidates = self._strategy.ask()
        self._asked = []
        for candidate in self._candidates[:count]:
            body = self.space.changes(candidate)
            evaluation = self._stored.get(self._count)
            if evaluation is None:
                evaluation = Evaluation(
                    search=self._digest, seed=self._seed, index=self._count, body=body
                )
            elif evaluation.body != body:
                raise ValueError(
                    f"evaluation {self._count} of search {self._digest} on file is of another"
                    " body than the search tries: the file has been changed"
                )
            self._asked.append(evaluation)
            self._count += 1
        return self._asked

    def tell(self) -> None:
        """Learn from the generation asked for; from a part of one, the last, nothing is learnt."""
        if len(self._asked) == len(self._candidates):
            self._strategy.tell(self._candidates, [each.score for each in self._asked])

    def _begin(self, mean: Float) -> Any:
        # Numbers from a generator of its own: by itself the library seeds that of all of NumPy.
        return cma.CMAEvolutionStrategy(
            mean,
            1.0,
            {
                "CMA_stds": self.space.spreads,
                "randn": lambda *shape: self._random.normal(size=shape),
                "seed": np.nan,
                "popsize": POPULATION,
                "bounds": [0.0, 1.0],
                "verbose": -9,
            },
        )


def _digest(space: SearchSpace, judge: Mapping[str, Any], seed: int) -> str:
    """Digest of all that a search's evaluations depend on."""
    content = {
        "space": asdict(space),
        "parameters": OPEN_PARAMETERS,
        "judge": judge,
        "seed": seed,
        "versions": package_versions("cma", "numpy", "scipy", "scikit-learn"),
        "code": code_digest(__name__),
    }
    text = json.dumps(content, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:24]
