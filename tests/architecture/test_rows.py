"""Rows and faults that we claim have tests, rows quick ones; ROWS.md and FAULTS.md say which, and SLOW.txt is true."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

import faults
import rows
import tiers

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="module", params=["row", "fault"])
def listed(request: pytest.FixtureRequest) -> tuple[Any, dict[Any, list[str]], dict[Any, str]]:
    """The module that writes the table, what the tests are marked with, and what is claimed."""
    module = rows if request.param == "row" else faults
    return module, rows.collect(request.param), rows.FEATURES if module is rows else faults.EXPECTED  # type: ignore[return-value]


def test_every_claim_has_a_test_and_every_mark_is_in_the_list(listed: Any) -> None:
    _, marked, claimed = listed
    assert sorted(claimed.keys() ^ marked.keys()) == []


def test_every_row_has_a_quick_test() -> None:
    marked = rows.collect("row")
    assert [mark for mark, tests in marked.items() if all(tiers.is_slow(f"tests/{test}") for test in tests)] == []


def test_the_file_is_up_to_date(listed: Any) -> None:
    module, marked, _ = listed
    written = module.TARGET.read_text(encoding="utf-8")
    assert written == module.render(marked), f"run: python tests/{module.__name__}.py"


def test_marks_of_module_class_and_function_are_found(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "test_x.py").write_text(
        "import pytest\n"
        "pytestmark = [pytest.mark.anyio, pytest.mark.row(1)]\n"
        "@pytest.mark.row(2, 3)\n"
        "async def test_a(): ...\n"
        "@pytest.mark.row(4)\n"
        "class TestB:\n"
        "    @pytest.mark.row(5)\n"
        "    def test_c(self): ...\n"
        "@pytest.mark.parametrize('x', [pytest.param(1, marks=pytest.mark.fault('A01'))])\n"
        "def test_d(x): ...\n"
        "def helper(): ...\n"
    )
    a, c, d = "deep/test_x.py::test_a", "deep/test_x.py::TestB::test_c", "deep/test_x.py::test_d"
    assert rows.collect("row", tmp_path) == {1: [a, c, d], 2: [a], 3: [a], 4: [c], 5: [c]}
    assert rows.collect("fault", tmp_path) == {"A01": [d]}


def test_every_slow_test_names_the_quick_one_that_keeps_its_promise() -> None:
    """Or that it keeps it itself, with its first case or in the slow tier."""
    table = tiers.table()
    defined = {f"tests/{name}" for name in rows.defined(rows.TESTS)}
    assert sorted(table.keys() - defined) == [], "in SLOW.txt, but gone or renamed"
    keepers = {name: keeper for name, keeper in table.items() if keeper not in (tiers.FIRST, tiers.ALONE)}
    assert {name: keeper for name, keeper in keepers.items() if keeper not in defined} == {}, "no such test"
    assert {name: keeper for name, keeper in keepers.items() if tiers.is_slow(keeper)} == {}, "slow itself"
