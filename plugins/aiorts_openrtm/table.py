"""`[openrtm]`: the table of a system file that names the file of OpenRTM that it was made of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aiorts import KernelService, setting


@dataclass(frozen=True, slots=True)
class OpenRTMSettings:
    """The origin of a system that was made of a file of OpenRTM."""

    profile: Path | None = setting(  # noqa: RUF009 - it makes a field
        None, "The file of OpenRTM it was made of: aiorts export takes from it what a system file has no words for."
    )


class OpenRTM(KernelService):
    """Does nothing while a system runs."""

    name = "openrtm"
    settings = OpenRTMSettings
    provenance = True
