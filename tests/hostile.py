"""Texts that no terminal, figure or page may show as they are, and atlases whose attributes contain them."""

import itertools

import numpy as np

# A screen is cleared, a line is forged, writing turns round, half a character; longer than a text may be.
HOSTILE = "\x1b[2J\ndone\u202e\udcff" + "<b>A</b>" * 100
# In turn also what is no formula, what would take long to set, letters without a glyph, and what is no text.
VALUES = (
    HOSTILE, r"$\nonsense{$" + HOSTILE, f"${'A' * 3_000_000}$", f"${'{' * 3000}{'}' * 3000}$", "$\u4e2d_0$ \u4e2d", 3,
    np.arange(5.0),
)  # fmt: skip


def changed(ds, values):
    """The atlas with these values in turn in its text attributes, but for those that name its system and its flags."""
    ds, values = ds.copy(), itertools.cycle(values)
    keep = ("atlas_system", "atlas_scene", "flag_meanings")
    for owner in (ds, *ds.variables.values()):
        owner.attrs = {
            name: next(values) if isinstance(old, str) and name not in keep else old
            for name, old in owner.attrs.items()
        }
    return ds
