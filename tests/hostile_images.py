"""Atlas files of which the HDF5 image says something else than the table: edits by name."""

from collections.abc import Callable

import h5py
import numpy as np
from footers import sealed
from hostile import parted


def with_another_image(data: bytes, edit: Callable[[h5py.File], None]) -> bytes:
    """A file with an edit of its image, the table as it was, and the right footer."""
    image, table = parted(data)
    with h5py.File.in_memory(image) as opened:
        edit(opened)
        opened.flush()
        return sealed(bytes(opened.id.get_file_image()), table)


def replace(name: str, **options: object) -> Callable[[h5py.File], None]:
    """An edit that stores a dataset in another way."""

    def edit(opened: h5py.File) -> None:
        values = opened[name][()]
        del opened[name]
        opened.create_dataset(name, **({"data": values} | options))

    return edit


def soft_link(opened: h5py.File) -> None:
    opened.move("alpha", "hidden")
    opened["alpha"] = h5py.SoftLink("/hidden")


def external_link(opened: h5py.File) -> None:
    del opened["alpha"]
    opened["alpha"] = h5py.ExternalLink("/etc/passwd", "/alpha")


def group(opened: h5py.File) -> None:
    del opened["alpha"]
    opened.create_group("alpha")


def stranger(opened: h5py.File) -> None:
    opened["passengers"] = np.arange(3)


def groups(opened: h5py.File) -> None:
    opened.create_group("a/b/c")


def hard_link(opened: h5py.File) -> None:
    opened["another name"] = opened["alpha"]


def missing(opened: h5py.File) -> None:
    del opened["alpha"]


def half_a_product(opened: h5py.File) -> None:
    del opened["cell_verdict"]


def virtual(opened: h5py.File) -> None:
    shape = opened["verdict"].shape
    del opened["verdict"]
    layout = h5py.VirtualLayout(shape, np.int8)
    layout[:] = h5py.VirtualSource("elsewhere.h5", "verdict", shape)
    opened.create_virtual_dataset("verdict", layout)


def external_storage(opened: h5py.File) -> None:
    shape = opened["verdict"].shape
    del opened["verdict"]
    opened.create_dataset(
        "verdict", shape, np.int8, external=[("/etc/passwd", 0, h5py.h5f.UNLIMITED)]
    )


def promise_without_data(opened: h5py.File) -> None:
    shape = (1 << 10, *opened["verdict"].shape[1:])
    del opened["verdict"]
    opened.create_dataset(
        "verdict",
        shape,
        np.int8,
        chunks=shape,
        shuffle=True,
        compression="gzip",
        fletcher32=True,
    )


def descending_axis(opened: h5py.File) -> None:
    opened["gamma"][:] = opened["gamma"][()][::-1]


def short_axis(opened: h5py.File) -> None:
    replace("alpha", data=opened["alpha"][:-1], **AS_WRITTEN)(opened)


def say(value: object) -> Callable[[h5py.File], None]:
    """An edit of what a reader may ask for first."""

    def edit(opened: h5py.File) -> None:
        opened.attrs["content_sha256"] = opened["alpha"].ref if value is h5py.ref_dtype else value

    return edit


def filters_twice(opened: h5py.File) -> None:
    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    layout.set_chunk(opened["alpha"].chunks)
    for _ in range(2):
        layout.set_shuffle()
        layout.set_deflate(6)
        layout.set_fletcher32()
    values = opened["alpha"][()]
    del opened["alpha"]
    space = h5py.h5s.create_simple(values.shape)
    dataset = h5py.h5d.create(opened.id, b"alpha", h5py.h5t.IEEE_F64LE, space, layout)
    dataset.write(h5py.h5s.ALL, h5py.h5s.ALL, values)


AS_WRITTEN = {"chunks": True, "shuffle": True, "compression": "gzip", "fletcher32": True}
IMAGES = {
    edit.__name__: edit
    for edit in (
        soft_link,
        external_link,
        group,
        stranger,
        missing,
        half_a_product,
        virtual,
        external_storage,
        promise_without_data,
        descending_axis,
        short_axis,
        groups,
        hard_link,
    )
} | {
    "array attribute": say(np.full(1000, b"jaxstab atlas__")),
    "attribute of any length": say("jaxstab atlas"),
    "huge attribute": say(np.bytes_(b"a" * 65000)),
    "object attribute": say(h5py.ref_dtype),
    "attribute of numbers": say(np.arange(3)),
    "empty attribute": say(h5py.Empty("S64")),
    "contiguous": replace("alpha"),
    "unchecked": replace("alpha", chunks=True, compression="gzip", shuffle=True),
    "other filter": replace("alpha", compression="lzf", shuffle=True, fletcher32=True),
    "single precision": replace("alpha", dtype="float32", chunks=True),
    "complex": replace("alpha", data=np.zeros((24, 2), complex), **AS_WRITTEN),
    "big endian": replace("alpha", dtype=">f8", **AS_WRITTEN),
    "half precision": replace("alpha", dtype="float16", **AS_WRITTEN),
    "unsigned codes": replace("verdict", dtype="uint8", **AS_WRITTEN),
    "an enumeration": replace("verdict", dtype=h5py.enum_dtype({"a": 0}, "i1"), **AS_WRITTEN),
    "opaque": replace("alpha", data=np.zeros((24, 2), "V8"), **AS_WRITTEN),
    "a compound": replace("alpha", data=np.zeros((24, 2), [("a", "f8")]), **AS_WRITTEN),
    "arrays": replace("alpha", dtype=np.dtype("(3,)f8"), data=None, shape=(24, 2), **AS_WRITTEN),
    "a scalar": replace("alpha", data=1.0),
    "no values": replace("alpha", data=h5py.Empty("f8")),
    "a long line": replace("spec", data=np.array([b"a" * 5000]), **AS_WRITTEN),
    "one filter twice": filters_twice,
    "a lossy filter": replace("spec_line", scaleoffset=0, chunks=True),
    "references": replace("alpha", dtype=h5py.ref_dtype, data=None, shape=(24, 2), chunks=True),
    "strings of any length": replace("spec", dtype=h5py.string_dtype(), data=["a", "b"]),
}
