"""URDF files of random serial chains."""

from __future__ import annotations

from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np

ODD: Final = ("no", "1e3", "joint.{}", "axis {}", "Gelenk-ä{}", "a:b", "q_{}", "arm", "path", "null")
"""Names that a YAML reader or a graph may take for something else."""


def random_chain(folder: Path, seed: int, *, sliding: float = 0.2, untidy: bool = False) -> Path:
    """A robot of 4 to 7 axes with random axes, frames, limits and inertia; a quarter of the links have none.

    `sliding` is the probability that a joint is prismatic. An untidy file has odd names, and a part of its joints has
    no limits, or a zero velocity.
    """
    random, other = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    count, scale = int(random.integers(4, 8)), 10.0 ** random.uniform(-1, 1)
    names = [f"j{k}" for k in range(1, count + 1)]
    if untidy:
        names = [str(name).format(k) for k, name in enumerate(other.permutation(ODD)[:count], 1)]
    text = '<robot name="made"><link name="l0"/>'
    for k, name in enumerate(names, 1):
        kind = random.choice(["revolute", "prismatic", "continuous"], p=[0.85 - sliding, sliding, 0.15])
        lower = random.uniform(-2.5, 0.5) * (0.2 if kind == "prismatic" else 1)
        upper = lower + random.uniform(0.5, 4.0) * (0.2 if kind == "prismatic" else 1)
        between = "" if kind == "continuous" else f'lower="{lower:.3f}" upper="{upper:.3f}" '
        limit = (
            f'<limit {between}velocity="{random.uniform(0.5, 4):.3f}" effort="{scale * random.uniform(5, 100):.3f}"/>'
        )
        if untidy:
            bare = "" if kind == "continuous" else '<limit lower="0" upper="0" velocity="0" effort="0"/>'
            limit = str(other.choice([limit, bare], p=[0.7, 0.3]))
        mass, size = scale * random.uniform(0.2, 1.0), random.uniform(0.02, 0.4, 3)
        points = size * random.normal(size=(6, 3))
        second = mass / 6 * points.T @ points
        moments = np.trace(second) * np.eye(3) - second
        places = ("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2)
        inertia = " ".join(f'{key}="{moments[i, j]:.9f}"' for key, i, j in places)
        inertial = (
            f'<inertial><origin xyz="{_row(random.uniform(-0.1, 0.1, 3))}" rpy="{_row(random.uniform(-3, 3, 3))}"/>'
            f'<mass value="{mass:.6f}"/><inertia {inertia}/></inertial>'
        )
        text += (
            f'<link name="l{k}">{"" if random.random() < 0.25 else inertial}</link><joint name={quoteattr(name)} '
            f'type="{kind}"><parent link="l{k - 1}"/><child link="l{k}"/><axis xyz="{_row(random.normal(size=3))}"/>'
            f'{limit}<origin xyz="{_row(random.uniform(-0.4, 0.4, 3))}" rpy="{_row(random.uniform(-3, 3, 3))}"/>'
            "</joint>"
        )
    path = folder / "made.urdf"
    path.write_text(f"{text}</robot>", encoding="utf-8")
    return path


def _row(values: np.ndarray) -> str:
    return " ".join(f"{value:.6f}" for value in values)
