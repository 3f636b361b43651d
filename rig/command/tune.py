"""peltier tune CONFIG: gains from the plate model, and the margins of the whole law with them.

The whole law is estimator, resistance feedback through the inverse, temperature PID, delays, plate and film; the film's
slope is taken as 0.6 to 2.2 times the model's. Gains with too small margins are refused (exit status 1), with a line
on what to lower.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rig.command.record_arguments import add_json_argument, writable_folder
from rig.command.terminal import Terminal
from rig.core.faults import fault

if TYPE_CHECKING:
    from compensator.control.design import Design
    from rig.experiment.tuning import OwnTuning, WholeLaw


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path)
    parser.add_argument(
        "--output-age", type=float, metavar="S", help="how long before the thermometer the ohmmeter is read"
    )
    parser.add_argument("--acts-after", type=float, metavar="S", help="how long after a reading its command acts")
    parser.add_argument("--report", type=Path, metavar="DIR", help="report.html, figures and tuning.json there")
    add_json_argument(parser)


def main(options: argparse.Namespace) -> int:
    from rig.config.configuration import read_configuration
    from rig.config.model_file import read_model
    from rig.experiment.tracking import design_document, law_and_design, timing_of
    from rig.experiment.tuning import law_table, own_table, own_tuning, tuned_law
    from rig.records.film_output import column_of, in_decades, unit_of

    if options.report is not None:
        writable_folder(options.report)
    terminal = Terminal(options.json)
    file = read_configuration(options.config)
    configuration = file.content
    if configuration.experiment.model is None:
        raise fault(
            options.config,
            "experiment.model",
            "missing; expected a model file with [plate] and [film], as `peltier calibrate` writes",
        )
    model = read_model(file.beside(configuration.experiment.model), needs=("plate", "film"))
    assert model.film is not None
    assert model.plate is not None
    for flag, value in (("--output-age", options.output_age), ("--acts-after", options.acts_after)):
        if value is not None and not 0.0 <= value <= configuration.experiment.period_s:
            raise fault("the command line", flag, f"{value:g} s: expected 0 to a period")
    timing = timing_of(configuration, options.output_age, options.acts_after)
    own = own_tuning(configuration, model.film, model.plate)
    chosen = configuration.experiment.law
    name = chosen if chosen == "instrument_pid" else "full"
    found, design = tuned_law(configuration, model, name, timing)
    _, by_output = law_and_design("pid", configuration, model.film, model.plate)
    if name == "full":
        _print_gains(terminal, "full: PID on temperature, output in K/s", design, ("1/s", "1/s^2"))
    _print_margins(terminal, found)
    unit = "A" if model.plate.kind == "peltier" else "of full drive"
    output = model.film.output
    what, per = "log R" if in_decades(output) else column_of(output), unit_of(output)
    _print_gains(
        terminal, f"pid: PID on {what} alone, output in {unit}", by_output, (f"{unit}/{per}", f"{unit}/({per} s)")
    )
    _print_own_pid(terminal, own, configuration.bench.controller.driver)
    result = {
        "format": "peltier-tuning/2",
        name: {**design_document(design), "whole_law": law_table(found)},
        "pid": design_document(by_output),
        "instrument_pid_gains": own_table(own),
        "refused": found.refused,
    }
    if options.report is not None:
        from rig.report.tuning import write_tuning_report

        options.report.mkdir(exist_ok=True)
        write_tuning_report(options.report, options.config.name, result, found)
        terminal.print(f"report: {options.report / 'report.html'}")
    terminal.write_json(result)
    for line in found.refused:
        print(f"{options.config}: refused: {line}", file=sys.stderr)
    return 1 if found.refused else 0


def _print_gains(terminal: Terminal, title: str, design: Design, units: tuple[str, str]) -> None:
    """Print gains and margins of a PID alone. units: of Kp and Ki."""
    gains, margins = design.gains, design.margins
    terminal.print(f"{title}, period {design.period_s:g} s, dead time {design.dead_time_s:g} s")
    k_p, k_i = f"Kp {gains.kp:.5g} {units[0]}", f"Ki {gains.ki:.5g} {units[1]}"
    terminal.print(f"  {k_p}   {k_i}   tracking time {gains.tracking_time_s:.3g} s   b {gains.b:g}")
    terminal.print(
        f"  this loop alone: gain margin {margins.gain_margin:.2f}   phase margin {margins.phase_margin_deg:.1f} deg   "
        f"Ms {margins.ms:.3f}   crossover {margins.crossover_rad_per_s:.3g} rad/s"
    )


def _print_margins(terminal: Terminal, found: WholeLaw) -> None:
    t = found.timing
    terminal.print(
        f"{found.name}: the whole law (estimator, resistance through the inverse, temperature, delays, plate, film),\n"
        "  the smallest margins over heating and cooling branch"
    )
    terminal.print(
        f"  one reading of the ohmmeter corrects at most {found.most_share:.2f} of its error;\n"
        f"  it is read {1e3 * t.output_age_s:.0f} ms before the thermometer, "
        f"a command acts {1e3 * t.acts_after_s:.0f} ms after it"
        + (f" and {1e3 * t.late_s:.0f} ms that no stamp shows" if t.late_s else "")
    )
    terminal.print("  film's slope over   gain    phase margin   Ms of      Ms, at        Ms, at     disk margin")
    terminal.print("  the model's         margin  deg            the law    thermometer   ohmmeter   gain x, phase deg")
    for row in found.rows:
        m = row.margins
        if not m.stable:
            terminal.print(f"  {row.ratio:<19g} unstable ({row.way}, {row.degC:.1f} degC)")
            continue
        terminal.print(
            f"  {row.ratio:<19g} {m.gain_margin:<7.2f} {m.phase_margin_deg:<14.0f} {m.ms:<10.2f} "
            f"{_or_dash(m.at_thermometer):<13} {m.at_ohmmeter:<10.2f} {m.disk_gain:.2f}, {m.disk_phase_deg:.0f}"
        )
    terminal.print(
        f"  unstable with a film {_times(found.rings_at_ratio)} as steep as the model's, "
        f"or a plate whose gain is {_times(found.rings_at_gain)} the model's"
    )
    rest = found.rest
    terminal.print(
        f"  film at rest, within the band where the resistance is not fed back: gain margin {rest.gain_margin:.2f}, "
        f"Ms {rest.ms:.2f}"
    )


def _or_dash(value: float) -> str:
    return "-" if value != value else f"{value:.2f}"


def _times(ratio: float) -> str:
    return "more than 100 times" if ratio == float("inf") else f"{ratio:.2f} times"


def _print_own_pid(terminal: Terminal, own: OwnTuning, driver: str) -> None:
    pid, margins = own.pid, own.design.margins
    terminal.print(
        f"the controller's own PID (law instrument_pid): Kp {pid.kp_A_per_K:.4g} A/K, Ti {pid.ti_s:.3g} s, "
        f"Td {pid.td_s:.3g} s; Ms {margins.ms:.2f}"
    )
    if own.fields is None:
        terminal.print(f"  {driver}: the program does not know its fields")
        return
    listed = ", ".join(f"{field.option} = {field.value:g}" for field in own.fields)
    terminal.print(f"  [bench.controller] options = {{ {listed} }}")
    for command in dict.fromkeys(field.command for field in own.fields):
        terminal.print(f"  or at the instrument: {command}")
