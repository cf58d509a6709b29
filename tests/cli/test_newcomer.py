"""What a newcomer does wrong, and what is shown of components of one's own: one line, the right status."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aiorts import Component, Kernel
from aiorts.cli.console.report import LONGEST, shortened
from aiorts.errors import ComponentError, DeclarationError
from aiorts.testing import simulated
from aiorts.types import record
from run_parts import here

PARTS = """
from collections.abc import Iterator
import aiorts
from aiorts import Component, InPort, OutPort, Param, component
from aiorts.types import TimedDouble

class NoName(Component):
    def __init__(self): pass
class NoSuper(Component):
    out = OutPort(TimedDouble)
    def __init__(self, name): self.z = 1
class NoSuperPorts(NoSuper):
    def make_ports(self): pass
class LowPass(Component):
    '''A filter.'''
    raw = InPort(TimedDouble, unit="m")
    smooth = OutPort(TimedDouble, unit="m")
    alpha = Param(0.5, gt=0.0, le=1.0, doc="weight of the newest sample")
@component
def scale(x: float, *, k: float = Param(2.0, ge=0.0)) -> float:
    return x * k
@aiorts.component(when="all")
async def half(x: float) -> float:
    return x / 2
def plain(x: float) -> float:
    return x
Third = aiorts.component(plain, name="Third")
"""
NO_NAME = "; write def __init__(self, name) and call super().__init__(name)\n"
NO_SUPER = "NoSuper.__init__ must call super().__init__(name)\n"
SYSTEM = """schema = 1
[components.src]
type = "FlexiConst"
params.outputs = ["TimedDouble"]
params.constants = ["1"]
[components.low]
type = "parts.py:LowPass"
[[connections]]
from = "src.output"
to = "low.raw"
[contexts.loop]
kind = "periodic"
rate = 10.0
members = ["src", "low"]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "system.toml").write_text(SYSTEM)
    return tmp_path


def aiorts(folder: Path, *arguments: str, stdin: str = "", plugins: str = "") -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "aiorts", *arguments],
        input=stdin,
        capture_output=True,
        text=True,
        timeout=40,
        cwd=folder,
        env={**os.environ, "AIORTS_PLUGINS": plugins, "COLUMNS": "120"},
    )


# -- a constructor of one's own ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "parts.py:NoSuper"], NO_SUPER),
        (["run", "parts.py:NoName"], NO_NAME),
        (["--plugins", ".", "nosuper"], NO_SUPER),
        (["--plugins", ".", "noname", "--help"], NO_NAME),
        (["inspect", "parts.py:NoSuperPorts"], NO_SUPER.replace("NoSuper", "NoSuperPorts", 1)),
        (["run", "own.toml"], "own.toml:7:8: components.low: " + NO_SUPER),
    ],
)
def test_a_constructor_that_makes_no_component_is_one_line(folder: Path, arguments: list[str], said: str) -> None:
    (folder / "own.toml").write_text(SYSTEM.replace("LowPass", "NoSuper"))
    done = here(folder, *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("aiorts: E-PLUGIN: ")
    first, *quoted = done.stderr.splitlines(keepends=True)
    assert first.endswith(said)
    assert len(quoted) == 2 * (arguments[-1] == "own.toml")  # the line of the file, and a mark


UNMADE = r"^Unmade cannot be constructed: LookupError: no camera \(.*test_newcomer\.py:\d+\)$"


@simulated
async def test_a_kernel_names_the_class_that_cannot_be_constructed_and_keeps_the_cause() -> None:
    class Unmade(Component):
        def __init__(self, name: str) -> None:
            raise LookupError("no camera")

    async with Kernel() as kernel:
        with pytest.raises(ComponentError, match=UNMADE) as caught:
            await kernel.create(Unmade, "it")
        assert isinstance(caught.value.__cause__, LookupError)
        assert not kernel.components


# -- plugins of a folder -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_help_lists_what_the_environment_names_and_finds_functions(folder: Path) -> None:
    (folder / "p").mkdir()
    (folder / "p" / "parts.py").write_text(PARTS)
    for done in (
        here(folder, "help", "commands", AIORTS_PLUGINS="p"),
        here(folder, "--plugins", "p", "help", "commands"),
    ):
        assert done.returncode == 0
        listed = done.stdout.split("Components, as filters:")[1].replace(",", " ").split()
        assert {"lowpass", "scale", "half", "third"} <= set(listed)
        assert "plain" not in listed
    for name, said in (("scale", "4.0"), ("half", "1.0"), ("third", "2.0")):
        done = here(folder, name, stdin="2\n", AIORTS_PLUGINS="p")
        assert (done.returncode, done.stderr) == (0, "")
        assert f'"data": {said}' in done.stdout


def test_the_help_of_ones_own_component_shows_its_ports_and_the_range_of_its_parameters(folder: Path) -> None:
    done = here(folder, "--plugins", ".", "lowpass", "--help")
    shown = " ".join(done.stdout.split())
    assert "in raw TimedDouble m out smooth TimedDouble m" in shown
    assert '{"port": "raw", "data": ...}' in shown
    assert "weight of the newest sample [float; default 0.5; 0.0 < x <= 1.0]" in shown
    assert "input0" not in shown


def test_inspect_names_the_parameter_that_an_option_sets(folder: Path) -> None:
    shown = here(folder, "inspect", "FlexiConst").stdout
    assert "-p, --port       sets outputs" in shown


def test_the_help_of_flexifilter_explains_maps_by_examples_that_are_true(folder: Path) -> None:
    shown = here(folder, "flexifilter", "--help").stdout
    for example in ("0>1000>0", "0>1.8+32>0", "0:2>0,1>1:3"):
        assert f'-m "{example}"' in shown
    done = here(folder, *["flexifilter", "-i", "TimedDouble", "-o", "TimedDouble", "-m", "0>1.8+32>0"], stdin="100\n")
    assert '"data": 212.0' in done.stdout
    ports = "-i TimedDoubleSeq:3 -i TimedLong -o TimedDouble -o TimedDoubleSeq:4"
    assert here(folder, *f"flexifilter {ports} -m 0:2>0,1>1:3 --check".split()).returncode == 0


# -- messages ----------------------------------------------------------------------------------------------------------


def test_a_plugin_s_error_names_its_own_file_and_keeps_cause_and_remedy(folder: Path) -> None:
    deep = folder / ("a-folder-with-a-long-name/" * 5)
    deep.mkdir(parents=True)
    (deep / "lp.py").write_text(
        "from aiorts import component\n\n@component\ndef counter(*, n: int = 3):\n    yield 1.0\n"
    )
    done = here(folder, "inspect", f"{deep}/lp.py:counter")
    assert done.returncode == 2
    assert "signature.py" not in done.stderr
    assert "the result has no type hint; write" in done.stderr
    assert done.stderr.endswith("lp.py:3)\n")
    assert f"{deep}/lp.py" in done.stderr


@pytest.mark.slow
@given(
    st.lists(
        st.one_of(
            st.text("wo rd.:;,-", max_size=300).map(lambda text: (False, text)),
            st.text("ab.-_", min_size=1, max_size=60).map(lambda text: (True, f"/home/some-body/{text}/x.py")),
        ),
        max_size=8,
    )
)
def test_a_path_in_a_long_line_is_never_cut_and_the_words_are(parts: list[tuple[bool, str]]) -> None:
    line = shortened(" ".join(text for _, text in parts))
    paths = [text for is_path, text in parts if is_path]
    found = [word for word in line.split(" ") if word.startswith("/")]
    assert found == paths
    assert len(line) - sum(map(len, paths)) <= LONGEST + 8 * len(parts)
    assert line.count(" .../") == 0


def test_the_end_of_a_long_line_is_kept() -> None:
    folder = "/home/somebody/" + "robots/" * 40
    assert shortened(f"{folder}x.py: short") == f"{folder}x.py: short"
    line = shortened(f"{folder}x.py: it is wrong; {'a ' * 250}{folder}y.py; {'b ' * 250}; do this")
    assert line.startswith(f"{folder}x.py: it is wrong; a a")
    assert f" {folder}y.py " in line
    assert line.endswith("b b ; do this")
    assert shortened(f"'/home/my robots/x.py': {'a' * 400}").startswith("'/home/my robots/x.py': aaa")
    assert len(shortened("word " * 200)) == LONGEST


@pytest.mark.parametrize(
    "value",
    [
        "'" + "x y " * 5000 + "'",
        '"' + "it's " * 5000 + '"',
        repr("it's \"\n\t" * 5000),
        "x" * 50_000,
        "'" + "\\'" * 50_000 + "'",
    ],
)
def test_a_long_value_is_shortened_and_no_advice_is_cut(value: str) -> None:
    advice = 'say what is right: full = "block", ' + "or one of the others that you find in the guide " * 8 + "; end"
    line = shortened(f"E-X: pid0's value: got {value}; {advice}")
    assert line.startswith("E-X: pid0's value: got ")
    assert line.endswith(f"...{line.rpartition('...')[2]}")
    assert line.endswith(f"; {advice}")
    assert len(line) <= 140 + len(advice)


def test_the_message_of_a_field_that_cannot_travel_is_whole() -> None:
    class Scan:
        mode: complex

    with pytest.raises(DeclarationError) as caught:
        record(Scan)
    text = f"aiorts: E-PLUGIN: scan.py:Watch cannot be loaded: DeclarationError: {caught.value} (scan.py:7)"
    assert len(text) > 300
    assert shortened(text) == text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["graph", "system.toml", "-o", "g.png"],
            "E-USAGE: aiorts graph: -o g.png: no drawing ends in .png; there are ",
        ),
        (["run", "parts.py"], "E-CONFIG: parts.py: no system file; give parts.py:CLASS; it has NoName, NoSuper, "),
        (["run", "system.toml", "--set", "bogus"], "E-CONFIG: system.toml: --set 'bogus': expected COMPONENT.PARAM"),
        (["run", "system.toml", "--set", "a.b=1"], "E-CONFIG: system.toml: --set a.b=1: unknown component 'a'"),
        (["run", "system.toml", "--set", "low.b=1"], "E-CONFIG: --set low.b=1: low.b: no such parameter"),
        (["run", "parts.py:LowPass", "--set", "b"], "E-CONFIG: --set 'b': expected PARAM=VALUE"),
        (["help", "errors", "E-NOPE"], "E-USAGE: aiorts help: no error code 'E-NOPE'"),
        (
            ["flexiconst", "-p", "TimedLong", "-p", "TimedLong", "-c", "1"],
            "1 constant for 2 out-ports; give one for each",
        ),
    ],
)
def test_a_mistake_on_the_command_line_says_what_to_write(folder: Path, arguments: list[str], said: str) -> None:
    done = here(folder, *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert said in done.stderr
    assert not (folder / "g.png").exists()


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ('"low.raw"', '"low.row"', "10:6"),
        ('"low.raw"', '["low.raw", "src.input9"]', "10:18"),
        ('"src.output"', '"src.outpt"', "9:8"),
        ('"low.raw"', '"src.output"', "10:6"),
        ('["TimedDouble"]', '["TimedLong"]', "10:6"),
        ('["TimedDouble"]', '["TimedDoubl"]', "4:20"),
        ('["1"]', '["x"]', "5:22"),
    ],
)
def test_run_and_check_place_an_error_alike(folder: Path, old: str, new: str, place: str) -> None:
    (folder / "wrong.toml").write_text(SYSTEM.replace(old, new))
    for command in (["check"], ["run", "--for", "0.1"]):
        done = here(folder, *command, "wrong.toml")
        errors = [line for line in done.stderr.splitlines() + done.stdout.splitlines() if ": E-" in line]
        assert done.returncode in (1, 2)
        assert f"wrong.toml:{place}: " in errors[0]


# -- lines for several ports -------------------------------------------------------------------------------------------


def test_a_line_of_output1_is_for_input1_and_another_name_says_what_there_is(folder: Path) -> None:
    lines = '{"port": "output1", "data": 7}\n{"port": "input0", "data": 5}\n{"port": "outpt", "data": 1}\n'
    done = here(folder, *["flexidump", "-p", "TimedLong", "-p", "TimedLong", "--format", "text"], stdin=lines)
    assert done.returncode == 1
    assert sorted((line.split()[0], line.split()[-1]) for line in done.stdout.splitlines()) == [
        ("input0", "5"),
        ("input1", "7"),
    ]
    assert done.stderr.count("\n") == 1
    assert "line 3: no in-port 'outpt'; " in done.stderr


def test_a_text_that_is_no_number_is_a_bad_line_as_the_help_of_flexifilter_says(folder: Path) -> None:
    options = ["flexifilter", "-i", "TimedString", "-o", "TimedDouble"]
    done = here(folder, *options, stdin='"1"\n"x"\n"3"\n')
    assert (done.returncode, len(done.stdout.splitlines())) == (1, 2)
    assert done.stderr.startswith("aiorts: E-LINE: standard input, line 2")
    assert "got 'x'" in done.stderr
    assert "the others go on" in " ".join(here(folder, "flexifilter", "--help").stdout.split())
