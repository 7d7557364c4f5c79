"""Print the recipe of conda-forge for a source distribution: python scripts/tools/conda_recipe.py dist/precession_atlas-0.1.0.tar.gz

Requirements come from the pyproject.toml in it.
"""

from __future__ import annotations

import hashlib
import json
import re
import sys
import tarfile
import tomllib
from pathlib import Path

# Names that conda-forge spells otherwise, or splits: the last ones without windows and documentation.
NAMES = {"netCDF4": "netcdf4", "tomli_w": "tomli-w", "matplotlib": "matplotlib-base", "dask": "dask-core"}
RECIPE = """\
schema_version: 1

context:
  version: "{version}"
  python_min: "{python}"

package:
  name: precession-atlas
  version: ${{{{ version }}}}

source:
  url: https://pypi.org/packages/source/p/precession-atlas/precession_atlas-${{{{ version }}}}.tar.gz
  sha256: {sha256}

build:
  number: 0
  noarch: python
  script: ${{{{ PYTHON }}}} -m pip install . -vv --no-deps --no-build-isolation
  python:
    entry_points:
{scripts}

requirements:
  host:
    - python ${{{{ python_min }}}}.*
    - pip
{build}
  run:
    - python >=${{{{ python_min }}}}
{run}

tests:
  - python:
      imports: [atlas]
      pip_check: true
      python_version: ["${{{{ python_min }}}}.*", "*"]
  - script:
      - atlas new quickstart
      - atlas check quickstart.toml
      - atlas run quickstart.toml -o quickstart.nc --dry-run

about:
  summary: {summary}
  license: MIT
  license_file: LICENSE
"""


def listed(words: list[str]) -> str:
    """Items of a list of the recipe."""
    return "\n".join(f"    - {word}" for word in words)


def conda(requirement: str) -> str:
    """A requirement as conda has it: "numpy >=2.2"."""
    name, limits = re.fullmatch(r"([\w.-]+)\s*(.*)", requirement).groups()
    return f"{NAMES.get(name, name)} {limits}"


def main() -> int:
    source = Path(sys.argv[1])
    with tarfile.open(source) as archive:
        folder = archive.getnames()[0].partition("/")[0]
        texts = {
            name: archive.extractfile(f"{folder}/{name}").read().decode()
            for name in ("pyproject.toml", "PKG-INFO")
        }
    settings = tomllib.loads(texts["pyproject.toml"])
    project = settings["project"]
    recipe = RECIPE.format(
        version=re.search(r"^Version: (.+)$", texts["PKG-INFO"], re.MULTILINE)[1],
        python=project["requires-python"].removeprefix(">="),
        sha256=hashlib.sha256(source.read_bytes()).hexdigest(),
        scripts="\n".join(f"      - {name} = {value}" for name, value in project["scripts"].items()),
        build=listed([conda(each) for each in settings["build-system"]["requires"]]),
        run=listed([conda(each) for each in project["dependencies"]]),
        summary=json.dumps(project["description"]),
    )
    if urls := project.get("urls"):
        recipe += f"  homepage: {urls['Homepage']}\n  documentation: {urls['Documentation']}\n"
    print(recipe, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
