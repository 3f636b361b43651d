"""peltier replay RUN [--config OTHER.toml]: the law again over a recorded run.

The run's readings go into its law once more, and every command is compared bit for bit with the one that was sent.
They are the same for the version that made the run; for another one it is said which, and bits may differ.
A user-defined law (docs/own_law.md) is the file that the run folder keeps of it.
With --config, another configuration runs on the run's twin instead: a simulated rig with the film, plate and effects of
the run's model.toml.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from rig.command.record_arguments import add_json_argument, writable_file
from rig.command.terminal import Terminal, to_stderr


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=Path, metavar="RUN", help="the folder of a run")
    parser.add_argument("--config", type=Path, metavar="OTHER.toml", help="another configuration, on the run's twin")
    parser.add_argument("--out", type=Path, metavar="RECORD.csv", help="with --config: its record")
    add_json_argument(parser)


def main(options: argparse.Namespace) -> int:
    from rig.experiment.replay import replay_run

    terminal = Terminal(options.json)
    if options.config is not None:
        return _twin(options, terminal)
    replay = replay_run(options.run)
    same = replay.compared - replay.different
    terminal.print(f"{same} of {replay.compared} commands are the same, bit for bit")
    for name, (then, now) in replay.other_versions.items():
        terminal.print(f"the run was made with {name} {then}, this is {now}: bits may differ")
    if replay.different:
        terminal.print(f"largest difference {replay.largest:.3g}, the first at {replay.first_different_s:g} s")
    terminal.write_json({"format": "peltier-replay/1", "run": options.run, **replay.__dict__})
    return 0 if replay.different == 0 else 1


def _twin(options: argparse.Namespace, terminal: Terminal) -> int:
    from rig.analysis.error import target_error
    from rig.experiment.replay import twin_configuration
    from rig.experiment.simulation import simulate
    from rig.records.record_file import write_columns

    if options.out is not None:
        writable_file(options.out)
    file = twin_configuration(options.run, options.config)
    with terminal.progress(virtual=True) as progress:
        simulated = simulate(file, to_stderr, progress)
    if options.out is not None:
        write_columns(options.out, simulated.columns)
        terminal.print(f"record: {options.out}, {simulated.rows} rows")
    found = target_error(simulated)
    error = found.document() if found is not None else {}
    for name, value in error.items():
        terminal.print(f"{name}: {value:.4g}")
    terminal.write_json({"format": "peltier-replay/1", "run": options.run, "configuration": options.config, **error})
    if simulated.ended is not None:
        raise simulated.ended
    return 0
