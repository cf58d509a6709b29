"""`aiorts bench codec` measures the codecs of plugins beside ours, and says which it had to leave out."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from plugin_dists import project

CODEC = "from aiorts.wire import MsgpackCodec\nclass Same(MsgpackCodec):\n    '''Ours under another name.'''\n"


@pytest.mark.slow(kept_by="cli/test_filter_frames.py::test_a_codec_of_a_plugin_is_used")
@pytest.mark.row(54)
def test_a_codec_of_a_plugin_stands_beside_ours_and_a_broken_one_is_left_out(tmp_path: Path) -> None:
    modules = {"sames": CODEC, "brokens": "import no_such_module"}
    project(tmp_path, "sames", modules, {"codecs/same": "sames:Same", "codecs/broken": "brokens:Codec"})
    arguments = ["bench", "codec", "--quick", "--rounds", "1", "--scale", "0.01", "--no-peers", "--json"]
    done = subprocess.run(
        [sys.executable, "-m", "aiorts", "--plugins", str(tmp_path), *arguments],
        capture_output=True,
        text=True,
        timeout=40,
        env={**os.environ},
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    text = json.dumps(report)
    assert "same, 6 doubles" in text
    assert "aiorts, 6 doubles" in text
    assert "left out: codec 'broken' of folder" in text
    assert "No module named 'no_such_module'" in text
    assert not report.get("faults")
