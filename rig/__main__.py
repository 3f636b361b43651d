"""The command line: `peltier VERB ...`. A verb's module is imported only when it is called.

`off` and `stop` come through here, with an output to switch off: only what they need is imported at the top, here and
in what they import (rig.command.bench, rig.daemon.client, rig.core).
"""

from __future__ import annotations

import argparse
import importlib
import io
import os
import signal
import sys

from rig.core.faults import Faults
from rig.core.standard_streams import open_standard_streams, outlive_readers

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from typing import Any, NoReturn

# file of rig.command -> its verbs, each a function with its options in VERB_arguments -> what it does, for the overview
FILES = {
    "experiments": {
        "run": "run an experiment",
        "calibrate": "measure a film and its plate, and write their model",
        "simulate": "run the experiment on the simulated rig, with any effects",
        "improve": "diagnose a run, extend its model, run again, and compare",
        "replay": "run the law again over a recorded run, or another configuration on its twin",
        "report": "draw the report of a run folder, also of a run that ended early",
        "tune": "compute PID gains from the plate model, and the law's margins",
    },
    "records": {
        "identify": "fit film and plate models to records",
        "predict": "compare a model with a record that it was not fitted to",
        "invert": "compute temperatures for a wanted resistance",
        "diagnose": "find what the simulation of the rig gets wrong, and why",
    },
    "many": {
        "sweep": "run many simulated experiments, and tabulate the results",
        "trend": "find which effects the runs in a folder show, and since when",
    },
    "instruments": {
        "ports": "list the attached instruments",
        "check": "ask the instruments: do they answer, do they match the configuration",
        "emulate": "put simulated instruments on pseudo-terminals",
    },
    "servers": {
        "serve": "run the bench daemon: queue, history, page",
        "epics": "run an EPICS server beside the daemon",
        "overview": "serve one page for several daemons, with a STOP for each",
    },
    "bench": {
        "status": "show what the daemon's bench is doing",
        "watch": "show the same as a live table",
        "stop": "switch the output off, end the running job, empty the queue",
        "off": "switch the output off, with or without a daemon",
        "reset": "clear a latched trip or stop, with a reason",
    },
    "setup": {
        "init": "write commented configurations to start from",
        "precompile": "compile now what would be compiled at the first use",
    },
}
VERBS = {verb: file for file, verbs in FILES.items() for verb in verbs}
SWITCH_OFF = ("stop", "off")  # whatever stands in their way, the output is not confirmed off
MENDS = " To mend it, delete .venv and type `./peltier --help` (no checkout: install peltier-rig again)."
ON_A_CLOCK = ("run", "calibrate", "improve", "serve")
LONGEST_NAME = 12  # words that are tried as one name: a list of a thousand records is not a million looks
WRITTEN = ("out", "json", "report")
DOCUMENT = "run.json"  # a folder with it is a run's
# What a run's folder has from its run (rig/records/run_folder.py): measured once, or said of what was. A file of
# another name with these is the user's, and may be written again.
OF_A_RUN = frozenset(
    (DOCUMENT, "record.csv", "record.nc", "events.jsonl", "config.toml", "target.csv", "learned.csv", "predicted.csv")
) | {"model.toml", "MODEL.toml", "report.html"}


def overview() -> str:
    """Return the list of verbs."""
    lines = ["usage: peltier VERB ...        (peltier VERB --help: its options)", ""]
    lines += [f"  {verb:<10} {text}" for verbs in FILES.values() for verb, text in verbs.items()]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Run a verb; the return value is the exit status (docs/command_line.md)."""
    own_process = arguments is None  # a caller inside Python keeps its streams, and is not ours to double
    if own_process:
        open_standard_streams()
    words = sys.argv[1:] if arguments is None else arguments
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a file's name may be no text, as stderr knows already
    if not words or words[0] in ("-h", "--help", "help"):
        try:
            print(overview(), flush=True)
        except BrokenPipeError:  # its reader has gone, as in `| head`; what is still in the buffer goes nowhere
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0 if words else 2
    if words[0] == "--version":
        from rig.version import __version__

        print(__version__)
        return 0
    verb = words[0]
    if verb in ON_A_CLOCK and own_process:
        outlive_readers()
    if verb not in VERBS:
        import difflib

        near = difflib.get_close_matches(verb, VERBS, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else "."
        print(f"peltier: {verb!r} is no verb{hint} There are: {', '.join(VERBS)}", file=sys.stderr)
        return 2
    # small matrices: threads cost more than they give, and wait for each other, for seconds on a busy computer
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    status = _exit_status(lambda: _act(verb, words[1:], own_process), verb, own_process)
    for name in _split_names(words[1:]) if status == 2 else ():
        print(f"peltier {verb}: a name with spaces needs quotation marks: {name!r}", file=sys.stderr)
    return status


def _split_names(words: list[str]) -> list[str]:
    """Return names of files that a shell has split into several words: they exist, their first words alone do not."""
    found = []
    for first, word in enumerate(words):
        if not word.startswith("-") and not os.path.exists(word):
            names = [" ".join(words[first:end]) for end in range(first + 2, first + LONGEST_NAME + 1)]
            found += [name for name in dict.fromkeys(names) if os.path.exists(name)][:1]
    return found


class _OneLine(argparse.ArgumentParser):
    """A parser that says in one line what is wrong with the words; --help has the rest."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message.removeprefix('argument ')} ({self.prog} --help: its options)\n")

    def format_help(self) -> str:
        import inspect  # not needed by `off`, and as long to load as all that is

        self.description = inspect.cleandoc(self.description or "")
        self.formatter_class = argparse.RawDescriptionHelpFormatter
        return super().format_help()


def _act(verb: str, words: list[str], own_process: bool) -> int:
    """Read the words and do what they say. Importing is part of it: Ctrl-C comes then, too."""
    module = importlib.import_module(f"rig.command.{VERBS[verb]}")
    act = getattr(module, verb)
    # each option is tried with a formatter as it is added; one that asks for the terminal's width loads six modules
    plain = lambda prog: argparse.HelpFormatter(prog, width=80)  # noqa: E731
    parser = _OneLine(prog=f"peltier {verb}", description=act.__doc__, formatter_class=plain)
    getattr(module, f"{verb}_arguments")(parser)
    try:
        options = parser.parse_args(words)
    except SystemExit as stop:
        return int(stop.code or 0)
    options.own_process = own_process
    _refuse_overwriting(options)
    return int(act(options))


def _refuse_overwriting(options: argparse.Namespace) -> None:
    """Raise Faults if a file to be written is one of those to be read, or a run's, or is named twice: a record that was
    measured once is not replaced."""
    given = vars(options)
    named = {name: given[name] for name in WRITTEN if given.get(name) not in (None, "-", "")}
    if not named:
        return
    from pathlib import Path

    written = {name: Path(path) for name, path in named.items()}
    read = [path for name, value in given.items() if name not in WRITTEN for path in _files(value)]
    faults = [
        f"{path}: --{name}: is what is read; expected another file"
        for name, path in written.items()
        if os.path.isfile(path) and any(path.samefile(other) for other in read)
    ]
    faults += [
        f"{path}: --{name}: belongs to the run in {path.parent}; expected another file"
        for name, path in written.items()
        if path.name in OF_A_RUN and os.path.isfile(path) and os.path.isfile(path.parent / DOCUMENT)
    ]
    if "report" in written and os.path.isfile(written["report"] / DOCUMENT):
        faults.append(f"{written['report']}: --report: is a run's folder; expected another, such as one inside it")
    if "out" in written and written.get("json") == written["out"]:
        faults.append(f"{written['out']}: --out and --json: the same file; expected two")
    if faults:
        raise Faults(faults)


def _files(value: Any) -> Iterator[str | os.PathLike[str]]:
    """Yield the files that exist among an option's values."""
    for one in value if isinstance(value, (list, tuple)) else [value]:
        if isinstance(one, (str, os.PathLike)) and os.path.isfile(one):
            yield one


def _exit_status(action: Callable[[], int], verb: str, own_process: bool = False) -> int:
    """Run the action; turn what it raises into a line on stderr and an exit status. own_process: it ends then."""
    try:
        return _act_and_report(action, verb)
    except KeyboardInterrupt as error:  # before or after the time in which signals mean `Stopped`
        if own_process:  # a terminal's Ctrl-C comes twice: to the group, and from the guard
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        if verb in SWITCH_OFF:
            text = "OUTPUT NOT CONFIRMED OFF: stopped by SIGINT before an answer. Type it again, or switch off by hand."
            print(f"peltier {verb}: {text}", file=sys.stderr)
            return 11
        print(f"peltier {verb}: stopped by SIGINT{_notes(error)}", file=sys.stderr)
        return 130


def _act_and_report(action: Callable[[], int], verb: str) -> int:
    from rig.core.errors import RigError
    from rig.core.outcome import NotConfirmedOff, Outcome

    try:
        return int(action())
    except Faults as faults:
        for line in faults.lines:
            print(line, file=sys.stderr)
        return 2
    except NotConfirmedOff as outcome:
        text = f"OUTPUT NOT CONFIRMED OFF: {outcome}. Switch the controller off by hand."
        for line in (text, *_notes_of(outcome)):
            print(f"peltier {verb}: {line}", file=sys.stderr)
        return outcome.exit_status
    except (Outcome, RigError) as error:
        print(f"peltier {verb}: {error}{_notes(error)}", file=sys.stderr)
        return int(getattr(error, "exit_status", 1))
    except BrokenPipeError:  # whoever read our output has gone; nothing is left to tell them
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        missing = isinstance(error, ImportError)  # such as in a set-up that was interrupted
        mends = MENDS if missing else ""
        text = f"the installation is not whole ({error})" if missing else str(error)
        if verb in SWITCH_OFF:
            hand = f"OUTPUT NOT CONFIRMED OFF: {text}{_notes(error)}. Switch the controller off by hand.{mends}"
            print(f"peltier {verb}: {hand}", file=sys.stderr)
            return NotConfirmedOff.exit_status
        if not isinstance(error, OSError | ImportError):
            raise
        print(f"peltier {verb}: {text}{_notes(error)}{'.' + mends if missing else ''}", file=sys.stderr)
        return 1


def _notes(error: BaseException) -> str:
    """Return the notes of an error as the end of a line."""
    return "".join(f"; {note}" for note in _notes_of(error))


def _notes_of(error: BaseException) -> list[str]:
    """Return the notes that were added to an error: first what became of the output, then where a report is."""
    from rig.core.outcome import OfOutput

    return sorted(dict.fromkeys(getattr(error, "__notes__", [])), key=lambda note: not isinstance(note, OfOutput))


if __name__ == "__main__":
    sys.exit(main())
