"""Prints a FlexiFilter's map as a table for people; it makes no component."""

from __future__ import annotations

from collections.abc import Sequence

from aiorts_flexi.common.ports import PortSpec, parse_port
from aiorts_flexi.mapping.mapping import Mapping, Rules

_HEADINGS = ("from", "factor", "to", "value")


def map_table(inputs: Sequence[str], outputs: Sequence[str], text: str, rules: Rules | None = None) -> str:
    """The map `text` between ports of these types, one line for each entry, without a line end.

    Raises:
        TypedTextError: a port or the map is wrong, with the place.
        ConfigurationError: the rules are wrong.
    """
    ins = [parse_port(spec, f"input{number}") for number, spec in enumerate(inputs)]
    outs = [parse_port(spec, f"output{number}") for number, spec in enumerate(outputs)]
    mapping = Mapping(ins, outs, text, rules or Rules())
    rows = [_HEADINGS, *(_row(mapping, outs, number) for number in range(len(mapping.entries)))]
    widths = [max(len(row[column]) for row in rows) for column in range(len(_HEADINGS))]
    padded = ([f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)] for row in rows)
    return "\n".join("  ".join(cells).rstrip() for cells in padded)


def _row(mapping: Mapping, outs: Sequence[PortSpec], number: int) -> tuple[str, ...]:
    entry = mapping.entries[number]
    source, target = mapping.inputs[entry.source], outs[entry.target]
    factor = "" if entry.mult is None else f"x {entry.mult!r}"
    offset = "" if entry.off is None else f" {'-' if str(entry.off).startswith('-') else '+'} {abs(entry.off)!r}"
    kinds = f"{source.kind(entry.source_pin)} -> {target.kind(entry.target_pin)}"
    return (_pin(source, entry.source_pin), f"{factor}{offset}", _pin(target, entry.target_pin), kinds)


def _pin(spec: PortSpec, pin: int | str) -> str:
    return spec.name if spec.shape == "scalar" else f"{spec.name}:{pin}"
