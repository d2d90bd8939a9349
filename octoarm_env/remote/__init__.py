"""The environment ``OctoArm-v0`` on a server, over gRPC.

Needs grpcio and protobuf: ``pip install "octoarm-env[remote]"``. A server is started by
``octoarm serve``; any server of the protocol dm_env_rpc with the arm's worlds will do.
"""

try:
    from octoarm_env.remote.connection import Connection, RemoteError
    from octoarm_env.remote.env import RemoteOctoArm
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        f'{error}. The remote environment needs more packages: pip install "octoarm-env[remote]"',
        name=error.name,
    ) from error

__all__ = ["Connection", "RemoteError", "RemoteOctoArm"]
