"""Branches of relative equilibria against a parameter, as a dataset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from ...errors import BadInput
from ...flags import BifurcationKind, Completeness
from ...measure.instrument import Variable
from ...scene import grid
from ...scene.checks import typed
from ...scene.model import SCHEMA, Duration, Scene
from ...scene.read import scene_from
from ...scene.tables import check_written
from ...store import dataset
from ...systems.base import Array, Points, check_possible, possible_body
from ...systems.gyrostat import Gyrostat
from ..equilibria.algebra import attitudes, body_at_rest
from ..equilibria.dataset import UNUSED, attributes
from .bifurcations import BodyFamily, Branches, follow

# Variables that `equilibria` does not give. A variable fold_<name> that is missing here has the attributes of <name>.
_OWN = Variable.table(
    Variable("index_sum", "float64", "1", "sum of (-1)^index over the equilibria"),
    Variable("fold_kind", "int8", "1", "kind of bifurcation", BifurcationKind.meanings()),
    Variable("fold_direction", "float64", "1", "rotation vector in body axes along which solutions separate"),
    Variable("fold_branch", "int64", "1", "branches that meet; -1: no more"),
)


@typed
def branches(
    system: str,
    body: Mapping[str, float],
    *,
    along: Mapping[str, Sequence[float]],
    ties: Mapping[str, str] | None = None,
) -> xr.Dataset:
    """Branches of relative equilibria, or of permanent rotations about the vertical, against one parameter.

    All solutions are computed at every value, and solutions of neighbouring values are joined. An interval in which a solution
    begins, ends or changes its stability is divided until Newton's method finds each bifurcation in the interval.

    Parameters
    ----------
    system : str
        "satellite" or "fixed_point".
    body : mapping of str to float
        Parameter -> number; omitted parameters take their defaults. Of the start values only n of the fixed_point, the rate of
        rotation, has an effect.
    along : mapping of str to sequence of float
        Two or more values of one parameter, or of another name that `ties` refer to.
    ties : mapping of str to str, optional
        Parameter -> arithmetic in the other names, such as ``{"B": "1 + 0.5 * A"}``, as in a scene.

    Returns
    -------
    Dataset
        Variables over "branch" and the parameter are those of `equilibria`, with nan (index -1) where a branch does not exist.
        The index is the number of directions in which the amended potential decreases if the rate of rotation is constant. Along
        the parameter are completeness (flags), equilibrium_count and index_sum, nan where they are not certain. The index_sum is
        the sum of (-1)^index, which is 0 for a satellite without symmetry, and 2 with an axis of symmetry and for permanent
        rotations. The dimension "fold" has the bifurcations in the order of the parameter. Its variables are ``fold_<parameter>``,
        fold_error, fold_kind (flags), and angles, vectors and potential with the prefix ``fold_``. The solutions separate along
        the rotation vector fold_direction. The variable fold_branch has the branches that meet.

    Raises
    ------
    BadInput
        For names, values and ties that a scene does not allow, for a parameter that changes no body, where no body is possible,
        and where every value is a bifurcation.

    Notes
    -----
    No branch is missed at a given value. A branch with two folds between two values is found if the tangents at one value do
    not predict the solutions at the other value. A closed branch between two values is found if complex solutions at one value
    become real, to first order, before the other value.
    """
    return branches_of_scene(scene_of("branches", system, body, along, ties))


def scene_of(
    title: str,
    system: str,
    body: Mapping[str, float],
    axes: Mapping[str, Sequence[float]],
    ties: Mapping[str, str] | None,
) -> Scene:
    """Return the scene with the parameters `body`. For each varied parameter, `axes` has a list of values."""
    for name, values in axes.items():
        check_written(f"axes.{name}.values", values)
    table = {
        "schema": SCHEMA, "title": title, "system": system, "fixed": dict(body), "ties": dict(ties or {}),
        "axes": {name: {"values": np.asarray(values).tolist()} for name, values in axes.items()},
        "integration": {"duration": 1.0},
    }  # fmt: skip
    return scene_from(table, folder=None)


def empty_dataset(scene: Scene) -> xr.Dataset:
    """Return a dataset with the parameters of a scene, without motions and without start values that the scene does not set."""
    ds = dataset.dataset(replace(scene, outputs=()), {})
    starts = {name for name, parameter in scene.system.parameters.items() if parameter.start}
    ds = ds.drop_vars(starts - {*scene.axes, *scene.fixed, *scene.ties}, errors="ignore")
    ds.attrs = {"title": scene.title, "references": scene.system.reference, "atlas_system": scene.system.name}
    return ds


def branches_of_scene(scene: Scene) -> xr.Dataset:
    """Return the branches of the bodies of a scene along its only axis, in the form that `branches` returns."""
    system = scene.system
    if len(scene.axes) != 1:
        raise BadInput(f"branches: needs one axis, found {', '.join(scene.axes)}")
    if not isinstance(system, Gyrostat):
        raise BadInput(f"branches: of the {system.name} no relative equilibria are known")
    ((name, axis),) = scene.axes.items()
    values = np.sort(axis.values)
    scene = replace(scene, axes={name: replace(axis, values=values)}, duration=Duration(1.0), nudge={})
    sample = grid.points_at(scene, {name: values})
    check_possible(system, sample.base)
    possible = np.flatnonzero(possible_body(system, sample.base) & (sample.reason != grid.Reason.NO_VALUE))
    if possible.size < 2 or scene.points or axis.offset_from_family:
        raise BadInput("branches: needs an axis on which two values or more have a body that is possible")

    def points(values: Array) -> Points:
        return grid.points_at(scene, {name: values[:, 0]}).base

    some = values[possible]
    body = body_at_rest(system, points(some[:, None]))
    if not any(np.ptp(each, axis=0).any() for each in (*body[:3], *body.alpha, *body.beta, *body.gamma)):
        raise BadInput(f"branches: {name} changes no equilibria; take a parameter of body or field")
    family = BodyFamily.of(system, points, some[:, None])
    result = follow(family, some, possible - np.arange(possible.size), stability=True)
    if not result.total:
        raise BadInput(
            f"branches: each of these values of {name} is a bifurcation, or its equilibria are not isolated; add values between them"
        )
    variables = _variables(name, values.size, possible, family, result)
    ds = empty_dataset(scene)
    ds = ds.drop_vars([each for each in variables if each in ds]).assign(variables)
    parameter = ds[name].attrs
    of_axis = {f"fold_{name}": parameter, "fold_error": {"units": parameter["units"]}}
    for each in variables:
        ds[each].attrs = _OWN.get(each) or of_axis.get(each) or attributes(each.removeprefix("fold_"))
    return ds


def _variables(
    along: str, size: int, possible: np.ndarray, family: BodyFamily, result: Branches
) -> dict[str, tuple[tuple[str, ...], np.ndarray]]:
    """Return the variables of branches and bifurcations. `possible` has the indices of the values with a possible body."""
    node, place = np.nonzero(result.branch >= 0)
    variables = {}
    for name, column in result.listed.items():
        dims = ("branch", along, "body_axis")[column.ndim == 1 :][: column.ndim]
        shape = (result.total, size, 3)[column.ndim == 1 :][: column.ndim]
        full = np.full(shape, UNUSED.get(name, np.nan if column.dtype.kind == "f" else 0), column.dtype)
        if column.ndim == 1:
            full[possible] = column
        else:
            full[result.branch[node, place], possible[node]] = column[node, place]
        variables[name] = dims, full
    index, points = variables["index"][1], result.points
    unknown = np.isin(variables["completeness"][1], (Completeness.NEAR_BIFURCATION, Completeness.NOT_LISTED))
    signs = np.where(index >= 0, (-1) ** np.maximum(index, 0), 0)
    for count, values in (("equilibrium_count", index >= 0), ("index_sum", signs)):
        variables[count] = (along,), np.where(unknown, np.nan, values.sum(0))
    frames = np.array([point.frame for point in points]).reshape(-1, 3, 3)
    where = np.array([point.value for point in points])
    potential = body_at_rest(family.system, family.points(where[:, None])).potential(
        frames[:, 0], frames[:, 2]
    )
    attitude = attitudes(frames) | {"potential": potential}
    columns = {name: column for name, column in attitude.items() if name in variables} | {
        along: where,
        "kind": np.array([point.kind for point in points], np.int8),
        "error": np.array([point.error for point in points]),
        "direction": np.array([point.direction for point in points]).reshape(-1, 3),
    }
    for name, column in columns.items():
        variables[f"fold_{name}"] = ("fold", "body_axis")[: column.ndim], column
    width = max(map(len, result.meeting), default=0)
    meeting = np.array([[*row, *(width - len(row)) * [-1]] for row in result.meeting], int)
    return variables | {"fold_branch": (("fold", "meeting"), meeting.reshape(len(points), width))}
