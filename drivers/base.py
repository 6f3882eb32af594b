"""The door to the devices: what an axis, a camera, an iris and a target holder promise, whoever
made them.
"""

from drivers.axis import Axis, Guard
from drivers.camera import Camera, CameraDevice, Frame
from drivers.camera_commands import CameraCommands
from drivers.commands import AxisCommands, SettingCommands
from drivers.detector import Detector
from drivers.setting import Setting
from drivers.status import Status, wait_all

__all__ = [
    "Axis", "AxisCommands", "Camera", "CameraCommands", "CameraDevice", "Detector", "Frame",
    "Guard", "Setting", "SettingCommands",
    "Status", "wait_all",
]  # fmt: skip
