"""The report of a diagnosis: page and figures, and one record diagnosed with all files of its report, as values."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from compensator.hysteresis.functions import Array
from rig.analysis.diagnosed import Asked, diagnosed, model_of
from rig.analysis.error import residual, residual_label, split_unit
from rig.analysis.film_records import earlier_film_records, fitted_to
from rig.analysis.trend import of_diagnosis
from rig.batch import given
from rig.config.effect_tables import add_effect_files
from rig.config.model_file import write_model
from rig.core.faults import Faults
from rig.core.file_writing import write_text
from rig.records.record_file import Record
from rig.records.run_folder import plain_json
from rig.report import diagnosis_words as words
from rig.report import page
from rig.report.batch import CANDIDATE, MODEL, RecordReport, Task, files_in
from sim.diagnosis.extended_model import extended_model
from sim.diagnosis.result import with_model

if TYPE_CHECKING:
    from sim.diagnosis.result import Diagnosis
    from sim.inference.joint.likelihood import Fit
    from sim.inference.record.record import Record as Rows


BASE, EXTENDED = page.EDGE, page.COLOURS["model"]
MOST_DOTS = 4000  # more hide each other, and make the page slow
UNCHANGED = 0.05  # of an error: less is not worth a number
MILLI = 0.3  # K: below it a figure is in mK


def scaled(size: float, unit: str) -> tuple[float, str]:
    """Return the factor and the prefix with which a size is shown: millikelvins below a limit."""
    return (1e3, "m") if size < MILLI and unit == "K" else (1.0, "")


def residuals(diagnosis: Diagnosis, fit: Fit) -> dict[str, Array]:
    """Return measured - model by channel, shape (rows,), in K and in decades of R or the film's own unit; nan without a
    reading."""
    record, out = diagnosis.record, {}
    for key, values in diagnosis.shown(fit).items():
        if key == "temperature_K":
            out[key] = np.where(record.temperature_used, residual(record.temperature_degC, values), np.nan)
        elif record.output is not None:
            left = record.quantity.size * residual(record.output, values, record.quantity.name)
            out[key] = np.where(record.output_used, left, np.nan)
    return out


def drawn_course(diagnosis: Diagnosis) -> Figure:
    """Draw the temperature over time, measured and simulated by both models, and the current."""
    record = diagnosis.record
    fig, axes = page.new_figure(2, 5.0, [2.6, 1.0])
    degC = np.where(record.temperature_used, record.temperature_degC, np.nan)
    courses: list[tuple[Array, str, str, Any]] = [(degC, page.COLOURS["measured"], "measured", "-")]
    for group, colour, name in _models(diagnosis):
        courses.append((diagnosis.shown(group)["temperature_K"], colour, name, (0, (4, 2))))
    for values, colour, name, style in courses:
        page.draw_line(
            axes[0], record.time_s, values, breaks=_breaks(record), color=colour, label=name, linestyle=style
        )
    axes[0].set_ylabel("temperature / \N{DEGREE SIGN}C")
    page.legend_above(axes[0])
    if record.current_A is not None:
        breaks, colour = _breaks(record), page.COLOURS["current"]
        page.draw_line(axes[1], record.time_s, record.current_A, held=True, breaks=breaks, color=colour, linewidth=0.9)
    axes[1].set_ylabel(_drive(diagnosis).replace(" / of", "\n/ of"))
    axes[1].set_xlabel(_time(record)[0])
    if record.joined.size:
        _times_of_each(axes[1], record)
    return fig


def _models(diagnosis: Diagnosis) -> list[tuple[Fit, str, str]]:
    """The fit, colour and name of each model that is shown: the base model only if the extended one differs from it."""
    models = [(diagnosis.base, BASE, "base model"), (diagnosis.fit, EXTENDED, "extended model")]
    return models if _extends(diagnosis) else [(diagnosis.fit, EXTENDED, "model")]


def _extends(diagnosis: Diagnosis) -> bool:
    """Whether the extended model has other effects than the base model, or another film."""
    fit, base = diagnosis.fit, diagnosis.base
    return fit.effects != base.effects or type(fit.joint.film) is not type(base.joint.film)


def _breaks(record: Rows) -> list[int]:
    """Return the rows at which a line is interrupted: after gaps, and at the first row of each record."""
    return sorted({*record.after_gaps.tolist(), *record.joined.tolist()})


def _against(diagnosis: Diagnosis) -> list[tuple[str, Array]]:
    """Return the (label, values) against which residuals are drawn."""
    record = diagnosis.record
    temperature = np.where(record.temperature_used, record.temperature_degC, np.nan)
    rate = np.concatenate([_rate(temperature[part], record.file_s[part]) for part in record.parts])
    found = [_time(record), ("temperature / \N{DEGREE SIGN}C", temperature), ("rate / K/s", rate)]
    if record.current_A is not None:
        found.append((_drive(diagnosis), record.current_A))
    elif record.test_current_A is not None:
        found.append(("test current / A", record.test_current_A))
    return found


def _time(record: Rows) -> tuple[str, Array]:
    if record.joined.size:
        return "time / s, record after record", record.time_s
    return "time / s", record.file_s


def _drive(diagnosis: Diagnosis) -> str:
    share = diagnosis.drive is not None or (diagnosis.plate is not None and diagnosis.plate.kind == "heater")
    return "drive / of full drive" if share else "current / A"


def _rate(temperature_degC: Array, time_s: Array) -> Array:
    """Return the rate of one record, K/s, smoothed over a few rows; nan if it has fewer than two readings."""
    good = np.isfinite(temperature_degC)
    if np.sum(good) < 2:
        return np.full(time_s.size, np.nan)
    even = np.interp(time_s, time_s[good], temperature_degC[good])
    width = 9 if time_s.size > 200 else 3
    smooth = np.convolve(np.pad(even, width // 2, mode="edge"), np.ones(width) / width, "valid")
    return np.asarray(np.gradient(smooth, time_s), dtype=np.float64)


def _times_of_each(axis: Axes, record: Rows) -> None:
    """Label an axis of joined records with the times of each record's file, and draw a line where each begins."""
    places, labels = [], []
    for part in record.parts:
        time, begin_s = record.file_s[part], float(record.time_s[part.start])
        ticks = [t for t in MaxNLocator(3).tick_values(time[0], time[-1]) if time[0] <= t <= time[-1]]
        places += [begin_s + t - time[0] for t in ticks]
        labels += [f"{t:.12g}" for t in ticks]
        if part.start:
            axis.axvline(begin_s, color=BASE, linewidth=0.8)
    axis.set_xticks(places, labels)


def _residual(
    folder: Path, diagnosis: Diagnosis, against: list[tuple[str, Array]], key: str, before: Array, after: Array
) -> str:
    """Draw the residuals of one channel, a row of panels for each model, each row on its own scale."""
    what, unit = words.channels_of(diagnosis)[key]
    models = [(before, BASE, "base model"), (after, EXTENDED, "extended model")]
    models = models if _extends(diagnosis) else [(after, EXTENDED, "model")]
    fig, axes = page.grid(len(models), len(against), 2.6 * len(models), sharey="row")
    good = np.flatnonzero(np.isfinite(before) & np.isfinite(after))
    index = good[np.unique(np.linspace(0, good.size - 1, min(MOST_DOTS, good.size)).astype(np.int64))]
    beyond = False
    for row, (residuals_of_model, colour, name) in zip(axes, models, strict=True):
        spread = float(np.nanpercentile(np.abs(residuals_of_model), 99.5))
        scale, prefix = scaled(spread, unit)
        limit, values = 1.3 * scale * spread, scale * residuals_of_model
        far = good[np.abs(values[good]) > limit]
        beyond, dots = beyond or far.size > 0, np.union1d(index, far)
        for axis, (label, x) in zip(row, against, strict=True):
            shown = np.clip(values[dots], -limit, limit)
            axis.plot(x[dots], shown, ".", color=colour, markersize=2, rasterized=True)
            axis.set_ylim(-1.03 * limit, 1.03 * limit)
            axis.set_xlabel(label)
        row[0].set_ylabel(f"{name}\n{residual_label(f'{prefix}{unit}')}")
    if diagnosis.record.joined.size:
        for axis in axes[:, 0]:
            _times_of_each(axis, diagnosis.record)
    *others, last = [label.split(" / ")[0] for label, _ in against]
    caption = f"Residual of {what} against {', '.join(others)} and {last}."
    caption += " Each row has its own scale." * (len(models) > 1)
    caption += " Dots on the edge are beyond it." * beyond
    return page.saved(fig, folder, f"residual_{key}", caption)


def drawn_loop(diagnosis: Diagnosis) -> Figure:
    """Draw the film's output over temperature, measured and simulated."""
    record = diagnosis.record
    assert record.output is not None
    fig, axes = page.grid(1, 2, 3.6)
    temperature = diagnosis.fit.at.run.path.at(record.time_s)
    good = np.flatnonzero(record.output_used)
    index = good[np.unique(np.linspace(0, good.size - 1, min(MOST_DOTS, good.size)).astype(np.int64))]
    read = record.output_used & np.isfinite(temperature)
    panels = _models(diagnosis)
    for axis, (group, colour, name) in zip(axes[0], panels, strict=False):
        modelled = diagnosis.shown(group)[record.quantity.channel]
        measured, model = (record.quantity.values(v) for v in (record.output, modelled))
        dots = {"markersize": 2, "color": page.COLOURS["measured"], "rasterized": True, "label": "measured"}
        axis.plot(temperature[index], measured[index], ".", **dots)
        line: dict[str, Any] = {"color": colour, "linewidth": 0.9, "rasterized": True, "label": name}
        model = np.where(read, model, np.nan)
        page.draw_line(axis, record.time_s, model, over=temperature, breaks=record.first_rows, **line)
        if record.quantity.is_resistance:
            page.log_scale(axis)
        axis.legend(loc="upper right", markerscale=4, fontsize=9)
        axis.set_xlabel("plate's temperature / \N{DEGREE SIGN}C")
    axes[0, 0].set_ylabel("resistance / ohm" if record.quantity.is_resistance else record.quantity.column)
    if len(panels) == 1:
        axes[0, 1].remove()
    return fig


RUNNERS_UP = 6  # rows of a table that is read at a glance


def write_diagnosis_report(folder: Path, diagnosis: Diagnosis) -> None:
    """Write report.html and diagnosis.json into a folder that is there, with its models."""
    write_text(folder / "diagnosis.json", plain_json(diagnosis.document()) + "\n")
    parts = [page.paragraph(f"{line}.", "note") for line in words.record_lines(diagnosis)]
    if held := words.held_out_lines(diagnosis):
        parts += [page.paragraph("Held-out records, and the errors there:", "note"), page.bullets(held)]
    parts.append(page.tiles(_numbers(diagnosis)))
    figures = []
    if diagnosis.plate is not None:
        caption = "The temperature as measured, and as the models simulate it from the drive alone."
        figures.append(page.saved(drawn_course(diagnosis), folder, "course", caption))
    if diagnosis.record.output is not None:
        caption = "The loop as measured, and as the models simulate it."
        figures.append(page.saved(drawn_loop(diagnosis), folder, "loop", caption))
    if figures:
        parts.append(page.section("Measured and modelled", *figures))
    assumed = words.assumed_lines(diagnosis)
    if assumed:
        assumed = [page.paragraph("Assumed to be there, in the base model too:"), page.bullets(assumed)]
    parts.append(page.section("Effects", _effects(diagnosis), *assumed))
    parts.append(page.section("Residual, warnings, and what to do next", *_left(diagnosis)))
    parts += _not_named(diagnosis, (folder / CANDIDATE).is_file())
    before, after = residuals(diagnosis, diagnosis.base), residuals(diagnosis, diagnosis.fit)
    against = _against(diagnosis)
    shown = [_residual(folder, diagnosis, against, key, before[key], after[key]) for key in after]
    parts += [page.section("Residuals", *shown), *_models_found(diagnosis), *_limits(diagnosis)]
    parts.append(page.section("Other sets of effects", *_runners_up(diagnosis)))
    title = f"Diagnosis of {words.together(diagnosis)}"
    page.write_page(folder / "report.html", title, words.sentence(diagnosis), parts)


def _numbers(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    found = [(words.verdict_words(diagnosis), "verdict")]
    for what, unit, channel in words.judged_channels(diagnosis):
        scale, prefix = scaled(channel.rmse_base, unit)
        before, after = scale * channel.rmse_base, scale * channel.rmse_extended
        arrow = f"{before:.3g} \N{RIGHTWARDS ARROW} {after:.3g} {prefix}{unit}"
        if not diagnosis.findings:
            arrow = f"{after:.3g} {prefix}{unit}"
        models = ", base and extended model" * bool(diagnosis.findings)
        noise = f"noise {scale * channel.noise:.3g} {prefix}{unit}"
        found.append((arrow, f"RMS error of {what} in held-out rows{models}; {noise}"))
    return found


def _effects(diagnosis: Diagnosis) -> str:
    if not diagnosis.findings:
        return page.paragraph("None is named.")
    head = ["effect", "parameters (95 % interval)", "log-likelihood gain", "false alarms", "error without it"]
    instead = any(f.indistinguishable_from for f in diagnosis.findings)
    head += ["or instead of it"] * instead
    rows = []
    for f in words.by_gain(diagnosis):
        values = words.of_drive(words.parameters(f, ";\n"), diagnosis)
        called = {key: what for key, (what, _) in words.channels_of(diagnosis).items()}
        times = {key: g.rmse_before / max(g.rmse_after, 1e-300) for key, g in f.gain.items()}
        gains = [
            f"{called[key]} {max(factor, 1.0 / factor):.3g} times {'larger' if factor > 1.0 else 'smaller'}"
            for key, factor in times.items()
            if abs(math.log(factor)) > UNCHANGED
        ]
        other = [", ".join(f.indistinguishable_from) or "\N{EN DASH}"] * instead
        gained = ", ".join(gains) or "about the same"
        evidence = f"{f.evidence:,.0f}{words.needed(f, diagnosis)}"
        effect = diagnosis.search.known.get(f.name)
        name = f"{f.name}: {effect.changes}" if effect is not None else f.name
        rows.append([name, values, evidence, words.false_alarms(f).removeprefix("false alarms "), gained, *other])
    note = (
        "Log-likelihood gain: what the fit loses without this effect; in brackets, what an effect needs to be named. "
    )
    note += "False alarms: the share of records without any effect in which one is named. Error without it: RMS error "
    note += "in held-out rows, compared with the extended model's."
    return page.table(head, rows) + page.paragraph(note, "note")


def _not_named(diagnosis: Diagnosis, as_model: bool) -> list[str]:
    """A section on candidates, if there are any. as_model: whether the first was written as a model."""
    if not diagnosis.candidates:
        return []
    note = "They may do worse on another record: check with --holdout. "
    if as_model:
        note += f"{CANDIDATE} is the model with the first of them."
    else:
        note += "Written as a model file, none of them predicts these rows better than the named effects."
    shown = [page.bullets(words.not_named(diagnosis)), page.paragraph(note, "note")]
    return [page.section("Candidates that are not named", *shown)]


def _limits(diagnosis: Diagnosis) -> list[str]:
    rows = words.limit_rows(diagnosis)
    if not rows:
        return []
    head = ["effect", "size that this record allows (95 %)", "typical range"]
    note = "A leakage and a heat sink are larger effects the smaller their values are: their limits are lower ones."
    shown = [page.table(head, rows), page.paragraph(note, "note")]
    return [page.section("Size limits of effects that are not named", *shown)]


def _models_found(diagnosis: Diagnosis) -> list[str]:
    plate, shown = diagnosis.plate, []
    if plate is not None:
        rows = []
        for name, (value, ci) in plate.parameters.items():
            width = 0.0 if ci is None else ci[1] - ci[0]
            ends = words.NOT_FIXED if ci is None else f"{words.number(ci[0], width)} to {words.number(ci[1], width)}"
            what, unit = split_unit(name)
            rows.append([what, words.number(value, width), ends, unit])
        kind = "Peltier plate" if plate.kind == "peltier" else plate.kind
        shown.append(page.table([kind, "value", "95 % interval", "unit"], rows))
        shown += [page.paragraph(f"Each record's room: {line}.", "note") for line in words.room_line(diagnosis)]
        shown += [page.paragraph("Doubtful:"), page.bullets(plate.doubts)] if plate.doubts else []
    if diagnosis.film is not None:
        shown.append(page.paragraph(f"{words.film_words(diagnosis.film)}.", "note"))
    return [page.section("Plate and film", *shown)] if shown else []


def _left(diagnosis: Diagnosis) -> list[str]:
    left = [f"Residual: {text}" for text in words.left_over(diagnosis)] or [words.residual_words(diagnosis)]
    left += [f"Warning: {words.warning_line(diagnosis, w)}" for w in diagnosis.warnings]
    return [page.bullets([*left, *(f"Next: {text}" for text in diagnosis.next_experiment)])]


def _runners_up(diagnosis: Diagnosis) -> list[str]:
    """A table of the other sets that were fitted, the likeliest first."""
    search, names = diagnosis.search, frozenset(e.name for e in diagnosis.fit.effects)
    best = search.value(diagnosis.fit)
    others = [(search.value(fit) - best, key) for key, fit in search.table.items() if key != names]
    if not others:
        return [page.paragraph("No other set of effects was fitted.")]
    others.sort(key=lambda e: -e[0])
    rows = [[", ".join(sorted(key)) or "none", f"{more:+,.1f}"] for more, key in others]
    note = "Score: the log-likelihood, less the price of the parameters."
    if others[0][0] >= 0.0:
        note += " A set with a better score is not named if the record does not determine the size of one of its "
        note += "effects, or if the residual is larger than what that effect explains."
    head = ["effects", "score, compared with that of the named effects"]
    return [page.table(head, rows[:RUNNERS_UP]), page.paragraph(note, "note")]


# what there is to do about it, most first
RANK = ("partly_unexplained", "explained", "unexplained", "too_short", "clean")


def report_diagnosis(
    record: Any,
    asked: Asked,
    model: str | None = None,
    *holdout: Any,
    report: bool | None = None,
    further: Sequence[Record] = (),
    say: Callable[[str], None] = lambda text: None,
) -> RecordReport:
    """Diagnose a record.

    record, holdout: `Record`s, or what an engine shares of them. model: where its model will stand; None: nowhere.
    report: True if its files are wanted; None: where the model is. further: records that are diagnosed with it as one;
    say: takes progress.
    """
    add_effect_files(asked.effect_files)
    one: Record = given(record)
    earlier = earlier_film_records(one.source, say)
    records = [one, *further]
    try:
        diagnosis, extended = diagnosed(records, asked, [given(other) for other in holdout], earlier, say)
    except Faults as faults:
        return RecordReport(faults=tuple(faults.lines))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if model is not None:
            diagnosis = with_model(diagnosis, model)
            film_of = [*records, *(earlier if extended.further else [])]
            write_model(folder / MODEL, fitted_to(model_of(extended), film_of), words.model_comment(diagnosis))
        if report if report is not None else model is not None:
            for candidate in diagnosis.candidates[:1]:
                tried = extended_model(candidate.fit, diagnosis.record)
                comment = f"with what was found in {words.together(diagnosis)} and is not named: "
                comment = "\n".join([comment + ", ".join(candidate.names), *words.unit_lines(diagnosis)])
                write_model(folder / CANDIDATE, fitted_to(model_of(tried), records), comment)
            write_diagnosis_report(folder, diagnosis)
        files = files_in(folder)
    return RecordReport(diagnosis.document(), tuple(words.lines(diagnosis)), files)


def _rank(row: Mapping[str, Any]) -> tuple[int, float, int]:
    """What matters first: what shows an effect, by the evidence; then what nothing explains; then what is clean."""
    verdict = str(row.get("verdict", ""))
    evidence = [value for key, value in row.items() if key.endswith(".evidence") and isinstance(value, float)]
    place = RANK.index(verdict) if verdict in RANK else len(RANK)
    return place, -max(evidence, default=0.0), int(row["number"])


def diagnoses(asked: Asked, holdout: Sequence[Record]) -> Task:
    return Task(
        work=report_diagnosis,
        options=asked,
        document="diagnosis.json",
        table="diagnoses",
        title="Diagnoses",
        row=of_diagnosis,
        rank=_rank,
        columns={"verdict": "verdict", "named": "effects and sizes", "left": "left over"},
        shared=tuple(holdout),
        files=asked.effect_files,
    )
