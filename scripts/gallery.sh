#!/usr/bin/env bash
# Makes the pictures of the documentation anew that our programs draw: runs the commands of docs/src/gallery.md and keeps what its comments name, and
# the pictures of other pages. The window's are made by studio-pictures.sh. Needs Python with Pillow.
set -euo pipefail
cd "$(dirname "$0")/.."
[ -n "${NONRIGID_BUILT:-}" ] || cargo build --release --quiet --bins
export PATH="$PWD/target/release:$PATH"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
page=$PWD/docs/src/gallery.md
python3 - "$page" > "$work/commands.sh" <<'PYTHON'
import re, sys
print("\n".join(re.findall(r"^```sh\n(.*?)^```$", open(sys.argv[1], encoding="utf-8").read(), flags=re.S | re.M)))
PYTHON
cd "$work"
bash -euo pipefail commands.sh
# The example of README and of the artist's tutorial.
nonrigid register --template data/rig/template.obj --rig data/rig --identity-modes 40 --target data/cases/same_open/scan.ply \
    --landmarks data/cases/same_open/landmarks.json --out demo.obj --picture demo.png
python3 - "$page" "$work" <<'PYTHON'
import csv, pathlib, re, sys
from PIL import Image

page, work = map(pathlib.Path, sys.argv[1:])
images = page.parent / "images"


def keep(picture, kept, width=1000):
    picture.thumbnail((width, 6000), Image.Resampling.LANCZOS)
    # Rare colours, those of a scale, count as much as skin.
    colours = picture.quantize(256, method=Image.Quantize.MAXCOVERAGE)
    picture.quantize(palette=colours, dither=Image.Dither.FLOYDSTEINBERG).save(kept, optimize=True)


for kept, made in re.findall(r"\(images/(gallery/\S+)\)\n<!-- picture: (\S+) -->", page.read_text(encoding="utf-8")):
    keep(Image.open(work / made).convert("RGB"), images / kept)
keep(Image.open(work / "demo.png").convert("RGB"), images / "demo.png", 1300)
keep(Image.open(work / "figures/surgery.png").convert("RGB"), images / "surgery.png", 1300)

# Fig. 5 with four of its models: margins, rows and panels as src/render/sheet.rs lays them out.
sheet = Image.open(work / "figures/extreme.png").convert("RGB")
with open(work / "figures/extreme.csv", encoding="utf-8") as file:
    models = [row["model"] for row in csv.DictReader(file) if not row["error"]]
margin, gap, panel = 14, 6, 292
high = (sheet.height - 2 * margin + gap) // (len(models) + 1)
right = margin + 4 * (panel + gap)
rows = [0] + [1 + models.index(name) for name in ["hybrid", "sequential", "blendshape", "graph"]]
some = Image.new("RGB", (sheet.width, 2 * margin - gap + high * len(rows)), "white")
some.paste(sheet.crop((right, 0, sheet.width, some.height)), (right, 0))  # the colour bar
for k, row in enumerate(rows):
    top = margin + high * row
    some.paste(sheet.crop((0, top, right, top + high)), (0, margin + high * k))
keep(some, images / "extreme.png")
PYTHON
