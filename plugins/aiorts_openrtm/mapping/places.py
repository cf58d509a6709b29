"""Places of boxes: the `Location` of a profile's components, and the layout file of a system file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isfinite

from aiorts.layout import BAND_HEAD, FARTHEST, Place, Places
from aiorts.system import Wanted
from aiorts_openrtm.markup.element import Element
from aiorts_openrtm.markup.shapes import RTS, RTS_EXT


def located(root: Element, names: Mapping[str, str], wanted: Wanted) -> Places:
    """The places that a profile states; 0, 0 states none, since tools that place nothing write it.

    Args:
        names: the name in the system file of each component of the profile.
        wanted: the system; the highest box of each context stands at the top of its band.
    """
    found = {names.get(name, name): place for name, place in _stated(root)}
    contexts: dict[str, str] = {}
    for context in wanted.contexts.values():
        for member in context.members:
            contexts.setdefault(member, context.name)
    tops: dict[str, float] = {}
    for name, (_, y) in found.items():
        home = contexts.get(name, "")
        tops[home] = min(tops.get(home, y), y)
    places = Places()
    for name, (x, y) in found.items():
        top = tops[contexts.get(name, "")] - BAND_HEAD
        places.boxes[name] = Place(x, y - top, top)
        places.by_hand.add(name)
    return places


def _stated(root: Element) -> Iterator[tuple[str, tuple[float, float]]]:
    for component in root.elements(RTS, "Components"):
        for location in component.elements(RTS_EXT, "Location"):
            try:
                x, y = (float(location.get(RTS_EXT, word)) for word in ("x", "y"))
            except ValueError:
                continue
            if (x or y) and all(isfinite(one) and abs(one) <= FARTHEST for one in (x, y)):
                yield component.get(RTS, "instanceName"), (x, y)


def with_places(root: Element, names: Mapping[str, str], places: Places) -> Element:
    """The profile with the places of a system file's boxes; a `Location` that states the same stays as it is."""

    def component(one: Element) -> Element:
        name = one.get(RTS, "instanceName")
        place = places.boxes.get(names.get(name, name)) if (one.space, one.local) == (RTS, "Components") else None
        return one if place is None else one.edited(lambda child: _at(child, place))

    return root.edited(component)


def _at(one: Element, place: Place) -> Element:
    if (one.space, one.local) != (RTS_EXT, "Location"):
        return one
    for word, value in (("x", place.x), ("y", place.top + place.y)):
        stated = one.get(RTS_EXT, word)
        try:
            is_same = float(stated) == value
        except ValueError:
            is_same = False
        if not is_same:
            one = one.with_attribute(f"rtsExt:{word}", RTS_EXT, str(round(value)))
    return one
