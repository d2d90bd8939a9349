"""What the tests of pictures, films and shows share."""

from contextlib import contextmanager

import pytest
from octoarm_agents.cli.policy_names import find_policy
from octoarm_agents.viewing.episode import Episode

from octoarm_env import ArmParameters

SMALL = ("--width", 160, "--height", 120)


def make_episode(name, *, arm=None, steps=30, seed=0, policy=None, **settings):
    """An episode of a policy by its name, or of another one where that is at home."""
    named = find_policy(str(name), arm)
    chosen = named.policy if policy is None else policy
    env = named.make_env(steps)
    return Episode(chosen, env, seed=seed, steps=steps, title=str(name), **settings)


def play(episode):
    while not episode.ended:
        episode.step()
    return episode


def write_headstand(folder):
    """A body that stands on its base, too heavy for that: it leaves its domain within 3 s."""
    ArmParameters(gravity=(0.0, 0.0, -70.0)).to_json(folder / "headstand.json")
    return folder / "headstand.json"


def interrupt_at(monkeypatch, step):
    """Let Ctrl-C be pressed when an episode has made so many steps."""
    make_step = Episode.step

    def interrupted(self):
        if self.steps_made == step:
            raise KeyboardInterrupt
        return make_step(self)

    monkeypatch.setattr(Episode, "step", interrupted)


@contextmanager
def full_disk(size):
    """Files may not grow beyond so many bytes."""
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
