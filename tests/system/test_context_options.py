"""Options of contexts, and limits of processes, are declared once: files, commands and the schema go by it."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import jsonschema
import pytest

from aiorts import Catalogue, Context, EventContext, Kernel, Option
from aiorts.errors import AiortsError, ConfigurationError, SystemFileError
from aiorts.kernel.extensions.arguments import arguments_of
from aiorts.model.declared import options_of
from aiorts.processes import Limits
from aiorts.system import Finding, check, load, parse, prepare, schema
from control_parts import commanded
from system_parts import CHAIN

Write = Callable[..., Path]
PATIENT = ("--timeout", "60")
REFERENCE = Path(__file__).parents[2] / "aiorts" / "guide" / "pages" / "reference" / "system-file.md"
ORBITS = """
from __future__ import annotations

from typing import Annotated, Literal

from aiorts import EventContext, Option

Turns = Annotated[int, Option("How often it turns.", unit="rad", low=1, high=9)]


class Orbit(EventContext):
    "Runs its members in turns."

    kind = "orbit"

    def __init__(
        self,
        turns: Turns = 2,
        way: Annotated[Literal["left", "right"], Option("Where it turns to.")] = "left",
        drift: Annotated[float, Option("How far it is off.", above=0)] | None = None,
        plain: float = 1.0,
        *,
        name: str = "",
        deadline: float | None = None,
    ) -> None:
        super().__init__(name=name, deadline=deadline)
        self._check_options(Orbit, turns=turns, way=way, drift=drift)
        self.turns, self.way, self.drift, self.plain = turns, way, drift, plain
"""
PROJECT = '[project]\nname = "orbits"\n[project.entry-points."aiorts.contexts"]\norbit = "declared_orbits:Orbit"\n'
WRONG = [
    ("turns = 0", "expected a whole number from 1 to 9, such as 2, got 0"),
    ("turns = 10", "expected a whole number from 1 to 9, such as 2, got 10"),
    ("turn = 3", "unknown key 'turn'; did you mean 'turns'?"),
    ("way = 'lft'", "unknown way 'lft'; did you mean 'left'?"),
    ("drift = 0.0", "expected a number above 0, got 0.0"),
    ("turns = 1.5", "expected a whole number, got 1.5"),
]


@pytest.fixture(scope="module")
def orbits(tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    """A plugin folder with a kind of context whose options are declared."""
    folder = tmp_path_factory.mktemp("orbits")
    (folder / "declared_orbits.py").write_text(ORBITS)
    (folder / "pyproject.toml").write_text(PROJECT)
    return Catalogue([folder])


def orbiting(line: str) -> str:
    return CHAIN.replace('kind = "periodic"', 'kind = "orbit"', 1).replace("rate = 100.0", line, 1)


def marked(one: Finding) -> str:
    return one.quote[one.column - 1 : one.column - 1 + one.width]


@pytest.mark.parametrize("line", ["turns = 9", "way = 'right'\ndrift = 1e-9", "plain = -5.0", ""])
def test_what_a_context_declares_is_taken_by_check_and_schema(write: Write, orbits: Catalogue, line: str) -> None:
    path = write(orbiting(line))
    assert [one for one in check(path, plugins=orbits.folders) if one.severity == "error"] == []
    jsonschema.validate(tomllib.loads(path.read_text()), schema(orbits))
    (made,) = (vars(one) for one in prepare(load(path), orbits).contexts.values() if one.kind == "orbit")
    assert {key: made[key] for key in tomllib.loads(line)} == tomllib.loads(line)


@pytest.mark.parametrize(("line", "said"), WRONG)
def test_what_it_does_not_take_is_refused_with_range_and_suggestion(
    write: Write, orbits: Catalogue, line: str, said: str
) -> None:
    path = write(orbiting(line))
    (one,) = (one for one in check(path, plugins=orbits.folders) if one.severity == "error")
    assert said in one.message
    assert marked(one) in line
    assert one.where.rpartition(".")[2] == line.partition(" ")[0]
    with pytest.raises(AiortsError, match=said.partition("; ")[0].replace("?", r"\?")):
        prepare(load(path), orbits)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(tomllib.loads(path.read_text()), schema(orbits))


@pytest.mark.anyio
async def test_a_kernel_that_runs_refuses_the_same_of_a_client(
    orbits: Catalogue, capsys: pytest.CaptureFixture[str]
) -> None:
    async with Kernel(plugins=orbits, services={"control": {"name": "orbits"}}) as kernel:
        for line, said in WRONG:
            words = line.replace(" = ", "=").replace("'", "")
            status, text = await commanded(capsys, "ctx", "start", "o", words, "--kind", "orbit", *PATIENT)
            assert status == 2, text
            assert f"o: {words.partition('=')[0]}: {said.partition(', got')[0]}" in text
        assert await commanded(capsys, "ctx", "start", "o", "turns=0x3", "way=right", "--kind", "orbit", *PATIENT) == (
            0,
            "",
        )
        made = vars(kernel.contexts["o"])
        assert (made["turns"], made["way"]) == (3, "right")


def test_a_program_is_refused_the_same(orbits: Catalogue) -> None:
    cls: Any = orbits.find("contexts", "orbit").load_class(Context)
    assert cls(turns=9, drift=0.5).drift == 0.5
    for given, said in (
        ({"turns": 0}, "o: turns = 0: expected a whole number from 1 to 9, such as 2"),
        ({"way": "lft"}, "o: way = 'lft': expected one of left, right"),
        ({"drift": -1.0}, "o: drift = -1.0: expected a number above 0"),
    ):
        with pytest.raises(ConfigurationError) as error:
            cls(name="o", **given)
        assert str(error.value) == said


def test_the_schema_describes_what_is_declared_and_what_is_not_as_it_did(orbits: Catalogue) -> None:
    kinds = {
        one["properties"]["kind"]["const"]: one for one in schema(orbits, templates=False)["$defs"]["context"]["oneOf"]
    }
    given = kinds["orbit"]["properties"]
    assert given["turns"] == {
        "type": "integer",
        "description": "How often it turns. Unit: rad.",
        "default": 2,
        "minimum": 1,
        "maximum": 9,
    }
    assert given["way"] == {"enum": ["left", "right"], "description": "Where it turns to.", "default": "left"}
    assert given["drift"] == {"type": "number", "description": "How far it is off.", "exclusiveMinimum": 0}
    assert given["plain"] == {"type": "number", "default": 1.0}
    # It declares no deadline of its own: that of its base class is described, and its range left to the class.
    described = kinds["event"]["properties"]["deadline"]["description"]
    assert given["deadline"] == {"type": "number", "description": described}


@pytest.mark.parametrize("kind", ["event", "external", "periodic", "realtime", "thread"])
def test_each_option_of_a_context_of_aiorts_is_declared_and_on_the_page(kind: str) -> None:
    cls = Catalogue().find("contexts", kind).load_class(Context)
    assert list(options_of(cls)) == list(arguments_of(cls))
    part = REFERENCE.read_text().partition(f'kind = "{kind}"`\n')[2].partition("\n##")[0]
    text = " ".join(part.split())
    assert [name for name, one in options_of(cls).items() if one.described.partition("`")[0] not in text] == []


def test_a_signature_with_a_name_that_is_not_known_declares_nothing() -> None:
    class Known(EventContext):
        def __init__(self, pace: Annotated[float, Option("Its pace.", low=1)] = 2, *, name: str = "") -> None:
            super().__init__(name=name)

    class Unknown(EventContext):
        def __init__(self, pace: Annotated[float, Option("Its pace.", low=1)], other: Nowhere) -> None:  # type: ignore[name-defined] # noqa: F821
            super().__init__()
            self._check_options(Unknown, pace=pace)

    assert {name: (one.default, one.low) for name, one in options_of(Known).items()} == {"pace": (2, 1)}
    assert options_of(Unknown) == {}
    assert Unknown(0.0, None).kind == "event"


# -- limits ------------------------------------------------------------------------------------------------------------

LIMITED = 'type = "parts.py:Source"\nisolation = "process"\nlimits = {{{}}}'


def limited(text: str) -> str:
    return CHAIN.replace('type = "parts.py:Source"', LIMITED.format(text), 1)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("memory = 0", "0: expected a whole number from 1 on"),
        ("memory = 1.5", "1.5: expected a whole number from 1 on"),
        ("cpu = 0", "0: expected a share of one processor above 0"),
        ("cpu = inf", "inf: expected a share of one processor above 0"),
        ("proceses = 2", "unknown key 'proceses'; did you mean 'processes'?"),
    ],
)
def test_a_limit_out_of_range_is_refused_by_check_and_schema(write: Write, text: str, said: str) -> None:
    (one,) = (one for one in check(write(limited(text))) if one.severity == "error")
    assert one.message == said
    with pytest.raises(SystemFileError, match=said.replace("?", r"\?")):
        parse(limited(text), Path("nowhere/s.toml"))
    if text != "cpu = inf":  # JSON has no such number
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(tomllib.loads(limited(text)), schema())


def test_limits_in_range_are_taken_and_described(write: Write) -> None:
    text = limited("memory = 1, cpu = 0.25, processes = 4")
    assert [one for one in check(write(text)) if one.severity == "error"] == []
    jsonschema.validate(tomllib.loads(text), schema())
    page = " ".join(REFERENCE.read_text().partition("## `[components.NAME.limits]`")[2].split())
    assert [name for name, one in options_of(Limits).items() if one.described not in page] == []
    with pytest.raises(ConfigurationError, match="memory = True: expected a whole number from 1 on"):
        Limits(memory=True)
