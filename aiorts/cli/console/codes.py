"""The codes of messages, E- for errors, W- and N- for `aiorts check`: meaning, usual cause and remedy.

A test compares the table with the source, so that it has every code and no other.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from aiorts.errors import SLOW_READER


class Code(NamedTuple):
    """The explanation of a code."""

    meaning: str
    cause: str
    remedy: str


CODES: Final[dict[str, Code]] = {
    "E-ABANDONED": Code(
        "A hook ignored every cancellation; its component is abandoned and never runs again.",
        "The hook catches CancelledError and goes on, or shields what it waits for.",
        "Let CancelledError pass in the hook it names; blocking code belongs in a ThreadContext.",
    ),
    "E-ABSENT": Code(
        "Nothing that runs has this name.",
        "A component that is gone or spelt otherwise, or a kernel that cannot be reached.",
        "`aiorts ls` shows what runs.",
    ),
    "E-AIORTS": Code(
        "An error of aiorts that has no code of its own.",
        "An extension raises AiortsError itself.",
        "Look with --debug which extension raised it; its author derives the error with a `code` of its own.",
    ),
    "E-AMBIGUOUS": Code(
        "Several things that run have this name.",
        "The same system runs twice, or two kernels have a component of the same name.",
        "Write one of the names that the message lists: kernel/component.",
    ),
    "E-APPLY": Code(
        "A plan for a running system failed, and what of it was done was taken back.",
        "A component that is wanted fails in a hook, or two ports that are to be connected do not fit.",
        "Repair what the message names and apply it again; `aiorts check` finds most of it before.",
    ),
    "E-AWAIT": Code(
        "A coroutine was made and never awaited: it did nothing.",
        "A hook without async calls write or read, or await was forgotten.",
        "Use write_nowait in a plain hook, or make the hook async def and await.",
    ),
    "E-BUSY": Code(
        "Two tasks use what only one can use at a time.",
        "Two tasks read the same in-port, or a system is run twice at once.",
        "Let one task read the port and pass the samples on.",
    ),
    "E-CALL-TIMEOUT": Code(
        "A function that a thread called on the loop was not done in time.",
        "The function waits for long, or other code holds the event loop up.",
        "Give it a longer timeout; look for code that blocks the event loop.",
    ),
    "E-CLOSED": Code(
        "The kernel, connector or port was closed, or never bound.",
        "It was removed while in use, or super().__init__() was not called.",
        "Use it before it is removed; call super().__init__() in the component's __init__.",
    ),
    "E-COMPONENT": Code(
        "A component's own code failed.",
        "An exception came out of its constructor or one of its hooks; the line names the hook.",
        "Run again with --debug to see the traceback; the component can be reset.",
    ),
    "E-CONFIG": Code(
        "A parameter or an option does not exist, or its value is not allowed.",
        "A misspelt name, a value out of its range, a map, port or constant that does not follow its grammar.",
        "aiorts inspect NAME shows what is allowed; a mark stands under the mistake.",
    ),
    "E-CONFORM": Code(
        "An extension does not keep a promise of its kind.",
        "A conformance suite of aiorts.testing found it.",
        "Read which promise; the suite's test of that name shows how it is tried.",
    ),
    "E-CONNECT": Code(
        "Two ports cannot be connected, or not with these options.",
        "Other types, units or shapes, two out-ports, an unknown policy; in a program, a port that is not there.",
        "Compare the ports with aiorts inspect; aiorts check shows the FlexiFilter that would join them, if one can.",
    ),
    "E-CONTROL": Code(
        "A running kernel cannot be looked into or controlled.",
        "Its folder of sockets is not safe, another release of aiorts, or a client that is none.",
        "Read the reason in the line; both ends of the same release of aiorts understand each other.",
    ),
    "E-CONVERT": Code(
        "A value cannot be converted without changing it silently.",
        "A number out of range of the target, text that is no number.",
        "Scale the value, or choose what happens: --overflow saturate, --round floor, --nan 0.",
    ),
    "E-DAMAGED": Code(
        "Bytes of a recording are not those that were written; nothing behind the place is read.",
        "A fault of the disk, an incomplete copy or a power failure; the line names the byte.",
        "aiorts log salvage FILE NEW copies everything that is whole, and reports what is lost.",
    ),
    "E-DECLARE": Code(
        "A component class or a record type is written wrongly.",
        "A hook with other arguments, a default outside its bounds, a field that cannot travel.",
        "Correct the class and attribute that the line names.",
    ),
    "E-DENIED": Code(
        "The kernel does not allow this operation over this connection.",
        "--control=view; over a network no --allow-control; a client that may only look; a file outside of --files.",
        "Start it without --control=view, with --allow-control for other hosts, with --files DIR; make it an operator.",
    ),
    "E-EXTRA": Code(
        "A package that is needed for this is not installed.",
        "A plot or a comparison needs a package that is no dependency of aiorts.",
        "Run the pip command of the line.",
    ),
    "E-FDS": Code(
        "This process, or the whole system, has no descriptor left: it can open no file, socket, pipe or timer.",
        "A low limit (ulimit -n), a great many contexts, or code that opens files and does not close them.",
        "Raise it with ulimit -n 4096; aiorts doctor shows the limit, ls /proc/PID/fd what is open.",
    ),
    "E-FRAME": Code(
        "A frame on standard input is bad; the others go on, and the exit status is 1.",
        "The writer uses another codec, or what it wrote was cut.",
        "Give both filters the same --codec.",
    ),
    "E-GOAL-CANCELLED": Code(
        "A goal ended without a result, as its client asked.",
        "The client called cancel(), waited too long, or was deactivated, removed or disconnected.",
        "Catch GoalCancelled where the result is awaited.",
    ),
    "E-GOAL-FAILED": Code(
        "A goal ended without a result.",
        "The provider failed it, was deactivated, removed or reloaded, or did not cancel it within cancel_timeout.",
        "The line and the attribute reason say which; aiorts help goals says what a provider has to do.",
    ),
    "E-HOOK-TIMEOUT": Code(
        "A hook did not return within its deadline.",
        "It waits for something that does not come, blocks its thread, or takes longer than its context allows.",
        "Wait with a time-out inside the hook, block in a thread context only, or give a longer deadline.",
    ),
    "E-INTERFACE": Code(
        "Two service ports do not match: one requires what the other does not provide.",
        "A method is missing, or has other parameters or another result.",
        "The line names both ports and the difference; compare them with aiorts inspect.",
    ),
    "E-LINE": Code(
        "A line of standard input is no sample for the port; the other lines are processed.",
        "No JSON, another type, a value out of range; the line is named by its number.",
        'Write {"port": "input0", "data": 1.5} or the bare data; aiorts inspect TYPE shows a line.',
    ),
    "E-LOG": Code(
        "Lines of the log are lost: its file cannot be opened or written, or a handler or filter of logging raised.",
        "Another process holds the file, its disk is full, or its folder cannot be written; or the handler is faulty.",
        "The line has the cause; choose another --log-file, make room, or repair the handler.",
    ),
    "E-NAME": Code(
        "A name or path has a character or structure that is not allowed.",
        "Blanks, dots or slashes in a name, or one of more than 100 characters.",
        "Use letters, digits, '_' and '-'; a port is COMPONENT.PORT.",
    ),
    "E-NO-ANSWER": Code(
        "A running kernel gave no answer in time.",
        "Its process is stopped, or its event loop is held.",
        "Ask again with a longer --timeout; `aiorts ls` shows who does not answer.",
    ),
    "E-OPENRTM": Code(
        "A file of OpenRTM cannot be read, or not be made.",
        "It is none of those that aiorts import takes, too large or too deep, or something in it cannot be.",
        "The line names the place and what to do; aiorts help openrtm-files lists what is read.",
    ),
    "E-OUTPUT": Code(
        "Standard output could not be written; its last lines are lost.",
        "The disk is full, or the stream was closed.",
        "Make room and run again.",
    ),
    "E-PLUGIN": Code(
        "An extension cannot be found, loaded or used.",
        "A misspelt name, a package that is not installed, an import that fails.",
        "aiorts plugins lists what there is; aiorts plugins --check imports each and shows what is wrong.",
    ),
    "E-PROCESS": Code(
        "A process cannot be started, or not with the limits that were asked for.",
        "The system has no more processes or descriptors, or limits.processes needs a cgroup v2 that is not delegated.",
        "Read the reason in the line; with systemd, Delegate=yes in the unit gives it a cgroup of its own.",
    ),
    "E-READ-TIMEOUT": Code(
        "No sample arrived in time.",
        "The writer is not active, or sends more rarely than the reader waits.",
        "Look at the writer's state and connection; wait longer.",
    ),
    "E-RECORD": Code(
        "A value does not fit the field it was given for.",
        "A wrong type, a number out of range, an unknown or missing field.",
        "aiorts inspect TYPE shows the fields; the line has what was expected and got.",
    ),
    "E-RECORDING": Code(
        "A recording cannot be read, made or continued.",
        "It is no recording, exists already, another recorder writes it, or the disk is full.",
        "The line names the file and the reason; aiorts log info FILE shows what a recording holds.",
    ),
    "E-SELECT": Code(
        "A selection names an input that FlexiSelect does not have.",
        "A selector below 0, or not below the number of inputs.",
        "Correct its sender, or choose --out-of-range hold or none.",
    ),
    "E-SERVICE": Code(
        "A service call could not be made as requested.",
        "The port is bound to several providers, or to none that fits.",
        "Call one of its proxies, or connect it to one provider.",
    ),
    "E-SERVICE-CYCLE": Code(
        "Components wait for each other's answer in a circle; the call that closes it is refused.",
        "A provider calls back to a component that waits for it.",
        "Declare one of the provided interfaces with concurrent=True.",
    ),
    "E-SERVICE-FAILED": Code(
        "The provider of a service raised, or answered with a wrong type.",
        "Its own code; the line has its message.",
        "Look at the provider; it is not in error because of it.",
    ),
    "E-SERVICE-TIMEOUT": Code(
        "A service call was not answered within its deadline.",
        "The provider was busy with its own hooks, or its method takes longer.",
        "Give the call more time with within(seconds), or provide it with concurrent=True.",
    ),
    "E-SERVICE-UNAVAILABLE": Code(
        "No provider can answer a service call.",
        "The provider is absent, not active, in error or being removed, or the port is not connected.",
        "Activate or reset the provider; wait_bound() waits for a connection.",
    ),
    "E-STALE": Code(
        "A call was meant for a kernel that has ended, and another has its name now.",
        "The run was started anew between two calls.",
        "Give the command again: nothing was done.",
    ),
    "E-STATE": Code(
        "The request does not fit the state of a component, context or kernel.",
        "A component, context or kernel is used before it is added, or after it is closed.",
        "The line names both: bring it into the state it needs first.",
    ),
    "E-STOP": Code(
        "Not everything ended in time; the process ended nevertheless.",
        "A thread or a hook that cannot be cancelled was still busy 4.8 s after the stop.",
        "Look for code that blocks; give its waits a time-out.",
    ),
    "E-SYSTEM": Code(
        "A system file is wrong.",
        "It is not valid TOML, has an unknown key, or names a component, port or member that is not there.",
        "Correct the place the line names; it suggests what may have been meant.",
    ),
    "E-THREAD": Code(
        "A call came from a thread that may not make it.",
        "Code in a thread of its own uses the kernel directly.",
        "Use the port's write_from_thread(), kernel.call_from_thread(), or a ThreadContext's blocking calls.",
    ),
    "E-TOO-LARGE": Code(
        "A frame is larger than its limits allow.",
        "An array or text beyond the limits, or bytes that are no frame.",
        "Send less at once, or give the codec other limits.",
    ),
    "E-TRANSITION": Code(
        "A lifecycle request did not take effect in time.",
        "A hook of the component is still running; or what its start waits for (start.after) did not come about.",
        "Look at what the hook waits for, and whether the components it waits for are active; give a longer time-out.",
    ),
    "E-TYPE": Code(
        "A value of the wrong type or shape was written to a port; nothing was sent.",
        "The port was declared for another record, or its shape has another length.",
        "Write the record that aiorts inspect shows for the port.",
    ),
    "E-UNKNOWN-TYPE": Code(
        "No record type or component has this name, or more than one has.",
        "A misspelt name, or a module of types that is not imported.",
        "aiorts types and aiorts plugins list them; --type-mod MODULE imports yours.",
    ),
    "E-UNREAD": Code(
        "The system ended while samples were left unread; the exit status is 1.",
        "A reader took none for a second: it is inactive or waits for another input. Or the time is over of W-UNREAD.",
        "Look at the reader that the line names.",
    ),
    "E-USAGE": Code(
        "The command line is wrong; nothing was run.",
        "An unknown command or option, a value missing or out of range, an option given twice.",
        "aiorts COMMAND --help shows what it takes.",
    ),
    "E-WIRE": Code(
        "Bytes are not a valid frame.",
        "The sender is not aiorts, or is another version of it.",
        "Look at the sender.",
    ),
    "E-LINK": Code(
        "Another kernel cannot be reached, or does not say what was expected.",
        "It has ended, has the name of this one, or is of another release of aiorts.",
        "Read the reason in the line; aiorts ls shows what runs.",
    ),
    "E-LINK-TIMEOUT": Code(
        "Another kernel has not answered in time.",
        "It is stopped, or its event loop is busy.",
        "Look at the kernel that the line names; the link is offered again by itself.",
    ),
    "W-ISOLATION": Code(
        "Components that were to have processes of their own run in this one.",
        "The clock is simulated: virtual time passes in one process.",
        "Leave --simulate out where the processes matter.",
    ),
    "W-LINK": Code(
        "A link to another kernel waits, was lost, or was ended by the other end.",
        "The other kernel or component is not there, or its user has disconnected it.",
        "Start the other kernel: the link goes on by itself; on_link_lost says what happens otherwise.",
    ),
    "E-WRITE-TIMEOUT": Code(
        "Readers with full = block had no room in time; the others have the sample.",
        "A reader is slower than the writer, or has stopped.",
        "Look at the reader that the line names; choose a longer timeout, or another policy.",
    ),
    "N-LINK": Code(
        "A port of a connection is in another kernel: a note of aiorts check.",
        "Its path begins with the name of a kernel.",
        "Ignore the note; aiorts run says when the other kernel refuses the connection.",
    ),
    "N-ADAPT": Code(
        "A FlexiFilter is put between two ports that do not fit: a note of aiorts check.",
        "Their connection says adapt = true, and there is one way to make samples of one those of the other.",
        "Ignore the note, or put a FlexiFilter of your own between them, which does it another way.",
    ),
    "N-OPERATOR": Code(
        "A component says what it does without its operator: aiorts check notes it.",
        "Its class, or the file, says `on_link_lost`, for a client that was killed or a network that was cut.",
        "Ignore the note.",
    ),
    "N-CIRCLE": Code(
        "Components that run on events wait for one another in a circle, and none begins: a note of aiorts check.",
        "No sample comes from outside, none has every or a rate, and on_activated writes nothing, or writes too early.",
        "Write the first sample in on_activated, with keep_last = true at its connection; or give one of them a rate.",
    ),
    "N-COPY": Code(
        "A port's type is mutable: aiorts check notes that each write makes a snapshot.",
        "The dataclass is not frozen.",
        "Write @dataclass(frozen=True), or @record.",
    ),
    "N-LIMITS": Code(
        "Samples of a port may be larger than a recording or a link takes: a note of aiorts check.",
        "Its type has a text, a list or a map of any length.",
        "Where they are short, ignore the note. A sample that is too large is left out, counted and reported.",
    ),
    "N-OPEN": Code(
        "A port has no connection: a note of aiorts check.",
        "Nothing in the system file names it.",
        "Connect it, or ignore the note.",
    ),
    "N-PORTS": Code(
        "The ports of a component are known only when it runs: a note of aiorts check.",
        "Its on_initialize adds ports, and no hook runs while a file is checked; or it has members in other kernels.",
        "Add them in a method make_ports that on_initialize calls; of members in other kernels ignore the note.",
    ),
    "N-VARIABLE": Code(
        "A variable of a system file is in no text of it.",
        "It is misspelt here or where it is meant, or no longer needed.",
        'Write "${name}" where it is meant, or remove it.',
    ),
    "W-BLOCK": Code(
        "A writer may wait forever, for a reader that runs only after it or waits for it.",
        "full = block without a time-out, and a buffer shorter than what one cycle writes; or length = 0 both ways.",
        "Make the buffer longer, set a timeout, or put the reader into another context.",
    ),
    "W-DROPPED": Code(
        "A connection that should deliver every sample did not, or, as aiorts check finds, cannot.",
        "The reader takes only the newest (.latest), is slower than the writer, or ended before it had read them.",
        f"{SLOW_READER.capitalize()}.",
    ),
    "W-EMPTY": Code(
        "The system file has no components: there is nothing to run.",
        "The file is unfinished, or its tables have other names.",
        "Write [components.NAME] with a type.",
    ),
    "W-EXPORT": Code(
        "A composite of a system file exports a pattern that no port of a member fits.",
        "A misspelt component or port, or a port that was renamed.",
        "Correct the pattern, or remove it.",
    ),
    "W-INACTIVE": Code(
        "A sample was dropped because its reader was not active yet, and none came through soon; said once in a run.",
        "It was written while the system started: in on_activated, or before the reader's context ran.",
        'Connect with keep_last = true, or start the writer later: start.after = "READER active".',
    ),
    "W-LOOP": Code(
        "Components that all run on events feed each other in a circle and never rest.",
        "Each writes whenever it reads, no context of the circle has a rate, and no on_execute awaits a sleep.",
        "Put one of them into a periodic context, or await self.kernel.sleep there: either paces the rest.",
    ),
    "W-UNFED": Code(
        "A component waits for data that cannot come: a component alone has no connection, or it pulls all it reads.",
        "aiorts run feeds a component alone from standard input where that is a pipe or file; a pull wakes no reader.",
        "Alone: pipe JSON lines into it, or run it with --rate. In a system: a context with every or a rate.",
    ),
    "W-UNREAD": Code(
        "A run goes on after its sources have ended, or the recording that it replays has, for readers that are slow.",
        "The line has the connectors, each with the number of samples that their readers have not read yet.",
        "Wait, end it with Ctrl-C, or let the reader be faster. Of a replay the line says how long it goes on at most.",
    ),
    "W-OPTION": Code(
        "A connection has an option that does nothing.",
        "It is misspelt, belongs to another middleware, or another option makes it meaningless.",
        "Write it as the message shows, or remove it.",
    ),
    "W-RULES": Code(
        "A rule of the system file has not connected ports that fit it.",
        "It has as many connectors as its max lets it make, or the two ports do not go together.",
        "Raise max, make the pattern narrower, or correct the ports as the message says.",
    ),
    "W-FILE": Code(
        "A parameter is a path, and its class does not say what the component does with the file.",
        "It counts as a file that is written: clients that lack the right 'code' may name only files below --files.",
        'Declare it with Param(..., file="read"), or file="write".',
    ),
    "W-LATE": Code(
        "Cycles of a context that runs were not done when the next was due: a warning of aiorts check.",
        "A hook takes too long, or other code holds up the event loop.",
        "See aiorts help missed-deadline; `aiorts cat -l CONTEXT` says who is to blame.",
    ),
    "W-SILENT": Code(
        "A writer has written nothing for longer than max_gap: a warning of aiorts check about what runs.",
        "It waits, has failed, or is not active.",
        "Look at it with `aiorts cat`.",
    ),
    "W-START": Code(
        "The time of --for was over before everything was started.",
        "What a component's start waits for (start.after, start.wait) takes longer.",
        "Give --for more seconds, or look at why those named first are not active.",
    ),
    "W-TRANSPORT": Code(
        "A connection has options that are about OpenRTM's transports and do nothing here.",
        "It comes from a file of OpenRTM's tools: interface_type, marshaling_type, an empty policy.",
        "Leave them for those tools, or remove them; each is reported once.",
    ),
    "W-TURNED": Code(
        "A connection of a system file names the in-port first.",
        "The values of from and to were exchanged.",
        "Write the out-port under from.",
    ),
    "W-UNUSED": Code(
        "A component of a system file is in no context and never runs.",
        "No context names it among its members.",
        "Name it among the members of a context, or remove it.",
    ),
}
