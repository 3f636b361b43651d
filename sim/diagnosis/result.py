"""What a diagnosis has found, and its JSON (peltier-diagnosis/1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.search import Search
from sim.inference.gain import Gain
from sim.inference.joint.held_out import simulated
from sim.inference.joint.likelihood import Fit
from sim.inference.record.record import Mask, Record

Interval = tuple[float, float]
LARGEST_PLAIN = 1e8  # above, nobody counts the zeros of a number in full
Sizes = Mapping[str, tuple[float, Interval | None]]  # of an effect: parameters by name, with 95 % intervals


@dataclass(frozen=True)
class Finding:
    """A named effect. evidence: log-likelihood that is lost without it; false_alarm: a bound of the share of records
    without any effect that reach that for one; indistinguishable_from: effects that explain the record as well in its
    place; gain: by channel."""

    name: str
    parameters: Sizes
    evidence: float
    false_alarm: float
    indistinguishable_from: tuple[str, ...] = ()
    gain: Mapping[str, Gain] = field(default_factory=dict)


@dataclass(frozen=True)
class Channel:
    """Noise of an instrument, and the errors of base and extended model in held-out rows."""

    noise: float
    rmse_base: float
    rmse_extended: float
    samples_holdout: int


@dataclass(frozen=True)
class Candidate:
    """A set of effects that was found and is not named; its errors in held-out rows beside those of what is named."""

    names: tuple[str, ...]
    parameters: Mapping[str, Sizes]
    rmse_named: Mapping[str, float]
    rmse_holdout: Mapping[str, float]
    reduction_ci95: Mapping[str, Interval]
    why_not_named: str
    fit: Fit = field(repr=False)


@dataclass(frozen=True)
class UpperLimit:
    """The largest size of an effect that is not named (95 %). limit: in the parameter's unit, None if the record allows
    any; from_below: the record excludes what is smaller (a leakage's resistance); typical: the typical range of sizes,
    None where the record's unit is another; absorbed: plate or film do nearly the same as an effect of that size."""

    name: str
    parameter: str
    limit: float | None
    from_below: bool
    typical: Interval | None
    absorbed: bool = False

    @property
    def allows_all_typical(self) -> bool:
        """Return True if an effect of any typical size may be there, unseen."""
        if self.limit is None or self.typical is None:
            return self.limit is None
        return self.limit <= self.typical[0] if self.from_below else self.limit >= self.typical[1]

    @property
    def excludes_all_typical(self) -> bool:
        """Return True if an effect of every typical size would have shown."""
        if self.limit is None or self.typical is None:
            return False
        return self.limit >= self.typical[1] if self.from_below else self.limit <= self.typical[0]


@dataclass(frozen=True)
class Caution:
    """A warning. from_s, to_s: as the record's file has the time, None: all of it; record: its number among several,
    from 1 on, None: all of them, or the only one."""

    code: str
    text: str
    from_s: float | None = None
    to_s: float | None = None
    record: int | None = None


@dataclass(frozen=True)
class PlateNumbers:
    """kind; parameters by the names of a model file, with 95 % intervals, None where the record does not fix one;
    doubts: a line each, with what an experiment would need to settle it."""

    kind: str
    parameters: Sizes
    doubts: tuple[str, ...]


@dataclass(frozen=True)
class HeldOutRecord:
    """Another record: its source, errors (RMSE of the base and of the extended model, rows) by channel, and the room
    that was fitted to its first rows, None without a plate."""

    source: str
    errors: Mapping[str, tuple[float, float, int]]
    ambient_degC: float | None = None


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Everything that a diagnosis has found.

    verdict: clean, explained, partly_unexplained, unexplained or too_short. findings: the named effects, the most
    evident first. channels and unexplained: by the keys of the JSON, "temperature_K" and the film's
    (`Quantity.channel`). film: its form. candidates: found and not named. limits: of effects that are not named.
    assumed: parameters of the effects that the user stated. record: as the fits took it. base, fit: the fits without
    and with what was found; likeliest: the fit with what explains less than it leaves over, too; without: the fit
    without each named effect. elsewhere: other records; written: the fit that predicts them best, whose model is
    written. sources: files of the records. drive: unit of a current
    that is a share of full drive. not_believed: readings that were left out when the files were read.
    """

    verdict: str
    findings: tuple[Finding, ...]
    channels: Mapping[str, Channel | None]
    unexplained: Mapping[str, str | None]
    film: Mapping[str, Any] | None
    warnings: tuple[Caution, ...]
    next_experiment: tuple[str, ...]
    plate: PlateNumbers | None
    candidates: tuple[Candidate, ...]
    limits: tuple[UpperLimit, ...]
    assumed: Mapping[str, Sizes]
    record: Record
    base: Fit
    fit: Fit
    likeliest: Fit
    without: Mapping[str, Fit]
    search: Search
    elsewhere: tuple[HeldOutRecord, ...] = ()
    written: Literal["base", "extended", "likeliest"] = "extended"
    sources: tuple[str, ...] = ()
    model: str | None = None
    drive: str | None = None
    not_believed: tuple[Mapping[str, Any], ...] = ()

    @property
    def rooms_degC(self) -> list[float]:
        """Each record's room; none without a current."""
        joint, x = self.fit.joint, self.fit.for_simulation.at.x
        if not joint.driven:
            return []
        room = float(x[joint.place["ambient_degC"]])
        others = range(1, len(joint.joined_anew))
        return [room, *(room + float(x[joint.place[f"room_K.{k}"]]) for k in others)]

    def shown(self, fit: Fit) -> dict[str, Array]:
        """Return what a fit's simulation shows in every row, by channel: degC, and the film's output as the fits have
        it."""
        run, channels = simulated(fit), {}
        if fit.joint.driven:
            channels["temperature_K"] = run.run.shown_degC
        if fit.joint.film is not None:
            channels[self.record.quantity.channel] = run.shown_dec
        return channels

    def document(self) -> dict[str, Any]:
        """The JSON of `peltier diagnose`."""
        rooms: Sequence[float | None] = self.rooms_degC or [None] * len(self.sources)
        return {
            "format": "peltier-diagnosis/1",
            "verdict": self.verdict,
            "effects": [_finding(f) for f in self.findings],
            "channels": {key: None if c is None else dict(vars(c)) for key, c in self.channels.items()},
            "unexplained": dict(self.unexplained),
            "film": None if self.film is None else dict(self.film),
            "plate": self.plate
            and {
                "kind": self.plate.kind,
                "parameters": sizes(self.plate.parameters),
                "doubts": list(self.plate.doubts),
            },
            "assumed": [{"name": name, "parameters": sizes(own)} for name, own in self.assumed.items()],
            "candidates": [
                {
                    "names": list(c.names),
                    "parameters": {name: sizes(own) for name, own in c.parameters.items()},
                    "rmse_holdout": dict(c.rmse_holdout),
                    "why_not_named": c.why_not_named,
                }
                for c in self.candidates
            ],
            "upper_limits": [
                {"name": limit.name, "parameter": limit.parameter, "limit95": limit.limit} for limit in self.limits
            ],
            "rows": self._rows(),
            "records": [
                {"source": source, "ambient_degC": room} for source, room in zip(self.sources, rooms, strict=False)
            ],
            "holdouts": [
                {
                    "source": other.source,
                    "channels": {
                        key: {"rmse_base": base, "rmse_extended": extended, "samples_holdout": rows}
                        for key, (base, extended, rows) in other.errors.items()
                    },
                    "ambient_degC": other.ambient_degC,
                }
                for other in self.elsewhere
            ],
            "warnings": [{key: getattr(w, key) for key in CAUTION_KEYS} for w in self.warnings],
            "next_experiment": list(self.next_experiment),
            "model": self.model,
        }

    def _rows(self) -> dict[str, Any]:
        """How many rows were fitted, decided and judged, and which readings were left out, by the time of the file.
        Held-out rows of the record itself decide which candidates are shown; other records, all of them, the verdict
        and the model."""
        record = self.record
        left_out = [
            {"record": record.number_of(out.row), "time_s": float(record.file_s[out.row])}
            | {"column": out.column, "rule": out.rule}
            for out in record.left_out
        ]
        deciding, judging = _count(record.deciding), _count(record.judging)
        if self.elsewhere:
            judging = sum(max(rows for _, _, rows in o.errors.values()) if o.errors else 0 for o in self.elsewhere)
        return {
            "fitted": _count(~record.held_out),
            "deciding": deciding,
            "judging": judging,
            "left_out": [*left_out, *(dict(one) for one in self.not_believed)],
        }


CAUTION_KEYS = ("code", "record", "from_s", "to_s", "text")


def sizes(parameters: Sizes) -> dict[str, Any]:
    """Return parameters with their intervals as the JSON has them."""
    return {
        name: {"value": value, "ci95": None if ci is None else list(ci)} for name, (value, ci) in parameters.items()
    }


def _finding(f: Finding) -> dict[str, Any]:
    return {
        "name": f.name,
        "parameters": sizes(f.parameters),
        "evidence": f.evidence,
        "false_alarm": f.false_alarm,
        "false_alarm_kind": "bound",
        "indistinguishable_from": list(f.indistinguishable_from),
        "gain": {key: {**vars(g), "reduction_ci95": list(g.reduction_ci95)} for key, g in f.gain.items()},
    }


def _count(rows: Mask) -> int:
    return int(np.sum(rows))


def verdict_of(named: bool, left: bool) -> str:
    """Return the verdict for whether effects are named, and whether residual structure is left."""
    if named:
        return "partly_unexplained" if left else "explained"
    return "unexplained" if left else "clean"


def with_model(diagnosis: Diagnosis, path: str) -> Diagnosis:
    """Return the diagnosis with the path of the extended model's file."""
    return replace(diagnosis, model=path)


def rough(value: float) -> str:
    """Return a number with the two digits that matter: 0.062, 2.4, 230; 4,700,000 in full."""
    rounded = float(f"{value:.2g}")
    return f"{rounded:,.0f}" if 100.0 <= abs(rounded) < LARGEST_PLAIN else f"{value:.2g}"
