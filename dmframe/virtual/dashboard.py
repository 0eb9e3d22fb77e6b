"""The dashboard: a line of text, answered by a line."""

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
    """What the dashboard says to a command, whatever its case."""
    words = line.strip()
    for name, command in _COMMANDS.items():
        if words.lower() == name or words.lower().startswith(f"{name} "):
            return command(robot, words[len(name) :].strip())
    return f"could not understand: '{words}'"


def _stop(robot: VirtualRobot, _: str) -> str:
    robot.end_program("the dashboard stops it")
    return "Stopped"


def _unlock(robot: VirtualRobot, _: str) -> str:
    return "Protective stop releasing" if robot.unlock() else "Cannot unlock protective stop"


def _power_on(robot: VirtualRobot, _: str) -> str:
    if robot.safety.robot_mode == POWER_OFF:
        robot.safety.power(IDLE)
    return "Powering on"


def _power_off(robot: VirtualRobot, _: str) -> str:
    robot.power_off()
    return "Powering off"


def _brakes(robot: VirtualRobot, _: str) -> str:
    robot.safety.power(RUNNING)
    return "Brake releasing"


def _restart(robot: VirtualRobot, _: str) -> str:
    if robot.safety.mode != EMERGENCY:
        robot.unlock()
        robot.power_off()
    return "Restarting safety"


def _popup(robot: VirtualRobot, text: str) -> str:
    robot.tell(f"popup: {text}")
    return "showing popup"


def _log(robot: VirtualRobot, text: str) -> str:
    robot.tell(f"log: {text}")
    return "Added log message"


def _version(robot: VirtualRobot, _: str) -> str:
    return f"URSoftware {'.'.join(map(str, robot.version[:3]))}.{robot.version[3]} (virtual)"


def _model(robot: VirtualRobot, _: str) -> str:
    return next((name.upper() for name in MODELS[::-1] if robot.arm.name.lower().startswith(name)), "UR10")


def _state(robot: VirtualRobot, _: str) -> str:
    return f"{'PLAYING' if robot.running else 'STOPPED'} virtual.urp"


_COMMANDS: Final[Mapping[str, Callable[[VirtualRobot, str], str]]] = {
    "robotmode": lambda robot, _: f"Robotmode: {MODE_NAMES[robot.safety.robot_mode]}",
    "safetymode": lambda robot, _: f"Safetymode: {SAFETY_NAMES[robot.safety.mode]}",
    "safetystatus": lambda robot, _: f"Safetystatus: {SAFETY_NAMES[robot.safety.mode]}",
    "running": lambda robot, _: f"Program running: {str(robot.running).lower()}",
    "programstate": _state,
    "polyscopeversion": _version,
    "version": lambda robot, _: ".".join(map(str, robot.version[:3])),
    "get serial number": lambda robot, _: SERIAL,
    "get robot model": _model,
    "get loaded program": lambda robot, _: "Loaded program: virtual.urp",
    "get operational mode": lambda robot, _: "AUTOMATIC",
    "get variable": lambda robot, _: "No variable",
    "is in remote control": lambda robot, _: "true",
    "isprogramsaved": lambda robot, _: "true virtual.urp",
    "power on": _power_on,
    "power off": _power_off,
    "brake release": _brakes,
    "unlock protective stop": _unlock,
    "restart safety": _restart,
    "stop": _stop,
    "play": lambda robot, _: "Failed to execute: play",
    "pause": lambda robot, _: "Failed to execute: pause",
    "load": lambda robot, name: f"File not found: {name}",
    "popup": _popup,
    "close popup": lambda robot, _: "closing popup",
    "close safety popup": lambda robot, _: "closing safety popup",
    "addtolog": _log,
    "set operational mode": lambda robot, mode: f"Operational mode '{mode}' is set",
    "clear operational mode": lambda robot, _: "No longer controlling the operational mode",
    "setuserrole": lambda robot, role: f"Setting user role: {role}",
    "quit": lambda robot, _: "Disconnected",
    "shutdown": lambda robot, _: "Shutting down",
}
