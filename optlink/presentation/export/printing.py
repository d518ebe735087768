"""Files of closed solids [mm], STL and 3MF here: the parts beside each other on a plate, or the assembly in its layers."""

import struct
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np

from optlink.linkage.mechanism import FRAME
from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import Array
from optlink.presentation.parts.layers import Stacked
from optlink.presentation.parts.layout import laid_out
from optlink.presentation.parts.model import MM, FlatPart, PartSet, Pin, placed
from optlink.presentation.parts.solids import Solid, plate, stud

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
TYPES = "http://schemas.openxmlformats.org/package/2006/content-types"
RELATIONS = "http://schemas.openxmlformats.org/package/2006/relationships"
MODEL = "3D/3dmodel.model"
LONG_AGO = (1980, 1, 1, 0, 0, 0)  # the same design gives the same file


class Movable(Protocol):
    """A named body, which can be put anywhere."""

    def moved(self, shift: Array, angle: float = 0.0) -> Self:
        """Return it turned by an angle [rad] about the z axis, then shifted by a vector (3,) [mm]."""


B = TypeVar("B", bound=Movable)


@dataclass(frozen=True)
class Kernel(Generic[B]):
    """What makes bodies of parts and of pins between two heights [mm], and writes them to a file with a title."""

    plate: Callable[[FlatPart], B]
    stud: Callable[[Pin, float, float], B]
    write: Callable[[Sequence[B], str, Path], None]

    def on_plate(self, parts: PartSet) -> Iterator[B]:
        """Yield every part beside the others, flat on z = 0."""
        for one in laid_out(parts.parts.values()).parts:
            yield self.plate(one.part).moved(np.append(one.shift, 0.0))

    def assembled(self, stack: Stacked, motion: Motion) -> Iterator[B]:
        """Yield every part, pin and spacer of the assembly at the first position of a motion."""
        for name, part in stack.parts.parts.items():
            place, angle = np.zeros(2), 0.0
            if name != FRAME:
                place = MM * motion.position(motion.mechanism.origin(name))[0]
                angle = float(np.asarray(motion.body_angle(name).value)[0])
            yield self.plate(part).moved(np.append(place, stack.heights[name]), angle)
        for pin in stack.parts.pins:
            yield self.stud(pin, *stack.span(pin)).moved(np.append(_axis(pin, motion), 0.0))
        for pin, low, part in stack.spacers:
            yield self.plate(part).moved(np.append(_axis(pin, motion), low))


def _axis(pin: Pin, motion: Motion) -> Array:
    return np.asarray(placed(motion, pin.on, pin.at[None])[0, 0])


def stl(solids: Sequence[Solid], title: str, path: Path) -> None:
    """Write a binary STL file of all solids."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    corners = np.concatenate([one.places[one.triangles] for one in solids])
    rows = np.zeros(len(corners), record)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    rows["normal"] = normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-30)[:, None]
    rows["corners"] = corners
    header = f"optlink, millimetres: {title}".encode("ascii", "replace")[:80].ljust(80)
    path.write_bytes(header + struct.pack("<I", len(rows)) + rows.tobytes())


def threemf(solids: Sequence[Solid], title: str, path: Path) -> None:
    """Write a 3MF file with an object of its name for every solid."""
    objects, items = [], []
    for number, one in enumerate(solids, 1):
        places = "".join(f'<vertex x="{x:.12g}" y="{y:.12g}" z="{z:.12g}"/>' for x, y, z in one.places.tolist())
        faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in one.triangles.tolist())
        mesh = f"<mesh><vertices>{places}</vertices><triangles>{faces}</triangles></mesh>"
        objects.append(f'<object id="{number}" type="model" name="{escape(one.name)}">{mesh}</object>')
        items.append(f'<item objectid="{number}"/>')
    head = '<?xml version="1.0" encoding="UTF-8"?>\n'
    kinds = (("rels", "application/vnd.openxmlformats-package.relationships+xml"), ("model", f"{_KIND}+xml"))
    types = "".join(f'<Default Extension="{ending}" ContentType="{kind}"/>' for ending, kind in kinds)
    start = f'<Relationship Id="model" Target="/{MODEL}" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
    files = {
        "[Content_Types].xml": f'{head}<Types xmlns="{TYPES}">{types}</Types>',
        "_rels/.rels": f'{head}<Relationships xmlns="{RELATIONS}">{start}</Relationships>',
        MODEL: (
            f'{head}<model unit="millimeter" xml:lang="en-GB" xmlns="{CORE}"><metadata name="Title">{escape(title)}</metadata>'
            f"<resources>{''.join(objects)}</resources><build>{''.join(items)}</build></model>"
        ),
    }
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(zipfile.ZipInfo(name, LONG_AGO), text.encode(), zipfile.ZIP_DEFLATED)


_KIND = "application/vnd.ms-package.3dmanufacturing-3dmodel"


def _mesh(write: Callable[[Sequence[Solid], str, Path], None]) -> Kernel[Solid]:
    return Kernel(plate, stud, write)


def _exact() -> Kernel[Any]:
    from optlink.presentation.export import step

    return Kernel(step.plate, step.stud, step.step)


KERNELS: dict[str, Callable[[], Kernel[Any]]] = {".stl": partial(_mesh, stl), ".3mf": partial(_mesh, threemf), ".step": _exact}
"""What makes and writes solids, by the ending of the file."""
