"""Rules that may prove the label of one start, and the loop over many starts. Momenta are tried before the energy."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...measure import instrument
from ...systems.base import Array, Points, shape_of
from ...systems.gyrostat import Gyrostat
from ...theory.compiled import of_system
from ...theory.point import dot, fmin, greatest, minus, scaled, times
from .bounds import BOUND, PROOFS_OF, Direction, GyrostatBody, Proof, Tolerances, label_of, largest_deviation
from .energy import attitude, in_space, symmetric, upright
from .top import top


class LabelProofs(NamedTuple):
    """Labels that are proved for every duration, and their kinds of proof, in the system's frame and in inertial space."""

    kind: int  # value of `Proof`
    label: int  # 0 if no label is proved
    inertial_kind: int
    inertial_label: int
    bound: float  # half the width of the widest proved range of a rate


def prove_in_space(body, w, gamma, is_axial, tolerances):
    """Return the labels that can be proved for a body with a fixed point."""
    proofs = LabelProofs(Proof.NONE, 0, Proof.NONE, 0, np.nan)
    if body.turn != 0:
        return proofs
    if is_axial:
        proofs = with_bounds(proofs, Proof.MOMENTA, top(body, w, gamma, tolerances), 0.0, tolerances)
    inertia = body.inertia
    n = dot(times(inertia, w), gamma) / dot(times(inertia, gamma), gamma)
    if proofs.kind == Proof.NONE and is_slow(body, w, scaled(n, gamma), tolerances):
        proofs = with_bounds(proofs, Proof.ENERGY, in_space(body, w, gamma), 0.0, tolerances)
    return proofs


def prove_in_frame(body, w, alpha, gamma, is_axial, frame_rate, tolerances):
    """Return the labels that can be proved for a body in a frame with the directions alpha and gamma."""
    proofs = LabelProofs(Proof.NONE, 0, Proof.NONE, 0, np.nan)
    if is_axial:
        # No minimum is isolated, because turns about the axis keep the energy. The other rules need an isolated minimum.
        bounds = symmetric(body, w, alpha, gamma)
        return with_bounds(proofs, Proof.ENERGY, bounds, frame_rate, tolerances)
    if not (body.damping >= 0 and is_slow(body, w, scaled(body.turn, gamma), tolerances)):
        return proofs
    if np.hypot(gamma[0], gamma[1]) < tolerances.angle:
        bounds = upright(body, w, alpha, gamma)
        proofs = with_bounds(proofs, Proof.ENERGY, bounds, frame_rate, tolerances)
    return with_bounds(proofs, Proof.ENERGY, attitude(body, w, alpha, gamma), frame_rate, tolerances)


def is_slow(body, w, turn, tolerances):
    """Whether a rotation at a rate within the tolerance can have the initial kinetic energy. If not, the energy proves no label."""
    u = minus(w, turn)
    return dot(times(body.inertia, u), u) <= greatest(body.inertia) * tolerances.rate**2


def with_bounds(proofs, kind, bounds, frame_rate, tolerances):
    """Add to `proofs` what the bounds of one more rule prove. The first proof of a label counts."""
    deviation = largest_deviation(bounds, tolerances)
    label = label_of(bounds, deviation, tolerances, 0.0)
    inertial = label_of(bounds, deviation, tolerances, frame_rate)
    own, inertial_kind = kind if label else 0, kind if inertial else 0
    if proofs.kind:
        own, label = proofs.kind, proofs.label
    if proofs.inertial_kind:
        inertial_kind, inertial = proofs.inertial_kind, proofs.inertial_label
    return LabelProofs(own, label, inertial_kind, inertial, fmin(proofs.bound, deviation))


class Bodies(NamedTuple):
    """Bodies, as in `GyrostatBody`, and states at the starts of runs. Vectors are arrays (3, points)."""

    w: Array
    alpha: Array
    gamma: Array
    inertia: Array
    rotor: Array
    radial_field: Array
    velocity_field: Array
    normal_field: Array
    turn: Array  # This array and the next ones have the shape (points,).
    radial_gradient: Array
    normal_gradient: Array
    damping: Array

    @classmethod
    def of(cls, system: Gyrostat, points: Points) -> Bodies:
        body, one = system.body(points), np.ones(shape_of(points))
        w, alpha, gamma = (vector.T * one for vector in system.start(points))
        vectors = body.inertia, body.rotor, body.alpha.field, body.beta.field, body.gamma.field
        columns = (np.array(vector.T * one) for vector in vectors)
        numbers = body.turn, body.alpha.gradient, body.gamma.gradient, body.damping
        return cls(w, alpha, gamma, *columns, *(number * one for number in numbers))


def body_at(bodies, i):
    radius = Direction(bodies.radial_gradient[i], load(bodies.radial_field, i))
    velocity = Direction(0.0, load(bodies.velocity_field, i))
    normal = Direction(bodies.normal_gradient[i], load(bodies.normal_field, i))
    inertia, rotor = load(bodies.inertia, i), load(bodies.rotor, i)
    return GyrostatBody(inertia, rotor, bodies.turn[i], radius, velocity, normal, bodies.damping[i])


def load(block, i):
    return block[0, i], block[1, i], block[2, i]


def prove_all(bodies, axial, frame_rate, single, rate, angle, kinds, labels, bound):
    """Write the proofs of every start into `kinds`, `labels` and `bound`. If `single` is true, only gamma is at rest in the frame."""
    for i in range(bound.size):
        w, alpha, gamma = load(bodies.w, i), load(bodies.alpha, i), load(bodies.gamma, i)
        body = body_at(bodies, i)
        tolerances = Tolerances(rate[i], angle)
        if single:
            proofs = prove_in_space(body, w, gamma, axial[i], tolerances)
        else:
            proofs = prove_in_frame(body, w, alpha, gamma, axial[i], frame_rate[i], tolerances)
        kinds[0, i], labels[0, i], bound[i] = proofs.kind, proofs.label, proofs.bound
        kinds[1, i], labels[1, i] = proofs.inertial_kind, proofs.inertial_label


@np.errstate(all="ignore")
def prove_points(
    system: Gyrostat, points: Points, tolerances: instrument.Tolerances, in_machine_code: bool = False
) -> dict[str, NDArray[Any]]:
    """Return the variables of the instrument, and proved labels under the names of predicted labels. Unproved labels are 0."""
    bodies, one = Bodies.of(system, points), np.ones(shape_of(points))
    names = ["label"] if system.frame_rate is None else ["label", "label_inertial"]
    frame_rate = one if system.frame_rate is None else system.frame_rate(points) * one
    kinds, labels = np.zeros((2, 2, one.size), np.int8)
    bound, single = np.empty(one.size), len(system.equations.FRAME_VECTORS) == 1
    axial, rate = system.conserves_axial_momentum(points) & (one > 0), tolerances.rate * one
    loop = of_system(prove_all, system, in_machine_code)
    loop(bodies, axial, frame_rate, single, rate, tolerances.angle, kinds, labels, bound)
    result: dict[str, NDArray[Any]] = {BOUND: bound}
    for name, kind, label in zip(names, kinds, labels, strict=False):
        result |= {PROOFS_OF[name]: kind, name.replace("label", "predicted"): label}
    return result
