"""The pictures of the guide are what a run in virtual time gives, and show what their page says."""

from __future__ import annotations

import re
from statistics import median

import pytest

from aiorts.guide.contents import FOLDER, page
from guide_pictures import POLICIES, drawn, samples


@pytest.mark.parametrize("name", POLICIES)
def test_a_picture_is_what_its_script_draws(name: str) -> None:
    assert (FOLDER / "howto" / f"policy-{name}.svg").read_text(encoding="utf-8") == drawn(name), (
        "run python tests/guide_pictures.py, and look whether the page says the same"
    )


def test_the_page_shows_each_picture_once_and_there_are_no_others() -> None:
    found = page("choose-policy")
    assert found is not None
    shown = re.findall(r"\((policy-[a-z-]+\.svg)\)", found.text)
    assert sorted(shown) == sorted(path.name for path in FOLDER.rglob("policy-*.svg")) == sorted(set(shown))


@pytest.mark.parametrize(
    ("name", "age", "dropped"),
    [("flush", 0.2, True), ("new-new", 0.025, True), ("new-skip", 0.025, True), ("periodic-new", 0.025, True),
     ("flush-drain", 0.0375, False), ("block", 0.1, False)],
)  # fmt: skip
def test_a_picture_shows_the_age_and_the_losses_that_the_page_states(name: str, age: float, dropped: bool) -> None:
    late = [sample for sample in samples(name) if sample.written >= 0.5]
    assert median(one.read - one.written for one in late if one.read is not None) == pytest.approx(age)
    assert any(one.read is None and not one.waits for one in late) == dropped
