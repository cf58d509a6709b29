"""The values that a component keeps when its declarations change: those that still exist and are still allowed."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

from aiorts.errors import ConfigurationError
from aiorts.model.configuration.parameters import validate
from aiorts.model.configuration.sets import ConfigurationState


def handed_over(
    old: ConfigurationState,
    new: ConfigurationState,
    declared: Collection[str],
    is_free: Callable[[str], bool],
    owner: str,
) -> tuple[ConfigurationState, dict[str, str]]:
    """The new declarations with the old sets, values and active set; and the reasons for lost values, by parameter.

    Args:
        declared: parameters that the old class declared; others were added at run time, and are kept.
        is_free: whether a parameter of this name can be added to the new component.
    """
    lost: dict[str, str] = {}
    state = new
    for name, spec in old.specs.items():
        if name in state.specs or name in declared:
            continue
        if is_free(name):
            state = state.with_parameter(spec, owner)
        else:
            lost[name] = "the new code has something of that name"
    for set_name, values in old.sets.items():
        kept: dict[str, Any] = dict(new.sets.get(set_name, {}))
        for name, value in values.items():
            if name not in state.specs:
                lost.setdefault(name, "the new code has no such parameter")
                continue
            try:
                kept |= validate(state.specs, {name: value}, owner=owner, current=state.values)
            except ConfigurationError as error:
                lost.setdefault(name, str(error))
        state = state.merged({set_name: kept}, None, owner)
    return state.activated(old.active, owner), lost
