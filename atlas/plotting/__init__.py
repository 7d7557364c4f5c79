"""Figures of atlases and motions. Only this package and extensions import Matplotlib."""
