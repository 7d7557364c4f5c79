"""README and docs: every command and code block runs, every table is the registry's."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.M | re.S)


def test_tables_are_those_of_the_registries():
    done = subprocess.run(
        [sys.executable, "scripts/make_docs.py", "--check"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    "page", ["README.md", *sorted(f"docs/{p.name}" for p in (ROOT / "docs").glob("*.md"))]
)
def test_code_blocks_run(page, tmp_path):
    """Scenes are saved under the name that the next command uses; commands of atlas and Python run in order."""
    saved = "first.toml"
    for language, text in BLOCK.findall((ROOT / page).read_text()):
        if language == "toml":
            (tmp_path / saved).write_text(text)
        elif language == "python":
            done = subprocess.run(
                [sys.executable, "-c", text], cwd=tmp_path, capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, done.stderr
        elif language == "sh":
            for line in text.splitlines():
                command = line.split("#")[0].split()
                if command[:1] == ["atlas"]:
                    done = subprocess.run(
                        [sys.executable, "-m", *command],
                        cwd=tmp_path,
                        capture_output=True,
                        text=True,
                        check=False,
                    )
                    assert done.returncode == 0, done.stderr
                else:  # set-up: cannot run inside itself, but must be there
                    assert command[:1] == ["sh"]
                    assert (ROOT / command[1]).is_file()


def test_links_lead_somewhere():
    for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
            if not target.startswith("http"):
                assert (page.parent / target).exists(), f"{page.name}: {target}"
