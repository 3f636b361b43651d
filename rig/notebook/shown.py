"""How a result shows itself: as lines of text, in a notebook with a figure below."""

from __future__ import annotations

from abc import abstractmethod
from html import escape
from typing import TYPE_CHECKING

from rig.core.python_words import python_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Shown:
    """What `print` and a notebook show of a result: the lines that the command line prints, and a figure."""

    lines: tuple[str, ...]

    @abstractmethod
    def plot(self) -> Figure:
        """A matplotlib Figure; `figure.savefig("figure.png")` keeps it."""

    def __str__(self) -> str:
        return python_words("\n".join(self.lines))

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        from rig.report.figures import svg_text

        svg = svg_text(self.plot())
        return f"<pre>{escape(str(self))}</pre>{svg[svg.index('<svg') :]}"
