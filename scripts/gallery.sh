#!/usr/bin/env bash
# Makes the pictures of docs/src/gallery.md anew: runs its commands and keeps what its comments name. Needs Python with Pillow.
set -euo pipefail
cd "$(dirname "$0")/.."
cargo build --release --quiet --bins
export PATH="$PWD/target/release:$PATH"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
page=$PWD/docs/src/gallery.md
python3 - "$page" > "$work/commands.sh" <<'PYTHON'
import re, sys
print("\n".join(re.findall(r"^```sh\n(.*?)^```$", open(sys.argv[1], encoding="utf-8").read(), flags=re.S | re.M)))
PYTHON
(cd "$work" && bash -euo pipefail commands.sh)
python3 - "$page" "$work" <<'PYTHON'
import pathlib, re, sys
from PIL import Image
page, work = map(pathlib.Path, sys.argv[1:])
for kept, made in re.findall(r"\((images/gallery/\S+)\)\n<!-- picture: (\S+) -->", page.read_text(encoding="utf-8")):
    image = Image.open(work / made).convert("RGB")
    image.thumbnail((1000, 4000), Image.Resampling.LANCZOS)
    image.quantize(128, dither=Image.Dither.NONE).save(page.parent / kept, optimize=True)
PYTHON
