"""What a release takes from the repository: its notes, and the versions of the site."""

import hashlib
import re
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
TOOLS = ROOT / "scripts" / "tools"


def run(*words):
    """A finished script."""
    return subprocess.run(
        [sys.executable, *map(str, words)], cwd=ROOT, capture_output=True, text=True, check=False
    )


def test_notes_are_the_section_of_the_version(tmp_path):
    (tmp_path / "scripts" / "tools").mkdir(parents=True)
    script = tmp_path / "scripts" / "tools" / "release_notes.py"
    script.write_text((TOOLS / script.name).read_text())
    (tmp_path / "CHANGELOG.md").write_text(
        "# Changelog\n\n## [Unreleased]\n\n## [0.2.0] - 2030-01-02\n\n- **[New](docs/a.md)** of [others](https://example.org/).\n\n### Fixed\n\n- Old.\n\n## [0.1.0] - 2029-01-02\n\n- First.\n"
    )
    assert (
        run(script, "0.2.0").stdout == "- **New** of [others](https://example.org/).\n\n### Fixed\n\n- Old.\n"
    )
    assert run(script, "0.1.0").stdout == "- First.\n"
    for missing in ("0.3.0", "Unreleased"):
        refused = run(script, missing)
        assert refused.returncode == 1
        assert refused.stderr == f"CHANGELOG.md has no section [{missing}] with a date\n"


def test_a_site_is_added_to_those_of_other_versions(tmp_path):
    site, folder = tmp_path / "site", tmp_path / "pages"
    site.mkdir()
    folder.mkdir()
    for version, first in (
        ("latest", "latest"),
        ("0.9.0", "0.9.0"),
        ("0.10.0", "0.10.0"),
        ("0.9.1", "0.10.0"),
    ):
        (site / "index.html").write_text(version)
        assert run(TOOLS / "site_versions.py", site, folder, version).returncode == 0
        assert f"url={first}/" in (folder / "index.html").read_text()
        assert (folder / version / "index.html").read_text() == version
    listed = re.findall(r'href="(.*?)/"', (folder / "versions.html").read_text())
    assert listed == ["0.10.0", "0.9.1", "0.9.0", "latest"]
    assert run(TOOLS / "site_versions.py", site, folder, "../x").returncode == 2


def test_the_recipe_has_the_requirements_of_the_source_distribution(tmp_path):
    (tmp_path / "PKG-INFO").write_text("Name: precession-atlas\nVersion: 9.8.7\n")
    with tarfile.open(tmp_path / "a.tar.gz", "w:gz") as source:
        source.add(tmp_path / "PKG-INFO", "precession_atlas-9.8.7/PKG-INFO")
        source.add(ROOT / "pyproject.toml", "precession_atlas-9.8.7/pyproject.toml")
    recipe = yaml.safe_load(run(TOOLS / "conda_recipe.py", tmp_path / "a.tar.gz").stdout)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    run_requirements = [re.sub(r"\W", "_", each.split()[0]).lower() for each in recipe["requirements"]["run"]]
    needed = [re.split("[>=]", each)[0].lower() for each in project["dependencies"]]
    split = {"matplotlib": "matplotlib_base", "dask": "dask_core"}
    assert run_requirements == ["python", *(split.get(name, name) for name in needed)]
    assert recipe["context"] == {"version": "9.8.7", "python_min": "3.11"}
    assert recipe["source"]["sha256"] == hashlib.sha256((tmp_path / "a.tar.gz").read_bytes()).hexdigest()
    assert recipe["about"]["summary"] == project["description"]


@pytest.mark.parametrize("form", sorted((ROOT / ".github").rglob("*.yml")), ids=lambda path: path.name)
def test_actions_of_others_are_pinned_by_their_commits(form):
    used = re.findall(r"uses: (\S+)", form.read_text())
    assert [
        each for each in used if not re.fullmatch(r"actions/[\w-]+@v\d+|[\w/-]+@[0-9a-f]{40}", each)
    ] == []
