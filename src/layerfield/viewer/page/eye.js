// Where the eye is, how hands move it, and how it sways by itself until they do.

import { distanceOf, extent } from "layerfield/optics.js";

const BEYOND = 1.5; // times the synthesized range
const STRONGEST = 0.03; // change of a layer's magnification at the nearest distance
const STEP = 0.1; // of half the range, a key
const PUPILS = 0.063; // metres between the two eyes of a viewer
const PERIOD = 6; // seconds of a sway

export class Eye {
  constructor(changed) {
    this.changed = changed;
    this.swaying = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.apart = 0;
  }

  // Stand in front of another display; a place that it has, too, stays.
  face(display) {
    const { centre, half } = extent(display);
    const widest = Math.max(...half) || 1 / Math.max(...display.parallax.map(Math.abs), 1);
    const deepest = Math.max(...display.depths.map(Math.abs));
    const usual = 1 / distanceOf(display);
    const front = Math.max(display.depths[0], 0);
    const nearest = usual + (deepest ? STRONGEST / deepest : usual);
    this.centre = centre;
    this.half = half.map((range) => range || widest);
    this.swing = half;
    this.nearness = { usual, most: front ? Math.min(nearest, 0.9 / front) : nearest };
    this.moveTo(...(this.slope ?? centre), this.inverse ?? usual);
    const steps = Math.max(...(display.grid ?? [2, 2])) - 1 || 1;
    const known = display.physical && usual > 0; // else a view step
    this.apart = known ? PUPILS * usual : (2 * widest) / steps;
    this.widest = Math.max(2 * widest, 2 * this.apart);
  }

  moveTo(x, y, inverse = this.inverse) {
    const kept = [x, y].map((value, axis) => {
      const reach = BEYOND * this.half[axis];
      return Math.min(Math.max(value, this.centre[axis] - reach), this.centre[axis] + reach);
    });
    this.slope = kept;
    this.inverse = Math.min(Math.max(inverse, 0), this.nearness.most);
    this.changed();
  }

  // Move by shares of half the range across and down, and of the range of distances.
  moveBy(x, y, near = 0) {
    this.still();
    this.moveTo(
      this.slope[0] + x * this.half[0],
      this.slope[1] + y * this.half[1],
      this.inverse + near * this.nearness.most,
    );
  }

  goTo(x, y) {
    this.still();
    this.moveTo(x, y);
  }

  home() {
    this.still();
    this.moveTo(...this.centre, this.nearness.usual);
  }

  get distance() {
    return 1 / this.inverse;
  }

  still() {
    this.swaying = false;
  }

  sway(on) {
    this.swaying = on;
    this.changed();
  }

  // Called with the time in seconds before every picture.
  tick(seconds) {
    if (!this.swaying) return;
    const turn = (2 * Math.PI * seconds) / PERIOD;
    this.moveTo(
      this.centre[0] + 0.9 * this.swing[0] * Math.sin(turn),
      this.centre[1] + 0.5 * this.swing[1] * Math.sin(2 * turn),
    );
  }

  listenTo(element) {
    let last = null;
    element.addEventListener("pointerdown", (event) => {
      element.setPointerCapture(event.pointerId);
      last = event;
    });
    element.addEventListener("pointermove", (event) => {
      if (!last || event.pointerId !== last.pointerId) return;
      const across = 2 / element.clientWidth, down = 2 / element.clientHeight;
      this.moveBy((event.clientX - last.clientX) * across, (event.clientY - last.clientY) * down);
      last = event;
    });
    for (const end of ["pointerup", "pointercancel"])
      element.addEventListener(end, () => (last = null));
    element.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.moveBy(0, 0, -Math.sign(event.deltaY) * 0.04);
    }, { passive: false });
  }

  // Whether the key was one of those that move the eye.
  key({ key, shiftKey }) {
    const far = shiftKey ? 4 * STEP : STEP;
    const moves = {
      ArrowLeft: [-far, 0], ArrowRight: [far, 0], ArrowUp: [0, -far], ArrowDown: [0, far],
      "+": [0, 0, 0.04], "=": [0, 0, 0.04], "-": [0, 0, -0.04], "−": [0, 0, -0.04],
    };
    if (moves[key]) this.moveBy(...moves[key]);
    else if (key === "0") this.home();
    else if (key === " ") this.sway(!this.swaying);
    else return false;
    return true;
  }
}
