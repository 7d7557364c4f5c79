"""Figures of atlases and motions; only this room and extensions import Matplotlib."""
