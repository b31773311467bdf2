#!/usr/bin/env bash
# The way of a newcomer: in a home of its own, on a clone of what is committed, run the commands of README's "Install" (but the Python package) and
# "One minute", and of "Now your own scan" of the artist's tutorial, on a scan that is none of the example's. Takes a build; CARGO_TARGET_DIR may name
# a folder with one, and CARGO_HOME one with what has been downloaded.
set -euo pipefail
repository=$(cd "$(dirname "$0")/.." && pwd)
home=$(mktemp -d)
trap 'rm -rf "$home"' EXIT
git clone --quiet "$repository" "$home/nonrigid"
cd "$home/nonrigid"
python3 - > "$home/commands.sh" <<'PYTHON'
import re

def commands(page, heading):
    section = re.split(r"^## ", open(page, encoding="utf-8").read(), flags=re.M)
    section = next(s for s in section if s.startswith(heading))
    blocks = "".join(re.findall(r"^```sh\n(.*?)^```$", section, flags=re.S | re.M))
    lines = blocks.replace("\\\n", " ").replace(" && ", "\n").splitlines()
    return [line.split("  #")[0].strip() for line in lines if line.strip() and not line.startswith("pip ")]

wanted = commands("README.md", "Install") + commands("README.md", "One minute")
print("\n".join(wanted + commands("docs/src/tutorials/artist.md", "Now your own scan")))
PYTHON
count=$(wc -l < "$home/commands.sh")
[ "$count" -le 10 ] || { echo "error: $count commands to the first own scan, ten at most" >&2; exit 1; }
rustup=${RUSTUP_HOME:-$HOME/.rustup} cargo=${CARGO_HOME:-$HOME/.cargo} toolchain=$(rustup show active-toolchain | cut -d' ' -f1)
clean() {
    env -i HOME="$home" PATH="$home/.cargo/bin:$(dirname "$(command -v cargo)"):/usr/local/bin:/usr/bin:/bin" CARGO_INSTALL_ROOT="$home/.cargo" \
        RUSTUP_HOME="$rustup" RUSTUP_TOOLCHAIN="$toolchain" CARGO_HOME="$cargo" ${CARGO_TARGET_DIR:+CARGO_TARGET_DIR="$CARGO_TARGET_DIR"} "$@"
}
while read -r -u 3 command; do
    # What the newcomer's own scanner and landmark program would have left.
    if [[ $command == *" scan.ply"* ]] && [ ! -e scan.ply ]; then
        clean data-gen --seed 2024 --cases 1 --out "$home/other" > /dev/null
        cp "$home"/other/cases/*/{scan.ply,landmarks.json} .
    fi
    echo "\$ $command"
    seconds=$SECONDS
    clean bash -euo pipefail -c "$command"
    echo "# $((SECONDS - seconds)) s"
done 3< "$home/commands.sh"
for file in wrapped.obj wrapped.png mine.obj mine.png distance.png; do [ -s "$file" ] || { echo "error: no $file" >&2; exit 1; }; done
echo "$count commands from nothing to the first own scan"
