"""The stable names: the list that the guide shows is of names that there are, and none goes by accident."""

from __future__ import annotations

import importlib
import re
from importlib.metadata import entry_points

from test_layers import ROOT

import aiorts.types
from aiorts.guide import headings, page
from aiorts.system import schema
from aiorts.tiers import NOT_STABLE, tier_of_command, tier_of_page

FEWEST = {
    "aiorts": 28,
    "aiorts.clock": 6,
    "aiorts.errors": 22,
    "aiorts.exits": 13,
    "aiorts.system": 7,
    "aiorts.testing": 5,
    "aiorts.types": 184,
    "aiorts_log": 12,
}
"""How many names of a module were stable once: the list of the page cannot be made shorter unnoticed."""


def stable() -> dict[str, list[str]]:
    """Module -> its stable names, as the page `stability` lists them."""
    found = page("stability")
    assert found is not None
    block = headings(found.text)["The stable names"].partition("```text\n")[2].partition("```")[0]
    parts = re.split(r"^(\S+):\n", block, flags=re.MULTILINE)
    return {module: names.split() for module, names in zip(parts[1::2], parts[2::2], strict=True)}


def test_every_stable_name_is_there_and_public() -> None:
    gone = []
    for module, names in stable().items():
        loaded = importlib.import_module(module)
        gone += [f"{module}.{name}" for name in names if name not in loaded.__all__ or not hasattr(loaded, name)]
    assert gone == [], "deprecate it first: aiorts/guide/pages/explanation/stability.md"


def test_the_list_is_not_made_shorter() -> None:
    listed = stable()
    assert listed.keys() == FEWEST.keys()
    assert {module: len(names) for module, names in listed.items() if len(names) < FEWEST[module]} == {}
    assert set(listed["aiorts.types"]) == set(aiorts.types.__all__)


STABLE_TABLES = {"schema", "include", "variables", "plugins", "clock", "components", "connections", "contexts"} | {
    *("record", "replay")
}
"""Of a system file, those of the stable tier."""


def test_each_table_of_a_system_file_is_of_one_tier() -> None:
    found = page("stability")
    assert found is not None
    said = re.search(r"The tables\s+(.*?) are provisional,\s+(.*?) experimental", found.text, re.DOTALL)
    assert said is not None
    others = set(re.findall(r"`(\w+)`", "".join(said.groups())))
    assert (set(schema()["properties"]), others & STABLE_TABLES) == (STABLE_TABLES | others, set())


def test_recordings_are_stable_whoever_writes_them() -> None:
    assert [tier_of_command(name) for name in ("record", "log", "replay")] == [None] * 3
    assert tier_of_page("recording") is None


def test_the_flexi_components_are_there() -> None:
    offered = {one.name for one in entry_points(group="aiorts.components") if one.value.startswith("aiorts_flexi")}
    assert offered >= {f"Flexi{name}" for name in ("Add", "Const", "Dump", "Dupe", "Filter", "Logger", "Select")}


def test_readme_and_the_page_name_what_belongs_to_each_tier() -> None:
    found = page("stability")
    assert found is not None
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    for tier in NOT_STABLE:
        things = ", ".join(tier.things).lower()
        for text, begin in ((readme, f"**{tier.name.lower()}**: "), (found.text, f"\n| {tier.name.lower()} | ")):
            part = re.split(r"[;.]| \|", text.partition(begin)[2], maxsplit=1)[0]
            assert part.lower() == things
