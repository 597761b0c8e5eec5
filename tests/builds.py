"""A tiny atlas, for the tests of builds: its tiles are computed once."""

from functools import cache
from pathlib import Path

from jaxstab import AtlasSpec, plan_atlas
from jaxstab.atlas.plan import Plan, Tile
from jaxstab.atlas.write.tiles import Build

KEY = "0" * 64
TINY = AtlasSpec(
    alpha=[0.0, 0.1, 0.2], beta=[0.1, 0.2], gamma=[0.0, 0.001], delta=[0.015], delay=[0.0, 1.0],
    products=["verdict"],
)  # fmt: skip
FORMER = b"the former file"


@cache
def tiny_plan() -> Plan:
    return plan_atlas(TINY)


def tiny_build(key: str = KEY) -> Build:
    return Build(TINY, key, Path("a.h5"))


@cache
def tiny_images() -> dict[Tile, bytes]:
    return {tile: tiny_build().image(tile) for tile in tiny_plan().tiles}


def entries(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())
