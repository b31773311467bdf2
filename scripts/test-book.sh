#!/usr/bin/env bash
# Runs the commands of the book's tutorials and how-tos, each page in a folder of its own, with the programs of target/release
# (NONRIGID_BUILT=1: those that are there): the fenced `sh` blocks from the top, all but those under `<!-- not run: WHY -->`. The files that a page
# calls the reader's own are made by the lines of `<!-- before:`, which readers do not see; they run in their place, and $page is the page. Names of
# pages as arguments run these alone.
set -euo pipefail
cd "$(dirname "$0")/.."
export CARGO_PROFILE_RELEASE_DEBUG=${CARGO_PROFILE_RELEASE_DEBUG:-0}
[ -n "${NONRIGID_BUILT:-}" ] || cargo build --release --quiet --bins
export PATH="$PWD/target/release:$PATH"
pages=("$@")
if [ ${#pages[@]} -eq 0 ]; then pages=(docs/src/tutorials/*.md docs/src/howto/*.md); fi
root=$PWD
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
for page in "${pages[@]}"; do
    folder=$work/$(basename "$page" .md)
    mkdir "$folder"
    python3 - "$root/$page" > "$folder.sh" <<'PYTHON'
import re, sys
text = open(sys.argv[1], encoding="utf-8").read()
for before, skipped, block in re.findall(r"^<!-- before:\n(.*?)^-->$|(<!-- not run: [^>]*-->\n)?^```sh\n(.*?)^```$", text, flags=re.S | re.M):
    if not skipped:
        print(before + block)
PYTHON
    seconds=$SECONDS
    if ! (cd "$folder" && page=$root/$page bash -euo pipefail "$folder.sh" > "$folder.log" 2>&1); then
        tail -20 "$folder.log" >&2
        echo "error: the commands of $page fail" >&2
        exit 1
    fi
    echo "$page: $(grep -c . "$folder.sh") lines, $((SECONDS - seconds)) s"
done
