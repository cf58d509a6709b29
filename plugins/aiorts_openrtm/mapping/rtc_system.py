"""The profile of a system of one component, of the description of its type."""

from __future__ import annotations

from aiorts_openrtm.markup.element import Element
from aiorts_openrtm.markup.shapes import made, made_root
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
    name = f"{rtc.name}0"
    component = made(
        "Components",
        *(made("DataPorts", name=one.name, ext_visible="true", where=one.where) for one in rtc.data_ports),
        *(made("ServicePorts", name=one.name, where=one.where) for one in rtc.service_ports),
        *(
            made(
                "ConfigurationSets",
                *(made("ConfigurationData", name=key, data=value, where=places[key]) for key, value in values.items()),
                id=word,
                where=where,
            )
            for word, values in sets.items()
            if values or word == "default"
        ),
        made(
            "ExecutionContexts",
            id="0",
            kind=rtc.context or "PeriodicExecutionContext",
            rate=str(rtc.rate or 1000.0),
            where=where,
        ),
        made("Location", ext=True, x="0", y="0", height="0", width="0", direction="down"),
        id=rtc.id,
        pathUri=f"localhost/{name}.rtc",
        activeConfigurationSet="default",
        instanceName=name,
        compositeType="None",
        isRequired="true",
        ext_visible="true",
        where=where,
    )
    return made_root(
        component,
        id=f"RTSystem:{rtc.vendor or 'aiorts'}:{rtc.name}:{rtc.version or '1.0.0'}",
        abstract=rtc.description,
        creationDate="1970-01-01T00:00:00",
        updateDate="1970-01-01T00:00:00",
        version="0.2",
        where=where,
    )
