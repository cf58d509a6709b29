"""A converter as text: FILE.py:function, package.module:function, or a name that a plugin offers with its own text."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.errors import AiortsError, PluginError, WiringError
from aiorts.kernel.extensions.catalogue import Catalogue
from aiorts.testing import simulated
from aiorts.types import TimedDouble, TimedLong
from plugin_dists import project

FUNCTIONS = """
from aiorts.types import TimedDouble, TimedLong
number = 3
class Needs:
    def __init__(self, a, b): pass
def to_mm(sample: TimedDouble) -> TimedLong:
    return TimedLong(sample.tm, round(sample.data * 1000))
def two(a, b): return a
async def later(sample): return sample
def several(sample): yield sample
"""
OFFERED = """
from aiorts.errors import ConfigurationError
from aiorts.types import TimedLong
thing = 3
def scale(text, source, target):
    if text == "raise":
        raise RuntimeError("no such luck")
    if text == "nothing":
        return None
    try:
        factor = float(text)
    except ValueError:
        raise ConfigurationError(f"scale {text!r}: expected a number") from None
    return lambda sample: target(sample.tm, round(sample.data * factor))
"""


class Metres(Component):
    out = OutPort(TimedDouble, unit="m")


class Millimetres(Component):
    inp = InPort(TimedLong, unit="mm")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    (tmp_path / "scaling.py").write_text(FUNCTIONS)
    project(tmp_path / "plug", "plug-scale", {"plug_scale": OFFERED}, {
        "converters/scale": "plug_scale:scale",
        "converters/thing": "plug_scale:thing",
    })  # fmt: skip
    monkeypatch.chdir(tmp_path)
    path, modules = list(sys.path), set(sys.modules)
    sys.path.insert(0, str(tmp_path))
    yield tmp_path
    sys.path[:] = path
    for name in set(sys.modules) - modules:
        if name in ("scaling", "plug_scale"):
            del sys.modules[name]


async def converted(folder: Path, text: Any) -> tuple[str | None, int]:
    async with Kernel(plugins=Catalogue((folder / "plug",))) as kernel:
        metres, millimetres = await kernel.create(Metres), await kernel.create(Millimetres)
        connector = await kernel.connect(metres.out, millimetres.inp, convert=text)
        metres.out.write_nowait(TimedDouble(7, 1.5))
        sample = millimetres.inp.read_nowait()
        assert sample.tm == 7
        return connector.profile.convert, sample.data


@pytest.mark.parametrize("text", ["scaling.py:to_mm", "scaling:to_mm", "scale 1000", " scale  1000 ", "map 0>1000>0"])
def test_each_form_converts_and_the_profile_has_the_text(folder: Path, text: str) -> None:
    @simulated
    async def run() -> None:
        assert await converted(folder, text) == (text.strip(), 1500)

    run()


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("scaling.py:to_mmm", PluginError, r"convert: .*there is no 'to_mmm'; did you mean 'to_mm'\?"),
        ("scalin.py:to_mm", PluginError, r"no file 'scalin.py' in .*; did you mean 'scaling.py:to_mm'\?"),
        ("scalings:to_mm", PluginError, r"no module named 'scalings'; did you mean scaling\?"),
        ("scaling.py:two", PluginError, "this function cannot be called with one sample alone: missing"),
        ("scaling.py:Needs", PluginError, "this class cannot be called with one sample alone: missing"),
        ("scaling.py:later", PluginError, "is a coroutine function, and nothing waits inside a write"),
        ("scaling.py:several", PluginError, "is a generator function"),
        ("scaling.py:number", PluginError, "expected a function or a text, got int"),
        (
            "scall 3",
            PluginError,
            r"no converter named 'scall'; did you mean scale\?; a function is written FILE\.py:function",
        ),
        ("0:1>0", PluginError, "or the name of a converter with its text behind it; there are map, scale, thing"),
        ("thing 3", PluginError, "converter 'thing' of folder .* a int makes no converter"),
        ("scale x", WiringError, r"metres0.out -> millimetres0.inp: convert = scale x: scale 'x': expected a number"),
        ("scale raise", WiringError, "it could not be made: RuntimeError: no such luck"),
        ("scale nothing", WiringError, "it made something else: expected a function or a text, got NoneType"),
        ("map 0>1000", WiringError, "convert = map 0>1000: map '0>1000', character 1: there is no out-port 1000"),
        ("", WiringError, "convert = '': expected a text that names a converter; give a plain function"),
    ],
)
def test_what_finds_none_is_refused_with_the_remedy(
    folder: Path, text: str, error: type[AiortsError], message: str
) -> None:
    @simulated
    async def run() -> None:
        with pytest.raises(error, match=message):
            await converted(folder, text)

    run()
