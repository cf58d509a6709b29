"""Makes the profile of a system of one component from the description of its type."""

from __future__ import annotations

from aiorts_openrtm.markup.element import Element
from aiorts_openrtm.markup.shapes import made, made_component, made_set, made_system
from aiorts_openrtm.profiles.rtc_profile import RtcProfile


def system_of_type(rtc: RtcProfile) -> Element:
    """A system with one component of this type, with its ports, parameters and context."""
    where = rtc.element.where
    sets = {
        "default": {one.name: one.default for one in rtc.parameters},
        "__widget__": {one.name: one.widget for one in rtc.parameters if one.widget},
        "__constraints__": {one.name: one.constraint for one in rtc.parameters if one.constraint},
        "__type__": {one.name: one.type for one in rtc.parameters if one.type},
    }
    places = {one.name: one.where for one in rtc.parameters}
    context = made(
        "ExecutionContexts",
        id="0",
        kind=rtc.context or "PeriodicExecutionContext",
        rate=str(rtc.rate or 1000.0),
        where=where,
    )
    parts = (
        *(made("DataPorts", name=one.name, ext_visible="true", where=one.where) for one in rtc.data_ports),
        *(made("ServicePorts", name=one.name, where=one.where) for one in rtc.service_ports),
        *(
            made_set(word, {key: (value, places[key]) for key, value in values.items()}, where)
            for word, values in sets.items()
            if values or word == "default"
        ),
        context,
    )
    return made_system(
        made_component(f"{rtc.name}0", rtc.id, parts, where=where),
        identity=f"RTSystem:{rtc.vendor or 'aiorts'}:{rtc.name}:{rtc.version or '1.0.0'}",
        abstract=rtc.description,
        where=where,
    )
