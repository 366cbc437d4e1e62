"""What the paper claims, and the rules that say whether it holds.

A claim is a list of checks, each on every light field. It `holds` if all checks hold, `does not
hold` if none does, `holds in part` otherwise, and is `not measured` if there is nothing to check.
The paper's own two networks decide; others stand beside them. Differences below `ALIKE_DB`, or
`ALIKE` of the larger figure, are none.
"""

import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

from layerfield.reproduction.contenders import (
    CNN,
    COURSES,
    DIRECT,
    PAPER_ITERATIONS,
    STARTS,
    UNET,
)
from layerfield.reproduction.measures import Measured, Shown, unevenness

ALIKE_DB = 0.1
ALIKE = 0.05
STEADY = 1.5  # slowest over fastest run of a network; above, the machine was busy
ABOUT_50 = 25  # iterations: half of what the paper says

PAPER: dict[int | str, str] = {
    1: "U-Net converges better and generalises better than the stacked CNN (figure 4)",
    2: "quality is more uniform, and light is shared more evenly among the layers (figures 5, 6)",
    3: "U-Net is comparable to about 50 iterations of the iterative algorithm (figure 6)",
    4: "U-Net takes less computation than the stacked CNN and than iterative algorithms (abstract)",
    5: "U-Net has better quality than the stacked CNN and than iterative algorithms (abstract)",
    "A": "skip connections improve convergence (sections 1 and 3)",
    "B": "gradients vanish in deep stacked CNNs, and their quality declines (section 3)",
    "C": "trained on large pixel numbers, the output becomes the background (section 3)",
    "D": "rotation and scaling are unsuitable as augmentation (section 3)",
}


@dataclass(frozen=True)
class Check:
    """One comparison.

    Args:
        says: what should be so.
        holds: whether it is.
        figures: the numbers.
    """

    says: str
    holds: bool
    figures: str


@dataclass(frozen=True)
class Claim:
    """A claim of the paper and what was found.

    Args:
        number: in the table.
        checks: that decide.
        beside: lines that do not: other networks, the direct solver, what to know.
        missing: what would have to be there to measure it.
    """

    number: int | str
    checks: tuple[Check, ...] = ()
    beside: tuple[str, ...] = ()
    missing: str = ""

    @property
    def paper(self) -> str:
        """What the paper says."""
        return PAPER[self.number]

    @property
    def verdict(self) -> str:
        """What was found, in a word or three."""
        held = [check.holds for check in self.checks]
        if not held:
            return "not measured"
        if all(held):
            return "holds"
        return "holds in part" if any(held) else "does not hold"

    @property
    def figures(self) -> str:
        """The numbers in words; or what is missing."""
        lines = [f"{_mark(check)}: {check.says} ({check.figures})" for check in self.checks]
        return "; ".join(lines) or self.missing

    def as_record(self) -> dict[str, Any]:
        """Return the claim as plain data."""
        return {"paper": self.paper, "verdict": self.verdict} | asdict(self)


def _mark(check: Check) -> str:
    return "yes" if check.holds else "no"


def less(one: float, other: float) -> bool:
    """Say whether one figure is below another by more than `ALIKE` of the larger.

    >>> less(90, 100), less(97, 100)
    (True, False)
    """
    return other - one > ALIKE * max(abs(one), abs(other))


def better(one: float, other: float) -> bool:
    """Say whether one PSNR is above another by more than `ALIKE_DB`; equals are not."""
    return one > other and one - other > ALIKE_DB


def judge_quality(fields: Sequence[Measured]) -> list[Check]:
    """Claim 5: PSNR above that of the stacked CNN and of every iterative algorithm at 100."""
    checks = []
    for each in fields:
        unet, cnn, place = each.shown[UNET], each.shown[CNN], _place(each, fields)
        checks.append(
            Check(
                f"higher PSNR than the stacked CNN{place}",
                better(unet.psnr, cnn.psnr),
                f"U-Net {unet.psnr:.2f} dB, stacked CNN {cnn.psnr:.2f} dB, "
                f"optimum {each.optimum.psnr:.2f} dB",
            )
        )
        for name, course in each.courses.items():
            count = min(PAPER_ITERATIONS, course.most)
            reached = course.psnr[count]
            checks.append(
                Check(
                    f"higher PSNR than {count} iterations of {COURSES[name]}{place}",
                    better(unet.psnr, reached),
                    f"{unet.psnr:.2f} and {reached:.2f} dB",
                )
            )
    return checks


def judge_equivalence(fields: Sequence[Measured]) -> list[Check]:
    """Claim 3: at least half of 50 iterations are needed to reach the U-Net, with each solver."""
    checks = []
    for each in fields:
        quality = each.shown[UNET].psnr
        for name, course in each.courses.items():
            count = course.reaching(quality)
            checks.append(
                Check(
                    f"worth {ABOUT_50} iterations of {COURSES[name]} or more{_place(each, fields)}",
                    count is None or count >= ABOUT_50,
                    f"{iterations(count, course.most)}; {STARTS[name]}",
                )
            )
    return checks


def iterations(count: float | None, most: int) -> str:
    """Return an equivalent in words.

    >>> iterations(12.34, 500), iterations(None, 500)
    ('equal to 12.3 iterations', 'equal to more than 500 iterations')
    """
    return f"equal to more than {most} iterations" if count is None else (
        f"equal to {count:.1f} iterations"
    )  # fmt: skip


def judge_uniformity(fields: Sequence[Measured]) -> list[Check]:
    """Claim 2: PSNR spreads less over views; light and detail less unevenly over layers."""
    checks = []
    for each in fields:
        unet, cnn, place = each.shown[UNET], each.shown[CNN], _place(each, fields)
        checks += [
            Check(
                f"PSNR differs less from view to view than with the stacked CNN{place}",
                less(unet.view_spread, cnn.view_spread),
                f"standard deviation {unet.view_spread:.2f} and {cnn.view_spread:.2f} dB, worst "
                f"view {min(unet.by_view):.2f} and {min(cnn.by_view):.2f} dB",
            ),
            Check(
                f"light is shared more evenly than by the stacked CNN{place}",
                less(unevenness(unet.light), unevenness(cnn.light)),
                f"shares, front to back: U-Net {parts(unet.light)}, stacked CNN {parts(cnn.light)}",
            ),
            Check(
                f"detail is shared more evenly than by the stacked CNN{place}",
                less(unevenness(unet.detail), unevenness(cnn.detail)),
                f"gradient energy, front to back: U-Net {parts(unet.detail)}, "
                f"stacked CNN {parts(cnn.detail)}",
            ),
            Check(
                "the stacked CNN gives the first layer most light, and the others less and less "
                f"change{place}",
                front_heavy(cnn),
                "deviation of pixels, front to back: "
                + ", ".join(f"{layer.std:.3f}" for layer in cnn.figures),
            ),
        ]
    return checks


def front_heavy(shown: Shown) -> bool:
    """Say whether the first layer has most light and the layers behind it vary less and less."""
    changes = [layer.std for layer in shown.figures]
    falling = all(less(after, before) for before, after in pairwise(changes))
    return shown.light[0] == max(shown.light) and falling


def judge_computation(fields: Sequence[Measured]) -> list[Check]:
    """Claim 4: less of everything than the stacked CNN, and than solvers at equal quality."""
    checks = []
    for each in fields:
        unet, place = each.shown[UNET], _place(each, fields)
        checks += _against_cnn(unet, each.shown[CNN], place)
        for name in each.courses:
            checks += _against_solver(unet, each, name, place)
    if all(steady(each) for each in fields):
        return checks
    return [check for check in checks if not check.says.startswith("less time")]


def steady(each: Measured) -> bool:
    """Say whether runs of one network took alike; if not, the seconds decide nothing."""
    networks = [s for s in each.shown.values() if s.contender.iterations is None]
    return all(shown.unsteady < STEADY for shown in networks)


def _against_cnn(unet: Shown, cnn: Shown, place: str) -> list[Check]:
    compared = [
        ("fewer multiply-adds per pixel", unet.cost, cnn.cost, "{:,.0f}"),
        ("less time", unet.seconds, cnn.seconds, "{:.2f} s"),
        ("less peak memory", unet.megabytes, cnn.megabytes, "{:.0f} MB"),
    ]
    return [
        Check(f"{says} than the stacked CNN{place}", less(one, other), _pair(one, other, how))
        for says, one, other, how in compared
        if one is not None and other is not None
    ]


def _against_solver(unet: Shown, each: Measured, name: str, place: str) -> list[Check]:
    """Compare with a solver at the PSNR of the network; one that never gets there costs more."""
    course, solver = each.courses[name], COURSES[name]
    reached = course.reaching(unet.psnr)
    if reached is None:
        where = f"to equal quality with {solver}{place}"
        never = f"{solver} does not get there in {course.most} iterations"
        return [Check(f"fewer multiply-adds, less time {where}", True, never)]
    count, where = max(reached, 1.0), f"than {solver} to equal quality{place}"
    cost, seconds = course.cost.of(count), course.seconds_at(count)
    note = f", {count:.1f} iterations"
    checks = [
        Check(
            f"fewer multiply-adds per pixel {where}",
            less(unet.cost, cost),
            _pair(unet.cost, cost, "{:,.0f}") + note,
        ),
        Check(
            f"less time {where}",
            less(unet.seconds, seconds),
            _pair(unet.seconds, seconds, "{:.3f} s") + note,
        ),
    ]
    if unet.megabytes is not None and course.megabytes is not None:
        figures = _pair(unet.megabytes, course.megabytes, "{:.0f} MB")
        held = less(unet.megabytes, course.megabytes)
        checks.append(Check(f"less peak memory than {solver}{place}", held, figures))
    return checks


def _pair(one: float, other: float, how: str) -> str:
    return f"{how.format(one)} against {how.format(other)}"


def parts(values: Sequence[float]) -> str:
    """Return shares as percentages.

    >>> parts([0.5, 0.25, 0.25])
    '50 25 25 %'
    """
    return " ".join(f"{100 * value:.0f}" for value in values) + " %"


def _place(each: Measured, fields: Sequence[Measured]) -> str:
    return f", {each.field.name}" if len(fields) > 1 else ""


def lines_beside(fields: Sequence[Measured]) -> dict[int, tuple[str, ...]]:
    """Return, by claim, a line for every contender and solver: what does not decide."""
    found: dict[int, list[str]] = {2: [], 3: [], 4: [], 5: []}
    for each in fields:
        place = _place(each, fields)
        for shown in each.shown.values():
            _add_lines(found, each, shown, place)
        for name, course in each.courses.items():
            found[4].append(
                f"{COURSES[name]}{place}: {course.cost.each:,.0f} multiply-adds per pixel an "
                f"iteration, 50 iterations {course.cost.of(50):,.0f}; an iteration takes "
                f"{course.seconds[-1] / course.most:.4f} s{_memory(course.megabytes)}"
            )
    if not all(steady(each) for each in fields):
        found[4].append(
            f"time is not judged: runs of one network differed by more than {STEADY} times, the "
            "machine was busy; run it again on a quiet one"
        )
    found[2].append(
        "views at the rim of the grid are harder: where quality rises, the spread of PSNR over "
        "views rises, so that a small spread alone is no merit"
    )
    found[4].append("parameters are storage, not computation; peak memory includes the libraries")
    return {number: tuple(lines) for number, lines in found.items()}


def _add_lines(found: dict[int, list[str]], each: Measured, shown: Shown, place: str) -> None:
    label = f"{shown.contender.label}{place}"
    found[2].append(
        f"{label}: PSNR deviates by {shown.view_spread:.2f} dB over views, worst "
        f"{min(shown.by_view):.2f} dB; light "
        f"{parts(shown.light)}, detail {parts(shown.detail)}; layers: {_layers(shown)}"
    )
    short = each.optimum.psnr - shown.psnr
    found[5].append(f"{label}: {shown.psnr:.2f} dB, {short:.2f} dB below the optimum")
    sized = f", {shown.parameters:,} parameters" if shown.parameters else ""
    found[4].append(
        f"{label}: {shown.cost:,.0f} multiply-adds per pixel, {shown.seconds:.3f} s"
        f"{_memory(shown.megabytes)}{sized}"
    )
    if shown.contender.iterations is None or shown.contender.key == DIRECT:
        equal = [
            f"{COURSES[name]} {iterations(course.reaching(shown.psnr), course.most)}"
            for name, course in each.courses.items()
        ]
        found[3].append(f"{label}: " + ", ".join(equal))


def _layers(shown: Shown) -> str:
    return " | ".join(
        f"mean {layer.mean:.3f} deviation {layer.std:.3f} gradient {layer.gradient_energy:.4f} "
        f"peak {layer.peak:.2f}"
        for layer in shown.figures
    )


def _memory(megabytes: float | None) -> str:
    return "" if megabytes is None else f", {megabytes:.0f} MB at the peak"


def mean_and_range(values: Sequence[float], how: str = "{:.2f}") -> str:
    """Return the mean of a few values, with their range if there are several.

    >>> mean_and_range([1.0]), mean_and_range([1.0, 2.0])
    ('1.00', '1.50 (1.00 to 2.00)')
    """
    mean = how.format(statistics.mean(values))
    if len(values) == 1:
        return mean
    return f"{mean} ({how.format(min(values))} to {how.format(max(values))})"
