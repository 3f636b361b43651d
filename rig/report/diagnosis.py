"""The report page of a diagnosis: verdict, effects, errors, residuals, warnings, upper limits."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rig.core.file_writing import write_text
from rig.records.run_folder import plain_json
from rig.report.batch import CANDIDATE
from rig.report.diagnosis_figures import course_figure, gain_figure, loop_figure, residual_figures, scaled
from rig.report.diagnosis_words import (
    NOT_FIXED,
    assumed_lines,
    by_gain,
    channels_of,
    film_words,
    held_out_lines,
    judged_channels,
    left_over,
    limit_rows,
    not_named,
    number,
    parameters,
    record_lines,
    room_line,
    sentence,
    split_unit,
    together,
    warning_line,
)
from rig.report.page import bullets, paragraph, section, table, tiles, write_page

if TYPE_CHECKING:
    from sim.diagnosis.result import Diagnosis

RUNNERS_UP = 6  # rows of a table that is read at a glance


def write_diagnosis_report(folder: Path, diagnosis: Diagnosis) -> None:
    """report.html and diagnosis.json in a folder that is there, with its models."""
    write_text(folder / "diagnosis.json", plain_json(diagnosis.document()) + "\n")
    residual = residual_figures(folder, diagnosis)
    parts = [
        *_records(diagnosis),
        tiles(_numbers(diagnosis)),
        *_first(folder, diagnosis),
        section("Effects", _effects(diagnosis), *_assumed(diagnosis), *_changes(diagnosis)),
        *_not_named(diagnosis, (folder / CANDIDATE).is_file()),
        section("Errors on held-out rows", gain_figure(folder, diagnosis)),
        section("Residual, warnings, and what to do next", *_left(diagnosis)),
        section("Residuals", *residual),
    ]
    parts += _plate(diagnosis)
    parts += _limits(diagnosis)
    parts.append(section("Other sets of effects", *_runners_up(diagnosis)))
    write_page(folder / "report.html", f"Diagnosis of {together(diagnosis)}", sentence(diagnosis), parts)


def _first(folder: Path, diagnosis: Diagnosis) -> list[str]:
    """Figures of the record and the models: the temperature over time, the loop."""
    figures = [course_figure(folder, diagnosis)] if diagnosis.plate is not None else []
    if diagnosis.record.output is not None:
        figures.append(loop_figure(folder, diagnosis))
    return [section("Measured and modelled", *figures)] if figures else []


def _records(diagnosis: Diagnosis) -> list[str]:
    """What was diagnosed, and what was held out."""
    parts = [paragraph(f"{line}.", "note") for line in record_lines(diagnosis)]
    if held := held_out_lines(diagnosis):
        parts += [paragraph("Held-out records, and the errors there:", "note"), bullets(held)]
    return parts


def _numbers(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    found = [(diagnosis.verdict.replace("_", " "), "verdict")]
    for what, unit, channel in judged_channels(diagnosis):
        scale, prefix = scaled(channel.rmse_base, unit)
        before, after = scale * channel.rmse_base, scale * channel.rmse_extended
        arrow = f"{before:.3g} \N{RIGHTWARDS ARROW} {after:.3g} {prefix}{unit}"
        if not diagnosis.findings:
            arrow = f"{after:.3g} {prefix}{unit}"
        found.append((arrow, f"RMS error of {what} in held-out rows; noise {scale * channel.noise:.3g} {prefix}{unit}"))
    if diagnosis.film is not None:
        kind, _, form = film_words(diagnosis.film).partition(", ")
        found.append((kind, form))
    return found


def _effects(diagnosis: Diagnosis) -> str:
    """The table of effects."""
    if not diagnosis.findings:
        return paragraph("None is named.")
    head = ["effect", "parameters (95 % interval)", "evidence", "false alarms", "error without it", "or instead of it"]
    rows = []
    for f in by_gain(diagnosis):
        values = parameters(f, ";\n")
        gains = [
            f"{channels_of(diagnosis)[key][0]} \N{MULTIPLICATION SIGN} {g.rmse_before / max(g.rmse_after, 1e-300):.3g}"
            for key, g in f.gain.items()
        ]
        other = ", ".join(f.indistinguishable_from) or "\N{EN DASH}"
        gained = ", ".join(gains) or "\N{EN DASH}"
        rows.append([f.name, values, f"{f.evidence:,.0f}", f"{f.false_alarm:.2g}", gained, other])
    return table(head, rows)


def _assumed(diagnosis: Diagnosis) -> list[str]:
    """The effects that --assume gave."""
    lines = assumed_lines(diagnosis)
    return [paragraph("Assumed to be there, in the base model too:"), bullets(lines)] if lines else []


def _not_named(diagnosis: Diagnosis, as_model: bool) -> list[str]:
    """A section on candidates, if there are any. as_model: whether the first was written as a model."""
    if not diagnosis.candidates:
        return []
    note = "These sets were chosen for their errors here, and may do worse on another record: check with --holdout. "
    if as_model:
        note += f"The model with the first of them is {CANDIDATE}."
    else:
        note += "Written as a model file, none of them predicts these rows better than the named effects."
    return [section("Candidates that are not named", bullets(not_named(diagnosis)), paragraph(note, "note"))]


def _limits(diagnosis: Diagnosis) -> list[str]:
    """A section with the upper limits."""
    rows = [list(row) for row in limit_rows(diagnosis)]
    if not rows:
        return []
    head = ["effect", "size that this record allows (95 %)", "typical range"]
    note = "A larger effect would have been seen. Leakage and heat sink are larger effects if their value is smaller."
    return [section("Upper limits of effects that are not named", table(head, rows), paragraph(note, "note"))]


def _plate(diagnosis: Diagnosis) -> list[str]:
    """A section for a record with a current."""
    plate = diagnosis.plate
    if plate is None:
        return []
    rows = []
    for name, (value, ci) in plate.parameters.items():
        width = 0.0 if ci is None else ci[1] - ci[0]
        interval = NOT_FIXED if ci is None else f"{number(ci[0], width)} to {number(ci[1], width)}"
        what, unit = split_unit(name)
        rows.append([f"{what} / {unit}" if unit else what, number(value, width), interval])
    rooms = [paragraph(f"Each record's room: {line}.", "note") for line in room_line(diagnosis)]
    doubts = [paragraph("Doubtful:"), bullets(plate.doubts)] if plate.doubts else []
    return [section(f"The plate ({plate.kind})", table(["parameter", "value", "95 % interval"], rows), *rooms, *doubts)]


def _changes(diagnosis: Diagnosis) -> list[str]:
    """A description of each effect, and what the columns mean."""
    known = diagnosis.search.known
    found = [known[f.name] for f in diagnosis.findings if f.name in known]
    words = [f"{effect.name} ({effect.link}): {effect.changes}." for effect in found]
    if not words:
        return []
    return [
        bullets(words),
        paragraph(
            "Evidence: the fall of the log-likelihood if the effect is removed and everything else is fitted again. "
            "Error without it: RMS error in held-out rows, relative to the extended model's.",
            "note",
        ),
    ]


def _left(diagnosis: Diagnosis) -> list[str]:
    left = left_over(diagnosis)
    parts = [bullets(f"Residual structure, {text}" for text in left)] if left else [paragraph("The residual is noise.")]
    warnings = [f"Warning, {w.code.replace('_', ' ')}: {warning_line(diagnosis, w)}" for w in diagnosis.warnings]
    if warnings:
        parts.append(bullets(warnings))
    if diagnosis.next_experiment:
        parts += [paragraph("Next:"), bullets(diagnosis.next_experiment)]
    return parts


def _runners_up(diagnosis: Diagnosis) -> list[str]:
    """A table of the other sets that were fitted, the likeliest first."""
    search, names = diagnosis.search, frozenset(e.name for e in diagnosis.fit.effects)
    best = search.value(diagnosis.fit)
    behind = [(best - search.value(fit), key) for key, fit in search.table.items() if key != names]
    if not behind:
        return [paragraph("No other set of effects was fitted.")]
    rows = [[", ".join(sorted(key)) or "none", f"{less:,.1f}"] for less, key in sorted(behind, key=lambda e: e[0])]
    note = "Score: log-likelihood - price of the parameters. Below 0: a better score than that of the named effects, "
    note += "with an effect that could not be named."
    return [
        table(["effects", "score of the named effects - score of this set"], rows[:RUNNERS_UP]),
        paragraph(note, "note"),
    ]
