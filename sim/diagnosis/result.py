"""What a diagnosis has found, and its JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim.diagnosis.data.record import Record
from sim.diagnosis.data.rough_number import rough
from sim.diagnosis.judge.verdict import Verdict
from sim.diagnosis.report.candidates import Candidate
from sim.diagnosis.report.caution import Caution
from sim.diagnosis.report.plate_numbers import PlateNumbers
from sim.diagnosis.report.upper_limits import UpperLimit
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.validate.gain import Gain
from sim.diagnosis.validate.halves import Halves

MORE = 1.1  # times the noise, from which what the record leaves open is said beside it
NOISY = 1.3  # times what is foreseen of held-out rows, from which a fit that leaves nothing else does not carry over
SHORTFALL = "does not carry over to held-out rows; the record determines too little of the film or the plate"
UNLOGGED = "the current changed between the rows, and a simulation from the record does not know how"
FIRST_ROWS = (
    "what is a held-out record's own (its room, first temperatures and the film's memory) was fitted to its first "
    "rows, which leave it open; fitted to all of its rows, these are off by"
)
ONLY_UNSEEN = "held-out rows are predicted"  # so begins what is left of a channel whose fitted rows leave nothing


@dataclass(frozen=True)
class Finding:
    """One named effect: parameters by name with their 95 % intervals, evidence, its confounders, gain by
    channel."""

    name: str
    parameters: dict[str, tuple[float, tuple[float, float] | None]]
    evidence: float
    false_alarm: float
    indistinguishable_from: list[str]
    gain: dict[str, Gain]


@dataclass(frozen=True)
class Channel:
    """One channel: its instrument's noise, the held-out RMSE of the base and of the extended model, how many rows were
    held; expected: RMSE with the true effects, the noise and what this record leaves open (a walk of the plate between
    the rows, a film's steps, a film's course where the fitted rows never were); all_told: how many times that is missed
    where what belongs to another record is fitted to all of its rows."""

    noise: float
    rmse_base: float
    rmse_extended: float
    samples_holdout: int
    expected: float
    all_told: float

    @property
    def leaves_open(self) -> bool:
        """Whether more than the noise is to be expected of held-out rows."""
        return self.expected > MORE * self.noise

    @property
    def foreseen(self) -> str:
        """What is expected of them, in words."""
        return "the noise and what this record leaves open" if self.leaves_open else "the noise"


@dataclass(frozen=True)
class HeldOutRecord:
    """Another record: its source, and by channel the extended model's RMSE in those of its rows that judge, with how
    many they are; none where its rows decide. ambient_degC: the room that its first rows tell; None without a plate."""

    source: str
    errors: dict[str, tuple[float, int]]
    ambient_degC: float | None = None

    def document(self) -> dict[str, Any]:
        """As in the JSON."""
        channels = {name: {"rmse_extended": rmse, "samples_holdout": n} for name, (rmse, n) in self.errors.items()}
        return {"source": self.source, "channels": channels, "ambient_degC": self.ambient_degC}


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """verdict, findings in order of evidence, channels (None where the record lacks one), what is left in words, the
    film's form, warnings, what to do next, the plate's numbers, what was found and is not named, how large what is not
    named may be, the parameters of what was assumed, each record's room (of a record with a current); sources: of the
    records; halves: of other records held out; elsewhere: the error on each of these; record and chain: for figures and
    for the extended model; drive: the unit of a current that is a share of full drive, else None; not_believed:
    readings that were left out where the records were read, as in the JSON. The keys of channels, gains and what is
    left are "temperature_K" and the film's (`sim.diagnosis.data.quantity`)."""

    verdict: str
    findings: list[Finding]
    channels: dict[str, Channel | None]
    unexplained: dict[str, str | None]
    film: dict[str, Any] | None
    warnings: list[Caution]
    next_experiment: list[str]
    record: Record
    chain: Chain
    judged: Verdict
    plate: PlateNumbers | None
    candidates: list[Candidate]
    limits: list[UpperLimit]
    assumed: dict[str, dict[str, tuple[float, tuple[float, float] | None]]]
    rooms_degC: list[float]
    halves: Halves | None
    sources: tuple[str, ...] = ()
    elsewhere: tuple[HeldOutRecord, ...] = ()
    model: str | None = None
    drive: str | None = None
    not_believed: tuple[dict[str, Any], ...] = ()

    @property
    def left(self) -> dict[str, str | None]:
        """By channel what is left, in words: what the verdict counts (`unexplained`); or, where that is nothing, by how
        much held-out rows are missed. None: nothing."""
        found = dict(self.unexplained)
        for key, off in self.missed.items():
            if found[key] is None:
                found[key] = f"held-out rows are {off}: {self._why_missed(key)}"
        return found

    def open_at_first(self, key: str) -> bool:
        """Whether a channel's held-out rows are missed by what their record's first rows leave open of what is its own
        (room, first temperatures, memory), and met where that is fitted to all of its rows."""
        channel = self.channels[key]
        return key in self.missed and channel is not None and channel.all_told <= NOISY

    def _why_missed(self, key: str) -> str:
        channel = self.channels[key]
        if self.record.early > 0.0:
            return UNLOGGED
        if channel is not None and self.open_at_first(key):
            return f"{FIRST_ROWS} {rough(channel.all_told)} times {channel.foreseen}"
        return f"what was fitted {SHORTFALL}"

    @property
    def missed(self) -> dict[str, str]:
        """By channel, where held-out rows are missed by more than is foreseen: off by 2.4 times the noise. Where
        currents were not logged, more than the noise alone, so that this is said."""
        found = {}
        for key, channel in self.channels.items():
            if channel is None:
                continue
            foreseen, words = channel.expected, channel.foreseen
            if self.record.early > 0.0:
                foreseen, words = channel.noise, "the noise"
            if channel.rmse_extended > NOISY * foreseen:
                found[key] = f"off by {rough(channel.rmse_extended / foreseen)} times {words}"
        return found

    def _rows(self) -> dict[str, Any]:
        """How many rows fitted, decided and judged, of the first fold where there are two; and which readings were left
        out, by the number of their record and the time of its file. Of the record itself all rows are fitted where
        others are held out; `held_out` then says which of their rows are in which half, `folds` how many of them decide
        and judge."""
        record = self.record
        left_out = [
            {
                "record": record.number_of(row),
                "time_s": float(record.file_s[row]),
                "column": column,
                "rule": rule,
            }
            for row, column, rule in record.left_out
        ]
        left_out += self.not_believed
        fitted = int(np.sum(~record.held_out))
        if self.halves is None:
            deciding, judging = int(np.sum(record.deciding)), int(np.sum(record.judging))
            return {"fitted": fitted, "deciding": deciding, "judging": judging, "left_out": left_out}
        folds, held_out = self.halves.folds, self.halves.document()
        return {"fitted": fitted, **folds[0], "left_out": left_out, "folds": folds, "held_out": held_out}

    def document(self) -> dict[str, Any]:
        """The JSON of `peltier diagnose`, format peltier-diagnosis/1."""
        rooms: Sequence[float | None] = self.rooms_degC or [None] * len(self.sources)
        return {
            "format": "peltier-diagnosis/1",
            "verdict": self.verdict,
            "effects": [
                {
                    "name": f.name,
                    "parameters": _values(f.parameters),
                    "evidence": f.evidence,
                    "false_alarm": f.false_alarm,
                    "false_alarm_kind": "bound",
                    "indistinguishable_from": f.indistinguishable_from,
                    "gain": {
                        channel: {
                            "rmse_before": g.rmse_before,
                            "rmse_after": g.rmse_after,
                            "reduction_ci95": list(g.reduction_ci95),
                        }
                        for channel, g in f.gain.items()
                    },
                }
                for f in self.findings
            ],
            "channels": {
                name: None
                if c is None
                else {
                    "noise": c.noise,
                    "rmse_base": c.rmse_base,
                    "rmse_extended": c.rmse_extended,
                    "samples_holdout": c.samples_holdout,
                }
                for name, c in self.channels.items()
            },
            "unexplained": self.unexplained,
            "left": self.left,
            "film": self.film,
            "plate": None if self.plate is None else self.plate.document(),
            "assumed": [{"name": name, "parameters": _values(own)} for name, own in self.assumed.items()],
            "candidates": [c.document() for c in self.candidates],
            "upper_limits": [limit.document() for limit in self.limits],
            "rows": self._rows(),
            "records": [
                {"source": source, "ambient_degC": room} for source, room in zip(self.sources, rooms, strict=False)
            ],
            "holdouts": [record.document() for record in self.elsewhere],
            "warnings": [w.document() for w in self.warnings],
            "next_experiment": self.next_experiment,
            "model": self.model,
        }


def _values(parameters: Mapping[str, tuple[float, tuple[float, float] | None]]) -> dict[str, Any]:
    """Parameters with their intervals, in JSON."""
    return {
        name: {"value": value, "ci95": list(ci) if ci is not None else None} for name, (value, ci) in parameters.items()
    }


def verdict_of(findings: list[Finding], unexplained: dict[str, str | None], sparse: bool = False) -> str:
    """clean, explained, partly_unexplained or unexplained; too_short where nothing is named and nothing left but in the
    film's channel, of a record too sparse to tell a film's flank or the turns of its temperature."""
    if sparse and not findings and unexplained["temperature_K"] is None:
        return "too_short"
    left = any(text is not None for text in unexplained.values())
    if findings:
        return "partly_unexplained" if left else "explained"
    return "unexplained" if left else "clean"


def with_model(diagnosis: Diagnosis, path: str) -> Diagnosis:
    """The same, with the path of the extended model's file."""
    return replace(diagnosis, model=path)
