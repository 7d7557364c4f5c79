"""Write the tables of the pages in docs from the registries and from theory; --check compares only.

python scripts/tools/make_docs.py [--check] [--docs FOLDER]
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import numpy as np

from atlas.analysis import catalogue
from atlas.flags import Agreement, Flag, Label, Stability, Status
from atlas.papers.amer2013 import claims
from atlas.plotting.amer2013 import amplitude_table, periodic_solutions
from atlas.systems import SYSTEMS
from atlas.systems.base import System
from atlas.variables import variables

DOCS = Path(__file__).parents[2] / "docs"


def table(rows: list[tuple[str, ...]]) -> str:
    """Rows, the first one the heading, as a Markdown table."""
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


def parameters(system: System) -> str:
    """Table of the parameters of a system."""
    rows = [("parameter", "unit", "default", "allowed", "meaning")]
    for p in system.parameters.values():
        low = "" if np.isinf(p.low) else f"{'>' if p.open_low else '>='} {p.low:g}"
        default = "" if np.isnan(p.default) else f"{p.default:g}"
        rows.append((f"`{p.name}`", p.unit, default, low, p.meaning))
    return table(rows)


def dataset(system: System) -> str:
    """Table of the variables of an atlas."""
    rows = [("variable", "type", "unit or flags", "meaning")]
    for v in variables(system).values():
        values = ", ".join(v.flags) if v.flags else v.units
        rows.append((f"`{v.name}`", v.dtype, values, v.long_name + (f" ({v.comment})" if v.comment else "")))
    return table(rows)


def families(system: System) -> str:
    """Table of the families of steady motions."""
    rows = [("family", "equations", "solves for", "motion", "conditions")]
    for f in system.families.values():
        rows.append(
            (f"`{f.name}`", f.equations, ", ".join(f.solve), f.title, "; ".join(c.text for c in f.conditions))
        )
    return table(rows)


def flags(flag: type[Flag]) -> str:
    """Table of the values of a flag variable."""
    return table(
        [("value", "name", "meaning"), *((str(f.value), f"`{f.name.lower()}`", f.sentence) for f in flag)]
    )


def amplitudes(system: System) -> str:
    """Table of the amplitudes behind the figures of Amer et al. (2013)."""
    return table(amplitude_table(claims.figure_table()))


def periodic(system: System) -> str:
    """Table of the periodic solutions of Amer et al. (2013)."""
    return table(periodic_solutions(claims.periodic_table()))


def claim_table(system: System) -> str:
    """Table of the claims of Amer et al. (2013)."""
    rows = [("claim", "verdict", "measured")]
    for claim in claims.claims(claims.figure_table()):
        rows.append((claim.text, claim.verdict if claim.holds else f"**{claim.verdict}**", claim.measured))
    return table(rows)


def published_equations(system: System) -> str:
    """Table of the equations of the paper, as printed and as corrected."""
    rows = [("equation", "verdict", "as printed", "true", "residual as printed", "as true", "effect")]
    for row in catalogue.published(system):
        sizes = (_rounded(row["residual_printed"]), _rounded(row["residual_true"]))
        texts = (row[key] for key in ("equation", "verdict", "printed", "true"))
        rows.append((*texts, *sizes, row["effect"] or row["measure"]))
    return table(rows)


def _rounded(residual: float | None) -> str:
    """A residual with one digit, so that the page is the same on every processor."""
    return "" if residual is None else "< 1e-9" if residual < 1e-9 else f"{residual:.0e}"


TABLES = {
    "parameters": parameters,
    "variables": dataset,
    "families": families,
    "flags": flags,
    "amplitudes": amplitudes,
    "periodic": periodic,
    "claims": claim_table,
    "printed": published_equations,
}

SUBJECTS = SYSTEMS | {flag.__name__: flag for flag in (Label, Status, Agreement, Stability)}


def filled(text: str) -> str:
    """The text with every <!-- NAME SUBJECT --> ... <!-- end --> replaced by its table."""

    def replacement(match: re.Match[str]) -> str:
        name, subject = match.groups()
        return f"<!-- {name} {subject} -->\n{TABLES[name](SUBJECTS[subject])}\n<!-- end -->"

    return re.sub(r"<!-- (\w+) (\w+) -->\n.*?<!-- end -->", replacement, text, flags=re.S)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if a page is stale")
    parser.add_argument("--docs", type=Path, default=DOCS, help="folder of the pages (default: docs)")
    options = parser.parse_args()
    stale = []
    for path in sorted(options.docs.glob("*.md")):
        text = path.read_text()
        if filled(text) != text:
            stale.append(path.name)
            if not options.check:
                path.write_text(filled(text))
    print(f"{'stale' if options.check else 'written'}: {', '.join(stale) or 'nothing'}")
    return int(bool(stale) and options.check)


if __name__ == "__main__":
    sys.exit(main())
