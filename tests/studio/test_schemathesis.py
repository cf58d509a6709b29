"""schemathesis over the description: no 5xx, and no answer that is not described, with a token of each right."""

from __future__ import annotations

import asyncio
import time
import warnings
from collections import Counter
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import jsonschema
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from campaign import CAMPAIGN, time_limit
from control_parts import running
from studio_parts import Site, serving

EXAMPLES = 200 if CAMPAIGN else 8
"""Of each operation."""
PROGRAM = """
from typing import Protocol

from aiorts import Component, InPort, OutPort, Param, Provided
from aiorts.types import TimedDouble


class Driving(Protocol):
    async def gear(self, number: int) -> str: ...


class Counter(Component):
    out = OutPort(TimedDouble)
    step: float = Param(1.0, ge=0.0)

    def on_execute(self) -> None:
        self.out.write_nowait(TimedDouble(data=self.step))


class Reader(Component):
    in_ = InPort(TimedDouble, name="in")
    driving = Provided[Driving]()

    async def gear(self, number: int) -> str:
        return f"gear {number}"

    def on_execute(self) -> None:
        self.in_.drain()
"""
SYSTEM = """
schema = 1
[components.counter0]
type = "robot.py:Counter"
[components.reader0]
type = "robot.py:Reader"
[[connections]]
from = "counter0.out"
to = "reader0.in"
[contexts.loop]
kind = "periodic"
rate = 100.0
members = ["counter0", "reader0"]
"""
VIEW: Final[tuple[tuple[str, Mapping[str, Any]], ...]] = (
    *(("names", {}), ("profile", {}), ("origin", {}), ("contexts", {}), ("statistics", {}), ("catalogue", {})),
    *(("configuration", {"component": "counter0"}), ("dump_configuration", {"components": ["counter0"]})),
    *(("log_levels", {}), ("outline", {"components": ["counter0"]}), ("part", {"components": ["counter0"]})),
    *(("schema", {"type": "TimedDouble"}), ("connectors", {}), ("fits", {"port": "counter0.out"})),
    *(("sizes", {"connectors": ["counter0.out-reader0.in"]}), ("interfaces", {"port": "reader0.driving"})),
    ("save", {"folder": "/"}),
)
"""Calls that are answered, in this order."""
OPERATE: Final[tuple[tuple[str, Mapping[str, Any]], ...]] = (
    ("configure", {"component": "counter0", "values": {"default": {"step": 2.0}}}),
    ("measure", {"connectors": ["counter0.out-reader0.in"], "count": 10}),
    ("log_level", {"level": "debug", "components": ["counter0"]}),
    ("set_rate", {"context": "loop", "rate": 50.0}),
    ("call", {"path": "reader0.driving.gear", "args": [1]}),
    ("inject", {"port": "reader0.in", "lines": ['{"tm": 0, "data": 1.0}']}),
    ("deactivate", {"component": "counter0"}),
    ("activate", {"component": "counter0"}),
    ("create", {"type": "FlexiDump", "name": "made0", "params": {"inputs": "TimedDouble"}}),
    ("start_context", {"name": "more", "kind": "periodic", "members": ["made0"], "options": {"rate": 10.0}}),
    ("leave_context", {"context": "more", "members": ["made0"]}),
    ("join_context", {"context": "more", "members": ["made0"]}),
    ("stop_context", {"context": "more"}),
    ("remove", {"components": ["made0"]}),
    ("disconnect", {"names": ["counter0.out-reader0.in"]}),
    ("connect", {"ports": ["counter0.out", "reader0.in"]}),
)
KNOWN: Final[Mapping[str, Any]] = {name: value for _, body in (*VIEW, *OPERATE) for name, value in body.items()}
"""What arguments of these names may be, so that some of what is tried means something."""
LAST: Final = "stop"


@pytest.mark.slow
@pytest.mark.row(151)
@pytest.mark.timeout(time_limit(1_800))
@pytest.mark.skipif(find_spec("schemathesis") is None, reason="schemathesis, of the extra dev, is not installed")
@pytest.mark.parametrize("right", ["view", "operate"])
def test_whatever_is_asked_the_answer_is_as_described(right: str, tmp_path: Path) -> None:
    (tmp_path / "robot.py").write_text(PROGRAM)
    (tmp_path / "robot.toml").write_text(SYSTEM)
    edit = ["--edit"] if right == "operate" else []
    with running("robot", str(tmp_path / "robot.toml")) as run, serving(*edit) as (process, client):
        asyncio.run(client.enter())
        began = time.monotonic()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of packages that schemathesis brings
            answered = tried(client, (*VIEW, *(OPERATE if edit else ())))
        took = time.monotonic() - began
        assert process.poll() is None
        assert run.poll() is None
        if edit:
            assert asyncio.run(client.call("robot", LAST)).status == 200
            answered[LAST] += 1
    print(f"{right}: {len(+answered)} operations with 2xx of {len(answered)}, {EXAMPLES} examples, {took:.0f} s")
    assert len(+answered) >= (30 if edit else 16), sorted(+answered)


def tried(client: Site, calls: tuple[tuple[str, Mapping[str, Any]], ...]) -> Counter[str]:
    """Ask for everything that is described; returns how often each operation was answered with 2xx."""
    import requests

    with requests.Session() as session:
        return tried_over(session, client, calls)


def tried_over(session: Any, client: Site, calls: tuple[tuple[str, Mapping[str, Any]], ...]) -> Counter[str]:
    """The same, over connections that are kept."""
    from schemathesis import openapi
    from schemathesis.checks import not_a_server_error
    from schemathesis.specs.openapi import checks

    described = asyncio.run(client.ask("GET", "/openapi.json")).value
    conform = [not_a_server_error, checks.status_code_conformance, checks.content_type_conformance]
    schema = openapi.from_dict(described)
    operations = {
        found.definition.raw["operationId"]: found for one in schema.get_all_operations() if (found := one.ok())
    }
    answered: Counter[str] = Counter()
    own = {"Authorization": f"Bearer {client.token}"}

    def ask(name: str, case: Any) -> str:
        while (
            reply := case.call(base_url=client.origin, session=session, headers=own, timeout=30.0)
        ).status_code == 429:
            time.sleep(0.2)
        case.validate_response(reply, checks=conform)
        # schemathesis 4.32 takes the tuples of OpenAPI 3.1 (prefixItems) in answers for those of 3.0, and gives up.
        (kind,) = reply.headers["content-type"]
        answer = operations[name].definition.raw["responses"][str(reply.status_code)]["content"][kind]["schema"]
        jsonschema.Draft202012Validator({**answer, "components": described["components"]}).validate(reply.json())
        answered[name] += reply.status_code < 300
        return str(reply.text)

    for name, body in calls:
        media_type = "application/json"
        case = operations[name].Case(path_parameters={"kernel": "robot"}, body=dict(body), media_type=media_type)
        said = ask(name, case)
        assert answered[name], f"{name}: {said}"
    for name, operation in operations.items():
        streams = "application/x-ndjson" in str(
            operation.definition.raw["responses"]["200" if name != "end_token" else "204"]
        )
        if streams or name in (LAST, "end_token", "exchange"):
            continue
        kernels = st.sampled_from(["robot"] * 9 + ["nobody", "../robot", "é"])

        @settings(
            max_examples=EXAMPLES,
            deadline=None,
            derandomize=True,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(operation.as_strategy(), kernels, st.sets(st.sampled_from(sorted(KNOWN))))
        def fuzz(case: Any, kernel: str, known: set[str]) -> None:
            if case.path_parameters:
                case.path_parameters["kernel"] = kernel
            if isinstance(case.body, dict):
                case.body |= {key: KNOWN[key] for key in known & case.body.keys()}
            ask(name, case)  # noqa: B023 - it is run before the next one

        fuzz()
    return answered
