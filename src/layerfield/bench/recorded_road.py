"""The road that is timed, recorded once on a GPU and played for every picture."""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace

import torch

from layerfield.bench.road import EightBitViews, Panels, views_to_panels
from layerfield.clock import without_waiting
from layerfield.display import Display
from layerfield.methods import SolverMethod
from layerfield.solvers.tiled_admm import TiledAdmm
from layerfield.synthesizer import find_method, pose
from layerfield.transfer import Curve, named


def refuse_unrecorded(method: str, display: Display) -> None:
    """Refuse what asks the processor while a picture is made: that cannot be recorded.

    Raises:
        ValueError: a network or `fourier-tiles`, a display with subframes or a curve.
    """
    found = find_method(method)
    solver = found.make(display.link) if isinstance(found, SolverMethod) else None
    if solver is None or isinstance(solver, TiledAdmm):
        raise ValueError(
            f"'{method}' asks the processor while it makes a picture, so it cannot be recorded for "
            "a GPU; expected a solver other than fourier-tiles"
        )
    if display.subframes > 1 or isinstance(display.transfer, Curve):
        raise ValueError(
            f"display '{display.name}' has {display.subframes} subframes and the transfer "
            f"{named(display.transfer)}; recorded for a GPU are displays of one, without a curve"
        )


class RecordedRoad:
    """The road for one display and size of views, recorded once on a GPU and played for all others.

    A picture is then a single call: on the road itself, processors take longer to say what is to be
    done than a large GPU takes to do it. What is known of the display is kept meanwhile.

    Args:
        views: of that size, on the GPU.
        display: as of `views_to_panels`, and the others.
        method: as `synthesize` takes it.
        iterations: of the method.

    Raises:
        ValueError: see `refuse_unrecorded`.
    """

    def __init__(
        self, views: EightBitViews, display: Display, method: str, iterations: int
    ) -> None:
        refuse_unrecorded(method, display)
        self._views = replace(views, codes=views.codes.clone())
        self._graph = torch.cuda.CUDAGraph()
        given = self._views, display, method, iterations
        views_to_panels(*given)  # what is kept of a display, and compiled, is found before
        constants = pose(views.light_field(), display).constants
        self._kept = constants, constants.gram.spectral.kept
        with without_waiting(), torch.cuda.graph(self._graph):
            self._made = views_to_panels(*given)

    def __call__(self, views: EightBitViews) -> Panels:
        """Return the panels of other views; the next call writes on them.

        Raises:
            ValueError: views of another shape, or of more bits.
        """
        expected, codes = self._views.codes, views.codes
        if (codes.shape, codes.dtype) != (expected.shape, expected.dtype):
            raise ValueError(
                f"found views of shape {tuple(codes.shape)}, {codes.dtype}, recorded was "
                f"{tuple(expected.shape)}, {expected.dtype}"
            )
        self._views.codes.copy_(views.codes)
        self._graph.replay()
        return self._made


class Pipeline:
    """Recorded roads that take turns, each on a stream of its own.

    A GPU begins a picture before the one before is done: coarse steps and networks are too small
    to keep all of it busy.

    Args:
        views: of the size of all that follow, on the GPU.
        display: as of `views_to_panels`, and the others.
        method: as `synthesize` takes it.
        iterations: of the method.
        at_once: pictures that are under way together; each takes the memory of one.

    Raises:
        ValueError: see `refuse_unrecorded`.
    """

    def __init__(
        self, views: EightBitViews, display: Display, method: str, iterations: int, at_once: int
    ) -> None:
        roads = [RecordedRoad(views, display, method, iterations) for _ in range(at_once)]
        self._lanes = deque((road, torch.cuda.Stream(views.codes.device)) for road in roads)
        self._under_way = deque[tuple[Panels, torch.cuda.Event]]()

    def __call__(self, views: EightBitViews) -> Panels:
        """Return the panels of a picture alone.

        Raises:
            ValueError: as of a `RecordedRoad`.
        """
        self._begin(views)
        return self._end()

    def run(self, pictures: Iterable[EightBitViews]) -> Iterator[Panels]:
        """Yield the panels of pictures, in their order, for the current stream.

        They are written on once so many more have been asked for as are under way together.

        Raises:
            ValueError: as of a `RecordedRoad`.
        """
        for views in pictures:
            if len(self._under_way) == len(self._lanes):
                yield self._end()
            self._begin(views)
        while self._under_way:
            yield self._end()

    def _begin(self, views: EightBitViews) -> None:
        road, stream = self._lanes[0]
        self._lanes.rotate(-1)
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            panels, done = road(views), torch.cuda.Event()
            done.record()
        views.codes.record_stream(stream)
        self._under_way.append((panels, done))

    def _end(self) -> Panels:
        panels, done = self._under_way.popleft()
        torch.cuda.current_stream().wait_event(done)
        return panels
