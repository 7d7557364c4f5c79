"""The magnetised satellite-gyrostat on a circular orbit (Yehia & El-kenani 2021)."""

from .system import SATELLITE, Satellite

__all__ = ["SATELLITE", "Satellite"]
