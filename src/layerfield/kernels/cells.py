"""Cells of 8x8 pixels: what is known of them, a small network on that, and what is added.

Where every row is solved by itself it is a picture of its own, of one row of cells, above and below
which everything is as it is there: cells are one pixel tall, and taps of a column are one.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from torch import Tensor

from layerfield.kernels.blends import planes_of
from layerfield.kernels.compiled import compiled

CELL = 8  # pixels along the sides
APART = 2  # so far up or down, and left or right, lie the windows of a cell
SIGNS = 6  # what is known of a cell
BEYOND = 10.0  # what goes beyond the bounds is small
DEEPEST = 3.0  # logarithms have no least; below e^-3, a twentieth of the light, is little to see
_SIDE = 2 * APART  # of what windows have in common
_ROWS = 16  # of cells that a convolution goes over together
LEAK = 0.1  # what is left of negative values between convolutions


class Network(NamedTuple):
    """A `Relief` for compiled loops.

    Args:
        own: taps for every layer of the display, of all convolutions but the last.
        common: taps for the mean of all layers.
        bias: what is added.
        last: taps of the last one.
    """

    own: tuple[np.ndarray, ...]
    common: tuple[np.ndarray, ...]
    bias: tuple[np.ndarray, ...]
    last: np.ndarray

    @classmethod
    def of(cls, hidden: Sequence[Sequence[Tensor]], last: Tensor) -> "Network":
        """Return the network of such tensors, see `Relief`."""
        own, common, bias = (
            tuple(_array(each) for each in part) for part in zip(*hidden, strict=True)
        )
        return cls(own, common, bias, _array(last))

    @property
    def of_rows(self) -> "Network":
        """The same for rows that know nothing of each other."""
        own, common = (tuple(map(_of_rows, part)) for part in (self.own, self.common))
        return Network(own, common, self.bias, _of_rows(self.last))


def _array(values: Tensor) -> np.ndarray:
    return values.detach().contiguous().numpy()


def _of_rows(taps: np.ndarray) -> np.ndarray:
    return taps.sum(axis=2, keepdims=True)


_NO_TAPS = np.zeros((0, 0, 3, 3), np.float32)
NO_NETWORK = Network((_NO_TAPS,) * 2, (_NO_TAPS,) * 2, (np.zeros(0, np.float32),) * 2, _NO_TAPS)


def told(bounds: tuple[float, float]) -> tuple[float, float]:
    """Return the bounds that a network is told of: no further apart than `DEEPEST`."""
    low, high = bounds
    return max(low, high - DEEPEST), high


def relieve_(
    shadow: Float[Tensor, "*batch layer c ty tx"],
    size: tuple[int, int],
    bounds: tuple[float, float],
    network: Network,
    *,
    by_row: bool,
) -> None:
    """Change s as `Relief` says.

    Args:
        shadow: s, contiguous, of single precision, on a processor.
        size: height and width of what has cells, in the top left corner.
        bounds: of z, see `told`.
        network: of any number of channels.
        by_row: whether every row is solved by itself.
    """
    tall, network = (1, network.of_rows) if by_row else (CELL, network)
    planes, low, high = planes_of(shadow), *(np.float32(each) for each in bounds)
    number, channels = shadow.shape[-4:-2]
    pictures, cells = len(planes) // number, (-(-size[0] // tall), -(-size[1] // CELL))
    known = np.empty((pictures, number, SIGNS, *cells), np.float32)
    change = np.empty((pictures, number, *cells), np.float32)
    seen = known, planes, channels, tall, *size, low, high
    _look.in_spans(*seen, count=len(planes) * cells[0], numbers=planes.size)
    work = known.size * sum(len(each) for each in network.bias)
    together = _ROWS if by_row else cells[0]
    asked = change, known, *network, high - low, together
    _answer.in_spans(*asked, count=pictures * -(-cells[0] // together), numbers=work)
    given = planes, change, channels, tall, *size
    _add.in_spans(*given, count=len(planes) * size[0], numbers=planes.size)


@compiled
def relieve_picture(planes, picture, number, channels, size, bounds, network):
    """Do the same to the layers of one picture of one channel, on one thread."""
    height, width = size
    rows, columns = -(-height // CELL), -(-width // CELL)
    known = np.empty((1, number, SIGNS, rows, columns), np.float32)
    change = np.empty((1, number, rows, columns), np.float32)
    item, channel = divmod(picture, channels)
    low, high = bounds
    for k in range(number):
        plane = (item * number + k) * channels + channel
        _look_at_rows(known[0, k], planes[plane], CELL, height, width, low, high, 0, rows)
    own, common, bias, last = network
    _answer(change, known, own, common, bias, last, high - low, rows, 0, 1)
    for k in range(number):
        plane = (item * number + k) * channels + channel
        _add_to_rows(planes[plane], change[0, k], CELL, height, width, 0, height)


@compiled
def _look(made, planes, channels, tall, height, width, low, high, begin, end):
    """Rows of cells of all planes, one after the other, from and to."""
    number, rows, place = made.shape[1], made.shape[3], begin
    while place < end:
        plane, row = divmod(place, rows)
        count = min(rows - row, end - place)
        item, rest = divmod(plane, number * channels)
        k, channel = divmod(rest, channels)
        known = made[item * channels + channel, k]
        _look_at_rows(known, planes[plane], tall, height, width, low, high, row, row + count)
        place += count


@compiled
def _look_at_rows(known, plane, tall, height, width, low, high, begin, end):
    """Rows of cells from and to: each from three bands of pixels, the first that of the row before.

    Two bands and two groups of pixels are a window, and four windows a cell. Where cells are one
    pixel tall, all three bands are that row again and again.
    """
    columns, one = known.shape[2], np.float32(1)
    groups, scale = 2 * columns + 1, one / (high - low)
    bands = np.empty((3, 4, groups), np.float32)
    room = np.empty((4, groups * _SIDE), np.float32)
    inside, beyond = np.empty(groups, np.float32), np.empty(groups, np.float32)
    quarter, share = np.float32(0.25), np.float32(BEYOND / (4 * CELL**2)) * scale
    for row in range(begin, end):
        if tall == 1:
            _look_at_band(bands[0], room, plane, row, 0, height, width, low, high)
            bands[1], bands[2] = bands[0], bands[0]
        else:
            if row > begin:
                bands[0] = bands[2]
            for n in range(1 if row > begin else 0, 3):
                top = row * CELL - APART + n * _SIDE
                _look_at_band(bands[n], room, plane, top, 1, height, width, low, high)
        for sign in range(2):  # how far it may fall; and, of what is left up to 1, rise
            shift, more = (one + scale * low, -quarter) if sign else (-scale * low, quarter)
            inside[:], beyond[:] = 0, 0
            for n in range(2):
                _add_windows(inside, beyond, bands[n, sign], bands[n + 1, sign], scale, shift)
            for column in range(columns):
                x = 2 * column
                known[sign, row, column] = quarter * (inside[x] + inside[x + 1])
                far = np.float32(BEYOND) * (beyond[x] + beyond[x + 1])
                known[4 + sign, row, column] = more * far
        for sign in range(2, 4):
            weight = -share if sign == 3 else share
            first, second, third = bands[0, sign], bands[1, sign], bands[2, sign]
            for x in range(groups):
                inside[x] = weight * (first[x] + np.float32(2) * second[x] + third[x])
            for column in range(columns):
                x = 2 * column
                both = inside[x] + np.float32(2) * inside[x + 1] + inside[x + 2]
                known[sign, row, column] = both


@compiled
def _add_windows(inside, beyond, upper, lower, scale, shift):
    """Add what is least in windows, scaled and shifted: what of it is from 0 to 1, and the rest."""
    zero, one = np.float32(0), np.float32(1)
    for x in range(len(upper) - 1):
        least = scale * min(upper[x], upper[x + 1], lower[x], lower[x + 1]) + shift
        kept = min(max(least, zero), one)
        inside[x] += kept
        beyond[x] += least - kept


@compiled
def _look_at_band(made, room, plane, top, step, height, width, low, high):
    """Groups of 4x4 pixels: the least, minus the highest, and sums of what is beyond the bounds.

    Pixels outside of the picture are as those at its edge.
    """
    least, most, over, under = room[0], room[1], room[2], room[3]
    zero, last = np.float32(0), height - 1
    first, second = plane[min(max(top, 0), last)], plane[min(max(top + step, 0), last)]
    third = plane[min(max(top + 2 * step, 0), last)]
    fourth = plane[min(max(top + 3 * step, 0), last)]
    for x in range(width):
        a, b, c, d = first[x], second[x], third[x], fourth[x]
        least[x + APART], most[x + APART] = min(a, b, c, d), max(a, b, c, d)
        over[x + APART] = (
            max(a - high, zero) + max(b - high, zero) + max(c - high, zero) + max(d - high, zero)
        )
        under[x + APART] = (
            max(low - a, zero) + max(low - b, zero) + max(low - c, zero) + max(low - d, zero)
        )
    for each in room:
        each[:APART] = each[APART]
        each[APART + width :] = each[APART + width - 1]
    for group in range(made.shape[1]):
        x = group * _SIDE
        made[0, group] = min(least[x], least[x + 1], least[x + 2], least[x + 3])
        made[1, group] = -max(most[x], most[x + 1], most[x + 2], most[x + 3])
        made[2, group] = over[x] + over[x + 1] + over[x + 2] + over[x + 3]
        made[3, group] = under[x] + under[x + 1] + under[x + 2] + under[x + 3]


@compiled
def _answer(made, known, own, common, bias, last, scale, together, begin, end):
    """All layers of so many rows of cells of pictures, from and to; rows know of those alone."""
    number, signs, rows, width = known.shape[1:]
    parts, above = -(-rows // together), last.shape[2] // 2
    for place in range(begin, end):
        picture, part = divmod(place, parts)
        top, height = part * together, min(together, rows - part * together)
        seen = np.empty((number, signs, height + 2 * above, width + 2), np.float32)
        seen[:, :, above : above + height, 1:-1] = known[picture, :, :, top : top + height]
        for n in range(len(own)):
            for k in range(number):
                _frame(seen[k], above)
            shared = _of_all(seen, common[n], bias[n])
            after = np.empty((number, len(shared), height + 2 * above, width + 2), np.float32)
            for k in range(number):
                found = shared.copy()
                _convolve(found, seen[k], own[n])
                _go_on(after[k], found, seen[k], above, n > 0)
            seen = after
        answers = np.zeros((number, 1, height, width + 2), np.float32)
        for k in range(number):
            _frame(seen[k], above)
            _convolve(answers[k], seen[k], last)
        _balance(made[picture, :, top : top + height], answers[:, 0], scale)


@compiled
def _balance(made, answers, scale):
    """Take the mean of all layers off, and scale what is left."""
    number, height, width = made.shape
    for y in range(height):
        for x in range(width):
            mean = np.float32(0)
            for k in range(number):
                mean += answers[k, y, x]
            mean /= np.float32(number)
            for k in range(number):
                made[k, y, x] = scale * (answers[k, y, x] - mean)


@compiled
def _of_all(seen, taps, bias):
    """Return what is said to all layers of the display alike: by their mean."""
    number, signs, height, width = seen.shape
    mean = np.zeros((signs, height, width), np.float32)
    for k in range(number):
        for sign in range(signs):
            for y in range(height):
                mean[sign, y] += seen[k, sign, y] / np.float32(number)
    found = np.empty((len(bias), height + 1 - taps.shape[2], width), np.float32)
    for channel in range(len(bias)):
        found[channel] = bias[channel]
    _convolve(found, mean, taps)
    return found


@compiled
def _go_on(after, found, seen, above, adds):
    """Put what was found, and what was seen before if that is asked for, inside of a frame."""
    channels, height, width = found.shape
    for channel in range(channels):
        for y in range(height):
            line, old = found[channel, y], seen[channel if adds else 0, y + above]
            for x in range(width - 2):
                value = max(line[x], np.float32(LEAK) * line[x])
                after[channel, y + above, x + 1] = value + old[x + 1] if adds else value


@compiled
def _frame(planes, above):
    """Put what is nearest around planes: a column at each side, so many rows above and below."""
    for plane in planes:
        plane[:, 0] = plane[:, 1]
        plane[:, -1] = plane[:, -2]
        if above:
            plane[0] = plane[1]
            plane[-1] = plane[-2]


@compiled
def _convolve(made, seen, taps):
    """Add what 3x3 or 1x3 taps find in planes that have a frame.

    What is made is as wide, so that rows follow each other in both alike: the last two values of
    each mean nothing.
    """
    _, height, width = made.shape
    for y in range(0, height, _ROWS):
        count = min(_ROWS, height - y) * width - 2
        for channel in range(len(made)):
            line = made[channel].reshape(-1)[y * width :]
            for sign in range(len(seen)):
                plane, near = seen[sign].reshape(-1), taps[channel, sign]
                upper = plane[y * width :]
                a, b, c = near[0, 0], near[0, 1], near[0, 2]
                if len(near) == 1:
                    for x in range(count):
                        line[x] += a * upper[x] + b * upper[x + 1] + c * upper[x + 2]
                    continue
                middle, lower = plane[(y + 1) * width :], plane[(y + 2) * width :]
                d, e, f = near[1, 0], near[1, 1], near[1, 2]
                g, h, i = near[2, 0], near[2, 1], near[2, 2]
                for x in range(count):
                    line[x] += (
                        (a * upper[x] + b * upper[x + 1] + c * upper[x + 2])
                        + (d * middle[x] + e * middle[x + 1] + f * middle[x + 2])
                        + (g * lower[x] + h * lower[x + 1] + i * lower[x + 2])
                    )


@compiled
def _add(planes, change, channels, tall, height, width, begin, end):
    """Rows of pixels of all planes, one after the other, from and to."""
    number, place = change.shape[1], begin
    while place < end:
        plane, y = divmod(place, height)
        count = min(height - y, end - place)
        item, rest = divmod(plane, number * channels)
        k, channel = divmod(rest, channels)
        cells = change[item * channels + channel, k]
        _add_to_rows(planes[plane], cells, tall, height, width, y, y + count)
        place += count


@compiled
def _add_to_rows(plane, cells, tall, height, width, begin, end):
    """Rows of pixels from and to."""
    rows, columns = cells.shape
    half, one = np.float32(0.5), np.float32(1) / np.float32(CELL)
    # Half a cell more at each side: what lies beyond the last middles is as it is there.
    between = np.empty(columns + 2, np.float32)
    line = np.empty((columns + 1) * CELL, np.float32)
    for y in range(begin, end):
        at = max((np.float32(y) + half) / np.float32(tall) - half, np.float32(0))
        upper = int(at)
        lower, below = min(upper + 1, rows - 1), at - np.float32(upper)
        for x in range(columns):
            first, second = cells[upper, x], cells[lower, x]
            between[x + 1] = first + below * (second - first)
        between[0], between[columns + 1] = between[1], between[columns]
        for column in range(columns + 1):
            first, step = between[column], between[column + 1] - between[column]
            for x in range(CELL):
                line[column * CELL + x] = first + (np.float32(x) + half) * one * step
        pixels = plane[y]
        for x in range(width):
            pixels[x] += line[x + CELL // 2]
