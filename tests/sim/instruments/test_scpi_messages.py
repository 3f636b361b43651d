"""SCPI messages taken apart."""

from __future__ import annotations

import pytest

from sim.instruments.scpi import CommandTree, ScpiError, boolean, number, split_outside_quotes


@pytest.fixture
def tree() -> CommandTree:
    tree = CommandTree()
    for pattern in (
        ":DATA:FRESh",
        "[:SENSe#]:FRESistance:RANGe[:UPPer]",
        "[:SENSe#]:FRESistance:NPLCycles",
        "*IDN",
    ):
        tree.define(pattern, set=lambda parameters: ",".join(parameters), ask=lambda _, name=pattern: name)
    return tree


def run(tree: CommandTree, message: str) -> list[str | None]:
    return [call() for call in tree.parse(message)]


@pytest.mark.parametrize(
    "header",
    [
        "FRES:RANG",
        ":fresistance:range:upper",
        "SENS:FRES:RANG:UPP",
        ":SENSE1:FRES:RANG",
        "sens1:FRESISTANCE:rang",
    ],
)
def test_long_and_short(tree: CommandTree, header: str) -> None:
    assert run(tree, f"{header} 1, 'a;b,c' ") == ["1,'a;b,c'"]


@pytest.mark.parametrize("header", ["FRESI:RANG", "RANG", ":SENS2:FRES:RANG", "FRES", "FRES:RANG:UPP:X", "IDN"])
def test_no_other_spelling(tree: CommandTree, header: str) -> None:
    with pytest.raises(ScpiError, match="-113"):
        run(tree, header + " 1")


def test_words_with_one_short_form_in_different_places(tree: CommandTree) -> None:
    assert run(tree, "DATA:FRES?;:FRES:NPLC?") == [":DATA:FRESh", "[:SENSe#]:FRESistance:NPLCycles"]


def test_paths(tree: CommandTree) -> None:
    names = ["[:SENSe#]:FRESistance:RANGe[:UPPer]", "*IDN", "[:SENSe#]:FRESistance:NPLCycles"]
    assert run(tree, ":SENS:FRES:RANG?;*IDN?;NPLC?") == names
    assert run(tree, ":SENS:FRES:RANG?;*IDN?;:FRES:NPLC?") == names
    assert run(tree, "SENS:FRES:RANG?;*IDN?;SENS:FRES:NPLC?") == names


def test_split() -> None:
    assert split_outside_quotes("a;'b;c';\"d;'e\";f", ";") == ["a", "'b;c'", '"d;\'e"', "f"]


def test_parameters() -> None:
    assert number(("min",), 1.0, 2.0, 1.5) == 1.0
    assert number(("DEFault",), 1.0, 2.0, 1.5) == 1.5
    assert number(("1.25E0",), 1.0, 2.0, 1.5) == 1.25
    assert boolean(("on",)) is True
    assert boolean(("0",)) is False
    for parameters in ((), ("1", "2")):
        with pytest.raises(ScpiError):
            number(parameters, 0.0, 9.0, 0.0)
