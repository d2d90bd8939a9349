"""Readouts, agents and experiments for the soft robotic octopus arm of `octoarm_env`."""

__version__ = "0.1.0"
