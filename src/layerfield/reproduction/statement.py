"""The table of claims as text."""

from collections.abc import Sequence
from typing import Any

from layerfield.reproduction.claims import Claim

_BUT = ("was cut short", "is not judged")  # of lines that nobody should miss


def claims_text(claims: Sequence[Claim], record: dict[str, Any]) -> str:
    """Return claims.md: the table, the checks behind every verdict, what it was made from."""
    lines = ["# The claims of Gao et al. 2024, measured", "", "| | claim | verdict |", "|-|-|-|"]
    lines += [f"| {c.number} | {c.paper} | **{c.verdict}** |" for c in claims]
    for claim in claims:
        lines += ["", f"## {claim.number}. {claim.paper}: {claim.verdict}", ""]
        lines += [claim.missing] if claim.missing else []
        if claim.checks:
            lines += ["| holds | what should be so | figures |", "|-|-|-|"]
        lines += [f"| {_word(c.holds)} | {c.says} | {c.figures} |" for c in claim.checks]
        lines += ["", "Beside it, without a say in the verdict:", ""] if claim.beside else []
        lines += [f"- {_plain(line)}" for line in claim.beside]
    return "\n".join([*lines, "", "## Made with", "", *_made_with(record), ""])


def claim_lines(claims: Sequence[Claim]) -> list[str]:
    """Return the verdicts with their numbers for a terminal."""
    lines = []
    for claim in claims:
        lines.append(f"{claim.number}. {claim.paper}: {claim.verdict.upper()}")
        lines += [f"   {claim.missing}"] if claim.missing else []
        lines += [f"   {_word(c.holds):3} {c.says}: {c.figures}" for c in claim.checks]
        lines += [f"   but {line}" for line in claim.beside if any(w in line for w in _BUT)]
    return lines


def _word(holds: bool) -> str:
    return "yes" if holds else "no"


def _plain(line: str) -> str:
    return line.replace("|", "/")


def _made_with(record: dict[str, Any]) -> list[str]:
    made = ", ".join(f"{key} {value}" for key, value in record["made_with"].items())
    seeds = "; ".join(f"{name} {seeds or 'none'}" for name, seeds in record["seeds"].items())
    weights = "; ".join(
        f"{label}: recipe {each['recipe']}, sha256 {each['sha256'][:12]}"
        for label, each in record["weights"].items()
    )
    return [
        f"- display {record['display']}; light fields: {', '.join(record['fields'])}",
        f"- seeds of the trainings: {seeds}",
        f"- weights: {weights or 'none'}",
        f"- {made}",
        "- the rules behind the verdicts and all choices: docs/gao2024.md",
    ]
