"""Turns messages of ROS 2, as `rosbags` has them, into the records of `aiorts.types.ros` and back, field by field."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from operator import attrgetter
from typing import Any, Final

import aiorts.types.ros as ros
from aiorts.errors import MissingExtra
from aiorts.types import Field, fields_of, full_name

_MESSAGES: Final = (
    *(ros.Imu, ros.LaserScan, ros.Image, ros.CompressedImage, ros.PointCloud2, ros.JointState, ros.NavSatFix),
    *(ros.Odometry, ros.Twist, ros.TwistStamped, ros.PoseStamped, ros.TransformStamped),
)
MESSAGES: Final[dict[str, type]] = {full_name(cls): cls for cls in _MESSAGES}
"""The records that stand for a whole message, by ROS's short name; single parts become OpenRTM's records."""


def library() -> Any:
    """The two modules of `rosbags` that are used: typesys and serde. MissingExtra when it is not installed."""
    try:
        import rosbags.serde as serde  # type: ignore[import-not-found,unused-ignore]
        import rosbags.typesys as typesys  # type: ignore[import-not-found,unused-ignore]
    except ImportError:
        raise MissingExtra("reading and writing of ROS 2 messages", "rosbags", "ros") from None
    return typesys, serde


@cache
def standard_types() -> Any:
    """The types of the ROS 2 distributions; the messages here are the same in all of them."""
    typesys, _ = library()
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def record_of(name: str) -> type | None:
    """The record for whole messages of a type (`sensor_msgs/msg/Imu`)."""
    return MESSAGES.get(name.replace("/msg/", "/"))


def ros_name(cls: type) -> str:
    """The name of a record's type in files of ROS 2: `sensor_msgs/msg/Imu`."""
    return full_name(cls).replace("/", "/msg/")


def with_nested(cls: type) -> Iterator[type]:
    """A record type and the record types of its fields, at any depth."""
    yield cls
    for field in fields_of(cls):
        if field.record is not None:
            yield from with_nested(field.record)


def maker(cls: type) -> Callable[[Any], Any]:
    """A function that makes a record of a decoded message; it raises RecordError for a value that does not fit."""
    gets = [_getter(field) for field in fields_of(cls)]
    return lambda message: cls(*[get(message) for get in gets])


def _getter(field: Field) -> Callable[[Any], Any]:
    get = attrgetter(field.name)
    if field.record is None:
        return get
    make = maker(field.record)
    if field.spelling.startswith("seq["):
        return lambda message: [make(item) for item in get(message)]
    return lambda message: make(get(message))


def unmaker(cls: type, store: Any) -> Callable[[Any], Any]:
    """A function that makes from a record a message that `store` can write."""
    gets = [_ungetter(field, store) for field in fields_of(cls)]
    message = store.types[ros_name(cls)]
    return lambda record: message(*[get(record) for get in gets])


def _ungetter(field: Field, store: Any) -> Callable[[Any], Any]:
    get = attrgetter(field.name)
    is_list = field.spelling.startswith("seq[")
    if field.record is None:
        return get if not is_list or field.element is not None else lambda record: list(get(record))
    make = unmaker(field.record, store)
    if is_list:
        return lambda record: [make(item) for item in get(record)]
    return lambda record: make(get(record))
