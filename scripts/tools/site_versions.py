"""Put a built site into a folder of versions: python scripts/tools/site_versions.py out/site FOLDER VERSION

FOLDER/VERSION is replaced, FOLDER/index.html leads to the newest release, or to "latest" before there is one, and
FOLDER/versions.html lists them all.
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

LATEST = "latest"  # of the branch main


def order(name: str) -> list[int]:
    """Key by which releases are sorted."""
    return [int(part) for part in name.split(".")]


def main() -> int:
    site, folder, version = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
    if not re.fullmatch(rf"{LATEST}|\d+(\.\d+)+", version):
        print(f"{version}: neither {LATEST} nor a release such as 0.1.0", file=sys.stderr)
        return 2
    shutil.rmtree(folder / version, ignore_errors=True)
    shutil.copytree(site, folder / version)
    names = [path.parent.name for path in folder.glob("*/index.html")]
    releases = sorted((name for name in names if name != LATEST), key=order, reverse=True)
    first = (releases or [LATEST])[0]
    links = "\n".join(
        f'<li><a href="{name}/">{name}</a></li>'
        for name in [*releases, *([LATEST] if LATEST in names else [])]
    )
    head = '<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n<title>Precession Atlas</title>\n'
    (folder / "versions.html").write_text(f"{head}<h1>Precession Atlas</h1>\n<ul>\n{links}\n</ul>\n</html>\n")
    (folder / "index.html").write_text(
        f'{head}<meta http-equiv="refresh" content="0; url={first}/">\n<a href="{first}/">{first}</a>\n</html>\n'
    )
    (folder / ".nojekyll").touch()  # names that begin with _ are served
    return 0


if __name__ == "__main__":
    sys.exit(main())
