"""The guide in the terminal and the browser: found, searched, shown at any width, and never from outside."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from aiorts.cli.app import run_command
from aiorts.guide import blocks, pages, rendered, search
from aiorts.guide.newcomers import ASKED
from aiorts.guide.server import answer, renderer


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    capsys.readouterr()
    status = run_command(arguments)
    said = capsys.readouterr()
    return status, said.out, said.err


def test_a_topic_is_a_page_a_command_comes_first_and_a_misspelt_one_is_named(
    capsys: pytest.CaptureFixture[str],
) -> None:
    status, out, _ = run(capsys, "help", "Records")
    assert (status, out.splitlines()[0]) == (0, "# Records of your own")
    assert run(capsys, "help", "log")[1].startswith("Usage: aiorts log")
    assert run(capsys, "help", "E-LINE")[1].startswith("E-LINE: ")
    status, _, err = run(capsys, "help", "recrds")
    assert status == 2
    assert "did you mean records?" in err


def test_the_list_names_every_page_with_its_title(capsys: pytest.CaptureFixture[str]) -> None:
    out = run(capsys, "help", "--list")[1]
    for page in pages():
        assert re.search(rf"^  {page.name} +{re.escape(page.title)}$", out, re.MULTILINE), page.name


def test_a_section_shows_its_pages_alone(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "help", "Tutorial")
    assert status == 0
    assert "  component   Step 1: a component\n" in out
    assert "architecture" not in out


@pytest.mark.slow
def test_a_search_names_the_page_first_that_the_question_is_about(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "help", "--search", "record types of my own")
    assert status == 0
    assert out.startswith("aiorts help records ")
    assert search("rosbag2")[0].page.name == "ros-bag"
    status, _, err = run(capsys, "help", "--search", "xyzzy")
    assert status == 2
    assert "--list" in err


@pytest.mark.slow
def test_a_search_shows_five_pages_at_the_most_and_none_that_fits_half_as_well(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for question in ("slow consumer", "limit"):
        shown = [
            line.split()[2] for line in run(capsys, "help", "--search", question)[1].splitlines() if line[0] != " "
        ]
        hits = search(question)
        assert shown == [hit.page.name for hit in hits if hit.score >= hits[0].score / 2][:5]
        assert 1 <= len(shown) < len(hits)


@pytest.mark.slow
@pytest.mark.parametrize(
    "forms",
    [("recording", "recordings"), ("drop", "drops", "dropped", "dropping"), ("code", "codes"), ("add", "adding"),
     ("policy", "policies"), ("setting", "settings"), ("class", "classes"), ("miss", "missed", "misses")],
)  # fmt: skip
def test_a_search_finds_the_same_for_each_form_of_a_word(forms: tuple[str, ...]) -> None:
    found = [search(form) for form in forms]
    assert found[0]
    assert all(one == found[0] for one in found)


QUESTIONS = {
    "my reader is too slow and samples are lost": "slow-reader",
    "how many messages were dropped": "slow-reader",
    "which push policy for my rates": "choose-policy",
    "only the newest value": "choose-policy",
    "block the writer until there is room": "choose-policy",
    "what made the cycle miss its deadline": "missed-deadline",
    "garbage collection pauses": "missed-deadline",
    "SCHED_FIFO permission denied": "real-time",
    "restart a component after an error": "supervise",
    "systemd unit with a watchdog": "deploy",
    "run in a docker container": "deploy",
    "convert a recording to a ROS 2 bag": "ros-bag",
    "my own dataclass as the type of a port": "records",
    "a custom execution context": "write-context",
    "my own binary format": "write-codec",
    "options of aiorts run for my service": "write-service",
    "benchmark my own code": "write-bench",
    "two processes": "connect-processes",
}


@pytest.mark.slow(kept_by="test_what_newcomers_typed_is_answered_first_by_the_page_that_says_what_there_is")
def test_each_word_of_a_newcomer_leads_first_to_the_page_that_answers() -> None:
    names = {page.name for page in pages()}
    assert ASKED.keys() <= names
    words = [word for several in ASKED.values() for word in several]
    assert len(set(words)) == len(words)
    found = {word: search(word)[0].page.name for word in words}
    wrong = {word: found[word] for page, several in ASKED.items() for word in several if found[word] != page}
    assert wrong == {}


@pytest.mark.parametrize(
    ("word", "page", "said"),
    [("gui", "watch-in-the-browser", "browser"), ("dashboard", "watch-in-the-browser", "browser"),
     ("metrics", "limits", "metrics"),
     ("kubernetes", "limits", "Kubernetes"), ("rviz", "foxglove-live", "Foxglove"), ("3d", "foxglove-live", "Foxglove"),
     ("deadlock", "quality-of-service", "deadlock"),
     ("feedback loop", "quality-of-service", "no component begins"), ("losses", "slow-reader", ""),
     ("websocket", "fastapi", ""), ("health", "fastapi", ""), ("replay", "recording", "")],
)  # fmt: skip
def test_what_newcomers_typed_is_answered_first_by_the_page_that_says_what_there_is(
    word: str, page: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for question in (word, f"is there a {word}?"):
        status, out, _ = run(capsys, "help", "--search", question)
        assert status == 0
        assert out.startswith(f"aiorts help {page} ")
        assert said in "".join(out.splitlines()[1:2])


def test_the_line_of_a_tier_is_no_answer() -> None:
    assert {hit.page.name for hit in search("provisional")} == {"stability", "command-line"}


DISTRIBUTION = ("distributed", "distribution", "multiprocess", "multiprocessing", "remote")


@pytest.mark.slow
@pytest.mark.parametrize("question", DISTRIBUTION)
def test_what_is_asked_about_several_processes_is_answered_first_by_the_limits(question: str) -> None:
    hit = search(question)[0]
    assert (hit.page.name, hit.heading.partition(":")[0]) == ("limits", "Several processes or machines")


@pytest.mark.slow
@pytest.mark.parametrize("question", ["node", "executor", "subscription", "reason", "motor"])
def test_an_excerpt_is_prose_without_links_tables_and_code(question: str) -> None:
    for hit in search(question):
        assert not hit.line.startswith(("|", "```", "class ", "import "))
        assert "](" not in hit.line


@pytest.mark.parametrize(
    ("words", "first", "inside"),
    [("api Rig", "### `aiorts.testing.Rig`", "feed("), ("Rig", "### `aiorts.testing.Rig`", "feed("),
     ("testing.Rig", "### `aiorts.testing.Rig`", "feed("), ("TimedPose2D", "### `aiorts.types.TimedPose2D`", "Pose2D"),
     ("record-types timedpose2d", "### `TimedPose2D`", "stamp"), ("FlexiAdd", "## FlexiAdd", "--port"),
     ("policies full policy", "## Buffer and full policy: what happens to a slow reader", "WriteTimeout"),
     ("errors-codes E-LINE", "", "error-codes")],
)  # fmt: skip
def test_a_part_of_a_page_is_shown_by_its_heading(
    words: str, first: str, inside: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = run(capsys, "help", *words.split())
    assert (status, out.partition("\n")[0]) == (0 if first else 2, first)
    assert inside in out + err
    assert len([line for line in out.splitlines() if re.match(r"#+ ", line)]) == bool(first)


@pytest.mark.slow
def test_a_public_name_is_shown_by_its_last_word_and_a_misspelt_one_is_named(
    capsys: pytest.CaptureFixture[str],
) -> None:
    import aiorts

    taken = {page.name for page in pages()} | {"run"}
    for name in aiorts.__all__[::4]:
        if name.lower() not in taken:
            assert f"### `aiorts.{name}`" in run(capsys, "help", name)[1], name
    for words, near in (("Rgi", "did you mean Rig?"), ("api Rigg", "did you mean Rig?"), ("api xyzzy", "help api")):
        status, out, err = run(capsys, "help", *words.split())
        assert (status, out) == (2, "")
        assert near in err


def test_a_table_folds_its_last_column_or_names_equal_cells_once() -> None:
    two = "| name | what it is |\n|---|---|\n| a | one two three four five |\n| b | |"
    assert rendered(two, 20, bold=False).splitlines() == [
        "a", "    what it is: one", "        two three", "        four five", "b"
    ]  # fmt: skip
    assert rendered(two.replace("five", "five six seven eight"), 40, bold=False).splitlines() == [
        "name  what it is", "a     one two three four five six seven", "      eight", "b"
    ]  # fmt: skip
    wide = f"| kind | sent | stored | read |\n|---|---|---|---|\n| {'k' * 40} | itself | a list | itself |"
    assert rendered(wide, 40, bold=False).splitlines() == ["k" * 40, "    sent, read: itself", "    stored: a list"]


def test_a_picture_is_its_description_and_where_it_is_shown() -> None:
    shown = rendered("![a curve](a.svg)", 80, bold=False)
    assert shown == "(picture, shown by aiorts help --serve: a curve)"


@pytest.mark.slow
def test_a_question_of_a_user_is_answered_by_one_of_the_first_two_pages() -> None:
    found = {question: [hit.page.name for hit in search(question)[:2]] for question in QUESTIONS}
    assert {question: names for question, names in found.items() if QUESTIONS[question] not in names} == {}


@pytest.mark.slow
@pytest.mark.parametrize("width", [20, 80, 200])
def test_a_page_keeps_every_word_and_is_no_wider_than_the_terminal(width: int) -> None:
    for page in pages():
        shown = rendered(page.text, width, bold=False)
        code = {f"    {line}".rstrip() for block in blocks(page.text) for line in block.text.splitlines()}
        longest = max(map(len, re.findall(r"\S+", shown)), default=0)
        for line in shown.splitlines():
            assert line in code or line.startswith("#") or len(line) <= max(width, 8 + longest), line
        written = re.sub(r"^```.*?^```$|<!--.*?-->", "", page.text, flags=re.DOTALL | re.MULTILINE)
        written = re.sub(
            r"^\|[^|\n]*(.*\n\|-)", r"\1", written, flags=re.MULTILINE
        )  # in a list, the first cell is its head
        words = re.findall(r"\w+", re.sub(r"!?\[([^\]]+)\]\([^)\s]+\)", r"\1", written))
        assert set(words) <= set(re.findall(r"\w+", shown)), page.name


def test_heads_are_bold_on_a_terminal_and_nothing_else() -> None:
    shown = rendered("# A head\n\nText\n\n```python\n# no head\n```\n", 80, bold=True)
    assert shown == "\x1b[1m# A head\x1b[0m\n\nText\n\n    # no head"


def test_files_of_a_page_are_saved_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "help", "plugin", "--save", str(tmp_path / "tanks"))
    assert status == 0
    assert out.splitlines() == [str(path) for path in map(Path, out.splitlines()) if path.is_file()]
    assert (tmp_path / "tanks" / "acme_tanks.py").read_text(encoding="utf-8").startswith("from aiorts import")
    status, _, err = run(capsys, "help", "plugin", "--save", str(tmp_path / "tanks"))
    assert (status, "nothing was written" in err) == (2, True)
    assert run(capsys, "help", "--save", str(tmp_path))[0] == 2


@pytest.mark.slow
def test_the_browser_gets_every_page_with_links_that_lead_somewhere_and_nothing_from_outside() -> None:
    pytest.importorskip("markdown_it")
    render = renderer()
    answered = cache(lambda target: answer(target, render))
    for target in ["/", "/search?q=record", *(f"/{page.name}" for page in pages())]:
        status, kind, body = answered(target)
        text = body.decode()
        assert (status, kind) == (200, "text/html; charset=utf-8"), target
        for link in re.findall(r'(?:href|src|action)="([^"]*)"', text):
            if link.startswith(("http", "#")):
                assert f'src="{link}"' not in text, link
            else:
                assert answered(link.partition("#")[0])[0] == 200, f"{target}: {link}"
    assert answer("/../../../etc/passwd", render)[0] == 404
    assert b"<script" not in answer("/search?q=<script>x</script>", render)[2]


@pytest.mark.slow
def test_it_serves_on_this_machine_alone_until_it_is_interrupted() -> None:
    pytest.importorskip("markdown_it")
    command = [sys.executable, "-m", "aiorts", "help", "--serve", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            port = re.search(r"http://127\.0\.0\.1:(\d+)/", line)
            assert port, line
            with socket.create_connection(("127.0.0.1", int(port[1])), timeout=10) as client:
                client.sendall(b"GET /records HTTP/1.0\r\n\r\n")
                assert client.makefile("rb").readline().split()[1] == b"200"
        finally:
            process.send_signal(2)
        assert process.wait(timeout=10) == 130
