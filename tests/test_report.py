"""Pages on results and evaluations: what they show, that they need nothing else, and refusals."""

import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pytest
import torch
from test_cli import contents, fails, run, succeed

from layerfield import Display, FieldOptions, LightField, procedural_light_field, synthesize
from layerfield.cli.options import recorded
from layerfield.display_spec import parse_spec
from layerfield.evaluate import Row, evaluate, write_rows
from layerfield.report.evaluation_page import evaluation_page
from layerfield.report.facts import facts_of_rows
from layerfield.report.page import Gallery, html
from layerfield.report.result_page import result_page
from layerfield.result import make_result, write_result, write_views
from layerfield.stored_result import open_result

SIZE = (20, 24)
SMALL = 'name = "<small> & co $x_1$"\nlink = "additive"\ndisparity = [1, 0]\nviews = [3, 3]\n'
IN_TIME = SMALL.replace("additive", "multiplicative") + 'subframes = 2\ntransfer = "srgb"\n'
LISTED = 'link = "additive"\ndisparity = [1, 0]\nviewpoints = [[0, 0], [1, 1], [-1, 0.5]]\n'
ROW = 'link = "additive"\ndisparity = [1, 0]\nviews = [1, 4]\n'
PANELS = """
name = "panelled"
link = "additive"
depth_mm = [2, 0]
pitch_um = 200
viewing_distance_mm = 500
viewing_angle_deg = 4
views = [3, 3]
[[panels]]
pitch_um = 200
resolution = [40, 40]
[[panels]]
pitch_um = 200
resolution = [40, 40]
"""


class _Seen(HTMLParser):
    """What a page refers to, and whether its tags are closed."""

    def __init__(self) -> None:
        super().__init__()
        self.references: list[str] = []
        self.names: list[str] = []
        self.missing: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.references += [v or "" for k, v in attrs if k in ("src", "href", "xlink:href")]
        if tag == "img" and not given.get("alt"):
            self.missing.append(tag)
        if tag == "svg" and not given.get("aria-label"):
            self.missing.append(tag)
        if tag == "figure":
            self.names.append("figure")
        if tag not in ("meta", "img", "link", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if self.open and self.open[-1] == tag:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def inspect(page: str) -> _Seen:
    """Check what holds for every page."""
    seen = _Seen()
    seen.feed(page)
    assert not seen.open
    assert not seen.missing
    for reference in seen.references:
        assert reference.startswith(("data:image/png;base64,", "#")), reference[:80]
    assert "url(http" not in page
    assert "@import" not in page
    assert not re.search(r"/(home|root|tmp|Users)/", page)
    ids = re.findall(r'<(?:h2|section)[^>]* id="([^"]*)"', page)
    assert len(ids) == len(set(ids))
    return seen


def field_for(display: Display, channels: int = 3) -> LightField:
    grid = display.geometry.grid or (1, display.view_count)
    made = procedural_light_field(grid=grid, size=SIZE, seed=2)
    return replace(made, stored=made.views[:, :channels], name="a<b>&'c\"", bits=8)


def make(folder: Path, toml: str, *, targets=True, history=False, channels=3) -> Path:
    display = Display(parse_spec(toml, "display"))
    field = field_for(display, channels)
    solution = synthesize(field, display, iterations=2, history=history)
    result = make_result(field, display, solution, method="fourier-admm", bits=8)
    write_result(folder, result, targets=field if targets else None)
    return folder


def page_of(folder: Path) -> str:
    page = html(result_page(open_result(folder)))
    inspect(page)
    return page


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> Path:
    return make(tmp_path_factory.mktemp("made") / "out", SMALL, history=True)


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    display = Display(parse_spec(SMALL, "display"))
    methods = [("fourier-admm", 1), ("fourier-admm", 3), ("sweeps", 2)]
    return evaluate([field_for(display)], [display], methods)


@pytest.fixture
def desk(tmp_path, monkeypatch, result, rows) -> Path:
    """A folder with a result, `out`, and the rows of an evaluation, `rows.json`."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(result, tmp_path / "out")
    write_rows(tmp_path / "rows.json", rows)
    return tmp_path


@pytest.fixture
def undrawn(monkeypatch):
    """Charts are made, but drawing them, which takes most of the time, is left to other tests."""
    monkeypatch.setattr("layerfield.report.page.svg", lambda _: "<svg></svg>")


# ------------------------------------------------------------------------------------- results


@pytest.fixture(scope="module")
def page(result) -> str:
    return page_of(result)


def test_a_page_holds_everything(result, page):
    views = page.count("Target of the view")
    assert views in (3, 4)  # the best one may be in the centre
    assert page.count("<figure>") == 2 + 2 + 3 * views + 1 + 1 + 1 + 1
    for words in (
        "Epipolar slice",
        "Histogram",
        "PSNR after every iteration",
        "Scale of the error",
    ):
        assert words in page
    facts = json.loads((result / "result.json").read_text())
    assert f"{facts['psnr']:.2f} dB" in page
    assert f"torch {torch.__version__}" in page
    assert "synth --targets" not in page


def test_names_are_escaped(page):
    assert "a&lt;b&gt;&amp;&#x27;c&quot; on &lt;small&gt; &amp; co $x_1$" in page
    assert "<small>" not in page


def test_the_same_result_gives_the_same_bytes(result, page):
    assert page_of(result) == page


def test_without_targets_the_page_says_what_to_do(tmp_path, undrawn):
    page = page_of(make(tmp_path / "out", SMALL, targets=False))
    assert "Error of" not in page
    for words in ("synth --targets", "report --field", "synth --history", "synth --reference"):
        assert words in page
    assert page.count("<figure>") == 2 + 2 + page.count("What the layers show in") + 1 + 1


@pytest.mark.parametrize(
    ("toml", "channels", "words"),
    [
        (IN_TIME, 3, "Subframe 1, layer 1|PSNR, linear light|srgb|2, of which viewers"),
        (LISTED, 1, "list of 3|no row of several viewpoints|Middle of the list"),
        (ROW, 1, "1x4 grid|PSNR of every view;"),
        (PANELS, 3, "PSNR of the panels|mm from the display plane"),
    ],
)
def test_every_kind_of_display(tmp_path, toml, channels, words):
    page = page_of(make(tmp_path / "out", toml, channels=channels))
    for each in words.split("|"):
        assert each in page


def test_many_subframes_are_not_all_shown(tmp_path, undrawn):
    toml = IN_TIME.replace("subframes = 2", "subframes = 5")
    page = page_of(make(tmp_path / "out", toml))
    assert "The first 4 of 5 subframes" in page
    assert "Subframe 4" not in page


def test_a_perfect_result(tmp_path):
    display = Display(parse_spec(SMALL, "display"))
    black = LightField(torch.zeros(9, 1, *SIZE), (3, 3))
    solution = synthesize(black, display, iterations=1, history=True)
    made = make_result(black, display, solution, method="fourier-admm", bits=8)
    write_result(tmp_path / "out", made, targets=black)
    assert "24x20 px exactly" in page_of(tmp_path / "out")


def test_figures_of_views_are_computed_where_none_are_recorded(result, tmp_path, undrawn):
    shutil.copytree(result, tmp_path / "out")
    facts = json.loads((tmp_path / "out/result.json").read_text())
    known = facts.pop("psnr_by_view")
    (tmp_path / "out/result.json").write_text(json.dumps(facts))
    (found,) = re.findall(r"from (\S+) to (\S+) dB", page_of(tmp_path / "out"))
    assert [float(value) for value in found] == pytest.approx([min(known), max(known)], abs=0.05)


# ---------------------------------------------------------------------------------- evaluations


def test_a_page_compares_methods(rows):
    page = html(evaluation_page(facts_of_rows(rows)))
    inspect(page)
    assert page.count("<figure>") == 1 + 3 + 1
    for row in rows:
        assert f"<td>{row.figures.psnr:.2f}</td>" in page
    assert "certified to" in page
    assert "linear light, dB" not in page


def test_of_one_method_there_is_no_frontier(rows):
    page = evaluation_page(facts_of_rows(rows[:1]))
    assert [each.name for each in page.exhibits()] == ["1-views-1", "1-shares"]


def test_exact_rows_without_reference_and_grid(rows):
    """Older files have no grid; None stands for infinite figures."""
    facts = [
        row.model_copy(
            update={"psnr": None, "psnr_by_view": [None] * 9, "excess": None, "grid": None}
            | {"reference_kind": "", "seconds": 0.0}
        )
        for row in facts_of_rows(rows)
    ]
    page = html(evaluation_page(facts))
    inspect(page)
    assert "exact" in page


def test_methods_that_were_run_twice_have_bars_of_their_own(rows):
    page = evaluation_page(facts_of_rows([rows[0], rows[0]]))
    inspect(text := html(page))
    assert "fourier-admm:1 (2)" in text


def test_odd_names_can_be_drawn(rows):
    odd = "_日本\x1b$\\frac{" + "x" * 80
    page = html(evaluation_page(facts_of_rows([replace(row, method=odd) for row in rows])))
    inspect(page)
    assert "\x1b" not in page


# ---------------------------------------------------------------------------- the command line


def test_page_and_figures(desk):
    said = succeed("report", "out", "--out", "r.html", "--figures", "figs")
    assert "r.html" in said
    inspect((desk / "r.html").read_text("utf-8"))
    index = json.loads((desk / "figs/figures.json").read_text())
    names = {name for entry in index for name in entry["files"]}
    assert names | {"figures.json"} == {path.name for path in (desk / "figs").iterdir()}
    assert any(name.endswith(".svg") for name in names)
    for path in (desk / "figs").glob("*.svg"):
        ElementTree.parse(path)


def test_the_same_rows_give_the_same_files(desk):
    args = ["report", "rows.json", "--out", "r.html", "--figures", "figs"]
    succeed(*args)
    before = contents(desk)
    succeed(*args, "--force")
    assert contents(desk) == before


def test_targets_of_a_field_are_read_as_the_result_was(desk, undrawn):
    display = Display(parse_spec(SMALL.replace("[3, 3]", "[5, 5]"), "display"))
    many = procedural_light_field(grid=(5, 5), size=(24, 30))
    write_views(desk / "many", many.views, display, 8)
    (desk / "d.toml").write_text(SMALL)
    args = ["--views", "3x3", "--crop", "20x18+2+1", "--shift", "0.5", "--order", "br-row"]
    succeed("synth", "many", *args, "--display", "d.toml", "--out", "new")
    succeed("report", "new", "--out", "without.html")
    succeed("report", "new", "--out", "with.html", "--field", "many")
    assert "Error of" not in (desk / "without.html").read_text("utf-8")
    assert "Error of" in (desk / "with.html").read_text("utf-8")


@pytest.mark.parametrize(
    "options",
    [
        {"views": "3x5", "step": "2", "shift": "-0.25", "scale": "0.5"},
        {"quilt": "4x8a0.75", "crop": "30x20", "grid": "2x3"},
        {"lenslet": "20", "crop": "30x20+1+2", "order": "bl-column"},
    ],
)
def test_options_are_recorded_as_they_are_parsed(options):
    parsed = FieldOptions.parse(**options)
    assert FieldOptions.parse(**recorded(parsed)["options"]) == parsed


def test_evaluate_writes_a_page(desk, rows, monkeypatch, undrawn):
    monkeypatch.setattr("layerfield.cli.evaluate.evaluate", lambda *_, **__: rows)
    (desk / "d.toml").write_text(SMALL)
    write_views(desk / "views", field_for(Display.load("d.toml")).views, Display.load("d.toml"), 8)
    args = ["evaluate", "views", "--display", "d.toml", "--methods", "fourier-admm:1"]
    succeed(*args, "--report", "r.html", "--json", "new.json")
    succeed("report", "new.json", "--out", "again.html")
    assert (desk / "r.html").read_bytes() == (desk / "again.html").read_bytes()
    fails(run(*args, "--report", "r.html"), "r.html exists", "force")
    fails(run(*args, "--report", "x", "--json", "x"), "2 files to write called 'x'")
    fails(run(*args, "--report", "views/view_00_00.png", "--force"), "among the input views")


def text(name: str, content: str | bytes):
    def prepare(desk: Path) -> None:
        (desk / name).write_bytes(content.encode() if isinstance(content, str) else content)

    return prepare


def changed(**facts):
    """Change what result.json holds; None takes a key away."""

    def prepare(desk: Path) -> None:
        path = desk / "out/result.json"
        found = json.loads(path.read_text()) | facts
        path.write_text(json.dumps({k: v for k, v in found.items() if v is not None}))

    return prepare


def other_field(desk: Path) -> None:
    display = Display(parse_spec(SMALL, "display"))
    views = procedural_light_field(grid=(3, 3), size=SIZE, seed=9).views
    write_views(desk / "other", views, display, 8)


OUT = ["--out", "r.html"]
REFUSED = [
    ("nothing there", ["report", "no", *OUT], "cannot read no|No such file", None),
    ("empty", ["report", "f", *OUT], "f is not valid JSON|it is empty", text("f", "")),
    ("truncated", ["report", "f", *OUT], "f is not valid JSON", text("f", '[{"field": "a')),
    ("nested", ["report", "f", *OUT], "f is not valid JSON", text("f", "[" * 10**6)),
    ("long number", ["report", "f", *OUT], "f is not valid", text("f", "[" + "9" * 9999 + "]")),
    ("no text", ["report", "f", *OUT], "f is no text", text("f", b"\xff\xfe\x00")),
    ("a number", ["report", "f", *OUT], "a single value, expected a list", text("f", "3")),
    ("an object", ["report", "f", *OUT], "one object, expected a list", text("f", "{}")),
    ("no rows", ["report", "f", *OUT], "f holds no rows", text("f", "[]")),
    ("many rows", ["report", "f", *OUT], "1001 rows|most 1000", text("f", f"[{'{},' * 1000}{{}}]")),
    ("other rows", ["report", "f", *OUT], "f, row 1|missing|make it anew", text("f", '[{"a": 1}]')),
    ("no result", ["report", ".", *OUT], "holds no display.toml with a result.json", None),
    ("keys missing", ["report", "out", *OUT], "'psnr' is missing|anew", changed(psnr=None)),
    ("not a number", ["report", "out", *OUT], "'psnr' is 'high'", changed(psnr="high")),
    ("out of range", ["report", "out", *OUT], "'seconds' is 1e+300", changed(seconds=1e300)),
    (
        "bad options",
        ["report", "out", *OUT, "--field", "out/targets"],
        "views is 'all'",
        changed(field={"options": {"views": "all"}}),
    ),
    (
        "other views",
        ["report", "out", *OUT, "--field", "other"],
        "shows these views with|light field that it was made of",
        other_field,
    ),
    ("rows and field", ["report", "rows.json", *OUT, "--field", "x"], "leave out --field", None),
    ("exists", ["report", "out", *OUT], "r.html exists|force", text("r.html", "mine")),
    ("onto the input", ["report", "rows.json", "--out", "rows.json", "--force"], "the input", None),
    ("onto a folder", ["report", "rows.json", "--out", "out", "--force"], "it is a folder", None),
    ("no folder", ["report", "out", "--out", "no/r.html"], "no does not exist", None),
    (
        "figures are not ours",
        ["report", "out", *OUT, "--figures", "out/layers", "--force"],
        "was not made here",
        None,
    ),
    (
        "figures over the result",
        ["report", "out", *OUT, "--figures", "out", "--force"],
        "out is, holds or lies among the input",
        None,
    ),
    (
        "page among the figures",
        ["report", "out", "--out", "figs/r.html", "--figures", "figs"],
        "figs/r.html is or lies in figs",
        None,
    ),
]


@pytest.mark.parametrize(
    ("args", "words", "prepare"), [r[1:] for r in REFUSED], ids=[r[0] for r in REFUSED]
)
def test_refusals(desk, args, words, prepare):
    if prepare is not None:
        prepare(desk)
    before = contents(desk)
    fails(run(*args), *words.split("|"))
    assert contents(desk) == before


def test_a_huge_file_is_not_read(desk):
    with (desk / "huge").open("wb") as file:
        file.truncate(2**30)
    fails(run("report", "huge", *OUT), "huge has more than 64 MB")


def test_galleries_hold_the_figures(result):
    page = result_page(open_result(result))
    names = [each.name for each in page.exhibits()]
    assert len(names) == len(set(names))
    blocks = [block for section in page.sections for block in section.blocks]
    assert sum(len(b.exhibits) for b in blocks if isinstance(b, Gallery)) == len(names)
