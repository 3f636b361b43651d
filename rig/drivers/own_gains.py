"""A controller's own PID in the instrument's own fields: what each gain is called there, in which unit, how fine.

    Kp in A/K, Ti and Td in s  ->  options of the driver, which it sets and reads back, and commands that do it

Sources: the manuals that the drivers name. Not verified on an instrument: TIGN and TDGN of the LDC501 (their names, and
that TIGN is 1/s of the proportional gain), and the law inside each: a textbook PID is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from compensator.control.own_pid import OwnPid

PER_CENT, PER_MIN = 100.0, 60.0  # full output is 100 percent; a minute has 60 s


@dataclass(frozen=True)
class OwnField:
    """One gain: the driver's option and its value, rounded as the instrument keeps it; the command; the unit."""

    option: str
    value: float
    command: str
    unit: str


Fields = list[OwnField]


def own_fields(driver: str, options: Mapping[str, Any], pid: OwnPid, limit: float) -> Fields | None:
    """The fields of a driver's instrument; None where it has no PID of its own, or one that is not known here.

    limit: the current (A, or share of full drive) that is 100 % of the output.
    """
    made = _MADE.get(driver)
    return made(options, pid, limit) if made is not None else None


def configured_pid(driver: str, options: Mapping[str, Any], limit: float) -> OwnPid | None:
    """What a configuration's options set; None where they do not give all of it."""
    fields = own_fields(driver, options, OwnPid(1.0, 1.0), limit)
    if fields is None or any(options.get(field.option) is None for field in fields):
        return None
    return set_pid([replace(field, value=float(options[field.option])) for field in fields], driver, limit)


def set_pid(fields: Fields, driver: str, limit: float) -> OwnPid:
    """What the fields come to."""
    given = {field.option: field.value for field in fields}
    if driver == "meerstetter":
        return OwnPid(given["kp_percent_per_K"] * limit / PER_CENT, given["ti_s"], given["td_s"])
    if driver == "te_technology":
        integral = given["integral_per_min"]
        return OwnPid(
            limit / given["bandwidth_K"], PER_MIN / integral if integral else 0.0, given["derivative_min"] * PER_MIN
        )
    if driver == "srs_ldc500":
        return OwnPid(abs(given["p_A_per_K"]), 1.0 / given["i_per_s"] if given["i_per_s"] else 0.0, given["d_s"])
    return OwnPid(given["p"] * limit / PER_CENT, 1000.0 / given["i"] if given["i"] else 0.0, given["d"] / PER_CENT)


def _meerstetter(_: Mapping[str, Any], pid: OwnPid, limit: float) -> Fields:
    values = (
        ("kp_percent_per_K", round(PER_CENT * pid.kp_A_per_K / limit, 2), 3010, "%/K"),
        ("ti_s", round(pid.ti_s, 2), 3011, "s"),
        ("td_s", round(pid.td_s, 2), 3012, "s"),
    )
    return [OwnField(name, value, f"parameter {number} = {value:g}", unit) for name, value, number, unit in values]


def _te_technology(options: Mapping[str, Any], pid: OwnPid, limit: float) -> Fields:
    per_K = 10 if options.get("model") == "tc-48-20" else 100
    band_K = max(round(limit / pid.kp_A_per_K * per_K), 1) / per_K
    integral = round(PER_MIN / pid.ti_s, 2) if pid.ti_s > 0.0 else 0.0
    return [
        OwnField("bandwidth_K", band_K, f"code 1d = {round(band_K * per_K)}", "K"),
        OwnField("integral_per_min", integral, f"code 1e = {round(100 * integral)}", "repeats/min"),
        OwnField("derivative_min", round(pid.td_s / PER_MIN, 2), f"code 1f = {round(100 * pid.td_s / PER_MIN)}", "min"),
    ]


def _srs_ldc500(_: Mapping[str, Any], pid: OwnPid, __: float) -> Fields:
    values = (
        ("p_A_per_K", -round(pid.kp_A_per_K, 4), "TPGN", "A/K"),  # negative regulates, as the manual says
        ("i_per_s", round(1.0 / pid.ti_s, 4) if pid.ti_s > 0.0 else 0.0, "TIGN", "1/s"),
        ("d_s", round(pid.td_s, 4), "TDGN", "s"),
    )
    return [OwnField(name, value, f"{command} {value:g}", unit) for name, value, command, unit in values]


def _lakeshore(options: Mapping[str, Any], pid: OwnPid, limit: float) -> Fields:
    p = min(round(PER_CENT * pid.kp_A_per_K / limit, 1), 1000.0)
    i = min(round(1000.0 / pid.ti_s, 1), 1000.0) if pid.ti_s > 0.0 else 0.0
    d = round(PER_CENT * pid.td_s, 1)
    command = f"PID {options.get('output', 1)},{p:g},{i:g},{d:g}"
    return [OwnField(name, value, command, "") for name, value in (("p", p), ("i", i), ("d", d))]


_MADE: dict[str, Callable[[Mapping[str, Any], OwnPid, float], Fields]] = {
    "lakeshore": _lakeshore,
    "meerstetter": _meerstetter,
    "srs_ldc500": _srs_ldc500,
    "te_technology": _te_technology,
}
