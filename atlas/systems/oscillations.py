"""The frequencies of small oscillations as variables that a scene may ask for."""

from __future__ import annotations

from collections.abc import Callable

from .base import Array, DerivedVariable, Flags, Points

FREQUENCIES = ("frequency_1", "frequency_2", "frequency_3")


def frequency_variables(
    family: Callable[[Points], Flags], frequencies: Callable[[Points, Flags], Array], comment: str
) -> dict[str, DerivedVariable]:
    """The variables frequency_1, frequency_2 and frequency_3, the largest first.

    Parameters
    ----------
    family : callable
        points -> flags of their families (points,).
    frequencies : callable
        points, flags -> array (points, 3), the largest first, nan where there is none; rad per time unit.
    comment : str
        Where there is none.
    """

    def variable(i: int) -> DerivedVariable:
        def values(points: Points, duration: Array, pause: Callable[[], None]) -> Array:
            pause()
            return frequencies(points, family(points))[:, i]

        order = ("largest", "second", "third")[i]
        return DerivedVariable(
            FREQUENCIES[i],
            "rad s-1",
            f"{order} frequency of small oscillations about the steady motion",
            values,
            comment,
        )

    return {FREQUENCIES[i]: variable(i) for i in range(len(FREQUENCIES))}
