"""The commands that list what comes with the package: `displays`, `methods`, `weights`."""

from layerfield.cli.terminal import print_lines, say
from layerfield.display import Display, preset_names
from layerfield.methods import CHAIN_ITERATIONS
from layerfield.shipped import shipped
from layerfield.synthesizer import METHODS


def displays() -> None:
    """List the displays that come with the package."""
    found = [Display.load(name) for name in preset_names()]
    lines = [["name", "link", "views", "layers", "description"]]
    for display in found:
        views = "x".join(map(str, display.geometry.grid or (display.view_count,)))
        lines.append([display.name, display.link.name, views, str(display.layer_count)])
        lines[-1].append(display.spec.description)
    print_lines(lines)


def methods() -> None:
    """List the methods that make layers."""
    lines = [["name", "iterations", "displays", "summary"]]
    for method in METHODS.values():
        links = ", ".join(method.links)
        lines.append([method.name, str(method.iterations), links, method.summary])
    print_lines(lines)
    say("A name that `layerfield weights` lists, or FILE.safetensors, is the network with those")
    say("weights. NETWORK+SOLVER, as unet+fourier-admm, is a network followed by")
    say(f"{CHAIN_ITERATIONS} iterations of a solver.")


def weights() -> None:
    """List the trained networks that come with the package, with their scores."""
    entries = shipped()
    if not entries:
        say("no weights are shipped; train a network with layerfield train RECIPE.toml")
        return
    lines = [["name", "network", "display", "MB", "scores", "recipe"]]
    for entry in entries:
        display, size = entry.trained_for.name, f"{entry.megabytes:g}"
        lines.append([entry.name, entry.network, display, size, entry.scores, entry.recipe])
    print_lines(lines)
