"""Types and codecs that plugins offer are found by their names on first use, and nothing is imported before."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import msgpack
import pytest

from aiorts import Catalogue, Kernel
from aiorts.errors import PluginError, UnknownTypeError, WireError
from aiorts.kernel.extensions import finders
from aiorts.testing import simulated
from aiorts.types import TimedDouble, all_types, find_type, wire_type
from aiorts.wire import MsgpackCodec, find_codec
from plugin_dists import COMPONENT, install, project

RECORD = "from aiorts.types import record\n@record\nclass {0}:\n    tm: int = 0\n    data: float = 0.0\n"
DATACLASS = "from dataclasses import dataclass\n@dataclass\nclass {0}:\n    tm: int\n    level: float\n"


@pytest.fixture(autouse=True)
def as_found() -> Iterator[None]:
    path = list(sys.path)
    yield
    sys.path[:] = path
    finders.offer_from(None)
    for name in [name for name in sys.modules if name.startswith("plug_")]:
        del sys.modules[name]


@pytest.mark.row(64)
def test_a_type_is_imported_when_its_name_is_asked_for_and_no_other_is(tmp_path: Path) -> None:
    project(tmp_path / "a", "plug-a", {"plug_a": RECORD.format("DepthA")}, {"types/DepthA": "plug_a:DepthA"})
    project(tmp_path / "b", "plug-b", {"plug_b": "raise SystemExit"}, {"types/DepthB": "plug_b:DepthB"})
    finders.offer_from(Catalogue([tmp_path]))
    assert find_type("TimedDouble") is TimedDouble
    assert "plug_a" not in sys.modules
    assert find_type("DepthA").__module__ == "plug_a"
    assert find_type("plug_a.DepthA") is find_type("DepthA")
    assert "plug_b" not in sys.modules


@pytest.mark.row(64)
def test_a_module_of_types_is_imported_when_nothing_else_has_the_name(tmp_path: Path) -> None:
    text = DATACLASS.format("DepthC") + "class NoRecord: pass\n@dataclass\nclass Handle:\n    file: object\n"
    project(tmp_path, "plug-c", {"plug_c": text}, {"types/anything": "plug_c"})
    finders.offer_from(Catalogue([tmp_path]))
    cls = find_type("DepthC")
    codec = MsgpackCodec()
    assert codec.decode(codec.encode(cls(1, 2.5))) == cls(1, 2.5)
    with pytest.raises(UnknownTypeError, match=r"'Handle': Handle\.file: a value of type object cannot travel"):
        find_type("Handle")


@pytest.mark.slow
@pytest.mark.row(64)
def test_installed_types_are_found_by_the_types_alone(tmp_path: Path) -> None:
    install(tmp_path, "plug-d", {"plug_d": RECORD.format("DepthD")}, {"types/DepthD": "plug_d:DepthD"})
    code = (
        "import sys; from aiorts.types import find_type; from aiorts.wire import MsgpackCodec\n"
        "for name in (b'plug_d.Other', b'xplug_d.DepthD', b'plug_d', b'DepthD', b'this.s', b'plug_d:DepthD'):\n"
        "    try: MsgpackCodec().decode(b'\\x93\\x01' + bytes([0xa0 + len(name)]) + name + b'\\x82')\n"
        "    except Exception as error: print(type(error).__name__, 'plug_d' in sys.modules, 'this' in sys.modules)\n"
        "print(find_type('DepthD').__qualname__)"
    )
    path = os.pathsep.join(filter(None, (str(tmp_path), os.environ.get("PYTHONPATH", ""))))
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "PYTHONPATH": path},
    )
    # What came in a frame imports nothing but a class that is declared under that very name.
    assert (done.stdout, done.stderr) == ("WireError False False\n" * 6 + "DepthD\n", "")


@pytest.mark.row(64)
def test_a_declared_type_that_a_frame_names_is_imported_and_a_broken_one_is_the_frames_error(tmp_path: Path) -> None:
    files = {"plug_w": RECORD.format("DepthW") + "@record\nclass Undeclared:\n    data: float = 0.0\n"}
    project(tmp_path / "w", "plug-w", files, {"types/Depth": "plug_w : DepthW"})
    project(tmp_path / "v", "plug-v", {"plug_v": "raise OSError"}, {"types/DepthV": "plug_v:DepthV"})
    finders.offer_from(Catalogue([tmp_path]))
    codec = MsgpackCodec()
    frame = msgpack.packb([1, "plug_w.DepthW", {"tm": 1, "data": 2.5}])
    with pytest.raises(WireError, match=r"unknown type 'plug_w\.Undeclared'"):
        codec.decode(frame.replace(b"\xadplug_w.DepthW", b"\xb1plug_w.Undeclared"))
    assert "plug_w" not in sys.modules
    found = codec.decode(frame)
    assert (type(found).__module__, found.tm, found.data) == ("plug_w", 1, 2.5)
    assert wire_type("plug_w.DepthW") is type(found) is find_type("plug_w.DepthW")
    for _ in range(2):
        with pytest.raises(WireError, match=r"plug_v\.DepthV.*OSError"):
            codec.decode(frame.replace(b"plug_w.DepthW", b"plug_v.DepthV"))


def test_a_bare_name_in_a_line_finds_a_declared_class_and_says_when_several_have_it(tmp_path: Path) -> None:
    for letter in "xy":
        entries = {f"types/Only{letter}": f"plug_{letter}:Only{letter}", "types/Both": f"plug_{letter}:Both"}
        text = RECORD.format(f"Only{letter}") + RECORD.format("Both")
        project(tmp_path / letter, f"plug-{letter}", {f"plug_{letter}": text}, entries)
    project(tmp_path / "z", "plug-z", {"plug_z": "raise SystemExit"}, {"types/Inz": "plug_z"})
    finders.offer_from(Catalogue([tmp_path]))
    assert wire_type("Onlyx") is None
    with pytest.raises(UnknownTypeError, match=r"'Both' is declared more than once: plug_x\.Both and plug_y\.Both"):
        wire_type("Both", bare=True)
    found = wire_type("Onlyx", bare=True)
    assert found is not None
    assert found.__module__ == "plug_x"
    assert wire_type("Inz", bare=True) is None  # a module is imported for what somebody types, and for no file


def test_a_near_name_of_a_plugins_type_is_given_without_importing_it(tmp_path: Path) -> None:
    project(tmp_path, "plug-e", {"plug_e": RECORD.format("DepthE")}, {"types/DepthE": "plug_e:DepthE"})
    finders.offer_from(Catalogue([tmp_path]))
    with pytest.raises(UnknownTypeError, match="unknown type 'DephtE'; did you mean DepthE"):
        find_type("DephtE")
    assert "plug_e" not in sys.modules


@pytest.mark.fault("F05")
@pytest.mark.parametrize(
    ("text", "target", "message"),
    [
        ("import no_such_module", "plug_f:DepthF", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("raise SystemExit(3)", "plug_f", "a plugin that may define it is broken: .*SystemExit: 3"),
        ("DepthF = 5", "plug_f:DepthF", "it is no record type"),
        ("class DepthF: pass", "plug_f:DepthF", "it is no record type"),
    ],
)
def test_a_broken_type_is_an_unknown_one_with_the_reason_and_is_tried_once(
    tmp_path: Path, text: str, target: str, message: str
) -> None:
    tries = tmp_path / "tries"
    text = f"with open({str(tries)!r}, 'a') as file: file.write('x')\n{text}"
    entry = "types/DepthF" if ":" in target else "types/others"
    project(tmp_path, "plug-f", {"plug_f": text}, {entry: target})
    finders.offer_from(Catalogue([tmp_path]))
    for _ in range(3):
        with pytest.raises(UnknownTypeError, match=message):
            find_type("DepthF")
    assert tries.read_text() == "x"
    assert find_type("TimedDouble") is TimedDouble


@pytest.mark.slow
@pytest.mark.fault("F05")
def test_a_type_whose_import_never_ends_holds_up_who_asks_for_seconds_and_no_longer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(finders, "_LIMIT", 0.2)
    stop = threading.Event()
    sys.modules["plug_stop"] = stop  # type: ignore[assignment]
    project(tmp_path, "plug-g", {"plug_g": "import plug_stop\nplug_stop.wait()"}, {"types/DepthG": "plug_g:DepthG"})
    finders.offer_from(Catalogue([tmp_path]))
    try:
        began = time.monotonic()
        with pytest.raises(UnknownTypeError, match=r"still being imported after 0.2 s"):
            find_type("DepthG")
        assert time.monotonic() - began < 5
    finally:
        stop.set()


def test_a_type_that_asks_for_another_while_it_is_imported_gets_it(tmp_path: Path) -> None:
    asking = "from aiorts.types import find_type\nOther = find_type('DepthI')\n" + RECORD.format("DepthH")
    modules = {"plug_h": asking, "plug_i": RECORD.format("DepthI")}
    project(tmp_path, "plug-h", modules, {"types/DepthH": "plug_h:DepthH", "types/DepthI": "plug_i:DepthI"})
    finders.offer_from(Catalogue([tmp_path]))
    began = time.monotonic()
    assert find_type("DepthH").__name__ == "DepthH"
    assert time.monotonic() - began < 3
    assert "plug_i.DepthI" in all_types()


@pytest.mark.fault("F05")
def test_two_types_that_ask_for_each_other_are_refused_without_waiting(tmp_path: Path) -> None:
    asking = "from aiorts.types import find_type\nOther = find_type('{0}')\n"
    modules = {"plug_j": asking.format("DepthK"), "plug_k": asking.format("DepthJ")}
    project(tmp_path, "plug-j", modules, {"types/DepthJ": "plug_j:DepthJ", "types/DepthK": "plug_k:DepthK"})
    finders.offer_from(Catalogue([tmp_path]))
    began = time.monotonic()
    with pytest.raises(UnknownTypeError, match="unknown type 'DepthJ'"):
        find_type("DepthJ")
    assert time.monotonic() - began < 4.0  # what waits for itself waits for 5


@pytest.mark.slow
def test_unknown_names_are_cheap(tmp_path: Path) -> None:
    """The packages are listed once, not for each name that somebody mistypes."""
    began = time.perf_counter()
    for number in range(300):
        with pytest.raises(UnknownTypeError):
            find_type(f"NoSuchType{number}")
    assert time.perf_counter() - began < 15  # 1 s on an idle machine, and ten times that with a list for each


@simulated
async def test_a_component_made_by_name_finds_the_types_of_its_kernels_process() -> None:
    async with Kernel() as kernel:
        with pytest.raises(Exception, match="unknown type 'NoDepth'"):
            await kernel.create("FlexiDump", inputs=("NoDepth",))
        assert not kernel.components


# -- codecs ------------------------------------------------------------------------------------------------------------

CODEC = (
    "from aiorts.wire import MsgpackCodec\n"
    "class Shifted(MsgpackCodec):\n"
    "    def encode(self, record): return b'!' + super().encode(record)\n"
    "    def decode(self, data, expected=None): return super().decode(data[1:], expected)\n"
)


@pytest.mark.row(54)
@pytest.mark.parametrize("offered", ["Shifted", "make", "ready"])
def test_a_codec_is_found_by_name_be_it_a_class_a_function_or_ready_made(tmp_path: Path, offered: str) -> None:
    text = CODEC + "make = lambda: Shifted()\nready = Shifted()\n"
    project(tmp_path, "plug-codec", {"plug_codec": text}, {"codecs/shifted": f"plug_codec:{offered}"})
    finders.offer_from(Catalogue([tmp_path]))
    codec = find_codec("shifted")
    frame = codec.encode(TimedDouble(1, 2.0))
    assert frame == b"!" + find_codec("msgpack").encode(TimedDouble(1, 2.0))
    assert codec.decode(frame, TimedDouble) == TimedDouble(1, 2.0)


@pytest.mark.row(54)
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Codec = 5", "codec 'odd': expected a class with encode and decode, got int"),
        ("class Codec: pass", "codec 'odd': Codec has no methods encode and decode"),
        (
            "class Codec:\n    def __init__(self): raise SystemError('no')",
            "codec 'odd': cannot be made: SystemError: no",
        ),
        ("raise SystemExit", "codec 'odd' of folder .* cannot be loaded: SystemExit"),
    ],
)
def test_what_is_no_codec_is_refused(tmp_path: Path, text: str, message: str) -> None:
    project(tmp_path, "plug-odd", {"plug_odd": text}, {"codecs/odd": "plug_odd:Codec"})
    finders.offer_from(Catalogue([tmp_path]))
    with pytest.raises(PluginError, match=message):
        find_codec("odd")
    with pytest.raises(PluginError, match="no codec named 'msgpck'; did you mean msgpack"):
        find_codec("msgpck")
    assert isinstance(find_codec("msgpack"), MsgpackCodec)


# -- the kernel --------------------------------------------------------------------------------------------------------


@pytest.mark.fault("F05")
def test_an_import_that_never_ends_stops_neither_the_loop_nor_the_end_of_the_kernel(tmp_path: Path) -> None:
    stop = threading.Event()
    sys.modules["plug_stop"] = stop  # type: ignore[assignment]
    modules = {"plug_hang": "import plug_stop\nplug_stop.wait()", "plug_fine": COMPONENT}
    entries = {"components/Hang": "plug_hang:Good", "components/Fine": "plug_fine:Good"}
    project(tmp_path, "plug-hang", modules, entries)

    async def main() -> float:
        async with Kernel(plugins=Catalogue([tmp_path])) as kernel:
            hanging = asyncio.ensure_future(kernel.create("Hang"))
            await asyncio.sleep(0.05)
            assert (await kernel.create("Fine")).name == "good0"
            began = time.monotonic()
        took = time.monotonic() - began
        hanging.cancel()
        with pytest.raises(asyncio.CancelledError):
            await hanging
        return took

    try:
        assert asyncio.run(main()) < 5.0
    finally:
        stop.set()


@pytest.mark.slow(kept_by="test_an_import_that_never_ends_stops_neither_the_loop_nor_the_end_of_the_kernel")
@pytest.mark.fault("F05")
def test_a_process_ends_although_an_import_does_not(tmp_path: Path) -> None:
    project(tmp_path, "plug-loop", {"plug_loop": "while True: pass"}, {"components/Loop": "plug_loop:Good"})
    code = (
        "import asyncio, pathlib, sys\nfrom aiorts import Catalogue, Kernel\n"
        "async def main():\n"
        "    async with Kernel(plugins=Catalogue([pathlib.Path(sys.argv[1])])) as kernel:\n"
        "        asyncio.ensure_future(kernel.create('Loop'))\n"
        "        await asyncio.sleep(0.2)\n"
        "asyncio.run(main())\nprint('ended')\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stdout, done.stderr) == (0, "ended\n", "")
