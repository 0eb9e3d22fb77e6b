"""A script that runs: its threads, one cycle of the robot after another."""

from __future__ import annotations

import math
import operator
import traceback
from collections.abc import Callable, Generator
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, final

from dmframe.errors import DmframeError
from dmframe.virtual.arithmetic import Pose
from dmframe.virtual.functions import Functions, Halted, names_of, waiting_of
from dmframe.virtual.urscript import transpiled
from dmframe.virtual.words import ScriptError

if TYPE_CHECKING:
    from dmframe.virtual.robot import VirtualRobot

MOST_TURNS: Final = 100_000
"""Of loops and calls within a cycle: a script that waits for nothing would stop the robot's clock."""
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
    """A thread of a script: a generator, resumed once a cycle."""

    def __init__(self, name: str, steps: Generator[None, None, Any]) -> None:
        self.name, self.alive, self._steps = name, True, steps

    def resume(self) -> None:
        """Until it waits for the next cycle, or ends."""
        try:
            next(self._steps)
        except StopIteration:
            self.alive = False

    def close(self) -> None:
        """End it where it stands."""
        self.alive = False
        with suppress(ValueError):  # a thread that kills itself runs on until it waits
            self._steps.close()


@final
class Program:
    """A script, from its text to its end.

    Its threads run in the order in which they began, each once a cycle, until it waits.

    Raises
    ------
    ScriptError
        The text is no script, or holds what is not understood.
    """

    def __init__(self, text: str, robot: VirtualRobot) -> None:
        found = transpiled(text, names_of(Functions), waiting_of(Functions))
        self.name, self._lines = found.name or "a line of script", found.lines
        self.secondary = found.secondary
        self._robot, self._functions = robot, Functions(robot, self)
        self._globals = dict[str, Any]()
        self._turns = 0
        names: dict[str, Any] = {
            "__builtins__": {},
            "_g": self._globals,
            "_call": self._functions.table,
            "_Pose": Pose,
            "_true": _true,
            "_copy": _copy,
            "_item": _item,
            "_put": _put,
            "_arithmetic": _arithmetic,
            "_compare": _compare,
            "_read": self._read,
            "_turn": self._turn,
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
        """Resume each thread once; None, or why the program is over."""
        self._turns, place = 0, 0
        while place < len(self._threads):  # those that begin in this cycle run in it, too
            thread = self.current = self._threads[place]
            place += 1
            if not thread.alive:
                continue
            try:
                thread.resume()
            except Halted:
                return "halt"
            except DmframeError as fault:
                return self._told(fault.text, fault)
            except RecursionError:  # where it came is chance
                return "functions call functions, deeper than can be followed"
            except Exception as fault:  # what a script does wrong, Python tells in many ways
                return self._told(f"{type(fault).__name__}: {fault}", fault)
            finally:
                self.current = None
        if not self._threads[0].alive:
            return "its last line is done"
        self._threads = [thread for thread in self._threads if thread.alive]
        if self.mover is not None and not self.mover.alive:
            self.free(self.mover)
        return None

    def close(self) -> None:
        """End all threads, and close the script's sockets."""
        for thread in self._threads:
            thread.close()
        self._functions.close()

    def claim(self) -> Thread | None:
        """The thread that runs now is the one that moves the robot. Raises `ScriptError` where another does."""
        if self.secondary:
            raise ScriptError("a secondary program moves nothing; begin it with def")
        mover = self.mover
        if mover is not None and mover is not self.current and mover.alive:
            raise ScriptError(f"thread {mover.name} already moves the robot; kill or join it before another motion")
        self.mover = self.current
        return self.current

    def free(self, thread: Thread | None) -> None:
        """That thread's motion is over."""
        if self.mover is thread:
            self.mover = None

    def _told(self, text: str, fault: Exception) -> str:
        frames = [frame for frame in traceback.extract_tb(fault.__traceback__) if frame.filename == FILE]
        line = f"line {self._lines[(frames[-1].lineno or 1) - 1]}: " if frames else ""
        return f"{line}{' '.join(text.split())}"

    def _read(self, name: str) -> Any:
        try:
            return self._globals[name]
        except KeyError:
            raise ScriptError(f"{name}: expected a variable, found none of that name") from None

    def _turn(self) -> None:
        self._turns += 1
        if self._turns > MOST_TURNS:
            raise ScriptError(f"a loop without sync() or another wait: {MOST_TURNS} turns and calls in one cycle")

    def _run(self, name: str, steps: Generator[None, None, Any]) -> Thread:
        thread = Thread(name, steps)
        self._threads.append(thread)
        return thread

    def _kill(self, thread: Any) -> None:
        if isinstance(thread, Thread):
            thread.close()
            if self.mover is thread:
                self.free(thread)
                self._robot.let_go()

    def _join(self, thread: Any) -> Generator[None, None, None]:
        while isinstance(thread, Thread) and thread.alive:
            yield


def _true(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ScriptError(f"expected True or False, found {value}")
    return value


def _copy(value: Any) -> Any:
    return type(value)(map(_copy, value)) if isinstance(value, list) else value


def _whole(index: Any, of: Any) -> Any:
    if not isinstance(of, list):
        raise ScriptError(f"expected a list or a pose, found {of}")
    if isinstance(index, bool) or not isinstance(index, int | float) or index != int(index):
        raise ScriptError(f"expected the number of an element, found {index}")
    if not 0 <= index < len(of):
        raise ScriptError(f"expected an element from 0 to {len(of) - 1}, found {index:g}")
    return int(index)


def _item(values: Any, index: Any) -> Any:
    if isinstance(index, tuple):
        return _item(_item(values, index[0]), index[1])
    return values[_whole(index, values)]


def _put(values: Any, index: Any, value: Any) -> None:
    if isinstance(index, tuple):
        values, index = _item(values, index[0]), index[1]
    values[_whole(index, values)] = value


def _arithmetic(sign: str, left: Any, right: Any) -> Any:
    if isinstance(left, list) and isinstance(right, list):
        if len(left) != len(right):
            raise ScriptError(f"{sign}: expected lists of one length, found {len(left)} and {len(right)}")
        return type(left)(_arithmetic(sign, a, b) for a, b in zip(left, right, strict=True))
    if isinstance(left, list):
        return type(left)(_arithmetic(sign, a, right) for a in left)
    if isinstance(right, list):
        return type(right)(_arithmetic(sign, left, b) for b in right)
    for value in (left, right):
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ScriptError(f"{sign}: expected numbers, found {value!r}")
    if sign in "/%" and right == 0:
        raise ScriptError(f"{sign}: division by zero")
    found = _SIGNS[sign](left, right)
    if isinstance(found, int) and not -MOST_INTEGER - 1 <= found <= MOST_INTEGER:  # Python's would grow without end
        raise ScriptError(f"{sign}: expected an integer of 32 bits, found a longer one")
    return found


def _compare(sign: str, left: Any, right: Any) -> bool:
    if sign not in ("==", "!="):
        for value in (left, right):
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ScriptError(f"{sign}: expected numbers, found {value!r}")
    return bool(_SIGNS[sign](left, right))


def _halt() -> None:
    raise Halted


def _missing(name: str) -> Any:
    raise ScriptError(f"{name}: the virtual robot does not emulate this function")
