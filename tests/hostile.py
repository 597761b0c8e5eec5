"""Atlas files from strangers: every checksum is right, and what they say is not.

``assembled`` makes a file out of arrays, as plain bytes: the readers do not look at the HDF5 image.
``hostile_files`` is the list that every reader meets; ``mutants`` makes as many more as are wanted.
"""

import hashlib
import re
import zlib
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from itertools import product

import numpy as np
from footers import image_of, sealed

from jaxstab.atlas import schema
from jaxstab.atlas import schema as footer
from jaxstab.atlas.file import Array
from jaxstab.atlas.product import SLICE
from jaxstab.atlas.products.table import PRODUCTS
from jaxstab.atlas.schema import Span, Stored, table_text, values_digest
from jaxstab.atlas.spec import words_of

Arrays = dict[str, Array]
_FILTERS = words_of(None)
Edit = Callable[[Arrays], None]


def chunks_of(values: Array, chunk: tuple[int, ...]) -> Iterator[Array]:
    steps = (range(0, n, step) for n, step in zip(values.shape, chunk, strict=True))
    for start in product(*steps):
        yield values[tuple(slice(i, i + n) for i, n in zip(start, chunk, strict=True))]


@cache
def zeros(name: str, dtype: str, shape: tuple[int, ...]) -> tuple[bytes, str]:
    """The bytes of a chunk of nothing but zeros, and their digest."""
    values = np.zeros(shape, dtype)
    return stored(name, values, shape), values_digest(values)


def stored(name: str, values: Array, chunk: tuple[int, ...]) -> bytes:
    """The bytes of a chunk, with a checksum of HDF5 that no reader of the table looks at."""
    whole = np.zeros(chunk, values.dtype)
    whole[tuple(map(slice, values.shape))] = values
    data = whole.tobytes()
    if schema.VARIABLES[name].is_packed:
        planes = np.frombuffer(data, np.uint8).reshape(-1, values.dtype.itemsize)
        data = zlib.compress(planes.T.tobytes(), 1)
    return data + bytes(4)


def assembled(
    arrays: Mapping[str, Array],
    chunks: Mapping[str, tuple[int, ...]] | None = None,
    made_by: str = "jaxstab 0",
) -> bytes:
    """A file of these arrays, right in all but perhaps what they say."""
    image, variables = b"an image", []
    for name, values in arrays.items():
        chunk = (chunks or {}).get(name, values.shape)
        where: list[Span] = []
        digests = []
        for part in chunks_of(values, chunk):
            if any(part.strides) or part.shape != chunk:
                data, digest = stored(name, part, chunk), values_digest(part)
            else:  # zeros that take no memory
                data, digest = zeros(name, part.dtype.str, chunk)
            where.append((len(image), len(data)))
            digests.append(digest)
            image += data
        variable = schema.VARIABLES[name]
        variables.append(Stored(variable, values.dtype, values.shape, chunk, digests, where))
    return sealed(image, table_text(made_by, _FILTERS, variables))


def parted(data: bytes) -> tuple[bytes, bytes]:
    """The image and the table of a file."""
    image = image_of(data)
    assert image is not None
    return image, data[len(image) : -footer.FOOTER.size]


def retold(data: bytes, edit: Callable[[str], str]) -> bytes:
    """A file with an edit of its table, and right digests again."""
    image, table = parted(data)
    head, shapes, *rest = edit(table.decode("latin-1")).split("\n\n")
    digest = hashlib.sha256(f"{shapes}\n".encode("latin-1")).hexdigest()
    head = re.sub(r"(?<=\ncontent )[0-9a-f]{64}", digest, head)
    return sealed(image, "\n\n".join([head, shapes, *rest]).encode("latin-1"))


# ----------------------------------------------------------------------------------------- the list


def put(name: str, value: object, place: object = 0) -> Edit:
    """An edit of some values of an array."""

    def edit(arrays: Arrays) -> None:
        arrays[name] = arrays[name].copy()
        arrays[name][place] = value

    return edit


def become(name: str, change: Callable[[Array], Array]) -> Edit:
    def edit(arrays: Arrays) -> None:
        arrays[name] = np.ascontiguousarray(change(arrays[name]))

    return edit


def without(*names: str) -> Edit:
    def edit(arrays: Arrays) -> None:
        for name in names:
            arrays.pop(name, None)

    return edit


def errors(value: float) -> Edit:
    return put("alpha_limits", value, (..., [9, 19]))


VALUES: dict[str, Edit] = {
    "negative error bounds": errors(-1e-3),
    "error bounds of NaN": errors(np.nan),
    "an upper error of NaN": put("alpha_limits", np.nan, (0, 0, 0, 0, 13)),
    "limits of NaN": put("alpha_limits", np.nan, (0, 0, 0, 0, 0)),
    "an infinite slope": put("alpha_limits", -np.inf, (0, 0, 0, 0, 1)),
    "reversed gamma": become("gamma", lambda v: v[::-1]),
    "an infinite slope along the delay": put("alpha_limits", np.inf, (0, 0, 0, 0, 5)),
    "cells of delays reversed": become("limit_range", lambda v: v[::-1]),
    "cells of delays that overlap": put("limit_range", 1.25, (0, 1)),
    "a cell of delays twice": become("limit_range", lambda v: v[[0, *range(len(v) - 1)]]),
    "a cell that ends before it begins": put("limit_range", 0.5, (-1, 1)),
    "limits at a negative delay": put("limit_range", -1.0, (0, 0)),
    "limits at a delay of NaN": put("limit_range", np.nan, (-1, 1)),
    "limits at a delay of 1000": put("limit_range", 1000.0, (-1, 1)),
    "limits at an infinite beta": put("limit_range", np.inf, (0, 5)),
    "limits at an alpha of NaN": put("limit_range", np.nan, (0, 2)),
    "limits at too wide a beta": put("limit_range", [-1.5e308, 1.5e308], (0, [4, 5])),
    "limits at a thin beta": put("limit_range", [0.0, 1e-302], (0, [4, 5])),
    "limits at a beta that rounding swallows": put(
        "limit_range", [1.0, 1.0 + 2.0**-45], (0, [4, 5])
    ),
    "limits at an alpha that rounding swallows": put(
        "limit_range", [-1.0, -1.0 + 2.0**-25], (0, [2, 3])
    ),
    "limits at one alpha": put("limit_range", 0.1, (0, [2, 3])),
    "five ends": become("limit_range", lambda v: v[:, :5]),
    "gamma twice": become("gamma", lambda v: np.full_like(v, v[0])),
    "negative gamma": become("gamma", lambda v: v - 1.0),
    "negative delta": put("delta", -1e-300),
    "five terms": become("alpha_limits", lambda v: v[..., :5]),
    "a delay too few": become("alpha_limits", lambda v: v[:, :, :, :1]),
    "cells as nodes": become("alpha_limits", lambda v: v[:, :1]),
    "limits in double precision": become("alpha_limits", lambda v: v.astype("<f8")),
    "single precision": become("gamma", lambda v: v.astype("<f4")),
    "big endian": become("gamma", lambda v: v.astype(">f8")),
    "whole numbers": become("gamma", lambda v: v.astype("<i8")),
    "one dimension more": become("gamma", lambda v: v[:, None]),
    "a dimension less": become("alpha_limits", lambda v: v[0]),
}
"""What C and Octave read as well."""

ELSEWHERE: dict[str, Edit] = {
    "reversed delays": become("delay", lambda v: v[::-1]),
    "reversed alpha": become("alpha", lambda v: v[::-1]),
    "a negative delay": put("delay", -1.0),
    "a delay of NaN": put("delay", np.nan, -1),
    "a delay of 1000": put("delay", 1000.0, -1),
    "an infinite beta": put("beta", np.inf, -1),
    "alpha of NaN": put("alpha", np.nan, (0, 0)),
    "too wide a beta": become(
        "beta", lambda v: np.stack([v[0] - 1.5e308, *v[1:-1], v[-1] + 1.5e308])
    ),
    "a thin beta": become(
        "beta", lambda v: np.arange(len(v))[:, None] * np.full((1, v.shape[1]), 1e-302)
    ),
    "too thin a beta": become(
        "beta", lambda v: np.arange(len(v))[:, None] * np.full((1, v.shape[1]), 5e-324)
    ),
    "a beta that rounding swallows": become(
        "beta", lambda v: 1.0 + 2.0**-50 * np.arange(len(v))[:, None] * np.ones((1, v.shape[1]))
    ),
    "lines of no text": become("spec", lambda v: np.array([b"\xff", *v[1:]], v.dtype)),
    "one alpha": become("alpha", lambda v: v[:1]),
    "node numbers": put("alpha_node", 7),
    "cell numbers": become("limit_cell", lambda v: v[::-1]),
    "a code beyond": put("verdict", 4),
    "a negative code": put("cell_verdict", -1),
    "a negative radius": put("spectral_radius", -1.0),
    "a damping ratio beyond": put("damping_ratio", 1.5),
    "a number of poles beyond": put("outside", -2),
    "half a product": without("cell_verdict"),
    "no products": without(*(set(schema.VARIABLES) - schema.ALWAYS)),
    "no axis": without("gamma", "alpha_node"),
    "another order": lambda arrays: arrays.update(delay=arrays.pop("delay")),
    "long lines": become("spec", lambda v: v.astype("S5000")),
    "no bytes": become("verdict", lambda v: v.astype(np.uint8)),
}
"""What the readers of limits alone do not look at."""


def sub(pattern: str, text: str, count: int = 1) -> Callable[[str], str]:
    return lambda table: re.sub(pattern, text, table, count=count)


_AT = r"(?<=\nalpha_limits )\d+\+\d+"
TABLES: dict[str, Callable[[str], str]] = {
    "version 2": sub("atlas 3", "atlas 2"),
    "version 4": sub("atlas 3", "atlas 4"),
    "version -1": sub("atlas 3", "atlas -1"),
    "a version beyond integers": sub("atlas 3", "atlas 99999999999999999999"),
    "another format": sub("jaxstab atlas", "jaxstab table"),
    "no table": lambda _: "\n\n\n\n",
    "a nul byte": sub("\nalpha_limits ", "\nalpha\0limits "),
    "a block less": lambda table: table[: table.rindex("\n\n") + 1],
    "a huge array": sub(r"alpha_limits <f4 \d+", "alpha_limits <f4 999999999999"),
    "a product of 0 modulo 2^64": sub(
        r"alpha_limits <f4 \S+", "alpha_limits <f4 4294967296x4294967296x1x1x14"
    ),
    "a huge chunk": sub(r"(alpha_limits <f4 \S+) \d+", r"\1 999999999999"),
    "a chunk larger than the array": sub(r"(alpha_limits <f4 \S+) 4x", r"\1 5x"),
    "a chunk of nothing": sub(r"(alpha_limits <f4 \S+) 4x", r"\1 0x"),
    "an array of nothing": sub(r"alpha_limits <f4 4x", "alpha_limits <f4 0x"),
    "a negative length": sub(r"alpha_limits <f4 4x", "alpha_limits <f4 -4x"),
    "a length with a sign": sub(r"alpha_limits <f4 4x", "alpha_limits <f4 +4x"),
    "a length in hexadecimal": sub(r"alpha_limits <f4 4x", "alpha_limits <f4 0x4x"),
    "a long length": sub(r"alpha_limits <f4 4x", f"alpha_limits <f4 {'0' * 5000}4x"),
    "an object": sub(r"alpha_limits <f4", "alpha_limits |O"),
    "a place beyond the image": sub(_AT, "9999999+1924"),
    "a place at the end of numbers": sub(_AT, "18446744073709551615+1924"),
    "a negative place": sub(_AT, "-1+1924"),
    "a size of nothing": sub(_AT, "8+0"),
    "a size too large": sub(_AT, "8+999999"),
    "another place": sub(_AT, "8+5380"),
    "no place": sub(r"(\nalpha_limits) \d+\+\d+", r"\1"),
    "places too many": sub(f"({_AT})", r"\1 \1"),
    "other names": sub(r"\ngamma ", "\ngamme ", 0),
    "no filters": sub("\nfilters [^\n]*", ""),
    "a wrong digest": sub(r"(alpha_limits <f4 \S+ \S+) [0-9a-f]", r"\1 g"),
    "a digest of others": sub(r"(alpha_limits <f4 \S+ \S+) [0-9a-f]{8}", r"\1 01234567"),
    "a short digest": sub(r"(alpha_limits <f4 \S+ \S+ [0-9a-f]+)[0-9a-f]\n", "\\1\n"),
    "no digest": sub(r"(alpha_limits <f4 \S+ \S+) [0-9a-f]+\n", "\\1\n"),
}
WORDS: dict[str, Callable[[str], str]] = {
    "a nul byte at the end": lambda table: table + "\0",
    "no end": lambda table: table[:-1],
    "a block more": lambda table: table + "\nmore 1+1\n",
    "a name twice": sub(r"(\nalpha [^\n]*)", r"\1\1", 0),
    "a stranger": sub(r"\n\n(?=\w+ )", "\n\npassengers 1+1\n", 0),
    "terminal escapes": sub("made by [^\n]*", "made by \x1b]0;title\x07"),
    "no program": sub("made by [^\n]*", "made by "),
    "escapes in the filters": sub("filters [^\n]*", "filters \x1b]0;title\x07"),
    "endless filters": sub("filters [^\n]*", "filters " + "a" * 5000),
    "letters beyond ASCII": sub("made by [^\n]*", "made by \xe9"),
    "an overlap": sub(r"(\ncell_verdict) \d+(\+\d+)", r"\1 8\2"),
}
"""What the readers of limits alone do not look at."""


def long_tables(base: Arrays) -> dict[str, bytes]:
    """Tables of megabytes that would become hundreds of them in lists of words."""
    image, table = parted(assembled(base))
    return {
        "many lines": sealed(image, table + b"\n" * 10**7),
        "many blocks": sealed(image, table.replace(b"\n\n", b"\n" * 10**7, 1)),
        "many words": retold(
            assembled(base), sub(r"(\nalpha_limits) (?=\d+\+)", r"\1" + " 1" * 10**6)
        ),
        "many lengths": retold(
            assembled(base), sub("alpha_limits <f4 ", f"alpha_limits <f4 {'1x' * 10**6}")
        ),
        "many digests": retold(
            assembled(base), sub(r"(alpha_limits <f4 \S+ \S+)", r"\1" + " a" * 10**6)
        ),
    }


def longer_stream(base: Arrays) -> bytes:
    """A chunk of fields that goes on for 64 MB when it is inflated."""
    image, table = parted(assembled(base))
    packed = zlib.compress(bytes(2**26), 1)
    place = f"{len(image)}+{len(packed) + 4}"
    text = re.sub(r"(\noutside )\d+\+\d+", rf"\g<1>{place}", table.decode())
    return sealed(image + packed + bytes(4), text.encode())


def bomb(base: Arrays) -> bytes:
    """A megabyte that promises 226 MB of fields, and has them: zeros."""
    count, (gammas, deltas, delays) = 2048, (base[name].size for name in SLICE)
    arrays = dict(base)
    for name in ("verdict", "cell_verdict", *PRODUCTS["alpha_limits"].names):
        del arrays[name]
    for name in ("alpha", "beta"):
        arrays[f"{name}_node"] = np.arange(count, dtype=np.int32)
        arrays[f"{name}_cell"] = np.arange(count - 1, dtype=np.int32)
        arrays[name] = np.linspace(0.0, 1.0, count)[:, None] * np.ones((1, delays))
    shape = count, count, gammas, deltas, delays
    fields = PRODUCTS["fields"].names[:-1]
    arrays |= {name: np.broadcast_to(base[name].dtype.type(0), shape) for name in fields}
    return assembled(arrays, dict.fromkeys(fields, (count, count, 1, 1, 1)))


def wrong_content(data: bytes) -> bytes:
    image, table = parted(data)
    return sealed(image, re.sub(rb"content [0-9a-f]{8}", b"content 01234567", table))


def hostile_files(base: Arrays) -> dict[str, tuple[bytes, bool]]:
    """Files by name, and whether the readers of limits must refuse them as Python does."""
    whole = assembled(base)
    files = {}
    for edits, by_all in ((VALUES, True), (ELSEWHERE, False)):
        for name, edit in edits.items():
            arrays = dict(base)
            edit(arrays)
            files[name] = assembled(arrays), by_all
    for tables, by_all in ((TABLES, True), (WORDS, False)):
        files |= {name: (retold(whole, edit), by_all) for name, edit in tables.items()}
    files["a wrong content_sha256"] = wrong_content(whole), True
    files["a bomb"] = bomb(base), True
    files["a longer stream"] = longer_stream(base), False
    files |= {name: (data, False) for name, data in long_tables(base).items()}
    return files


# ------------------------------------------------------------------------------------------ mutants


def mutants(base: Arrays, rng: np.random.Generator, count: int) -> Iterator[bytes]:
    """Files with some bytes of table or chunks changed; digests are right again, but some."""
    whole = assembled(base, chunks={"alpha_limits": (3, 1, 2, 1, 20)})
    for _ in range(count):
        if rng.random() < 0.7:
            yield retold(whole, lambda text: _mutated_text(text, rng))
        else:
            yield _mutated_values(base, rng)


def _mutated_text(text: str, rng: np.random.Generator) -> str:
    """Another number, digit, letter, line or part of a line, once or a few times."""
    for _ in range(int(rng.integers(1, 4))):
        numbers = list(re.finditer(r"\d+", text))
        found = numbers[int(rng.integers(len(numbers)))]
        number = int(found[0][:15])
        others = [0, 1, number + 1, max(number - 1, 0), number * 2, 2**31, 2**32, 10**12 - 1, -1]
        lines = text.split("\n")
        i, j = rng.integers(len(lines), size=2)
        kind = int(rng.integers(5))
        if kind < 2:
            text = f"{text[: found.start()]}{rng.choice(others)}{text[found.end() :]}"
        elif kind == 2:
            lines[i], lines[j] = lines[j], lines[i]
            text = "\n".join(lines)
        elif kind == 3:
            text = "\n".join(lines[:i] + lines[i + int(rng.integers(2)) :] + [lines[j]])
        else:
            place, letter = int(rng.integers(len(text))), chr(int(rng.integers(256)))
            text = text[:place] + letter + text[place + int(rng.integers(3)) :]
    return text if text.count("\n\n") else text + "\n\n"


_NUMBERS = (np.nan, np.inf, -np.inf, -1.0, 0.0, 5e-324, -1e-300, 1e308, -1e308, 0.5)


def _mutated_values(base: Arrays, rng: np.random.Generator) -> bytes:
    arrays = dict(base)
    name = str(rng.choice([n for n, values in base.items() if values.dtype.kind != "S"]))
    values = base[name].copy()
    for place in rng.integers(values.size, size=int(rng.integers(1, 4))):
        new = rng.choice(_NUMBERS) if values.dtype.kind == "f" else rng.integers(-2, 6)
        with np.errstate(over="ignore"):
            values.flat[place] = np.array(new).astype(values.dtype)
    arrays[name] = values
    return assembled(arrays)
