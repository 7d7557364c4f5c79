"""One HTML file that shows an atlas, without a server and without anything from the network."""

from __future__ import annotations

import base64
import hashlib
import html
import io
import json
import re
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import xarray as xr
from matplotlib import rc_context

from ...analysis.metadata import map_variable, scene_of, system_of
from ...errors import BadInput, attribute_text
from ...files import atomic_write, writable
from ...kernel.tableaux import METHODS
from ...plotting.maps import atlas_map
from ...plotting.style import STYLE
from ...scene import checks
from .content import MAX_BYTES, MAX_POINTS, Layout, Store, motion_table, page_layout, page_table
from .motion import CannotTranslate, sources, translate

# The scripts of the page are joined in one scope, and the last script starts the page.
SCRIPTS = ("map.js", "point.js", "motion.js", "controls.js")
FORMATS = (".html", ".htm")
FALLBACK_DPI = 110
FRAME_HEIGHT = 900  # height of a page in a notebook, in pixels
NO_MOTION = "null"


@dataclass(frozen=True)
class Page:
    """A page about an atlas.

    Attributes
    ----------
    html : str
        The whole file. It loads nothing, because its content-security policy forbids loading.
    """

    html: str

    def save(self, path: str | Path, *, force: bool = False) -> None:
        """Write the page, all of it or nothing.

        Parameters
        ----------
        path : str or Path
            File to write, .html or .htm.
        force : bool, optional
            Replace an existing file.

        Raises
        ------
        BadInput
            For another suffix, an existing file, and a path that cannot be written.
        """
        path = writable(path, FORMATS, force=force)
        with atomic_write(path) as temporary:
            temporary.write_text(self.html, encoding="utf-8")

    def _repr_html_(self) -> str:
        """Return the page as HTML in a frame that has access neither to the notebook nor to the network."""
        return (
            f'<iframe title="atlas" sandbox="allow-scripts allow-downloads" width="100%" height="{FRAME_HEIGHT}" style="border:0"'
            f' srcdoc="{html.escape(self.html)}"></iframe>'
        )


def page(ds: xr.Dataset, *, degrees: bool | None = None) -> Page:
    """One HTML file with maps of all variables, the values of each point, and its motion, integrated in the page.

    Parameters
    ----------
    degrees : bool, optional
        Show all angles in degrees. By default only the axes with display_units = "deg" in the scene are in degrees.

    Returns
    -------
    Page
        Jupyter shows the page in the cell, and `page().save("map.html")` writes a file. The page needs no server and loads nothing.
        Above `atlas.extensions.page.content.MAX_POINTS` points, only every second, third, ... value along the longest axes is shown.
    """
    return atlas_page(ds, degrees=degrees)


def atlas_page(
    ds: xr.Dataset, *, file: str = "", max_points: int = MAX_POINTS, degrees: bool | None = None
) -> Page:
    """Make the page of an atlas. Commands on the page open the atlas `file`."""
    system, scene = system_of(ds), scene_of(ds)
    file = file or Path(str(ds.encoding.get("source", "atlas.nc"))).name
    method = attribute_text(ds.attrs, "atlas_method") if scene is None else scene.settings.method
    checks.choice("damaged: the attribute atlas_method", method, METHODS)
    script, fault = "", {}
    try:
        # Trajectories differ from the atlas by rounding, because kernels fuse products and sums, and browsers do not.
        texts = sources(system, method)
        script = f"{translate(texts)}\nreturn {{{', '.join(f'{name}: {name}$' for name in texts)}}};"
    except CannotTranslate as error:
        fault["fault"] = f"The equations of this system cannot be translated for this page: {error}"
    count = max_points
    while True:
        layout = page_layout(ds, count, degrees)
        store = Store(layout.shape)
        try:
            motions = fault or motion_table(layout, store)
        except BadInput as error:
            motions = {"fault": f"No motions in this page: {error}"}
        table = page_table(layout, store, motions, file)
        if store.nbytes <= MAX_BYTES or count < 1000:
            break
        count = int(count * min(0.9, MAX_BYTES / store.nbytes))
    return Page(_file_text(table, script, _fallback(layout)))


def _fallback(layout: Layout) -> str:
    """Return a picture of the map for readers without scripts, as a data URL."""
    middle = layout.ds.isel({dim: layout.ds.sizes[dim] // 2 for dim in layout.panel_dims})
    buffer = io.BytesIO()
    figure = atlas_map(middle, map_variable(layout.whole), width="page", degrees=layout.degrees)
    with rc_context(STYLE):
        figure.savefig(buffer, format="png", dpi=FALLBACK_DPI)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def _file_text(table: dict[str, Any], equations: str, picture: str) -> str:
    """Return the text of the file. The security policy allows only the style and the script of the page, and embedded images."""
    folder = files(__package__)
    style = folder.joinpath("page.css").read_text(encoding="utf-8")
    program = "\n".join(folder.joinpath(name).read_text(encoding="utf-8") for name in SCRIPTS)
    body = f"(() => {{\n{equations}\n}})()" if equations else NO_MOTION
    script = f'"use strict";\nconst equations = {body};\n{program}'
    policy = (
        f"default-src 'none'; script-src {_hash(script)}; style-src {_hash(style)}; img-src data:;"
        " base-uri 'none'; form-action 'none'"
    )
    # Characters are escaped, so that no text can end the element around the data.
    text = json.dumps(table, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    parts = {
        "policy": html.escape(policy),
        "title": html.escape(table["title"]),
        "style": style,
        "script": script,
        "data": text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"),
        "picture": f'<img src="{picture}" alt="{html.escape(table["title"])}">',
    }
    template = folder.joinpath("template.html").read_text(encoding="utf-8")
    # All parts are inserted in one pass, so that names of parts inside a part are not replaced.
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], template)


def _hash(text: str) -> str:
    """Return the source expression of a content-security policy for an element with this text."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}'"
