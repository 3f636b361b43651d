"""A number for people, of which two digits matter."""

from __future__ import annotations

LARGEST_PLAIN = 1e8  # from which on zeros are not counted any more


def rough(value: float) -> str:
    """Two digits that matter: 0.062, 2.4, 230; 4,700,000 in full."""
    rounded = float(f"{value:.2g}")
    return f"{rounded:,.0f}" if 100.0 <= abs(rounded) < LARGEST_PLAIN else f"{value:.2g}"
