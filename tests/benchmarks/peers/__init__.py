"""The same closed loop in other tools, one file each; `PEERS` lists them in the order of the table."""

from __future__ import annotations

from importlib import import_module

from tests.benchmarks.peer import Peer

PEERS = (
    "ours_compiled",
    "ours_interpreted",
    "cpp_pinocchio",
    "jax_by_hand",
    "jax_arrays",
    "jaxonomy_blocks",
    "jaxonomy_arrays",
    "mujoco_callback",
    "mujoco_euler",
    "drake_diagram",
    "numpy_pinocchio",
    "pathsim_blocks",
    "bdsim_blocks",
    "python_control",
)


def find(key: str) -> type[Peer]:
    """The tool of that module; its import needs no optional package."""
    found: type[Peer] = import_module(f"tests.benchmarks.peers.{key}").Loop
    return found
