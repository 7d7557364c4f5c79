"""Families of periodic motions as datasets."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from ... import systems
from ...errors import BadInput, shown
from ...flags import EventsComplete, FamilyEnd, Flag, OrbitStability, PeriodicEvent
from ...kernel import specialization, tangent
from ...kernel.tableaux import TANGENT_METHOD
from ...measure.instrument import Variable
from ...scene import checks
from ...scene.family import near_values, solution
from ...scene.model import Settings
from ...scene.read import parse_family
from ...scene.tables import Table, flat_columns, parameter_arrays, table
from ...store import dataset
from ...systems.base import Array, Points, check_possible, families_of, subset
from ...systems.gyrostat import Gyrostat
from ...systems.gyrostat.body import transverse_axes
from ..attitude.attitude import STARTS, start
from .families import BIRTHS, Member, Path
from .flow import Flow
from .orbits import Family, SteadyMotion

UNSTEADY = 1e-8  # largest `SteadyMotion.residual` of a steady motion, in units of its rates
ON_CIRCLE = 1e-6  # largest distance by which rounding may move a multiplier off the unit circle
# Largest relative error of a given frequency, and largest distance of a ratio of frequencies from 1 or 2 at a resonance.
NEAREST, RESONANT = 1e-3, 1e-8
MAX_ORBITS = 10_000
POLE = 1e-6  # sine of theta below which psi, phi and their rates have few digits
FAMILY, ORBIT, EVENT = ("family",), ("family", "orbit"), ("family", "event")
MULTIPLIER = (*ORBIT, "multiplier")
# Keys of the argument `motion`, and the corresponding keys of the table [family] of a scene.
SECTION = {"family": "name", "solve": "solve", "branch": "branch", "near": "near"}
_VARIABLES: dict[str, tuple[tuple[str, ...], str, str, type[Flag] | None]] = {
    "period": (ORBIT, "s", "period", None),
    "turn": (ORBIT, "rad", "turn about the axis of symmetry in a period, up to whole turns", None),
    "energy": (ORBIT, "J", "energy integral", None),
    "theta_min": (ORBIT, "rad", "least theta", None),
    "theta_max": (ORBIT, "rad", "largest theta", None),
    "orbit_stable": (ORBIT, "1", "linear stability of the orbit, momenta held", OrbitStability),
    "closing": (ORBIT, "1", "largest error at the nodes, in rad and in rates of the motion", None),
    "arc": (ORBIT, "1", "arc length from the birth", None),
    "multiplier_real": (MULTIPLIER, "1", "real part of a multiplier", None),
    "multiplier_imag": (MULTIPLIER, "1", "imaginary part of a multiplier", None),
    "frequency": (FAMILY, "rad s-1", "frequency of the small oscillations", None),
    "birth_period": (FAMILY, "s", "period of the small oscillations", None),
    "birth_energy": (FAMILY, "J", "energy integral of the steady motion", None),
    "birth_slope": (FAMILY, "s J-1", "slope of the period by the energy at the birth", None),
    "end": (FAMILY, "1", "how the family ends", FamilyEnd),
    "end_period": (FAMILY, "s", "period at the end", None),
    "end_energy": (FAMILY, "J", "energy integral at the end", None),
    "complete": (
        FAMILY,
        "1",
        "whether all events up to three periods of the birth are listed",
        EventsComplete,
    ),
    "event_kind": (EVENT, "1", "what happens along the family", PeriodicEvent),
    "event_period": (EVENT, "s", "period where it happens", None),
    "event_energy": (EVENT, "J", "energy integral where it happens", None),
    "event_arc": (EVENT, "1", "arc length where it happens", None),
}


@checks.typed
def periodic(
    system: str,
    body: Table,
    *,
    motion: Mapping[str, Any] | None = None,
    frequency: float | str = "all",
    orbits: int = 60,
    max_period: float = 12.0,
    energy: float | Sequence[float] | None = None,
    above: float | Sequence[float] | None = None,
    events: bool = True,
) -> xr.Dataset:
    """Families of periodic motions that are born from a steady motion, from there to their ends.

    Parameters
    ----------
    system : str
        "satellite" or "fixed_point".
    body : mapping of str to float, array_like or DataArray
        Parameters, as in `label_points`. Omitted parameters take their defaults, and arrays give an atlas of families.
    motion : mapping, optional
        Start values of the steady motion, and, if a family of steady motions solves some of them, also keys of the table [family]
        of a scene: ``{"family": "perp_radius", "solve": ["m"], "theta0": 0.9}``. The default is the start in `body`.
    frequency : float, int or str
        Frequency of the small oscillations about the motion, given to a relative error of 1e-3. An int is the position of the
        frequency, as in frequency_1, where 1 is the largest frequency. "all" selects every frequency.
    orbits : int
        Largest number of orbits listed for a family. If more were computed, they are thinned evenly from the birth to the end.
    max_period : float
        A family is followed until its period exceeds `max_period` times the period at its birth.
    energy, above : float or sequence of float, optional
        Energies, or their excess over the energy of the steady motion. All orbits with these energies are listed, and no others.
    events : bool
        Whether to look for bifurcations and folds, which doubles the time.

    Returns
    -------
    xarray.Dataset
        Variables over the dimensions of arrays and "family", with the parameters as coordinates: frequency, birth_period, birth_energy,
        birth_slope (dT/dh for period T and energy h), the constant momenta, end (flags), end_period, end_energy, complete (flags).
        Also over "orbit": start values for `trajectory` and `label_points`, at the largest theta; period; turn of a symmetric body
        about the third axis, after which the motion repeats; energy; theta_min; theta_max; orbit_stable (flags); closing, the error
        at the nodes; arc, the length from birth. Also over "orbit" and "multiplier": multiplier_real, multiplier_imag, without the
        multipliers that are always 1. Also over "event": event_kind (flags), event_period, event_energy, event_arc.

    Raises
    ------
    BadInput
        If the motion is not steady or has no such frequency, or if Lyapunov's theorem gives no family; for several bodies, if all fail.

    Notes
    -----
    For fixed momenta, an orbit is stable if all listed multipliers are within 1e-6 of the unit circle, or if none is listed, as for
    a symmetric top. Near an end at infinite period, bifurcations follow without end. They are listed up to the last orbit.
    """
    description = systems.get(system)
    if not isinstance(description, Gyrostat):
        raise BadInput(f"periodic: needs a system with gyrostats, such as satellite; {system} has none")
    if energy is not None and above is not None:
        raise BadInput("energy and above are both given; allowed: one of them")
    if isinstance(frequency, str) and frequency != "all":
        raise BadInput(f'frequency = {shown(frequency)}: must be a number or "all"')
    if not checks.number("max_period", max_period) > 1:
        raise BadInput(f"max_period = {max_period:g}: must be above 1")
    checks.whole_number("orbits", orbits, 1, MAX_ORBITS)
    motion = motion or {}
    family = {SECTION[key]: motion[key] for key in motion if key in SECTION}
    source = table(body, description.parameters) | {key: motion[key] for key in motion if key not in SECTION}
    names, given, _ = parameter_arrays(description, source)
    arrays = xr.broadcast(*given) or (xr.DataArray(0.0),)
    dims, shape = arrays[0].dims, arrays[0].shape
    for dim in {*dims} & {*MULTIPLIER, *EVENT, *STARTS}:
        raise BadInput(f"body: the dimension {dim} is one of the result; rename it")
    points = flat_columns(description, names, [array.values for array in arrays[: len(names)]], shape, source)
    description.check(points)
    check_possible(description, points)
    levels = [
        None if each is None else [checks.number("energy", x) for x in np.ravel(each).tolist()]
        for each in (energy, above)
    ]
    values = partial(_family_values, orbits=orbits, energy=levels[0], above=levels[1], events=events)
    rows, refusals = list[list[dict[str, Any]]](), list[BadInput]()
    for i in range(len(points["A"])):
        try:
            born = _families(description, subset(points, np.array([i])), family, frequency)
            Omega = points["Omega"][i] if "Omega" in points else None
            rows.append([values(Path(each).follow(max_period), Omega) for each in born])
        except BadInput as error:
            rows.append([])
            refusals.append(error)
    if not any(rows):
        raise refusals[0]
    ds = xr.Dataset({name: _variable(description, name, rows, dims, shape) for name in max(rows, key=len)[0]})
    own = {name for name, parameter in description.parameters.items() if parameter.start} | {*map(str, ds)}
    ds = dataset.with_parameters(ds, description, dict(zip(names, given, strict=True)), leave_out=own)
    text = specialization.source(description, TANGENT_METHOD.name, of=tangent)
    ds.attrs = dataset.provenance(
        description, Settings(method=TANGENT_METHOD.name), specialization.kernel_hash(text),
        title=f"families of periodic motions of the {description.title}", warnings=[],
    )  # fmt: skip
    return ds


def _families(
    system: Gyrostat, points: Points, table: Mapping[str, Any], frequency: float | str
) -> list[Family]:
    """Return the families of one body for the frequencies that `frequency` selects."""
    if table:
        name, solve, choice = parse_family(system, table)
        chosen = families_of(system)[name]
        points = solution(chosen, solve, points, near_values(system, chosen, solve, choice))
    if points["damping"][0]:
        raise BadInput(
            f"damping = {points['damping'][0]:g}: motions of a damped body do not repeat; set it to 0"
        )
    flow = Flow(system, points)
    steady, size = SteadyMotion(flow), np.linalg.norm(flow.start[:3])
    scale = max(float(flow.bound(flow.start)), float(size))
    if not steady.residual <= UNSTEADY * max(scale, scale**2):
        raise BadInput("motion: no steady motion starts here; family and solve make one of it")
    births, zeros = steady.births()
    if flow.symmetric and np.linalg.norm(steady.along) < POLE:
        raise BadInput("motion: the axis of symmetry is on the vertical, where turns about both are the same")
    if zeros or not births:
        raise BadInput(
            f"motion: {'an exponent is 0, families are not isolated' if zeros else 'it has no small oscillations'}"
        )
    found = [birth.frequency for birth in births]
    text, places = ", ".join(f"{each:.9g}" for each in found), range(len(found))
    if not isinstance(frequency, str):
        position = isinstance(frequency, int | np.integer)
        place = int(frequency) - 1 if position else int(np.argmin(np.abs(np.subtract(found, frequency))))
        if place not in places or not (position or abs(found[place] - frequency) <= NEAREST * found[place]):
            raise BadInput(f"frequency = {frequency:g}: the motion has {text}, in positions from 1 on")
        places = range(place, place + 1)
    result, refused = [], ""
    for k in places:
        others = np.delete(found, k) / found[k]
        # Lyapunov's theorem gives no family if another frequency is equal or twice as large.
        ratios = [n for n in (2, 1) if (np.abs(others - n) < RESONANT).any()]
        if ratios:
            refused = f"frequency = {found[k]:.9g}: Lyapunov's theorem gives no family, another frequency is {ratios[0]} times as large"
            continue
        flow = copy.copy(flow)
        flow.rate = max(abs(float(flow.body.turn[0])), float(size), found[k])
        steady = SteadyMotion(flow)
        result.append(Family(steady, steady.births()[0][k]))
    if not result:
        raise BadInput(refused)
    return result


def _family_values(
    path: Path, Omega: float | None, *, orbits: int, energy: list[float] | None, above: list[float] | None, events: bool
) -> dict[str, Any]:  # fmt: skip
    """Return the values of a family by the names of the variables."""
    family, flow, members = path.family, path.family.flow, path.members
    momenta = {name: flow.value(name, flow.start) for name in flow.momenta}
    values: dict[str, Any] = {
        "frequency": family.birth.frequency, "birth_period": family.unit, "birth_energy": family.birth_energy,
        "birth_slope": slope_at_birth(family, members), **momenta,
        **dict(zip(("end", "end_period", "end_energy"), path.end[:3], strict=True)),
    }  # fmt: skip
    if events:
        found, values["complete"] = path.events()
        rows = np.reshape(found, (-1, 4))
        values |= dict(zip(("event_kind", "event_period", "event_energy", "event_arc"), rows.T, strict=True))
    if above is not None:
        energy = [each + family.birth_energy for each in above]
    if energy is not None:
        members = [each for level in energy for each in path.at_energy(level)]
    elif len(members) > orbits:
        members = [members[i] for i in np.linspace(0, len(members) - 1, orbits).astype(int)]
    n, extremes = len(members), [_extremes(flow, each) for each in members]
    mu = np.array([each.multipliers for each in members]).reshape(n, len(members[0].multipliers) if n else 0)
    chi = np.array([each.orbit.chi for each in members])
    stable = (np.abs(np.abs(mu) - 1) < ON_CIRCLE).all(1)
    return values | {
        **_starts(flow, np.reshape([each[2] for each in extremes], (n, len(flow.start))), Omega),
        "period": [each.orbit.period for each in members], "turn": 2 * np.pi * np.rint(chi / (2 * np.pi)) - chi,
        "energy": [each.energy for each in members], "theta_min": [each[0] for each in extremes],
        "theta_max": [each[1] for each in extremes], "multiplier_real": mu.real, "multiplier_imag": mu.imag,
        "orbit_stable": np.where(stable, OrbitStability.STABLE, OrbitStability.UNSTABLE),
        "closing": [each.solution.closing for each in members], "arc": [each.arc for each in members],
    }  # fmt: skip


def slope_at_birth(family: Family, members: Sequence[Member]) -> float:
    """Return d period / d energy at amplitude 0, extrapolated from the first orbits."""
    above = np.array([each.energy - family.birth_energy for each in members[:BIRTHS]])
    if len(above) < BIRTHS or not np.abs(above).min() > 0:
        return np.nan
    slopes = (np.array([each.orbit.period for each in members[:BIRTHS]]) - family.unit) / above
    return float(np.linalg.solve((above / above[-1])[:, None] ** np.arange(BIRTHS), slopes)[0])


def _extremes(flow: Flow, each: Member) -> tuple[float, float, Array]:
    """Return the least and largest theta of an orbit, and the state at the largest theta (or nearby, if the axis is vertical there)."""
    orbit, duration, extremes = each.orbit, each.orbit.period / len(each.orbit.states), []
    paths = flow.nodes(orbit.states, duration, orbit.bound)
    step, states = duration / (paths.shape[1] - 1), paths[:, :-1].reshape(-1, len(flow.start))

    def after(time: float, state: Array) -> Array:
        return flow.nodes(state[None], time, 0.0, 1)[0, 1]

    def rise(time: float, state: Array) -> float:
        """Return the rate of cos(theta) when `time` has passed after `state`."""
        y = after(time, state)
        u1, u2, _, g1, g2, _ = flow.equations.frame_motion(y, flow.constants[:, 0])
        return float(g1 * u2 - g2 * u1)

    for sign in (1, -1):
        place = int(np.argmax(sign * states[:, -1]))
        state = states[place - int(sign * rise(1e-9 * step, states[place]) < 0)]
        ends = 1e-9 * step, step
        turns = rise(ends[0], state) * rise(ends[1], state) < 0
        extremes.append(
            after(brentq(rise, *ends, args=(state,), xtol=1e-15), state) if turns else states[place]
        )
    low, high = (np.arctan2(np.hypot(y[-3], y[-2]), y[-1]) for y in extremes)
    sines = np.hypot(*states[:, -3:-1].T)
    if np.sin(high) < POLE < sines.max():
        states = states[sines > 0.1 * sines.max()]
        extremes[1] = states[np.argmin(states[:, -1])]
    return float(low), float(high), extremes[1]


def _starts(flow: Flow, states: Array, Omega: float | None) -> dict[str, Any]:
    """Return the start values of `states` by name. If the states contain gamma but not alpha, psi0 is 0."""
    if not len(states):
        return {name: states[:, 0] for name in STARTS}
    gamma = states[:, -3:]
    alpha = states[:, 3:6] if flow.rotates else transverse_axes(gamma)[..., 0, :]
    attitude = Rotation.from_matrix(np.stack([alpha, np.cross(gamma, alpha), gamma], 1))
    values = start(
        flow.system.name, attitude=attitude, rates=states[:, :3], relative_to="inertial", Omega=Omega
    )
    return values if flow.rotates else values | {"psi0": 0 * values["psi0"]}


def _variable(
    system: Gyrostat, name: str, rows: Sequence[Sequence[Mapping[str, Any]]], dims: tuple[Any, ...], shape: tuple[int, ...]
) -> tuple[tuple[Any, ...], Array, dict[str, Any]]:  # fmt: skip
    """Return the variable `name` from the values in `rows`. Missing numbers are nan. Missing flags are 0, or LOST in the variable `end`."""
    of_starts = (ORBIT, "", "", None) if name in STARTS else (FAMILY, "N m s", f"momentum held, {name}", None)
    own, unit, text, flags = _VARIABLES.get(name, of_starts)
    values = [[np.asarray(family[name], float) for family in families] for families in rows]
    inner = np.max([each.shape for families in values for each in families], axis=0).astype(int)
    empty = np.nan if flags is None else FamilyEnd.LOST if name == "end" else 0
    full = np.full((len(rows), max(map(len, rows)), *inner), empty, float if flags is None else np.int8)
    for i, families in enumerate(values):
        for j, each in enumerate(families):
            place: Any = (i, j, *map(slice, each.shape))
            full[place] = each
    if name in STARTS:
        text, unit = system.parameters[name].meaning, system.parameters[name].unit
    attributes = Variable(name, "int8", unit, text, flags.meanings() if flags else None).attributes()
    return (*dims, *own), full.reshape(*shape, *full.shape[1:]), attributes
