"""The file `NAME.layout.json` in the folder of a system file: the places of its components' boxes.

Text and bytes come in and go out; `stored_places` alone opens it. The studio writes it when boxes are moved, `aiorts
import` from a profile of OpenRTM; the studio, `aiorts graph` and `aiorts export` read it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import field
from math import isfinite
from pathlib import Path
from typing import Any, Final, NamedTuple

from aiorts.late import dataclass

LARGEST_LAYOUT: Final = 1 << 20
"""The most bytes of a layout file."""
_SCHEMA: Final = 1
FARTHEST: Final = 1e6
"""The most pixels from the origin to a place."""


class Place(NamedTuple):
    """The place of the corner of a box at its top left."""

    x: float
    """The distance from the left of the kernel."""
    y: float
    """The distance from the top of the band, which is that of the box's context or composite."""
    top: float
    """The top of that band, from the top of the kernel."""


@dataclass(slots=True)
class Places:
    """The places of a kernel's boxes.

    Attributes:
        boxes: by the names of components.
        by_hand: the components that a user has moved.
    """

    boxes: dict[str, Place] = field(default_factory=dict)
    by_hand: set[str] = field(default_factory=set)


def layout_beside(path: Path) -> Path:
    """The layout file of a system file."""
    return path.with_suffix(".layout.json")


def text_of_places(kernel: str, places: Places) -> str:
    """The text of a layout file.

    Args:
        kernel: the name of the kernel that stays over restarts, for readers.
    """
    parts = {"schema": _SCHEMA, "kernel": kernel, "by_hand": sorted(places.by_hand)}
    head = "".join(f"  {_json(name)}: {_json(value)},\n" for name, value in parts.items())
    # Each box has its own line, so that a moved box changes one line.
    boxes = ",\n".join(f"    {_json(name)}: {_json(place)}" for name, place in sorted(places.boxes.items()))
    return f'{{\n{head}  "boxes": {{\n{boxes}\n  }}\n}}\n'


def _json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def places_of(data: bytes) -> Places:
    """The places in a layout file; ValueError: it is no such file."""
    if len(data) > LARGEST_LAYOUT:
        raise ValueError(f"expected at most {LARGEST_LAYOUT} bytes")
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        raise ValueError("expected places as JSON") from None
    if not isinstance(document, dict) or document.get("schema") != _SCHEMA:
        raise ValueError(f"expected schema = {_SCHEMA}")
    boxes, by_hand = document.get("boxes"), document.get("by_hand", [])
    if not isinstance(boxes, Mapping) or not all(map(_is_place, boxes.values())):
        raise ValueError("boxes: expected three numbers for each component")
    if not isinstance(by_hand, list) or not all(isinstance(one, str) for one in by_hand):
        raise ValueError("by_hand: expected names of components")
    return Places({name: Place(*map(float, place)) for name, place in boxes.items()}, set(by_hand) & boxes.keys())


def _is_place(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 3
        and all(type(one) in (int, float) and isfinite(one) and abs(one) <= FARTHEST for one in value)
    )


def stored_places(file: Path, report: Callable[[Path, str], None]) -> Places | None:
    """The places in the layout file of a system file; None if there is no such file, or it is unusable.

    Args:
        report: gets the path of a layout file that is of no use, and why.
    """
    path = layout_beside(file)
    try:
        if path.is_file():
            with path.open("rb") as source:
                return places_of(source.read(LARGEST_LAYOUT + 1))
    except OSError as error:
        report(path, f"cannot be read: {error.strerror}")
    except ValueError as error:
        report(path, f"{error}; not used")
    return None
