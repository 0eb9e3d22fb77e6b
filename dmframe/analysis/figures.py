"""Bode and Nyquist diagrams of the servo and its inverse, as SVG."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from dmframe.analysis.rational import Rational
from dmframe.analysis.servo import JointLoop
from dmframe.common.plotting import COLORS, GREY, PAGE, look, names_above, new_figure, styled

POINTS: Final = 400
_LOOP: Final = "loop gain $L$"
_PORT: Final = r"servo with its inverse, $\sigma \to$ torque"
_SERVO: Final = r"servo, $\dot q_c - \dot q \to$ torque"


def bode_svg(joints: Sequence[JointLoop]) -> str:
    """Bode diagrams of the loop gain and of the controller's port, one curve per joint."""
    from matplotlib.ticker import MultipleLocator

    omega = _frequencies(joints)
    with styled():
        figure = new_figure(PAGE, 3.6)
        panels = figure.subplots(2, 2, sharex=True)
        for column, (title, unit, systems) in enumerate(_columns(joints)):
            for k, (joint, system) in enumerate(zip(joints, systems, strict=True)):
                value = system.at(1j * omega)
                panels[0, column].loglog(omega, np.abs(value), label=joint.joint, **look(k))
                panels[1, column].semilogx(omega, _phase(value), **look(k))
            panels[0, column].set_title(title)
            panels[0, column].set_ylabel("magnitude" + (f" [{unit}]" if unit else ""))
            panels[1, column].set_ylabel("phase [deg]")
            panels[1, column].set_xlabel("frequency [rad/s]")
            panels[1, column].yaxis.set_major_locator(MultipleLocator(45))
            panels[1, column].set_xlim(omega[0], omega[-1])
        panels[0, 0].axhline(1, color=GREY, linewidth=0.8)
        panels[1, 0].axhline(-180, color=GREY, linewidth=0.8)
        for end in (-90, 90):  # phase limits of a passive port
            panels[1, 1].axhline(end, color=GREY, linewidth=0.8)
        _phase_limits(panels[1, 0], -180)
        _phase_limits(panels[1, 1], -90, 90)
        names_above(figure, panels[0, 0], PAGE)
        return _svg(figure, "Bode diagrams of the joint servos")


def nyquist_svg(joints: Sequence[JointLoop]) -> str:
    """Nyquist diagrams of the loop gain, and of servo and inverse: passive where the real part is nonnegative."""
    omega = _frequencies(joints, dense=8)
    with styled():
        figure = new_figure(PAGE, 3.3)
        panels = figure.subplots(1, 2)
        for k, joint in enumerate(joints):
            _curve(panels[0], joint.loop, omega, joint.joint, k, 3.0)
        around = np.linspace(0, 2 * np.pi, 181)
        panels[0].plot(np.cos(around), np.sin(around), color=GREY, linewidth=0.8)
        panels[0].plot([-1], [0], marker="+", color=COLORS[2], markersize=7, linestyle="none")
        panels[0].annotate("$-1$", (-1, 0), (-4, 5), textcoords="offset points", ha="right")
        panels[0].set(xlim=(-3, 2), ylim=(-3, 2), aspect="equal", title=_LOOP)
        (_, _, _), (title, unit, systems) = _columns(joints)
        size = 2.2 * max(abs(complex(system.at(1j * omega[-1]))) for system in systems)
        for k, (joint, system) in enumerate(zip(joints, systems, strict=True)):
            _curve(panels[1], system, omega, joint.joint, k, size)
        panels[1].axvspan(-size / 2, 0, color="#f2e3e5", linewidth=0, zorder=0)
        panels[1].annotate("not passive", (-size / 4, size * 0.06), ha="center", color=COLORS[2])
        panels[1].set(xlim=(-size / 2, _right_end(systems, omega, size)), ylim=(-size, size / 8), title=title)
        for axes, kind in ((panels[0], ""), (panels[1], f" [{unit}]")):
            axes.axhline(0, color=GREY, linewidth=0.6)
            axes.axvline(0, color=GREY, linewidth=0.6)
            axes.set_xlabel(f"real part{kind}")
            axes.set_ylabel(f"imaginary part{kind}")
        names_above(figure, panels[0], PAGE)
        return _svg(figure, "Nyquist diagrams of the joint servos")


def _columns(joints: Sequence[JointLoop]) -> tuple[tuple[str, str, list[Rational]], tuple[str, str, list[Rational]]]:
    """Title, unit and one system per joint: the loop gain, and the port, or the servo where there is no inverse."""
    ports = [joint.port for joint in joints if joint.port is not None]
    second = (_PORT, ports) if len(ports) == len(joints) else (_SERVO, [joint.servo for joint in joints])
    return (_LOOP, "", [joint.loop for joint in joints]), (second[0], "N m s/rad", second[1])


def _frequencies(joints: Sequence[JointLoop], dense: int = 1) -> np.ndarray:
    """Frequencies from a decade below the slowest pole or zero of the loops to a decade above the fastest."""
    corners = [abs(r) for joint in joints for r in (*joint.tracking.poles, *joint.loop.zeros) if abs(r) > 1e-9]
    low, high = min(corners, default=1.0), max(corners, default=1.0)
    return np.logspace(np.floor(np.log10(low)) - 1, np.ceil(np.log10(high)) + 1, POINTS * dense)


def _phase(value: np.ndarray) -> np.ndarray:
    """Continuous phase [deg], with the high-frequency end between -180 and 180."""
    continuous = np.unwrap(np.angle(value[::-1]))[::-1]
    return np.asarray(np.degrees(continuous))


def _phase_limits(axes: Any, *ends: float) -> None:
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, *ends) - 10, max(high, *ends, -60) + 10)


def _curve(axes: Any, system: Rational, omega: np.ndarray, label: str, k: int, size: float) -> None:
    """Draw the part of a frequency response within the axes, with an arrow towards rising frequency."""
    value = system.at(1j * omega)
    value = value[np.abs(value) < 4 * size]
    axes.plot(value.real, value.imag, label=label, **look(k))
    inside = np.flatnonzero(np.abs(value) < 0.9 * size)
    if inside.size > 2:
        at = int(inside[inside.size // 4])
        ahead = min(at + max(1, inside.size // 40), value.size - 1)
        arrow = {"arrowstyle": "-|>", "color": look(k)["color"], "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", _xy(value[ahead]), _xy(value[at]), arrowprops=arrow)


def _right_end(systems: Sequence[Rational], omega: np.ndarray, size: float) -> float:
    """Right end of the axes: the largest real part within their height, with a margin."""
    values = np.concatenate([system.at(1j * omega) for system in systems])
    shown = values.real[np.abs(values.imag) <= size]
    return 1.1 * float(min(2 * size, np.max(shown, initial=size / 2)))


def _xy(value: complex) -> tuple[float, float]:
    return float(value.real), float(value.imag)


def _svg(figure: Any, title: str) -> str:
    """Figure as SVG text for an HTML page; the same figure gives the same bytes."""
    from dmframe.common.version import version

    text = io.StringIO()
    meta = {"Date": None, "Creator": f"dmframe {version()}", "Title": title}
    figure.savefig(text, format="svg", metadata=meta)
    whole = text.getvalue()
    return whole[whole.index("<svg") :]
