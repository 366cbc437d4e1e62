"""The registry of forms; a new one is one line here, and one file where it is no video."""

from layerfield.video.film import Film
from layerfield.video.form import Form
from layerfield.video.pictures import Pictures

_HALF_COLOUR = {(channels, 8): "yuv420p" for channels in (1, 3)}

FORMS: dict[str, Form] = {
    "ffv1": Film(
        title="lossless video (FFV1)",
        bits=(8, 16),
        codec="ffv1",
        suffix=".mkv",
        pixels={(1, 8): "gray", (3, 8): "bgr0", (1, 16): "gray16le", (3, 16): "gbrp16le"},
        options={"level": "3", "g": "1", "slices": "4", "slicecrc": "1"},
        lossy=False,
    ),
    "h264": Film(
        title="video with losses (H.264)",
        bits=(8,),
        codec="libx264",
        suffix=".mp4",
        pixels=_HALF_COLOUR,
        options={"crf": "14", "preset": "medium", "bf": "0"},  # decoded in the order of their times
        lossy=True,
    ),
    "av1": Film(
        title="video with losses (AV1)",
        bits=(8,),
        codec="libsvtav1",
        suffix=".mp4",
        pixels=_HALF_COLOUR,
        options={"crf": "18", "preset": "8"},
        lossy=True,
    ),
    "png": Pictures(),
}
