"""Drawings of a system: everything is in them, and each is valid in its language, whatever a type is called."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aiorts import Catalogue
from aiorts.layout import Place, Places
from aiorts.system import GRAPH_FORMATS, graph, load, parse
from campaign import cases, time_limit
from system_parts import CHAIN

CATALOGUE = Catalogue()
ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").rglob("system.toml"))
ROOMBA = load(ROOT / "examples" / "roomba" / "system.toml")
SVG = "{http://www.w3.org/2000/svg}"


@pytest.mark.row(113)
def test_mermaid_has_contexts_components_ports_and_connectors(tmp_path: Path, write: Callable[..., Path]) -> None:
    text = CHAIN.replace("length = 4", 'subscription = "new"\npush = "skip"').replace("100.0", "12.5")
    assert graph(load(write(text))) == (
        "flowchart LR\n"
        '  subgraph g0["fast: periodic, 12.5 Hz"]\n'
        '    c0["<b>source</b><br/>Source<br/>▶ out: TimedLong"]\n'
        "  end\n"
        '  subgraph g1["rest: event"]\n'
        '    c1["<b>middle</b><br/>Middle<br/>◀ input: TimedLong<br/>▶ output: TimedLong"]\n'
        '    c2["<b>sink</b><br/>Sink<br/>◀ input: TimedLong"]\n'
        "  end\n"
        '  c0 -->|"out → input<br/>new, skip"| c1\n'
        '  c1 -->|"output → input"| c2\n'
    )


@pytest.mark.row(113)
def test_dot_joins_port_with_port(write: Callable[..., Path]) -> None:
    text = graph(load(write(CHAIN.replace("length = 4", 'subscription = "periodic"\npush_rate = 5'))), "dot")
    assert '    c0 [label="{source\\nSource|{<o0> out: TimedLong}}"];\n' in text
    assert '  c0:o0:e -> c1:i0:w [label="periodic, 5 Hz"];\n' in text
    assert "  c1:o1:e -> c2:i0:w;\n" in text


def test_a_component_in_several_contexts_or_in_none_is_drawn_once(write: Callable[..., Path]) -> None:
    text = CHAIN.replace('["middle", "sink"]', '["middle", "source"]')
    drawn = graph(load(write(text)))
    assert drawn.count("<b>source</b>") == 1
    assert "Source (also in rest)" in drawn
    assert 'subgraph g2["in no context"]\n    c2["<b>sink</b>' in drawn


def boxes_of(document: str) -> list[tuple[float, float, float, float]]:
    root = ElementTree.fromstring(document)
    return [
        (*(float(one.get(key, "")) for key in ("x", "y", "width", "height")),)  # type: ignore[misc]
        for one in root.iter(f"{SVG}rect")
        if one.get("class") == "box"
    ]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.parent.name)
def test_svg_is_well_formed_within_its_frame_and_no_box_covers_another(path: Path) -> None:
    document = graph(load(path), "svg")
    root = ElementTree.fromstring(document)
    width, height = float(root.get("width", "")), float(root.get("height", ""))
    boxes = boxes_of(document)
    assert len(boxes) == document.count('class="name"')
    for x, y, wide, high in boxes:
        assert x >= 0
        assert x + wide <= width
        assert y >= 0
        assert y + high <= height
    for number, (x, y, wide, high) in enumerate(boxes):
        for other_x, other_y, other_wide, other_high in boxes[:number]:
            apart = x >= other_x + other_wide or other_x >= x + wide or y >= other_y + other_high or other_y >= y + high
            assert apart
    assert document == graph(load(path), "svg")


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.parent.name)
def test_no_arrow_runs_through_a_box(path: Path) -> None:
    document = graph(load(path), "svg")
    boxes = boxes_of(document)
    ways = re.findall(r'class="wire"[^>]* d="([^"]+)"', document)
    assert len(ways) == document.count('class="wire"')
    for way in ways:
        points = [(float(x), float(y)) for x, y in re.findall(r"([-\d.]+),([-\d.]+)", way)]
        for (ax, ay), (bx, by) in pairwise(points):
            for x, y, wide, high in boxes:
                beside = max(ax, bx) <= x + 0.5 or min(ax, bx) >= x + wide - 0.5
                assert beside or max(ay, by) <= y + 0.5 or min(ay, by) >= y + high - 0.5, way


@pytest.mark.slow(kept_by="studio/test_layout.py::test_a_graph_that_would_be_too_wide_goes_on_below")
def test_a_thousand_components_make_a_picture_of_bearable_width() -> None:
    names = [f"c{n:03}" for n in range(1000)]
    text = "schema = 1\n" + "".join(f'[components.{name}]\ntype = "x.py:X"\n' for name in names)
    ends = [(one, two) for step in (1, 7) for one, two in zip(names, names[step:], strict=False)]
    text += "".join(f'[[connections]]\nfrom = "{one}.o"\nto = "{two}.i"\n' for one, two in ends)
    for first in range(0, 1000, 25):
        text += f'[contexts.x{first:03}]\nkind = "event"\nmembers = {names[first : first + 25]}\n'.replace("'", '"')
    root = ElementTree.fromstring(graph(parse(text, Path("s.toml")), "svg", CATALOGUE))
    assert float(root.get("width", "")) < 10_000
    assert float(root.get("height", "")) < 20_000


def test_several_labels_before_one_port_become_one(write: Callable[..., Path]) -> None:
    more = '[[connections]]\nfrom = "source.out"\nto = "sink.input"\nfull = "block"\n'
    document = graph(load(write(CHAIN.replace("[contexts.fast]", f"{more}[contexts.fast]"))), "svg")
    labels = re.findall(r'class="label"[^>]*>([^<]*)<', document)
    assert "block" in labels
    ends = re.findall(r'class="label" x="([\d.-]+)" y="([\d.-]+)"', document)
    assert len(ends) == len(set(ends))


def test_the_roomba_flows_from_left_to_right() -> None:
    document = graph(load(ROOT / "examples" / "roomba" / "system.toml"), "svg")
    names = re.findall(r'class="name" x="([\d.]+)"[^>]*>(\w+)<', document)
    where = {name: float(x) for x, name in names}
    assert where["imu"] < where["odometry"] < where["metres"] < where["checker"]
    assert where["imu"] < where["turn_rate"] < where["show"]
    assert document.count('<path class="wire"') == 7


def placed_in(document: str) -> dict[str, tuple[float, float]]:
    """The corner of each box of a drawing, by name."""
    names = re.findall(r'class="name"[^>]*>(\w+)<', document)
    return {name: (x, y) for name, (x, y, _, _) in zip(names, boxes_of(document), strict=True)}


def apart(boxes: list[tuple[float, float, float, float]]) -> bool:
    """Whether no box covers another."""
    return all(
        x >= u + w or u >= x + wide or y >= v + h or v >= y + high
        for number, (x, y, wide, high) in enumerate(boxes)
        for u, v, w, h in boxes[:number]
    )


def test_boxes_stand_where_they_stood_and_a_new_one_beside_them() -> None:
    system = load(ROOT / "examples" / "roomba" / "system.toml")
    usual = placed_in(graph(system, "svg"))
    stored = {"imu": (0.0, 48.0), "metres": (636.0, 110.0), "odometry": (330.0, 48.0), "turn_rate": (450.0, 192.0)}
    places = Places({name: Place(x, y, 0.0) for name, (x, y) in stored.items()})
    document = graph(system, "svg", places=places)
    found = placed_in(document)
    assert found.keys() == usual.keys()
    assert apart(boxes_of(document))
    assert found["odometry"][0] < found["turn_rate"][0] < found["metres"][0]
    wider = (found["metres"][0] - found["odometry"][0]) / (636.0 - 330.0)
    assert wider > 1.0
    for name, (x, y) in stored.items():
        assert found[name][0] - found["imu"][0] == pytest.approx(x * wider, abs=0.5)
        assert found[name][1] - found["odometry"][1] == pytest.approx(y - 48.0, abs=0.5) or name == "imu"
    assert graph(system, "svg", places=Places()) == graph(system, "svg")
    assert graph(system, "dot", places=places) == graph(system, "dot")


@given(
    st.dictionaries(
        st.sampled_from(["imu", "odometry", "turn_rate", "metres", "checker", "show", "gone"]),
        st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)),
    )
)
@settings(max_examples=cases(2_000), deadline=None)
def test_wherever_boxes_are_said_to_have_stood_none_covers_another(stored: dict[str, tuple[float, float]]) -> None:
    places = Places({name: Place(x, y, 0.0) for name, (x, y) in stored.items()})
    document = graph(ROOMBA, "svg", CATALOGUE, places)
    boxes, root = boxes_of(document), ElementTree.fromstring(document)
    assert len(boxes) == 6
    assert apart(boxes)
    left, top, width, height = map(float, root.get("viewBox", "").split())
    assert all(left <= x and x + w <= left + width and top <= y and y + h <= top + height for x, y, w, h in boxes)


def test_another_form_is_refused() -> None:
    with pytest.raises(ValueError, match="expected mermaid, dot, svg"):
        graph(parse("schema = 1\n", Path("s.toml")), "png")


def test_an_empty_system_is_a_drawing_too() -> None:
    for form in GRAPH_FORMATS:
        assert graph(parse("schema = 1\n", Path("s.toml")), form)


@pytest.mark.slow(kept_by="test_the_roomba_flows_from_left_to_right")
def test_a_long_chain_with_a_way_back_is_laid_out_without_end_of_recursion() -> None:
    names = [f"c{n}" for n in range(1500)]
    text = "schema = 1\n" + "".join(f'[components.{name}]\ntype = "x.py:X"\n' for name in names)
    ends = [*pairwise(names), (names[-1], names[0])]
    text += "".join(f'[[connections]]\nfrom = "{one}.o"\nto = "{two}.i"\n' for one, two in ends)
    document = graph(parse(text, Path("s.toml")), "svg")
    assert document.count('class="box"') == 1500
    ElementTree.fromstring(document)


NASTY = st.text(st.sampled_from("ab<>&\"'\\{}|[]#;%-→\n\t\x00é(`~"), min_size=1, max_size=12)


@st.composite
def systems(draw: st.DrawFn) -> str:
    """Systems of any shape, with types and options that mean something to the languages of drawings."""
    import json

    count = draw(st.integers(1, 5))
    names = [f"n{number}" for number in range(count)]
    text = "schema = 1\n"
    for name in names:
        text += f"[components.{name}]\ntype = {json.dumps(draw(NASTY), ensure_ascii=True)}\n"
    ends = st.tuples(st.sampled_from(names), st.integers(0, 1), st.sampled_from(names))
    for one, port, two in draw(st.lists(ends, max_size=6, unique=True)):
        option = draw(st.sampled_from(["", 'subscription = "new"\n', 'full = "block"\n']))
        text += f'[[connections]]\nfrom = "{one}.o{port}"\nto = "{two}.i"\n{option}'
    for number in range(draw(st.integers(0, 3))):
        members = draw(st.lists(st.sampled_from(names), unique=True))
        kind = json.dumps(draw(NASTY), ensure_ascii=True)
        text += f"[contexts.x{number}]\nkind = {kind}\nmembers = {json.dumps(members)}\n"
    return text


TEXT = r'"(?:[^"\\\n]|\\.)*"'
DOT = (
    r"digraph system \{",
    r"  rankdir=LR;",
    rf"  (?:node|edge) \[(?:\w+=(?:\w+|{TEXT})(?:, )?)+\];",
    r"  subgraph cluster_\d+ \{",
    rf"    label={TEXT};",
    r"    style=rounded;",
    rf"    c\d+ \[label={TEXT}\];",
    r"  \}",
    rf"  c\d+:o\d+:e -> c\d+:i\d+:w(?: \[label={TEXT}\])?;",
    r"\}",
)
SAFE = r'[^"#;\n]|#\d+;'
MERMAID = (
    r"flowchart LR",
    rf'  subgraph g\d+\["(?:{SAFE})*"\]',
    rf'    c\d+\["<b>\w+</b><br/>(?:{SAFE})*"\]',
    r"  end",
    rf'  c\d+ -->\|"(?:{SAFE})*"\| c\d+',
)


def fits(line: str, forms: tuple[str, ...]) -> bool:
    return any(re.fullmatch(form, line) for form in forms)


def records_are_balanced(label: str) -> bool:
    """Braces of a record label, without the escaped ones, open and close in order."""
    depth = 0
    for c in re.sub(r"\\.", "", label):
        depth += (c == "{") - (c == "}")
        if depth < 0:
            return False
    return depth == 0


@pytest.mark.slow(kept_by="test_svg_is_well_formed_within_its_frame_and_no_box_covers_another")
@given(systems())
@settings(max_examples=cases(5_000))
@pytest.mark.timeout(time_limit(600))
def test_whatever_a_type_is_called_each_drawing_is_valid(text: str) -> None:
    system: Any = parse(text, Path("nowhere/s.toml"))
    assert all(fits(line, MERMAID) for line in graph(system, "mermaid", CATALOGUE).splitlines())
    dot = graph(system, "dot", CATALOGUE)
    assert all(fits(line, DOT) for line in dot.splitlines())
    assert all(records_are_balanced(label) for label in re.findall(rf"c\d+ \[label=({TEXT})\]", dot))
    document = graph(system, "svg", CATALOGUE)
    root = ElementTree.fromstring(document)
    assert len(boxes_of(document)) == len(system.components)
    assert sum(one.get("class") == "wire" for one in root.iter(f"{SVG}path")) == len(system.connections)


def test_a_rendezvous_is_named_at_its_arrow(write: Callable[..., Path]) -> None:
    drawn = graph(load(write(CHAIN.replace("length = 4", "length = 0"))))
    assert '|"out → input<br/>length 0"|' in drawn
