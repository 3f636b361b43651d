"""What a user should know besides: what the rows show by themselves, what the record lacks, what may be off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sim.diagnosis.data.noise_model import root_mean_square
from sim.diagnosis.data.record import Record
from sim.diagnosis.data.rough_number import rough
from sim.diagnosis.fit.plate_parameters import ROOM
from sim.diagnosis.judge.carried_over import CarriedOver
from sim.diagnosis.report.caution import Caution
from sim.diagnosis.report.row_warnings import row_warnings
from sim.diagnosis.report.upper_limits import UpperLimit, film_not_described
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.validate.halves import Halves

ALIKE = 0.1  # relative difference of two lags: instruments and films that do not know of each other differ by more


def warnings_of(
    chain: Chain, names: frozenset[str], hidden: Mapping[str, tuple[str, float]], limits: list[UpperLimit]
) -> list[Caution]:
    """All that apply. names: of the effects fitted; hidden: as `hidden_by_the_film` has it; limits: of the others."""
    record = chain.record
    found = [*row_warnings(record), *constant_columns(record)]
    if record.current_A is None:
        found.append(Caution("no_current", "no current_A: plate, driver and thermometer were not judged"))
    if record.output is None:
        found.append(Caution("no_resistance", f"no {record.quantity.column}: film and its meter were not judged"))
    elif not record.quantity.is_resistance:
        text = "series resistance, leakage, ranges and self-heating were not judged: they are a resistance's"
        found.append(Caution("no_resistance", f"{record.quantity.column}: {text}"))
    elif record.test_current_A is None:
        found.append(Caution("no_test_current", "no meter_current_A: self-heating was not judged"))
    if not film_not_described(chain, names):
        found += [absorbed(name, parameter, limits) for name, (parameter, _) in hidden.items()]
    found += as_late_as_each_other(chain, names)
    return found + coloured_noise(chain) + film_in_steps(chain) + film_is_not_described(chain, names)


def constant_columns(record: Record) -> list[Caution]:
    """Of what is logged about the plate and does not change."""
    found = []
    for name, (low, high) in record.constant_inputs.items():
        all_rows = f"{low:g} in all rows" if low == high else f"{low:g} to {high:g}, the same throughout each record"
        text = f"{name}: {all_rows}: not used, since only changes of it show how it acts on the plate"
        if name == ROOM.name:
            text += "; the room is found from the plate alone, and should agree with it"
        found.append(Caution("constant_column", text))
    return found


def absorbed(name: str, parameter: str, limits: list[UpperLimit]) -> Caution:
    """Of an effect that the film's own shape hides at a usual size: what the record allows of it is one number, here
    and among the limits."""
    known = next((limit for limit in limits if (limit.name, limit.parameter) == (name, parameter)), None)
    text = f"{name}: would not have shown at any usual size: the film's own shape absorbs it"
    if known is not None and known.limit is not None:
        size = f"{parameter} {'above' if known.from_below else 'below'} {rough(known.limit)}"
        text = f"{name}: would not have shown with {size}: the film's own shape absorbs it"
    return Caution("absorbed_by_the_film", text)


def as_late_as_each_other(chain: Chain, names: frozenset[str]) -> list[Caution]:
    """Of a thermometer and a film that are as late as each other behind the plate, as one lag before it makes them."""
    tau_s = {e.name: float(e.par[0]) for fit in chain.fits(names) if fit is not None for e in fit.effects}
    thermometer = tau_s.get("sensor_lag")
    for name in ("film_lag", "meter_lag"):
        if thermometer is not None and name in tau_s and abs(tau_s[name] / thermometer - 1.0) < ALIKE:
            text = (
                f"sensor_lag and {name} are alike ({thermometer:.2g} and {tau_s[name]:.2g} s): one lag of the current, "
                "before the plate, looks so in both; see how the driver follows its command first"
            )
            return [Caution("lags_alike", text)]
    return []


def coloured_noise(chain: Chain) -> list[Caution]:
    """Of instruments whose noise has a spectrum of its own."""
    of = {}
    if chain.first is not None and chain.first.channel.noise.colour is not None:
        of["thermometer"] = f"{chain.first.channel.noise.level:.2g} K"
    if chain.facts is not None and chain.facts.noise.colour is not None:
        of["ohmmeter"] = f"{chain.facts.noise.level * chain.record.quantity.size:.2g} {chain.record.quantity.unit}"
    if not of:
        return []
    sizes = " and ".join(f"the {instrument}'s, {size} (RMS)" for instrument, size in of.items())
    text = (
        f"noise has a spectrum of its own, as behind a filter or with 1/f noise: {sizes}. What rows next to each other "
        "show of it tells how much of it is slow; what is slow and no larger than that would not have shown"
    )
    return [Caution("coloured_noise", text)]


def film_in_steps(chain: Chain) -> list[Caution]:
    """Of a film whose domains switch visibly, or so it seems."""
    facts = chain.facts
    if facts is None or facts.domains is None or facts.noise.wandering is None:
        return []
    own, quantity = root_mean_square(facts.noise.wandering.deviation), chain.record.quantity
    step, lacks = (f"{value * quantity.size:.1g} {quantity.unit}" for value in (facts.domains.step_dec, own))
    text = (
        f"the film switches in steps, it seems, of about {step}: what a smooth film lacks, {lacks} (RMS), comes again "
        "at the same temperatures, and counts as the film's own beside the ohmmeter's noise. A prediction is off by "
        "that much, and an effect's size may be off by up to three times what its interval says. What an ohmmeter does "
        "behind a change of range comes again, too, and would pass for such steps"
    )
    return [Caution("film_in_steps", text)]


def film_is_not_described(chain: Chain, names: frozenset[str]) -> list[Caution]:
    """Of readings of the film of which more is left than their noise."""
    if not film_not_described(chain, names):
        return []
    text = (
        "more is left than the noise, by a cause that is not in the catalogue or a film of another kind (one that "
        "switches in visible steps, for example): no limits are given for what acts on the film and at the ohmmeter"
    )
    if chain.split(names)[1]:
        text += ", and what is named there may be off by more than its interval"
    return [Caution("film_not_described", text)]


def out_of_time(doing: str, share: float, seconds: float, kinds: Sequence[str] = ()) -> Caution:
    """Of a diagnosis that its time cut short. doing: what was ended when this share of the time was over; kinds: of
    plate, where not all of them were searched to the end."""
    text = (
        f"{doing} was ended {share * seconds:.3g} s after the beginning, its share of the {seconds:.3g} s allowed: "
        "this is the best until then; more time may say more"
    )
    if kinds:
        text += f". The kind of plate ({' or '.join(kinds)}) was not decided: what is said here may be of the wrong one"
    return Caution("out_of_time", text)


def memoryless_not_asked() -> Caution:
    """Of a base without D(T), where the time was over before it was asked whether the film needs one."""
    text = "the time was over before it was asked whether the film needs a D(T): its model has none, as the base says"
    return Caution("memoryless_not_asked", text)


def unlogged_currents(record: Record) -> list[Caution]:
    """Of a record whose current changed between its rows."""
    if record.early == 0.0:
        return []
    text = (
        f"the temperature bends before the rows in which the current changes: {record.early:.0%} of a change had acted "
        "before its row, on average. The current changed between the rows, and is in none: its mean there was taken, "
        "and a prediction from it is off by more than the noise"
    )
    return [Caution("current_between_rows", text)]


def left_open(carried: CarriedOver) -> list[Caution]:
    """Of held-out rows of which the fitted rows tell too little."""
    left, of = carried.not_counted
    if not left:
        return []
    text = (
        f"{left} of {of} held-out rows go where the fitted rows tell less of the film than a reading does: they count "
        "for no verdict, and the error in held-out rows is mostly theirs. More loops there would tell"
    )
    return [Caution("film_left_open", text)]


def decided_elsewhere(halves: Halves | None) -> list[Caution]:
    """Where halves of other records disagree about a name, so that not all of their rows judge."""
    if halves is None or not halves.decided or (halves.first_judges and halves.second_judges):
        return []
    fold, names = halves.folds[0], ", ".join(sorted(halves.refused))
    text = f"each half of the other records speaks against another name ({names}): errors there are optimistic"
    if fold["judging"]:
        left = ", ".join(sorted(halves.refused - halves.overruled))
        text = (
            f"{fold['deciding']} rows of the other records speak against {left}, which the other {fold['judging']} "
            "rows leave: it is not said, and errors are of these"
        )
        if halves.overruled:
            needed = ", ".join(sorted(halves.overruled))
            text = (
                f"{fold['judging']} rows of the other records, by themselves, speak against {needed}, which all of "
                "them together need: it is said, and errors are of those that speak against it"
            )
    return [Caution("held_out_rows_decided", text)]


def decided_by_records(names: frozenset[str]) -> list[Caution]:
    """names: those that further records of the film decided."""
    if not names:
        return []
    text = f"{', '.join(sorted(names))}: decided by the records that told the film before: "
    text += "the film of all records tells rows that no fit has seen only with it"
    return [Caution("decided_by_film_records", text)]
