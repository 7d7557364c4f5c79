"""Print the section of a version in CHANGELOG.md, without links into the repository: python scripts/tools/release_notes.py 0.1.0"""

from __future__ import annotations

import re
import sys
from pathlib import Path

CHANGELOG = Path(__file__).parents[2] / "CHANGELOG.md"


def main() -> int:
    text = CHANGELOG.read_text(encoding="utf-8")
    section = re.search(
        rf"^## \[{re.escape(sys.argv[1])}\] - \S+\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL
    )
    if section is None or not section[1].strip():
        print(f"CHANGELOG.md has no section [{sys.argv[1]}] with a date", file=sys.stderr)
        return 1
    print(re.sub(r"\[([^]]*)\]\((?!https?:)[^)]*\)", r"\1", section[1].strip()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
