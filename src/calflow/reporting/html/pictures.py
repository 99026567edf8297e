"""Drawings as small pictures, so that a page with every figure can be sent by mail, however many rows are in them."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

PER_INCH = 168  # dots: letters are sharp on a telephone, too
COLOURS = 64  # enough for the shades of a report's figures


def pictures(folder: Path, names: Sequence[str]) -> dict[str, bytes]:
    """Return the SVG drawings of a folder by their names, as WebP pictures.

    They are drawn by typst, which takes a small part of the time that Matplotlib would take to draw each once more.
    """
    import typst

    if not names:
        return {}
    pages = "\n#pagebreak()\n".join(f'#image("/{name}.svg")' for name in names)
    source = f"#set page(width: auto, height: auto, margin: 0pt)\n{pages}".encode()
    drawn = typst.compile(source, root=str(folder), format="png", ppi=PER_INCH, ignore_system_fonts=True)  # type: ignore[call-overload]
    each = drawn if isinstance(drawn, list) else [drawn]
    return {name: _small(Image.open(io.BytesIO(page))) for name, page in zip(names, each, strict=True)}


def _small(picture: Image.Image) -> bytes:
    """Return a picture in few colours, without loss in what is left of it."""
    kept = io.BytesIO()
    picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).convert("RGB").save(kept, "webp", lossless=True)
    return kept.getvalue()
