"""Equilibria in which damped motions end, the evidence for these ends, and times of settling; see `wells`."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from ...flags import SettledBy, Status
from ...kernel.ensemble import Ensemble
from ...kernel.integrate import NODES_PER_LEVEL
from ...measure.instrument import Instrument, Measured, Run, Variable
from ...measure.rates import tolerated_error
from ...systems.base import Array, Flags, Mask, Points, System
from ...systems.gyrostat import Gyrostat
from ...systems.gyrostat.body import length

MARGIN = 10.0  # a proof adds this multiple of the energy's error to the energy
ENERGY_ROUNDING = 1e-14  # relative error of the energy
# Largest error before a motion settles: angles in rad, rates divided by the frequency bound. A larger error may change the basin.
LARGEST_ERROR = 0.01
LEVELS = 6  # number of minima, counted from the lowest, for which a time of settling is measured
END, NO_END, TIME = "end_equilibrium", -1, "settling_time"
LEVEL = "ends:level"  # key of the energy below which the body counts as settled at its equilibrium
START = "ends:start"  # key of the energy at the start plus a margin for errors
LEAST = "ends:least"  # key of the lowest potential among equilibria that are no minima
_ORDER = (
    "in the order of the potential, then of alpha and gamma, or of theta0 about a fixed point; -1 where the motion is not settled or undecided;"
    " positions of different bodies cannot be compared"
)
_TIME = (
    "the energy is then too low for more than 1e-3 rad and 1e-3 of the frame's rate, or of the natural rate at rest where that is 0; seen at"
    " every eighth node; nan where this is not reached, and at ends that are no minimum"
)
_INDEX = "0 of a minimum of the amended potential; -1 where there is no end"
_ANGLE = "nan where there is no end, and where the members of a circle of equilibria differ"
_ROWS = (
    (END, "int16", "1", "position in atlas.equilibria of", _ORDER, NO_END, ("not_settled", "equilibrium")),
    ("end_theta0", "float64", "rad", "angle from the vertical to the third body axis at", _ANGLE, 0, None),
    ("end_psi0", "float64", "rad", "precession angle at", _ANGLE, 0, None),
    ("end_phi0", "float64", "rad", "angle of proper rotation at", _ANGLE, 0, None),
    ("end_index", "int8", "1", "Morse index of", _INDEX, -1, None),
)


@dataclass(frozen=True)
class Ends(Instrument):
    """The equilibrium in which a damped gyrostat ends, found from the last state and the energy in this state."""

    needs_whole_run = True

    def every_variable(self, system: System) -> tuple[Variable, ...]:
        end = "the equilibrium in which the motion ends"
        return (
            *(
                Variable(
                    name, dtype, units, f"{text} {end}", None, comment, True, missing, positions, "settled_by"
                )
                for name, dtype, units, text, comment, missing, positions in _ROWS
            ),
            Variable("settled_by", "int8", "1", "how the end is known", SettledBy.meanings(), optional=True),
        )

    def variables(self, system: System) -> tuple[Variable, ...]:
        """Return the variables for a gyrostat with damping, else none. About a fixed point the precession angle is left out."""
        if not isinstance(system, Gyrostat) or "damping" not in system.parameters:
            return ()
        missing = "end_psi0" if len(system.equations.FRAME_VECTORS) == 1 else ""
        return tuple(variable for variable in self.every_variable(system) if variable.name != missing)

    def wanted(self, system: System, outputs: Collection[str]) -> bool:
        return super().wanted(system, outputs) or SETTLING.wanted(system, outputs)

    def measurements(self, run: Run, measured: Measured) -> dict[str, Array]:
        from ..equilibria.algebra import ANGLES, frames_of
        from .wells import SETTLED, wells_of

        assert isinstance(run.system, Gyrostat)
        with np.errstate(all="ignore"):
            (wells, row), finite = wells_of(run.system, run.points), run.integration.finite
            error = (measured["integral_drift"] + ENERGY_ROUNDING) / run.ensemble.scales[0]
            w, alpha, gamma = run.system.vectors(np.where(finite, run.integration.final_state, 0.0))
            frames, rates = frames_of(alpha, gamma), w - wells.body.turn[row, None] * gamma
            nearest, angle = wells.nearest(frames, row)
            near, damped = finite & (angle <= SETTLED), finite & (run.points["damping"] > 0)
            energy = np.where(damped, wells.energy(frames, rates, row) + MARGIN * error, np.inf)
            w, alpha, gamma = run.system.vectors(run.ensemble.origin)
            start = wells.energy(frames_of(alpha, gamma), w - wells.body.turn[row, None] * gamma, row)
            well = wells.proved(frames, energy, row, nearest, near)
            known = [well >= 0, near & (length(rates) <= SETTLED * wells.rate[row])]
        place = np.select(known, [well, nearest], NO_END)
        return {
            END: place,
            **{f"end_{name}": wells.angles[name][row, place] for name in ANGLES},
            "end_index": wells.index[row, place],
            "settled_by": np.select(known, [SettledBy.PROVED, SettledBy.MEASURED], SettledBy.NOT),
            LEVEL: wells.settled[row, place],
            START: start + MARGIN * error,
            LEAST: wells.least[row],
        }

    def needs_growth(self, run: Run, status: Flags) -> Mask:
        """Return a mask of settled points with an uncertain end. A proved end is certain if the start has less energy than all saddles."""
        measured = run.measured
        decided = (measured["settled_by"] == SettledBy.PROVED) & (measured[START] < measured[LEAST])
        return (status == Status.OK) & (measured[END] >= 0) & ~decided

    def undecided(self, run: Run) -> Mask:
        """Return a mask of the points whose ends may change if the starts have errors as large as the tolerance.

        A proved end is certain if the motion starts below the rim of its well, because the motion then never leaves the well.
        """
        from .wells import wells_of

        error = tolerated_error(run.settings, run.step_sizes, run.bound)
        grown = run.growth + np.log(error) > np.log(LARGEST_ERROR)
        where = np.flatnonzero(grown & (run.measured["settled_by"] == SettledBy.PROVED))
        if where.size:
            wells, row = wells_of(run.system, run.points)
            wells.find_rims(np.unique(row[where]))
            own = row[where], run.measured[END][where]
            grown[where] = ~(run.measured[START][where] < wells.rim[own])
        return grown

    def outcome_differs(self, run: Run, other: Run) -> Mask:
        return run.measured[END] != other.measured[END]

    def columns(self, run: Run, columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        settled, undecided = (columns["status"] == Status.OK) & (run.measured[END] >= 0), self.undecided(run)
        result = {}
        for v in self.every_variable(run.system):
            missing = v.missing if v.dtype.startswith("int") else np.nan
            result[v.name] = np.where(settled & ~undecided, run.measured[v.name], missing).astype(v.dtype)
        result["settled_by"][undecided] = SettledBy.UNDECIDED
        return result


@dataclass(frozen=True)
class Settling(Instrument):
    """Time after which the energy keeps a body near the minimum in which the body ends."""

    sums = given = LEVELS

    def every_variable(self, system: System) -> tuple[Variable, ...]:
        text = "time after which attitude and rates stay within 1e-3 of the end"
        return (Variable(TIME, "float64", "s", text, comment=_TIME, optional=True),)

    def variables(self, system: System) -> tuple[Variable, ...]:
        return self.every_variable(system) if ENDS.variables(system) else ()

    def constants(self, system: System, points: Points, start: Ensemble) -> Array:
        """Return the energies below which a body is settled at a minimum, (LEVELS, points), from the lowest. A missing minimum has nan."""
        from .wells import wells_of

        wells, row = wells_of(system, points)
        return np.ascontiguousarray(np.sort(wells.settled, axis=1)[row, :LEVELS].T)

    def measurements(self, run: Run, measured: Measured) -> dict[str, Array]:
        counts, levels = run.plugged(self)
        own = levels == measured[LEVEL]
        nodes = NODES_PER_LEVEL * counts[own.argmax(0), np.arange(own.shape[1])]
        reached = (measured[END] >= 0) & own.any(0) & (nodes <= run.integration.intervals)
        time = run.step_sizes.transient + nodes * run.step_sizes.sample_spacing
        return {TIME: np.where(reached, time, np.nan)}

    def columns(self, run: Run, columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {TIME: np.where(columns[END] >= 0, run.measured[TIME], np.nan)}


ENDS, SETTLING = Ends(), Settling()
