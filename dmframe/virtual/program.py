"""Execution of a script: its threads are resumed once in each cycle of the robot."""

from __future__ import annotations

import math
import operator
import traceback
from collections.abc import Callable, Generator
from contextlib import suppress
from types import GeneratorType
from typing import TYPE_CHECKING, Any, Final, cast, final

from dmframe.common.errors import DmframeError
from dmframe.virtual.arithmetic import Pose, is_number
from dmframe.virtual.budget import (
    COUNTED,
    MOST_STORED,
    MOST_THREADS,
    RATE,
    SECONDARY_FRACTION,
    Budget,
    copied,
    elements,
)
from dmframe.virtual.functions import Functions, Halted, names_of, waiting_of
from dmframe.virtual.urscript import transpiled
from dmframe.virtual.words import ScriptError

if TYPE_CHECKING:
    from dmframe.virtual.robot import VirtualRobot

MOST_INTEGER: Final = (1 << 31) - 1
FILE: Final = "<script>"

_SIGNS: Final[dict[str, Callable[[Any, Any], Any]]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "%": math.fmod,
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
}


@final
class Thread:
    """A thread of a script: a generator that is resumed once a cycle."""

    def __init__(self, name: str, steps: Generator[None, None, Any]) -> None:
        self.name, self.alive, self._steps = name, True, steps

    def resume(self) -> None:
        """Run it until it waits for the next cycle, or ends."""
        try:
            next(self._steps)
        except StopIteration:
            self.alive = False

    def close(self) -> None:
        """End it."""
        self.alive = False
        with suppress(ValueError):  # a thread that kills itself runs on until it waits
            self._steps.close()

    @property
    def stored(self) -> list[Any]:
        """Variables of all active calls."""
        found, steps = list[Any](), cast(Any, self._steps)
        while isinstance(steps, GeneratorType):
            found += [] if steps.gi_frame is None else steps.gi_frame.f_locals.values()
            steps = steps.gi_yieldfrom
        return found


@final
class Program:
    """Running script. Its threads run in the order in which they began, each once a cycle, until it waits.

    Raises
    ------
    ScriptError
        The text is not valid URScript, or uses a construct that is not supported.
    """

    def __init__(self, text: str, robot: VirtualRobot) -> None:
        found = transpiled(text, names_of(Functions), waiting_of(Functions))
        self.name, self._lines = found.name or "a line of script", found.lines
        self.secondary = found.secondary
        self.words = found.words
        refill = RATE * robot.dt * (SECONDARY_FRACTION if self.secondary else 1)
        self._allowance = Budget(refill, robot.bursts.drawn())
        self._robot, self._functions = robot, Functions(robot, self, self._allowance)
        self._globals = dict[str, Any]()
        names: dict[str, Any] = {
            "__builtins__": {},
            "_g": self._globals,
            "_call": self._functions.table,
            "_pose": _pose,
            "_list": self._allowance.sized,
            "_true": _true,
            "_xor": _xor,
            "_copy": self._copy,
            "_item": _item,
            "_put": self._put,
            "_arithmetic": self._arithmetic,
            "_compare": self._compare,
            "_read": self._read,
            "_turn": self._allowance.spend,
            "_run": self._run,
            "_kill": self._kill,
            "_join": self._join,
            "_halt": _halt,
            "_missing": _missing,
        }
        try:
            exec(compile(found.source, FILE, "exec"), names)
        except (SyntaxError, MemoryError, RecursionError) as fault:
            raise ScriptError(f"{self.name}: cannot be read: {fault}") from None
        self._threads = [Thread(self.name, names["main"]())]
        self.mover: Thread | None = None
        self.current: Thread | None = None

    def cycle(self) -> str | None:
        """Resume each thread once; return why the program has ended, or None."""
        self._allowance.cycle()
        place = 0
        while place < len(self._threads):  # a thread that starts in this cycle runs in it, too
            thread = self.current = self._threads[place]
            place += 1
            if not thread.alive:
                continue
            try:
                thread.resume()
            except Halted:
                return "halt"
            except DmframeError as fault:
                return self._located(fault.text, fault)
            except RecursionError:  # without the line, which depends on the stack
                return "calls of functions are nested too deeply"
            except Exception as fault:  # a script's errors raise many kinds of Python exceptions
                return self._located(f"{type(fault).__name__}: {fault}", fault)
            finally:
                self.current = None
        if not self._threads[0].alive:
            return "its last line is done"
        self._threads = [thread for thread in self._threads if thread.alive]
        if self.mover is not None and not self.mover.alive:
            self.free(self.mover)
        return self._counted()

    def _counted(self) -> str | None:
        """Return why the script stores too much, or None; counted after every `COUNTED` copied elements."""
        if self._allowance.copied < COUNTED:
            return None
        self._allowance.copied = 0
        stored = [*self._globals.values(), *(value for thread in self._threads for value in thread.stored)]
        if elements([value for value in stored if isinstance(value, list | str)], MOST_STORED) > MOST_STORED:
            return f"expected variables of no more than {MOST_STORED} elements in all, found more"
        return None

    def close(self) -> None:
        """End all threads and close the script's sockets."""
        for thread in self._threads:
            thread.close()
        self._functions.close()

    def claim(self) -> Thread | None:
        """Let the current thread move the robot, and return it. Raises `ScriptError` if another thread moves it."""
        if self.secondary:
            raise ScriptError("a secondary program must not move the robot; begin it with def")
        mover = self.mover
        if mover is not None and mover is not self.current and mover.alive:
            raise ScriptError(f"thread {mover.name} already moves the robot; kill or join it before another motion")
        self.mover = self.current
        return self.current

    def free(self, thread: Thread | None) -> None:
        """Release the robot after that thread's motion."""
        if self.mover is thread:
            self.mover = None

    def _located(self, text: str, fault: Exception) -> str:
        frames = [frame for frame in traceback.extract_tb(fault.__traceback__) if frame.filename == FILE]
        line = f"line {self._lines[(frames[-1].lineno or 1) - 1]}: " if frames else ""
        return f"{line}{' '.join(text.split())}"

    def _read(self, name: str) -> Any:
        try:
            return self._globals[name]
        except KeyError:
            raise ScriptError(f"{name}: expected a variable, found none of that name") from None

    def _copy(self, value: Any) -> Any:
        return copied(self._allowance.sized(value)) if isinstance(value, list | str) else value

    def _put(self, values: Any, places: tuple[Any, ...], value: Any) -> None:
        found = _item(values, places[:-1])
        place = _whole(places[-1], found)
        found[place] = self._copy(value)
        if isinstance(value, list | str):  # the whole list may have become too large
            self._allowance.sized(values)

    def _arithmetic(self, left: Any, *rest: Any) -> Any:
        for sign, right in zip(rest[::2], rest[1::2], strict=True):
            left = _computed(sign, left, right)
            if isinstance(left, list):
                self._allowance.sized(left)
        return left

    def _compare(self, sign: str, left: Any, right: Any) -> bool:
        if isinstance(left, list | str):
            self._allowance.sized(left)
        if sign not in ("==", "!="):
            _check_numbers(sign, left, right)
        return bool(_SIGNS[sign](left, right))

    def _run(self, name: str, steps: Generator[None, None, Any]) -> Thread:
        if sum(thread.alive for thread in self._threads) >= MOST_THREADS:
            raise ScriptError(f"run {name}: expected no more than {MOST_THREADS} threads")
        thread = Thread(name, steps)
        self._threads.append(thread)
        return thread

    def _kill(self, thread: Any) -> None:
        if isinstance(thread, Thread):
            thread.close()
            if self.mover is thread:
                self.free(thread)
                self._robot.release()

    def _join(self, thread: Any) -> Generator[None, None, None]:
        while isinstance(thread, Thread) and thread.alive:
            yield


def _true(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ScriptError(f"expected True or False, found {value}")
    return value


def _xor(*values: Any) -> bool:
    return sum(map(_true, values)) % 2 == 1


def _pose(values: list[Any]) -> Pose:
    if len(values) != 6 or not all(map(is_number, values)):
        raise ScriptError(f"p[...]: expected six numbers, found {len(values)} values")
    return Pose(values)


def _whole(index: Any, of: Any) -> Any:
    if not isinstance(of, list):
        raise ScriptError(f"expected a list or a pose, found {of}")
    if not is_number(index) or index != int(index):
        raise ScriptError(f"expected the index of an element, found {index}")
    if not 0 <= index < len(of):
        raise ScriptError(f"expected an index from 0 to {len(of) - 1}, found {index:g}")
    return int(index)


def _item(values: Any, places: tuple[Any, ...]) -> Any:
    for place in places:
        values = values[_whole(place, values)]
    return values


def _computed(sign: str, left: Any, right: Any) -> Any:
    if isinstance(left, list) and isinstance(right, list):
        if len(left) != len(right):
            raise ScriptError(f"{sign}: expected lists of equal length, found {len(left)} and {len(right)}")
        return type(left)(_computed(sign, a, b) for a, b in zip(left, right, strict=True))
    if isinstance(left, list):
        return type(left)(_computed(sign, a, right) for a in left)
    if isinstance(right, list):
        return type(right)(_computed(sign, left, b) for b in right)
    _check_numbers(sign, left, right)
    if sign in "/%" and right == 0:
        raise ScriptError(f"{sign}: division by zero")
    found = _SIGNS[sign](left, right)
    if isinstance(found, int) and not -MOST_INTEGER - 1 <= found <= MOST_INTEGER:  # Python integers are unbounded
        raise ScriptError(f"{sign}: expected an integer of 32 bits, found a longer one")
    return found


def _check_numbers(sign: str, *values: Any) -> None:
    for value in values:
        if not is_number(value):
            raise ScriptError(f"{sign}: expected numbers, found {value!r}")


def _halt() -> None:
    raise Halted


def _missing(name: str) -> Any:
    raise ScriptError(f"{name}: the virtual robot does not emulate this function")
