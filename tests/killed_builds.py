"""Builds an atlas again and again and kills each build at a random time; prints what was found.

Run with a path and a number of kills. The specification, the key and the images of the tiles, and
the bytes of the whole atlas come pickled from stdin: no child computes, so all can be forked.
"""

import os
import pickle
import random
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jaxstab import build_atlas, tiles
from jaxstab.atlas.write import build

FORMER = b"the former file"
spec, key, images, whole = pickle.load(sys.stdin.buffer)
path, kills = Path(sys.argv[1]), int(sys.argv[2])


def stored_images(_: Any, items: Any, *__: Any) -> Iterator[Any]:
    for tile in items:
        time.sleep(0.001)
        yield tile, images[tile]


build.build_key, tiles.images = (lambda *_: key), stored_images
start = time.perf_counter()
build_atlas(spec, path)
takes = time.perf_counter() - start
chance = random.Random(20120412)
found = {FORMER: 0, whole: 0}
path.write_bytes(FORMER)
for _ in range(kills):
    child = os.fork()
    if child == 0:
        build_atlas(spec, path)
        os._exit(0)
    time.sleep(chance.uniform(0.0, 1.5 * takes))
    os.kill(child, 9)
    os.waitpid(child, 0)
    found[path.read_bytes()] += 1
    if path.read_bytes() == whole:
        path.write_bytes(FORMER)
build_atlas(spec, path)
assert path.read_bytes() == whole
assert os.listdir(path.parent) == [path.name], os.listdir(path.parent)
sys.stdout.write(" ".join(map(str, found.values())))
