#!/bin/sh
# Add the site of out/site to the branch gh-pages of a repository, as the version named: sh scripts/site.sh REPOSITORY VERSION
set -e
cd "$(dirname "$0")/.."
root=$PWD
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
for _ in 1 2 3; do  # another job may push in the meantime
    rm -rf "$folder"
    git clone --quiet --depth 1 --branch gh-pages "$1" "$folder" 2>/dev/null || git init --quiet --initial-branch gh-pages "$folder"
    "${PYTHON:-python3}" scripts/tools/site_versions.py out/site "$folder" "$2"
    cd "$folder"
    git add --all
    ! git diff --cached --quiet || exit 0
    git -c user.name=site -c user.email=site@localhost commit --quiet --message "Site of $2"
    ! git push --quiet "$1" HEAD:gh-pages || exit 0
    cd "$root"
done
exit 1
