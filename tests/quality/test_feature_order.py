"""Features stand at a transport in the order of one tuple, whichever room has offered its own first."""

from __future__ import annotations

import pytest

from aiorts.kernel.ports import features
from aiorts.kernel.quality import FEATURES
from aiorts.links import linked
from aiorts.model.profile import ConnectorProfile


@pytest.mark.parametrize("links_first", [False, True])
def test_features_of_a_link_stand_in_one_order(monkeypatch: pytest.MonkeyPatch, *, links_first: bool) -> None:
    monkeypatch.setattr(features, "_FEATURES", [])
    for rows in (linked.FEATURES, FEATURES)[:: 1 if links_first else -1]:
        features.offer(*rows)
    profile = ConnectorProfile(far_end="reader", lifespan=1.0, measure=10)
    keys = [feature.key for feature in features.features_of(profile)]
    assert keys == ["lifespan", "measure", "on_link_lost", "on_link_lost"]
