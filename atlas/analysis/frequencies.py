"""Frequencies of one motion: the strongest lines in the spectra of its angles.

The numerical analysis of fundamental frequencies (Laskar 1993, doi 10.1016/0167-2789(93)90210-R): the maximum of the windowed
Fourier integral is refined to far below the distance of two lines of a discrete transform, all lines found so far are
fitted together, and the next one is looked for in the residual. The packages for this
method have licences that a user of this one may not be able to accept, so that it is written here on top of SciPy.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal.windows import hann

from ..errors import BadInput
from ..systems.base import Array
from .metadata import system_of

Signal = NDArray[np.complex128]

# Share of the largest frequency of the samples beyond which a line may be that of a faster motion.
MAX_SHARE_OF_NYQUIST = 0.8
# How often all lines are refined after each new one.
PASSES = 2


def frequencies(trajectory: xr.Dataset, lines: int) -> xr.Dataset:
    """Strongest lines of a motion; see `Atlas.frequencies`.

    Parameters
    ----------
    trajectory : Dataset
        As `atlas.trajectory` returns it.
    lines : int
        Number of lines of each signal.

    Returns
    -------
    Dataset
        Over (signal, line), see `Atlas.frequencies`.

    Raises
    ------
    BadInput
        Where the samples are too few for the fastest line.
    """
    time = trajectory["time"].values
    columns = _signals(trajectory)
    shape = (len(columns), lines)
    frequency, amplitude, share = (np.full(shape, np.nan) for _ in range(3))
    nyquist = np.pi / (time[1] - time[0])
    for i, (name, signal) in enumerate(columns.items()):
        weight = hann(time.size)
        weight /= weight.sum()
        power = float(weight @ np.abs(signal - weight @ signal) ** 2)
        real = name not in ("psi", "phi")
        line_frequencies, coefficients = spectral_lines(time, signal, lines, real=real)
        count = len(line_frequencies)
        frequency[i, :count], amplitude[i, :count] = line_frequencies, np.abs(coefficients)
        share[i, :count] = np.abs(coefficients) ** 2 / power * (0.5 if real else 1.0)
        if count and np.abs(line_frequencies[0]) > MAX_SHARE_OF_NYQUIST * nyquist:
            raise BadInput(
                f"samples = {time.size}: too few for a line of {name} at {line_frequencies[0]:g} rad per time unit; take"
                f" {4 * time.size}"
            )
    return xr.Dataset(
        {
            "frequency": (
                ("signal", "line"),
                frequency,
                {"units": "rad s-1", "long_name": "frequency, signed"},
            ),
            "amplitude": (
                ("signal", "line"),
                amplitude,
                {"long_name": "amplitude, in the unit of the signal"},
            ),
            "share": (("signal", "line"), share, {"units": "1", "long_name": "share of the variance"}),
        },
        coords={"signal": list(columns), "line": np.arange(lines)},
        attrs=trajectory.attrs,
    )


def _signals(trajectory: xr.Dataset) -> dict[str, Signal]:
    """The signals of a motion by name: those of theta, psi and phi, or the observables of the system."""
    observables = system_of(trajectory).observables if "atlas_system" in trajectory.attrs else ()
    if observables:
        return {o.name: trajectory[o.name].values.astype(np.complex128) for o in observables}
    return {name: _signal(trajectory, name) for name in ("theta", "psi", "phi")}


def _signal(trajectory: xr.Dataset, name: str) -> Signal:
    """cos theta or sin theta e^(i angle)."""
    theta = trajectory["theta"].values
    if name == "theta":
        return np.asarray(np.cos(theta), np.complex128)
    angle = trajectory[name].values
    return np.where(np.isnan(angle), 0.0, np.sin(theta) * np.exp(1j * np.nan_to_num(angle)))


def spectral_lines(time: Array, signal: Signal, count: int, *, real: bool = False) -> tuple[Array, Signal]:
    """Strongest lines of a signal, a constant and a sum of c exp(i w t), by decreasing power as they are found.

    Parameters
    ----------
    time : ndarray of float64, shape (samples,)
        Evenly spaced.
    signal : ndarray of complex128, shape (samples,)
    count : int
        Number of lines; fewer are returned where the residual is rounding.
    real : bool
        The signal is real: lines at w and -w are one, with w >= 0 and the amplitude of the cosine.

    Returns
    -------
    frequency : ndarray of float64
        In rad per unit of time.
    coefficient : ndarray of complex128
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
        frequencies.append(_refined(time, residual * weight, grid[highest], grid[1]))
        coefficients, residual = _fit(time, signal, frequencies, weight, real)
        # Lines shift the maxima of each other: each is refined again without the others.
        for _ in range(PASSES):
            for i, frequency in enumerate(frequencies):
                half = coefficients[[i]] / (2 if real else 1)  # without the line at the opposite frequency
                single = (residual + _waves(time, [frequency]) @ half) * weight
                frequencies[i] = _refined(time, single, frequency, grid[1])
                coefficients, residual = _fit(time, signal, frequencies, weight, real)
    return np.array(frequencies), coefficients


def _refined(time: Array, weighted: Signal, guess: float, width: float) -> float:
    """Frequency of the maximum of the Fourier integral within `width` of a guess."""

    def negative(frequency: float) -> float:
        """Magnitude of the Fourier integral, with the sign for a minimiser."""
        return -abs(complex(np.exp(-1j * frequency * time) @ weighted))

    result = minimize_scalar(
        negative, bounds=(guess - width, guess + width), method="bounded", options={"xatol": 1e-10 * width}
    )
    return float(result.x)


def _waves(time: Array, frequencies: list[float]) -> Signal:
    """exp(i w t), of shape (samples, frequencies)."""
    return np.asarray(np.exp(1j * np.outer(time, frequencies)))


def _fit(
    time: Array, signal: Signal, frequencies: list[float], weight: Array, real: bool
) -> tuple[Signal, Signal]:
    """Coefficients of all lines, fitted with a constant by weighted least squares, and the residual of the signal."""
    waves, count = _waves(time, frequencies), len(frequencies)
    basis = np.concatenate([waves, waves.conj() if real else waves[:, :0], np.ones((time.size, 1))], axis=1)
    weighted = basis.conj().T * weight
    solution = np.linalg.lstsq(weighted @ basis, weighted @ signal, rcond=1e-12)[0]
    fitted = np.asarray(solution, np.complex128)
    residual = np.asarray(signal - basis @ fitted, np.complex128)
    return (2 * fitted[:count] if real else fitted[:count]), residual
