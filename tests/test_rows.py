"""Every row of the comparison that we claim has a test, and ROWS.md says which."""

from __future__ import annotations

from typing import TYPE_CHECKING

import rows

if TYPE_CHECKING:
    from pathlib import Path


def test_every_claimed_row_has_a_test() -> None:
    missing = sorted(rows.FEATURES.keys() - rows.collect().keys())
    assert missing == [], f"rows without a test: {missing}"


def test_every_marked_row_is_in_the_list() -> None:
    assert sorted(rows.collect().keys() - rows.FEATURES.keys()) == []


def test_rows_file_is_up_to_date() -> None:
    written = rows.TARGET.read_text(encoding="utf-8")
    assert written == rows.render(rows.collect()), "run: python tests/rows.py"


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
        "def helper(): ...\n"
    )
    a, c = "deep/test_x.py::test_a", "deep/test_x.py::TestB::test_c"
    assert rows.collect(tmp_path) == {1: [a, c], 2: [a], 3: [a], 4: [c], 5: [c]}
