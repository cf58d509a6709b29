"""The files that name an option of a connector: its declaration, the generated file and those that act on it.

A new option touches its declaration and the files that do something by it. Where a file of another kind names one, the
same is known twice: it asks the declarations (`options_of`) instead.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from types import MappingProxyType

import pytest

import aiorts
from aiorts.model.options import OWN_OPTIONS, SERVICE_KEYS

ROOT = Path(aiorts.__file__).parent.parent
OPTIONS = tuple(key for key in (*OWN_OPTIONS, *SERVICE_KEYS) if key != "name")
"""Without the name, which much else has."""
EVERYDAY = frozenset(
    {"push", "skip", "length", "full", "empty", "timeout", "stamp", "convert", "measure", "mapping", "strict"}
)
"""Options with the names of other things: of these, only uses of a profile, and of a table of options, are counted."""
DECLARED = MappingProxyType(
    {
        "aiorts/model/profile.py": "declares those of the connector",
        "aiorts/model/options.py": "declares those of the ports and of services; defaults and exclusions",
        "aiorts/model/connect_options.py": "is generated",
    }
)
ACTS = MappingProxyType(
    {
        "aiorts/adapting/inserting.py": ("inserts a FlexiFilter, and refuses a converter with it", "adapt convert"),
        "aiorts/adapting/proposing.py": ("finds the mapping of a FlexiFilter", "adapt"),
        "aiorts/assembly.py": ("inserts a FlexiFilter; gives samples of a port", "adapt keep_last"),
        "aiorts/cli/commands/live/connecting.py": ("takes a converter's file; has the kernel adapt", "adapt convert"),
        "aiorts/cli/runtime/hints.py": ("says what would lose less", "dataflow push subscription"),
        "aiorts/composites/composite.py": ("orders by data flow, of which a pulled edge is none", "dataflow"),
        "aiorts/control/measuring.py": ("switches measuring on while somebody looks", "measure"),
        "aiorts/control/operations/statistics.py": (
            "says what is timed, and which connectors are links",
            "measure on_link_lost",
        ),
        "aiorts/control/operations/tools.py": ("keeps the samples for a tool", "full length"),
        "aiorts/control/operations/wiring.py": ("has a FlexiFilter inserted", "adapt"),
        "aiorts/isolation/moving.py": ("puts a link in the place of a connector", "convert length on_link_lost"),
        "aiorts/kernel/connections.py": (
            "makes connectors anew, and changes them",
            "convert length on_link_lost push_rate",
        ),
        "aiorts/kernel/ending.py": ("takes converters apart", "mapping"),
        "aiorts/kernel/execution/apart.py": ("refuses a rendezvous between contexts", "length"),
        "aiorts/kernel/ports/connector.py": ("answers for what is measured", "max_gap push_rate subscription"),
        "aiorts/kernel/ports/features.py": (
            "chooses the transport, and orders the features",
            "dataflow lifespan on_link_lost subscription",
        ),
        "aiorts/kernel/ports/last_sample.py": ("offers the last sample", "keep_last"),
        "aiorts/kernel/ports/losses.py": ("says what is lost at the beginning", "convert keep_last"),
        "aiorts/kernel/ports/out_port.py": ("writes", "convert length timeout"),
        "aiorts/kernel/ports/periodic_transport.py": ("sends at a rate", "full out_length push_rate skip stamp"),
        "aiorts/kernel/ports/receiver.py": ("reads", "dataflow"),
        "aiorts/kernel/ports/tap.py": ("makes a tap", "on_link_lost subscription"),
        "aiorts/kernel/ports/transport.py": ("sends", "dataflow full length measure push skip stamp subscription"),
        "aiorts/kernel/ports/wiring.py": (
            "joins two ports",
            "allow_duplicate connection_limit convert fan_in fan_out keep_last stamp subscription",
        ),
        "aiorts/kernel/quality/__init__.py": ("names the features", "convert length lifespan measure"),
        "aiorts/kernel/quality/conversion.py": ("converts", "convert"),
        "aiorts/kernel/quality/expiry.py": ("drops what is too old", "lifespan"),
        "aiorts/kernel/quality/gaps.py": ("watches for silent writers", "max_gap"),
        "aiorts/links/ends.py": ("makes the two ends of a link", "dataflow on_link_lost"),
        "aiorts/links/ledgers.py": ("times what is acknowledged", "measure"),
        "aiorts/links/linked.py": (
            "declares the features of links",
            "dataflow full lifespan on_link_lost stamp subscription",
        ),
        "aiorts/links/reader_link.py": (
            "says what the reader's end does",
            "dataflow full length lifespan measure push stamp subscription",
        ),
        "aiorts/links/writer_link.py": (
            "sends over a link",
            "full keep_last length lifespan push subscription timeout",
        ),
        "aiorts/system/file/pairs.py": ("refuses a second connector of two ports", "allow_duplicate"),
        "aiorts/kernel/microkernel.py": ("loads converters that a text names", "convert"),
        "aiorts/observe/html.py": ("marks the edges that send at once", "subscription"),
        "aiorts/observe/introspection.py": ("refuses a length of no samples", "length"),
        "aiorts/observe/listening.py": ("takes writes without a reader", "full out_length"),
        "aiorts/observe/monitor.py": ("measures while it is open", "measure"),
        "aiorts/observe/special_reports.py": ("reports what is bound loosely", "strict"),
        "aiorts/planning/applying.py": ("compares converters by what they name", "convert"),
        "aiorts/planning/canon.py": (
            "writes a link as it was asked for",
            "convert on_link_lost push strict subscription",
        ),
        "aiorts/realtime/lock_free_periodic.py": ("sends at a rate between threads", "full out_length skip"),
        "aiorts/realtime/lock_free_transport.py": ("sends between threads", "full"),
        "aiorts/reload/replacement.py": ("finds the new version of a converter", "convert"),
        "aiorts/rules/rule.py": ("refuses options of one pair in a rule", "adapt allow_duplicate push_rate"),
        "aiorts/services/service_port.py": ("binds interfaces", "mapping"),
        "aiorts/services/service_wiring.py": ("binds interfaces", "mapping strict"),
        "aiorts/system/checks/adapting.py": ("checks what would be inserted", "adapt convert"),
        "aiorts/system/checks/circles.py": ("follows waits and first samples", "dataflow keep_last"),
        "aiorts/system/checks/connection_checks.py": ("checks stamps and converters", "convert stamp subscription"),
        "aiorts/system/checks/running.py": ("follows the way of the samples", "dataflow"),
        "aiorts/system/checks/surveyed.py": ("follows the way of the samples", "dataflow subscription"),
        "aiorts/system/checks/whole.py": (
            "judges rates and buffers",
            "dataflow full length on_link_lost push subscription",
        ),
        "aiorts/system/draw/picture.py": ("draws edges", "dataflow full length push push_rate subscription"),
        "aiorts/system/file/load.py": ("loads converters", "convert"),
        "aiorts/system/file/survey.py": ("reads what needs other files", "convert on_link_lost push_rate"),
        "aiorts/system/wanting.py": ("binds interfaces as the kernel would", "strict"),
        "plugins/aiorts_bench/interprocess/near.py": ("measures it", "subscription"),
        "plugins/aiorts_bench/push/ageing.py": ("measures it", "push_rate subscription"),
        "plugins/aiorts_bench/push/answer.py": ("measures it", "push_rate subscription"),
        "plugins/aiorts_bench/push/flow.py": ("measures it", "out_length push_rate subscription"),
        "plugins/aiorts_bench/push/grid.py": ("measures it", "push_rate subscription"),
        "plugins/aiorts_bench/push/load.py": ("measures it", "push_rate subscription"),
        "plugins/aiorts_bench/push/push.py": ("measures it", "subscription"),
        "plugins/aiorts_flexi/recordings/recording.py": ("lets the replay wait", "full"),
        "plugins/aiorts_log/recorder/about.py": ("writes it into a recording", "full length subscription"),
        "plugins/aiorts_log/recorder/beside.py": ("keeps what is to be recorded", "length"),
        "plugins/aiorts_openrtm/mapping/connections.py": (
            "writes OpenRTM's words",
            "dataflow out_length push_rate subscription",
        ),
        "plugins/aiorts_openrtm/mapping/exporting.py": ("writes OpenRTM's words", "dataflow subscription"),
        "plugins/aiorts_openrtm/mapping/importing.py": (
            "reads a profile that joins two ports twice",
            "allow_duplicate",
        ),
        "plugins/aiorts_studio/watching/words.py": ("shows it on an edge", "full length push push_rate subscription"),
        "plugins/aiorts_zenoh/transport.py": ("lets older samples go", "push"),
    }
)
"""What a file does by options, and which."""
OTHERS = MappingProxyType(
    {
        "aiorts/cli/demo/motor.py": "subscription",  # what `subscribe` returned
        "aiorts/control/operators.py": "on_link_lost",  # of a component
        "aiorts/isolation/stand_in.py": "on_link_lost",  # of a component
        "aiorts/kernel/component.py": "on_link_lost",  # of a component
        "aiorts/kernel/registry.py": "on_link_lost",  # of a component
        "aiorts/model/policy.py": "subscription",  # an argument
        "aiorts/model/wanted/entries.py": "dataflow on_link_lost",  # an order of a composite; of a component
        "aiorts/planning/component_rows.py": "on_link_lost",  # of a component
        "aiorts/statemachines/state_machine.py": "length",
        "aiorts/supervision/component_place.py": "on_link_lost",  # of a component
        "plugins/aiorts_bench/push/answer.py": "fan_in fan_out",  # axes of its grid
        "plugins/aiorts_bench/push/grid.py": "fan_in fan_out",
        "plugins/aiorts_bench/push/load.py": "fan_in fan_out",
        "plugins/aiorts_bench/push/push.py": "fan_out",
        "plugins/aiorts_flexi/recordings/logger.py": "max_gap",  # of a replay, as in the five after it
        "plugins/aiorts_flexi/recordings/replaying.py": "max_gap",
        "plugins/aiorts_foxglove/protocol.py": "subscription",  # a word of that protocol
        "plugins/aiorts_log/playing/in_place.py": "max_gap",
        "plugins/aiorts_log/playing/player.py": "max_gap",
        "plugins/aiorts_log/playing/schedule.py": "max_gap",
        "plugins/aiorts_studio/serving.py": "lifespan",  # of a web server
        "plugins/aiorts_studio/watching/scene.py": "on_link_lost",  # of a component
        "plugins/aiorts_studio/watching/watch.py": "on_link_lost",  # of a component
    }
)
"""Other things of the same name."""
FORBIDDEN = (
    "aiorts/system/schemas/",
    "aiorts/system/file/parse.py",
    "aiorts/model/wanted/",
    "aiorts/cli/commands/live/describing.py",
)
MOST = 9
"""The most files that name one of the options below."""


def _last(node: ast.AST) -> str:
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def _names(node: ast.AST, prose: set[int]) -> str | None:
    """The option that a node may name."""
    match node:
        case ast.Attribute(value=value, attr=name):
            return name if name not in EVERYDAY or _last(value).endswith("profile") else None
        case (
            ast.Subscript(value=value, slice=ast.Constant(value=str(name)))
            | ast.Call(func=ast.Attribute(value=value, attr="get"), args=[ast.Constant(value=str(name)), *_])
        ):
            return name if _last(value) in ("options", "own", "chosen", "given", "extra") else None
        case ast.Constant(value=str(name)) if id(node) not in prose:
            return name if name not in EVERYDAY else None
        case ast.keyword(arg=name) | ast.arg(arg=name) | ast.AnnAssign(target=ast.Name(id=name)):
            return name if name not in EVERYDAY else None
    return None


def named_in(source: str) -> set[str]:
    """The options that a file names."""
    tree = ast.parse(source)
    prose = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    return {name for node in ast.walk(tree) if (name := _names(node, prose)) in OPTIONS}


def _files() -> Iterator[tuple[str, set[str]]]:
    for room in ("aiorts", "plugins"):
        for path in sorted((ROOT / room).rglob("*.py")):
            yield path.relative_to(ROOT).as_posix(), named_in(path.read_text("utf-8"))


@pytest.fixture(scope="module")
def named() -> dict[str, set[str]]:
    """The options that each file names, but the files that declare them."""
    return {path: options for path, options in _files() if options and path not in DECLARED}


def test_what_a_file_names_is_found() -> None:
    assert named_in(
        'options["skip"], own.get("full"), profile.length, other.length, f(lifespan=1), {"keep_last": 1}'
    ) == {
        "skip",
        "full",
        "length",
        "lifespan",
        "keep_last",
    }
    assert named_in('"""lifespan"""\nx = "of a lifespan"') == set()


def test_only_files_that_act_on_an_option_name_it(named: dict[str, set[str]]) -> None:
    known = {path: set(options.split()) for path, (_, options) in ACTS.items()}
    for path, options in OTHERS.items():
        known[path] = known.get(path, set()) | set(options.split())
    new = {path: sorted(options - known.get(path, set())) for path, options in named.items()}
    gone = {path: sorted(options - named.get(path, set())) for path, options in known.items()}
    assert {path: options for path, options in new.items() if options} == {}, "ask the declarations, or give a reason"
    assert {path: options for path, options in gone.items() if options} == {}, "take them off the list"


def test_what_reads_and_describes_options_names_none(named: dict[str, set[str]]) -> None:
    others = {path: set(options.split()) for path, options in OTHERS.items()}
    found = {path: options - others.get(path, set()) for path, options in named.items() if path.startswith(FORBIDDEN)}
    assert {path: options for path, options in found.items() if options} == {}


@pytest.mark.parametrize("option", ["keep_last", "lifespan", "allow_duplicate"])
def test_few_files_name_an_option(named: dict[str, set[str]], option: str) -> None:
    others = [path for path, options in OTHERS.items() if option in options.split()]
    acting = [path for path, options in named.items() if option in options and path not in others]
    declaring = [path for path in DECLARED if option in named_in((ROOT / path).read_text("utf-8"))]
    assert len(acting) + len(declaring) <= MOST, sorted([*acting, *declaring])
