"""A controller's own PID in the instrument's own fields: what each gain is called there, in which unit, how fine.

    Kp in A/K, Ti and Td in s  ->  options of the driver, which it sets and reads back, and commands that do it

A driver whose instrument has a PID has `own_fields` for this direction and `own_pid` for the other. The law inside each
instrument is not verified: a textbook PID is taken.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from compensator.control.pid import OwnPid
from rig.drivers.controller import OwnField
from rig.drivers.registry import controller_class

Fields = list[OwnField]


def own_fields(driver: str, options: Mapping[str, Any], pid: OwnPid, limit: float) -> Fields | None:
    """Return the fields of a driver's instrument; None if it has no PID of its own, or one that is not known here.

    limit: the current (A, or share of full drive) that is 100 % of the output.
    """
    make = getattr(controller_class(driver), "own_fields", None)
    return None if make is None else list(make(options, pid.kp_A_per_K, pid.ti_s, pid.td_s, limit))


def configured_pid(driver: str, options: Mapping[str, Any], limit: float) -> OwnPid | None:
    """Return the PID that a configuration's options set; None if they do not give all of it."""
    fields = own_fields(driver, options, OwnPid(1.0, 1.0), limit)
    if fields is None or any(options.get(field.option) is None for field in fields):
        return None
    return set_pid([replace(field, value=float(options[field.option])) for field in fields], driver, limit)


def set_pid(fields: Fields, driver: str, limit: float) -> OwnPid:
    """Return the PID that the fields set."""
    given = {field.option: field.value for field in fields}
    return OwnPid(*controller_class(driver).own_pid(limit, **given))
