"""Composites: several components that look and run as one.

The kernel knows a composite only as a group of components (`Group`). Members are added and removed between two cycles;
each change takes effect as a whole or not at all.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING
from aiorts.late import late as _late

if TYPE_CHECKING:
    from aiorts.composites.composite import Composite, CompositeChanged
    from aiorts.composites.composition import exports, groups_of, shown
    from aiorts.composites.composition_check import group_of, leaves_of, outer_of, parts_of
    from aiorts.composites.group import CompositeGroup
    from aiorts.composites.membership import Wanted, change, transition
    from aiorts.composites.previous_placement import PreviousPlacement
    from aiorts.composites.recovery import bring_back, stopped_with
    from aiorts.model.policy import ErrorPolicy

_late(
    globals(),
    {
        "aiorts.composites.composite": "Composite CompositeChanged",
        "aiorts.composites.composition": "exports groups_of shown",
        "aiorts.model.policy": "ErrorPolicy",
        "aiorts.composites.composition_check": "group_of leaves_of outer_of parts_of",
        "aiorts.composites.group": "CompositeGroup",
        "aiorts.composites.membership": "Wanted change transition",
        "aiorts.composites.previous_placement": "PreviousPlacement",
        "aiorts.composites.recovery": "bring_back stopped_with",
    },
)
