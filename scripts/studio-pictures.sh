#!/usr/bin/env sh
# Pictures of the studio in docs/src/images: studio-plan.png, studio-analyse.png and the clip studio.webp. Needs a Chromium, and
# Python with Pillow for the clip.
set -eu
cd "$(dirname "$0")/.."
cargo build --release -p studio
frames=$(mktemp -d)
trap 'rm -rf "$frames"' EXIT
node studio/web/e2e/pictures.mjs target/release/nonrigid-studio docs/src/images "$frames"
python3 - "$frames" docs/src/images/studio.webp <<'PYTHON'
import pathlib, sys
from PIL import Image
paths = sorted(pathlib.Path(sys.argv[1]).glob("*.png"))
images = [Image.open(p).convert("RGB").resize((800, 450), Image.LANCZOS) for p in paths]
images[0].save(sys.argv[2], save_all=True, append_images=images[1:], duration=200, loop=0, quality=70, method=4)
PYTHON
