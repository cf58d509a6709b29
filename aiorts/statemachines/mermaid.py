"""Writes a chart as a Mermaid state diagram, for notebooks, forges and browsers; active states can be marked."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from aiorts.statemachines.chart_structure import StateStructure, structure_of
from aiorts.statemachines.charting import Chart

_RESERVED: Final = frozenset(
    {"state", "end", "note", "class", "classDef", "direction", "as", "default", "style", "click", "accTitle", "root"}
)
_PLAIN: Final = re.compile(r"\w+")


def write_mermaid(chart: Chart, active: tuple[str, ...] = ()) -> str:
    """The chart as text for Mermaid, `active` states marked."""
    root = structure_of(chart)
    drawing = _Drawing(root)
    lines = ["stateDiagram-v2", *(f"    {line}" for line in drawing.inside(root))]
    if active:
        lines.append("    classDef active stroke-width:4px,font-weight:bold")
        lines += [f"    class {drawing.ids[name]} active" for name in active]
    return "\n".join(lines) + "\n"


class _Drawing:
    """Assigns each arrow to the innermost state that has both of its ends.

    Mermaid would otherwise draw the target state inside the source.
    """

    def __init__(self, root: StateStructure) -> None:
        self.ids = dict(_ids(root))
        self._around: dict[str, tuple[StateStructure, ...]] = {}
        self._arrows: dict[str, list[str]] = {}
        self._place(root, ())
        self._draw(root)

    def inside(self, state: StateStructure) -> Iterator[str]:
        """The lines between the braces of a state."""
        if state.kind == "state" and state.initial:
            yield f"[*] --> {self.ids[state.initial[0]]}{_acts(state.init)}"
        for number, child in enumerate(state.states):
            if number and state.kind == "parallel" and child.kind not in ("history", "deep"):
                yield "--"
            yield from self._state(child)
        yield from self._arrows.get(state.name, ())

    def _place(self, state: StateStructure, around: tuple[StateStructure, ...]) -> None:
        self._around[state.name] = around
        for child in state.states:
            self._place(child, (*around, state))

    def _draw(self, state: StateStructure) -> None:
        own = self._around[state.name]
        for way in state.transitions:
            if way.target is not None:
                other = self._around[way.target]
                both = [one for one, two in zip(own, other, strict=False) if one is two]
                # The regions of a parallel state are drawn separately: an arrow between two of them is written outside.
                holder = next((one for one in reversed(both) if one.kind != "parallel"), None)
                label = way.label
                arrow = f"{self.ids.get(state.name, '[*]')} --> {self.ids[way.target]}" + (
                    f" : {label}" if label else ""
                )
                self._arrows.setdefault("root" if holder is None else holder.name, []).append(arrow)
        for child in state.states:
            self._draw(child)

    def _state(self, state: StateStructure) -> Iterator[str]:
        own = self.ids[state.name]
        if state.kind in ("history", "deep"):
            yield f'state "{"H*" if state.kind == "deep" else "H"} {state.name}" as {own}'
            return
        named = f'state "{state.name}" as {own}' if own != state.name else f"state {own}"
        if state.states:
            yield f"{named} {{"
            yield from (f"    {line}" for line in self.inside(state))
            yield "}"
        else:
            yield named
        for word in ("entry", "do", "exit"):
            acts = getattr(state, word)
            if acts:
                yield f"{own} : {word} / {', '.join(acts)}"
        if state.defer:
            yield f"{own} : defer {', '.join(state.defer)}"
        yield from (f"{own} : {way.label}" for way in state.transitions if way.target is None)
        if state.kind == "final":
            yield f"{own} --> [*]"


def _ids(state: StateStructure) -> Iterator[tuple[str, str]]:
    for child in state.states:
        plain = _PLAIN.fullmatch(child.name) and child.name not in _RESERVED
        yield child.name, child.name if plain else "s_" + re.sub(r"\W", "_", child.name) + "_"
        yield from _ids(child)


def _acts(acts: tuple[str, ...]) -> str:
    return f" : / {', '.join(acts)}" if acts else ""
