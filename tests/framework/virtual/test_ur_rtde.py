"""ur_rtde, unmodified, drives the robot in real time, from a separate process, through the manufacturer's ports."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from typing import Any

import pytest
from virtual_robots import own_host, robot

LIMIT = 120.0
"""Time limit of the client [s]; it needs some seconds."""
pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("rtde_control") is None, reason="needs ur_rtde: python -m pip install ur_rtde"
)

CLIENT = """
import json, sys, time
from dashboard_client import DashboardClient
from rtde_control import RTDEControlInterface
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface

host, found = sys.argv[1], {}
dashboard = DashboardClient(host)
dashboard.connect()
found["version"], found["mode"] = dashboard.polyscopeVersion(), dashboard.robotmode()
receive = RTDEReceiveInterface(host)
control = RTDEControlInterface(host)
writes = RTDEIOInterface(host)
found["start"] = receive.getActualQ()
found["pose"] = receive.getActualTCPPose()

def steadily(reached):
    for _ in range(2000):
        if reached():
            return True
        time.sleep(0.005)
    return False

# as speedj_example.py
begin = receive.getActualQ()[0]
for _ in range(60):
    period = control.initPeriod()
    control.speedJ([0.1, 0, 0, 0, 0, 0], 0.5, 0.002)
    control.waitPeriod(period)
control.speedStop()
found["speedJ"] = receive.getActualQ()[0] - begin

# as servoj_example.py
goal = receive.getActualQ()
goal[1] += 0.02
def servo():
    period = control.initPeriod()
    control.servoJ(goal, 0.5, 0.5, 0.002, 0.1, 300)
    control.waitPeriod(period)
    return abs(receive.getTargetQ()[1] - goal[1]) < 1e-4
found["servoJ"] = steadily(servo)
control.servoStop()

# as move_async_example.py
goal = receive.getActualQ()
goal[0] += 0.5
control.moveJ(goal, 0.3, 0.5, True)
found["moving"] = steadily(lambda: receive.getActualQd()[0] > 0.02)
control.stopJ(2.0)
found["short"] = goal[0] - receive.getActualQ()[0]
goal = receive.getTargetQ()
goal[0] -= 0.05
found["moveJ"] = control.moveJ(goal, 1.0, 2.0)
found["arrived"] = max(abs(a - b) for a, b in zip(receive.getTargetQ(), goal))
goal = receive.getTargetTCPPose()
goal[2] += 0.01
found["moveL"] = control.moveL(goal, 0.25, 0.5)
found["lifted"] = receive.getTargetTCPPose()[2] - goal[2]
found["inverse"] = max(
    abs(a - b) for a, b in zip(control.getInverseKinematics(receive.getTargetTCPPose()), receive.getTargetQ())
)

# as io_example.py
writes.setStandardDigitalOut(3, True)
found["output"] = steadily(lambda: receive.getDigitalOutState(3))
writes.setSpeedSlider(0.5)
found["slider"] = steadily(lambda: receive.getTargetSpeedFraction() == 0.5)

# what the maker's controller does of itself
control.triggerProtectiveStop()
found["stopped"] = steadily(receive.isProtectiveStopped)
dashboard.unlockProtectiveStop()
found["unlocked"] = steadily(lambda: not receive.isProtectiveStopped())
found["again"] = control.reuploadScript() and steadily(control.isProgramRunning)
control.stopScript()
found["over"] = steadily(lambda: dashboard.programState().startswith("STOPPED"))
control.disconnect()
receive.disconnect()
print(json.dumps(found))
"""


def test_its_interfaces_drive_the_robot() -> None:
    host = own_host()
    with robot("ur10_full") as held:
        held.listen(host)  # this client supports no other ports
        with held.in_background():
            done = subprocess.run(
                [sys.executable, "-c", CLIENT, host], capture_output=True, text=True, timeout=LIMIT, check=False
            )
    assert done.returncode == 0, (done.stderr, list(held.messages)[-20:])
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    assert found["version"] == "5.11.0.108249"
    assert found["mode"] == "Robotmode: RUNNING"
    assert found["start"] == pytest.approx([1.455411, -1.016031, 0.978316, 0, -1.570796, 0], abs=1e-3)
    assert found["pose"][:3] == pytest.approx([0.07, -0.82, 0.55], abs=1e-3)
    assert found["speedJ"] > 0.002
    assert found["servoJ"]
    assert found["moving"]
    assert found["short"] > 0.2
    assert found["moveJ"]
    assert found["arrived"] < 1e-9
    assert found["moveL"]
    assert abs(found["lifted"]) < 1e-8
    assert found["inverse"] < 1e-6
    assert found["output"]
    assert found["slider"]
    assert found["stopped"]
    assert found["unlocked"]
    assert found["again"]
    assert found["over"]
    assert held.safety.reason == "protective stop: requested by the script"
