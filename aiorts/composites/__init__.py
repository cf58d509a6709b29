"""Composites: several components that look and run as one.

The kernel knows a composite only as a group of components (`Group`). Members are added and removed between two cycles;
each change takes effect as a whole or not at all.
"""

from __future__ import annotations

from aiorts.composites.composite import Composite, CompositeChanged
from aiorts.composites.composition import exports, groups_of, shown
from aiorts.composites.composition_check import group_of, leaves_of, outer_of, parts_of
from aiorts.composites.group import CompositeGroup
from aiorts.composites.membership import Wanted, change, transition
from aiorts.composites.previous_placement import PreviousPlacement
from aiorts.composites.recovery import bring_back, stopped_with
from aiorts.model.policy import ErrorPolicy
