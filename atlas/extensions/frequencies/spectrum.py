"""Frequencies of one motion, which are the strongest lines in the spectra of its angles.

The method is numerical analysis of fundamental frequencies (Laskar 1993, doi 10.1016/0167-2789(93)90210-R). The maximum of the
windowed Fourier integral gives a frequency with an error far below the spacing of a discrete Fourier transform. All lines found so far are
fitted together, and the next line is found in the residual. Packages for this method have restrictive licences and are not used.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal.windows import hann

from ...analysis.degrees import in_rad
from ...analysis.metadata import system_of
from ...errors import BadInput, shown
from ...label.trajectory import MAX_SAMPLES
from ...scene.checks import whole_number
from ...systems.base import Array

Signal = NDArray[np.complex128]

MAX_LINES = 1000  # largest number of spectral lines of a signal

# A line above this fraction of the Nyquist frequency of the samples may be the alias of a faster line.
MAX_SHARE_OF_NYQUIST = 0.8
# A line is compared with the derivative of the signal if its amplitude exceeds this fraction of the largest value of the signal.
MIN_AMPLITUDE = 1e-5
PASSES = 2  # refinements of all lines after each new line


def frequencies(
    ds: xr.Dataset,
    lines: int = 3,
    *,
    samples: int = 8193,
    trajectory: xr.Dataset | None = None,
    degrees: bool = False,
    **coords: float,
) -> xr.Dataset:
    """Strongest lines in the spectra of one motion, refined beyond the resolution of a Fourier transform.

    Parameters
    ----------
    lines : int
        Number of lines of each signal.
    samples : int
        Number of instants of the motion. More instants are taken if a line is too fast for this number.
    trajectory : Dataset, optional
        A motion from `atlas.trajectory`, in place of the point's; its samples must resolve the lines.
    degrees : bool, optional
        Take the angles of the point in degrees; the result is in rad.
    **coords : float
        The point, as for `nearest`.

    Returns
    -------
    Dataset
        Over "signal" and "line", the strongest line first: frequency (rad per time unit, signed for psi and phi),
        amplitude, and share of the variance. Signal "theta" is cos(theta), "psi" and "phi" are
        sin(theta) e^(i psi) and sin(theta) e^(i phi) in the frame, each minus its mean. For a system with observables the
        signals are the observables, with amplitudes in their units. Lines that are not found are nan.

    Notes
    -----
    The lines of a regular motion are the same in both halves of a run; the lines of a chaotic motion change.
    """
    whole_number("lines", lines, 1, MAX_LINES)
    if trajectory is None and not coords and "time" in ds.dims:
        trajectory = ds
    if trajectory is None:
        return frequencies_of_point(
            lambda count: ds.atlas.trajectory(samples=count, degrees=degrees, **coords), lines, samples
        )
    if "time" not in getattr(trajectory, "dims", ()):
        raise BadInput(f"trajectory = {shown(trajectory)}: must be a dataset from atlas.trajectory")
    return frequencies_of_motion(trajectory, lines)


def frequencies_of_motion(trajectory: xr.Dataset, lines: int) -> xr.Dataset:
    """Return the strongest lines of each signal of a motion, or raise BadInput if there are too few samples."""
    trajectory = in_rad(trajectory)
    ds, (name, fastest) = _lines(trajectory, lines)
    if fastest:
        raise BadInput(
            f"samples = {trajectory.sizes['time']}: too few for a line of {name} at {fastest:g} rad per time unit; take"
            f" {_samples_for(trajectory, fastest)}"
        )
    return ds


def frequencies_of_point(trajectory: Callable[[int], xr.Dataset], lines: int, samples: int) -> xr.Dataset:
    """Return the strongest lines of a motion. `trajectory` is called with more `samples` until the samples resolve the lines."""
    while True:
        motion = trajectory(samples)
        ds, (_, fastest) = _lines(motion, lines)
        needed = _samples_for(motion, fastest) if fastest else samples
        if needed <= samples or needed > MAX_SAMPLES:
            return ds if not fastest else frequencies_of_motion(motion, lines)
        samples = needed


def _samples_for(trajectory: xr.Dataset, frequency: float) -> int:
    """Return the number of samples of a motion for which a frequency is well below the Nyquist frequency."""
    duration = float(trajectory["time"][-1] - trajectory["time"][0])
    return 1 + math.ceil(1.25 * frequency * duration / (MAX_SHARE_OF_NYQUIST * np.pi))


def _lines(trajectory: xr.Dataset, lines: int) -> tuple[xr.Dataset, tuple[str, float]]:
    """Return the strongest lines, and the signal and frequency of the fastest unresolved line, or ("", 0) if all lines are resolved."""
    time = trajectory["time"].values
    columns = _signals(trajectory)
    dims, shape = ("signal", "line"), (len(columns), lines)
    frequency, amplitude, share = (np.full(shape, np.nan) for _ in range(3))
    nyquist, too_fast = np.pi / (time[1] - time[0]), ("", 0.0)
    for i, (name, (signal, slope)) in enumerate(columns.items()):
        weight = hann(time.size)
        weight /= weight.sum()
        power = float(weight @ np.abs(signal - weight @ signal) ** 2)
        real = name not in ("psi", "phi")
        line_frequencies, coefficients = spectral_lines(time, signal, lines, real=real)
        count = len(line_frequencies)
        frequency[i, :count], amplitude[i, :count] = line_frequencies, np.abs(coefficients)
        share[i, :count] = np.abs(coefficients) ** 2 / power * (0.5 if real else 1.0)
        # A line that is too fast for the samples appears at another frequency, or as a constant. The amplitude of a line in the
        # derivative is the amplitude in the signal times i times the true frequency. Weak lines are not checked.
        candidates = [*line_frequencies, 0.0]
        fitted, slopes = (_fit(time, each, candidates, weight, real)[0] for each in (signal, slope))
        strong = np.abs(fitted) > MIN_AMPLITUDE * np.abs(signal).max()
        true = np.divide(slopes, 1j * fitted, out=np.array(candidates, complex), where=strong).real
        fastest = max(np.abs(true).max(), np.abs(line_frequencies[:1]).max(initial=0.0))
        if fastest > max(MAX_SHARE_OF_NYQUIST * nyquist, too_fast[1]):
            too_fast = name, float(fastest)
    ds = xr.Dataset(
        {
            "frequency": (dims, frequency, {"units": "rad s-1", "long_name": "frequency, signed"}),
            "amplitude": (dims, amplitude, {"long_name": "amplitude, in the unit of the signal"}),
            "share": (dims, share, {"units": "1", "long_name": "share of the variance"}),
        },
        coords={"signal": list(columns), "line": np.arange(lines)},
        attrs=trajectory.attrs,
    )
    return ds, too_fast


def _signals(trajectory: xr.Dataset) -> dict[str, tuple[Signal, Signal]]:
    """Return by name each signal of a motion and its time derivative. Signals are observables, or functions of theta, psi and phi."""
    system = system_of(trajectory) if "atlas_system" in trajectory.attrs else None
    if system is not None and system.observables:
        # Each state is moved backward and forward by a short step of time. Central differences then give the time derivatives.
        points = {
            name: np.array([float(trajectory.get(f"{name}_start", trajectory.get(name, np.nan)))])
            for name in system.parameters
        }
        equations, constants = system.equations, system.constants(points)
        state = np.array([trajectory[name].values for name in equations.STATE])
        time = 1e-5 * float(trajectory["step"])
        change = time * np.array(np.broadcast_arrays(*equations.rhs(state, constants)))
        signals = {}
        for o in system.observables:
            low, high = (
                moved[equations.STATE.index(o.name)] if o.name in equations.STATE else getattr(equations, o.name)(moved, constants)
                for moved in (state - change, state + change)
            )  # fmt: skip
            signals[o.name] = trajectory[o.name].values + 0j, (high - low) / (2 * time) + 0j
        return signals
    theta, theta_dot = trajectory["theta"].values, np.nan_to_num(trajectory["theta_dot"].values)
    signals = {"theta": (np.cos(theta) + 0j, -np.sin(theta) * theta_dot + 0j)}
    for name in ("psi", "phi"):
        # On the vertical the angle is nan, and sin(theta) is 0.
        angle, rate = (np.nan_to_num(trajectory[key].values) for key in (name, f"{name}_dot"))
        turn = np.exp(1j * angle)
        signals[name] = np.sin(theta) * turn, (np.cos(theta) * theta_dot + 1j * np.sin(theta) * rate) * turn
    return signals


def spectral_lines(time: Array, signal: Signal, count: int, *, real: bool = False) -> tuple[Array, Signal]:
    """Find the frequencies w (rad per unit of time) and amplitudes c of a sum of c exp(i w t), in the order of extraction.

    Fewer than `count` frequencies are found if only rounding errors remain. If `real` is true, w >= 0 and c are amplitudes of cosines.
    """
    weight = hann(time.size)
    weight /= weight.sum()
    grid = 2 * np.pi * np.fft.fftfreq(2 * time.size, time[1] - time[0])
    frequencies: list[float] = []
    coefficients, residual = _fit(time, signal, frequencies, weight, real)
    scale = float(np.abs(signal).max())
    while len(frequencies) < count:
        spectrum = np.abs(np.fft.fft(residual * weight, 2 * time.size))
        if real:
            spectrum[grid < 0] = 0.0
        highest = int(np.argmax(spectrum))
        if spectrum[highest] <= 1e-12 * scale:
            break
        frequencies.append(_refine(time, residual * weight, grid[highest], grid[1]))
        coefficients, residual = _fit(time, signal, frequencies, weight, real)
        # Lines shift each other's maxima. Each line is therefore refined again after the other lines are subtracted.
        for _ in range(PASSES):
            for i, frequency in enumerate(frequencies):
                half = coefficients[[i]] / (2 if real else 1)  # a cosine has two waves of half its amplitude
                single = (residual + np.exp(1j * np.outer(time, [frequency])) @ half) * weight
                frequencies[i] = _refine(time, single, frequency, grid[1])
                coefficients, residual = _fit(time, signal, frequencies, weight, real)
    return np.array(frequencies), coefficients


def _refine(time: Array, weighted: Signal, guess: float, width: float) -> float:
    """Return the frequency of the maximum of the Fourier integral within `width` of `guess`."""

    def negative(frequency: float) -> float:
        return -abs(complex(np.exp(-1j * frequency * time) @ weighted))

    result = minimize_scalar(
        negative, bounds=(guess - width, guess + width), method="bounded", options={"xatol": 1e-10 * width}
    )
    return float(result.x)


def _fit(
    time: Array, signal: Signal, frequencies: list[float], weight: Array, real: bool
) -> tuple[Signal, Signal]:
    """Fit all lines and a constant by weighted least squares. Return the coefficients of the lines, and the residual."""
    waves, count = np.exp(1j * np.outer(time, frequencies)), len(frequencies)
    basis = np.concatenate([waves, waves.conj() if real else waves[:, :0], np.ones((time.size, 1))], axis=1)
    weighted = basis.conj().T * weight
    solution = np.linalg.lstsq(weighted @ basis, weighted @ signal, rcond=1e-12)[0]
    fitted = np.asarray(solution, np.complex128)
    residual = np.asarray(signal - basis @ fitted, np.complex128)
    return (2 * fitted[:count] if real else fitted[:count]), residual
