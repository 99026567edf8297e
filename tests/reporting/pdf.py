"""What is on the pages of a PDF: their texts and their pictures."""

from __future__ import annotations

import numpy as np
import pypdfium2
from pypdfium2.raw import FPDFText_GetFontSize


def pages_of(pdf: bytes) -> list[str]:
    """The text of each page, with words that are broken at a line's end put together."""
    document = pypdfium2.PdfDocument(pdf)
    texts = [page.get_textpage().get_text_bounded() for page in document]
    return [text.replace("\r\n", "\n").replace("\ufffe\n", "").replace("\ufffe", "") for text in texts]


def smallest_print(pdf: bytes) -> float:
    """The size [points] of the smallest letter on the first page."""
    text = pypdfium2.PdfDocument(pdf)[0].get_textpage()
    letters = [k for k in range(text.count_chars()) if text.get_text_range(k, 1).strip()]
    return min(FPDFText_GetFontSize(text, k) for k in letters)


def pictures_of(pdf: bytes, dots_per_inch: float) -> list[np.ndarray]:
    """Each page in levels of grey, (height, width)."""
    document = pypdfium2.PdfDocument(pdf)
    return [page.render(scale=dots_per_inch / 72, grayscale=True).to_numpy().squeeze() for page in document]


def filled(pdf: bytes) -> list[float]:
    """How far down each page is filled, a share of its height, without what stands on every page."""
    shares = []
    for page in pictures_of(pdf, 20):
        dots = page < 200
        dots = dots[int(0.065 * len(dots)) : int(0.935 * len(dots))]
        shares.append(float((np.flatnonzero(dots.any(axis=1)).max() + 1) / len(dots)))
    return shares
