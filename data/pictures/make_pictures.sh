#!/usr/bin/env bash
# Draw the pictures of README.md and of docs/ again: bash data/pictures/make_pictures.sh (jaxstab installed).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

python pages.py
awk '/^```toml/ { inside = 1; next } /^```/ { inside = 0 } inside' ../../docs/guide.md >"$scratch/my_device.toml"
jaxstab guard "$scratch/my_device.toml" -o "$scratch/my_guard.h" --mass 0.22:0.28 --delay 0.0008:0.0012 \
    --plot ../../docs/guard.png
