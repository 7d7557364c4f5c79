"""README and docs: code blocks run, tables are those of the registries, links lead to files."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = [
    "README.md",
    "CONTRIBUTING.md",
    *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")),
]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.M | re.S)


def run_python(*arguments, cwd):
    """Run Python with these arguments; an exit status other than 0 fails the test."""
    process = subprocess.run(
        [sys.executable, *arguments], cwd=cwd, capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stdout + process.stderr


def test_tables_are_those_of_the_registries():
    run_python("scripts/tools/make_docs.py", "--check", cwd=ROOT)


@pytest.mark.parametrize("page", PAGES)
def test_code_blocks_run(page, tmp_path):
    """A TOML block is saved as the scene of the blocks after it; commands of atlas and Python run in order."""
    for language, text in BLOCK.findall((ROOT / page).read_text()):
        if language == "toml":
            (tmp_path / "first.toml").write_text(text)
        elif language == "python":
            if module := re.match(r"# (\w+\.py)\n", text):  # its name; a later block imports it
                (tmp_path / module[1]).write_text(text)
            run_python("-c", text, cwd=tmp_path)
        elif language == "sh":
            for line in text.splitlines():
                command = line.split("#")[0].split()
                if command[:1] == ["atlas"]:
                    run_python("-m", *command, cwd=tmp_path)
                else:  # the set-up cannot run inside its own tests, but its scripts must exist
                    assert command[:1] == ["sh"]
                    assert (ROOT / command[1]).is_file()


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_to_files(page):
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", (ROOT / page).read_text()):
        if not target.startswith("http"):
            assert ((ROOT / page).parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES)
def test_scripts_that_pages_name_exist(page):
    for script in re.findall(r"scripts/[\w/]+\.(?:py|sh)", (ROOT / page).read_text()):
        assert (ROOT / script).is_file(), script
