"""What acts, by the names that the command line knows, and where it is at home."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from octoarm_agents.cli.options import read_body

if TYPE_CHECKING:
    import gymnasium as gym

    from octoarm_agents.policies import Policy
    from octoarm_agents.policies.evaluation import Trivial
    from octoarm_env import ArmParameters

__all__ = ["ACTOR_HELP", "Actor", "find_actor"]

ACTOR_HELP = (
    "File of an agent (.npz), AGENT/TARGET for one that comes along, or clock/TARGET, hold/TARGET."
)


@dataclasses.dataclass(frozen=True)
class Actor:
    """An agent and its environment.

    Attributes:
        name: as it was asked for.
        policy: the agent; None: nobody yet.
        parameters: the body.
        settings: the environment's, `octoarm_agents.common.environment.SETTINGS` or some of them.
    """

    name: str
    policy: Policy | Trivial | None
    parameters: ArmParameters
    settings: dict[str, Any]

    def make_env(self, steps: int) -> gym.Env[Any, Any]:
        """Make the environment, for episodes of so many steps."""
        import gymnasium as gym

        from octoarm_agents.common.environment import ENV_ID

        try:
            return gym.make(ENV_ID, max_episode_steps=steps, arm=self.parameters, **self.settings)
        except (TypeError, ValueError) as error:  # a body that cannot swing along the target
            raise typer.BadParameter(f"{error}.", param_hint="'--arm'") from None


def find_actor(name: str, arm: Path | None) -> Actor:
    """Find an agent by its name, on its own body or on that in a file.

    Raises:
        typer.BadParameter: there is no such agent, or it does not fit the body.
    """
    from octoarm_agents.common.environment import TARGETS
    from octoarm_agents.policies import load_policy, trained_agents
    from octoarm_agents.policies.evaluation import TRIVIAL

    trained = {"/".join(key): file for key, file in trained_agents().items()}
    trivial = {f"{kind}/{target}": (kind, target) for kind in TRIVIAL for target in TARGETS}
    file = Path(name)
    if not file.exists():
        if name in trivial:
            kind, target = trivial[name]
            return Actor(name, kind, read_body(arm), {"target": target})
        if name not in trained and file.suffix != ".npz":
            known = ", ".join((*trained, *trivial))
            raise typer.BadParameter(f"{name!r} is neither a file nor one of {known}.")
        file = trained.get(name, file)
    try:
        policy = load_policy(file)
    except OSError as error:
        raise typer.BadParameter(f"cannot read {name}: {error.strerror}.") from None
    except ValueError as error:
        raise typer.BadParameter(f"{error}.") from None
    body = policy.parameters
    if arm is not None:
        body = read_body(arm)
        if body.compartments != policy.parameters.compartments:
            raise typer.BadParameter(
                f"{arm} has {body.compartments} compartments, the agent is for a body with "
                f"{policy.parameters.compartments}.",
                param_hint="'--arm'",
            )
    return Actor(name, policy, body, dict(policy.settings))
