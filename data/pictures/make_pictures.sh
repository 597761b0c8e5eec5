#!/usr/bin/env bash
# Draw the pictures of README.md and of docs/ again: bash data/pictures/make_pictures.sh (jaxstab installed).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

jaxstab region --gamma 0 --delta 0.015 --delay 1 -o region.png
jaxstab limits ../scenes/omega.toml --plot limits.png || [ $? = 1 ] # a wall of the scene is unstable
jaxstab atlas build -o "$scratch/atlas.h5"
jaxstab atlas plot "$scratch/atlas.h5" -o atlas.png

python pages.py
awk '/^```toml/ { inside = 1; next } /^```/ { inside = 0 } inside' ../../docs/guide.md >"$scratch/my_device.toml"
jaxstab guard "$scratch/my_device.toml" -o "$scratch/my_guard.h" --mass 0.22:0.28 --delay 0.0008:0.0012 \
    --plot ../../docs/guard.png
