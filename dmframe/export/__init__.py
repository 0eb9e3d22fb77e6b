"""Export of a graph's controller: as C, as a ROS 2 package, or with its robot as FMUs."""

from __future__ import annotations

from dmframe.export.c import export_c
from dmframe.export.fmu import export_fmus
from dmframe.export.ros2 import export_ros2

__all__ = ["export_c", "export_fmus", "export_ros2"]
