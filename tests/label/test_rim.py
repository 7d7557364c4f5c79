"""Motions on both sides of the rim of the cylinder, against samples of their trajectories."""

import numpy as np
import pytest

import atlas
from atlas.flags import Label, Status

pytestmark = pytest.mark.usefixtures("whole_kernels")

DURATION, RATE = 60.0, 0.05


def bodies(system, count, seed):
    """Bodies whose third axis librates about the vertical, or turns around it."""
    rng = np.random.default_rng(seed)
    points = {"theta0": rng.uniform(0.005, 0.03, count), "phi0": rng.uniform(0, 6, count)}
    points |= {"A": rng.uniform(0.9, 1.0, count), "B": rng.uniform(1.0, 1.2, count)}
    points["theta_dot0"] = rng.normal(scale=0.003, size=count)
    if system == "satellite":
        zero = dict.fromkeys(("phi0", "theta_dot0"), np.zeros(count))  # of pitch, too
        return points | {"B": rng.uniform(1.1, 1.2, count), "C": rng.uniform(0.84, 0.88, count)} | zero
    return points | {
        "C": rng.uniform(0.5, 1.5, count),
        "z0": rng.choice([-1.0, 1.0], count),
        "m": rng.uniform(-4, 4, count),
    }


def judged(system, points, i, cylinder):
    """The label by the rule as it is written, from samples; None where they do not decide."""
    one = {name: values[i] for name, values in points.items()}
    motion = atlas.trajectory(system, one, duration=DURATION, samples=3001)
    theta, sine = motion.theta.values, np.sin(motion.theta.values)
    outside, change = sine >= cylinder, np.ptp(theta)
    share = outside.mean()
    normal = motion.normal_rate.values.std() / RATE
    if sine.max() < cylinder or (sine.min() < cylinder and share <= 0.5 and change <= cylinder):
        measures, kind = [normal], Label.PERMANENT_ROTATION
    else:
        psi, phi = motion.psi_dot.values[outside], motion.phi_dot.values[outside]
        measures = [np.sqrt((motion.theta_dot.values**2).mean()) / RATE, psi.std() / RATE, phi.std() / RATE]
        if sine.min() < cylinder:
            measures += [normal, change / cylinder]
        zero = min(abs(psi.mean()), abs(phi.mean())) / RATE
        kind = Label.PERMANENT_ROTATION if zero <= 1 else Label.REGULAR_PRECESSION
        if max(measures) <= 1 and abs(zero - 1) < 0.02:
            return None
    borders = [share / 0.5, change / cylinder, sine.max() / cylinder, sine.min() / cylinder, max(measures)]
    if np.abs(np.array(borders) - 1).min() < 0.02:
        return None
    return kind if max(measures) <= 1 else Label.DRIFTING


@pytest.mark.long
@pytest.mark.parametrize("system", ["satellite", "fixed_point"])
def test_labels_around_the_rim(system):
    """Of every duration and share outside, from full runs and from runs that may end early."""
    points, counted = bodies(system, 6, seed=5), np.zeros(4, int)
    wide = atlas.label_points(system, points, duration=DURATION, rate_tolerance=RATE, cylinder_tolerance=1e-5)
    for i in range(6):
        one = {name: values[i] for name, values in points.items()}
        low, high = np.sin(wide.theta_min[i].item()), np.sin(wide.theta_max[i].item())
        for share in (0.2, 0.6, 1.2):  # theta changes by less than the radius up to 1
            cylinder = high - share * min(low, 0.5 * high)
            settings = {"duration": DURATION, "rate_tolerance": RATE, "cylinder_tolerance": cylinder}
            ds = atlas.label_points(system, one, **settings)
            only = atlas.label_points(system, one, variables=["label", "status"], **settings)
            if ds.status.item() == Status.OK:
                assert ds.label.item() == only.label.item()
                if (expected := judged(system, points, i, cylinder)) is not None:
                    assert ds.label.item() == expected, (i, share)
                    counted[expected] += 1
    assert counted[Label.PERMANENT_ROTATION] > 2
    assert counted[Label.DRIFTING] > 0


def test_an_axis_that_librates_in_the_cap_is_no_regular_precession():
    """Theta from 0.0086 to 0.0506, whatever the radius of the cap."""
    body = {"A": 0.9742868368, "B": 1.1618441757, "C": 0.8618453009, "theta0": [0.01]}
    for cylinder in (0.045, 0.0505, 0.052):
        ds = atlas.label_points(
            "satellite", body, duration=60.0, rate_tolerance=RATE, cylinder_tolerance=cylinder
        )
        assert (ds.label.item(), ds.status.item()) == (Label.PERMANENT_ROTATION, Status.OK)
        assert np.isnan(ds.psi_dot_mean.item())
        assert ds.error_estimate.item() < 1e-6


def test_nodes_that_meet_a_libration_in_the_same_phase():
    """Where 0.489 of a run is outside, but more than half of the nodes, no label is given but that of most of the run."""
    top = {"A": 1.046892, "B": 1.046892, "C": 2.009858, "Mg": 1.0, "z0": 0.6434065, "N": -0.1167857, "l3": -0.4883044, "n": -1.861982,
           "m": 2.831575, "theta0": 0.00549237, "theta_dot0": 0.0014323, "psi0": 6.161211, "phi0": 3.77865}  # fmt: skip
    theta = atlas.trajectory("fixed_point", top, duration=DURATION, samples=6001).theta.values
    assert np.ptp(theta) < 0.01
    assert (np.sin(theta) > 0.01).mean() == pytest.approx(0.489, abs=2e-3)
    for method in ("rk4", "rk8"):
        settings = {"rate_tolerance": 0.02, "cylinder_tolerance": 0.01, "method": method}
        ds = atlas.label_points("fixed_point", top, duration=DURATION, **settings)
        kind = Label.PERMANENT_ROTATION if ds.status.item() == Status.OK else Label.UNRESOLVED
        assert ds.label.item() == kind
