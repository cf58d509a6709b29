"""Files of OpenRTM: profiles of systems (RtsProfile, XML and YAML), `rtc.conf`, `.conf` of components, `RTC.xml`.

`markup/` reads and writes XML and YAML as a tree, `profiles/` and `conf/` hold their content as values, `mapping/`
makes systems of them and back, `commands/` is `aiorts import` and `aiorts export`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aiorts.late import late

if TYPE_CHECKING:
    from aiorts_openrtm.conf.properties import Conf, Entry
    from aiorts_openrtm.errors import OpenRTMError
    from aiorts_openrtm.mapping.opening import read_system
    from aiorts_openrtm.notes import Note
    from aiorts_openrtm.profiles.rtc_profile import (
        RtcDataPort,
        RtcInterface,
        RtcParameter,
        RtcProfile,
        RtcServicePort,
    )
    from aiorts_openrtm.profiles.rts_profile import RtsProfile

__all__ = (
    "Conf",
    "Entry",
    "Note",
    "OpenRTMError",
    "RtcDataPort",
    "RtcInterface",
    "RtcParameter",
    "RtcProfile",
    "RtcServicePort",
    "RtsProfile",
    "read_system",
)

late()
