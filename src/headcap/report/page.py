"""What the report's pages have in common: pictures with captions, and templates that become one file, no script, no network."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import jinja2

from headcap.artifacts import Manifest, atomic_path
from headcap.evaluation.metrics import Figure
from headcap.report.overlays import Image, jpeg_uri, png_uri
from headcap.report.pictures import Picture, error_legend_colours


@dataclass(frozen=True)
class Shown:
    """A picture of a page."""

    uri: str
    """Its content, as a data URI."""
    caption: str
    wide: bool = False
    """Whether it takes the page's whole width."""


def drawing(image: Image, caption: str, colours: int = 128) -> Shown:
    """A diagram over the page's whole width, in so many colours."""
    return Shown(png_uri(image, colours), caption, wide=True)


def photograph(picture: Picture, caption: str | None = None, *, wide: bool = False) -> Shown:
    """A picture of the recordings or of a mesh, with its own caption or another."""
    return Shown(jpeg_uri(picture.image), picture.caption if caption is None else caption, wide)


class PageInputs(Protocol):
    """What every page tells."""

    @property
    def figures(self) -> Sequence[Figure]:
        """All figures, held to their limits or not."""

    @property
    def manifests(self) -> Sequence[tuple[str, Manifest]]:
        """What the page was made of, by path."""

    @property
    def versions(self) -> Mapping[str, str]:
        """Of the software."""

    @property
    def settings(self) -> Mapping[str, Any]:
        """As they were given."""


def write_page(path: Path | str, template: str, inputs: PageInputs, **content: Any) -> None:
    """Write a page as one HTML file from a template that extends `page.html.j2`."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("headcap.report", "."), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["value"] = number
    held = [figure.ok for figure in inputs.figures if figure.ok is not None]
    page = environment.get_template(template).render(
        inputs=inputs,
        # figures within their limits, and past them
        verdict=(held.count(True), held.count(False)),
        legend=error_legend_colours(),
        settings=json.dumps(dict(inputs.settings), indent=2, sort_keys=True, default=str),
        **content,
    )
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def number(value: float | None) -> str:
    """A figure's value as the pages tell it."""
    if value is None:
        return "not measured"
    if abs(value) >= 1000 or value == round(value):
        return f"{value:,.0f}"
    return f"{value:.3g}"
