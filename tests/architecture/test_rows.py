"""Claims have tests, rows quick ones, and a slow test names the quick one that keeps its promise."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

import faults
import marks
import rows
import tiers

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="module", params=["row", "fault"])
def listed(request: pytest.FixtureRequest) -> tuple[Any, dict[Any, list[str]], dict[Any, str]]:
    """The module that writes the table, what the tests are marked with, and what is claimed."""
    module = rows if request.param == "row" else faults
    return module, marks.collect(request.param), rows.FEATURES if module is rows else faults.EXPECTED  # type: ignore[return-value]


@pytest.mark.slow
def test_every_claim_has_a_test_and_every_mark_is_in_the_list(listed: Any) -> None:
    _, marked, claimed = listed
    assert sorted(claimed.keys() ^ marked.keys()) == []


@pytest.mark.slow
def test_every_row_has_a_quick_test() -> None:
    marked = marks.collect("row")
    assert [mark for mark, tests in marked.items() if all(marks.is_slow(test) for test in tests)] == []


@pytest.mark.slow
def test_the_report_has_every_claim_and_every_test_that_is_marked(listed: Any) -> None:
    module, marked, claimed = listed
    written = module.render(marked)
    assert [text for text in claimed.values() if text not in written] == []
    assert [test for tests in marked.values() for test in tests if f"`{test}`" not in written] == []


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
    assert marks.collect("row", tmp_path) == {1: [a, c, d], 2: [a], 3: [a], 4: [c], 5: [c]}
    assert marks.collect("fault", tmp_path) == {"A01": [d]}


def test_the_nearest_mark_says_what_keeps_the_promise_of_a_slow_test(tmp_path: Path) -> None:
    (tmp_path / "test_x.py").write_text(
        "import pytest\n"
        "pytestmark = [pytest.mark.anyio, pytest.mark.slow]\n"
        "async def test_a(): ...\n"
        "@pytest.mark.slow(kept_by='test_a')\n"
        "def test_b(): ...\n"
        "@pytest.mark.slow(kept_by='deep/test_y.py::test_c')\n"
        "class TestB:\n"
        "    def test_c(self): ...\n"
        "TestMachine = Machine.TestCase\n"
        "TestMachine.pytestmark = [pytest.mark.slow(kept_by='first')]\n"
    )
    (tmp_path / "test_y.py").write_text(
        "@pytest.mark.parametrize('x', [pytest.param(1, marks=pytest.mark.slow)])\ndef test_one_case_alone(x): ...\n"
    )
    assert marks.slow(tmp_path) == {
        "test_x.py::test_a": tiers.ALONE,
        "test_x.py::test_b": "test_x.py::test_a",
        "test_x.py::TestB::test_c": "deep/test_y.py::test_c",
        "test_x.py::TestMachine::runTest": tiers.FIRST,
    }


def test_every_slow_test_names_the_quick_one_that_keeps_its_promise() -> None:
    """Or that it keeps it itself, with its first case or in the slow tier."""
    keepers = {name: keeper for name, keeper in marks.slow().items() if keeper not in (tiers.FIRST, tiers.ALONE)}
    assert {name: keeper for name, keeper in keepers.items() if keeper not in marks.defined(marks.TESTS)} == {}, (
        "no such test"
    )
    assert {name: keeper for name, keeper in keepers.items() if marks.is_slow(keeper)} == {}, "slow itself"
