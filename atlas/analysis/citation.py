"""Citations for results from an atlas, as text and as BibTeX."""

from __future__ import annotations

import re

import xarray as xr

from ..errors import MAX_MESSAGE, attribute_text
from .latex import escaped
from .metadata import scene_of, system_of

AUTHORS = "The Precession Atlas developers"  # as in CITATION.cff


def cite(ds: xr.Dataset, bibtex: bool) -> str:
    """Return text or BibTeX that names the program, the equations and the computation; see `Atlas.cite`."""
    system, attributes = system_of(ds), ds.attrs
    scene_of(ds)  # raises BadInput for joined atlases

    def text(name: str, default: str = "unknown") -> str:
        return attribute_text(attributes, name, default, MAX_MESSAGE)

    if not bibtex:
        return (
            f"Precession Atlas {text('atlas_version')}, kernel {text('atlas_kernel_hash')}"
            f" ({text('atlas_versions')}; {text('atlas_cpu')}, {text('atlas_platform')}).\n"
            f"Equations of the {system.title}: {text('references')}.\n"
            f"Atlas {text('title')!r}: {text('history')}."
        )
    program = f"Precession Atlas, version {text('atlas_version')}"
    entries = [_entry("precession_atlas", author=AUTHORS, title=program)]
    if system.bibtex:
        entries.append(system.bibtex)
    elif system.reference:
        entries.append(_entry(system.name, note=system.reference, doi=system.doi))
    kind = "result" if "atlas_result" in attributes else "kernel"
    key = text("atlas_result" if kind == "result" else "atlas_kernel_hash")
    entries.append(
        _entry(
            "atlas_" + re.sub(r"\W", "", key)[:12],
            author=text("creator_name", ""),
            title=text("title"),
            year=text("date_created", "")[:4],
            note=f"Atlas computed by {program}; {kind} {key}",
        )
    )
    return "\n".join(entries)


def _entry(key: str, **values: str) -> str:
    """Return a BibTeX entry @misc. Double braces keep names and capital letters unchanged."""
    lines = [f"  {name} = {{{{{escaped(value)}}}}}," for name, value in values.items() if value]
    return "\n".join([f"@misc{{{key},", *lines, "}", ""])
