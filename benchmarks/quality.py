"""How near every method comes to the reference, on the five light fields.

    python benchmarks/quality.py OUT.json

Prints a table for each field and display, then what 8-bit panels cost.
"""

import json
import sys
from pathlib import Path

from five_fields import five_fields

from layerfield import Display, evaluate, psnr, synthesize
from layerfield.evaluate import tables
from layerfield.panels import dequantise
from layerfield.solvers.rounding import panel_codes
from layerfield.synthesizer import pose

METHODS = {
    "additive-3": [("fourier-admm", 10), ("nmf", 100), ("sart", 50), ("gradient", 100)],
    "multiplicative-3": [
        ("fourier-admm", 0),
        ("fourier-admm", 2),
        ("fourier-admm", 10),
        ("sweeps", 10),
        ("gradient", 100),
    ],
}


def main(out: Path) -> None:
    rows, costs = [], []
    for name, field in five_fields().items():
        for preset, methods in METHODS.items():
            display = Display.load(preset)
            found = evaluate([field], [display], methods)
            rows += found
            for title, lines in tables(found):
                print(title)
                print("\n".join("  ".join(f"{cell:>12}" for cell in line) for line in lines))
            costs.append(eight_bits(name, field, display))
            print("8 bit costs", costs[-1], "dB\n", flush=True)
    records = {"rows": [row.as_record() for row in rows], "eight_bits": costs}
    out.write_text(json.dumps(records, indent=1), "utf-8")


def eight_bits(name, field, display) -> dict:
    """What rounding to 8 bits costs in dB, each pixel by itself and all layers together."""
    layers, problem = synthesize(field, display).layers, pose(field, display)
    before = psnr(display(layers), field.views)
    cost = {
        rounding: round(
            before
            - psnr(
                display(dequantise(panel_codes(problem, layers, bits=8, rounding=rounding))),
                field.views,
            ),
            4,
        )
        for rounding in ("nearest", "joint")
    }
    return {"field": name, "display": display.name, **cost}


if __name__ == "__main__":
    main(Path(sys.argv[1]))
