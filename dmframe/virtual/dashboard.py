"""Dashboard server: answers each line of text by a line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Final

from dmframe.virtual.safety import EMERGENCY, IDLE, MODE_NAMES, POWER_OFF, RUNNING, SAFETY_NAMES

if TYPE_CHECKING:
    from dmframe.virtual.robot import VirtualRobot

GREETING: Final = "Connected: Universal Robots Dashboard Server"
SERIAL: Final = "20000000000"
MODELS: Final = ("ur3", "ur5", "ur10")


def answer(robot: VirtualRobot, line: str) -> str:
    """Answer of the dashboard to a command, in upper or lower case."""
    words = line.strip()
    for name, command in _COMMANDS.items():
        if words.lower() == name or words.lower().startswith(f"{name} "):
            return command(robot, words[len(name) :].strip())
    return f"could not understand: '{words}'"


def _done(action: Callable[[VirtualRobot, str], object], reply: str) -> Callable[[VirtualRobot, str], str]:
    """Command that executes an action and has a fixed answer."""

    def command(robot: VirtualRobot, text: str) -> str:
        action(robot, text)
        return reply

    return command


def _power_on(robot: VirtualRobot, _: str) -> None:
    if robot.safety.robot_mode == POWER_OFF:
        robot.safety.power(IDLE)


def _restart(robot: VirtualRobot, _: str) -> None:
    if robot.safety.mode != EMERGENCY:
        robot.unlock()
        robot.power_off()


def _model(robot: VirtualRobot, _: str) -> str:
    return next((name.upper() for name in MODELS[::-1] if robot.arm.name.lower().startswith(name)), "UR10")


_COMMANDS: Final[Mapping[str, Callable[[VirtualRobot, str], str]]] = {
    "robotmode": lambda robot, _: f"Robotmode: {MODE_NAMES[robot.safety.robot_mode]}",
    "safetymode": lambda robot, _: f"Safetymode: {SAFETY_NAMES[robot.safety.mode]}",
    "safetystatus": lambda robot, _: f"Safetystatus: {SAFETY_NAMES[robot.safety.mode]}",
    "running": lambda robot, _: f"Program running: {str(robot.running).lower()}",
    "programstate": lambda robot, _: f"{'PLAYING' if robot.running else 'STOPPED'} virtual.urp",
    "polyscopeversion": lambda robot, _: "URSoftware {}.{}.{}.{} (virtual)".format(*robot.version),
    "version": lambda robot, _: ".".join(map(str, robot.version[:3])),
    "get serial number": lambda robot, _: SERIAL,
    "get robot model": _model,
    "get loaded program": lambda robot, _: "Loaded program: virtual.urp",
    "get operational mode": lambda robot, _: "AUTOMATIC",
    "get variable": lambda robot, _: "No variable",
    "is in remote control": lambda robot, _: "true",
    "isprogramsaved": lambda robot, _: "true virtual.urp",
    "power on": _done(_power_on, "Powering on"),
    "power off": _done(lambda robot, _: robot.power_off(), "Powering off"),
    "brake release": _done(lambda robot, _: robot.safety.power(RUNNING), "Brake releasing"),
    "unlock protective stop": lambda robot, _: (
        "Protective stop releasing" if robot.unlock() else "Cannot unlock protective stop"
    ),
    "restart safety": _done(_restart, "Restarting safety"),
    "stop": _done(lambda robot, _: robot.end_program("stopped by the dashboard"), "Stopped"),
    "play": lambda robot, _: "Failed to execute: play",
    "pause": lambda robot, _: "Failed to execute: pause",
    "load": lambda robot, name: f"File not found: {name}",
    "popup": _done(lambda robot, text: robot.report(f"popup: {text}"), "showing popup"),
    "close popup": lambda robot, _: "closing popup",
    "close safety popup": lambda robot, _: "closing safety popup",
    "addtolog": _done(lambda robot, text: robot.report(f"log: {text}"), "Added log message"),
    "set operational mode": lambda robot, mode: f"Operational mode '{mode}' is set",
    "clear operational mode": lambda robot, _: "No longer controlling the operational mode",
    "setuserrole": lambda robot, role: f"Setting user role: {role}",
    "quit": lambda robot, _: "Disconnected",
    "shutdown": lambda robot, _: "Shutting down",
}
