"""The catalogue where extensions that it measures with are missing."""

import json
import subprocess
import sys

import pytest

CODE = """
import sys
from atlas import cli, extension
found = {name: each for name, each in extension.extensions().items() if name not in sys.argv[1].split()}
extension._found = lambda: (found, {})
from atlas.extensions.catalogue import tables as catalogue
catalogue.N_SAMPLES = 1
sys.argv[0] = "atlas"
sys.exit(cli.main(["conditions", *sys.argv[2:]]))
"""


@pytest.mark.long
@pytest.mark.parametrize("missing", ["plane", "normal_form", "plane normal_form"])
def test_equations_that_cannot_be_measured_name_the_missing_extension(missing):
    command = [sys.executable, "-c", CODE, missing, "satellite", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    (line,) = done.stderr.splitlines()
    assert line.endswith(f"are not measured: not installed: {missing.replace(' ', ' and ')}")
    rows = json.loads(done.stdout)["printed"]
    for row in rows:
        not_measured = row["measure"].startswith("not measured")
        assert not_measured == (row["residual_true"] is None), row["equation"]
    measures = {row["measure"] for row in rows if row["residual_true"] is None}
    assert measures == {f"not measured: the extension {name} is not installed" for name in missing.split()}
