"""peltier simulate CONFIG [--effect NAME[:param=value,...]]... --out RECORD.csv: simulate the experiment.

The configured experiment runs on simulated instruments in virtual time, whatever its ports are; a current_profile runs
without instruments, so that its rows are exact. Effects of --effect are added to those of the configuration; a
parameter that is left out takes the geometric mean of its typical sizes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from rig.command.record_arguments import add_effect_file_argument, add_json_argument, writable_file
from rig.command.terminal import Terminal, to_stderr


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, metavar="CONFIG")
    parser.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME[:param=value,...]",
        help="switch an effect of the catalogue on, as in film_lag:tau_s=3 (repeatable)",
    )
    add_effect_file_argument(parser, ", to be switched on by --effect")
    parser.add_argument("--seed", type=int, metavar="N", help="seed of the noise; default: as configured")
    parser.add_argument("--out", type=Path, required=True, metavar="RECORD.csv")
    add_json_argument(parser)


def main(options: argparse.Namespace) -> int:
    from rig.experiment.simulation import read_simulation, simulate
    from rig.records.record_file import write_columns

    writable_file(options.out)
    terminal = Terminal(options.json)
    file = read_simulation(options.config, options.effect, options.effect_file, options.seed)

    with terminal.progress(virtual=True) as progress:
        simulated = simulate(file, to_stderr, progress)
    write_columns(options.out, simulated.columns)
    for effect in simulated.effects:
        parameters = ", ".join(f"{name} = {value:g}" for name, value in effect.values().items())
        terminal.print(f"{effect.name}: {parameters}")
    terminal.print(f"record: {options.out}, {simulated.rows} rows")
    terminal.write_json(
        {
            "format": "peltier-simulation/1",
            "record": options.out,
            "rows": simulated.rows,
            "seed": file.content.simulation.seed,
            "effects": [{"name": e.name, "parameters": e.values()} for e in simulated.effects],
        }
    )
    if simulated.ended is not None:
        raise simulated.ended
    return 0
