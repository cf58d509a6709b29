"""Pictures of systems: the places of boxes, the ways of edges round them, and the file that keeps the places.

Pure: `aiorts graph` and the studio draw what comes out.
"""

from __future__ import annotations

from aiorts.layout.boxes import HEAD, ROW, Band, Edge, Key, Route, Spot, meets
from aiorts.layout.detour import Point
from aiorts.layout.file import (
    FARTHEST,
    LARGEST_LAYOUT,
    Place,
    Places,
    layout_beside,
    places_of,
    stored_places,
    text_of_places,
)
from aiorts.layout.placing import (
    BAND_FOOT,
    BAND_GAP,
    BAND_HEAD,
    GROUP_GAP,
    GROUP_HEAD,
    LEFT,
    Layout,
)
from aiorts.layout.stacking import columns

__all__ = (
    "BAND_FOOT",
    "BAND_GAP",
    "BAND_HEAD",
    "Band",
    "Edge",
    "FARTHEST",
    "GROUP_GAP",
    "GROUP_HEAD",
    "HEAD",
    "Key",
    "LARGEST_LAYOUT",
    "LEFT",
    "Layout",
    "Place",
    "Places",
    "Point",
    "ROW",
    "Route",
    "Spot",
    "columns",
    "layout_beside",
    "meets",
    "places_of",
    "stored_places",
    "text_of_places",
)
