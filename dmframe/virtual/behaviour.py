"""How ideal a virtual robot is: its slider, and what is between it and its clients."""

from __future__ import annotations

from dmframe.errors import ValueFault


class Behaviour:
    """Numbers that may be set at any time. Raises `ValueFault` for one out of its range."""

    @property
    def slider(self) -> float:
        """The speed slider, by which the targets of all joints are scaled."""
        return self._slider

    @slider.setter
    def slider(self, value: float) -> None:
        self._slider = share("slider", value)

    @property
    def lost(self) -> float:
        """Share of samples that are not sent."""
        return self._lost

    @lost.setter
    def lost(self, value: float) -> None:
        self._lost = share("lost", value)

    @property
    def command_delay(self) -> int:
        """Cycles until what a client writes is taken."""
        return self._command_delay

    @command_delay.setter
    def command_delay(self, value: int) -> None:
        self._command_delay = count("command_delay", value)

    @property
    def measurement_delay(self) -> int:
        """Cycles until a sample is sent."""
        return self._measurement_delay

    @measurement_delay.setter
    def measurement_delay(self, value: int) -> None:
        self._measurement_delay = count("measurement_delay", value)


def share(name: str, value: float) -> float:
    """A number from 0 to 1. Raises `ValueFault`."""
    if not 0 <= value <= 1:
        raise ValueFault(f"{name}: expected a number from 0 to 1, found {value}")
    return float(value)


def count(name: str, value: int) -> int:
    """A whole number, 0 or more. Raises `ValueFault`."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueFault(f"{name}: expected a whole number, 0 or more, found {value}")
    return value
