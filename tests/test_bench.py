"""The benchmark: the whole road, what is counted, what is kept, the command, its figures."""

import getpass
import importlib.util
import json
import math
import os
import re
import signal
import socket
import statistics
import time
from dataclasses import replace
from pathlib import Path

import numba
import pytest
import torch
from test_cli import fails, run, succeed
from test_package import commands_in, runs, small_field

from layerfield import Display, LightField, psnr, synthesize
from layerfield.bench import benchmark, frontier, scaling
from layerfield.bench.benchmark import bench_growth, bench_methods
from layerfield.bench.figures import file_name
from layerfield.bench.frontier import Contest, parse_contenders, run_contest
from layerfield.bench.operations import OperationCounter, TransformRecorder
from layerfield.bench.reaching import reached, reached_tables
from layerfield.bench.records import known_rows, open_folder
from layerfield.bench.road import EightBitViews, views_to_panels
from layerfield.bench.rows import BenchRow, Effort, measured, with_peak
from layerfield.bench.scaling import Case, Growth, ScaleRow, cases, run_growth
from layerfield.bench.standing import standing_tables, standings
from layerfield.bench.throughput import (
    Stream,
    copy_bandwidth,
    displays,
    floor_seconds,
    pictures,
    run_stream,
)
from layerfield.bench.timing import timed, timed_by_turns
from layerfield.kernels.compiled import compiled
from layerfield.kernels.preparation import PREPARATION
from layerfield.panels import dequantise
from layerfield.reference import Reference
from layerfield.reproduction.measures import solver_cost
from layerfield.result import write_views
from layerfield.synthesizer import pose

ROOT = Path(__file__).parents[1]
CPU = torch.device("cpu")
DISPLAY = Display.load("additive-3")
QUICK = Effort(repeats=1, cap=60.0)
PRIVATE = ("/", socket.gethostname(), getpass.getuser())


@pytest.fixture(scope="module")
def field() -> LightField:
    return replace(small_field(), name="small")


def contest(*methods: tuple[str, tuple[int, ...]], effort: Effort = QUICK, **more) -> Contest:
    return Contest(more.get("displays", [DISPLAY]), methods, effort, CPU)


# ------------------------------------------------------------------------------ what is measured


def test_the_road_is_synthesis_of_rounded_views_and_rounding(field):
    views = EightBitViews.of(field)
    made = views_to_panels(views, DISPLAY, "fourier-admm", 3)
    rounded = LightField((field.views * 255).round() / 255, field.grid)
    layers = synthesize(rounded, DISPLAY, method="fourier-admm", iterations=3).layers
    assert torch.allclose(made.layers, layers, atol=1e-5)  # sums of codes are exact
    assert made.codes.dtype == views.codes.dtype == torch.uint8
    assert (made.codes.float() / 255 - made.layers).abs().max() <= 0.5 / 255 + 1e-6


def test_a_row_is_judged_from_its_codes(field):
    views, display = EightBitViews.of(field), Display.load("tabletop-additive")
    row = measured(views, display, "fourier-admm", 2, QUICK)
    codes = views_to_panels(views, display, "fourier-admm", 2).codes
    seen = display.transfer.encode(display(dequantise(codes, display.transfer)))
    assert row.psnr == pytest.approx(psnr(seen, views.light_field().views))
    assert (row.field, row.size, row.label) == ("small", (40, 48), "fourier-admm:2")
    assert row.seconds.runs == 1
    assert row.transform_seconds is not None
    assert 0 < row.unrounded < row.mean_square_error


def test_times_are_those_of_runs_after_a_warm_up():
    calls = iter(range(11))
    seconds, made = timed(lambda: next(calls), CPU, repeats=3)
    assert (seconds.runs, made, next(calls)) == (9, 0, 10), "short ones are repeated more often"
    assert seconds.fastest <= seconds.median <= seconds.slowest
    assert timed(lambda: time.sleep(0.26), CPU, repeats=2)[0].runs == 2
    assert timed(lambda: None, CPU, repeats=3, cap=0.0)[0].runs == 1


def test_a_warm_up_that_compiles_does_not_count():
    """Or else, in a new installation, the first method would be over the cap."""
    compiled(lambda values: values)(0)  # from here on Numba is listened to
    fresh, told = numba.njit(lambda number: number + 1), list[bool]()
    with PREPARATION.told(told.append):
        assert timed(lambda: fresh(1), CPU, repeats=3, cap=0.01)[0].runs > 1
    assert told == [True, False]


def test_operations_of_known_sums():
    a, b = torch.ones(4, 8), torch.ones(8, 2)
    with OperationCounter() as counter:
        a.matmul(b)
    assert counter.operations == 2 * 4 * 8 * 2
    with OperationCounter() as counter:
        a.add_(a, alpha=0.5).mul(2).clone().view(-1).sum()
    assert counter.operations == 2 * 32 + 32 + 32
    with OperationCounter() as counter:
        torch.fft.irfft2(torch.fft.rfft2(a))
    assert counter.operations >= 2 * 2.5 * 32 * math.log2(32)


def test_transforms_are_those_of_the_run_itself(field):
    """A step makes complex ones of half the width, where it is compiled."""
    values = torch.ones(4, 8)
    with TransformRecorder() as recorder:
        torch.fft.irfft2(torch.fft.rfft2(values))
    with TransformRecorder() as again:
        recorder.again()()
    assert len(recorder) == len(again) >= 2
    assert not recorder.in_place
    with TransformRecorder() as run:
        views_to_panels(EightBitViews.of(field), DISPLAY, "fourier-admm", 3)
    with TransformRecorder() as again:
        run.again()()
    assert again.in_place == run.in_place
    assert [each.back for each in run.in_place] == 3 * [False, True]
    assert len(run) == 6


@pytest.mark.parametrize("method", ["nmf", "fourier-admm"])
def test_operations_of_an_iteration_are_those_of_the_model(field, method):
    """Two for every multiply-add of `solver_cost`, which rounds some sums up to those."""
    views = EightBitViews.of(field)

    def counted(iterations: int) -> float:
        with OperationCounter() as counter:
            views_to_panels(views, DISPLAY, method, iterations)
        return counter.operations / views.codes[0].numel()

    model = 2 * solver_cost(method, pose(field, DISPLAY)).each
    assert (counted(5) - counted(2)) / 3 == pytest.approx(model, rel=0.25)


def test_peak_memory_is_that_of_another_process(field):
    views = EightBitViews.of(field)
    row = measured(views, DISPLAY, "nmf", 1, QUICK)
    assert row.peak_mb is None
    assert (with_peak(row, views, DISPLAY, "nmf").peak_mb or 0) > 50


# ------------------------------------------------------------------------------ who is compared


def test_methods_have_their_own_number_of_iterations_or_the_budgets():
    assert parse_contenders("nmf:3,unet,sart,nmf:1", (5, 2)) == [
        ("nmf", (1, 3)),
        ("unet", (0,)),
        ("sart", (2, 5)),
    ]


def test_a_method_is_left_out_where_it_does_not_serve(field, monkeypatch):
    known = Reference(1e-3, "best known", "test")
    monkeypatch.setattr(frontier, "reference", lambda _: known)
    both = [DISPLAY, Display.load("multiplicative-3")]
    rows = run_contest([field], contest(("nmf", (1,)), ("sweeps", (1,)), displays=both))
    assert [(row.display, row.method) for row in rows] == [
        ("additive-3", "nmf"),
        ("additive-3", "sweeps"),
        ("multiplicative-3", "sweeps"),
    ]
    with pytest.raises(ValueError, match="ntf"):
        contest(("ntf", (1,)))


def test_the_cap_stops_a_method_and_is_shown(field, quick_references):
    slow = Effort(repeats=3, cap=1e-9)
    rows = run_contest([field], contest(("sart", (1, 2)), ("nmf", (1,)), effort=slow))
    assert [(row.method, row.iterations, row.seconds.runs) for row in rows] == [
        ("sart", 1, 1),
        ("nmf", 1, 1),
    ]
    ((title, table),) = standing_tables(rows)
    assert "optimum" in title or "best known" in title
    assert all("(cap)" in " ".join(line) for line in table[1:])


def row_of(field: str, method: str, iterations: int, error: float, **more) -> BenchRow:
    known = Reference(1e-3, "optimum", "test")
    return BenchRow(
        field, (4, 4), "additive-3", method, iterations, 30.0, error, error,
        seconds=more.get("seconds", timed(lambda: None, CPU, repeats=1)[0]), capped=False,
        operations=10.0, operations_per_pixel=1.0, transform_seconds=None, reference=known,
    )  # fmt: skip


def test_standings_are_over_the_same_fields():
    rows = [row_of(name, "a", 1, e) for name, e in (("x", 1.1e-3), ("y", 1.2e-3), ("z", 2e-3))]
    (found,) = standings([*rows, row_of("x", "a", 2, 1e-3)])
    assert (found.label, found.worst_field) == ("a", "z")
    assert found.excess_median == pytest.approx(0.2)
    assert found.excess_worst == pytest.approx(1.0)
    assert found.below == pytest.approx(10 * math.log10(1.1 * 1.2 * 2) / 3)


def test_time_to_quality_is_that_of_the_first_budget_near_enough():
    rows = [row_of("x", "a", n, e) for n, e in ((5, 1.01e-3), (2, 1.02e-3), (1, 1.03e-3))]
    rows = [replace(row, unrounded=1e-3) for row in rows]
    near, far = reached([*rows, row_of("x", "b", 1, 2e-3)])
    assert (near.iterations, near.unrounded_iterations) == (2, 1)
    assert (far.iterations, far.seconds) == (None, None)
    ((title, table),) = reached_tables([*rows, row_of("x", "b", 1, 2e-3)])
    assert "0.1 dB" in title
    assert table[0] == ["method", "x"]
    assert table[1][1].endswith("(2)")
    assert "not in" in table[2][1]
    only = replace(row_of("x", "c", 7, 1.03e-3), unrounded=1e-3)
    ((_, table),) = reached_tables([only])
    assert table[1][1].startswith("unrounded ")


def test_a_better_layer_improves_the_best_known(field, monkeypatch):
    """Then all rows of that light field and display are compared with it."""
    monkeypatch.setattr(frontier, "reference", lambda _: Reference(1.0, "best known", "test"))
    monkeypatch.setattr(frontier, "store_reference", lambda *_: None)
    rows = run_contest([field], contest(("nmf", (1, 5))))
    first, last = rows
    assert first.yardstick == last.yardstick == Reference(last.least, "best known", "nmf:5")
    assert (first.excess > 0) and last.excess >= 0


# --------------------------------------------------------------------------------- what is kept


def test_a_stopped_run_loses_nothing(field, tmp_path, monkeypatch, quick_references):
    made = []

    def stopping(*given):
        if len(made) == 2:
            raise KeyboardInterrupt
        made.append(given)
        return measured(*given)

    methods = contest(("nmf", (1, 2)), ("sart", (1,)))
    monkeypatch.setattr(frontier, "measured", stopping)
    with pytest.raises(KeyboardInterrupt):
        bench_methods(tmp_path, [field], methods, command="test")
    half = json.loads((tmp_path / "bench.json").read_text())
    assert len(half["rows"]) == 2
    monkeypatch.setattr(frontier, "measured", measured)
    rows = bench_methods(tmp_path, [field], methods, command="test")
    whole = json.loads((tmp_path / "bench.json").read_text())
    assert [row["seconds"] for row in whole["rows"][:2]] == [r["seconds"] for r in half["rows"]]
    assert [row.method for row in rows] == ["nmf", "nmf", "sart"]
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_rows_of_another_run_are_refused(field, tmp_path, quick_references):
    bench_methods(tmp_path, [field], contest(("nmf", (1,))), command="test")
    other = contest(("nmf", (1,)), effort=Effort(repeats=2))
    with pytest.raises(ValueError, match="effort"):
        bench_methods(tmp_path, [field], other, command="test")
    (tmp_path / "bench.json").write_text("{}")
    with pytest.raises(ValueError, match="damaged"):
        known_rows(tmp_path / "bench.json", {})
    with pytest.raises(ValueError, match="not written"):
        BenchRow.of_record({"field": "x"})
    with pytest.raises(ValueError, match="not written"):
        ScaleRow.of_record({"axis": "pixels"})


def test_folders_that_are_not_replaced(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    for how, words in (
        ({}, "exists"),
        ({"force": True}, "no benchmark"),
        ({"resume": True}, "go on"),
    ):
        with pytest.raises(ValueError, match=words):
            open_folder(tmp_path / "mine", **{"resume": False, "force": False} | how)
    assert (tmp_path / "mine" / "notes.txt").is_file()
    with pytest.raises(ValueError, match="cannot make"):
        open_folder(tmp_path / "nowhere" / "deep", resume=False, force=False)


# ------------------------------------------------------------------------------------- growth

SMALL = (
    Case("pixels", size=(16, 16)),
    Case("pixels", size=(16, 32)),
    Case("views", size=(24, 24), grid=(3, 3), reach=2.0),
    Case("views", size=(24, 24), grid=(3, 5), reach=2.0),
)


def test_every_size_has_whole_pixel_shifts_and_a_series_one_margin():
    margins: dict[str, set] = {}
    for case in cases():
        display = case.display("additive")
        assert all(float(c).is_integer() for v in display.geometry.shifts for s in v for c in s)
        margins.setdefault(case.axis, set()).add(display.margin)
    assert margins == {"pixels": {(2, 2)}, "views": {(8, 8)}, "layers": {(6, 6)}}
    sizes = [case.amount for case in cases() if case.axis == "pixels"]
    assert sizes[:-1] == [sizes[0] * 2**n for n in range(len(sizes) - 1)]
    assert (sizes[0], sizes[-1]) == (256 * 256, 3840 * 2160)


def test_growth_is_measured_drawn_and_goes_on(tmp_path, monkeypatch):
    growth = Growth(("additive",), [("nmf", 1), ("ntf", 1)], QUICK, CPU, SMALL)
    rows = bench_growth(tmp_path, growth, command="test")
    own = [row for row in rows if row.method == "nmf:1"]
    assert [row.amount for row in own] == [256, 512, 9, 15]
    assert [row.per_doubling is None for row in own] == [True, False, True, False]
    assert all("ntf" in (row.left_out or "") for row in rows if row.method == "ntf:1")
    assert {"scaling.png", "scaling.svg"} < {path.name for path in tmp_path.iterdir()}
    monkeypatch.setattr(scaling, "views_to_panels", lambda *_: pytest.fail("measured again"))
    again = bench_growth(tmp_path, growth, command="test")
    assert [row.seconds for row in again if row.seconds] == [row.seconds for row in own]


def test_what_does_not_fit_is_left_out_and_said(monkeypatch):
    monkeypatch.setattr(scaling, "_free_megabytes", lambda _: 0.01)
    (row,) = run_growth(Growth(("additive",), [("nmf", 1)], QUICK, CPU, SMALL[:1]))
    assert row.seconds is None
    assert "GB are free" in (row.left_out or "")
    monkeypatch.undo()
    impatient = Effort(repeats=1, cap=1e-9)
    rows = run_growth(Growth(("additive",), [("nmf", 1)], impatient, CPU, SMALL[:2]))
    assert [row.left_out is None for row in rows] == [True, False]


def test_per_doubling_is_two_in_proportion():
    small, large = Case("pixels", size=(10, 10)), Case("pixels", size=(20, 20))
    assert scaling._per_doubling(4.0, large, small) == pytest.approx(2)


def test_runs_by_turns_are_compared_with_their_neighbours(monkeypatch):
    order, slower = [], iter(range(1, 100))

    def one_run(own, _device):
        order.append(own())
        return own() * next(slower), None  # a machine that becomes slower

    monkeypatch.setattr("layerfield.bench.timing.once", one_run)
    seconds, ratio = timed_by_turns(lambda: 4.0, lambda: 2.0, CPU, repeats=4)
    assert order == [2.0, 4.0] * 5
    assert seconds.runs == 4
    assert ratio == pytest.approx(2 * statistics.median([4 / 3, 6 / 5, 8 / 7, 10 / 9]))
    order.clear()
    seconds, ratio = timed_by_turns(lambda: 4.0, lambda: 2.0, CPU, repeats=4, cap=1.0)
    assert (seconds.runs, order) == (1, [2.0, 4.0])
    assert 2 < ratio < 2.4  # of the warm-ups


# --------------------------------------------------------------------------------- throughput


def test_the_gpu_benchmark_runs_at_a_tiny_size_on_a_cpu(tmp_path, capsys, monkeypatch):
    place = importlib.util.spec_from_file_location("gpu", ROOT / "benchmarks" / "gpu.py")
    assert place is not None
    assert place.loader is not None
    gpu = importlib.util.module_from_spec(place)
    place.loader.exec_module(gpu)
    known = [Reference(1e-3, "best known", "test")]
    monkeypatch.setattr(gpu, "references", lambda *_: known)  # they take minutes
    monkeypatch.setattr(gpu, "copy_bandwidth", lambda _: 1e9)
    stream = Stream(size=(16, 24), pictures=1, length=1, repeats=1, budgets=(0, 1))
    gpu.main(tmp_path / "gpu.json", stream, ["fourier-admm"], pictures(stream, CPU))
    found = json.loads((tmp_path / "gpu.json").read_text())
    pairs = [(row["link"], row["transfer"]) for row in found["rows"]]
    assert pairs == [(k, t) for k in ("additive", "multiplicative") for t in ("none", "srgb")]
    assert all(row["pictures_a_second"] > 0 and row["floor"] > 0 for row in found["rows"])
    assert "floor" in capsys.readouterr().out


def test_the_fewest_iterations_that_reach_the_quality_are_timed():
    stream = Stream(size=(24, 32), pictures=2, length=2, repeats=1, quality=0.05)
    views, display = pictures(stream, CPU), displays()[0]
    assert not torch.equal(views[0].codes, views[1].codes)
    best = [Reference(1.0, "optimum", "test")] * 2
    row = run_stream(views, display, best, ("nmf", (1, 2)), stream, 1e9)
    assert (row.iterations, row.reached) == (1, True)
    row = run_stream(
        views, display, [Reference(1e-9, "optimum", "test")] * 2, ("nmf", (1, 2)), stream, 1e9
    )
    assert (row.iterations, row.reached) == (2, False)
    assert floor_seconds(views[0], display, 1e9) == (25 * 3 * 24 * 32 + 9 * 28 * 36) / 1e9
    assert copy_bandwidth(CPU, 2**16) > 0


# -------------------------------------------------------------------------------- the command


@pytest.fixture
def desk(tmp_path, monkeypatch, quick_references) -> Path:
    monkeypatch.chdir(tmp_path)
    write_views(Path("my-views"), small_field().views, DISPLAY, 8)
    return tmp_path


BENCH = ["bench", "my-views", "--repeats", "1", "--methods", "fourier-admm,nmf:2"]


def test_the_command_leaves_json_and_figures(desk):
    out = succeed(*BENCH, "--budgets", "2,1", "--out", "made", "--memory")
    assert "fourier-admm:2" in out
    names = {path.name for path in (desk / "made").iterdir()}
    assert names == {"bench.json"} | {
        f"{name}-additive-3.{kind}" for name in ("frontier", "excess") for kind in ("png", "svg")
    }
    text = (desk / "made" / "bench.json").read_text()
    found = json.loads(text, parse_constant=pytest.fail)
    assert [(row["method"], row["iterations"]) for row in found["rows"]] == [
        ("fourier-admm", 1),
        ("fourier-admm", 2),
        ("nmf", 2),
    ]
    assert [row["peak_mb"] is None for row in found["rows"]] == [True, False, False]
    assert {"processor", "threads", "torch"} < set(found["made_with"])
    assert found["command"].startswith("layerfield bench my-views --methods fourier-admm,nmf:2")
    assert len(found["summary"]) == 3
    for row in found["rows"]:
        assert row["excess"] >= row["excess_unrounded"] > 0
        assert row["operations"] > 0
    for private in (str(desk), *PRIVATE):
        assert not re.search(rf"\b{re.escape(private)}\b", text)
    svg = (desk / "made" / "frontier-additive-3.svg").read_text()
    assert all(word in svg for word in ("fourier-admm", "nmf", "reference", "seconds a picture"))


def test_paths_are_recorded_as_names(desk):
    words = ["--methods", "nmf:1", "--repeats", "1"]
    succeed("bench", desk / "my-views", *words, "--out", desk / "made")
    text = (desk / "made" / "bench.json").read_text()
    assert str(desk) not in text


def test_resume_and_force(desk):
    first = [*BENCH, "--budgets", "1", "--out", "made"]
    succeed(*first)
    before = json.loads((desk / "made/bench.json").read_text())["rows"]
    fails(run(*first), "exists", "--resume", "--force")
    succeed(*first[:-4], "--budgets", "1,2", "--out", "made", "--resume")
    after = json.loads((desk / "made/bench.json").read_text())["rows"]
    assert [row["seconds"] for row in after[:2]] == [row["seconds"] for row in before]
    assert len(after) == 3
    fails(run(*BENCH, "--cap", "7", "--out", "made", "--resume"), "effort")
    succeed(*first, "--force")
    assert len(json.loads((desk / "made/bench.json").read_text())["rows"]) == 2


def test_rows_of_other_things_of_the_same_name_are_not_gone_on_with(desk):
    near = "\n".join(
        ['name = "mine"', 'link = "additive"', "disparity = [1, 0, -1]", "views = [5, 5]"]
    )
    (desk / "mine.toml").write_text(near)
    first = ["bench", "my-views", "--display", "mine.toml", "--methods", "nmf:1", "--repeats", "1"]
    succeed(*first, "--out", "made")
    before = (desk / "made/bench.json").read_bytes()
    fails(
        run(*first, "--crop", "24x24+0+0", "--out", "made", "--resume"), "light field", "my-views"
    )
    (desk / "mine.toml").write_text(near.replace("-1]", "-2]"))
    fails(run(*first, "--out", "made", "--resume"), "display", "mine")
    assert (desk / "made/bench.json").read_bytes() == before
    (desk / "mine.toml").write_text(near.replace("mine", "other"))
    succeed(*first, "--out", "made", "--resume")
    found = json.loads((desk / "made/bench.json").read_text())
    assert set(found["subjects"]["display"]) == {"mine", "other"}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["bench", "--out", "o"], "--scaling"),
        (["bench", "nowhere", "--out", "o"], "nowhere"),
        ([*BENCH, "--budgets", "1,x", "--out", "o"], "budgets"),
        ([*BENCH, "--cap", "0", "--out", "o"], "cap"),
        ([*BENCH, "--cap", "nan", "--out", "o"], "cap"),
        ([*BENCH, "--repeats", "0", "--out", "o"], "repeats"),
        ([*BENCH, "--device", "tpu", "--out", "o"], "device"),
        ([*BENCH, "--display", "nothing", "--out", "o"], "nothing"),
        (["bench", "my-views", "--methods", "nofm", "--out", "o"], "nmf"),
        (["bench", "my-views", "--methods", "ntf", "--out", "o"], "additive"),
        ([*BENCH, "--views", "3x3", "--out", "o"], "3x3"),
        ([*BENCH, "--out", "nowhere/o"], "nowhere"),
        ([*BENCH, "--out", "my-views", "--force"], "my-views"),
        ([*BENCH, "--out", "o", "--resume"], "--resume"),
    ],
)
def test_wrong_input_is_one_line_and_leaves_nothing(desk, words, said):
    fails(run(*words), said)
    assert [path.name for path in desk.iterdir()] == ["my-views"]


def test_an_interrupt_leaves_whole_files(desk, monkeypatch):
    monkeypatch.setattr(frontier, "with_peak", lambda *_: os.kill(os.getpid(), signal.SIGINT))
    words = [*BENCH, "--budgets", "1", "--out", "made", "--memory"]
    fails(run(*words), "interrupted")
    assert not list((desk / "made").iterdir())


def test_scaling_from_the_command_line(desk, monkeypatch):
    monkeypatch.setattr(scaling, "cases", lambda: iter(SMALL[:2]))
    out = succeed("bench", "--scaling", "--methods", "nmf:1", "--repeats", "1", "--out", "made")
    assert "per doubling" in out
    found = json.loads((desk / "made/scaling.json").read_text())
    assert [row["amount"] for row in found["rows"]] == [256, 512]
    assert found["command"].endswith("--scaling")


def test_every_command_of_the_page_on_performance_runs(desk, monkeypatch):
    monkeypatch.setattr(scaling, "cases", lambda: iter(SMALL[:2]))
    page = (ROOT / "docs" / "performance.md").read_text("utf-8")
    runs([line for line in commands_in(page) if line.startswith("layerfield")])
    for script in re.findall(r"benchmarks/(\w+)\.py", page):
        assert (ROOT / "benchmarks" / f"{script}.py").is_file()


def test_names_of_files():
    assert file_name("a b/c:d") == "a-b-c-d"
    assert benchmark.made_on(CPU).endswith(f"{torch.get_num_threads()} thread")
