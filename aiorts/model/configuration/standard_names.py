"""Standard names of properties, each with one type and one unit, so that tools find the same thing by the same name.

The paper on flexible components says of property bags that names drift apart between components "even for identical
properties": a name that is not in this list is allowed, and reported with the names near to it.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from aiorts.late import dataclass
from aiorts.spelling import meant

if TYPE_CHECKING:
    from collections.abc import Mapping

    from aiorts.model.configuration.parameters import ParameterSpec


@dataclass(frozen=True, slots=True)
class StandardName:
    """A standard name: its type as it is written in annotations, its unit, and its meaning."""

    name: str
    type: str
    unit: str
    doc: str


_ROWS: Final = (
    ("frame_id", "str", "", "coordinate frame in which the data is given"),
    ("parent_frame_id", "str", "", "coordinate frame in which the mounting is given"),
    ("mounting_position", "tuple[float, ...]", "m", "x, y, z of the device in the parent frame"),
    ("mounting_orientation", "tuple[float, ...]", "rad", "roll, pitch, yaw of the device in the parent frame"),
    ("serial_number", "str", "", "of the device, as its maker writes it"),
    ("manufacturer", "str", "", "of the device"),
    ("model", "str", "", "of the device"),
    ("hardware_version", "str", "", "of the device"),
    ("firmware_version", "str", "", "of the device"),
    ("device", "Path", "", "the device's file, such as /dev/ttyUSB0"),
    ("baud_rate", "int", "Bd", "of a serial line"),
    ("host", "str", "", "name or address of the device in the network"),
    ("network_port", "int", "", "the device's port in the network"),
    ("bus", "str", "", "field bus the device hangs on, such as can0"),
    ("node_id", "int", "", "of the device on its bus"),
    ("channel", "int", "", "of a device that has several"),
    ("simulated", "bool", "", "no device is there: the data is made up"),
    ("calibration_file", "Path", "", "where the calibration stands"),
    ("calibrated_on", "str", "", "date of the calibration, YYYY-MM-DD"),
    ("sampling_rate", "float", "Hz", "at which the device measures"),
    ("scan_rate", "float", "Hz", "turns or sweeps in a second"),
    ("latency", "float", "s", "from the measurement to the sample"),
    ("timeout", "float", "s", "after which the device counts as silent"),
    ("range_min", "float", "m", "nearest distance that is measured"),
    ("range_max", "float", "m", "farthest distance that is measured"),
    ("angle_min", "float", "rad", "first angle of a sweep"),
    ("angle_max", "float", "rad", "last angle of a sweep"),
    ("angle_increment", "float", "rad", "from one ray of a sweep to the next"),
    ("noise", "float", "", "standard deviation, in the unit of the data"),
    ("width", "int", "px", "of an image"),
    ("height", "int", "px", "of an image"),
    ("pixel_format", "str", "", "of an image, such as rgb8"),
    ("exposure_time", "float", "s", "of an image"),
    ("focal_length", "float", "px", "of a camera"),
    ("field_of_view", "float", "rad", "horizontal"),
    ("mass", "float", "kg", "of the body"),
    ("centre_of_mass", "tuple[float, ...]", "m", "x, y, z in the body's frame"),
    ("payload_mass", "float", "kg", "most that may be carried"),
    ("joint_names", "tuple[str, ...]", "", "in the order of the data"),
    ("gear_ratio", "float", "", "turns of the motor for one of the axis"),
    ("wheel_radius", "float", "m", "of a driven wheel"),
    ("wheel_separation", "float", "m", "between the driven wheels"),
    ("max_velocity", "float", "m/s", "most that is commanded"),
    ("max_acceleration", "float", "m/s^2", "most that is commanded"),
    ("max_angular_velocity", "float", "rad/s", "most that is commanded"),
    ("max_force", "float", "N", "most that is applied"),
    ("max_torque", "float", "N m", "most that is applied"),
)
STANDARD_NAMES: Final[Mapping[str, StandardName]] = MappingProxyType({row[0]: StandardName(*row) for row in _ROWS})


def remark_on(spec: ParameterSpec) -> str:
    """A remark on a property's name, type and unit; empty when they are a standard name's."""
    standard = STANDARD_NAMES.get(spec.name)
    if standard is None:
        return f"no standard name{meant(spec.name.lower(), STANDARD_NAMES, str, most=3)}"
    remarks = []
    if spec.type_text.removesuffix(" | None") != standard.type:
        remarks.append(f"its type is {standard.type}, not {spec.type_text}")
    if spec.unit != standard.unit:
        remarks.append(f"its unit is {standard.unit or 'none'}, not {spec.unit or 'none'}")
    return f"a standard name, but {' and '.join(remarks)}" if remarks else ""
