"""Write the tables of the pages in docs from the registries and from theory; --check only compares them.

python scripts/tools/make_docs.py [--check] [--docs FOLDER]
"""

from __future__ import annotations

import argparse
import ast
import json
import re
import sys
from collections import Counter
from collections.abc import Iterable
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from atlas.analysis.latex import FUNCTIONS
from atlas.extensions.catalogue import tables as catalogue
from atlas.extensions.catalogue.latex import NAME, NAMES, SIGNS, TOKEN, in_latex
from atlas.extensions.catalogue.papers import published_numbers
from atlas.flags import Agreement, Flag, Label, Stability, Status
from atlas.systems import SYSTEMS
from atlas.systems.base import System, families_of
from atlas.variables import variables

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS / "examples" / "amer2013_figures"))  # which is not installed


def table(rows: list[tuple[str, ...]]) -> str:
    """Rows, the first one the heading, as a Markdown table."""
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


PROTECTED = re.compile(
    r"`[^`]*`\w*|\$[^$]*\$|\[[^\]]*\]\([^)]*\)|</?[a-z!][^>]*>|https?://\S+|\*\*[^*]*\*\*|\d+(?:\.\d+)?e[+-]?\d+|\b[\w.]+/[\w./]*\.\w+"
)
OPERATORS = {*SIGNS, *"=<>+-/|()[]", "!="} - {"x", "*", ".", "..", "...", "{", "}"}


def with_formulas(text: str) -> str:
    """Prose with the formulas between its words, such as "stable for C > A", as LaTeX between dollars.

    Code, links and LaTeX are not changed. A letter after a number, as in "2 s", is a unit; a letter before a point is an initial.
    """
    if text.startswith("|") and text.endswith("|"):  # a row of a table
        return "|".join(map(with_formulas, re.split(r"(?<!\\)\|", text[1:]))).join(["|", ""])
    parts, start = [], 0
    for match in PROTECTED.finditer(text):
        parts += [_set(text[start : match.start()]), match[0]]
        start = match.end()
    return "".join([*parts, _set(text[start:])])


def _set(text: str) -> str:
    """`with_formulas` for text without code, links and LaTeX."""
    tokens = [(m[0], m.start(), m.end()) for m in TOKEN.finditer(text)]
    runs: list[list[tuple[str, int, int]]] = [[]]
    for token in tokens:
        adjoins = runs[-1] and not text[runs[-1][-1][2] : token[1]].strip(" ")
        if not _is_formula(token[0]) or not adjoins:
            runs.append([])
        if _is_formula(token[0]):
            runs[-1].append(token)
    for run in reversed(runs):
        _trim(run, text)
        words = [token for token, _, _ in run]
        names = [word for word in words if NAME.fullmatch(word) and word not in FUNCTIONS]
        core = [word for word in words if word not in ("(", ")")]
        powers = [word for word in words if word.startswith("^")]
        if (
            not (names or powers)
            or "^" in powers
            or "x)" in "".join(words)
            or _depth(run)
            or words.count("|") % 2
        ):
            continue
        first, last = run[0][1], run[-1][2]
        before, after = text[:first].rstrip(" ("), text[last:]
        is_single = len(core) == 1 and len(core[0]) == 1
        is_unit = (before[-1:].isdigit() and is_single) or (len(core) == 2 and core[0][0].isdigit())
        is_initial = is_single and core[0].isupper() and after.startswith(".")
        if is_unit or is_initial or re.search(r"[\w\-'_]", text[max(first - 1, 0) : first] + after[:1]):
            continue
        text = text[:first] + in_latex(text[first:last]) + after
    return text


def _trim(run: list[tuple[str, int, int]], text: str) -> None:
    """Remove tokens of the prose from both ends of a run: articles, list marks, brackets and functions without argument."""
    while run:
        (first, start, end), last = run[0], run[-1][0]
        follows = run[1][0] if len(run) > 1 else ""
        starts_sentence = not text[:start].strip(" -*(") or text[:start].rstrip(" *(")[-1] in ".:?"
        is_article = (first == "a" and re.match(r"\s*[A-Za-z*]|\s*$", text[end:])) or (
            first == "A"
            and starts_sentence
            and follows not in OPERATORS
            and text[end : end + 1] not in (",", ")")
        )
        if (
            is_article
            or first == "x"
            or first[0] in "=/)]<>^!"
            or (first[0] in "+-" and text[end : end + 1] == " ")
            or (first[0].isdigit() and follows == "(" and text[end : end + 1] == " ")
            or (first in ("(", "[") and _depth(run) > 0)
        ):
            run.pop(0)
        elif (
            last in (*"+-=/<>([x", *FUNCTIONS)
            or (last in (")", "]") and _depth(run) < 0)
            or (last == "a" and len(run) > 1 and run[-2][0] not in OPERATORS and follows)
        ):
            run.pop()
        else:
            return


def _is_formula(token: str) -> bool:
    """Whether a token may be part of a formula in prose."""
    name = NAME.fullmatch(token)
    if name is not None:
        return name[1] in (*NAMES, *FUNCTIONS) or len(name[1]) == 1
    return token in OPERATORS or token[0] in "^√" or token[0].isdigit()


def _depth(run: list[tuple[str, int, int]]) -> int:
    """Number of brackets that are open at the end of a run."""
    words = [token for token, _, _ in run]
    return sum(words.count(sign) for sign in "([") - sum(words.count(sign) for sign in ")]")


def unit(text: str) -> str:
    """A unit such as "rad s-1" with raised exponents, in one line."""
    raised = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
    text = re.sub(r"(?<=[a-z])-?\d+", lambda match: match[0].translate(raised), text)
    return text.replace(" ", "\N{NO-BREAK SPACE}")


def parameters(system: System) -> str:
    """Table of the parameters of a system."""
    rows = [("parameter", "meaning", "unit", "default", "allowed")]
    for p in system.parameters.values():
        low = "" if np.isinf(p.low) else f"{'>' if p.open_low else '>='} {p.low:g}"
        default = "" if np.isnan(p.default) else f"{p.default:g}"
        rows.append((f"`{p.name}`", with_formulas(p.meaning), unit(p.unit), default, low))
    return f"{table(rows)}\n\nThe frame: {with_formulas(system.frame_text)}."


def dataset(system: System) -> str:
    """List of the variables of an atlas, whose remarks are too long for the cells of a table."""
    lines = []
    for v in variables(system).values():
        values = f"flags {', '.join(v.flags)}" if v.flags else unit(v.units)
        asked = "; on request" if v.optional else ""
        remark = f"  \n  *{v.comment[0].upper()}{v.comment[1:]}.*" if v.comment else ""
        lines.append(
            f"- **`{v.name}`** ({v.dtype}, {values}{asked}): {with_formulas(v.long_name)}{with_formulas(remark)}"
        )
    return "\n".join(lines)


def families(system: System) -> str:
    """Table of the families of steady motions."""
    rows = [("family", "motion", "equations", "solves for", "of several solutions")]
    for f in families_of(system).values():
        texts = (with_formulas(text) for text in (f.title, f.equations))
        several = "; ".join(f"{name}: {text}" for name, text in f.several.items())
        rows.append((f"`{f.name}`", *texts, ", ".join(f.solve), several))
    return table(rows)


def conditions(system: System) -> str:
    """List of the conditions of the families, too long for the cells of a table; a long one of several families has a letter."""
    texts = {f.name: [_symbols(c.text) for c in f.conditions] for f in families_of(system).values()}
    counts = Counter(text for each in texts.values() for text in each)
    shared = [text for text, count in counts.items() if count > 1 and len(text) > 80]
    letters = {text: f"({letter})" for text, letter in zip(shared, "abc", strict=False)}
    lines = [f"- **{letter}**: {in_latex(text)}" for text, letter in letters.items()]
    for name, each in texts.items():
        lines.append(f"- **`{name}`**: {'; '.join(letters.get(text) or in_latex(text) for text in each)}")
    return "\n".join(lines)


def _symbols(text: str) -> str:
    """A condition with drag and damping by the letters of the equations of motion."""
    return re.sub(r"\bdrag", "d", text).replace("damping", "D")


def flags(flag: type[Flag]) -> str:
    """Table of the values of a flag variable."""
    return table(
        [("value", "name", "meaning"), *((str(f.value), f"`{f.name.lower()}`", f.sentence) for f in flag)]
    )


@cache
def figure_table() -> list[Any]:
    """Integrations behind the figures of Amer et al. (2013), for two tables."""
    from amer2013_figures import claims

    return claims.figure_table()


def by_body(rows: list[tuple[str, ...]]) -> str:
    """A transposed table for each body (first cell of a row), because the rows are too long for the page."""
    heading, *rest = [tuple(map(with_formulas, row)) for row in rows]
    groups = [list(group) for _, group in groupby(rest, key=lambda row: row[0])]
    columns = [zip(heading[1:], *(row[1:] for row in group), strict=True) for group in groups]
    return "\n\n".join(
        f"{group[0][0]}:\n\n{table(list(each))}" for group, each in zip(groups, columns, strict=True)
    )


def amplitudes(system: System) -> str:
    """Table of the amplitudes behind the figures of Amer et al. (2013)."""
    from amer2013_figures.figures import amplitude_table

    return by_body(amplitude_table(figure_table()))


def periodic(system: System) -> str:
    """Table of the periodic solutions of Amer et al. (2013)."""
    from amer2013_figures import claims
    from amer2013_figures.figures import periodic_solutions

    return by_body(periodic_solutions(claims.periodic_table()))


def claim_table(system: System) -> str:
    """Table of the claims of Amer et al. (2013)."""
    from amer2013_figures import claims

    rows = [("claim", "verdict", "measured")]
    for claim in claims.claims(figure_table()):
        verdict = claim.verdict if claim.holds else f"**{claim.verdict}**"
        rows.append((with_formulas(claim.text), verdict, with_formulas(claim.measured)))
    return table(rows)


def numbers(system: System) -> str:
    """Tables of the published numbers of each source and of those of the package."""
    parts = []
    for source, group in groupby(published_numbers(system), key=lambda row: row["source"]):
        rows = list(group)
        parts.append(
            f"**{source}**: {with_formulas(rows[0]['place'])}. *Read: {with_formulas(rows[0]['reading'])}.*"
        )
        cells = [
            tuple(with_formulas(row[key]) for key in ("quantity", "printed", "ours", "verdict"))
            for row in rows
        ]
        computed = [f"`{row['computation']}`" for row in rows]
        body = [(*cell, each) for cell, each in zip(cells, computed, strict=True)]
        parts.append(table([("number", "printed", "ours", "verdict", "computed as"), *body]))
        parts += [f"{row['quantity']}: {row['remark']}." for row in rows if row["remark"]]
    return "\n\n".join(parts)


def errata(system: System) -> str:
    """List of the equations of the paper that are wrong, as printed and as corrected; both are too long for the cells of a table."""
    items = []
    for row in catalogue.published(system, errata=True):
        residuals = [_rounded(row[key]) for key in ("residual_printed", "residual_true")]
        measured = f", residuals {' and '.join(residuals)}" if residuals[0] else ""
        printed, true = _readings(row)
        items.append(
            f"{_name(row)}, {row['verdict']}{measured}  \n  printed: {printed}  \n  true: {true}  \n  {_effect(row)}"
        )
    return "\n".join(items)


def confirmed(system: System) -> str:
    """List of the equations of the paper that are true as printed."""
    items = []
    for row in catalogue.published(system):
        if row["verdict"] == "true":
            printed, true = _readings(row)
            remark = "" if true == "the same" else true
            what = f"{_rounded(row['residual_true'])}: {_effect(row)}"
            items.append(f"{_name(row)}: {printed}" + (f"  \n  {remark}" if remark else "") + f"  \n  {what}")
    return "\n".join(items)


def _name(row: dict[str, Any]) -> str:
    """The number of an equation, as the beginning of an item."""
    return f"- **{_starred(row['equation'])}**"


def _readings(row: dict[str, Any]) -> list[str]:
    """An equation as printed and as true."""
    return [_starred(in_latex(row[key])) for key in ("printed", "true")]


def _effect(row: dict[str, Any]) -> str:
    """The effect of a difference between the readings, or else the meaning of the residuals."""
    return _starred(with_formulas(row["effect"] or row["measure"]))


def _starred(text: str) -> str:
    """A text in which stars outside formulas are escaped for Markdown."""
    return "".join(
        part if part[:1] == "$" else part.replace("*", r"\*") for part in re.split(r"(\$[^$]*\$)", text)
    )


def _rounded(residual: float | None) -> str:
    """A residual with one digit, so that the page is the same on every processor."""
    return "" if residual is None else "< 1e-9" if residual < 1e-9 else f"{residual:.0e}"


def evidence(folder: Path) -> str:
    """Table of the counts that evidence.py has saved."""
    rows = [("what", "against", "compared", "differ", "command")]
    for each in json.loads((DOCS / "evidence.json").read_text()).values():
        counts = (f"{each[name]:,}".replace(",", "\N{NO-BREAK SPACE}") for name in ("compared", "differ"))
        rows.append((each["what"], each["against"], *counts, f"`{each['command']}`"))
    return table(rows)


def rooms(folder: Path) -> str:
    """Table of the packages in a folder: first sentence, number of lines; modules of the folder itself share one row."""
    rows, beside = [("room", "contents", "lines")], []
    for path in sorted(folder.iterdir()):
        if (path / "__init__.py").is_file() and path.name != "extensions":
            docstring = ast.get_docstring(ast.parse((path / "__init__.py").read_text())) or ""
            sentence = docstring.partition("\n")[0].removesuffix(".")
            rows.append((f"`{path.name}/`", sentence, str(_lines(path.rglob("*.py")))))
        elif path.suffix == ".py" and not path.name.startswith("_"):
            beside.append(path)
    if beside:
        names = ", ".join(f"`{path.name}`" for path in beside)
        rows.append((names, "the faces, registries, and what every room uses", str(_lines(beside))))
    return table(rows)


def _lines(paths: Iterable[Path]) -> int:
    """Lines of some files, to the nearest hundred."""
    return max(100, 100 * round(sum(len(path.read_text().splitlines()) for path in paths) / 100))


TABLES = {
    "rooms": rooms,
    "evidence": evidence,
    "parameters": parameters,
    "variables": dataset,
    "families": families,
    "conditions": conditions,
    "flags": flags,
    "amplitudes": amplitudes,
    "periodic": periodic,
    "claims": claim_table,
    "numbers": numbers,
    "errata": errata,
    "confirmed": confirmed,
}

SUBJECTS = dict(SYSTEMS) | {flag.__name__: flag for flag in (Label, Status, Agreement, Stability)}
SUBJECTS |= {"core": ROOT / "atlas", "extensions": ROOT / "atlas" / "extensions"}


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
    for path in (*sorted(options.docs.glob("*.md")), *options.docs.parent.glob("ARCHITECTURE.md")):
        text = path.read_text()
        if filled(text) != text:
            stale.append(path.name)
            if not options.check:
                path.write_text(filled(text))
    print(f"{'stale' if options.check else 'written'}: {', '.join(stale) or 'nothing'}")
    return int(bool(stale) and options.check)


if __name__ == "__main__":
    sys.exit(main())
