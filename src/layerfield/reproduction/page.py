"""The claims with their figures as a page, of the same make as other reports."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from PIL import Image

from layerfield.report.page import Block, Facts, Gallery, Page, Picture, Section, Text
from layerfield.reproduction.claims import Claim

_SHOWS = {
    "figure3": "The target light field.",
    "figure4": "PSNR of training and test scenes against epochs, for both networks.",
    "figure4-effort": "The same against steps, seconds and operations.",
    "figure5": "The layer images of stacked CNN, U-Net and an iterative solver.",
    "figure5-shares": "How the layers share the light.",
    "figure6": "Reconstructed views with their errors.",
    "figure6-views": "PSNR over the views.",
    "figure6-iterations": "PSNR against iterations, networks and optimum as lines.",
}


def claims_page(claims: Sequence[Claim], record: dict[str, Any], folder: Path) -> Page:
    """Return the page of a reproduction.

    Args:
        claims: with their verdicts.
        record: what everything was made from.
        folder: holds the figures, PNG.
    """
    verdicts = Facts([(f"{c.number}. {c.paper}", c.verdict) for c in claims])
    figures = [_figure(path) for path in sorted(folder.glob("*.png"))]
    made = ", ".join(f"{key} {value}" for key, value in record["made_with"].items())
    return Page(
        "The claims of Gao et al. 2024, measured",
        f"Display {record['display']}; light fields: {', '.join(record['fields'])}. The rules "
        "behind the verdicts, and what was chosen where the paper is silent, are in "
        "docs/gao2024.md.",
        [
            Section("Verdicts", [verdicts]),
            *(Section(f"Claim {c.number}: {c.verdict}", list(_checks(c))) for c in claims),
            Section("Figures", [Gallery(figures)]),
        ],
        f"Made with {made}.",
    )


def _checks(claim: Claim) -> Iterator[Block]:
    yield Text(f"{claim.paper}.")
    if claim.missing:
        yield Text(claim.missing, "missing")
    for check in claim.checks:
        yield Text(f"{'Yes' if check.holds else 'No'}: {check.says}: {check.figures}")
    if claim.beside:
        yield Text("Beside it, without a say in the verdict:", "missing")
    yield from map(Text, claim.beside)


def _figure(path: Path) -> Picture:
    name, _, number = path.stem.rpartition("-")
    known = path.stem if path.stem in _SHOWS or not number.isdecimal() else name
    with Image.open(path) as image:
        image.load()
    shows = _SHOWS.get(known, f"{path.stem.capitalize()}.")
    return Picture(path.stem, image, shows, shows)
