"""An interrupt during the construction of expressions is not lost, whichever library clears it."""

from __future__ import annotations

import signal
from contextlib import suppress

import casadi as ca
import pytest

from dmframe.common import interrupts
from dmframe.common.interrupts import Insistent


def interrupted() -> None:
    """Interrupt as Ctrl-C does."""
    signal.raise_signal(signal.SIGINT)


def cleared() -> None:
    """An interrupt that is cleared."""
    with suppress(KeyboardInterrupt):
        interrupted()


def goes_on() -> None:
    """Work after an interrupt that was cleared."""
    cleared()
    while True:
        pass


class Odd:
    """An operand that is interrupted while CasADi inspects it."""

    def __SX__(self) -> ca.SX:
        interrupted()
        return ca.SX(1)


def test_casadi_clears_an_interrupt_and_reports_a_fault_that_is_invalid() -> None:
    with pytest.raises(Exception, match="sum1") as caught:
        ca.sum1(Odd())
    assert not isinstance(caught.value, KeyboardInterrupt)
    with pytest.raises(KeyboardInterrupt), Insistent():
        ca.sum1(Odd())


def test_one_that_is_cleared_is_raised_again_while_the_work_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interrupts, "AGAIN", 1e-3)
    with pytest.raises(KeyboardInterrupt), Insistent():
        goes_on()


def test_one_that_is_cleared_at_the_very_end_is_raised_there_and_signals_are_left_as_they_were() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGALRM)]
    lock = Insistent()
    with pytest.raises(KeyboardInterrupt), lock, lock:
        cleared()
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGALRM)] == before
    with lock:  # and is not raised a second time
        pass


def test_one_on_its_way_up_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interrupts, "AGAIN", 1e-3)
    put_away = []

    def putting_away() -> None:
        try:
            interrupted()
        finally:
            put_away.append(sum(range(1_000_000)) > 0)

    with pytest.raises(KeyboardInterrupt), Insistent():
        putting_away()
    assert put_away == [True]


def test_one_that_is_only_noted_while_files_are_written_is_not_raised() -> None:
    from dmframe.cli.signals import deferred_signals

    with deferred_signals() as came, Insistent():
        interrupted()
    assert came == [signal.SIGINT]
