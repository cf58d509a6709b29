"""Profiles of OpenRTM systems for tests: real ones where they are there, and as many generated ones as are wanted."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import canonicalize
from xml.sax.saxutils import quoteattr

from hypothesis import strategies as st

ROOT = Path(__file__).parents[1]
_PLACES = [folder / "shared" / "data" / "openrtm" for folder in (ROOT.parent, ROOT.parents[1])]
REAL = next((folder for folder in _PLACES if folder.is_dir()), None)
"""Files of a real robot arm; they are none of this repository."""

SPACES = (
    'xmlns:rts="http://www.openrtp.org/namespaces/rts" '
    'xmlns:rtsExt="http://www.openrtp.org/namespaces/rts_ext" '
    'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'
)


def canonical(text: str) -> str:
    """A document in canonical form, without the date at which it was written."""
    import re

    return re.sub(r' rts:updateDate="[^"]*"', "", canonicalize(text))


def profile(inside: str, **attributes: str) -> str:
    """A profile with this inside."""
    given = {
        "id": "RTSystem:lab:arm:1.0.0",
        "abstract": "of a test",
        "creationDate": "2026-01-02T03:04:05",
        "updateDate": "2026-01-02T03:04:05",
        "version": "0.2",
        **attributes,
    }
    said = " ".join(f"rts:{key}={quoteattr(value)}" for key, value in given.items())
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<rts:RtsProfile {SPACES} {said}>\n{inside}</rts:RtsProfile>\n'


def component(name: str, inside: str = "", *, kind: str = "", **attributes: str) -> str:
    """A component of a profile."""
    given = {
        "id": f"RTC:lab:test:{kind or name.rstrip('0123456789')}:1.0.0",
        "pathUri": f"localhost/{name}.rtc",
        "activeConfigurationSet": "default",
        "instanceName": name,
        "compositeType": "None",
        "isRequired": "true",
        **attributes,
    }
    said = " ".join(f"rts:{key}={quoteattr(value)}" for key, value in given.items())
    begin = f'    <rts:Components xsi:type="rtsExt:component_ext" {said} rtsExt:visible="true">\n'
    return f"{begin}{inside}    </rts:Components>\n"


def context(number: int = 0, rate: float = 100.0, kind: str = "PERIODIC", inside: str = "") -> str:
    """An execution context of a component."""
    said = f'xsi:type="rtsExt:execution_context_ext" rts:id="{number}" rts:kind="{kind}" rts:rate="{rate}"'
    return f"        <rts:ExecutionContexts {said}>{inside}</rts:ExecutionContexts>\n"


def configuration(name: str, /, **values: str) -> str:
    """A configuration set of a component."""
    data = "".join(
        f"<rts:ConfigurationData rts:name={quoteattr(k)} rts:data={quoteattr(v)}/>" for k, v in values.items()
    )
    return f'        <rts:ConfigurationSets rts:id="{name}">{data}</rts:ConfigurationSets>\n'


def connector(source: str, target: str, inside: str = "", *, kind: str = "Data", **attributes: str) -> str:
    """A connector of two ports, "component.port" each."""
    given = {"connectorId": f"{source}-{target}", "name": f"{source}_{target}".replace(".", "_")}
    if kind == "Data":
        given |= {"dataType": "IDL:RTC/TimedLong:1.0", "interfaceType": "corba_cdr", "dataflowType": "push"}
        given |= {"subscriptionType": "flush"}
    given |= attributes
    said = " ".join(f"rts:{key}={quoteattr(value)}" for key, value in given.items())
    ends = ""
    for side, path in (("source", source), ("target", target)):
        owner = path.partition(".")[0]
        ends += (
            f'<rts:{side}{kind}Port xsi:type="rtsExt:target_port_ext" rts:componentId="RTC:lab:test:x:1.0.0" '
            f'rts:instanceName="{owner}" rts:portName="{path}"/>'
        )
    local = f"{kind}PortConnectors"
    return f'    <rts:{local} xsi:type="rtsExt:{kind.lower()}port_connector_ext" {said}>{ends}{inside}</rts:{local}>\n'


def prop(name: str, value: str) -> str:
    """A property."""
    return f"<rtsExt:Properties rtsExt:name={quoteattr(name)} rtsExt:value={quoteattr(value)}/>"


def step(sequence: int, name: str, inside: str = "") -> str:
    """A step of a sequence."""
    target = f'<rts:TargetComponent rts:componentId="RTC:lab:test:x:1.0.0" rts:instanceName="{name}" rts:id="0"/>'
    return f'<rts:targets xsi:type="rtsExt:condition_ext" rts:sequence="{sequence}">{target}{inside}</rts:targets>'


def preceding(*names: str, timeout: int = 5000) -> str:
    """What a step waits for."""
    before = "".join(
        f'<rts:PrecedingComponents rts:componentId="RTC:lab:test:x:1.0.0" rts:instanceName="{name}" rts:id="0"/>'
        for name in names
    )
    return f'<rts:Preceding rts:timeout="{timeout}" rts:sendingTiming="SYNC">{before}</rts:Preceding>'


_WORDS = st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,8}", fullmatch=True)
_TEXTS = st.text(st.characters(min_codepoint=32, max_codepoint=0x2FFF, exclude_categories=("Cs", "Cc")), max_size=12)


@st.composite
def profiles(draw: st.DrawFn) -> str:
    """Profiles with components, sets, contexts, connectors of all options, sequences, and things nobody knows."""
    names = draw(st.lists(_WORDS.map(lambda word: f"{word}0"), min_size=1, max_size=5, unique_by=str.lower))
    parts = []
    for name in names:
        inside = "".join(
            configuration(set_name, **draw(st.dictionaries(_WORDS, _TEXTS, max_size=3)))
            for set_name in draw(st.lists(st.sampled_from(["default", "mode0", "__widget__", "__odd__"]), unique=True))
        )
        for number in range(draw(st.integers(0, 2))):
            rate = draw(st.sampled_from([0.0, 1.0, 500.0, 1000.0, 20000.0]))
            kind = draw(st.sampled_from(["PERIODIC", "EVENT_DRIVEN", "OTHER", "PeriodicExecutionContext", "Odd"]))
            inside += context(number, rate, kind)
        if draw(st.booleans()):
            inside += f"        <!-- {draw(_WORDS)} -->\n        <odd:Thing xmlns:odd='urn:odd' a='{draw(_WORDS)}'/>\n"
        place = 'rtsExt:x="1" rtsExt:y="-2" rtsExt:height="0" rtsExt:width="0" rtsExt:direction="down"'
        inside += f"        <rtsExt:Location {place}/>\n"
        inside += "".join(f"        {prop(draw(_WORDS), draw(_TEXTS))}\n" for _ in range(draw(st.integers(0, 2))))
        active = draw(st.sampled_from(["default", "mode0", ""]))
        parts.append(component(name, inside, activeConfigurationSet=active))
    for kind in sorted(draw(st.lists(st.sampled_from(["Data", "Service"]), max_size=4))):
        ends = [f"{draw(st.sampled_from(names))}.{draw(_WORDS)}" for _ in range(2)]
        options = "".join(
            prop(f"dataport.{key}", draw(values)) for key, values in _OPTIONS.items() if draw(st.integers(0, 4)) == 0
        )
        parts.append(connector(ends[0], ends[1], options, kind=kind))
    if draw(st.booleans()):
        word = draw(st.sampled_from(["StartUp", "Activation", "ShutDown", "Resetting"]))
        steps = ""
        for number, name in enumerate(names):
            wait = f'<rts:WaitTime rts:waitTime="{draw(st.integers(0, 3000))}"/>'
            steps += step(draw(st.integers(1, 3)), name, draw(st.sampled_from(["", wait, preceding(*names[:number])])))
        parts.append(f"    <rts:{word}>{steps}</rts:{word}>\n")
    return profile("".join(parts))


_OPTIONS = {
    "dataflow_type": st.sampled_from(["push", "pull", "PUSH", "duplex"]),
    "subscription_type": st.sampled_from(["flush", "new", "periodic", "Flush", "odd"]),
    "publisher.push_policy": st.sampled_from(["all", "fifo", "skip", "new"]),
    "publisher.push_rate": st.sampled_from(["10", "0.5", "-1", "x"]),
    "publisher.skip_count": st.sampled_from(["0", "3"]),
    "inport.buffer.length": st.sampled_from(["1", "8", "64", "0"]),
    "inport.buffer.write.full_policy": st.sampled_from(["overwrite", "do_nothing", "block"]),
    "inport.buffer.read.empty_policy": st.sampled_from(["readback", "do_nothing", "block"]),
    "inport.buffer.write.timeout": st.sampled_from(["1.0", "0.25"]),
    "timestamp_policy": st.sampled_from(["on_send", "on_received", "none"]),
    "serializer.cdr.endian": st.just("little,big"),
    "sync_readwrite": st.sampled_from(["YES", "NO"]),
}
