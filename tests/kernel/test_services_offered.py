"""A service that a plugin offers: attached by name, told what comes and goes, contained; its part of everything."""

from __future__ import annotations

import asyncio
import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from click.testing import CliRunner

from aiorts import Catalogue, Component, Kernel, KernelService, PeriodicContext
from aiorts.cli.commands.plugin_kinds import fault_of
from aiorts.cli.commands.run import run
from aiorts.cli.console.plugins_option import with_plugins
from aiorts.cli.runtime.dump import state_of
from aiorts.cli.runtime.service_options import chosen
from aiorts.cli.runtime.target import find_target
from aiorts.errors import ConfigurationError, PluginError
from aiorts.events import HookAfter
from aiorts.system import build, check, load, prepare, schema
from aiorts.testing import simulated

if TYPE_CHECKING:
    from collections.abc import Mapping

    from aiorts.kernel.loop.deadlines import StopBudget

OFFERED = """\
from dataclasses import dataclass
from typing import Literal
from aiorts import KernelService, setting
from aiorts.errors import ConfigurationError

@dataclass(frozen=True)
class Limits:
    '''How far it goes.'''
    low: float = setting(0.0, "m", option=True)
    high: float = setting(1.0, "m", option=True)
    names: tuple[str, ...] = setting((), "of components")
    loud: bool = setting(False, "say so", option=True)
    way: Literal["up", "down"] = setting("up", "which", option=True)

    def __post_init__(self):
        if self.low > self.high:
            raise ConfigurationError(f"low = {self.low} is above high = {self.high}")
        if self.high > 100:
            raise ConfigurationError(f"high: expected at most 100 m, got {self.high}")

class Fence(KernelService):
    name = "fence"
    settings = Limits
    def configure(self, settings):
        self.given = settings
        if settings.loud:
            raise ValueError("too loud")
    def report(self):
        return {"low": self.given.low, "names": list(self.given.names), "components": len(self.kernel.components)}
"""


@pytest.fixture(scope="session")  # its module can be imported from one place alone, in whatever order the tests come
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fence")
    (folder / "fence_plugin.py").write_text(OFFERED)
    entry = '[project]\nname = "fence"\n[project.entry-points."aiorts.services"]\nfence = "fence_plugin:Fence"\n'
    (folder / "pyproject.toml").write_text(entry)
    return folder


@pytest.fixture
def catalogue(folder: Path) -> Catalogue:
    return Catalogue([folder])


@simulated
async def test_a_kernel_attaches_what_it_was_given_by_name(catalogue: Catalogue) -> None:
    async with Kernel(plugins=catalogue, services={"fence": {"low": 0.5, "names": ["a"]}}) as kernel:
        assert [service.name for service in kernel.services] == ["fence"]
        assert kernel.profile().services == {"fence": {"low": 0.5, "names": ["a"], "components": 0}}
        assert kernel.profile().to_plain()["services"]["fence"]["names"] == ["a"]
        assert kernel.profile().structure().services == {}
        assert state_of(kernel)[-1] == "service fence: low 0.5, names ['a'], components 0"


@pytest.mark.parametrize(
    ("services", "error", "said"),
    [
        ({"fense": {}}, PluginError, "no service named 'fense'; did you mean fence?"),
        (
            {"mqtt": {}},
            PluginError,
            "named 'mqtt'; there are control, fence, links, openrtm, record, replay, rules, studio, supervision, "
            "watch_loop, zenoh",
        ),
        ({"fence": {"lo": 1}}, ConfigurationError, "service 'fence': lo: unknown key 'lo'; did you mean 'low'?"),
        ({"fence": {"low": "x"}}, ConfigurationError, "service 'fence': low: expected a number, got 'x'"),
        ({"fence": {"high": 1e9}}, ConfigurationError, "service 'fence': high: expected at most 100 m, got 1000000000"),
        ({"fence": {"names": "a"}}, ConfigurationError, "service 'fence': names: expected a list, got 'a'"),
    ],
)
def test_what_cannot_be_attached_is_named(
    catalogue: Catalogue, services: dict[str, dict[str, Any]], error: type[Exception], said: str
) -> None:
    with pytest.raises(error) as caught:
        Kernel(plugins=catalogue, services=services)
    assert said in str(caught.value)


def test_settings_that_only_fit_together_are_taken_together(catalogue: Catalogue) -> None:
    Kernel(plugins=catalogue, services={"fence": {"low": 5.0, "high": 10.0}})
    with pytest.raises(ConfigurationError, match=r"low = 5\.0 is above high = 4\.0"):
        Kernel(plugins=catalogue, services={"fence": {"low": 5.0, "high": 4.0}})


@simulated
async def test_a_service_that_cannot_begin_leaves_a_closed_kernel(catalogue: Catalogue) -> None:
    kernel = Kernel(plugins=catalogue, services={"fence": {"loud": True}})
    with pytest.raises(ValueError, match="too loud"):
        await kernel.open()
    assert "closed" in repr(kernel)


def written(tmp_path: Path, table: str) -> Path:
    path = tmp_path / "system.toml"
    path.write_text(f"schema = 1\n{table}")
    return path


@simulated
async def test_a_table_of_a_system_file_attaches_it(tmp_path: Path, catalogue: Catalogue) -> None:
    system = load(written(tmp_path, "[fence]\nlow = 0.25\n"))
    assert system.services == {"fence": {"low": 0.25}}
    async with Kernel() as kernel:
        await build(kernel, prepare(system, catalogue))
        assert kernel.profile().services["fence"]["low"] == 0.25
    assert schema(catalogue)["properties"]["fence"]["properties"]["way"] == {
        "anyOf": [{"enum": ["up", "down"]}, {"$ref": "#/$defs/template"}],
        "default": "up",
        "description": "which",
    }


@pytest.mark.parametrize(
    ("table", "place", "said"),
    [
        ("[fense]\nlow = 1\n", (2, 2), "unknown key 'fense'; did you mean 'fence'?"),
        ("[fence]\nlwo = 1\n", (3, 1), "unknown key 'lwo'; did you mean 'low'?"),
        ("[fence]\nlow = true\n", (3, 7), "expected a number, got True"),
        ("[fence]\nhigh = 101\n", (3, 8), "expected at most 100 m, got 101"),
        ("[fence]\nlow = 3\nhigh = 2\n", (2, 2), "low = 3 is above high = 2"),
        ("fence = 3\n", (2, 1), "unknown key 'fence'; there are schema, include, variables, plugins, clock"),
    ],
)
def test_a_mistake_in_its_table_has_its_place(
    tmp_path: Path, folder: Path, table: str, place: tuple[int, int], said: str
) -> None:
    errors = [one for one in check(written(tmp_path, table), plugins=[folder]) if one.severity == "error"]
    assert [(one.line, one.column) for one in errors] == [place]
    assert said in errors[0].message


def test_its_options_are_found_where_its_plugin_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Catalogue, "_default", Catalogue([folder]))
    out = CliRunner().invoke(run, ["--help"]).output
    assert "Options of the service fence:" in out
    assert "--fence-loud / --no-fence-loud" in out
    assert "--fence-way [up|down]" in out
    assert "--fence-names" not in out
    done = CliRunner().invoke(run, ["x.toml", "--fence-wya", "up"])
    assert (done.exit_code, "--fence-way" in done.output) == (2, True)
    with pytest.raises(ConfigurationError, match=r"service 'fence': high: expected at most 100 m, got 101\.0"):
        find_target("FlexiConst", (), None, {"fence": {"high": 101.0}})


class Part(Component):
    """A component like any other."""


class Noting(KernelService):
    """Notes what it is told, and raises after it where it is to."""

    def __init__(self, kernel: Any) -> None:
        super().__init__(kernel)
        self.told: list[str] = []
        self.raises = False

    def _note(self, what: str) -> None:
        self.told.append(what)
        if self.raises:
            raise ZeroDivisionError(what)

    def component_added(self, component: Component) -> None:
        self._note(f"added {component.name}")

    def component_removed(self, component: Component) -> None:
        self._note(f"removed {component.name}")

    def components_replaced(self, pairs: Mapping[Component, Component]) -> None:
        self._note(f"replaced {', '.join(f'{type(old).one} {type(new).one}' for old, new in pairs.items())}")  # type: ignore[attr-defined]

    def observers_changed(self) -> None:
        self._note(f"hooks wanted {self.kernel.bus.hooks_wanted}")

    async def closing(self, budget: StopBudget) -> None:
        self._note("closing")

    async def ending(self, budget: StopBudget) -> None:
        self._note(f"ending with {len(self.kernel.contexts)} contexts")

    def stopped(self) -> None:
        self._note("stopped")

    def closed(self) -> None:
        self._note("closed")


@simulated
async def test_a_service_that_raises_is_named_and_all_goes_on(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.ERROR, "aiorts.kernel"):
        async with Kernel() as kernel:
            bad, good = kernel.service(Noting), kernel.service(type("Other", (Noting,), {}))
            bad.raises = True
            part = await kernel.add(Part("part"))
            context = await kernel.start(PeriodicContext(10.0), part, activate=True)
            kernel.bus.subscribe(HookAfter, lambda _event: None)()
            await kernel.sleep(1.0)
            assert context.statistics.cycles >= 10
            await kernel.remove(part)
    heard = ["added part", "hooks wanted True", "hooks wanted False", "removed part", "closing"]
    heard += ["ending with 0 contexts", "stopped", "closed"]
    assert good.told == bad.told == heard
    lines = [record.getMessage() for record in caplog.records]
    assert lines[0] == "service Noting: component_added failed: ZeroDivisionError: added part"
    assert [line.split()[2] for line in lines] == [
        *("component_added", "observers_changed", "observers_changed", "component_removed"),
        *("closing", "ending", "stopped", "closed"),
    ]
    assert kernel.exit_status == 0


@simulated
async def test_a_service_hears_of_new_instances_when_code_is_read_anew(tmp_path: Path) -> None:
    file = tmp_path / "part.py"
    text = "from aiorts import Component\nclass Part(Component):\n    one = 1\n    def on_execute(self): pass\n"
    file.write_text(text)
    async with Kernel(plugins=Catalogue([tmp_path])) as kernel:
        service = kernel.service(Noting)
        part = await kernel.create("Part", "part")
        await kernel.start(PeriodicContext(10.0), part, activate=True)
        file.write_text(text.replace("one = 1", "one = 2"))
        await kernel.reload("Part")
        assert service.told == ["added part", "replaced 1 2"]
        assert type(kernel.components["part"]).one == 2  # type: ignore[attr-defined]


class Endless(KernelService):
    """Never lets go."""

    async def closing(self, budget: StopBudget) -> None:
        while True:
            try:
                await asyncio.sleep(100.0)
            except asyncio.CancelledError:
                if self.kernel.clock.time() > 60.0:
                    raise


@simulated
async def test_a_kernel_closes_in_time_whatever_a_service_does(caplog: pytest.LogCaptureFixture) -> None:
    async with Kernel() as kernel:
        kernel.service(Endless)
        part = await kernel.add(Part("part"))
        await kernel.start(PeriodicContext(10.0), part, activate=True)
        began = kernel.clock.time()
    assert kernel.clock.time() - began <= 5.0
    assert "service Endless: closing failed: TimeoutError: it was still running" in caplog.text
    left = [task for task in asyncio.all_tasks() if "Endless" in task.get_name()]
    await asyncio.sleep(60.0)
    left[0].cancel()


def offering(folder: Path, **services: str) -> Path:
    """A folder with a plugin that offers services with these fields."""
    stem = f"offering_{folder.name.replace('-', '_')}"
    text = "from dataclasses import dataclass\nfrom pathlib import Path\nfrom typing import Literal\n"
    text += "from aiorts import KernelService, setting\n"
    entries = '[project]\nname = "offering"\n[project.entry-points."aiorts.services"]\n'
    for name, fields in services.items():
        text += f"@dataclass(frozen=True)\nclass S_{name}:\n" + "".join(f"    {one}\n" for one in fields.splitlines())
        text += f"class {name}(KernelService):\n    name, settings = {name!r}, S_{name}\n"
        entries += f'{name} = "{stem}:{name}"\n'
    (folder / f"{stem}.py").write_text(text)
    (folder / "pyproject.toml").write_text(entries)
    (folder / "system.toml").write_text('schema = 1\n[plugins]\npath = ["."]\n')
    return folder


@pytest.mark.slow
def test_an_option_takes_what_its_field_is_declared_to_be(tmp_path: Path) -> None:
    fields = (
        'limit: float | None = setting(None, "m", option=True)\n'
        'loud: bool | None = setting(None, "say so", option=True)\n'
        'way: Literal["up", "down"] = setting("up", "which", option=True)\n'
        'file: Path | None = setting(None, "where", option=True)'
    )
    system = str(offering(tmp_path, opts=fields) / "system.toml")
    words = ["--opts-limit", "2", "--no-opts-loud", "--opts-way", "down", "--opts-file", "x"]
    given = {"limit": 2.0, "loud": False, "way": "down", "file": Path("x")}
    assert chosen(run.make_context("run", [system, *words]).params) == {"opts": given}
    assert CliRunner().invoke(run, [system, "--opts-limit", "far"]).exit_code == 2
    for args in ([system, "--help"], ["--plugins", str(tmp_path), "--help"], [system, "--opts-limit", "2", "--help"]):
        shown = CliRunner().invoke(with_plugins(run), args).output
        assert shown.count("--opts-limit FLOAT") == 1
        assert "--opts-way [up|down]" in shown


def test_the_main_setting_is_the_option_of_the_services_name_and_texts_are_repeated(tmp_path: Path) -> None:
    fields = (
        'file: Path | None = setting(None, "where", option="")\n'
        'ports: tuple[str, ...] = setting((), "of what", option="port")\n'
        'file_format: str = setting("x", "which", option="format")\n'
        'fresh: bool = setting(False, "from nothing", option="--fresh")'
    )
    system = str(offering(tmp_path, opts=fields) / "system.toml")
    words = ["--opts", "x", "--opts-port", "a.*", "--opts-port", "b.c", "--opts-format", "y", "--fresh"]
    given = {"file": Path("x"), "ports": ("a.*", "b.c"), "file_format": "y", "fresh": True}
    assert chosen(run.make_context("run", [system, *words]).params) == {"opts": given}
    assert chosen(run.make_context("run", [system, "--opts", "x"]).params) == {"opts": {"file": Path("x")}}
    shown = CliRunner().invoke(run, [system, "--help"]).output
    flags = ("--opts PATH", "--opts-port TEXT", "--opts-file", "--fresh / --no-fresh")
    assert [shown.count(f"{flag} ") for flag in flags] == [1, 1, 0, 1]


def test_a_path_of_its_table_is_counted_from_the_folder_of_the_file(tmp_path: Path) -> None:
    fields = 'file: Path | None = setting(None, "where", option="")\ntitle: str = setting("", "who")'
    folder = offering(tmp_path, paths=fields)
    (folder / "system.toml").write_text(
        'schema = 1\n[plugins]\npath = ["."]\n[paths]\nfile = "run.mcap"\ntitle = "run.mcap"\n'
    )
    system = load(folder / "system.toml")
    settings = prepare(system).services["paths"].settings
    assert (settings.file, settings.title) == (folder / "run.mcap", "run.mcap")
    for given in ("x.mcap", Path("x.mcap")):
        plan = prepare(system, services={"paths": {"file": given}}).services["paths"]
        assert plan.settings.file == Path("x.mcap")
    with pytest.raises(ConfigurationError, match="--paths: expected text, got 3"):
        prepare(system, services={"paths": {"file": 3}})
    assert schema(Catalogue([folder]))["properties"]["paths"]["properties"]["file"]["type"] == "string"


@pytest.mark.parametrize(
    ("services", "flag", "said"),
    [
        (
            {"opts": 'sizes: tuple[int, ...] = setting((), "of parts", option=True)'},
            "--opts-sizes",
            "--opts-sizes: sizes of the service opts cannot be an option: use bool, int, float, str, Path",
        ),
        (
            {
                "a": 'b_c: int = setting(1, "one", option=True)',
                "a_b": 'c: int = setting(1, "other", option=True)',
            },
            "--a-b-c",
            "--a-b-c is of b_c of the service a and of c of the service a_b; rename one",
        ),
    ],
)
def test_an_option_that_cannot_be_is_refused_by_name(
    tmp_path: Path, services: dict[str, str], flag: str, said: str
) -> None:
    system = str(offering(tmp_path, **services) / "system.toml")
    done = CliRunner().invoke(run, [system, flag, "1"])
    assert done.exit_code == 2
    assert said in " ".join(done.output.split())
    shown = CliRunner().invoke(run, [system, "--help"])
    assert (shown.exit_code, said in " ".join(shown.output.split())) == (0, True)


def test_an_option_that_the_command_itself_has_is_refused_by_the_check_of_plugins(tmp_path: Path) -> None:
    fields = 'file: str = setting("", "where", option=True)\nfolder: str = setting("", "where", option=True)'
    catalogue = Catalogue([offering(tmp_path, log=fields)])
    extension = catalogue.find("services", "log")
    said = "--log-file is of `aiorts run` itself and of file of the service log; rename one"
    assert fault_of(extension, extension.load()) == said
