"""Configuration of Sphinx for the pages of this folder; `sh scripts/docs.sh` builds them."""

from atlas import __version__

project = "Precession Atlas"
author = copyright = "The Precession Atlas developers"
version = release = __version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["paper", "examples"]

html_theme = "furo"
html_title = f"Precession Atlas {version}"
html_show_sphinx = False
html_extra_path = ["../out/pages"]  # the page of the quickstart, which scripts/docs.sh makes

myst_heading_anchors = 4  # links such as scenes.md#refinement-at-borders
nb_execution_in_temp = True  # the notebook writes files
nb_execution_raise_on_error = True
nb_execution_timeout = 300  # seconds for a cell; the first one may compile a kernel

default_role = "code"  # of single backticks in docstrings
autodoc_typehints = "none"  # the docstrings give types, with shapes and units
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_rtype = False
