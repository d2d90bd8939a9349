"""Policies by the names that the command line knows, and where they are at home."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from octoarm_agents.cli.options import read_body, refused

if TYPE_CHECKING:
    from octoarm_agents.policies.evaluation import Trivial
    from octoarm_agents.policies.rollout import PolicyPredictor
    from octoarm_env import ArmParameters, OctoArmVectorEnv


POLICY_HELP = (
    "File of an agent (.npz), AGENT/TARGET for one that comes along, or clock/TARGET, hold/TARGET."
)
PolicyName = Annotated[str, typer.Argument(help=POLICY_HELP, show_default=False)]


@dataclasses.dataclass(frozen=True)
class NamedPolicy:
    """A policy and its home.

    Attributes:
        name: as it was asked for.
        policy: what acts.
        parameters: the body.
        settings: the environment's, `octoarm_agents.common.environment.SETTINGS`.
    """

    name: str
    policy: PolicyPredictor | Trivial
    parameters: ArmParameters
    settings: dict[str, Any]

    def make_env(self, steps: int) -> OctoArmVectorEnv:
        """Make the environment, one for itself, for episodes of so many steps."""
        from octoarm_agents.common.environment import make_vector_env

        with refused("--arm"):  # a body that cannot swing along the target
            return make_vector_env(1, self.parameters, self.settings, steps=steps, threads=1)


def find_policy(name: str, arm: Path | None) -> NamedPolicy:
    """Find a policy by its name, on its own body or on that in a file.

    Raises:
        typer.BadParameter: there is no such policy, or it does not fit the body.
    """
    from octoarm_agents.common.environment import ENV_ID, TARGETS, inspect_env
    from octoarm_agents.policies import load_policy, trained_agents
    from octoarm_agents.policies.evaluation import NAMED

    trained = {"/".join(key): file for key, file in trained_agents().items()}
    trivial = {f"{kind}/{target}": (kind, target) for kind in NAMED for target in TARGETS}
    file = Path(name)
    if name in trivial and not file.exists():
        import gymnasium as gym

        kind, target = trivial[name]
        body = read_body(arm)
        with refused("--arm"):
            home = inspect_env(gym.make(ENV_ID, arm=body, target=target))
        return NamedPolicy(name, kind, *home)
    if not file.exists():
        if name not in trained and file.suffix != ".npz":
            known = ", ".join((*trained, *trivial))
            raise typer.BadParameter(f"{name!r} is neither a file nor one of {known}.")
        file = trained.get(name, file)
    with refused():
        policy = load_policy(file)
    body, own = policy.parameters if arm is None else read_body(arm), policy.parameters
    if body.compartments != own.compartments:
        raise typer.BadParameter(
            f"{arm} has {body.compartments} compartments, the agent is for a body with "
            f"{own.compartments}.",
            param_hint="'--arm'",
        )
    return NamedPolicy(name, policy, body, dict(policy.settings))
