from __future__ import annotations

import gc
import os
import re
import signal
import threading
from collections.abc import Iterator
from fnmatch import translate
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from flint import fmpz
from hypothesis import settings
from hypothesis.internal.conjecture import providers

from dmframe.block import AbstractBlock, steady
from dmframe.exact import primes

os.environ.setdefault(
    "OPENBLAS_NUM_THREADS", "1"
)  # before NumPy is loaded: a second thread mostly waits, and workers share the cores
gc.disable()  # until all tests are collected: objects of the collection stay
# Hypothesis would read all our modules for constants to try: seconds for each worker, and examples that depend on
# previous imports.
providers._get_local_constants = lambda: providers._local_constants
settings.register_profile("without deadlines", deadline=None)  # a busy machine is not a fault
settings.load_profile("without deadlines")


@pytest.fixture(scope="session", autouse=True)
def _compiled_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """One cache of compiled loops for the whole session and all its workers, separate from the user's."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "compiled"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DMFRAME_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="session", autouse=True)
def _checked_once() -> Iterator[None]:
    """A packaged block's methods are evaluated with other numbers once per set of options, numbers and sizes.

    For other blocks this is repeated for other expressions; with validators each time, since they may store numbers
    anywhere.
    """
    hooks, key = steady._hooks, steady._key

    def packaged(kind: type) -> bool:
        return kind.__module__.startswith("dmframe_blocks.")

    def key_of(statement: str, block: AbstractBlock, first: Any) -> Any:
        sizes = SimpleNamespace(text=repr([(name, part[1]) for name, part in first._parts.items()]))
        return key(statement, block, sizes if packaged(type(block)) else first)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(steady, "_hooks", lambda kind: not packaged(kind) and hooks(kind))
        patch.setattr(steady, "_key", key_of)
        yield


@pytest.fixture(scope="session", autouse=True)
def _probable_primes() -> Iterator[None]:
    """Proofs use probable primes, none of which is known to be composite: a proof takes 2 ms, thousands of times."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(primes, "is_prime", lambda number: bool(fmpz(number).is_probable_prime()))
        yield


@pytest.fixture(scope="session", autouse=True)
def _interruptible() -> None:
    """Ctrl-C reaches processes started by tests, also from a suite in the background of a shell, which ignores it."""
    ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    if ignored and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)


THOROUGH = Path(__file__).with_name("thorough.txt")
"""Tests of ``make thorough`` that ``make test`` omits; the file lists those without a faster instance there."""

BUT = " but "
"""A test with all its instances in that list, except those that follow, with ``|`` between them."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the tests of that list; a name or a pattern without a test in a whole collection is a fault."""
    lines = [line.strip() for line in THOROUGH.read_text(encoding="utf-8").splitlines()]
    lines = [line for line in lines if line and not line.startswith("#")]
    but = dict(line.split(BUT) for line in lines if BUT in line)
    kept = {name: {f"{name}[{instance}]" for instance in found.split(" | ")} for name, found in but.items()}
    patterns = [line for line in lines if BUT not in line]
    plain = {pattern for pattern in patterns if not set("*?") & set(pattern)}
    shapes = {pattern: translate(pattern.replace("[", "[[]")) for pattern in patterns if pattern not in plain}
    any_of, left = re.compile("|".join(shapes.values())), {line: re.compile(shape) for line, shape in shapes.items()}
    unused = plain.union(*kept.values())
    for item in items:
        name = item.nodeid
        if (of := name.partition("[")[0]) in kept:
            unused.discard(name)
            if name in kept[of]:
                continue
        elif name in plain:
            unused.discard(name)
        elif not any_of.match(name):
            continue
        item.add_marker(pytest.mark.thorough)
        left = {line: shape for line, shape in left.items() if not shape.match(name)}
    unused |= left.keys()
    if unused and config.args == config.getini("testpaths"):
        raise pytest.UsageError(f"{THOROUGH.name}: no test is called {', '.join(sorted(unused))}")


def pytest_collection_finish() -> None:
    """Rarer garbage collections, without permanent objects: a proof creates 10^5 small objects and no garbage."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(200_000, 20, 20)
    gc.enable()
