"""Write tests/FAULTS.md: what is done to the kernel and its tools on purpose, what is expected, which tests hold it.

Run: python tests/faults.py. The marks `@pytest.mark.fault("A01")` are read from the source; nothing is run.
"""

from __future__ import annotations

from pathlib import Path

from rows import collect

TARGET = Path(__file__).with_name("FAULTS.md")

GROUPS = {
    "A": "Code of components",
    "B": "Ports, buffers and services",
    "C": "Execution contexts and time",
    "D": "Recordings",
    "E": "Bytes from others",
    "F": "Files, plugins and the command line",
    "G": "Resources and long runs",
    "I": "What holds under every fault",
}
EXPECTED = {
    "A01": "A hook that raises: its component goes where the lifecycle's table says, its neighbours run on.",
    "A02": "A component whose activation failed is not executed, and its ports stay closed.",
    "A03": "`on_aborting` or `on_error` fails as well: the causes are chained, the state stays, the log is short.",
    "A04": "A reset that failed can be asked for again, and works when its cause is gone.",
    "A05": "A hook raises SystemExit, KeyboardInterrupt or the like: an error of its component, not the end of all.",
    "A06": "A hook that swallows its cancellation is cancelled a few times, then abandoned; the kernel closes in time.",
    "A07": "A hook that waits forever while it is cancelled is abandoned in the same way.",
    "A08": "A hook that waits forever is noticed by its deadline, and the others run on.",
    "A09": "A hook that blocks the loop is named, with file and line, while it blocks; the process can be made to end.",
    "A10": "A hook that holds its process for ever is seen as busy, and killed beyond its deadline; others run on.",
    "A11": "Writes in an endless loop, with no other await, leave everybody else their turns.",
    "A13": "A component's process crashes, exits or is killed: that is its failure; a reset starts another process.",
    "A14": "A task that a component started fails: that is its component's error and never gets lost.",
    "A15": "Tasks, threads and descriptors that a component leaves behind are named; the tasks are cancelled.",
    "A16": "A call from another thread is refused by name, where it cannot work, and changes nothing.",
    "A17": "A hook asks for its own deactivation, removal or the like: queued, carried out soon, no deadlock.",
    "A18": "A component that fails again and again is restarted with growing delays, and given up in the end.",
    "A19": "A hook of a wrong kind, name or signature is refused when its class is made.",
    "A20": "A value that is changed after it was written: every reader sees it as it was at the write.",
    "A21": "A flood of output is cut to a bound, and what was left out is counted.",
    "B01": "Ports whose types differ are not connected; the message names both and what to put between them.",
    "B02": "A value of another type is refused where it is written, and nobody receives it.",
    "B03": "An array of another shape, type or order is refused or converted exactly, at the write.",
    "B04": "NaN, infinities and negative zero arrive bit for bit.",
    "B05": "A conversion that would change a value is an error, unless a policy for it was chosen.",
    "B06": "For all combinations of subscription and policy the survivors are those of a reference model.",
    "B07": "A write that waits for a reader that never reads ends at its deadline.",
    "B08": "Disconnecting in the midst of a write leaves a whole sample or none, and the counts are right.",
    "B09": "Reconnecting the same ports brings neither a second connector nor old samples.",
    "B10": "Samples that wait for a component that is removed are counted as dropped.",
    "B11": "A ring of components on events starves nobody; `aiorts check` names it.",
    "B12": "Duplicates, ports that are not there and impossible names are refused with what is allowed.",
    "B13": "A buffer length out of range is refused with the range.",
    "B14": "A push rate or policy that makes no sense is refused and not guessed.",
    "B15": "A listener that raises is counted; the samples arrive.",
    "B16": "Connecting and disconnecting very often leaves no memory behind.",
    "B17": "Of a burst every sample is delivered or counted as dropped.",
    "B18": "Time stamps are kept as written or refused; they never wrap.",
    "B19": "A read that is cancelled takes no sample, and none comes twice.",
    "B20": "A provider that fails, hangs, goes or answers wrongly: the caller has a typed error by its deadline.",
    "B21": "A slow or failing reader takes nothing from the other readers.",
    "B22": "A change of parameters is made whole or not at all, whatever its checks do.",
    "C01": "An execution that takes several periods is counted as overrun; no burst follows unless it was chosen.",
    "C02": "A rate out of range is refused with the range.",
    "C03": "A context that cannot keep up takes no processor from the others.",
    "C04": "A wall clock that is set changes time stamps and no period.",
    "C05": "After the process was suspended there is one overrun and no burst.",
    "C06": "On a busy processor ticks are missed and counted; no component fails for it.",
    "C07": "Pauses of the garbage collector are counted, and kept short where aiorts owns the process.",
    "C08": "A component in several contexts is entered by one at a time; stopping them from its hooks does not hang.",
    "C09": "Any storm of requests leads through states of the lifecycle's table alone.",
    "C10": "Another rate holds at once, also while the context sleeps.",
    "C11": "Very many triggers in one turn are one run, and cost no memory.",
    "C12": "A member that waits holds up its own context and no other.",
    "C13": "Hours of virtual time have exactly the ticks that they should.",
    "C14": "Waiting for a negative time or for no number is refused or over at once, and never spins.",
    "D01": "A recorder that is killed leaves a file that opens as it is and holds an exact prefix.",
    "D02": "What was promised to be on the disk survives a loss of power; the rest is an exact prefix.",
    "D03": "A full disk ends the recording with one error, and leaves a valid file.",
    "D04": "A failing disk does the same; what it did not confirm is not said to be safe.",
    "D05": "A slow disk holds up nobody; what finds no room is counted.",
    "D06": "A flipped bit is found; no wrong value is ever read, and what is whole can be salvaged.",
    "D07": "A file that is cut off anywhere gives one clear message, in little memory.",
    "D08": "Lengths and counts that lie, and compression bombs, are refused by a limit.",
    "D09": "What is no recording is refused in one line.",
    "D10": "Recordings of other versions are read or refused by their version; the golden files are read forever.",
    "D11": "A pickle is refused by its first bytes; nothing unpickles.",
    "D12": "A type that is not known here is named; nothing that a file names is imported.",
    "D13": "A large recording is opened and sought at once, in little memory.",
    "D14": "A clock that was set back, and gaps, change no order and are waited for within a bound.",
    "D15": "A replay that is faster than its readers waits or counts, as their connectors say.",
    "D16": "All types come back from a recording bit for bit.",
    "D17": "Two recorders never share a file; one that is there is never touched unasked.",
    "D18": "Deactivated and activated again, recording and replay go on as promised.",
    "D19": "A file that vanishes while it is recorded is told once.",
    "D20": "A signal while much is buffered closes the recording whole.",
    "D21": "A replay keeps the times between samples and does not drift.",
    "D22": "Names and texts of a recording cannot command a terminal.",
    "E01": "A process at the other end of a link is killed: the loss is counted, and the link goes on when it is back.",
    "E02": "A link is cut: both ends are down within three seconds and say so; writes are kept or counted as they say.",
    "E03": "A link is there again: the same connectors go on within five seconds, and each sample is accounted for.",
    "E04": "A network that carries one way alone: both ends are down within two leases.",
    "E05": "What both sides change while they are apart: afterwards both know the same.",
    "E06": "A stopped peer: all samples arrive, or what is lost is counted; the writer's loop goes on.",
    "E07": "More is written than a link carries: the newest comes soon, the rest is counted, calls are answered.",
    "E08": "Loss, reordering, duplicates and delays of a transport: each sample is there once, in order.",
    "E09": "Two kernels of one name: the second is refused.",
    "E10": "What is larger than the other end takes is left out, or refused at the sender; what comes next arrives.",
    "E11": "Garbage of very many connections does no harm, leaves nothing, and others are served.",
    "E12": "Connections that come to nothing hold up no kernel that has a certificate.",
    "E13": "A msgpack bomb is refused by its structure, in milliseconds and little memory.",
    "E14": "The head of an array that lies is refused before any memory is taken for it.",
    "E15": "A message or type that is not known is left out, or refused at its connector; what is beside it goes on.",
    "E16": "Releases that share a protocol work together; others are told which each speaks, on both sides.",
    "E17": "Without a certificate nothing of a kernel is seen, and the reason is in the log.",
    "E18": "A certificate that is not to be used is refused, and the cause is named at the refused end.",
    "E19": "Orders of who may only look take no effect, are refused with E-DENIED and are in the log.",
    "E20": "Messages of a session that come again, or come to a later kernel, have no effect.",
    "E21": "A client that floods, stalls or says nonsense is bounded in rate and memory; others are served.",
    "E22": "A thousand short sessions: no call of others fails, and nothing of them is left.",
    "E23": "Right after a reconnection nothing is said to be absent that is there.",
    "E24": "Samples that flood in while the loop is held up: little memory, and what finds no room is counted.",
    "E25": "The interpreter ends within seconds, whatever its connection to other hosts is like.",
    "E26": "A port that is taken is said before anything runs; without any network all here runs on.",
    "F01": "A file that is no TOML: line, column and reason, within a second.",
    "F02": "YAML of others: no tags, few aliases, each key once; else it is not read.",
    "F03": "A misspelt key or section is told the one that was probably meant.",
    "F04": "An unknown component or command is told the nearest and what is installed.",
    "F05": "A plugin that is broken in any way is named with its origin; all else works.",
    "F06": "A bad port is marked where it is bad; what is accepted is the grammar.",
    "F07": "A bad map is marked where it is bad; nothing in it is skipped.",
    "F08": "A constant is a literal and never code; hostile ones cost neither time nor memory.",
    "F09": "Ctrl-C ends in order at any moment, and at once the second time; no traceback.",
    "F10": "SIGTERM, SIGHUP and SIGQUIT end in order with their status; SIGUSR1 tells state and stacks.",
    "F11": "A reader that leaves its pipe ends the writer quietly.",
    "F12": "Closed streams, a full disk behind one, and no terminal: the right status and no busy loop.",
    "F13": "A reader of a dump that stalls holds up no other component.",
    "F14": "In any locale, terminal and width it works, and escapes what cannot be shown.",
    "F15": "Who wants a file that somebody else has is told who has it.",
    "F16": "No home, a folder that is gone or may not be written: it works, or says in a line why not.",
    "F17": "No list of arguments gives a traceback; a wrong one is a line and status 2.",
    "F18": "With `--json` standard output is JSON to its last line, whatever goes wrong.",
    "F19": "What is named and absent, ambiguous, denied or does not answer: four sentences, four codes.",
    "F20": "A system file of another version of the format is told which one is read.",
    "G01": "Too few descriptors are one line that names who wanted one.",
    "G02": "What finds no memory is refused alone; the rest lives.",
    "G03": "Very many samples through a chain leave nothing behind.",
    "G04": "Very many components that come and go leave nothing behind.",
    "G05": "A public coroutine that is cancelled at any of its turns leaves no task and no lock behind.",
    "G06": "A thousand components, and hundreds of contexts, are on time.",
    "G07": "Ten thousand of anything take ten thousand times as long as one, and not more.",
    "G08": "Ten thousand connectors between two kernels, over one session of the network.",
    "G10": "A used-up pool of threads is told once, and the loop lives.",
    "G11": "The interpreter ends while threads of aiorts live.",
    "G12": "systemd is told: ready after activation, pings only while all contexts get on, stopping at the end.",
    "G13": "A thousand failures at once are a bounded number of lines and a summary.",
    "I7": "What is shown of a component's state is true a moment later at the most.",
}
"""Name of a fault and what is expected; the numbers that are missing need a network or processes of their own."""


def render(shown: dict[str, list[str]]) -> str:
    """The text of FAULTS.md."""
    lines = [
        "# Faults that are made on purpose, and the tests that hold what is expected",
        "",
        "Written by `python tests/faults.py` from the marks `fault(...)` of the tests; a test fails when it is stale.",
        "Besides its own expectation each has these: no other component is harmed, no sample is lost uncounted,",
        "nothing is abandoned, every wait ends, bad input never gives a traceback.",
    ]
    for group, title in GROUPS.items():
        lines += ["", f"## {group}: {title}", "", "| Fault | Expected | Tests |", "|---|---|---|"]
        for name in sorted(name for name in EXPECTED.keys() | shown.keys() if name.startswith(group)):
            tests = "<br>".join(f"`{test}`" for test in shown.get(name, [])) or "none yet"
            lines.append(f"| {name} | {EXPECTED.get(name, 'not in the list of faults.py')} | {tests} |")
    return "\n".join(lines) + "\n"


def found() -> dict[str, list[str]]:
    """Fault -> tests that are marked with it."""
    return {str(name): tests for name, tests in collect("fault").items()}


if __name__ == "__main__":
    TARGET.write_text(render(found()), encoding="utf-8")
    print(f"{TARGET}: {len(found())} faults")
