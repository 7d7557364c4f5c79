"""Figures of atlases, motions and studies; only this room and extensions import Matplotlib."""
