#!/usr/bin/env sh
# The studio in a headless Chromium, from the demo to kill -9, and against the command line. STUDIO_SHOTS=DIR keeps screenshots.
set -eu
cd "$(dirname "$0")/.."
command -v chromium >/dev/null || apt-get install -qq -y --no-install-recommends chromium >/dev/null
if [ -z "${NONRIGID_BUILT:-}" ]; then # 1: the programs that are there
    cargo build --release --bin nonrigid
    cargo build --release -p studio
fi
node studio/web/e2e/studio.mjs target/release/nonrigid-studio target/release/nonrigid
node studio/web/e2e/tools.mjs target/release/nonrigid-studio
