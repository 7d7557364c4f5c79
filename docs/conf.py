"""Configuration of Sphinx for the pages of this folder; `sh scripts/docs.sh` builds them."""

import os
import re
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import ziamath
from docutils import nodes
from latex2mathml.converter import convert

from atlas import __version__

project = "Precession Atlas"
author = copyright = "The Precession Atlas developers"
version = release = __version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["dollarmath"]
html_math_renderer = "mathml"  # which browsers set themselves: the site needs no network and no script for it
exclude_patterns = ["paper", "examples"]

html_theme = "furo"
html_title = f"Precession Atlas {version}"
html_show_sphinx = False
# Where a site of several versions is served, each names the page that lists them, in the folder above.
if versions := os.environ.get("SITE_VERSIONS"):
    html_theme_options = {"announcement": f'Version {version} | <a href="../{versions}">all versions</a>'}
html_static_path = [
    "static",
    str(Path(ziamath.__file__).parent / "fonts"),
]  # of ziamath only its font for formulas
html_css_files = ["site.css"]
html_extra_path = ["../out/pages"]  # the page of the quickstart, which scripts/docs.sh makes

myst_heading_anchors = 4  # links such as scenes.md#refinement-at-borders
nb_execution_in_temp = True  # the notebook writes files
nb_execution_raise_on_error = True
nb_execution_timeout = 300  # seconds for a cell; the first one may compile a kernel

default_role = "code"  # of single backticks in docstrings
autodoc_typehints_format = "short"
maximum_signature_line_length = 90
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_rtype = False


LONG = 12  # elements of a formula in a line of text, from which on it may be broken
MATHML = "http://www.w3.org/1998/Math/MathML"
PRIME = r'<mrow>\1<mo lspace="0" rspace="0">\2</mo></mrow>'
SPACE = r'\1<mspace width="0.17em"/>'


def breakable(formula):
    """A formula in a line of text, which browsers do not break, as several if it is long, from =, + or - to the next."""
    elements = list(ElementTree.fromstring(formula.replace(f' xmlns="{MATHML}"', ""))[0])
    if len(elements) < LONG:
        return formula
    parts = []
    for before, element in pairwise([None, *elements]):
        is_operator = element.tag == "mo" and element.text in ("=", "+", "\N{MINUS SIGN}")
        if before is None or (is_operator and (before.tag != "mo" or before.text in (")", "]", "}"))):
            parts.append(ElementTree.Element("mrow"))
            if is_operator and before is not None:
                element.set("form", "infix")
        parts[-1].append(element)
    return "<wbr>".join(f"<math>{ElementTree.tostring(part, 'unicode')}</math>" for part in parts)


def setup(app):
    """Set formulas, written in LaTeX, as MathML; leave out links to pages of atlases that were not made."""

    def formula(display):
        def visit(translator, node):
            latex = node.astext().replace("{aligned}", "{align*}")  # the converter knows the latter alone
            formula = re.sub(
                r"<mo[^>]*>(&#x0007C;|\|)",
                r'<mo stretchy="false" lspace="0" rspace="0">\1',
                convert(latex, display=display),
            )
            # A prime is raised in the font already, and names of functions need a space before their argument.
            formula = re.sub(r"<msup>(<mi>[^<]*</mi>)<mi>(&#x0203[23];)</mi></msup>", PRIME, formula)
            formula = re.sub(r"(<mi>(?:sin|cos|tan|ln|log|exp)</mi>)(?=<m[in])", SPACE, formula)
            if display == "inline":  # a word joiner keeps the punctuation beside it in the same line
                formula = f"&#x2060;{breakable(formula)}&#x2060;"
            translator.body.append(formula)
            raise nodes.SkipNode

        return visit, None

    def existing(match):
        return match[0] if (Path(app.srcdir).parent / "out" / "pages" / match[1]).exists() else ""

    def links(app, name, source):
        source[0] = re.sub(r'^<a href="(\w+_page\.html)">.*</a>$', existing, source[0], flags=re.MULTILINE)

    del app.registry.source_suffix[".ipynb"]  # notebooks are files to download, and no pages
    app.connect("source-read", links)
    app.add_html_math_renderer("mathml", formula("inline"), formula("block"))
